//! 64 rays side by side: what the f32 kernels need of them, what has been found for them, and the f64 decisions about single rays.
//!
//! Boxes. u = 2^-24, L = |origin|∞ + extent. Slabs are (plane · inverse) - (origin ± 12uL) · inverse. In units of uL |inverse| the origin's rounding, its sum and product take 3,
//! the result 2, and the inverse, the same in both terms and off by 2.5u of itself, 5: so entries are never late and exits never early. An inverse beyond 1e18 is cut to
//! that: it only brings entries nearer.
//! An origin far outside is first moved along the ray to the scene's box, in f64; all t of the f32 kernels count from there.

use super::filter::{FilterRay, U, deltas, holds};
use super::tree::{Block, Tree, WIDTH};
use crate::accel::tester::{Best, Tester};
use crate::geometry::bounds::Slabs;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::geometry::{NONE, Prepared, Ray, dot, norm_max};
use crate::scene::Surfaces;

/// Rays of a bundle: a bit of a `u64` for each.
pub const RAYS: usize = 64;
/// Cut of 1 / direction.
const STEEPEST: f32 = 1e18;
/// An origin farther from the scene's box than this many of its sizes is moved.
const NEAR_ENOUGH: f64 = 4.0;
/// No f32 rounds to more than this part of itself aside.
const ROUNDING: f64 = 1.0 / 8_388_608.0;

/// What is walked.
#[derive(Clone, Copy)]
pub struct Walked<'a> {
    pub tree: &'a Tree,
    pub surfaces: &'a Surfaces,
    /// The largest magnitude of a coordinate of the boxes.
    pub extent: f64,
    /// Corners of the scene's box.
    pub low: [f32; 3],
    pub high: [f32; 3],
}

/// The rays of a batch.
pub trait Questions {
    /// A ray, and whether anything that it meets will do.
    fn question(&self, index: usize) -> (Ray, bool);
}

impl Questions for [RayRecord] {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (self[index].ray(), self[index].query() == Query::Occluded)
    }
}

impl Questions for (&[Ray], bool) {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (self.0[index], self.1)
    }
}

/// The batch, and what its rays go through.
pub struct Batch<'a, 'q, Q: ?Sized> {
    pub walked: &'q Walked<'a>,
    pub questions: &'q Q,
}

/// What has been found for a ray on its way.
///
/// A triangle that is surely met, at a t known to within bounds, is a candidate: it ends the search behind it without having been decided.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Nothing that is entered behind this is wanted.
    pub limit: f32,
    /// What is met after the first and up to the second is surely within the range.
    pub sure: [f32; 2],
    /// Bounds of the candidate's t, infinite where there is none.
    pub low: f32,
    pub high: f32,
    /// Its block times eight plus its lane, or [`NONE`].
    pub candidate: u32,
}

/// What f64 knows of the rays.
#[repr(C, align(64))]
pub struct Exact {
    /// The origin, or the point that it was moved to.
    pub origin: [[f64; RAYS]; 3],
    /// Scaled, as all t are: its largest component lies in [1, 2).
    pub direction: [[f64; RAYS]; 3],
    pub shear: [[f64; RAYS]; 2],
    pub scale: [f64; RAYS],
    pub t_min: [f64; RAYS],
    pub t_max: [f64; RAYS],
    /// Where the t of f32 counts from.
    pub moved: [f64; RAYS],
    /// How far off the t of a decision may be, of an origin that was moved.
    pub moved_off: [f64; RAYS],
}

