//! Pure numbers: rays and their records, triangles, spheres, boxes, and what "hit" means. Knows no scene.
//!
//! Vertices and boxes are f32, rays are f64. [`triangle::intersect`] and [`sphere::intersect`] are the definition of a
//! hit; every structure and kernel answers exactly as they do. Nothing here fuses multiply and add.

pub mod angle;
pub mod bounding;
pub mod bounds;
pub mod position;
pub mod record;
pub mod sphere;
pub mod start;
pub mod triangle;
mod twofold;

use glam::DVec3;

/// "No primitive."
pub const NONE: u32 = u32::MAX;

/// A ray's question in stored space: which surface is met between `t_min` and `t_max`?
///
/// A hit (t, id) counts if (t_min, first_id) <= (t, id) in lexicographic order and t <= t_max.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: DVec3,
    /// Of any length but 0; t is measured in its units.
    pub direction: DVec3,
    pub t_min: f64,
    pub t_max: f64,
    /// At `t_min` itself only primitives from this id on count.
    pub first_id: u32,
    /// The primitive that the ray starts on, or [`NONE`].
    pub start: u32,
}

/// A ray with what all its intersection tests share: a direction whose largest component lies in [1, 2), and the shear
/// that turns it into the z axis (Woop, Benthin and Wald 2013, "Watertight Ray/Triangle Intersection", section 3).
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    pub origin: [f64; 3],
    /// The ray's direction times `scale`, a power of two.
    pub direction: [f64; 3],
    pub scale: f64,
    /// The axis of the largest component, and the next two in turn.
    pub kx: usize,
    pub ky: usize,
    pub kz: usize,
    /// The components along `kx` and `ky`, each over that along `kz`.
    pub shear_x: f64,
    pub shear_y: f64,
    /// In units of the scaled direction.
    pub t_min: f64,
    pub t_max: f64,
    pub first_id: u32,
}

impl Prepared {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let magnitude = [d[0].abs(), d[1].abs(), d[2].abs()];
        let kz = if magnitude[0] > magnitude[1] {
            if magnitude[0] > magnitude[2] { 0 } else { 2 }
        } else if magnitude[1] > magnitude[2] {
            1
        } else {
            2
        };
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let (scale, inverse) = normalising_power(magnitude[kz]);
        let direction = [d[0] * scale, d[1] * scale, d[2] * scale];
        Prepared {
            origin: ray.origin.to_array(),
            direction,
            scale,
            kx,
            ky,
            kz,
            shear_x: direction[kx] / direction[kz],
            shear_y: direction[ky] / direction[kz],
            t_min: ray.t_min * inverse,
            t_max: ray.t_max * inverse,
            first_id: ray.first_id,
        }
    }

    /// Whether (t, id), t in units of the scaled direction, isn't before the ray's begin.
    #[inline]
    pub fn begun(&self, t: f64, id: u32) -> bool {
        t > self.t_min || (t == self.t_min && id >= self.first_id)
    }
}

/// The f32 at or below t.
#[inline]
pub fn round_down(t: f64) -> f32 {
    let rounded = t as f32;
    if f64::from(rounded) > t { rounded.next_down() } else { rounded }
}

/// The f32 at or above t.
#[inline]
pub fn round_up(t: f64) -> f32 {
    -round_down(-t)
}

/// The power of two that brings a positive number into [1, 2), and its inverse. Denormals come as near as the
/// exponents of f64 allow.
#[inline(always)]
fn normalising_power(x: f64) -> (f64, f64) {
    let exponent = ((x.to_bits() >> 52) & 0x7ff).clamp(1, 2045);
    (f64::from_bits((2046 - exponent) << 52), f64::from_bits(exponent << 52))
}

/// Which of the three belongs to the axis of a direction's largest component.
#[inline(always)]
pub(crate) fn of_axis<T>(along_x: bool, along_y: bool, [x, y, z]: [T; 3]) -> T {
    if along_x {
        x
    } else if along_y {
        y
    } else {
        z
    }
}

#[inline(always)]
pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Largest magnitude.
#[inline]
pub(crate) fn norm_max(a: [f64; 3]) -> f64 {
    a[0].abs().max(a[1].abs()).max(a[2].abs())
}

/// Sum of magnitudes.
#[inline(always)]
pub(crate) fn norm1(a: [f64; 3]) -> f64 {
    (a[0].abs() + a[1].abs()) + a[2].abs()
}

/// A small deterministic generator for tests: Knuth's linear congruence.
#[cfg(test)]
struct Numbers(u64);

#[cfg(test)]
impl Numbers {
    /// The upper bits are the random ones.
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0
    }

    /// In [0, 1).
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / 9_007_199_254_740_992.0
    }
}
