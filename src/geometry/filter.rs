//! An f32 filter in front of the f64 decision of `triangle`: surely out, surely in, or unsure, for several triangles at once.
//!
//! It never contradicts `triangle::intersect`; what it is unsure of, that must decide. The bounds, with u = 2^-24 and L = |origin|∞ + max|vertex|∞:
//!
//! * Rounding the origin costs u|o|, the difference v − o another u(|v| + |o|), so the moved vertices are off by at most 2uL. The shear
//!   (|s| <= 1) adds to x: u for rounding s, 2u from z, u for the product, 2u for the difference. In all |x̃ − x| < 8uL; `delta` = 9uL.
//!   What the f64 test itself rounds is 2^-29 of that and lies within the rest.
//! * An edge function of coordinates of magnitude at most m, each off by δ: 4mδ + 2δ² from the inputs, 4um² from two products
//!   and a difference. `bound` = m(5δ + 8um) + 4δ², which leaves room for its own rounding and for what underflows.
//! * A sign is sure where the value is beyond the bound. Two sure signs that differ: out. Three sure and equal: in.
//! * t = z / d_z with d_z in [1, 2). The f64 t lies within 2^-32 L of the exact plane's or is clamped to the triangle's slabs, so it is in
//!   [min z, max z] / d_z up to δ: z is off by 2uL, its product with 1/d_z by another 2uL.

use super::Prepared;

/// Half an ulp of 1 in f32.
const U: f64 = 1.0 / 16_777_216.0;

/// N triangles, component by component: `block[vertex][axis][lane]`.
pub type Block<const N: usize> = [[[f32; N]; 3]; 3];

/// A ray rounded to f32, with the bound of what rounding did.
#[derive(Clone, Copy, Debug)]
pub struct FilterRay {
    /// Axes in the order kx, ky, kz.
    axes: [usize; 3],
    origin: [f32; 3],
    shear: [f32; 2],
    inverse_z: f32,
    /// Bound of the error of any sheared coordinate, and of t.
    pub delta: f32,
    t_min: f32,
}

/// What the filter says of N triangles, a bit for each lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict<const N: usize> {
    /// The f64 test finds no hit between t_min and t_max.
    pub out: u32,
    /// The f64 edge test is passed, whatever t is.
    pub inside: u32,
    /// Interval of t, in units of the scaled direction, of any f64 hit.
    pub t_low: [f32; N],
    pub t_high: [f32; N],
}

impl FilterRay {
    /// `extent` is the largest magnitude of a vertex coordinate. `None` where f32 can't hold the numbers.
    #[inline]
    pub fn new(ray: &Prepared, extent: f64) -> Option<Self> {
        let length = ray.origin.iter().fold(0.0, |m: f64, c| m.max(c.abs())) + extent;
        // Squares of coordinates must stay finite, and squares of delta above what underflows.
        if !(1e-10..1e17).contains(&length) {
            return None;
        }
        let axes = [ray.kx, ray.ky, ray.kz];
        let delta = (9.0 * U * length) as f32;
        Some(FilterRay {
            axes,
            origin: axes.map(|axis| ray.origin[axis] as f32),
            shear: [ray.shear_x as f32, ray.shear_y as f32],
            inverse_z: (1.0 / ray.direction[ray.kz]) as f32,
            delta,
            t_min: round_down(ray.t_min),
        })
    }

