//! The f64 decisions about single rays of a bundle.

use super::bundle::{Bundle, Progress, lower, upper};
use super::questions::Batch;
use super::tree::{Block, SPHERE_CANDIDATE, WIDTH};
use crate::accel::tester::Tester;
use crate::geometry::record::Answer;
use crate::geometry::start::RADIUS;
use crate::geometry::triangle::Plane;
use crate::geometry::{NONE, norm_max};
use crate::scene::mesh::is_guest;

impl Bundle {
    /// A lane's ray with what has been decided of it.
    fn tester<'a>(&self, batch: &Batch<'a, '_>, lane: usize) -> Tester<'a> {
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
        batch: &Batch,
        lane: usize,
        progress: &mut Progress,
        (block, are_spheres): (&Block, bool),
        mut open: u32,
    ) -> bool {
        if !are_spheres {
            open = self.not_beyond(batch.walked.starts_extent, lane, block, open);
            if open == 0 {
                return false;
            }
        }
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

    /// Which of these triangles aren't surely met beyond all that counts. A shadow ray ends just before the lamp it goes to: it needs no more than this to pass it.
    ///
    /// t is that of `triangle::intersect` wherever the plane is neither grazed nor so near to the origin that a start on a surface matters.
    fn not_beyond(&self, starts_extent: f64, lane: usize, block: &Block, mut open: u32) -> u32 {
        let exact = &self.exact;
        let t_best = self.t_best(lane);
        // How far the start's own triangle reaches is known of those of this part alone.
        if t_best == f64::INFINITY || exact.moved[lane] != 0.0 || is_guest(self.start[lane]) {
            return open;
        }
        let [origin, direction] = exact.line(lane);
        let radius = 2.0 * RADIUS * (norm_max(origin) + starts_extent);
        let mut left = open;
        while left != 0 {
            let k = left.trailing_zeros() as usize;
            left &= left - 1;
            let plane = Plane::seen(origin, direction, &corners(block, k));
            if plane.is_upright() && plane.height.abs() > radius * plane.size && plane.t() > t_best {
                open &= !(1 << k);
            }
        }
        open
    }

    /// Settles the candidate where what has been decided doesn't lie clear of it.
    fn reconcile(&mut self, batch: &Batch, lane: usize, progress: &mut Progress) {
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
    pub fn settle(&mut self, batch: &Batch, lane: usize, progress: &mut Progress) {
        let (block, k) = batch.walked.tree.candidate(progress.candidate);
        let mut tester = self.tester(batch, lane);
        let is_sphere = progress.candidate & SPHERE_CANDIDATE != 0;
        let t = if is_sphere { tester.meet_sphere(block.ids[k]) } else { None };
        let hit = if is_sphere { None } else { tester.meet(&corners(block, k)) };
        let t = t.or(hit.as_ref().map(|hit| hit.t)).map(|t| t - self.exact.moved[lane]);
        let off = self.exact.moved_off[lane];
        if t.is_some_and(|t| t + off >= f64::from(progress.low) && t - off <= f64::from(progress.high)) {
            if is_sphere {
                tester.test(block.ids[k]);
            } else {
                tester.offer_hit(block.ids[k], hit);
            }
            self.keep_best(lane, &tester);
        } else {
            self.contradicted |= 1 << lane;
        }
        progress.forget();
    }

    /// What has been decided of a lane whose candidate is settled.
    pub fn answer(&self, batch: &Batch, lane: usize) -> Answer {
        match self.any >> lane & 1 == 1 {
            true if self.found >> lane & 1 == 1 => Answer { primitive: 0, ..Answer::MISS },
            false if self.decided >> lane & 1 == 1 => self.tester(batch, lane).verdict(false),
            _ => Answer::MISS,
        }
    }
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
