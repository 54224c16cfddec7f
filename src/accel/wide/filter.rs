//! An f32 filter in front of the f64 decision of `geometry::triangle`, for a ray and eight triangles or for a triangle and many rays: surely out, surely in at a t
//! within bounds, or unsure.
//!
//! It never contradicts `triangle::intersect`; what it is unsure of, that must decide. The bounds, with u = 2^-24 and L = |origin|∞ + max|vertex|∞:
//!
//! * Rounding the origin costs u|o|, the difference v − o another u(|v| + |o|), so the moved vertices are off by at most 2uL. The shear
//!   (|s| <= 1), a component times a rounded inverse, is off by 4u. It adds to x: 4u, 2u from z, u for the product, 2u for the difference; fused, less. In all
//!   |x̃ − x| < 11uL; `delta` δ = 12uL, and more by what moving the origin along the ray has cost; the bound of t then grows by what the f64 test loses over the way. What the f64 test itself rounds is 2^-29 of that and lies within the rest.
//! * An edge function of coordinates of magnitude at most m, each off by δ: 4mδ + 2δ² from the inputs, 4um² from two products
//!   and a difference. `bound` = B = m(5δ + 8um) + 4δ² + 1e-36, which leaves room for its own rounding and for what underflows.
//! * A sign is sure where the value is beyond the bound. Two sure signs that differ: out. Three sure and equal: in.
//! * t = z / d_z with d_z in [1, 2). The f64 t lies within 2^-32 L of the exact plane's or is clamped to the triangle's slabs, so it is in
//!   [min z, max z] / d_z up to δ: z is off by 2uL, its product with the rounded 1/d_z by another 3uL.
//! * Where it is in, t = (U z0 + V z1 + W z2) / (S d_z), S = U + V + W. The three weights over S are off by 6B/|S| together; about the middle of the z, whose range is R, that
//!   moves their mean by 3BR/|S|. The z are off by less than δ, and all this takes less than δ in rounding: 4B(R + 2δ)/|S| + 3δ in all.

use super::lanes::{Eight, Vector};
use super::sphere_filter::JudgedSpheres;
use super::tree::WIDTH;
use crate::geometry::Prepared;

/// Half an ulp of 1 in f32.
pub const U: f64 = 1.0 / 16_777_216.0;

/// Whether f32 can hold the numbers for this L: squares of coordinates must stay finite, and squares of δ above what underflows.
#[inline(always)]
pub fn holds(length: f64) -> bool {
    (1e-10..1e17).contains(&length)
}

/// Bounds of the error of any sheared coordinate, and of t. `length` is L; the origin is off by at most `off`, and the f64 test's own t by at most `t_off`.
#[inline(always)]
pub fn deltas(length: f64, off: f64, t_off: f64) -> (f32, f32) {
    let delta = 12.0 * U * length + off;
    (delta as f32, (delta + t_off) as f32)
}

/// See [`Rays::over_square`].
#[inline(always)]
pub fn over_square([x, y]: [f32; 2]) -> f32 {
    1.0 / (x * x + y * y + 1.0)
}

/// What the bound of an edge function takes of δ: the factor of m, 5δ, and what is added, 4δ² + 1e-36.
#[inline(always)]
pub fn terms(delta: f32) -> (f32, f32) {
    (5.0 * delta, 4.0 * delta * delta + 1e-36)
}

/// Rays rounded to f32, side by side, with the bounds of what rounding did. Components are in the order kx, ky, kz.
#[derive(Clone, Copy, Debug)]
pub struct Rays<V> {
    pub origin: [V; 3],
    pub shear: [V; 2],
    pub inverse_z: V,
    /// 1 / (sx² + sy² + 1), for spheres.
    pub over_square: V,
    /// See [`terms`].
    pub linear: V,
    pub squared: V,
    pub t_delta: V,
    /// Not above the true one.
    pub t_min: V,
    /// Hits beyond it aren't wanted; not below where that is true.
    pub limit: V,
}

