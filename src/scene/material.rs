//! Materials: the coefficients of local illumination, reflection and refraction.

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
}

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
        }
    }
}

impl Material {
    /// Whether light passes through, so that a shadow ray has to go on.
    pub fn is_transparent(&self) -> bool {
        self.kt != [0.0; 3]
    }
}
