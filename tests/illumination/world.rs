//! Cameras, and that neither the scale nor the place of a scene matters.

use glam::{DAffine3, DVec3};
use heliostat::image::Image;
use heliostat::scene::generate::icosphere::icosphere;
use heliostat::scene::light::LightShape;
use heliostat::scene::{Camera, Light, Material, Shading};

use crate::tiny::*;

/// Where each pixel of a camera above a map sees it.
fn places(camera: Camera, width: u32, height: u32) -> Vec<[f64; 2]> {
    let mut tiny = Tiny::new(DVec3::Y, DVec3::ZERO).sized(width, height);
    tiny.header.camera = camera;
    tiny.map(0.0);
    tiny.render().pixels.iter().map(|pixel| mapped(pixel.map(f64::from))).collect()
}

#[test]
fn pixels_are_seen_through_their_centers() {
    for (width, height) in [(6, 4), (2, 5), (3, 3)] {
        // From above, north (-z) up, so that east (+x) is right.
        let (eye, target) = (v(0.5, 6.0, 0.25), v(0.5, 0.0, 0.25));
        let fov: f64 = 40.0;
        let perspective = Camera::perspective(eye, target, DVec3::NEG_Z, fov).unwrap();
        let orthographic = Camera::orthographic(eye, target, DVec3::NEG_Z, 3.0).unwrap();
        let half = 6.0 * libm::tan((fov / 2.0).to_radians());
        for (camera, half) in [(perspective, half), (orthographic, 1.5)] {
            let found = places(camera, width, height);
            let pixel = 2.0 * half / f64::from(height);
            for (index, place) in found.into_iter().enumerate() {
                let (column, row) = (index as u32 % width, index as u32 / width);
                let east = pixel * (f64::from(column) + 0.5 - f64::from(width) / 2.0);
                let south = pixel * (f64::from(row) + 0.5 - f64::from(height) / 2.0);
                assert_place(place, [0.5 + east, 0.25 + south]);
            }
        }
    }
}

#[test]
fn oblique_cameras_look_where_they_are_told() {
    let (eye, target) = (v(1.0, 5.0, 3.0), v(-0.5, 0.0, 0.25));
    let forward = (target - eye).normalize();
    // `up` only says which way is up: any vector in the same vertical plane gives the same picture.
    let right = forward.cross(DVec3::Y).normalize();
    let top = right.cross(forward);
    let half = libm::tan(15.0f64.to_radians());
    for up in [DVec3::Y, DVec3::Y * 7.0 + forward * 3.0] {
        let camera = Camera::perspective(eye, target, up, 30.0).unwrap();
        let found = places(camera, 3, 3);
        for (index, place) in found.into_iter().enumerate() {
            let film = [index % 3, index / 3].map(|k| (k as f64 - 1.0) * half * 2.0 / 3.0);
            let direction = forward + right * film[0] - top * film[1];
            let hit = eye - direction * (eye.y / direction.y);
            assert_place(place, [hit.x, hit.z]);
        }
    }
}

/// A bit of everything, with coordinates that are multiples of 1/16, made larger and moved. `even`: its box is centred.
fn still_life(factor: f64, shift: DVec3, orthographic: bool, even: bool) -> Image {
    let at = |x: f64, y: f64, z: f64| v(x, y, z) * factor + shift;
    let mut tiny = Tiny::new(DVec3::Y, DVec3::ZERO).sized(24, 18);
    tiny.image.spp = 3;
    let (eye, target) = (at(2.0, 3.5, 6.0), at(0.25, 0.5, 0.0));
    tiny.header.camera = if orthographic {
        Camera::orthographic(eye, target, DVec3::Y, 4.0 * factor).unwrap()
    } else {
        Camera::perspective(eye, target, DVec3::Y, 40.0).unwrap()
    };
    let floor = Material { kd: [0.7, 0.6, 0.5], kr: [0.2; 3], ..BLACK };
    tiny.quad(square(-4.0, 4.0).map(|p| at(p.x, p.y, p.z)), &floor);
    let size = if even { 4.0 } else { 3.5 };
    tiny.quad(
        [v(-4.0, -4.0, -4.0), v(4.0, -4.0, -4.0), v(4.0, size, -4.0), v(-4.0, size, -4.0)]
            .map(|p| at(p.x, p.y, p.z)),
        &floor,
    );
    let glass = Material { kt: [0.9, 0.8, 0.7], ks: [0.5; 3], fresnel: true, ..BLACK };
    tiny.sphere(at(0.5, 1.0, 0.5), 0.75 * factor, &glass);
    for (x, shading) in [(-1.5, Shading::Gouraud), (1.75, Shading::Phong), (0.0, Shading::Flat)] {
        let mut ball = icosphere(1, DVec3::ZERO, 0.75);
        for point in &mut ball.positions {
            let rounded = point.map(|c| (f64::from(c) * 16.0).round() / 16.0);
            *point = at(rounded[0] + x, rounded[1], rounded[2] - 1.0).to_array().map(|c| c as f32);
        }
        let matt = tiny.builder.material(Material { kd: [0.3, 0.8, 0.4], ks: [0.4; 3], ..BLACK });
        tiny.builder.mesh(ball, &DAffine3::IDENTITY, matt, shading).unwrap();
    }
    let direction = v(-0.36, -0.8, -0.48);
    let spot = LightShape::Spot { position: at(3.0, 6.0, 3.5), direction, cos_inner: 0.97, cos_outer: 0.8 };
    // The same strength at points whose distances are `factor` times as large.
    let falloff = Some([0.5, 0.0625 / factor, 0.015625 / (factor * factor)]);
    tiny.light(&Light { falloff, ..shining(spot) });
    tiny.light(&Light { ambient: [0.1; 3], ..point_light(at(-3.0, 5.0, 5.0)) });
    tiny.light(&shining(LightShape::Directional { direction: v(0.0, -0.6, -0.8) }));
    tiny.header.background = [0.1, 0.2, 0.3];
    tiny.render()
}