/// Rays side by side, each in its lane.
#[repr(C, align(64))]
pub struct Bundle {
    pub inverse: [[f32; RAYS]; 3],
    /// The origin's products with `inverse`, for the nearer and the farther planes.
    pub near_origin: [[f32; RAYS]; 3],
    pub far_origin: [[f32; RAYS]; 3],
    pub origin: [[f32; RAYS]; 3],
    pub shear: [[f32; RAYS]; 2],
    pub inverse_z: [f32; RAYS],
    pub delta: [f32; RAYS],
    pub t_delta: [f32; RAYS],
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
    best: [Best; RAYS],
    /// Lanes with a decided hit.
    decided: u64,
    /// Lanes that ask for any hit, and those of them that have one.
    pub any: u64,
    pub found: u64,
    /// Lanes of which a bound was wrong: those are to be walked again without putting anything off.
    pub contradicted: u64,
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
            shear: [NOTHING; 2],
            inverse_z: NOTHING,
            delta: NOTHING,
            t_delta: NOTHING,
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
                shear: [NOWHERE; 2],
                scale: NOWHERE,
                t_min: NOWHERE,
                t_max: NOWHERE,
                moved: NOWHERE,
                moved_off: NOWHERE,
            },
            best: [Best::NONE; RAYS],
            decided: 0,
            any: 0,
            found: 0,
            contradicted: 0,
            filters: true,
            first: 0,
            count: 0,
        })
    }

    /// Takes rays of the batch, from `first` on. Loops over lanes are written so that the compiler makes vectors of them.
    #[inline(always)]
    pub fn fill(&mut self, batch: &Batch<impl Questions + ?Sized>, first: usize, count: usize) {
        let count = count.min(RAYS);
        self.gather(batch, first, count);
        let filled = count.next_multiple_of(16).min(RAYS);
        for lane in count..filled {
            for axis in 0..3 {
                self.exact.origin[axis][lane] = self.exact.origin[axis][0];
                self.exact.direction[axis][lane] = self.exact.direction[axis][0];
            }
            (self.exact.t_min[lane], self.exact.t_max[lane]) = (self.exact.t_min[0], self.exact.t_max[0]);
            self.exact.moved[lane] = self.exact.moved[0];
            self.exact.moved_off[lane] = self.exact.moved_off[0];
        }
        self.shear(filled);
        self.round(batch.walked.extent, filled);
    }

    /// Reads the rays as they are asked.
    #[inline(always)]
    fn gather(&mut self, batch: &Batch<impl Questions + ?Sized>, first: usize, count: usize) {
        (self.first, self.count) = (first, count);
        (self.decided, self.any, self.found, self.contradicted) = (0, 0, 0, 0);
        let farthest = NEAR_ENOUGH * batch.walked.extent;
        let exact = &mut self.exact;
        for lane in 0..count {
            let (ray, any) = batch.questions.question(first + lane);
            let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
            for axis in 0..3 {
                exact.origin[axis][lane] = origin[axis];
                exact.direction[axis][lane] = direction[axis];
            }
            (exact.t_min[lane], exact.t_max[lane]) = (ray.t_min, ray.t_max);
            (exact.moved[lane], exact.moved_off[lane]) = (0.0, 0.0);
            self.start[lane] = ray.start;
            self.any |= u64::from(any) << lane;
            if norm_max(origin) > farthest {
                let (moved, off, from) = move_to_box(batch.walked, &ray);
                (exact.moved[lane], exact.moved_off[lane]) = (moved, off);
                for axis in 0..3 {
                    exact.origin[axis][lane] = from[axis];
                }
            }
        }
    }

    /// What [`Prepared::new`] does, for all lanes.
    #[inline(always)]
    fn shear(&mut self, filled: usize) {
        let filled = filled.min(RAYS);
        let Exact { direction: [x, y, z], shear: [shear_x, shear_y], scale, t_min, t_max, .. } =
            &mut self.exact;
        for lane in 0..filled {
            let d = [x[lane], y[lane], z[lane]];
            let [a, b, c] = [d[0].abs(), d[1].abs(), d[2].abs()];
            let along_x = (a > b) & (a > c);
            let along_y = (a <= b) & (b > c);
            let largest = if along_x {
                a
            } else if along_y {
                b
            } else {
                c
            };
            let exponent = ((largest.to_bits() >> 52) & 0x7ff).clamp(1, 2045);
            let up = f64::from_bits((2046 - exponent) << 52);
            let down = f64::from_bits(exponent << 52);
            let d = [d[0] * up, d[1] * up, d[2] * up];
            (x[lane], y[lane], z[lane]) = (d[0], d[1], d[2]);
            let first = if along_x {
                d[1]
            } else if along_y {
                d[2]
            } else {
                d[0]
            };
            let second = if along_x {
                d[2]
            } else if along_y {
                d[0]
            } else {
                d[1]
            };
            let main = if along_x {
                d[0]
            } else if along_y {
                d[1]
            } else {
                d[2]
            };
            shear_x[lane] = first / main;
            shear_y[lane] = second / main;
            scale[lane] = up;
            t_min[lane] *= down;
            t_max[lane] *= down;
            self.inverse_z[lane] = (1.0 / main) as f32;
            let signs = d[0].to_bits() >> 63 | (d[1].to_bits() >> 63) << 1 | (d[2].to_bits() >> 63) << 2;
            self.class[lane] = signs as u32
                + if along_x {
                    0
                } else if along_y {
                    8
                } else {
                    16
                };
        }
    }

    /// What f32 needs, rounded the safe way.
    #[inline(always)]
    fn round(&mut self, extent: f64, filled: usize) {
        let filled = filled.min(RAYS);
        let exact = &self.exact;
        let mut pads = [0.0f32; RAYS];
        let mut filters = true;
        for lane in 0..filled {
            let away =
                exact.origin[0][lane].abs().max(exact.origin[1][lane].abs()).max(exact.origin[2][lane].abs());
            let (length, off) = (away + extent, exact.moved_off[lane]);
            filters &= holds(length);
            (self.delta[lane], self.t_delta[lane]) = deltas(length, off, off);
            pads[lane] = (12.0 * U * length + 2.0 * off) as f32;
        }
        self.filters = filters;
        for axis in 0..3 {
            for lane in 0..filled {
                let direction = exact.direction[axis][lane] as f32;
                let cut = STEEPEST.copysign(direction);
                let inverse = if direction.abs() < 1.0 / STEEPEST { cut } else { 1.0 / direction };
                let (origin, pad) = (exact.origin[axis][lane] as f32, pads[lane].copysign(direction));
                self.inverse[axis][lane] = inverse;
                self.origin[axis][lane] = origin;
                self.near_origin[axis][lane] = (origin + pad) * inverse;
                self.far_origin[axis][lane] = (origin - pad) * inverse;
            }
        }
        for component in 0..2 {
            for lane in 0..filled {
                self.shear[component][lane] = exact.shear[component][lane] as f32;
            }
        }
        for lane in 0..filled {
            let (moved, off) = (exact.moved[lane], exact.moved_off[lane]);
            let begin = exact.t_min[lane] - moved;
            self.t_min[lane] = lower(begin - off);
            self.sure[0][lane] = upper(begin + off);
            let end = exact.t_max[lane] - moved;
            self.limit[lane] = upper(end + off);
            self.sure[1][lane] = lower(end - off);
            self.low[lane] = f32::INFINITY;
            self.high[lane] = f32::INFINITY;
            self.candidate[lane] = NONE;
        }
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
            axes: [kx as u8, ky as u8, kz as u8],
            origin: [self.origin[kx][lane], self.origin[ky][lane], self.origin[kz][lane]],
            shear: [self.shear[0][lane], self.shear[1][lane]],
            inverse_z: self.inverse_z[lane],
            delta: self.delta[lane],
            t_delta: self.t_delta[lane],
        }
    }

    /// A lane's ray with what has been decided of it.
    fn tester<'a>(&self, batch: &Batch<'a, '_, impl Questions + ?Sized>, lane: usize) -> Tester<'a> {
        let mut tester = Tester::new(batch.walked.surfaces, &batch.questions.question(self.first + lane).0);
        if self.decided >> lane & 1 == 1 {
            tester.resume(&self.best[lane]);
        }
        tester
    }

    /// The least decided t of a lane, or its ray's end.
    fn t_best(&self, lane: usize) -> f64 {
        if self.decided >> lane & 1 == 1 { self.best[lane].t } else { self.exact.t_max[lane] }
    }

    fn keep_best(&mut self, lane: usize, tester: &Tester) {
        if tester.found() {
            self.best[lane] = tester.best();
            self.decided |= 1 << lane;
        }
    }

    /// Puts the primitives `open` of a block to the f64 test; whether the ray has found all that it asks.
    #[inline(never)]
    pub fn decide(
        &mut self,
        batch: &Batch<impl Questions + ?Sized>,
        lane: usize,
        progress: &mut Progress,
        (block, are_spheres): (&Block, bool),
        mut open: u32,
    ) -> bool {
        let mut tester = self.tester(batch, lane);
        let before = tester.t_best;
        while open != 0 {
            let k = open.trailing_zeros() as usize;
            open &= open - 1;
            let id = block.ids[k];
            if are_spheres {
                tester.test(id);
            } else {
                tester.test_corners(id, &corners(block, k));
            }
            if self.any >> lane & 1 == 1 && tester.found() {
                self.found |= 1 << lane;
                return true;
            }
        }
        self.keep_best(lane, &tester);
        if tester.t_best < before {
            self.reconcile(batch, lane, progress);
        }
        false
    }

    /// Settles the candidate where what has been decided doesn't lie clear of it.
    fn reconcile(&mut self, batch: &Batch<impl Questions + ?Sized>, lane: usize, progress: &mut Progress) {
        if progress.candidate != NONE {
            let (decided, off) = (self.t_best(lane) - self.exact.moved[lane], self.exact.moved_off[lane]);
            if decided + off < f64::from(progress.low) {
                progress.forget();
            } else if decided - off <= f64::from(progress.high) {
                self.settle(batch, lane, progress);
            }
        }
        let (t, off) = (self.t_best(lane) - self.exact.moved[lane], self.exact.moved_off[lane]);
        let limit = upper(t + off);
        progress.limit = if progress.candidate == NONE { limit } else { progress.limit.min(limit) };
        progress.sure[1] = lower(t - off);
    }

    /// Decides the candidate.
    #[inline(never)]
    pub fn settle(&mut self, batch: &Batch<impl Questions + ?Sized>, lane: usize, progress: &mut Progress) {
        let (number, k) = (progress.candidate >> 3, progress.candidate as usize & (WIDTH - 1));
        let block = &batch.walked.tree.blocks[number as usize];
        let mut tester = self.tester(batch, lane);
        let hit = tester.meet(&corners(block, k));
        let t = hit.as_ref().map(|hit| hit.t - self.exact.moved[lane]);
        let off = self.exact.moved_off[lane];
        if t.is_some_and(|t| t + off >= f64::from(progress.low) && t - off <= f64::from(progress.high)) {
            tester.offer_hit(block.ids[k], hit);
            self.keep_best(lane, &tester);
        } else {
            self.contradicted |= 1 << lane;
        }
        progress.forget();
    }

    /// What has been decided of a lane whose candidate is settled.
    pub fn answer(&self, batch: &Batch<impl Questions + ?Sized>, lane: usize) -> Answer {
        match self.any >> lane & 1 == 1 {
            true if self.found >> lane & 1 == 1 => Answer { primitive: 0, ..Answer::MISS },
            false if self.decided >> lane & 1 == 1 => self.tester(batch, lane).verdict(false),
            _ => Answer::MISS,
        }
    }
}

impl Progress {
    fn forget(&mut self) {
        (self.low, self.high, self.candidate) = (f32::INFINITY, f32::INFINITY, NONE);
    }
}

/// An f32 at or below t, by at most an ulp or two. Infinity stays.
#[inline(always)]
fn lower(t: f64) -> f32 {
    let t = t.min(f64::MAX);
    (t - t.abs() * ROUNDING - 1e-44) as f32
}

/// An f32 at or above t, by at most an ulp or two. Infinity stays.
#[inline(always)]
fn upper(t: f64) -> f32 {
    -lower(-t)
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

#[inline(always)]
pub fn corners(block: &Block, lane: usize) -> [[f64; 3]; 3] {
    let mut corners = [[0.0; 3]; 3];
    for vertex in 0..3 {
        for axis in 0..3 {
            corners[vertex][axis] = f64::from(block.corners[vertex][axis][lane & (WIDTH - 1)]);
        }
    }
    corners
}
