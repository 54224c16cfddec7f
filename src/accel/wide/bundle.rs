//! 64 rays side by side: what the f32 kernels need of them, and what has been found for them.
//!
//! Boxes. u = 2^-24, L = |origin|∞ + extent. Slabs are (plane · inverse) - (origin ± 12uL) · inverse. In units of uL |inverse| the origin's rounding, its sum and product take 3,
//! the result 2, and the inverse, the same in both terms and off by 2.5u of itself, 5: so entries are never late and exits never early. An inverse beyond 1e18 is cut to
//! that: it only brings entries nearer.
//! An origin far outside is first moved along the ray to the scene's box, in f64; all t of the f32 kernels count from there.

use super::filter::{FilterRay, U, deltas, holds, over_square, terms};
use super::lanes::Eight;
use super::questions::{Batch, Questions, Walked};
use crate::accel::tester::Best;
use crate::geometry::bounds::Slabs;
use crate::geometry::{NONE, Prepared, Ray, dot, norm_max, of_axis};

/// Rays of a bundle: a bit of a `u64` for each.
pub const RAYS: usize = 64;
/// Cut of 1 / direction.
const STEEPEST: f32 = 1e18;
/// An origin farther from the scene's box than this many of its sizes is moved.
const NEAR_ENOUGH: f64 = 4.0;
/// No f32 rounds to more than this part of itself aside.
const ROUNDING: f32 = 1.0 / 8_388_608.0;
/// Put aside of every t beside that: far below what the filter can tell, yet no denormal number, which processors are slow with.
const LEAST: f32 = 1e-30;

/// What has been found for a ray on its way.
///
/// A triangle that is surely met, at a t known to within bounds, is a candidate: it ends the search behind it without having been decided.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Nothing that is entered behind this is wanted.
    pub limit: f32,
    /// What is met after the first and up to the second is surely within the range.
    pub sure: [f32; 2],
    /// Bounds of the candidate's t, infinite where there is none.
    pub low: f32,
    pub high: f32,
    /// Its block times eight plus its lane, with [`SPHERE_CANDIDATE`] if it is a sphere, or [`NONE`].
    pub candidate: u32,
}

/// What f64 knows of the rays.
#[repr(C, align(64))]
pub struct Exact {
    /// The origin, or the point that it was moved to.
    pub origin: [[f64; RAYS]; 3],
    /// Scaled, as all t are: its largest component lies in [1, 2).
    pub direction: [[f64; RAYS]; 3],
    pub t_min: [f64; RAYS],
    pub t_max: [f64; RAYS],
    pub scale: [f64; RAYS],
    /// Where the t of f32 counts from.
    pub moved: [f64; RAYS],
    /// How far off the t of a decision may be, of an origin that was moved.
    pub moved_off: [f64; RAYS],
    /// Whether any was.
    any_moved: bool,
}

impl Exact {
    /// A lane's origin and direction.
    #[inline(always)]
    pub fn line(&self, lane: usize) -> [[f64; 3]; 2] {
        let of = |vector: &[[f64; RAYS]; 3]| [vector[0][lane], vector[1][lane], vector[2][lane]];
        [of(&self.origin), of(&self.direction)]
    }
}

/// Rays side by side, each in its lane.
#[repr(C, align(64))]
pub struct Bundle {
    pub inverse: [[f32; RAYS]; 3],
    /// The origin's products with `inverse`, for the nearer and the farther planes.
    pub near_origin: [[f32; RAYS]; 3],
    pub far_origin: [[f32; RAYS]; 3],
    pub origin: [[f32; RAYS]; 3],
    pub direction: [[f32; RAYS]; 3],
    pub shear: [[f32; RAYS]; 2],
    pub inverse_z: [f32; RAYS],
    /// See [`Rays::over_square`](super::filter::Rays::over_square).
    pub over_square: [f32; RAYS],
    pub t_min: [f32; RAYS],
    pub limit: [f32; RAYS],
    pub sure: [[f32; RAYS]; 2],
    pub low: [f32; RAYS],
    pub high: [f32; RAYS],
    pub candidate: [u32; RAYS],
    /// The primitive that the ray starts on.
    pub start: [u32; RAYS],
    /// The axis of the direction's largest component times 8, plus the signs of its components: bit k for a negative component k.
    pub class: [u32; RAYS],
    pub exact: Exact,
    pub best: [Best; RAYS],
    /// Lanes with a decided hit.
    pub decided: u64,
    /// Lanes that ask for any hit, and those of them that have one.
    pub any: u64,
    pub found: u64,
    /// Lanes of which a bound was wrong: those are to be walked again without putting anything off.
    pub contradicted: u64,
    /// Bounds of the errors of all lanes; see [`deltas`].
    pub delta: f32,
    pub t_delta: f32,
    /// See [`terms`].
    pub linear: f32,
    pub squared: f32,
    /// What slabs are padded by.
    pub pad: f32,
    /// Whether f32 can hold the filter's numbers of all lanes.
    pub filters: bool,
    /// Which of the batch's rays lane 0 holds, and how many lanes are filled.
    pub first: usize,
    pub count: usize,
}

