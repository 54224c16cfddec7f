//! The classic coefficients as lobes: kd as Lambert's, ks and its exponent as Phong's normalised one, kr as a mirror, kt as smooth
//! refraction. What is reflected and refracted has the weights of the Whitted integrator.

use glam::DVec3;

use super::{Scattered, diffuse, fresnel, mean, phong, specular};
use crate::scene::{Color, Material};
use crate::transport::{BLACK, add, is_black, scaled, times};

#[derive(Clone, Copy, Debug)]
pub struct Classic {
    kd: Color,
    ks: Color,
    shininess: f64,
    kr: Color,
    kt: Color,
    /// Index on the viewer's side over the one behind.
    eta: f64,
    /// Whether kt is split by Fresnel's equations.
    fresnel: bool,
    /// The chance of each lobe; what is left is that of mirror and refraction together, which share it by Fresnel's equations.
    diffuse_chance: f64,
    phong_chance: f64,
    delta_chance: f64,
}

impl Classic {
    pub fn new(material: &Material, diffuse_tint: Color, entering: bool) -> Self {
        let r = material.reflectivity;
        let kd = scaled(times(material.kd, diffuse_tint), 1.0 - r);
        let ks = scaled(material.ks, 1.0 - r);
        let kr = add(material.kr, [r; 3]);
        let kt = material.kt;
        let weights = [mean(kd), mean(ks), mean(kr) + mean(kt)];
        let total = weights[0] + weights[1] + weights[2];
        let [diffuse_chance, phong_chance, delta_chance] =
            if total > 0.0 { weights.map(|weight| weight / total) } else { [0.0; 3] };
        Classic {
            kd,
            ks,
            shininess: material.shininess,
            kr,
            kt,
            eta: if entering { 1.0 / material.ior } else { material.ior },
            fresnel: material.fresnel,
            diffuse_chance,
            phong_chance,
            delta_chance,
        }
    }

    pub fn is_smooth(&self) -> bool {
        self.diffuse_chance > 0.0 || self.phong_chance > 0.0
    }

    pub fn evaluate(&self, wo: DVec3, wi: DVec3) -> (Color, f64) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (BLACK, 0.0);
        }
        let pdf = diffuse::pdf(wi.z);
        let mut value = scaled(self.kd, pdf);
        let mut chance = self.diffuse_chance * pdf;
        if self.phong_chance > 0.0 {
            let (lobe, pdf) = phong::evaluate(wo, wi, self.shininess);
            value = add(value, scaled(self.ks, lobe * wi.z));
            chance += self.phong_chance * pdf;
        }
        (value, chance)
    }

    pub fn sample(&self, wo: DVec3, u: [f64; 3]) -> Option<Scattered> {
        let smooth_chance = self.diffuse_chance + self.phong_chance;
        if u[0] >= smooth_chance && self.delta_chance > 0.0 {
            // Rounding may carry the quotient to 1.
            return self.sample_delta(wo, (u[0] - smooth_chance) / self.delta_chance);
        }
        if smooth_chance == 0.0 || wo.z <= 0.0 {
            return None;
        }
        let wi = if u[0] < self.diffuse_chance || self.phong_chance == 0.0 {
            diffuse::sample([u[1], u[2]])
        } else {
            phong::sample(wo, [u[1], u[2]], self.shininess)
        };
        let (value, pdf) = self.evaluate(wo, wi);
        Scattered::smooth(wi, value, pdf)
    }

    /// The mirror or the refracted ray; `u` in [0, 1] decides.
    fn sample_delta(&self, wo: DVec3, u: f64) -> Option<Scattered> {
        let (mut mirror, mut through, mut onward) = (self.kr, self.kt, -wo);
        // One index on both sides: nothing bends or turns back, whatever the normal says.
        if !is_black(self.kt) && self.eta != 1.0 {
            if wo.z <= 0.0 {
                return None;
            }
            match fresnel::dielectric(wo.z.min(1.0), self.eta) {
                Some(boundary) => {
                    let back = if self.fresnel { boundary.reflectance } else { 0.0 };
                    mirror = add(self.kr, scaled(self.kt, back));
                    through = scaled(self.kt, 1.0 - back);
                    onward = specular::refracted(wo, self.eta, boundary.behind);
                }
                None => (mirror, through) = (add(self.kr, self.kt), BLACK),
            }
        }
        let (mirror_weight, through_weight) = (mean(mirror), mean(through));
        let mirror_share = mirror_weight / (mirror_weight + through_weight);
        if u < mirror_share || through_weight == 0.0 {
            let chance = self.delta_chance * mirror_share;
            return (wo.z > 0.0)
                .then(|| Scattered::delta(specular::mirrored(wo), mirror.map(|c| c / chance), false));
        }
        let chance = self.delta_chance * (1.0 - mirror_share);
        Some(Scattered::delta(onward, through.map(|c| c / chance), true))
    }
}
