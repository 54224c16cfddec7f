//! How a surface scatters light: what the path integrator evaluates and samples. Pure functions of directions and uniform numbers;
//! knows no scene, ray or random sequence.
//!
//! Directions are unit vectors in the local frame of a hit: z is the shading normal on the side the ray came from, `wo` points to
//! the viewer, `wi` to where light comes from. A `wo` below the frame (which interpolated normals can bring about) scatters
//! nothing but straight through: use the geometric normal's frame there. Whether `wi` is on its side of the geometric normal is
//! for the caller to check.

mod classic;
mod compensation;
mod conductor;
mod dielectric;
pub(super) mod diffuse;
mod fresnel;
mod microfacet;
mod phong;
mod specular;

use glam::DVec3;

use self::classic::Classic;
use self::conductor::{Metal, RoughConductor};
use self::dielectric::RoughDielectric;
use self::microfacet::Ggx;
use super::{BLACK, is_black, scaled, times};
use crate::scene::material::{Material, Physical};
use crate::scene::{Color, mean};

/// The lobes of one hit.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf(Lobes);

#[derive(Clone, Copy, Debug)]
enum Lobes {
    Black,
    /// The albedo. Most of what is hit is of this kind, so it has a way of its own.
    Diffuse(Color),
    Classic(Classic),
    Mirror(Metal),
    RoughConductor(RoughConductor),
    /// The index on the viewer's side over the one behind.
    Boundary(f64),
    RoughDielectric(RoughDielectric),
}

/// A sampled direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scattered {
    pub wi: DVec3,
    /// f · |cos θi| / pdf of all lobes that could have made it; of a delta lobe its weight over its chance.
    pub weight: Color,
    /// Per solid angle, infinite of a delta lobe.
    pub pdf: f64,
    /// Whether `wi` is behind the surface.
    pub transmitted: bool,
}

impl Bsdf {
    /// The lobes of a material. `diffuse_tint` multiplies kd; `entering` tells that the viewer is outside.
    #[inline]
    pub fn new(material: &Material, diffuse_tint: Color, entering: bool) -> Self {
        if let Some(physical) = &material.physical {
            return Bsdf(Lobes::physical(physical, material.ior, entering));
        }
        let Material { ks, kr, kt, reflectivity, .. } = material;
        if is_black(*ks) && is_black(*kr) && is_black(*kt) && *reflectivity == 0.0 {
            let albedo = times(material.kd, diffuse_tint);
            return Bsdf(if is_black(albedo) { Lobes::Black } else { Lobes::Diffuse(albedo) });
        }
        Bsdf(Lobes::Classic(Classic::new(material, diffuse_tint, entering)))
    }

    /// Whether light from a given direction can be asked for: some lobe isn't a delta.
    #[inline]
    pub fn is_smooth(&self) -> bool {
        match &self.0 {
            Lobes::Diffuse(_) | Lobes::RoughConductor(_) | Lobes::RoughDielectric(_) => true,
            Lobes::Black | Lobes::Mirror(_) | Lobes::Boundary(_) => false,
            Lobes::Classic(lobes) => lobes.is_smooth(),
        }
    }

    /// f(wo, wi) · |cos θi| of the smooth lobes, and the density per solid angle with which [`sample`](Bsdf::sample) makes
    /// `wi` by them. A delta lobe counts nothing, but the chance of not choosing it is in the density.
    #[inline]
    pub fn evaluate(&self, wo: DVec3, wi: DVec3) -> (Color, f64) {
        match &self.0 {
            Lobes::Diffuse(albedo) => {
                if wo.z <= 0.0 || wi.z <= 0.0 {
                    return (BLACK, 0.0);
                }
                let pdf = diffuse::pdf(wi.z);
                (scaled(*albedo, pdf), pdf)
            }
            Lobes::Classic(lobes) => lobes.evaluate(wo, wi),
            Lobes::Black | Lobes::Mirror(_) | Lobes::Boundary(_) => (BLACK, 0.0),
            Lobes::RoughConductor(lobes) => lobes.evaluate(wo, wi),
            Lobes::RoughDielectric(lobes) => lobes.evaluate(wo, wi),
        }
    }

    /// A direction that light comes from, by three numbers in [0, 1), the first of which chooses the lobe. `None` where nothing is
    /// scattered.
    #[inline]
    pub fn sample(&self, wo: DVec3, u: [f64; 3]) -> Option<Scattered> {
        match &self.0 {
            Lobes::Diffuse(albedo) => {
                if wo.z <= 0.0 {
                    return None;
                }
                let wi = diffuse::sample([u[1], u[2]]);
                let pdf = diffuse::pdf(wi.z);
                (pdf > 0.0).then_some(Scattered { wi, weight: *albedo, pdf, transmitted: false })
            }
            Lobes::Classic(lobes) => lobes.sample(wo, u),
            Lobes::Black => None,
            Lobes::Mirror(metal) => metal.mirror(wo),
            Lobes::RoughConductor(lobes) => lobes.sample(wo, u),
            Lobes::Boundary(eta) => dielectric::smooth(wo, *eta, u[0]),
            Lobes::RoughDielectric(lobes) => lobes.sample(wo, u),
        }
    }
}

impl Lobes {
    fn physical(physical: &Physical, ior: f64, entering: bool) -> Self {
        match *physical {
            Physical::Conductor { eta, k, roughness } => {
                let metal = Metal { eta, k };
                match Ggx::new(roughness) {
                    Some(ggx) => Lobes::RoughConductor(RoughConductor::new(metal, ggx, roughness)),
                    None => Lobes::Mirror(metal),
                }
            }
            Physical::Dielectric { roughness } => {
                let eta = if entering { 1.0 / ior } else { ior };
                match Ggx::new(roughness) {
                    Some(ggx) if eta != 1.0 => Lobes::RoughDielectric(RoughDielectric { ggx, eta }),
                    _ => Lobes::Boundary(eta),
                }
            }
        }
    }
}

impl Scattered {
    fn smooth(wi: DVec3, value: Color, pdf: f64) -> Option<Self> {
        let weight = [value[0] / pdf, value[1] / pdf, value[2] / pdf];
        (pdf > 0.0 && !is_black(weight)).then_some(Scattered { wi, weight, pdf, transmitted: wi.z < 0.0 })
    }

    fn delta(wi: DVec3, weight: Color, transmitted: bool) -> Self {
        Scattered { wi, weight, pdf: f64::INFINITY, transmitted }
    }
}

#[cfg(test)]
mod tests;
