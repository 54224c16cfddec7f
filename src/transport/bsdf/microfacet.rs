//! Trowbridge and Reitz's distribution of microfacets (GGX), isotropic, with Smith's shadowing. Its visible normals are sampled by
//! spherical caps: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023, after Heitz 2018.
//!
//! With σ(w) = √(z² + α² (x² + y²)) Smith's terms need no tangent and no division by a cosine that may be 0:
//! G1(w) = 2|z| / (|z| + σ), and of both sides together, with heights correlated (Heitz 2014), G2 = 2 zo zi / (zi σo + zo σi).

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::scene::material::SMOOTH;

#[derive(Clone, Copy, Debug)]
pub struct Ggx {
    alpha: f64,
}

impl Ggx {
    /// α is the square of the roughness (Burley 2012). `None` where it is as good as smooth.
    pub fn new(roughness: f64) -> Option<Self> {
        (roughness >= SMOOTH).then_some(Ggx { alpha: roughness * roughness })
    }

    /// Microfacets per area and solid angle around the unit normal `m`.
    pub fn density(&self, m: DVec3) -> f64 {
        let (x, y) = (m.x / self.alpha, m.y / self.alpha);
        let stretched = x * x + y * y + m.z * m.z;
        1.0 / (PI * self.alpha * self.alpha * stretched * stretched)
    }

    fn sigma(&self, w: DVec3) -> f64 {
        (w.z * w.z + self.alpha * self.alpha * (w.x * w.x + w.y * w.y)).sqrt()
    }

    /// The part of the microfacets facing `w`, on either side, that is seen from there.
    pub fn seen(&self, w: DVec3) -> f64 {
        let z = w.z.abs();
        2.0 * z / (z + self.sigma(w))
    }

    /// Density of [`sample`](Ggx::sample) over that of the microfacets and the cosine of `wo` with the normal.
    pub fn visibility(&self, wo: DVec3) -> f64 {
        2.0 / (wo.z + self.sigma(wo))
    }

    /// G2 / (4 zo zi): what a reflection on the upper side has beside Fresnel's factor and the density.
    pub fn reflection(&self, wo: DVec3, wi: DVec3) -> f64 {
        0.5 / (wi.z * self.sigma(wo) + wo.z * self.sigma(wi))
    }

    /// G2 / G1: what a reflection by a visible microfacet weighs, but for Fresnel's factor.
    pub fn passed(&self, wo: DVec3, wi: DVec3) -> f64 {
        let sigma = self.sigma(wo);
        wi.z * (wo.z + sigma) / (wi.z * sigma + wo.z * self.sigma(wi))
    }

    /// The normal of a microfacet that is visible from `wo`, from two numbers in [0, 1).
    pub fn sample(&self, wo: DVec3, u: [f64; 2]) -> DVec3 {
        let alpha = self.alpha;
        let unit = DVec3::new(alpha * wo.x, alpha * wo.y, wo.z).normalize();
        let z = (1.0 - u[0]) * (1.0 + unit.z) - unit.z;
        let across = (1.0 - z * z).max(0.0).sqrt();
        let (sine, cosine) = libm::sincos(TAU * u[1]);
        let half = unit + DVec3::new(across * cosine, across * sine, z);
        DVec3::new(alpha * half.x, alpha * half.y, half.z).normalize()
    }
}