/// What f32 says of rays and triangles side by side.
#[derive(Clone, Copy, Debug)]
pub struct Judged<V> {
    /// A bit for each that the f64 test surely doesn't meet within the range.
    pub out: u32,
    /// The f64 edge test is surely passed; not where `out`.
    pub inside: u32,
    /// Bounds of t, in units of the scaled direction, where `inside`.
    pub low: V,
    pub high: V,
}

impl<V: Vector> Rays<V> {
    /// Judges each ray and the triangle `corners[vertex][component]` beside it; lanes that aren't `wanted` may be given any answer.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn judge(&self, corners: &[[V; 3]; 3], wanted: u32) -> Judged<V> {
        // SAFETY: the caller's promise.
        unsafe {
            // No closures: the compiler doesn't always inline the instructions of a level into them.
            let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = *corners;
            let ([ox, oy, oz], [sx, sy], zero) = (self.origin, self.shear, V::splat(0.0));
            let (az, bz, cz) = (az.sub(oz), bz.sub(oz), cz.sub(oz));
            let (ax, ay) = (sx.neg_mul_add(az, ax.sub(ox)), sy.neg_mul_add(az, ay.sub(oy)));
            let (bx, by) = (sx.neg_mul_add(bz, bx.sub(ox)), sy.neg_mul_add(bz, by.sub(oy)));
            let (cx, cy) = (sx.neg_mul_add(cz, cx.sub(ox)), sy.neg_mul_add(cz, cy.sub(oy)));
            let u = cx.mul_sub(by, cy.mul(bx));
            let v = ax.mul_sub(cy, ay.mul(cx));
            let w = bx.mul_sub(ay, by.mul(ax));
            let (least, most) = (u.min(v).min(w), u.max(v).max(w));
            let m = ax.max_abs(ay).max(bx.max_abs(by)).max(cx.max_abs(cy));
            let bound = m.mul_add(m.mul_add(V::splat((8.0 * U) as f32), self.linear), self.squared);
            // The lesser of the two is large only if two signs differ for sure.
            let apart = most.min(zero.sub(least)).gt(bound);
            if apart & wanted == wanted {
                return Judged { out: apart, inside: 0, low: zero, high: zero };
            }
            let (delta, iz) = (self.t_delta, self.inverse_z);
            let (at, bt, ct) = (az.mul(iz), bz.mul(iz), cz.mul(iz));
            let (first, last) = (at.min(bt).min(ct), at.max(bt).max(ct));
            let (first, last) = (first.sub(delta), last.add(delta));
            let out = apart | first.gt(self.limit) | self.t_min.gt(last);
            let inside = (least.gt(bound) | zero.sub(most).gt(bound)) & !out;
            if inside & wanted == 0 {
                return Judged { out, inside: 0, low: zero, high: zero };
            }
            let sum = u.add(v).add(w);
            let over = V::splat(1.0).div(sum);
            let mean = at.mul_add(u, bt.mul_add(v, ct.mul(w))).mul(over);
            let off = bound.mul(last.sub(first)).mul(over.abs());
            let off = off.mul_add(V::splat(4.0), delta.mul(V::splat(3.0)));
            let (low, high) = (mean.sub(off).max(first), mean.add(off).min(last));
            // Such as what a ray has just left.
            let passed = inside & (self.t_min.gt(high) | low.gt(self.limit));
            Judged { out: out | passed, inside: inside & !passed, low, high }
        }
    }
}

/// One ray rounded to f32.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct FilterRay {
    /// x, y, z.
    pub origin: [f32; 3],
    pub inverse_z: f32,
    pub shear: [f32; 2],
    /// See [`Rays::over_square`].
    pub over_square: f32,
    /// See [`terms`].
    pub linear: f32,
    pub squared: f32,
    pub t_delta: f32,
    /// kx, ky, kz.
    pub axes: [u8; 3],
}

