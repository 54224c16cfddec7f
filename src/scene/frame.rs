//! The map between world space (the user's numbers) and stored space, in which rays are traced.
//!
//! Stored = (world - shift) * scale. `scale` is a power of two and `shift` is used only where subtracting it
//! from every coordinate is exact, so that stored f32 vertices are the world's, without any rounding.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::mesh::Surfaces;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    pub shift: DVec3,
    /// A power of two.
    pub scale: f64,
}

impl Default for Frame {
    fn default() -> Self {
        Frame { shift: DVec3::ZERO, scale: 1.0 }
    }
}

impl Frame {
    /// Chooses the frame of finite world-space surfaces and moves them into it.
    ///
    /// The largest coordinate comes to lie in [0.5, 1). An axis is shifted only where the surfaces lie farther from
    /// 0 than they are wide and the shift is exact for each coordinate.
    pub fn apply(surfaces: &mut Surfaces) -> Frame {
        let mut frame = Frame { shift: DVec3::ZERO, scale: 1.0 };
        for axis in 0..3 {
            frame.shift[axis] = exact_shift(surfaces, axis);
        }
        let largest = coordinates(surfaces)
            .flat_map(|point| (0..3).map(move |axis| (f64::from(point[axis]) - frame.shift[axis]).abs()))
            .chain(surfaces.spheres.iter().map(|sphere| f64::from(sphere.radius)))
            .fold(0.0, f64::max);
        if largest > 0.0 {
            frame.scale = power_of_two(-(libm::ilogb(largest) + 1));
        }
        let store = |point: &mut [f32; 3]| {
            for axis in 0..3 {
                point[axis] = ((f64::from(point[axis]) - frame.shift[axis]) * frame.scale) as f32;
            }
        };
        surfaces.positions.iter_mut().for_each(store);
        for sphere in surfaces.spheres.iter_mut() {
            store(&mut sphere.center);
            sphere.radius = (f64::from(sphere.radius) * frame.scale) as f32;
        }
        frame
    }

    /// A world-space point in stored space.
    #[inline]
    pub fn to_stored(&self, point: DVec3) -> DVec3 {
        (point - self.shift) * self.scale
    }

    /// A stored point in world space.
    pub fn to_world(&self, point: DVec3) -> DVec3 {
        point / self.scale + self.shift
    }
}

fn coordinates(surfaces: &Surfaces) -> impl Iterator<Item = [f32; 3]> + '_ {
    surfaces.positions.iter().copied().chain(surfaces.spheres.iter().map(|sphere| sphere.center))
}

fn exact_shift(surfaces: &Surfaces, axis: usize) -> f64 {
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for point in coordinates(surfaces) {
        low = low.min(point[axis]);
        high = high.max(point[axis]);
    }
    if low > high {
        return 0.0;
    }
    // A coordinate on either side of 0, or nearer to 0 than the surfaces are wide: nothing to gain.
    if !(low > 0.0 && high - low < low || high < 0.0 && high - low < -high) {
        return 0.0;
    }
    // high < 2 low, so each difference to a number between them is exact (Sterbenz 1974).
    f64::from((0.5 * (f64::from(low) + f64::from(high))) as f32)
}

/// 2^exponent, for exponents of normal f64 numbers.
pub(crate) fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent.clamp(-1022, 1023)) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surfaces(points: &[[f32; 3]]) -> Surfaces {
        Surfaces { positions: points.to_vec().into(), ..Surfaces::default() }
    }

    #[test]
    fn scaled_scenes_are_stored_alike() {
        let points = [[0.1, -0.7, 0.3], [1.5, 0.2, -0.9], [0.6, 0.33, 0.21]];
        let mut plain = surfaces(&points);
        let frame = Frame::apply(&mut plain);
        assert_eq!(frame.scale, 0.5);
        for exponent in [-20, 20, 100, -100] {
            let factor = power_of_two(exponent) as f32;
            let mut scaled = surfaces(&points.map(|p| p.map(|c| c * factor)));
            let other = Frame::apply(&mut scaled);
            assert_eq!(scaled.positions, plain.positions);
            assert_eq!(other.scale * f64::from(factor), frame.scale);
        }
    }

    #[test]
    fn nothing_has_the_plain_frame() {
        assert_eq!(Frame::apply(&mut Surfaces::default()), Frame::default());
    }

    #[test]
    fn far_scenes_are_shifted_exactly_and_near_ones_are_not() {
        let near = [[0.1, -0.7, 0.3], [1.5, 0.2, -0.9], [0.6, 0.33, 0.21]];
        assert_eq!(Frame::apply(&mut surfaces(&near)).shift, DVec3::ZERO);
        let far = near.map(|p| p.map(|c| c + 1.0e6));
        let mut stored = surfaces(&far);
        let frame = Frame::apply(&mut stored);
        assert!(frame.shift.x > 9e5);
        for (point, world) in stored.positions.iter().zip(&far) {
            let back = frame.to_world(DVec3::from(point.map(f64::from)));
            assert_eq!(back, DVec3::from(world.map(f64::from)));
        }
    }
}
