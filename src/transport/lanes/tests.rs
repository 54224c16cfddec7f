//! Side by side and one by one.

use super::glossy::Glossy;
use super::matt::Matt;
use super::*;
use crate::accel::Accel;
use crate::geometry::record::Query;
use crate::scene::{Scene, load};
use crate::settings::{AccelKind, BuildPreset, Direct, ImageSettings, Integrator, SamplerKind};
use crate::transport::{Scratch, Sink};

#[derive(Default)]
struct Kept {
    rays: Vec<RayRecord>,
    light: Vec<(u32, Color)>,
}

impl Sink for Kept {
    fn push(&mut self, record: RayRecord) {
        self.rays.push(record);
    }

    fn deposit(&mut self, record: &RayRecord, radiance: Color) {
        self.light.push((record.pixel, radiance));
    }
}

impl Kept {
    fn sorted(mut self) -> Self {
        let bits = |color: Color| color.map(f64::to_bits);
        self.rays.sort_by_key(|ray| (ray.pixel, ray.bounce, ray.made_by, ray.throughput.map(f64::to_bits)));
        self.light.sort_by_key(|&(pixel, radiance)| (pixel, bits(radiance)));
        self
    }
}

fn scene(name: &str) -> Scene {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let mut scene = load::load(path.as_ref()).unwrap().scene;
    scene.find_emitters();
    scene.prepare_lighting(None);
    scene
}

/// Rays from all over the image and what becomes of them, side by side and one by one: the same, bit for bit.
#[test]
fn the_same_light_and_rays_as_one_by_one() {
    let mut side_by_side = 0;
    let (path, whitted) = (Integrator::Path, Integrator::Whitted);
    for (name, integrator, sampler, direct) in [
        ("cornell-path", path, SamplerKind::Sobol, Direct::Both),
        ("cornell-mixed", path, SamplerKind::Stratified, Direct::Both),
        ("many-lights", path, SamplerKind::Sobol, Direct::Light),
        ("interior", path, SamplerKind::Independent, Direct::Both),
        ("environment", path, SamplerKind::Blue, Direct::Both),
        ("veach-mis", path, SamplerKind::Sobol, Direct::Bsdf),
        ("sphereflake", whitted, SamplerKind::Sobol, Direct::Both),
        ("teapot", whitted, SamplerKind::Sobol, Direct::Both),
        ("glass", whitted, SamplerKind::Sobol, Direct::Both),
        ("spots", whitted, SamplerKind::Sobol, Direct::Both),
        ("shading", whitted, SamplerKind::Sobol, Direct::Both),
        ("textured", whitted, SamplerKind::Sobol, Direct::Both),
    ] {
        let scene = scene(name);
        let accel = Accel::build(AccelKind::Bvh, BuildPreset::Fast, &scene.surfaces);
        let settings = ImageSettings {
            integrator,
            roulette: 2,
            max_depth: 5,
            spp: 4,
            sampler,
            direct,
            ..ImageSettings::sized(48, 40)
        };
        let transport = Transport::new(&scene, &settings);
        let mut scratch = Scratch::default();
        let mut wave: Vec<RayRecord> = (0..48 * 40)
            .map(|pixel| {
                let (x, y) = (f64::from(pixel % 48) + 0.4, f64::from(pixel / 48) + 0.7);
                let (origin, direction) = scene.header.camera.ray(x, y, 48.0, 40.0, [0.5; 2]);
                RayRecord::camera(origin, direction, pixel, pixel % 4, 0)
            })
            .collect();
        while !wave.is_empty() {
            let mut answers = Vec::new();
            accel.trace(&scene.surfaces, &wave, &mut answers);
            let (mut alone, mut together) = (Kept::default(), Kept::default());
            for (record, answer) in wave.iter().zip(&answers) {
                transport.advance(record, answer, &mut alone);
                if answer.is_hit() && record.query() == Query::Closest {
                    side_by_side += usize::from(match integrator {
                        Integrator::Path => Matt::default().take(&transport, 0, record, answer),
                        Integrator::Whitted => Glossy::default().take(&transport, 0, record, answer),
                    });
                }
            }
            transport.advance_all(&wave, &answers, &mut scratch, &mut together);
            let (alone, together) = (alone.sorted(), together.sorted());
            assert!(alone.rays == together.rays, "{name}: rays differ");
            assert!(alone.light == together.light, "{name}: light differs");
            wave = together.rays;
        }
    }
    assert!(side_by_side > 20_000, "{side_by_side}");
}
