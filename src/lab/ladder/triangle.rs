//! Textbook kernels that meet a ray with a triangle, and the renderer's decision beside them. Each is as its source has it, faults
//! included. Knows neither meshes nor rays' aims.

use super::aim::AimedRay;
use crate::geometry::{NONE, Prepared, Ray, triangle};

/// A way to meet a ray with a triangle.
pub trait TriangleKernel: Sync {
    /// A ray with what all its tests share.
    type Ray;
    /// A triangle as the kernel wants it stored.
    type Stored: Sync;
    fn ray(&self, ray: &AimedRay) -> Self::Ray;
    fn store(&self, triangle: &[[f32; 3]; 3]) -> Self::Stored;
    /// The hit before the ray's begin doesn't count.
    fn intersect(&self, ray: &Self::Ray, triangle: &Self::Stored) -> Option<f64>;
}

macro_rules! vectors {
    ($name:ident, $float:ty) => {
        pub(super) mod $name {
            pub type V = [$float; 3];

            #[inline]
            pub fn sub(a: V, b: V) -> V {
                [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
            }

            #[inline]
            pub fn dot(a: V, b: V) -> $float {
                a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
            }

            #[inline]
            pub fn cross(a: V, b: V) -> V {
                [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
            }

            /// Möller & Trumbore 1997, the two-sided test: t, and the weights of the second and third vertex.
            #[inline]
            pub fn moller_trumbore(
                o: V,
                d: V,
                [v0, v1, v2]: &[V; 3],
                epsilon: $float,
            ) -> Option<[$float; 3]> {
                let (e1, e2) = (sub(*v1, *v0), sub(*v2, *v0));
                let p = cross(d, e2);
                let det = dot(e1, p);
                if det == 0.0 || (det > -epsilon && det < epsilon) {
                    return None;
                }
                let inverse = 1.0 / det;
                let s = sub(o, *v0);
                let u = dot(s, p) * inverse;
                if !(0.0..=1.0).contains(&u) {
                    return None;
                }
                let q = cross(s, e1);
                let v = dot(d, q) * inverse;
                if v < 0.0 || u + v > 1.0 {
                    return None;
                }
                let t = dot(e2, q) * inverse;
                (t > epsilon).then_some([t, u, v])
            }
        }
    };
}
vectors!(single, f32);
vectors!(double, f64);

/// Möller & Trumbore 1997, "Fast, Minimum Storage Ray/Triangle Intersection", in f32, with the ε of their listing or without.
pub struct MollerTrumboreF32 {
    pub epsilon: f32,
}

impl TriangleKernel for MollerTrumboreF32 {
    type Ray = AimedRay;
    type Stored = [[f32; 3]; 3];

    fn ray(&self, ray: &AimedRay) -> AimedRay {
        *ray
    }

    fn store(&self, triangle: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
        *triangle
    }

    #[inline]
    fn intersect(&self, ray: &AimedRay, triangle: &[[f32; 3]; 3]) -> Option<f64> {
        single::moller_trumbore(ray.origin, ray.direction, triangle, self.epsilon).map(|[t, ..]| f64::from(t))
    }
}

/// Möller & Trumbore 1997 in f64, without ε.
pub struct MollerTrumboreF64;

impl TriangleKernel for MollerTrumboreF64 {
    type Ray = [[f64; 3]; 2];
    type Stored = [[f64; 3]; 3];

    fn ray(&self, ray: &AimedRay) -> [[f64; 3]; 2] {
        [ray.origin.map(f64::from), ray.direction.map(f64::from)]
    }

    fn store(&self, triangle: &[[f32; 3]; 3]) -> [[f64; 3]; 3] {
        triangle.map(|v| v.map(f64::from))
    }

    #[inline]
    fn intersect(&self, [origin, direction]: &[[f64; 3]; 2], triangle: &[[f64; 3]; 3]) -> Option<f64> {
        double::moller_trumbore(*origin, *direction, triangle, 0.0).map(|[t, ..]| t)
    }
}

/// Woop, Benthin & Wald 2013, "Watertight Ray/Triangle Intersection", in f32, without its f64 fallback.
pub struct WoopF32;

/// The shear of Woop, Benthin & Wald 2013, section 3.
pub struct WoopRay {
    origin: [f32; 3],
    axes: [usize; 3],
    shear: [f32; 3],
}

impl TriangleKernel for WoopF32 {
    type Ray = WoopRay;
    type Stored = [[f32; 3]; 3];

    fn ray(&self, ray: &AimedRay) -> WoopRay {
        let d = ray.direction;
        let mut kz = 0;
        for axis in 1..3 {
            if d[axis].abs() > d[kz].abs() {
                kz = axis;
            }
        }
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        // Keeps the triangles' orientation.
        if d[kz] < 0.0 {
            (kx, ky) = (ky, kx);
        }
        WoopRay { origin: ray.origin, axes: [kx, ky, kz], shear: [d[kx] / d[kz], d[ky] / d[kz], 1.0 / d[kz]] }
    }

    fn store(&self, triangle: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
        *triangle
    }

    #[inline]
    fn intersect(&self, ray: &WoopRay, triangle: &[[f32; 3]; 3]) -> Option<f64> {
        let ([kx, ky, kz], [sx, sy, sz]) = (ray.axes, ray.shear);
        let [a, b, c] = triangle.map(|v| single::sub(v, ray.origin));
        let (ax, ay) = (a[kx] - sx * a[kz], a[ky] - sy * a[kz]);
        let (bx, by) = (b[kx] - sx * b[kz], b[ky] - sy * b[kz]);
        let (cx, cy) = (c[kx] - sx * c[kz], c[ky] - sy * c[kz]);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let det = u + v + w;
        if det == 0.0 {
            return None;
        }
        let t = (u * (sz * a[kz]) + v * (sz * b[kz]) + w * (sz * c[kz])) / det;
        (t >= 0.0).then_some(f64::from(t))
    }
}

/// [`WoopF32`] behind the slab test (Kay & Kajiya 1986) of each triangle's box, in f32, its corners rounded to the nearest half-precision
/// number and not padded.
pub struct HalfBoxes;

/// A ray for slabs and triangles.
pub struct SlabRay {
    inverse: [f32; 3],
    woop: WoopRay,
}

/// A triangle in its box of half-precision corners.
pub struct Boxed {
    low: [f32; 3],
    high: [f32; 3],
    triangle: [[f32; 3]; 3],
}

impl TriangleKernel for HalfBoxes {
    type Ray = SlabRay;
    type Stored = Boxed;

    fn ray(&self, ray: &AimedRay) -> SlabRay {
        SlabRay { inverse: ray.direction.map(f32::recip), woop: WoopF32.ray(ray) }
    }

    fn store(&self, triangle: &[[f32; 3]; 3]) -> Boxed {
        let corner = |pick: fn(f32, f32) -> f32| {
            std::array::from_fn(|axis| {
                nearest_half(pick(triangle[0][axis], pick(triangle[1][axis], triangle[2][axis])))
            })
        };
        Boxed { low: corner(f32::min), high: corner(f32::max), triangle: *triangle }
    }

    #[inline]
    fn intersect(&self, ray: &SlabRay, boxed: &Boxed) -> Option<f64> {
        let (mut near, mut far) = (0.0f32, f32::INFINITY);
        for axis in 0..3 {
            let first = (boxed.low[axis] - ray.woop.origin[axis]) * ray.inverse[axis];
            let last = (boxed.high[axis] - ray.woop.origin[axis]) * ray.inverse[axis];
            near = near.max(first.min(last));
            far = far.min(first.max(last));
        }
        if near > far {
            return None;
        }
        WoopF32.intersect(&ray.woop, &boxed.triangle)
    }
}

/// The half-precision number (IEEE 754 binary16) nearest to x, ties to even; infinite beyond its range.
pub fn nearest_half(x: f32) -> f32 {
    let magnitude = x.abs();
    if magnitude >= 65_520.0 {
        return f32::INFINITY.copysign(x);
    }
    // The spacing of its numbers: 2^(e − 10), from 2^-24 on. A division by a power of two is exact.
    let exponent = ((magnitude.to_bits() >> 23) as i32 - 127).max(-14);
    let spacing = f32::from_bits(((exponent - 10 + 127) as u32) << 23);
    ((magnitude / spacing).round_ties_even() * spacing).copysign(x)
}

/// What the renderer does: [`triangle::intersect`], in f64.
pub struct Product;

impl TriangleKernel for Product {
    type Ray = Prepared;
    type Stored = [[f32; 3]; 3];

    fn ray(&self, ray: &AimedRay) -> Prepared {
        Prepared::new(&Ray {
            origin: ray.origin.map(f64::from).into(),
            direction: ray.direction.map(f64::from).into(),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        })
    }

    fn store(&self, triangle: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
        *triangle
    }

    #[inline]
    fn intersect(&self, ray: &Prepared, triangle: &[[f32; 3]; 3]) -> Option<f64> {
        let hit = triangle::intersect(ray, &triangle.map(|v| v.map(f64::from)))?;
        ray.begun(hit.t, 0).then_some(hit.t * ray.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_those_of_the_standard() {
        for (x, half) in [
            (0.0, 0.0),
            (1.0, 1.0),
            (-1.0, -1.0),
            // Spacing 2^-10 above 1, 2^-11 below; ties go to the even one.
            (1.0 + 1.0 / 2048.0, 1.0),
            (1.0 + 3.0 / 2048.0, 1.0 + 2.0 / 1024.0),
            (1.000_5, 1.000_976_6),
            (10_003.0, 10_000.0),
            (65_504.0, 65_504.0),
            (65_519.0, 65_504.0),
            (65_520.0, f32::INFINITY),
            (-1e9, f32::NEG_INFINITY),
            // Denormals: multiples of 2^-24.
            (5.960_464_5e-8, 5.960_464_5e-8),
            (2e-8, 0.0),
            (1e-7, 1.192_092_9e-7),
        ] {
            assert_eq!(nearest_half(x), half, "{x}");
        }
    }

    #[test]
    fn all_kernels_hit_the_middle_and_miss_the_outside() {
        let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        fn check<K: TriangleKernel>(kernel: &K, triangle: &[[f32; 3]; 3], name: &str) {
            let stored = kernel.store(triangle);
            let meet = |x: f32, z: f32, down: f32| {
                let ray = AimedRay { origin: [x, 0.25, z], direction: [0.01, 0.02, down] };
                kernel.intersect(&kernel.ray(&ray), &stored)
            };
            for (z, down, side) in [(2.0, -0.5, "front"), (-2.0, 0.5, "back")] {
                let t = meet(0.25, z, down).expect(name);
                assert!((t - 4.0).abs() < 1e-5, "{name} {side}: {t}");
            }
            assert_eq!(meet(0.25, 2.0, 0.5), None, "{name} away");
            assert_eq!(meet(0.75, 2.0, -0.5), None, "{name} beside");
        }
        check(&MollerTrumboreF32 { epsilon: 1e-6 }, &triangle, "ε");
        check(&MollerTrumboreF32 { epsilon: 0.0 }, &triangle, "f32");
        check(&MollerTrumboreF64, &triangle, "f64");
        check(&WoopF32, &triangle, "Woop");
        check(&HalfBoxes, &triangle, "f16");
        check(&Product, &triangle, "product");
    }
}
