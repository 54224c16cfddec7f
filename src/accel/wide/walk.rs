//! Many rays on their way through the tree at once on one thread: while one waits for memory, others go on.
//!
//! Boxes and triangles are judged in f32 with bounds (below and in `filter`); what counts as a hit is decided in f64 by [`Tester`] alone. That decision is put off:
//! a triangle that is surely met, at a t known to within a bound, ends the search behind it as well as a decided one. Only where the filter is unsure, or two
//! bounds overlap, f64 decides at once; else only of the last candidate, when the walk is over. Should it then contradict the bound (it
//! never has), the ray is walked again without putting anything off.
//!
//! Boxes. u = 2^-24, L = |origin|∞ + extent. Slabs are (plane · inverse) - (origin ± 12uL) · inverse. In units of uL |inverse| the origin's rounding, its sum and product take 3,
//! the result 2, and the inverse, the same in both terms and off by 2.5u of itself, 5: so entries are never late and exits never early. An inverse beyond 1e18 is cut to
//! that: it only brings entries nearer.
//! An origin far outside is first moved along the ray to the scene's box, in f64; all t of this file count from there.

use std::mem::MaybeUninit;

use super::filter::{FilterRay, U};
use super::lanes::Lanes;
use super::tree::{Block, EMPTY, LEAF, Node, SPHERES, Tree, WIDTH, block_number};
use crate::accel::tester::Tester;
use crate::geometry::bounds::Slabs;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::geometry::{Prepared, Ray, dot, norm_max, round_down, round_up};
use crate::scene::Surfaces;

/// Rays in flight.
pub const FLIGHT: usize = 24;
/// Rays at nodes are stepped as long as there are more of them than this; then those at leaves.
const FEW: u32 = 6;
/// Cut of 1 / direction.
const STEEPEST: f32 = 1e18;
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
struct Flight {
    /// Which of the batch's rays it is.
    index: usize,
    start: u32,
    any: bool,
    /// Whether decisions are put off.
    lazy: bool,
    /// Whether a bound was wrong, so that all is to be walked again.
    contradicted: bool,
    /// Something is surely in the range of a ray that asks for no more.
    found: bool,
    /// Whether f32 can hold the filter's numbers.
    filters: bool,
    candidate: Option<Candidate>,
    inverse: [f32; 3],
    /// The origin's products with `inverse`, for the nearer and the farther planes.
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    /// Rows of `Node::planes` that are entered and left by.
    near: [u8; 3],
    far: [u8; 3],
    octant: u8,
    t_min: f32,
    /// What is met after the first and up to the second is surely within the range.
    sure: [f32; 2],
    /// Nothing that is entered behind this is wanted.
    limit: f32,
    filter: FilterRay,
    current: u32,
    waiting: usize,
    /// The least t decided, or the ray's end.
    t_best: f64,
    /// Where t counts from.
    moved: f64,
    /// How far off the t of a decision may be, of an origin that was moved.
    moved_off: f64,
}

/// What decides for a ray in flight, made when it first has to.
type Judge<'a> = Option<Tester<'a>>;

/// The batch, and what its rays go through.
struct Batch<'a, 'q, Q: ?Sized> {
    walked: &'q Walked<'a>,
    questions: &'q Q,
}

impl<'a, Q: Questions + ?Sized> Batch<'a, '_, Q> {
    #[inline(never)]
    fn judge(&self, index: usize) -> Tester<'a> {
        Tester::new(self.walked.surfaces, &self.questions.question(index).0)
    }
}

/// The stack of each ray in flight; kept between batches.
#[derive(Default)]
pub struct Scratch {
    children: Vec<u32>,
    t: Vec<f32>,
}

