//! Ambient, diffuse and specular light, kinds of lights, and which side is lit.

use glam::DVec3;
use heliostat::scene::light::LightShape;
use heliostat::scene::{Color, Light, Material, Shading};
use heliostat::settings::Integrator;

use crate::tiny::*;

const EYE: DVec3 = DVec3::new(1.5, 2.5, 3.0);
const HIT: DVec3 = DVec3::new(0.3, 0.0, -0.2);
const LAMP: DVec3 = DVec3::new(-1.0, 2.25, -1.5);

fn glossy() -> Material {
    Material { ka: [0.3, 0.2, 0.1], kd: [0.6, 0.5, 0.4], ks: [0.25, 0.5, 0.75], shininess: 7.5, ..BLACK }
}

fn colored(shape: LightShape) -> Light {
    Light { diffuse: [0.9, 0.7, 0.5], specular: [0.2, 0.4, 0.8], ..shining(shape) }
}

/// The floor at y = 0, seen at `HIT`.
fn floor(material: &Material, lights: &[Light]) -> Color {
    let mut tiny = Tiny::new(EYE, HIT);
    tiny.level(0.0, material);
    lights.iter().for_each(|light| tiny.light(light));
    tiny.color()
}

#[test]
fn ambient_light_is_the_scenes_and_the_lights_and_never_shadowed() {
    let material = Material { emission: [0.01, 0.02, 0.03], ..glossy() };
    let mut tiny = Tiny::new(EYE, HIT);
    tiny.level(0.0, &material);
    // In the shadow of a roof over everything.
    tiny.level(10.0, &BLACK);
    tiny.header.ambient = [0.1, 0.2, 0.3];
    for ambient in [[0.25, 0.0, 0.5], [0.0, 0.125, 0.0]] {
        tiny.light(&Light { ambient, ..point_light(v(0.0, 11.0, 0.0)) });
    }
    let ambient = [0.1 + 0.25, 0.2 + 0.125, 0.3 + 0.5];
    assert_color(tiny.color(), sum(product(material.ka, ambient), material.emission));
}

#[test]
fn emission_of_the_front_isn_t_seen_from_behind() {
    for integrator in [Integrator::Whitted, Integrator::Path] {
        for (one_sided, eye, expected) in
            [(false, EYE, [0.5; 3]), (false, -EYE, [0.5; 3]), (true, EYE, [0.5; 3]), (true, -EYE, [0.0; 3])]
        {
            let mut tiny = Tiny::new(eye, v(0.0, 0.0, 0.0));
            tiny.image.integrator = integrator;
            tiny.level(0.0, &Material { one_sided, ..glowing([0.5; 3]) });
            assert_color(tiny.color(), expected);
        }
    }
}

#[test]
fn point_lights_add_up() {
    let lights = [
        colored(LightShape::Point { position: LAMP }),
        colored(LightShape::Point { position: v(2.0, 1.0, 1.0) }),
    ];
    let by_hand = |light: &Light, position| Around::new(HIT, DVec3::Y, position, EYE).phong(&glossy(), light);
    let one = by_hand(&lights[0], LAMP);
    assert!(one.iter().all(|&c| c > 0.05), "{one:?}");
    assert_color(floor(&glossy(), &lights[..1]), one);
    assert_color(floor(&glossy(), &lights), sum(one, by_hand(&lights[1], v(2.0, 1.0, 1.0))));
}

#[test]
fn the_exponent_is_exact() {
    // The mirror direction of the viewer, but for a small angle.
    let light = colored(LightShape::Point { position: v(-1.0, 2.5, -3.125) });
    let around = Around::new(HIT, DVec3::Y, v(-1.0, 2.5, -3.125), EYE);
    for shininess in [0.0, 0.5, 1.0, 32.0, 500.25, 20_000.0] {
        let material = Material { shininess, ..glossy() };
        assert_color(floor(&material, std::slice::from_ref(&light)), around.phong(&material, &light));
    }
}

#[test]
fn directional_light_comes_from_one_direction() {
    let direction = v(0.4, -1.0, 0.3).normalize();
    let light = colored(LightShape::Directional { direction });
    let around = Around { to_light: -direction, ..Around::new(HIT, DVec3::Y, LAMP, EYE) };
    assert_color(floor(&glossy(), std::slice::from_ref(&light)), around.phong(&glossy(), &light));
}

#[test]
fn falloff_divides_by_a_polynomial_of_the_distance() {
    let distance = (LAMP - HIT).length();
    for [c, l, q] in [[1.0, 0.0, 0.0], [0.5, 0.25, 0.0], [0.25, 0.125, 0.5], [0.0, 0.0, 2.0]] {
        let light = Light { falloff: Some([c, l, q]), ..colored(LightShape::Point { position: LAMP }) };
        let whole = Around::new(HIT, DVec3::Y, LAMP, EYE).phong(&glossy(), &light);
        let expected = scaled(whole, 1.0 / (c + l * distance + q * distance * distance));
        assert_color(floor(&glossy(), &[light]), expected);
    }
}

