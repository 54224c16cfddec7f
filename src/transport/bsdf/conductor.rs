//! Metals: Fresnel's equations with a complex index for each channel, on a mirror or on GGX microfacets. What microfacets scatter
//! more than once is a lobe of its own, so that a metal that absorbs nothing loses nothing (see [`compensation`](super::compensation)).

use std::f64::consts::FRAC_1_PI;

use glam::DVec3;

use super::compensation::Loss;
use super::microfacet::Ggx;
use super::{Scattered, fresnel, mean, specular};
use crate::scene::Color;
use crate::transport::{BLACK, add, scaled};

/// The complex index of each channel.
#[derive(Clone, Copy, Debug)]
pub struct Metal {
    pub eta: Color,
    pub k: Color,
}

impl Metal {
    fn reflectance(&self, cosine: f64) -> Color {
        std::array::from_fn(|c| fresnel::conductor(cosine.clamp(0.0, 1.0), self.eta[c], self.k[c]))
    }

    /// A smooth surface of it.
    pub fn mirror(&self, wo: DVec3) -> Option<Scattered> {
        (wo.z > 0.0).then(|| Scattered::delta(specular::mirrored(wo), self.reflectance(wo.z), false))
    }
}

#[derive(Clone, Copy, Debug)]
pub struct RoughConductor {
    metal: Metal,
    ggx: Ggx,
    loss: Loss,
    /// Mean over channels and directions of what a microfacet reflects.
    reflected: f64,
    /// What becomes of the light that the single-scattering lobe loses, and its mean over channels.
    returned: Color,
    returned_mean: f64,
}

impl RoughConductor {
    pub fn new(metal: Metal, ggx: Ggx, roughness: f64) -> Self {
        let loss = Loss::new(roughness);
        let reflectance: Color = std::array::from_fn(|c| fresnel::conductor_mean(metal.eta[c], metal.k[c]));
        // Reflected once without leaving, it leaves after the 2nd, 3rd, ... reflection: a geometric series.
        let returned = reflectance.map(|f| f * f * (1.0 - loss.mean) / (1.0 - f * loss.mean));
        RoughConductor {
            metal,
            ggx,
            loss,
            reflected: mean(reflectance),
            returned,
            returned_mean: mean(returned),
        }
    }

    /// The chance of the lobe of multiple scattering, seen from where `loss` is lost.
    fn multiple_chance(&self, loss: f64) -> f64 {
        let multiple = self.returned_mean * loss;
        let single = self.reflected * (1.0 - loss);
        if multiple > 0.0 { multiple / (multiple + single) } else { 0.0 }
    }

    pub fn evaluate(&self, wo: DVec3, wi: DVec3) -> (Color, f64) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (BLACK, 0.0);
        }
        self.both(wo, wi, self.loss.at(wo.z))
    }

    fn both(&self, wo: DVec3, wi: DVec3, loss: f64) -> (Color, f64) {
        let m = (wo + wi).normalize();
        let density = self.ggx.density(m);
        let single = density * self.ggx.reflection(wo, wi) * wi.z;
        let mut value = scaled(self.metal.reflectance(wo.dot(m)), single);
        let mut pdf = 0.25 * density * self.ggx.visibility(wo);
        let chance = self.multiple_chance(loss);
        if chance > 0.0 {
            let multiple = loss * self.loss.at(wi.z) / self.loss.mean * (wi.z * FRAC_1_PI);
            value = add(value, scaled(self.returned, multiple));
            pdf = (1.0 - chance) * pdf + chance * self.loss.pdf(wi.z);
        }
        (value, pdf)
    }

    pub fn sample(&self, wo: DVec3, u: [f64; 3]) -> Option<Scattered> {
        if wo.z <= 0.0 {
            return None;
        }
        let loss = self.loss.at(wo.z);
        let wi = if u[0] < self.multiple_chance(loss) {
            self.loss.sample([u[1], u[2]])
        } else {
            specular::mirrored_by(wo, self.ggx.sample(wo, [u[1], u[2]]))
        };
        if wi.z <= 0.0 {
            return None;
        }
        let (value, pdf) = self.both(wo, wi, loss);
        Scattered::smooth(wi, value, pdf)
    }
}
