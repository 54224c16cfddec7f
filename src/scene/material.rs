//! Materials: the coefficients of local illumination, reflection and refraction, and surfaces known by their physics.

use super::Color;
use serde::{Deserialize, Serialize};

/// How a surface answers light: local + kr * reflected + kt * refracted, or, where `reflectivity` r is
/// given, (1 - r) * local + r * reflected. `local` is Phong's illumination (Phong 1975) plus `emission`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Ambient coefficient.
    pub ka: Color,
    /// Diffuse coefficient.
    pub kd: Color,
    /// Specular coefficient of lights.
    pub ks: Color,
    /// Phong's exponent, >= 0.
    pub shininess: f64,
    /// Weight of the mirror ray.
    pub kr: Color,
    /// Weight of the refracted ray; also what a shadow ray is multiplied by.
    pub kt: Color,
    /// Index of refraction inside, > 0 (outside is 1).
    pub ior: f64,
    /// The Sh tracer's blend r in [0, 1]; 0 where `kr` is used.
    pub reflectivity: f64,
    /// Radiance added to what is reflected.
    pub emission: Color,
    /// Emission only on the side that the geometric normal points to.
    pub one_sided: bool,
    /// Split kt between reflection and refraction by Fresnel's equations.
    pub fresnel: bool,
    /// Index of the texture that multiplies kd and ka.
    pub texture: Option<u32>,
    /// What the path integrator uses in place of the coefficients above, but for `ior` and `emission`.
    pub physical: Option<Physical>,
}

/// A surface by its physics. Roughness is in [0, 1]; its square is the α of microfacets (GGX), and below [`SMOOTH`] it is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Physical {
    /// A metal in vacuum; `eta` + i `k` is its complex index of refraction for each channel.
    Conductor { eta: Color, k: Color, roughness: f64 },
    /// Glass, water: what isn't reflected is refracted, by [`Material::ior`].
    Dielectric { roughness: f64 },
}

/// A surface of less roughness than this is as good as smooth, and narrower than f64 can tell of half vectors.
pub const SMOOTH: f64 = 1e-3;

impl Default for Material {
    /// Matt light grey.
    fn default() -> Self {
        Material {
            ka: [0.7; 3],
            kd: [0.7; 3],
            ks: [0.0; 3],
            shininess: 32.0,
            kr: [0.0; 3],
            kt: [0.0; 3],
            ior: 1.5,
            reflectivity: 0.0,
            emission: [0.0; 3],
            one_sided: false,
            fresnel: false,
            texture: None,
            physical: None,
        }
    }
}

impl Material {
    /// Whether it does nothing but reflect light evenly in all directions.
    #[inline]
    pub fn is_matt(&self) -> bool {
        let is_black = |color: &Color| color[0] == 0.0 && color[1] == 0.0 && color[2] == 0.0;
        self.physical.is_none()
            && [&self.ks, &self.kr, &self.kt, &self.emission].into_iter().all(is_black)
            && self.reflectivity == 0.0
    }

    /// Radiance that it sends to a side: that which its geometric normal points to, or the other.
    #[inline]
    pub fn emitted(&self, outside: bool) -> Color {
        if outside || !self.one_sided { self.emission } else { [0.0; 3] }
    }

    /// Whether light passes through, so that a shadow ray has to go on.
    pub fn is_transparent(&self) -> bool {
        self.kt != [0.0; 3]
    }
}

impl From<Physical> for Material {
    /// The coefficients that come closest to the surface, for the Whitted integrator: a smooth conductor is a mirror of its
    /// normal reflectance, a rough one has highlights of that colour whose width is that of its microfacets; a dielectric refracts
    /// and reflects by Fresnel's equations, whatever its roughness.
    fn from(physical: Physical) -> Self {
        let mut material =
            Material { ka: [0.0; 3], kd: [0.0; 3], physical: Some(physical), ..Material::default() };
        match physical {
            Physical::Conductor { eta, k, roughness } => {
                let reflectance = std::array::from_fn(|c| {
                    let (less, more, k2) = (eta[c] - 1.0, eta[c] + 1.0, k[c] * k[c]);
                    (less * less + k2) / (more * more + k2)
                });
                if roughness < SMOOTH {
                    material.kr = reflectance;
                } else {
                    let alpha = roughness * roughness;
                    material.ks = reflectance;
                    material.shininess = 2.0 / (alpha * alpha) - 2.0;
                }
            }
            Physical::Dielectric { .. } => {
                material.kt = [1.0; 3];
                material.fresnel = true;
            }
        }
        material
    }
}