/// A mask of the first lanes.
#[inline(always)]
pub fn first_lanes(count: usize) -> u64 {
    if count >= RAYS { u64::MAX } else { (1 << count) - 1 }
}

/// kx, ky, kz of a class.
#[inline(always)]
pub fn axes(class: u32) -> [usize; 3] {
    match class >> 3 {
        0 => [1, 2, 0],
        1 => [2, 0, 1],
        _ => [0, 1, 2],
    }
}

impl Bundle {
    /// Nothing in it.
    pub fn empty() -> Box<Bundle> {
        const NOTHING: [f32; RAYS] = [0.0; RAYS];
        const NOWHERE: [f64; RAYS] = [0.0; RAYS];
        Box::new(Bundle {
            inverse: [NOTHING; 3],
            near_origin: [NOTHING; 3],
            far_origin: [NOTHING; 3],
            origin: [NOTHING; 3],
            direction: [NOTHING; 3],
            shear: [NOTHING; 2],
            inverse_z: NOTHING,
            over_square: NOTHING,
            t_min: NOTHING,
            limit: NOTHING,
            sure: [NOTHING; 2],
            low: NOTHING,
            high: NOTHING,
            candidate: [NONE; RAYS],
            start: [NONE; RAYS],
            class: [0; RAYS],
            exact: Exact {
                origin: [NOWHERE; 3],
                direction: [NOWHERE; 3],
                scale: NOWHERE,
                t_min: NOWHERE,
                t_max: NOWHERE,
                moved: NOWHERE,
                moved_off: NOWHERE,
                any_moved: false,
            },
            best: [Best::NONE; RAYS],
            decided: 0,
            any: 0,
            found: 0,
            contradicted: 0,
            delta: 0.0,
            t_delta: 0.0,
            linear: 0.0,
            squared: 0.0,
            pad: 0.0,
            filters: true,
            first: 0,
            count: 0,
        })
    }

    /// Takes rays of the batch, from `first` on. Loops over lanes are written so that the compiler makes vectors of them.
    ///
    /// # Safety
    /// The level's instructions are there; there are `count` rays, at most [`RAYS`].
    #[inline(always)]
    pub unsafe fn fill<E: Eight>(
        &mut self,
        batch: &Batch,
        questions: &impl Questions,
        first: usize,
        count: usize,
    ) {
        let exact = &mut self.exact;
        // SAFETY: the caller's promise.
        self.any = unsafe { questions.gather::<E>(first, count, exact, &mut self.start) };
        (self.first, self.count) = (first, count);
        (self.decided, self.found, self.contradicted) = (0, 0, 0);
        // All lanes are filled and worked on: loops of a known length are the fastest.
        for lane in count..RAYS {
            for axis in 0..3 {
                exact.origin[axis][lane] = exact.origin[axis][0];
                exact.direction[axis][lane] = exact.direction[axis][0];
            }
            (exact.t_min[lane], exact.t_max[lane]) = (exact.t_min[0], exact.t_max[0]);
        }
        self.approach(batch);
        self.scale();
        self.round();
    }

    /// Moves origins that are far outside, before their directions are scaled, and tells how far from 0 all of them lie.
    #[inline(always)]
    fn approach(&mut self, batch: &Batch) {
        let extent = batch.walked.extent;
        if self.exact.any_moved {
            (self.exact.moved, self.exact.moved_off) = ([0.0; RAYS], [0.0; RAYS]);
            self.exact.any_moved = false;
        }
        let (mut nearest, mut farthest) = self.distances();
        let mut off = 0.0;
        if farthest > NEAR_ENOUGH * extent {
            off = self.come_near(batch);
            (nearest, farthest) = self.distances();
        }
        let length = farthest + extent;
        self.filters = holds(length) && holds(nearest + extent);
        (self.delta, self.t_delta) = deltas(length, off, off);
        (self.linear, self.squared) = terms(self.delta);
        self.pad = (12.0 * U * length + 2.0 * off) as f32;
    }