impl Flight {
    #[inline(always)]
    fn new(walked: &Walked, ray: &Ray, any: bool, index: usize, lazy: bool) -> Self {
        let prepared = Prepared::new(ray);
        let away = norm_max(prepared.origin);
        let (mut moved, mut moved_off, mut from) = (0.0, 0.0, prepared.origin);
        if away > NEAR_ENOUGH * walked.extent {
            (moved, moved_off, from) = move_to_box(walked, &prepared, away);
        }
        let length = norm_max(from) + walked.extent;
        let pad = (12.0 * U * length + 2.0 * moved_off) as f32;
        let filters = FilterRay::holds(length);
        let mut flight = Flight {
            index,
            start: ray.start,
            any,
            lazy,
            contradicted: false,
            found: false,
            filters,
            candidate: None,
            inverse: [0.0; 3],
            near_origin: [0.0; 3],
            far_origin: [0.0; 3],
            near: [0; 3],
            far: [0; 3],
            octant: 0,
            t_min: 0.0,
            sure: [0.0; 2],
            limit: 0.0,
            filter: FilterRay::new(&prepared, from, length, moved_off, moved_off),
            current: 0,
            waiting: 0,
            t_best: prepared.t_max,
            moved,
            moved_off,
        };
        for axis in 0..3 {
            let direction = prepared.direction[axis];
            let backwards = direction.is_sign_negative();
            let direction = direction as f32;
            let inverse = if direction.abs() < 1.0 / STEEPEST {
                if backwards { -STEEPEST } else { STEEPEST }
            } else {
                1.0 / direction
            };
            let (origin, pad) = (from[axis] as f32, if backwards { -pad } else { pad });
            flight.inverse[axis] = inverse;
            flight.near_origin[axis] = (origin + pad) * inverse;
            flight.far_origin[axis] = (origin - pad) * inverse;
            let lower = axis as u8;
            (flight.near[axis], flight.far[axis]) =
                if backwards { (lower + 3, lower) } else { (lower, lower + 3) };
            flight.octant |= u8::from(backwards) << axis;
        }
        if prepared.t_min != 0.0 || moved != 0.0 {
            flight.t_min = round_down(prepared.t_min - moved - moved_off);
            flight.sure[0] = round_up(prepared.t_min - moved + moved_off);
        }
        flight.set_limit();
        flight
    }

    /// The limit that the best decided hit sets.
    #[inline(always)]
    fn set_limit(&mut self) {
        if self.t_best == f64::INFINITY {
            (self.limit, self.sure[1]) = (f32::INFINITY, f32::INFINITY);
            return;
        }
        let t = self.t_best - self.moved;
        self.limit = round_up(t + self.moved_off);
        self.sure[1] = round_down(t - self.moved_off);
    }

