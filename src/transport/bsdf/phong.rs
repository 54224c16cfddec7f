//! The normalised Phong lobe: (n + 2) / 2π · cosⁿα about the mirror direction, times ks. Lafortune and Willems, "Using the
//! Modified Phong Reflectance Model for Physically Based Rendering", 1994. Reciprocal; a ks of 1 gives back all light at
//! normal incidence and less towards grazing, where the lobe dips below the surface.

use std::f64::consts::TAU;

use glam::DVec3;

use super::specular;

/// The lobe without its ks, and the solid-angle density of [`sample`].
pub fn evaluate(wo: DVec3, wi: DVec3, exponent: f64) -> (f64, f64) {
    let cosine = specular::mirrored(wo).dot(wi).min(1.0);
    if cosine <= 0.0 {
        return (0.0, 0.0);
    }
    let lobe = libm::pow(cosine, exponent) / TAU;
    ((exponent + 2.0) * lobe, (exponent + 1.0) * lobe)
}

/// A direction with density (n + 1) / 2π · cosⁿα, from two numbers in [0, 1). It may lie below the surface.
pub fn sample(wo: DVec3, u: [f64; 2], exponent: f64) -> DVec3 {
    let cosine = libm::pow(1.0 - u[0], 1.0 / (exponent + 1.0));
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (sin_phi, cos_phi) = libm::sincos(TAU * u[1]);
    let axis = specular::mirrored(wo);
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    (tangent * (sine * cos_phi) + bitangent * (sine * sin_phi) + axis * cosine).normalize()
}
