//! Many rays on their way through the tree at once on one thread: while one waits for memory, others go on.
//!
//! Boxes and triangles are judged in f32 with bounds (below and in `filter`); what counts as a hit is decided in f64 by [`Tester`] alone. That decision is put off:
//! a triangle that is surely met, at a t known to within a bound, ends the search behind it as well as a decided one. Only where the filter is unsure, or two
//! bounds overlap, f64 decides at once; else only of the last candidate, when the walk is over. Should it then contradict the bound (it
//! never has), the ray is walked again without putting anything off.
//!
//! Boxes. u = 2^-24, L = |origin|∞ + extent. Slabs are (plane · inverse) - (origin ± 8uL) · inverse: rounding inverse, the product with the origin, and the result makes
//! less than 4uL |inverse|, so entries are never late and exits never early. An inverse beyond 1e18 is cut to that: it only brings entries nearer.
//! An origin far outside is first moved along the ray to the scene's box, in f64; all t of this file count from there.

use super::filter::FilterRay;
use super::lanes::Lanes;
use super::tree::{Block, EMPTY, LEAF, Node, SPHERES, Tree, WIDTH};
use crate::accel::tester::Tester;
use crate::geometry::bounds::Slabs;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::geometry::{Ray, round_down, round_up};
use crate::scene::Surfaces;

/// Rays in flight.
pub const FLIGHT: usize = 24;
/// Rays at nodes are stepped as long as there are more of them than this; then those at leaves.
const FEW: u32 = 6;
/// Half an ulp of 1 in f32.
const U: f64 = 1.0 / 16_777_216.0;
/// Cut of 1 / direction.
const STEEPEST: f64 = 1e18;
/// An origin farther from the scene's box than this many of its sizes is moved.
const NEAR_ENOUGH: f64 = 4.0;

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

/// A triangle that is surely met, not yet decided.
#[derive(Clone, Copy)]
struct Candidate {
    block: u32,
    lane: u32,
    low: f32,
    high: f32,
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

/// One ray on its way.
struct Flight<'a> {
    tester: Tester<'a>,
    /// Which of the batch's rays it is.
    index: usize,
    any: bool,
    /// Whether decisions are put off.
    lazy: bool,
    /// Whether a bound was wrong, so that all is to be walked again.
    contradicted: bool,
    candidate: Option<Candidate>,
    inverse: [f32; 3],
    /// The origin's products with `inverse`, for the nearer and the farther planes.
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    /// Rows of `Node::planes` that are entered and left by.
    near: [u8; 3],
    far: [u8; 3],
    octant: usize,
    /// Where t counts from.
    moved: f64,
    /// What rounding in moving t may take.
    moved_off: f64,
    t_min: f32,
    /// What is met after the first and up to the second is surely within the range.
    sure: [f32; 2],
    /// Nothing that is entered behind this is wanted.
    limit: f32,
    /// `None` where f32 can't hold its numbers.
    filter: Option<FilterRay>,
    current: u32,
    waiting: usize,
}

/// The stack of each ray in flight; kept between batches.
#[derive(Default)]
pub struct Scratch {
    children: Vec<u32>,
    t: Vec<f32>,
}

impl<'a> Flight<'a> {
    /// `None` if the ray misses the scene's box.
    #[inline(always)]
    fn new(walked: &Walked<'a>, ray: &Ray, any: bool, index: usize, lazy: bool) -> Option<Self> {
        let tester = Tester::new(walked.surfaces, ray);
        let prepared = &tester.ray;
        let largest = |v: &[f64; 3]| v[0].abs().max(v[1].abs()).max(v[2].abs());
        let away = largest(&prepared.origin);
        let (mut moved, mut from) = (0.0, prepared.origin);
        let entered = Slabs::new(prepared, walked.extent).enter(walked.low, walked.high, prepared.t_max)?;
        if away > NEAR_ENOUGH * walked.extent {
            moved = entered;
            from = std::array::from_fn(|axis| prepared.origin[axis] + moved * prepared.direction[axis]);
        }
        // Of a moved origin, and of t counted from there.
        let moved_off = (away + moved.abs()) * (1.0 / (1u64 << 49) as f64);
        let length = largest(&from) + walked.extent;
        let pad = 8.0 * U * length + 2.0 * moved_off;
        let mut flight = Flight {
            index,
            any,
            lazy,
            contradicted: false,
            candidate: None,
            inverse: [0.0; 3],
            near_origin: [0.0; 3],
            far_origin: [0.0; 3],
            near: [0; 3],
            far: [0; 3],
            octant: 0,
            moved,
            moved_off,
            t_min: round_down(prepared.t_min - moved - moved_off),
            sure: [round_up(prepared.t_min - moved + moved_off); 2],
            limit: 0.0,
            filter: FilterRay::new(prepared, from, length, 2.0 * moved_off),
            current: 0,
            waiting: 0,
            tester,
        };
        for axis in 0..3 {
            let direction = flight.tester.ray.direction[axis];
            let backwards = direction.is_sign_negative();
            let inverse =
                if direction.abs() < 1.0 / STEEPEST { STEEPEST.copysign(direction) } else { 1.0 / direction };
            let pad = if backwards { -pad } else { pad };
            flight.inverse[axis] = inverse as f32;
            flight.near_origin[axis] = ((from[axis] + pad) * inverse) as f32;
            flight.far_origin[axis] = ((from[axis] - pad) * inverse) as f32;
            (flight.near[axis], flight.far[axis]) =
                if backwards { (axis as u8 + 3, axis as u8) } else { (axis as u8, axis as u8 + 3) };
            flight.octant |= usize::from(backwards) << axis;
        }
        flight.set_limit();
        Some(flight)
    }

