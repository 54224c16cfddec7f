//! Lambert's lobe: albedo / π, whatever the directions. Sampled by the cosine.

use std::f64::consts::FRAC_1_PI;

use glam::DVec3;

use crate::scene::camera::concentric;

/// Solid-angle density of [`sample`], for `cosine` >= 0 with the normal.
#[inline(always)]
pub fn pdf(cosine: f64) -> f64 {
    cosine * FRAC_1_PI
}

/// A direction about +z with density cosine / π, from two numbers in [0, 1): Malley's method, a disc lifted to the hemisphere.
#[inline(always)]
pub fn sample(u: [f64; 2]) -> DVec3 {
    let [x, y] = concentric(u);
    DVec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}
