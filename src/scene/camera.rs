//! Cameras: perspective and orthographic.

use glam::DVec3;
use serde::{Deserialize, Serialize};

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
        Some(Camera { position, forward, right: right * half_height, up: up * half_height, projection })
    }

    /// Origin and unit direction of the ray through film point (x, y) in pixels from the upper left corner of an image of
    /// width * height pixels.
    #[inline]
    pub fn ray(&self, x: f64, y: f64, width: f64, height: f64) -> (DVec3, DVec3) {
        let right = self.right * ((2.0 * x - width) / height);
        let up = self.up * ((height - 2.0 * y) / height);
        match self.projection {
            Projection::Perspective => (self.position, (self.forward + (right + up)).normalize()),
            Projection::Orthographic => (self.position + (right + up), self.forward),
        }
    }
}
