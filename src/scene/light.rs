//! Lights without extent: point, directional and spot.

use super::Color;
use glam::DVec3;
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Light {
    pub shape: LightShape,
    /// Id of Phong's diffuse term.
    pub diffuse: Color,
    /// Is of Phong's specular term.
    pub specular: Color,
    /// Added to the scene's ambient light, never shadowed.
    pub ambient: Color,
    /// `[c, l, q]`: the light is divided by c + l d + q d^2, d the distance in world units.
    pub falloff: Option<[f64; 3]>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum LightShape {
    Point {
        position: DVec3,
    },
    /// Shines along the unit vector `direction` from infinitely far.
    Directional {
        direction: DVec3,
    },
    /// Shines from `position` around the unit vector `direction`: whole where the angle's cosine is at least
    /// `cos_inner`, nothing below `cos_outer`, smoothstep between.
    Spot {
        position: DVec3,
        direction: DVec3,
        cos_inner: f64,
        cos_outer: f64,
    },
}

/// What one light sends to one point.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// From the point to the light, not normalised: the light is at `t = 1`, or infinitely far.
    pub to_light: DVec3,
    /// Where the shadow ray along `to_light` ends: 1 or infinity.
    pub t_max: f64,
    /// Falloff times spot cone.
    pub strength: f64,
}

impl Light {
    /// What arrives at `point` (stored space, `unit` world units for each of its units) when nothing is in the way.
    pub fn arrival(&self, point: DVec3, unit: f64) -> Arrival {
        match self.shape {
            LightShape::Directional { direction } => {
                Arrival { to_light: -direction, t_max: f64::INFINITY, strength: 1.0 }
            }
            LightShape::Point { position } => {
                let to_light = position - point;
                Arrival { to_light, t_max: 1.0, strength: self.attenuation(to_light.length() * unit) }
            }
            LightShape::Spot { position, direction, cos_inner, cos_outer } => {
                let to_light = position - point;
                let distance = to_light.length();
                let cosine = if distance > 0.0 { -to_light.dot(direction) / distance } else { 1.0 };
                let cone = if cosine >= cos_inner {
                    1.0
                } else if cosine <= cos_outer {
                    0.0
                } else {
                    let x = (cosine - cos_outer) / (cos_inner - cos_outer);
                    x * x * (3.0 - 2.0 * x)
                };
                Arrival { to_light, t_max: 1.0, strength: cone * self.attenuation(distance * unit) }
            }
        }
    }

    fn attenuation(&self, distance: f64) -> f64 {
        match self.falloff {
            None => 1.0,
            Some([c, l, q]) => 1.0 / (c + l * distance + q * distance * distance),
        }
    }
}
