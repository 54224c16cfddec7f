//! Glass and water: Fresnel's equations choose between reflection and refraction, on a smooth boundary or on GGX microfacets.
//! Walter et al., "Microfacet Models for Refraction through Rough Surfaces", 2007, with visible normals.
//!
//! Radiance is that of light on its way to the viewer: where it crosses the boundary it is spread or gathered by the square of the
//! indices, so refraction isn't symmetric. f(wo, wi) / no² = f(wi, wo) / ni².
//!
//! Microfacets scatter once here. What is lost by that is in `docs/materials.md`.

use glam::DVec3;

use super::fresnel::{self, Boundary};
use super::microfacet::Ggx;
use super::{Scattered, specular};
use crate::scene::Color;
use crate::transport::BLACK;

/// A smooth boundary; `eta` is the index on the viewer's side over the one behind, `u` in [0, 1) decides.
pub fn smooth(wo: DVec3, eta: f64, u: f64) -> Option<Scattered> {
    // One index on both sides: nothing bends or turns back, whatever the normal says.
    if eta == 1.0 {
        return Some(Scattered::delta(-wo, [1.0; 3], true));
    }
    if wo.z <= 0.0 {
        return None;
    }
    Some(match fresnel::dielectric(wo.z.min(1.0), eta) {
        Some(boundary) if u >= boundary.reflectance => {
            Scattered::delta(specular::refracted(wo, eta, boundary.behind), [eta * eta; 3], true)
        }
        _ => Scattered::delta(specular::mirrored(wo), [1.0; 3], false),
    })
}

/// A boundary of microfacets between two different indices.
#[derive(Clone, Copy, Debug)]
pub struct RoughDielectric {
    pub ggx: Ggx,
    /// The index on the viewer's side over the one behind, not 1.
    pub eta: f64,
}

impl RoughDielectric {
    pub fn evaluate(&self, wo: DVec3, wi: DVec3) -> (Color, f64) {
        if wo.z <= 0.0 || wi.z == 0.0 {
            return (BLACK, 0.0);
        }
        let (value, pdf) = if wi.z > 0.0 { self.reflection(wo, wi) } else { self.refraction(wo, wi) };
        ([value; 3], pdf)
    }

    fn reflection(&self, wo: DVec3, wi: DVec3) -> (f64, f64) {
        let m = (wo + wi).normalize();
        let reflectance = self.boundary(wo, m).map_or(1.0, |boundary| boundary.reflectance);
        let reflected = reflectance * self.ggx.density(m);
        (reflected * self.ggx.reflection(wo, wi) * wi.z, 0.25 * reflected * self.ggx.visibility(wo))
    }

    fn refraction(&self, wo: DVec3, wi: DVec3) -> (f64, f64) {
        let Some(m) = (wo * self.eta + wi).try_normalize() else { return (0.0, 0.0) };
        let m = if m.z < 0.0 { -m } else { m };
        let (before, behind) = (wo.dot(m), wi.dot(m));
        if before <= 0.0 || behind >= 0.0 {
            return (0.0, 0.0);
        }
        let Some(boundary) = self.boundary(wo, m) else { return (0.0, 0.0) };
        // Solid angle of microfacets over that of refracted directions.
        let spread = behind + self.eta * before;
        let jacobian = -behind / (spread * spread);
        let pdf =
            (1.0 - boundary.reflectance) * before * self.ggx.density(m) * self.ggx.visibility(wo) * jacobian;
        (pdf * self.ggx.seen(wi) * (self.eta * self.eta), pdf)
    }

    /// What a microfacet does; `None` where it reflects everything.
    fn boundary(&self, wo: DVec3, m: DVec3) -> Option<Boundary> {
        fresnel::dielectric(wo.dot(m).clamp(0.0, 1.0), self.eta)
    }

    pub fn sample(&self, wo: DVec3, u: [f64; 3]) -> Option<Scattered> {
        if wo.z <= 0.0 {
            return None;
        }
        let m = self.ggx.sample(wo, [u[1], u[2]]);
        let (wi, (value, pdf)) = match self.boundary(wo, m) {
            Some(boundary) if u[0] >= boundary.reflectance => {
                let along = self.eta * wo.dot(m) - boundary.behind;
                let wi = (m * along - wo * self.eta).normalize();
                (wi, if wi.z < 0.0 { self.refraction(wo, wi) } else { return None })
            }
            _ => {
                let wi = specular::mirrored_by(wo, m);
                (wi, if wi.z > 0.0 { self.reflection(wo, wi) } else { return None })
            }
        };
        Scattered::smooth(wi, [value; 3], pdf)
    }
}