    /// Pushes the children of the current node that the ray enters.
    ///
    /// # Safety
    /// The level's instructions are there; the stack has room for eight more.
    #[inline(always)]
    unsafe fn enter<L: Lanes>(&mut self, node: &Node, children: *mut u32, t: *mut f32) {
        // SAFETY: the caller's promise.
        unsafe {
            let near = crossing::<L>(node, self.near[0], self.inverse[0], self.near_origin[0])
                .max(crossing::<L>(node, self.near[1], self.inverse[1], self.near_origin[1]))
                .max(crossing::<L>(node, self.near[2], self.inverse[2], self.near_origin[2]))
                .max(L::splat(self.t_min));
            let far = crossing::<L>(node, self.far[0], self.inverse[0], self.far_origin[0])
                .min(crossing::<L>(node, self.far[1], self.inverse[1], self.far_origin[1]))
                .min(crossing::<L>(node, self.far[2], self.inverse[2], self.far_origin[2]))
                .min(L::splat(self.limit));
            let order = *node.order.get_unchecked(usize::from(self.octant));
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
    unsafe fn visit<'a, L: Lanes>(
        &mut self,
        batch: &Batch<'a, '_, impl Questions + ?Sized>,
        judge: &mut Judge<'a>,
    ) -> bool {
        let number = block_number(self.current);
        let block = &batch.walked.tree.blocks[number as usize];
        let all = (2u32 << (self.current & 7)) - 1;
        if self.current & SPHERES != 0 || !self.filters {
            return self.decide(batch, judge, block, all);
        }
        // SAFETY: the caller's promise.
        let judged = unsafe { self.filter.judge::<L>(&block.corners, self.t_min, self.limit) };
        let open = all & !judged.out;
        if open == 0 {
            return false;
        }
        if !self.lazy {
            return self.decide(batch, judge, block, open);
        }
        let mut unsure = open & !judged.inside;
        let mut sure = open & judged.inside;
        while sure != 0 {
            let lane = sure.trailing_zeros();
            sure &= sure - 1;
            let (low, high) = (judged.low[lane as usize], judged.high[lane as usize]);
            let id = block.ids[lane as usize];
            // A candidate may have come since the block was judged.
            if low > self.limit || id == self.start {
                continue;
            }
            // At the ends of the ray's range and beside another candidate nothing is sure.
            let in_range = low > self.sure[0] && high < self.sure[1];
            let apart = self.candidate.is_none_or(|other| high < other.low || other.high < low);
            if !in_range || !apart {
                unsure |= 1 << lane;
            } else if self.any {
                self.found = true;
                return true;
            } else if self.candidate.is_none_or(|other| high < other.low) {
                self.candidate = Some(Candidate { block: number, lane, low, high });
                self.limit = self.limit.min(high);
            }
        }
        unsure != 0 && self.decide(batch, judge, block, unsure)
    }

    /// Settles the candidate where what has been decided doesn't lie clear of it.
    fn reconcile<'a>(&mut self, batch: &Batch<'a, '_, impl Questions + ?Sized>, judge: &mut Judge<'a>) {
        if let Some(candidate) = self.candidate {
            let decided = self.t_best - self.moved;
            if decided + self.moved_off < f64::from(candidate.low) {
                self.candidate = None;
            } else if decided - self.moved_off <= f64::from(candidate.high) {
                self.settle(batch, judge);
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
    fn settle<'a>(&mut self, batch: &Batch<'a, '_, impl Questions + ?Sized>, judge: &mut Judge<'a>) {
        let Some(candidate) = self.candidate.take() else { return };
        let block = &batch.walked.tree.blocks[candidate.block as usize];
        let lane = candidate.lane as usize;
        let tester = judge.get_or_insert_with(|| batch.judge(self.index));
        let hit = tester.meet(&corners(block, lane));
        let t = hit.as_ref().map(|hit| hit.t - self.moved);
        let off = self.moved_off;
        if !t.is_some_and(|t| t + off >= f64::from(candidate.low) && t - off <= f64::from(candidate.high)) {
            self.contradicted = true;
            return;
        }
        tester.offer_hit(block.ids[lane], hit);
        self.t_best = tester.t_best;
    }

    /// Puts the lanes of `open` to the f64 test; whether the ray has found all that it asks.
    #[inline(never)]
    fn decide<'a>(
        &mut self,
        batch: &Batch<'a, '_, impl Questions + ?Sized>,
        judge: &mut Judge<'a>,
        block: &Block,
        mut open: u32,
    ) -> bool {
        let tester = judge.get_or_insert_with(|| batch.judge(self.index));
        while open != 0 {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            let id = block.ids[lane];
            if self.current & SPHERES == 0 {
                tester.test_corners(id, &corners(block, lane));
            } else {
                tester.test(id);
            }
            if self.any && tester.found() {
                return true;
            }
        }
        if tester.t_best < self.t_best {
            self.t_best = tester.t_best;
            self.reconcile(batch, judge);
        }
        false
    }

    fn answer(&self, judge: &Judge) -> Answer {
        match judge {
            _ if self.found => Answer { primitive: 0, ..Answer::MISS },
            Some(tester) => tester.verdict(self.any),
            None => Answer::MISS,
        }
    }
}

/// Where a ray from far outside comes to the scene's box: how far along, how far off the t of a decision may be, and the point. A ray that misses the box is left where it
/// passes it by.
#[cold]
fn move_to_box(walked: &Walked, ray: &Prepared, away: f64) -> (f64, f64, [f64; 3]) {
    let entered = Slabs::new(ray, walked.extent).enter(walked.low, walked.high, ray.t_max);
    let moved = entered.unwrap_or(-dot(ray.origin, ray.direction) / dot(ray.direction, ray.direction));
    let from = std::array::from_fn(|axis| ray.origin[axis] + moved * ray.direction[axis]);
    // Rounding the point takes far less than the decision's t may be off: twice what `triangle::GRAZING` derives.
    (moved, (away + walked.extent) * (1.0 / (1u64 << 31) as f64), from)
}

/// Where a ray crosses a row of eight planes. No closure: the compiler doesn't inline the instructions of a level into one.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
unsafe fn crossing<L: Lanes>(node: &Node, row: u8, inverse: f32, origin: f32) -> L {
    // SAFETY: a node's planes are aligned as it is; rows are 0 to 5.
    unsafe {
        L::load(node.planes.get_unchecked(usize::from(row)).as_ptr())
            .mul_sub(L::splat(inverse), L::splat(origin))
    }
}

#[inline(always)]
fn corners(block: &Block, lane: usize) -> [[f64; 3]; 3] {
    let mut corners = [[0.0; 3]; 3];
    for vertex in 0..3 {
        for axis in 0..3 {
            corners[vertex][axis] = f64::from(block.corners[vertex][axis][lane & (WIDTH - 1)]);
        }
    }
    corners
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
    let batch = Batch { walked, questions };
    let mut flights: [MaybeUninit<Flight>; FLIGHT] = [const { MaybeUninit::uninit() }; FLIGHT];
    let mut judges: [Judge<'a>; FLIGHT] = [const { None }; FLIGHT];
    let mut taken = answers.len().min(FLIGHT);
    for (index, flight) in flights[..taken].iter_mut().enumerate() {
        let (ray, any) = questions.question(index);
        flight.write(Flight::new(walked, &ray, any, index, true));
    }
    // All begin at the root, which is a node.
    let (mut at_nodes, mut at_leaves) = ((1u32 << taken) - 1, 0u32);
    while at_nodes | at_leaves != 0 {
        let leaves = at_nodes == 0 || (at_leaves != 0 && at_nodes.count_ones() <= FEW);
        let mut turn = if leaves { at_leaves } else { at_nodes };
        while turn != 0 {
            let lane = turn.trailing_zeros() as usize;
            turn &= turn - 1;
            let bit = 1u32 << lane;
            at_nodes &= !bit;
            at_leaves &= !bit;
            // SAFETY: lanes at nodes or leaves hold a flight; each lane has `size` places, more than the deepest walk takes and eight to spare; `current` names a
            // node or block of the tree, as all children do; the level's instructions are the caller's promise.
            let (flight, goes_on) = unsafe {
                let flight = flights.get_unchecked_mut(lane).assume_init_mut();
                let (children, t) = (stacks.add(lane * size), ts.add(lane * size));
                let done = if leaves {
                    flight.visit::<L>(&batch, judges.get_unchecked_mut(lane))
                } else {
                    flight.enter::<L>(tree.nodes.get_unchecked(flight.current as usize), children, t);
                    false
                };
                let goes_on = !done && flight.next(children, t);
                (flight, goes_on)
            };
            if !goes_on {
                let judge = &mut judges[lane];
                if flight.candidate.is_some() {
                    flight.settle(&batch, judge);
                }
                let (index, lazy) = if flight.contradicted {
                    (flight.index, false)
                } else {
                    answers[flight.index] = flight.answer(judge);
                    taken += 1;
                    (taken - 1, true)
                };
                *judge = None;
                if index >= answers.len() {
                    continue;
                }
                let (ray, any) = questions.question(index);
                *flight = Flight::new(walked, &ray, any, index, lazy);
            }
            prefetch(tree, flight.current);
            if flight.current & LEAF == 0 {
                at_nodes |= bit;
            } else {
                at_leaves |= bit;
            }
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
            let number = block_number(child);
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
