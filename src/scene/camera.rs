//! Cameras: perspective, with or without a lens, and orthographic.

use std::f64::consts::FRAC_PI_4;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::geometry::angle::sincos_of_eighth;

/// A camera as four vectors. Film coordinates run over [-1, 1] from bottom to top, and over
/// [-aspect, aspect] from left to right.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub position: DVec3,
    /// Unit viewing direction.
    pub forward: DVec3,
    /// From the film's centre to the middle of its right edge, for an aspect ratio of 1.
    pub right: DVec3,
    /// From the film's centre to the middle of its upper edge.
    pub up: DVec3,
    pub projection: Projection,
    /// Of a perspective camera with a thin lens; `None` is a pinhole.
    pub lens: Option<Lens>,
}

/// A thin lens: what lies in one plane is sharp (Cook, Porter and Carpenter 1984, "Distributed Ray Tracing").
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// > 0.
    pub radius: f64,
    /// Of the sharp plane from the camera along `forward`, > 0.
    pub focus: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Projection {
    /// `right` and `up` span the film at distance 1.
    Perspective,
    /// `right` and `up` span the film through `position`.
    Orthographic,
}

impl Default for Camera {
    /// At the origin, looking along -z, 45 degrees high.
    fn default() -> Self {
        Camera::perspective(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, 45.0).expect("constant camera")
    }
}

impl Camera {
    /// `fov` is the vertical field of view in degrees, in (0, 180). `None` if the view direction is zero or
    /// parallel to `up`, or a number isn't finite.
    pub fn perspective(position: DVec3, look_at: DVec3, up: DVec3, fov: f64) -> Option<Self> {
        let half_height = libm::tan(fov.to_radians() * 0.5);
        Camera::aim(position, look_at, up, half_height, Projection::Perspective)
    }

    /// `height` is that of the film in world units, > 0. `None` as in [`Camera::perspective`].
    pub fn orthographic(position: DVec3, look_at: DVec3, up: DVec3, height: f64) -> Option<Self> {
        Camera::aim(position, look_at, up, height * 0.5, Projection::Orthographic)
    }

    fn aim(
        position: DVec3,
        look_at: DVec3,
        up: DVec3,
        half_height: f64,
        projection: Projection,
    ) -> Option<Self> {
        let forward = (look_at - position).try_normalize()?;
        let right = forward.cross(up.try_normalize()?);
        let sound = position.is_finite() && half_height > 0.0 && half_height.is_finite();
        if !sound || right.length() < 1e-9 {
            return None;
        }
        let right = right.normalize();
        let up = right.cross(forward);
        Some(Camera {
            position,
            forward,
            right: right * half_height,
            up: up * half_height,
            projection,
            lens: None,
        })
    }

    /// Origin and unit direction of the ray through film point (x, y) in pixels from the upper left corner of an image of
    /// width * height pixels, and through the point of the lens, if there is one, that two numbers in [0, 1) choose: (1/2, 1/2) is its centre.
    #[inline(always)]
    pub fn ray(&self, x: f64, y: f64, width: f64, height: f64, lens: [f64; 2]) -> (DVec3, DVec3) {
        let right = self.right * ((2.0 * x - width) / height);
        let up = self.up * ((height - 2.0 * y) / height);
        match self.projection {
            Projection::Perspective => {
                let through = self.forward + (right + up);
                match self.lens {
                    None => (self.position, through.normalize()),
                    Some(Lens { radius, focus }) => {
                        let [x, y] = concentric(lens).map(|c| c * radius);
                        let aside = self.right.normalize() * x + self.up.normalize() * y;
                        (self.position + aside, (through * focus - aside).normalize())
                    }
                }
            }
            Projection::Orthographic => (self.position + (right + up), self.forward),
        }
    }
}

/// A point of the unit disc, uniform in area, that keeps neighbours neighbours (Shirley and Chiu 1997, "A Low Distortion Map Between Disk and
/// Square"). Without a branch, for many side by side.
#[inline(always)]
pub fn concentric(u: [f64; 2]) -> [f64; 2] {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let flat = a.abs() > b.abs();
    let (radius, other) = if flat { (a, b) } else { (b, a) };
    let (sine, cosine) = sincos_of_eighth(FRAC_PI_4 * (other / if radius == 0.0 { 1.0 } else { radius }));
    let (along, across) = (radius * cosine, radius * sine);
    if flat { [along, across] } else { [across, along] }
}