#[test]
fn spots_are_smooth_between_their_cones() {
    let whole = Around::new(HIT, DVec3::Y, LAMP, EYE)
        .phong(&glossy(), &colored(LightShape::Point { position: LAMP }));
    let axis = (HIT - LAMP).normalize();
    let aside = axis.cross(DVec3::Z).normalize();
    for (off, expected) in
        [(0.0, 1.0), (0.19, 1.0), (0.25, f64::NAN), (0.35, f64::NAN), (0.41, 0.0), (3.0, 0.0)]
    {
        // The spot looks past the hit by the angle `off`.
        let direction = axis * libm::cos(off) + aside * libm::sin(off);
        let (cos_inner, cos_outer) = (libm::cos(0.2), libm::cos(0.4));
        let x = (libm::cos(off) - cos_outer) / (cos_inner - cos_outer);
        let cone = if expected.is_nan() { 3.0 * x * x - 2.0 * x * x * x } else { expected };
        let distance = (LAMP - HIT).length();
        for falloff in [None, Some([0.0, 0.5, 0.0])] {
            let shape = LightShape::Spot { position: LAMP, direction, cos_inner, cos_outer };
            let weaker = if falloff.is_some() { 2.0 / distance } else { 1.0 };
            let found = floor(&glossy(), &[Light { falloff, ..colored(shape) }]);
            assert_color(found, scaled(whole, cone * weaker));
        }
        let hard = LightShape::Spot { position: LAMP, direction, cos_inner, cos_outer: cos_inner };
        let inside = if off < 0.2 { 1.0 } else { 0.0 };
        assert_color(floor(&glossy(), &[colored(hard)]), scaled(whole, inside));
    }
}

#[test]
fn spheres_are_lit_by_their_own_normal() {
    let center = v(0.5, 1.0, -0.25);
    let out = v(0.5, 0.7, 0.6).normalize();
    let hit = center + out * 0.75;
    let light = colored(LightShape::Point { position: v(-1.0, 4.0, 3.0) });
    let mut tiny = Tiny::new(EYE, hit);
    tiny.sphere(center, 0.75, &glossy());
    tiny.light(&light);
    assert_color(tiny.color(), Around::new(hit, out, v(-1.0, 4.0, 3.0), EYE).phong(&glossy(), &light));

    // From inside the normal is turned, and a light inside is seen.
    let (eye, lamp) = (center - out * 0.3, center + v(0.2, 0.1, -0.3));
    let light = colored(LightShape::Point { position: lamp });
    let mut tiny = Tiny::new(eye, hit);
    tiny.sphere(center, 0.75, &glossy());
    tiny.light(&light);
    assert_color(tiny.color(), Around::new(hit, -out, lamp, eye).phong(&glossy(), &light));
}

/// The floor with all shading normals equal to `normal`, wound and stored either way round.
fn tilted(eye: DVec3, normal: DVec3, lamp: DVec3) -> Vec<Color> {
    let mut found = Vec::new();
    for (wound, stored) in [(false, 1.0), (false, -1.0), (true, 1.0), (true, -1.0)] {
        for shading in [Shading::Phong, Shading::Gouraud] {
            let mut mesh = quad(square(0.0, 20.0));
            mesh.normals = vec![(normal * stored).to_array().map(|c| c as f32); 4];
            if wound {
                mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
            }
            let mut tiny = Tiny::new(eye, HIT);
            // No highlight: Gouraud's would differ.
            tiny.mesh(mesh, &Material { ks: [0.0; 3], ..glossy() }, shading);
            // Far enough that L hardly differs between the vertices.
            tiny.light(&shining(LightShape::Directional { direction: -lamp.normalize() }));
            found.push(tiny.color());
        }
    }
    found
}

#[test]
fn a_light_behind_either_normal_gives_nothing() {
    let normal = v(0.8, 0.6, 0.0);
    let kd = glossy().kd;
    let cosine = |lamp: DVec3| scaled(kd, normal.dot(lamp.normalize()));
    // In front of both.
    let lamp = v(0.5, 1.0, 0.0);
    tilted(EYE, normal, lamp).into_iter().for_each(|found| assert_color(found, cosine(lamp)));
    // In front of the shading normal, but below the floor.
    let lamp = v(1.0, -0.25, 0.0);
    assert!(normal.dot(lamp) > 0.0);
    tilted(EYE, normal, lamp).into_iter().for_each(|found| assert_eq!(found, [0.0; 3]));
    // Above the floor, but behind the shading normal.
    let lamp = v(-1.0, 0.25, 0.0);
    tilted(EYE, normal, lamp).into_iter().for_each(|found| assert_eq!(found, [0.0; 3]));
}

#[test]
fn both_normals_turn_to_the_viewers_side() {
    let normal = v(0.8, 0.6, 0.0);
    let below = v(EYE.x, -EYE.y, EYE.z);
    // Seen from below the shading normal is (-0.8, -0.6, 0).
    let lamp = v(-1.0, -0.5, 0.25);
    let expected = scaled(glossy().kd, -normal.dot(lamp.normalize()));
    tilted(below, normal, lamp).into_iter().for_each(|found| assert_color(found, expected));
    tilted(below, normal, -lamp).into_iter().for_each(|found| assert_eq!(found, [0.0; 3]));
}

#[test]
fn no_highlight_where_the_light_is_behind_the_shading_normal() {
    // (R·V) alone would be positive: R is L mirrored about N, whichever side L is on.
    let normal = v(0.8, 0.6, 0.0);
    let lamp = v(-1.0, 1.2, 0.0).normalize();
    let eye = v(4.0, 1.0, 0.0);
    let mirrored = 2.0 * normal.dot(lamp) * normal - lamp;
    assert!(normal.dot(lamp) < 0.0 && lamp.y > 0.0 && mirrored.dot(eye) > 0.0);
    let mut mesh = quad(square(0.0, 20.0));
    mesh.normals = vec![[0.8, 0.6, 0.0]; 4];
    let mut tiny = Tiny::new(HIT + eye, HIT);
    // No diffuse light, which would be negative there and could hide it.
    tiny.mesh(mesh, &Material { kd: [0.0; 3], ..glossy() }, Shading::Phong);
    tiny.light(&shining(LightShape::Directional { direction: -lamp }));
    assert_eq!(tiny.color(), [0.0; 3]);
}
