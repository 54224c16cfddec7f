//! Lambert's lobe: albedo / π, whatever the directions. Sampled by the cosine.

use std::f64::consts::{FRAC_1_PI, FRAC_PI_4};

use glam::DVec3;

/// Solid-angle density of [`sample`], for `cosine` >= 0 with the normal.
#[inline]
pub fn pdf(cosine: f64) -> f64 {
    cosine * FRAC_1_PI
}

/// A direction about +z with density cosine / π, from two numbers in [0, 1): Malley's method, a disc lifted to the hemisphere.
#[inline]
pub fn sample(u: [f64; 2]) -> DVec3 {
    let [x, y] = concentric_disc(u);
    DVec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// A point of the unit disc, uniform in area, that keeps neighbours neighbours: Shirley and Chiu, "A Low Distortion Map Between
/// Disk and Square", 1997.
#[inline]
pub fn concentric_disc(u: [f64; 2]) -> [f64; 2] {
    let [a, b] = u.map(|u| 2.0 * u - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0, 0.0];
    }
    if a.abs() > b.abs() {
        let (sine, cosine) = libm::sincos(FRAC_PI_4 * (b / a));
        [a * cosine, a * sine]
    } else {
        let (sine, cosine) = libm::sincos(FRAC_PI_4 * (a / b));
        [b * sine, b * cosine]
    }
}