impl FilterRay {
    /// A ray alone, with its own origin; `length` is L.
    pub fn new(ray: &Prepared, length: f64) -> Self {
        let (delta, t_delta) = deltas(length, 0.0, 0.0);
        let (linear, squared) = terms(delta);
        let axes = [ray.kx, ray.ky, ray.kz];
        let inverse_z = 1.0 / ray.direction[ray.kz] as f32;
        let shear = [ray.kx, ray.ky].map(|axis| ray.direction[axis] as f32 * inverse_z);
        FilterRay {
            axes: axes.map(|axis| axis as u8),
            origin: ray.origin.map(|c| c as f32),
            shear,
            inverse_z,
            over_square: over_square(shear),
            linear,
            squared,
            t_delta,
        }
    }

    /// Judges triangles `corners[vertex][axis][lane]`, aligned to 32 bytes, against hits from `t_min` to `limit`.
    ///
    /// # Safety
    /// The level's instructions are there; `axes` are below 3.
    #[inline(always)]
    pub unsafe fn judge<E: Eight>(
        &self,
        corners: &[[[f32; WIDTH]; 3]; 3],
        t_min: f32,
        limit: f32,
        wanted: u32,
    ) -> Judged<E> {
        // SAFETY: corners are aligned as their block is; the rest is the caller's promise.
        unsafe {
            let rays = self.side_by_side::<E>(t_min, limit);
            let mut sides = [[rays.t_min; 3]; 3];
            for vertex in 0..3 {
                for component in 0..3 {
                    let axis = usize::from(self.axes[component]);
                    sides[vertex][component] = E::load(corners[vertex].get_unchecked(axis).as_ptr());
                }
            }
            rays.judge(&sides, wanted)
        }
    }

    /// The same for spheres: `corners[0]` are the centres, `corners[1][0]` the radii.
    ///
    /// # Safety
    /// As of [`judge`](Self::judge).
    #[inline(always)]
    pub unsafe fn judge_spheres<E: Eight>(
        &self,
        corners: &[[[f32; WIDTH]; 3]; 3],
        t_min: f32,
        limit: f32,
        wanted: u32,
    ) -> JudgedSpheres<E> {
        // SAFETY: corners are aligned as their block is; the rest is the caller's promise.
        unsafe {
            let rays = self.side_by_side::<E>(t_min, limit);
            let mut center = [rays.t_min; 3];
            for component in 0..3 {
                let axis = usize::from(self.axes[component]);
                center[component] = E::load(corners[0].get_unchecked(axis).as_ptr());
            }
            rays.judge_spheres(&center, E::load(corners[1][0].as_ptr()), wanted)
        }
    }