    /// The limit that the best decided hit sets.
    #[inline(always)]
    fn set_limit(&mut self) {
        let t = self.tester.t_best - self.moved;
        self.limit = round_up(t + self.moved_off);
        self.sure[1] = round_down(t - self.moved_off);
    }

    /// Pushes the children of the current node that the ray enters.
    ///
    /// # Safety
    /// The level's instructions are there; the stack has room for eight more.
    #[inline(always)]
    unsafe fn enter<L: Lanes>(&mut self, node: &Node, children: *mut u32, t: *mut f32) {
        // SAFETY: the planes of a node are aligned as it is; the rest is the caller's promise.
        unsafe {
            let at = |row: u8, axis: usize, origin: &[f32; 3]| {
                let planes = L::load(node.planes.as_ptr().cast::<f32>().add(usize::from(row) * WIDTH));
                planes.mul_sub(L::splat(self.inverse[axis]), L::splat(origin[axis]))
            };
            let near = at(self.near[0], 0, &self.near_origin)
                .max(at(self.near[1], 1, &self.near_origin))
                .max(at(self.near[2], 2, &self.near_origin).max(L::splat(self.t_min)));
            let far = at(self.far[0], 0, &self.far_origin)
                .min(at(self.far[1], 1, &self.far_origin))
                .min(at(self.far[2], 2, &self.far_origin).min(L::splat(self.limit)));
            let order = node.order[self.octant];
            let (to, t) = (children.add(self.waiting), t.add(self.waiting));
            self.waiting += near.pack(far, order, node.children.as_ptr(), to, t);
        }
    }

    /// Takes the nearest waiting child that is still wanted; false if none is left.
    ///
    /// # Safety
    /// The stack holds `waiting` entries.
    #[inline(always)]
    unsafe fn next(&mut self, children: *const u32, t: *const f32) -> bool {
        while self.waiting > 0 {
            self.waiting -= 1;
            // SAFETY: below the number of entries.
            let (child, t) = unsafe { (*children.add(self.waiting), *t.add(self.waiting)) };
            if t <= self.limit {
                self.current = child;
                return true;
            }
        }
        false
    }

    /// Tests the primitives of the current block; whether the ray has found all that it asks.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn visit<L: Lanes>(&mut self, tree: &Tree) -> bool {
        let number = self.current >> 3 & (super::tree::MOST_BLOCKS as u32 - 1);
        let block = &tree.blocks[number as usize];
        let all = (2u32 << (self.current & 7)) - 1;
        let filter = match &self.filter {
            Some(filter) if self.current & SPHERES == 0 => filter,
            _ => return self.decide(tree, block, all),
        };
        // SAFETY: the caller's promise.
        let judged = unsafe { filter.judge::<L>(&block.corners, self.t_min, self.limit) };
        let open = all & !judged.out;
        if !self.lazy {
            return self.decide(tree, block, open);
        }
        let mut unsure = open & !judged.inside;
        let mut sure = open & judged.inside;
        while sure != 0 {
            let lane = sure.trailing_zeros();
            sure &= sure - 1;
            let (low, high) = (judged.low[lane as usize], judged.high[lane as usize]);
            if low > self.limit {
                continue;
            }
            let id = block.ids[lane as usize];
            // Where the ray starts, at the ends of its range and beside another candidate nothing is sure.
            let in_range = id != self.tester.start && low > self.sure[0] && high < self.sure[1];
            let apart = self.candidate.is_none_or(|other| high < other.low || other.high < low);
            if !in_range || !apart {
                unsure |= 1 << lane;
            } else if self.any {
                self.tester.found_surely(id);
                return true;
            } else if self.candidate.is_none_or(|other| high < other.low) {
                self.candidate = Some(Candidate { block: number, lane, low, high });
                self.limit = self.limit.min(high);
            }
        }
        unsure != 0 && self.decide(tree, block, unsure)
    }

    /// Settles the candidate where what has been decided doesn't lie clear of it.
    #[inline(always)]
    fn reconcile(&mut self, tree: &Tree) {
        if let Some(candidate) = self.candidate {
            let decided = self.tester.t_best - self.moved;
            if decided + self.moved_off < f64::from(candidate.low) {
                self.candidate = None;
            } else if decided - self.moved_off <= f64::from(candidate.high) {
                self.settle(tree);
            }
        }
        let before = self.limit;
        self.set_limit();
        if self.candidate.is_some() {
            self.limit = self.limit.min(before);
        }
    }

    /// Decides the candidate.
    #[inline(never)]
    fn settle(&mut self, tree: &Tree) {
        let Some(candidate) = self.candidate.take() else { return };
        let block = &tree.blocks[candidate.block as usize];
        let lane = candidate.lane as usize;
        let corners = corners(block, lane);
        let hit = self.tester.meet(&corners);
        let t = hit.as_ref().map(|hit| hit.t - self.moved);
        let off = self.moved_off;
        if !t.is_some_and(|t| t + off >= f64::from(candidate.low) && t - off <= f64::from(candidate.high)) {
            self.contradicted = true;
            return;
        }
        self.tester.offer_hit(block.ids[lane], hit);
    }

    /// Puts the lanes of `open` to the f64 test; whether the ray has found all that it asks.
    #[inline(always)]
    fn decide(&mut self, tree: &Tree, block: &Block, mut open: u32) -> bool {
        let before = self.tester.t_best;
        while open != 0 {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            let id = block.ids[lane];
            if (id as usize) < self.tester.surfaces.triangles.len() {
                self.tester.test_corners(id, &corners(block, lane));
            } else {
                self.tester.test(id);
            }
            if self.any && self.tester.found() {
                return true;
            }
        }
        if self.tester.t_best < before {
            self.reconcile(tree);
        }
        false
    }
}