    /// Judges N triangles against hits before `t_max`, an f32 not below the true limit.
    #[inline(always)]
    pub fn judge<const N: usize>(&self, block: &Block<N>, t_max: f32) -> Verdict<N> {
        let [kx, ky, kz] = self.axes;
        let moved = |vertex: usize, axis: usize, k: usize| -> [f32; N] {
            std::array::from_fn(|lane| block[vertex][axis][lane] - self.origin[k])
        };
        let z: [[f32; N]; 3] = std::array::from_fn(|vertex| moved(vertex, kz, 2));
        let sheared = |axis: usize, k: usize| -> [[f32; N]; 3] {
            std::array::from_fn(|vertex| {
                let from = moved(vertex, axis, k);
                std::array::from_fn(|lane| from[lane] - self.shear[k] * z[vertex][lane])
            })
        };
        let (x, y) = (sheared(kx, 0), sheared(ky, 1));
        let mut verdict = Verdict { out: 0, inside: 0, t_low: [0.0; N], t_high: [0.0; N] };
        let (mut out, mut inside) = ([false; N], [false; N]);
        for lane in 0..N {
            let edge = |p: usize, q: usize| x[p][lane] * y[q][lane] - y[p][lane] * x[q][lane];
            let (u, v, w) = (edge(2, 1), edge(0, 2), edge(1, 0));
            let size = |p: usize| x[p][lane].abs().max(y[p][lane].abs());
            let m = size(0).max(size(1)).max(size(2));
            let bound = m * (5.0 * self.delta + (8.0 * U) as f32 * m) + 4.0 * self.delta * self.delta;
            let (most, least) = (u.max(v).max(w), u.min(v).min(w));
            let at = |p: usize| z[p][lane] * self.inverse_z;
            let low = at(0).min(at(1)).min(at(2)) - self.delta;
            let high = at(0).max(at(1)).max(at(2)) + self.delta;
            out[lane] = (most > bound && least < -bound) || high < self.t_min || low > t_max;
            inside[lane] = least > bound || most < -bound;
            verdict.t_low[lane] = low;
            verdict.t_high[lane] = high;
        }
        for lane in 0..N {
            verdict.out |= u32::from(out[lane]) << lane;
            verdict.inside |= u32::from(inside[lane]) << lane;
        }
        verdict
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

#[cfg(test)]
mod tests {
    use super::super::triangle::{barycentrics, intersect};
    use super::super::{NONE, Ray};
    use super::*;
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
    }

    fn hunt(seed: u64, cases: u32) -> Tally {
        let (mut numbers, mut tally) = (Numbers(seed), Tally::default());
        for _ in 0..cases {
            let (ray, vertices) = case(&mut numbers);
            if ray.direction == DVec3::ZERO {
                continue;
            }
            let prepared = Prepared::new(&ray);
            let Some(filter) = FilterRay::new(&prepared, 2.0) else { continue };
            let block: Block<1> = vertices.map(|vertex| vertex.map(|c| [c]));
            let verdict = filter.judge(&block, round_up(prepared.t_max));
            let exact = vertices.map(|vertex| vertex.map(f64::from));
            let hit = intersect(&prepared, &exact);
            tally.cases += 1;
            tally.out += verdict.out;
            tally.inside += verdict.inside;
            tally.unsure += u32::from(verdict.out == 0 && verdict.inside == 0);
            assert!(
                !(verdict.out == 1
                    && hit.is_some_and(|hit| hit.t >= prepared.t_min && hit.t <= prepared.t_max)),
                "out, yet hit: {ray:?} {vertices:?}"
            );
            if let Some(hit) = hit {
                let (low, high) = (f64::from(verdict.t_low[0]), f64::from(verdict.t_high[0]));
                assert!(
                    low <= hit.t && hit.t <= high,
                    "t {} not in {low}..{high}: {ray:?} {vertices:?}",
                    hit.t
                );
                let [v, w] = barycentrics(&prepared, &exact, &hit);
                assert!((0.0..=1.0).contains(&v) && (0.0..=1.0).contains(&w), "{v} {w}");
            } else {
                assert_eq!(verdict.inside, 0, "in, yet missed: {ray:?} {vertices:?}");
            }
        }
        tally
    }

    #[test]
    fn never_contradicts_the_f64_test() {
        let tally = hunt(1, 400_000);
        assert!(tally.out > tally.cases / 20, "{tally:?}");
        assert!(tally.inside > tally.cases / 50, "{tally:?}");
        assert!(tally.unsure < tally.cases * 9 / 10, "{tally:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        #[test]
        fn never_contradicts_it_from_any_seed(seed in any::<u64>()) {
            hunt(seed, 10_000);
        }
    }

    #[test]
    fn lanes_are_judged_alike() {
        let mut numbers = Numbers(5);
        for _ in 0..2_000 {
            let (ray, _) = case(&mut numbers);
            let prepared = Prepared::new(&ray);
            let Some(filter) = FilterRay::new(&prepared, 2.0) else { continue };
            let lanes: [[[f32; 3]; 3]; 4] = std::array::from_fn(|_| case(&mut numbers).1);
            let block: Block<4> = std::array::from_fn(|v| {
                std::array::from_fn(|a| std::array::from_fn(|lane| lanes[lane][v][a]))
            });
            let together = filter.judge(&block, f32::INFINITY);
            for lane in 0..4 {
                let alone = filter.judge(&lanes[lane].map(|v| v.map(|c| [c])), f32::INFINITY);
                assert_eq!(
                    (together.out >> lane & 1, together.inside >> lane & 1),
                    (alone.out, alone.inside)
                );
            }
        }
    }
}
