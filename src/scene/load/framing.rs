//! Camera and lights for scenes that come without: everything is seen, from a little above.

use glam::DVec3;

use crate::scene::light::LightShape;
use crate::scene::{Camera, Light};

/// Vertical field of view in degrees.
const FOV: f64 = 40.0;
/// From the middle of the scene towards the camera: three quarters to the front, slightly above.
const VIEW: DVec3 = DVec3::new(0.55, 0.4, 1.0);

/// A camera that sees the whole bounding sphere of `bounds` in an image at least as wide as high.
pub fn camera(bounds: Option<(DVec3, DVec3)>) -> Camera {
    let (low, high) = bounds.unwrap_or((DVec3::splat(-1.0), DVec3::splat(1.0)));
    let center = low * 0.5 + high * 0.5;
    // A margin of 2 %, and never so near that f64 couldn't tell the camera from what it looks at.
    let radius = (high - low).length() * 0.51;
    let radius = radius.max(center.abs().max_element() * 1e-9).max(f64::from(f32::MIN_POSITIVE));
    let distance = radius / libm::sin(FOV.to_radians() * 0.5);
    let position = center + VIEW.normalize() * distance;
    Camera::perspective(position, center, DVec3::Y, FOV).expect("finite bounds of positive size")
}

/// A key light from the camera's upper left and a cooler, weaker fill light from its right.
pub fn lights(camera: &Camera) -> Vec<Light> {
    let (right, up) = (camera.right.normalize(), camera.up.normalize());
    let from = |x: f64, y: f64, color: [f64; 3], highlight: f64| Light {
        shape: LightShape::Directional { direction: (camera.forward - right * x - up * y).normalize() },
        diffuse: color,
        specular: color.map(|c| c * highlight),
        ambient: [0.0; 3],
        falloff: None,
    };
    vec![from(-0.7, 1.0, [0.8, 0.78, 0.74], 1.0), from(1.2, 0.2, [0.22, 0.24, 0.28], 0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounding_sphere_is_seen_whole_at_any_scale() {
        for (center, radius) in [(0.0, 1.0), (1e6, 0.5), (-3.0, 1e-12), (0.0, 1e37), (7.0, 0.0)] {
            let (center, half) = (DVec3::splat(center), DVec3::splat(radius));
            let camera = camera(Some((center - half, center + half)));
            let distance = (center - camera.position).length();
            assert!(distance.is_finite() && distance > 0.0);
            let seen = distance * libm::sin(libm::atan(camera.up.length()));
            assert!(seen >= half.length(), "{seen} of {}", half.length());
            assert!(camera.position.y > center.y);
        }
    }

    #[test]
    fn lights_come_from_the_viewers_side() {
        let camera = camera(None);
        for light in lights(&camera) {
            let LightShape::Directional { direction } = light.shape else { panic!("{light:?}") };
            assert!((direction.length() - 1.0).abs() < 1e-12);
            assert!(direction.dot(camera.forward) > 0.0 && direction.y < 0.0);
        }
    }
}
