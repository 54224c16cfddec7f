//! The f64 point of a hit: where shading happens and where the rays that go on from it start.
//!
//! It is computed from the surface, not along the ray: the farther a ray's origin, the farther off its end would be.

use glam::DVec3;

/// The weights of a triangle's three vertices, from those of its second and third.
#[inline(always)]
pub fn weights(u: f64, v: f64) -> [f64; 3] {
    [(1.0 - u) - v, u, v]
}

/// The point of a triangle that these weights name. [`Start`](super::start::Start) bounds how far it may lie off the true plane.
#[inline(always)]
pub fn on_triangle(corners: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    (corners[0] * weights[0] + corners[1] * weights[1]) + corners[2] * weights[2]
}

/// The point of a sphere nearest to `hit`, and the unit vector from the centre to it.
#[inline]
pub fn on_sphere(center: DVec3, radius: f64, hit: DVec3) -> (DVec3, DVec3) {
    let outward = (hit - center).normalize();
    (center + outward * radius, outward)
}