#[test]
fn a_scaled_scene_gives_the_same_bytes() {
    for orthographic in [false, true] {
        let plain = still_life(1.0, DVec3::ZERO, orthographic, false);
        let different = plain.pixels.iter().filter(|pixel| **pixel != plain.pixels[0]).count();
        assert!(different > 200, "only {different} pixels show something");
        for exponent in [-20, -1, 20] {
            let factor = libm::exp2(f64::from(exponent));
            assert_eq!(still_life(factor, DVec3::ZERO, orthographic, false), plain, "2^{exponent}");
        }
    }
}

#[test]
fn a_scene_moved_far_away_gives_the_same_bytes() {
    let shift = v(1e6, -1e6, 524_288.0);
    for orthographic in [false, true] {
        // Its centre goes back to 0, so that what is traced is the very same.
        let plain = still_life(1.0, DVec3::ZERO, orthographic, true);
        assert_eq!(still_life(1.0, shift, orthographic, true), plain);
        // Here the centre isn't 0: points are the same but for a shift, and f64 rounding differs.
        let plain = still_life(1.0, DVec3::ZERO, orthographic, false);
        let moved = still_life(1.0, shift, orthographic, false);
        for (a, b) in plain.pixels.iter().flatten().zip(moved.pixels.iter().flatten()) {
            assert!((a - b).abs() <= 1e-6, "{a} {b}");
        }
    }
}

#[test]
fn lights_fall_off_in_world_units_wherever_the_scene_is() {
    let (lamp, eye, hit) = (v(-1.0, 2.25, -1.5), v(1.5, 2.5, 3.0), v(0.25, 0.0, -0.125));
    let white = Material { kd: [0.9; 3], ks: [0.5; 3], ..BLACK };
    for factor in [1.0 / 64.0, 1.0, 64.0] {
        for shift in [DVec3::ZERO, v(1e6, 2e6, -1e6)] {
            for shading in [Shading::Flat, Shading::Gouraud] {
                let place = |p: DVec3| p * factor + shift;
                let mut tiny = Tiny::new(place(eye), place(hit));
                tiny.mesh(quad(square(0.0, 1600.0).map(|p| p + shift)), &white, shading);
                let shape = LightShape::Spot {
                    position: place(lamp),
                    direction: DVec3::NEG_Y,
                    cos_inner: 0.6,
                    cos_outer: -1.0,
                };
                let light = Light { falloff: Some([0.25, 0.5, 0.125]), ..shining(shape) };
                tiny.light(&light);
                if shading == Shading::Gouraud {
                    // Nothing but the place of the vertices counts: compared with the scene at the origin below.
                    let mut plain = Tiny::new(eye * factor, hit * factor);
                    plain.mesh(quad(square(0.0, 1600.0)), &white, shading);
                    let position = lamp * factor;
                    let shape = LightShape::Spot {
                        position,
                        direction: DVec3::NEG_Y,
                        cos_inner: 0.6,
                        cos_outer: -1.0,
                    };
                    plain.light(&Light { falloff: light.falloff, ..shining(shape) });
                    assert_color(tiny.color(), plain.color());
                    continue;
                }
                let distance = (lamp - hit).length() * factor;
                let around = Around::new(hit, DVec3::Y, lamp, eye);
                assert!(around.to_light.y > 0.6);
                let weaker = 1.0 / (0.25 + 0.5 * distance + 0.125 * distance * distance);
                assert_color(tiny.color(), scaled(around.phong(&white, &light), weaker));
            }
        }
    }
}