    /// The ray in every lane.
    ///
    /// # Safety
    /// The level's instructions are there; `axes` are below 3.
    #[inline(always)]
    unsafe fn side_by_side<V: Vector>(&self, t_min: f32, limit: f32) -> Rays<V> {
        // SAFETY: the caller's promise.
        unsafe {
            let [kx, ky, kz] = self.axes;
            let [kx, ky, kz] = [usize::from(kx), usize::from(ky), usize::from(kz)];
            Rays {
                origin: [
                    V::splat(*self.origin.get_unchecked(kx)),
                    V::splat(*self.origin.get_unchecked(ky)),
                    V::splat(*self.origin.get_unchecked(kz)),
                ],
                shear: [V::splat(self.shear[0]), V::splat(self.shear[1])],
                inverse_z: V::splat(self.inverse_z),
                over_square: V::splat(self.over_square),
                linear: V::splat(self.linear),
                squared: V::splat(self.squared),
                t_delta: V::splat(self.t_delta),
                t_min: V::splat(t_min),
                limit: V::splat(limit),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Plain;
    use super::super::tree::Block;
    use super::*;
    use crate::geometry::triangle::{barycentrics, intersect};
    use crate::geometry::{NONE, Prepared, Ray, round_down, round_up};
    use crate::simd::Level;
    use bytemuck::Zeroable;
    use glam::DVec3;
    use proptest::prelude::*;

    /// A small deterministic generator: millions of cases are wanted, not shrinking.
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> u64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let x = self.0 ^ (self.0 >> 33);
            x.wrapping_mul(0xff51_afd7_ed55_8ccd) >> 11
        }

        fn unit(&mut self) -> f64 {
            self.next() as f64 / (1u64 << 53) as f64
        }

        fn signed(&mut self) -> f64 {
            2.0 * self.unit() - 1.0
        }

        fn pick(&mut self, from: &[f64]) -> f64 {
            from[self.next() as usize % from.len()]
        }
    }

    /// A ray aimed near an edge, a vertex or the inside of a triangle that may be a sliver, far or tiny.
    fn case(numbers: &mut Numbers) -> (Ray, [[f32; 3]; 3]) {
        let size = numbers.pick(&[1.0, 1e-3, 1e-6]);
        let center: [f64; 3] = std::array::from_fn(|_| numbers.signed());
        let squash = numbers.pick(&[1.0, 1.0, 1e-4, 1e-7]);
        let vertices: [[f32; 3]; 3] = std::array::from_fn(|_| {
            std::array::from_fn(|axis| {
                let stretch = if axis == 0 { squash } else { 1.0 };
                (center[axis] + size * stretch * numbers.signed()) as f32
            })
        });
        let (a, b) = (numbers.unit(), numbers.unit() * numbers.pick(&[0.0, 1.0, 1e-6]));
        let weights = [a, (1.0 - a) * (1.0 - b), (1.0 - a) * b];
        let near = numbers.pick(&[0.0, 1e-16, 1e-9, 1e-7, 1e-6, 1e-2]) * size;
        let target: [f64; 3] = std::array::from_fn(|axis| {
            let on: f64 = (0..3).map(|k| weights[k] * f64::from(vertices[k][axis])).sum();
            on + near * numbers.signed()
        });
        let far = numbers.pick(&[1.0, 1.0, 30.0, 1e-2, 1e4]);
        let origin: [f64; 3] =
            std::array::from_fn(|axis| center[axis] * numbers.pick(&[0.0, 1.0]) + far * numbers.signed());
        let mut direction = DVec3::from(target) - DVec3::from(origin);
        if numbers.next().is_multiple_of(8) {
            direction[numbers.next() as usize % 3] = 0.0;
        }
        let t_min = numbers.pick(&[0.0, 0.0, 0.999_999, 1.0]);
        let t_max = numbers.pick(&[f64::INFINITY, f64::INFINITY, 1.0, 1.000_001]);
        let origin = DVec3::from(origin);
        (Ray { origin, direction, t_min, t_max, first_id: 0, start: NONE }, vertices)
    }

    /// How often the filter was sure, so that the test can't pass by being always unsure.
    #[derive(Debug, Default)]
    struct Tally {
        cases: u32,
        out: u32,
        inside: u32,
        unsure: u32,
        /// Where inside: the bounds of t are closer than the triangle's own.
        close: u32,
    }

    /// As the filter judges, with the bounds as arrays.
    struct Told {
        out: u32,
        inside: u32,
        low: [f32; WIDTH],
        high: [f32; WIDTH],
    }

    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn told<E: Eight>(filter: &FilterRay, block: &Block, t_min: f32, limit: f32) -> Told {
        #[repr(align(32))]
        struct Aligned([f32; WIDTH]);
        let (mut low, mut high) = (Aligned([0.0; WIDTH]), Aligned([0.0; WIDTH]));
        // SAFETY: the caller's promise; the places are aligned.
        unsafe {
            let judged = filter.judge::<E>(&block.corners, t_min, limit, 0xff);
            judged.low.store(low.0.as_mut_ptr());
            judged.high.store(high.0.as_mut_ptr());
            Told { out: judged.out, inside: judged.inside, low: low.0, high: high.0 }
        }
    }

    fn judge(level: Level, filter: &FilterRay, block: &Block, t_min: f32, limit: f32) -> Told {
        #[cfg(target_arch = "x86_64")]
        mod levels {
            use super::super::super::lanes::{Avx2, Avx512};
            use super::*;

            #[target_feature(enable = "avx2,fma")]
            pub unsafe fn avx2(filter: &FilterRay, block: &Block, t_min: f32, limit: f32) -> Told {
                // SAFETY: the caller has asked whether the processor has them.
                unsafe { told::<Avx2>(filter, block, t_min, limit) }
            }

            #[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
            pub unsafe fn avx512(filter: &FilterRay, block: &Block, t_min: f32, limit: f32) -> Told {
                // SAFETY: the caller has asked whether the processor has them.
                unsafe { told::<Avx512>(filter, block, t_min, limit) }
            }
        }
        // SAFETY: only levels that the processor has are asked for.
        unsafe {
            match level {
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => levels::avx2(filter, block, t_min, limit),
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => levels::avx512(filter, block, t_min, limit),
                _ => told::<Plain>(filter, block, t_min, limit),
            }
        }
    }

    fn levels() -> impl Iterator<Item = Level> {
        Level::ALL.into_iter().filter(|level| level.is_available())
    }

    /// Eight triangles against a ray that is aimed at the first of them.
    fn hunt(level: Level, seed: u64, cases: u32) -> Tally {
        let (mut numbers, mut tally) = (Numbers(seed), Tally::default());
        for _ in 0..cases {
            let (ray, first) = case(&mut numbers);
            if ray.direction == DVec3::ZERO {
                continue;
            }
            let prepared = Prepared::new(&ray);
            let length = prepared.origin.iter().fold(0.0, |m: f64, c| m.max(c.abs())) + 2.0;
            if !holds(length) {
                continue;
            }
            let filter = FilterRay::new(&prepared, length);
            let mut block = Block::zeroed();
            let triangles: [[[f32; 3]; 3]; WIDTH] =
                std::array::from_fn(|lane| if lane == 0 { first } else { case(&mut numbers).1 });
            for (lane, triangle) in triangles.iter().enumerate() {
                for vertex in 0..3 {
                    for axis in 0..3 {
                        block.corners[vertex][axis][lane] = triangle[vertex][axis];
                    }
                }
            }
            let judged = judge(level, &filter, &block, round_down(prepared.t_min), round_up(prepared.t_max));
            for (lane, triangle) in triangles.iter().enumerate() {
                let (out, inside) = (judged.out >> lane & 1, judged.inside >> lane & 1);
                let exact = triangle.map(|vertex| vertex.map(f64::from));
                let hit = intersect(&prepared, &exact);
                tally.cases += 1;
                tally.out += out;
                tally.inside += inside;
                tally.unsure += u32::from(out == 0 && inside == 0);
                assert!(
                    !(out == 1 && hit.is_some_and(|hit| hit.t >= prepared.t_min && hit.t <= prepared.t_max)),
                    "out, yet hit: {ray:?} {triangle:?}"
                );
                let Some(hit) = hit else {
                    assert_eq!(inside, 0, "in, yet missed: {ray:?} {triangle:?}");
                    continue;
                };
                if inside == 1 {
                    let (low, high) = (f64::from(judged.low[lane]), f64::from(judged.high[lane]));
                    assert!(
                        low <= hit.t && hit.t <= high,
                        "t {} not in {low}..{high}: {ray:?} {triangle:?}",
                        hit.t
                    );
                    tally.close += u32::from(high - low < 1e-4 * length);
                }
                let [v, w] = barycentrics(&prepared, &exact, &hit);
                assert!((0.0..=1.0).contains(&v) && (0.0..=1.0).contains(&w), "{v} {w}");
            }
        }
        tally
    }

    #[test]
    fn never_contradicts_the_f64_test() {
        for level in levels() {
            let tally = hunt(level, 1, 100_000);
            assert!(tally.out > tally.cases / 20, "{tally:?}");
            assert!(tally.inside > tally.cases / 500, "{tally:?}");
            assert!(tally.unsure < tally.cases / 2, "{tally:?}");
            assert!(tally.close > tally.inside * 3 / 4, "{tally:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        #[test]
        fn never_contradicts_it_from_any_seed(seed in any::<u64>()) {
            for level in levels() {
                hunt(level, seed, 3_000);
            }
        }
    }
}