#[inline(always)]
fn corners(block: &Block, lane: usize) -> [[f64; 3]; 3] {
    std::array::from_fn(|vertex| std::array::from_fn(|axis| f64::from(block.corners[vertex][axis][lane])))
}

/// Answers all records, in their order.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn walk<'a, L: Lanes>(
    walked: &Walked<'a>,
    questions: &(impl Questions + ?Sized),
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    let size = walked.tree.stack_size;
    if scratch.children.len() < FLIGHT * size {
        scratch.children.resize(FLIGHT * size, 0);
        scratch.t.resize(FLIGHT * size, 0.0);
    }
    let (stacks, ts) = (scratch.children.as_mut_ptr(), scratch.t.as_mut_ptr());
    let tree = walked.tree;
    let mut flights: [Option<Flight<'a>>; FLIGHT] = [const { None }; FLIGHT];
    let mut taken = 0;
    let (mut at_nodes, mut at_leaves) = (0u32, 0u32);
    // Takes the next ray that meets the scene's box.
    let mut take = |answers: &mut [Answer]| {
        while taken < answers.len() {
            let index = taken;
            taken += 1;
            let (ray, any) = questions.question(index);
            match Flight::new(walked, &ray, any, index, true) {
                Some(flight) => return Some(flight),
                None => answers[index] = Answer::MISS,
            }
        }
        None
    };
    for (lane, place) in flights.iter_mut().enumerate() {
        *place = take(answers);
        at_nodes |= u32::from(place.is_some()) << lane;
    }
    while at_nodes | at_leaves != 0 {
        let leaves = at_nodes == 0 || (at_leaves != 0 && at_nodes.count_ones() <= FEW);
        let mut turn = if leaves { at_leaves } else { at_nodes };
        while turn != 0 {
            let lane = turn.trailing_zeros() as usize;
            turn &= turn - 1;
            let Some(flight) = &mut flights[lane] else { continue };
            // SAFETY: each lane has `size` places, more than the deepest walk takes and eight to spare; `current` names a node or block of the
            // tree, as all children do; the level's instructions are the caller's promise.
            let goes_on = unsafe {
                let (children, t) = (stacks.add(lane * size), ts.add(lane * size));
                let done = if leaves {
                    flight.visit::<L>(tree)
                } else {
                    flight.enter::<L>(tree.nodes.get_unchecked(flight.current as usize), children, t);
                    false
                };
                !done && flight.next(children, t)
            };
            if !goes_on {
                if flight.candidate.is_some() {
                    flight.settle(tree);
                }
                let (index, any) = (flight.index, flight.any);
                if flight.contradicted {
                    flights[lane] = Flight::new(walked, &questions.question(index).0, any, index, false);
                } else {
                    answers[index] = flight.tester.verdict(any);
                    flights[lane] = take(answers);
                }
            }
            let (node_bit, bit) = match &flights[lane] {
                None => (0, 0),
                Some(flight) => {
                    prefetch(tree, flight.current);
                    (u32::from(flight.current & LEAF == 0) << lane, 1u32 << lane)
                }
            };
            at_nodes = at_nodes & !(1 << lane) | node_bit;
            at_leaves = at_leaves & !(1 << lane) | (bit & !node_bit);
        }
    }
}

#[inline(always)]
fn prefetch(tree: &Tree, child: u32) {
    debug_assert_ne!(child, EMPTY);
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let (from, bytes): (*const i8, usize) = if child & LEAF == 0 {
            (tree.nodes.as_ptr().wrapping_add(child as usize).cast(), size_of::<Node>())
        } else {
            let number = child >> 3 & (super::tree::MOST_BLOCKS as u32 - 1);
            (tree.blocks.as_ptr().wrapping_add(number as usize).cast(), size_of::<Block>())
        };
        for line in (0..bytes).step_by(64) {
            // SAFETY: a hint; any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.wrapping_add(line)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (tree, child);
}
