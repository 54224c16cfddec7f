//! The sky of scenes/environment.toml: a formula, so that the image needs no source.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use heliostat::output::read;

use super::stage::picture;
use crate::common::repository;

const SIZE: [u32; 2] = [64, 32];

fn texel(x: u32, y: u32) -> [f32; 3] {
    let (sin_around, cos_around) = libm::sincos((f64::from(x) + 0.5) / f64::from(SIZE[0]) * TAU);
    let (sin_down, cos_down) = libm::sincos((f64::from(y) + 0.5) / f64::from(SIZE[1]) * PI);
    let direction = DVec3::new(sin_down * sin_around, cos_down, sin_down * cos_around);
    if direction.y < 0.0 {
        return [0.2, 0.19, 0.17];
    }
    let sun = DVec3::new(0.35, 0.55, 0.6).normalize();
    let near = direction.dot(sun).max(0.0);
    let up = direction.y.sqrt();
    let sky = DVec3::new(0.85, 0.9, 0.95) * (1.0 - up) + DVec3::new(0.16, 0.3, 0.68) * up;
    let glow = DVec3::new(2.2, 1.6, 0.9) * libm::pow(near, 40.0);
    // Two texels or so: three degrees and a half around it.
    let disc = if near > 0.998 { DVec3::new(230.0, 205.0, 165.0) } else { DVec3::ZERO };
    (sky + glow + disc).to_array().map(|c| c as f32)
}

/// `HELIOSTAT_BLESS=1 cargo test sky` writes it anew.
#[test]
fn the_sky_is_its_formula() {
    let path = repository().join("scenes/sky.exr");
    if std::env::var_os("HELIOSTAT_BLESS").is_some() {
        std::fs::write(&path, picture(SIZE[0], SIZE[1], texel)).unwrap();
    }
    let image = read::read(&path).unwrap();
    assert_eq!([image.width, image.height], SIZE);
    let expected = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| texel(x, y)));
    assert!(image.pixels.iter().copied().eq(expected), "{} isn't its formula's", path.display());
    assert!(image.pixels.iter().any(|texel| texel[0] > 200.0), "the sun has set");
}
