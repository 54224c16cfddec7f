//! Which rank gets which blocks of a scene, by what the image will ask of them: a coarse look before any structure is there. Rank 0 alone looks.

use glam::DVec3;

use super::{Renderer, cost};
use crate::accel::Accel;
use crate::accel::partition::Survey;
use crate::accel::voxels::Voxels;
use crate::geometry::{NONE, Ray};
use crate::scene::Scene;
use crate::scene::material::Material;
use crate::settings::{AccelKind, ImageSettings, Integrator};

/// Most lights that are looked at from one place.
const LIGHTS: usize = 4;
/// Steps of a sequence that fills the unit square evenly (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
const STEPS: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];

/// Divides a scene among `ranks`, each of which may have `copies` primitives beside its own. The same for the same arguments. On the current rayon pool.
pub fn divide(scene: &Scene, settings: &ImageSettings, ranks: usize, copies: u64) -> Voxels {
    let looks = cost::looks(&Renderer::new(scene, &Accel::Brute, settings), settings.crop);
    let survey = Survey::new(&scene.surfaces, ranks);
    let mut hot = Vec::new();
    if copies > 0 {
        let onward = onward(scene, settings, &survey, &looks);
        hot = survey.hottest(&survey.heat(&[&looks[..], &onward].concat()), copies);
    }
    survey.divide(ranks, &looks, &hot)
}

/// How many primitives may be copied for so many bytes, with all textures that these may need.
pub fn copies(scene: &Scene, accel: AccelKind, bytes: u64) -> u64 {
    let primitives = scene.surfaces.len().max(1) as u64;
    let surfaces = scene.surfaces.memory() as u64;
    let textures = scene.memory() as u64 - surfaces;
    // Each has its number in the whole, too.
    let each =
        surfaces.div_ceil(primitives) + size_of::<u32>() as u64 + Accel::bytes_each(accel, &scene.surfaces);
    bytes.saturating_sub(textures) / each
}

/// What rays may follow where these first come to something: to lights, and, where surfaces or paths send them on, some way or other.
fn onward(scene: &Scene, settings: &ImageSettings, survey: &Survey, looks: &[Ray]) -> Vec<Ray> {
    let header = &scene.header;
    let sends_on = |material: &Material| {
        material.reflectivity > 0.0 || [material.kr, material.kt].concat().iter().any(|&weight| weight > 0.0)
    };
    let goes_on = settings.integrator == Integrator::Path || header.materials.iter().any(sends_on);
    let ray = |origin: DVec3, direction: DVec3, t_max: f64| Ray {
        origin,
        direction,
        t_min: 0.0,
        t_max,
        first_id: 0,
        start: NONE,
    };
    let mut rays = Vec::new();
    let mut lights = header.lights.iter().cycle();
    for (number, look) in looks.iter().enumerate() {
        let Some((_, place)) = survey.first(look) else { continue };
        for light in lights.by_ref().take(LIGHTS.min(header.lights.len())) {
            let arrival = light.arrival(place, 1.0 / header.frame.scale);
            if arrival.strength > 0.0 && arrival.to_light != DVec3::ZERO {
                rays.push(ray(place, arrival.to_light, arrival.t_max));
            }
        }
        if goes_on {
            let [u, v] = STEPS.map(|step| (number as f64 * step).fract());
            rays.push(ray(place, on_sphere(u, v), f64::INFINITY));
        }
    }
    rays
}

/// A direction for a point of the unit square, evenly.
fn on_sphere(u: f64, v: f64) -> DVec3 {
    let (z, angle) = (1.0 - 2.0 * u, std::f64::consts::TAU * v);
    let across = libm::sqrt(1.0 - z * z);
    DVec3::new(across * libm::cos(angle), across * libm::sin(angle), z)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::accel::voxels::EVERYBODY;
    use crate::scene::load;

    fn scene(name: &str) -> Scene {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        load::load(&path).unwrap().scene
    }

    #[test]
    fn copies_are_as_many_as_allowed_and_the_same_each_time() {
        let scene = scene("teapot.toml");
        let (image, ranks) = (ImageSettings::sized(64, 64), 3);
        let surfaces = &scene.surfaces;
        let held = |voxels: &Voxels| voxels.counts(surfaces, ranks).iter().sum::<u64>();
        let none = divide(&scene, &image, ranks, 0);
        assert!(!none.owners.contains(&EVERYBODY));
        let mut before = held(&none);
        for copies in [2000, 6000, u64::MAX] {
            let voxels = divide(&scene, &image, ranks, copies);
            assert_eq!(voxels, divide(&scene, &image, ranks, copies));
            let owned_by_all =
                |rank| voxels.copies(&scene.subset(&voxels.part(surfaces, rank)).surfaces, rank);
            assert!((0..ranks).all(|rank| owned_by_all(rank) <= copies));
            let now = held(&voxels);
            assert!(now > before, "{now} with {copies} copies, {before} with less");
            before = now;
        }
    }

    #[test]
    fn textures_are_paid_for_once() {
        let scene = scene("textured.toml");
        let texels = scene.memory() - scene.surfaces.memory();
        assert!(texels > 0);
        let copies = |bytes: usize| copies(&scene, AccelKind::Bvh, bytes as u64);
        assert_eq!(copies(texels), 0);
        let all = copies(texels + 1_000_000);
        assert!(all > 0 && copies(texels + 2_000_000).abs_diff(2 * all) <= 1);
    }
}