    /// The least and the largest |origin|∞.
    #[inline(always)]
    fn distances(&self) -> (f64, f64) {
        let [x, y, z] = &self.exact.origin;
        // As bits, whose order is that of numbers without a sign: those the compiler compares in vectors.
        let (mut nearest, mut farthest) = (u64::MAX, 0);
        for lane in 0..RAYS {
            let (x, y, z) = (x[lane].abs().to_bits(), y[lane].abs().to_bits(), z[lane].abs().to_bits());
            let away = x.max(y).max(z);
            (nearest, farthest) = (nearest.min(away), farthest.max(away));
        }
        (f64::from_bits(nearest), f64::from_bits(farthest))
    }

    /// Moves what lies far outside; how far off any t may be by that.
    #[cold]
    fn come_near(&mut self, batch: &Batch) -> f64 {
        let (mut most, exact) = (0.0, &mut self.exact);
        for lane in 0..RAYS {
            // Lanes that aren't filled repeat the first.
            let asked = if lane < self.count { lane } else { 0 };
            let ray = batch.questions.question(self.first + asked).0;
            if norm_max(ray.origin.to_array()) > NEAR_ENOUGH * batch.walked.extent {
                let (moved, off, from) = move_to_box(batch.walked, &ray);
                (exact.moved[lane], exact.moved_off[lane]) = (moved, off);
                exact.any_moved = true;
                most = f64::max(most, off);
                for axis in 0..3 {
                    exact.origin[axis][lane] = from[axis];
                }
            }
        }
        most
    }

    /// Scales the directions as [`Prepared::new`] does, and rounds them and the origins.
    #[inline(always)]
    fn scale(&mut self) {
        let Exact { direction: [x, y, z], scale, t_min, t_max, .. } = &mut self.exact;
        for lane in 0..RAYS {
            let d = [x[lane], y[lane], z[lane]];
            let [a, b, c] = [d[0].abs(), d[1].abs(), d[2].abs()];
            let along_x = (a > b) & (a > c);
            let along_y = (a <= b) & (b > c);
            let largest = of_axis(along_x, along_y, [a, b, c]);
            let exponent = ((largest.to_bits() >> 52) & 0x7ff).clamp(1, 2045);
            let up = f64::from_bits((2046 - exponent) << 52);
            let down = f64::from_bits(exponent << 52);
            (x[lane], y[lane], z[lane]) = (d[0] * up, d[1] * up, d[2] * up);
            scale[lane] = up;
            t_min[lane] *= down;
            t_max[lane] *= down;
            let signs = d[0].to_bits() >> 63 | (d[1].to_bits() >> 63) << 1 | (d[2].to_bits() >> 63) << 2;
            let axis = of_axis(along_x, along_y, [0, 8, 16]);
            self.class[lane] = signs as u32 + axis;
        }
        for axis in 0..3 {
            for lane in 0..RAYS {
                self.direction[axis][lane] = self.exact.direction[axis][lane] as f32;
                self.origin[axis][lane] = self.exact.origin[axis][lane] as f32;
            }
        }
    }

    /// What f32 needs, rounded the safe way.
    #[inline(always)]
    fn round(&mut self) {
        let pad = self.pad;
        for axis in 0..3 {
            for lane in 0..RAYS {
                let direction = self.direction[axis][lane];
                let cut = STEEPEST.copysign(direction);
                let inverse = if direction.abs() < 1.0 / STEEPEST { cut } else { 1.0 / direction };
                let (origin, pad) = (self.origin[axis][lane], pad.copysign(direction));
                self.inverse[axis][lane] = inverse;
                self.near_origin[axis][lane] = (origin + pad) * inverse;
                self.far_origin[axis][lane] = (origin - pad) * inverse;
            }
        }
        let ([ix, iy, iz], [dx, dy, dz]) = (&self.inverse, &self.direction);
        for lane in 0..RAYS {
            let axis = self.class[lane] >> 3;
            let along = [mask(axis == 0), mask(axis == 1), mask(axis == 2)];
            let inverse_z = one_of(along, [ix[lane], iy[lane], iz[lane]]);
            self.inverse_z[lane] = inverse_z;
            let shear = [
                one_of(along, [dy[lane], dz[lane], dx[lane]]) * inverse_z,
                one_of(along, [dz[lane], dx[lane], dy[lane]]) * inverse_z,
            ];
            (self.shear[0][lane], self.shear[1][lane]) = (shear[0], shear[1]);
            self.over_square[lane] = over_square(shear);
        }
        let exact = &self.exact;
        if exact.any_moved {
            for lane in 0..RAYS {
                let (moved, off) = (exact.moved[lane], exact.moved_off[lane]);
                let (begin, end) = (exact.t_min[lane] - moved, exact.t_max[lane] - moved);
                (self.t_min[lane], self.sure[0][lane]) = (lower(begin - off), upper(begin + off));
                (self.sure[1][lane], self.limit[lane]) = (lower(end - off), upper(end + off));
            }
        } else {
            for lane in 0..RAYS {
                (self.t_min[lane], self.limit[lane]) = (exact.t_min[lane] as f32, exact.t_max[lane] as f32);
            }
            // A loop of its own, over nothing but f32: twice as many at once.
            for lane in 0..RAYS {
                let (begin, end) = (self.t_min[lane], self.limit[lane]);
                (self.t_min[lane], self.sure[0][lane]) = (below(begin), -below(-begin));
                (self.sure[1][lane], self.limit[lane]) = (below(end), -below(-end));
            }
        }
        self.low = [f32::INFINITY; RAYS];
        self.high = [f32::INFINITY; RAYS];
        self.candidate = [NONE; RAYS];
    }

