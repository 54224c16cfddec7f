//! The f32 filter in front of the f64 decision of `geometry::sphere`: surely out, surely in at a first crossing within bounds, or unsure.
//!
//! In sheared coordinates the ray is o + τ (sx, sy, 1), |sx|, |sy| <= 1, and t = τ / d_z. With u = 2^-24, L = |origin|∞ + extent, which no centre or radius exceeds, and
//! δ = 12uL as in `filter`:
//!
//! * The centre c relative to the origin is off by 2uL, the direction by 4u. So s = c·(sx, sy, 1) is off by (6 + 8 + 9)uL, the inverse of the direction's square dd in [1, 3] by 11u of
//!   itself, and τ = s/dd, |τ| < 2L, by less than 47uL. The vector from the centre's foot on the ray, c - τ (sx, sy, 1), is off by less than (2 + 47 + 8 + 4)uL in each component and
//!   its length f by less than 106uL. Squares in place of lengths cost another 7uL: 11δ = 132uL exceeds all that.
//! * f > r + 11δ: out. f < r - 11δ: the line surely passes through, and half of its way inside, √((r² - f²)/dd), lies between what the two ends of f give; rounding the
//!   squares and dd is allowed for by 20u r².
//! * t = τ/d_z is off by less than 54uL < 5δ, and by what f64 itself loses, which for a near tangent is the root of 2^-53, far less than that.

use super::filter::{Judged, Rays, U};
use super::lanes::Vector;

/// What f32 says of rays and spheres side by side.
#[derive(Clone, Copy, Debug)]
pub struct JudgedSpheres<V> {
    pub judged: Judged<V>,
    /// A bit for each ray that surely has the sphere's centre behind it: if it starts on the sphere, it doesn't meet that again.
    pub leaving: u32,
}

impl<V: Vector> Rays<V> {
    /// Judges each ray and the sphere beside it, whose centre is given in the order kx, ky, kz; lanes that aren't `wanted` may be given any answer.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn judge_spheres(&self, center: &[V; 3], radius: V, wanted: u32) -> JudgedSpheres<V> {
        // SAFETY: the caller's promise.
        unsafe {
            let ([sx, sy], zero) = (self.shear, V::splat(0.0));
            let x = center[0].sub(self.origin[0]);
            let y = center[1].sub(self.origin[1]);
            let z = center[2].sub(self.origin[2]);
            let over = self.over_square;
            let along = sx.mul_add(x, sy.mul_add(y, z)).mul(over);
            let (fx, fy, fz) = (along.neg_mul_add(sx, x), along.neg_mul_add(sy, y), z.sub(along));
            let aside = fx.mul_add(fx, fy.mul_add(fy, fz.mul(fz)));
            // 11δ.
            let error = self.linear.mul(V::splat(2.2));
            let t_error = self.t_delta.mul(V::splat(5.0));
            let t = along.mul(self.inverse_z);
            let leaving = zero.sub(t_error).gt(t);
            let reach = radius.add(error);
            let apart = aside.gt(reach.mul(reach));
            if apart & wanted == wanted {
                let judged = Judged { out: apart, inside: 0, low: zero, high: zero };
                return JudgedSpheres { judged, leaving };
            }
            let square = radius.mul(radius);
            let slack = square.mul(V::splat((20.0 * U) as f32));
            let aside = aside.sqrt();
            let (near, far) = (aside.sub(error).max(zero), aside.add(error));
            let longest = square.sub(near.mul(near)).add(slack).max(zero).mul(over).sqrt();
            let shortest = square.sub(far.mul(far)).sub(slack).max(zero).mul(over).sqrt();
            let (longest, shortest) = (longest.mul(self.inverse_z.abs()), shortest.mul(self.inverse_z.abs()));
            let low = t.sub(longest).sub(t_error);
            let behind = low.gt(self.limit);
            let before = self.t_min.gt(t.add(longest).add(t_error));
            let out = apart | behind | before;
            let inside = radius.gt(far) & shortest.gt(zero) & !out;
            JudgedSpheres { judged: Judged { out, inside, low, high: t.sub(shortest).add(t_error) }, leaving }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::filter::FilterRay;
    use super::super::lanes::Plain;
    use super::super::tree::WIDTH;
    use crate::geometry::{NONE, Prepared, Ray, norm_max, sphere};
    use glam::DVec3;
    use proptest::prelude::*;

    #[repr(align(32))]
    struct Aligned([[[f32; WIDTH]; 3]; 3], [[f32; WIDTH]; 2]);

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn never_contradicts_the_f64_test(
            center in prop::array::uniform3(-1.0f32..1.0),
            radius in prop_oneof![1e-6f32..1e-3, 1e-3f32..0.5, 0.5f32..100.0],
            origin in prop::array::uniform3(-3.0f64..3.0),
            on in prop_oneof![Just(false), Just(true)],
            beside in prop_oneof![Just(1.0), 0.0f64..2.0, 0.999_999f64..1.000_001, Just(0.0)],
            across in prop::array::uniform3(-1.0f64..1.0),
            t_max in prop_oneof![Just(f64::INFINITY), 0.0f64..4.0],
        ) {
            let (middle, r) = (DVec3::from(center.map(f64::from)), f64::from(radius));
            let outwards = DVec3::from(origin).normalize_or(DVec3::X);
            let origin = if on { middle + outwards * r } else { DVec3::from(origin) };
            let aside = DVec3::from(across).cross(middle - origin).normalize_or(DVec3::Y);
            let direction = middle + aside * (r * beside) - origin;
            prop_assume!(direction.length() > 1e-6);
            let direction = if across[0] > 0.9 { -direction } else { direction };
            let ray = Prepared::new(&Ray { origin, direction, t_min: 0.0, t_max, first_id: 0, start: NONE });
            let reach = norm_max(ray.origin) + norm_max(middle.to_array()) + r;
            let filter = FilterRay::new(&ray, reach);
            let mut block = Aligned([[[0.0; WIDTH]; 3]; 3], [[0.0; WIDTH]; 2]);
            for axis in 0..3 {
                block.0[0][axis][0] = center[axis];
            }
            block.0[1][0][0] = radius;
            let (t_min, limit) = (0.0, ray.t_max as f32 * 1.000_001);
            // SAFETY: plain arrays need no instructions; all is aligned to 32 bytes.
            let spheres = unsafe {
                use super::super::lanes::Vector;
                let spheres = filter.judge_spheres::<Plain>(&block.0, t_min, limit, 1);
                spheres.judged.low.store(block.1[0].as_mut_ptr());
                spheres.judged.high.store(block.1[1].as_mut_ptr());
                spheres
            };
            let hit = sphere::first(&ray, center.map(f64::from), r, 0).filter(|t| *t <= ray.t_max);
            if spheres.judged.out & 1 == 1 {
                prop_assert!(hit.is_none(), "out, yet met at {hit:?}");
            }
            let (low, high) = (f64::from(block.1[0][0]), f64::from(block.1[1][0]));
            if spheres.judged.inside & 1 == 1 && low > 0.0 && high < ray.t_max {
                prop_assert!(hit.is_some_and(|t| low <= t && t <= high), "{hit:?} not in {low}..{high}");
            }
            if spheres.leaving & 1 == 1 {
                prop_assert!(sphere::leave(&ray, center.map(f64::from)).is_none());
            }
            // It must say something of plain cases.
            if !on && beside == 0.0 && r > 1e-3 && r < 0.5 && t_max == f64::INFINITY && (middle - origin).length() > 2.0 * r {
                prop_assert!((spheres.judged.inside | spheres.judged.out) & 1 == 1);
            }
        }
    }
}