    #[inline(always)]
    pub fn progress(&self, lane: usize) -> Progress {
        Progress {
            limit: self.limit[lane],
            sure: [self.sure[0][lane], self.sure[1][lane]],
            low: self.low[lane],
            high: self.high[lane],
            candidate: self.candidate[lane],
        }
    }

    #[inline(always)]
    pub fn keep(&mut self, lane: usize, progress: &Progress) {
        self.limit[lane] = progress.limit;
        [self.sure[0][lane], self.sure[1][lane]] = progress.sure;
        (self.low[lane], self.high[lane]) = (progress.low, progress.high);
        self.candidate[lane] = progress.candidate;
    }

    /// A lane's ray for the filter.
    #[inline(always)]
    pub fn filter_ray(&self, lane: usize) -> FilterRay {
        let [kx, ky, kz] = axes(self.class[lane]);
        FilterRay {
            origin: [self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]],
            inverse_z: self.inverse_z[lane],
            shear: [self.shear[0][lane], self.shear[1][lane]],
            over_square: self.over_square[lane],
            linear: self.linear,
            squared: self.squared,
            t_delta: self.t_delta,
            axes: [kx as u8, ky as u8, kz as u8],
        }
    }
}

impl Progress {
    pub fn forget(&mut self) {
        (self.low, self.high, self.candidate) = (f32::INFINITY, f32::INFINITY, NONE);
    }
}

/// The larger of two numbers, neither of which is NaN: one instruction, where `f64::max` takes several.
#[inline(always)]
pub fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// An f32 at or below t, by at most an ulp or two. Infinity stays.
#[inline(always)]
pub fn lower(t: f64) -> f32 {
    below(t as f32)
}

/// The same of a rounded t: what rounding brought it up by is half an ulp at most, and an ulp is at most `ROUNDING` of it.
#[inline(always)]
fn below(t: f32) -> f32 {
    let less = t - t.abs() * ROUNDING - LEAST;
    if t.abs() < f32::INFINITY { less } else { t }
}

/// An f32 at or above t, by at most an ulp or two. Infinity stays.
#[inline(always)]
pub fn upper(t: f64) -> f32 {
    -lower(-t)
}

/// All bits or none.
#[inline(always)]
fn mask(is: bool) -> u32 {
    0u32.wrapping_sub(u32::from(is))
}

/// The number whose mask is set, without a branch: stores behind those become masked ones, which some processors take long over.
#[inline(always)]
fn one_of(masks: [u32; 3], [x, y, z]: [f32; 3]) -> f32 {
    f32::from_bits((x.to_bits() & masks[0]) | (y.to_bits() & masks[1]) | (z.to_bits() & masks[2]))
}

/// Where a ray from far outside comes to the scene's box: how far along, how far off the t of a decision may be, and the point. A ray that misses the box is left where it
/// passes it by.
#[cold]
fn move_to_box(walked: &Walked, ray: &Ray) -> (f64, f64, [f64; 3]) {
    let ray = Prepared::new(ray);
    let entered = Slabs::new(&ray, walked.extent).enter(walked.low, walked.high, ray.t_max);
    let moved = entered.unwrap_or(-dot(ray.origin, ray.direction) / dot(ray.direction, ray.direction));
    let from = std::array::from_fn(|axis| ray.origin[axis] + moved * ray.direction[axis]);
    // Rounding the point takes far less than the decision's t may be off: twice what `triangle::GRAZING` derives.
    (moved, (norm_max(ray.origin) + walked.extent) * (1.0 / (1u64 << 31) as f64), from)
}
