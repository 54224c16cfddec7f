//! Many rays on their way through the tree at once on one thread, each on its own way: while one waits for memory, others go on.
//!
//! For rays that have little in common, and for what is left of a packet. Boxes and triangles are judged in f32 with bounds (`bundle`, `filter`); f64 decides at once only where
//! the filter is unsure or two bounds overlap.

use std::mem::MaybeUninit;

use super::bundle::{Bundle, Progress, RAYS};
use super::filter::{FilterRay, Judged};
use super::lanes::{Eight, Vector};
use super::questions::{Batch, Questions};
use super::tree::{Block, EMPTY, LEAF, Node, SPHERES, TreeView, WIDTH, block_number, candidate};

/// Rays in flight.
pub const FLIGHT: usize = 24;
/// Rays at nodes are stepped as long as there are more of them than this; then those at leaves.
const FEW: u32 = 6;

/// One ray on its way.
struct Flight {
    bundle: u32,
    lane: u32,
    start: u32,
    any: bool,
    /// Whether f32 may be sure of anything but misses: else all else is decided at once.
    lazy: bool,
    /// Whether f32 can hold the filter's numbers.
    filters: bool,
    octant: u8,
    /// Rows of `Node::planes` that are entered and left by.
    near: [u8; 3],
    far: [u8; 3],
    inverse: [f32; 3],
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    t_min: f32,
    progress: Progress,
    filter: FilterRay,
    current: u32,
    waiting: usize,
}

/// The stack of each ray in flight; kept between batches.
#[derive(Default)]
pub struct Stacks {
    children: Vec<u32>,
    t: Vec<f32>,
}

/// Rays to walk: a lane of a bundle each, as its number times 64 plus the lane's.
pub struct Tickets<'t> {
    pub tickets: &'t [u16],
    /// The node or block that they begin at.
    pub from: u32,
    /// See [`Bundle::contradicted`].
    pub lazy: bool,
}

impl Flight {
    #[inline(always)]
    fn new(bundles: &[Box<Bundle>], ticket: u16, from: u32, lazy: bool) -> Self {
        let (number, lane) = (usize::from(ticket) / RAYS, usize::from(ticket) % RAYS);
        let bundle = &*bundles[number];
        let mut flight = Flight {
            bundle: number as u32,
            lane: lane as u32,
            start: bundle.start[lane],
            any: bundle.any >> lane & 1 == 1,
            lazy,
            filters: bundle.filters,
            octant: bundle.class[lane] as u8 & 7,
            near: [0, 1, 2],
            far: [3, 4, 5],
            inverse: [0.0; 3],
            near_origin: [0.0; 3],
            far_origin: [0.0; 3],
            t_min: bundle.t_min[lane],
            progress: bundle.progress(lane),
            filter: bundle.filter_ray(lane),
            current: from,
            waiting: 0,
        };
        for axis in 0..3 {
            flight.inverse[axis] = bundle.inverse[axis][lane];
            flight.near_origin[axis] = bundle.near_origin[axis][lane];
            flight.far_origin[axis] = bundle.far_origin[axis][lane];
            let backwards = 3 * (flight.octant >> axis & 1);
            flight.near[axis] += backwards;
            flight.far[axis] -= backwards;
        }
        flight
    }

    /// Pushes the children of the current node that the ray enters.
    ///
    /// # Safety
    /// The level's instructions are there; the stack has room for eight more.
    #[inline(always)]
    unsafe fn enter<E: Eight>(&mut self, node: &Node, children: *mut u32, t: *mut f32) {
        // SAFETY: the caller's promise.
        unsafe {
            let near = crossing::<E>(node, self.near[0], self.inverse[0], self.near_origin[0])
                .max(crossing::<E>(node, self.near[1], self.inverse[1], self.near_origin[1]))
                .max(crossing::<E>(node, self.near[2], self.inverse[2], self.near_origin[2]))
                .max(E::splat(self.t_min));
            let far = crossing::<E>(node, self.far[0], self.inverse[0], self.far_origin[0])
                .min(crossing::<E>(node, self.far[1], self.inverse[1], self.far_origin[1]))
                .min(crossing::<E>(node, self.far[2], self.inverse[2], self.far_origin[2]))
                .min(E::splat(self.progress.limit));
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
            if t <= self.progress.limit {
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
    unsafe fn visit<E: Eight>(
        &mut self,
        batch: &Batch<impl Questions + ?Sized>,
        bundles: &mut [Box<Bundle>],
    ) -> bool {
        let number = block_number(self.current);
        let block = &batch.walked.tree.blocks[number as usize];
        let all = (2u32 << (self.current & 7)) - 1;
        let (bundle, lane) = (&mut bundles[self.bundle as usize], self.lane as usize);
        let are_spheres = self.current & SPHERES != 0;
        if !self.filters {
            return bundle.decide(batch, lane, &mut self.progress, (block, are_spheres), all);
        }
        let tree = batch.walked.tree;
        let ray = LoneRay { tree, filter: &self.filter, start: self.start, t_min: self.t_min, any: self.any };
        // SAFETY: the caller's promise; a flight's axes are below 3.
        match unsafe { ray.meet::<E>((block, are_spheres), number, all, self.lazy, &mut self.progress) } {
            Met::Nothing => false,
            Met::Any => {
                bundle.found |= 1 << lane;
                true
            }
            Met::Unsure(open) => bundle.decide(batch, lane, &mut self.progress, (block, are_spheres), open),
        }
    }
}

/// What one ray asks of a block.
pub struct LoneRay<'f> {
    pub tree: TreeView<'f>,
    pub filter: &'f FilterRay,
    pub start: u32,
    pub t_min: f32,
    pub any: bool,
}

/// What came of it, beside the progress.
pub enum Met {
    Nothing,
    /// Something is surely hit by a ray that asks for no more.
    Any,
    /// These f64 has to decide.
    Unsure(u32),
}

impl LoneRay<'_> {
    /// Judges the primitives `all` of a block, and takes the nearest that is surely met as the candidate.
    ///
    /// # Safety
    /// The level's instructions are there; the filter's axes are below 3.
    #[inline(always)]
    pub unsafe fn meet<E: Eight>(
        &self,
        (block, are_spheres): (&Block, bool),
        number: u32,
        all: u32,
        lazy: bool,
        progress: &mut Progress,
    ) -> Met {
        #[repr(align(32))]
        struct Bounds([f32; WIDTH], [f32; WIDTH]);
        // SAFETY: the caller's promise; a block's ids are aligned to 32 bytes.
        let judged = unsafe {
            if are_spheres {
                let spheres = self.filter.judge_spheres::<E>(&block.corners, self.t_min, progress.limit, all);
                let left = spheres.leaving & E::same(block.ids.as_ptr(), self.start);
                Judged { out: spheres.judged.out | left, ..spheres.judged }
            } else {
                self.filter.judge::<E>(&block.corners, self.t_min, progress.limit, all)
            }
        };
        let open = all & !judged.out;
        if open == 0 {
            return Met::Nothing;
        }
        let (mut unsure, mut sure) =
            if lazy { (open & !judged.inside, open & judged.inside) } else { (open, 0) };
        if sure != 0 {
            let mut bounds = Bounds([0.0; WIDTH], [0.0; WIDTH]);
            // SAFETY: eight aligned places each.
            unsafe {
                judged.low.store(bounds.0.as_mut_ptr());
                judged.high.store(bounds.1.as_mut_ptr());
            }
            while sure != 0 {
                let k = sure.trailing_zeros();
                sure &= sure - 1;
                let (low, high) = (bounds.0[k as usize], bounds.1[k as usize]);
                // A candidate may have come since the block was judged.
                if low > progress.limit || (block.ids[k as usize] == self.start && !are_spheres) {
                    continue;
                }
                // At the ends of the ray's range and beside another candidate nothing is sure.
                let in_range = low > progress.sure[0] && high < progress.sure[1];
                if self.any && in_range {
                    return Met::Any;
                }
                if in_range && high < progress.low {
                    (progress.low, progress.high) = (low, high);
                    progress.candidate = candidate(number, k, are_spheres);
                    progress.limit = progress.limit.min(high);
                } else if !self.tree.is_candidate(progress.candidate, block.ids[k as usize]) {
                    unsure |= 1 << k;
                }
            }
        }
        if unsure == 0 { Met::Nothing } else { Met::Unsure(unsure) }
    }
}

/// Where a ray crosses a row of eight planes. No closure: the compiler doesn't inline the instructions of a level into one.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
unsafe fn crossing<V: Vector>(node: &Node, row: u8, inverse: f32, origin: f32) -> V {
    // SAFETY: a node's planes are aligned as it is; rows are 0 to 5.
    unsafe {
        V::load(node.planes.get_unchecked(usize::from(row)).as_ptr())
            .mul_sub(V::splat(inverse), V::splat(origin))
    }
}

/// Walks the rays of all tickets; what is found goes into their bundles.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn fly<E: Eight>(
    batch: &Batch<impl Questions + ?Sized>,
    bundles: &mut [Box<Bundle>],
    &Tickets { tickets, from, lazy }: &Tickets,
    stacks: &mut Stacks,
) {
    let tree = batch.walked.tree;
    let size = tree.stack_size;
    if stacks.children.len() < FLIGHT * size {
        stacks.children.resize(FLIGHT * size, 0);
        stacks.t.resize(FLIGHT * size, 0.0);
    }
    let (stacks, ts) = (stacks.children.as_mut_ptr(), stacks.t.as_mut_ptr());
    let mut flights: [MaybeUninit<Flight>; FLIGHT] = [const { MaybeUninit::uninit() }; FLIGHT];
    let mut taken = tickets.len().min(FLIGHT);
    for (flight, &ticket) in flights.iter_mut().zip(tickets) {
        flight.write(Flight::new(bundles, ticket, from, lazy));
    }
    let all = (1u32 << taken) - 1;
    let (mut at_nodes, mut at_leaves) = if from & LEAF == 0 { (all, 0u32) } else { (0, all) };
    while at_nodes | at_leaves != 0 {
        let leaves = at_nodes == 0 || (at_leaves != 0 && at_nodes.count_ones() <= FEW);
        let mut turn = if leaves { at_leaves } else { at_nodes };
        while turn != 0 {
            let place = turn.trailing_zeros() as usize;
            turn &= turn - 1;
            let bit = 1u32 << place;
            at_nodes &= !bit;
            at_leaves &= !bit;
            // SAFETY: places at nodes or leaves hold a flight; each has `size` entries of the stacks, more than the deepest walk takes and eight to spare; `current` names a
            // node or block of the tree, as all children do; the level's instructions are the caller's promise.
            let (flight, goes_on) = unsafe {
                let flight = flights.get_unchecked_mut(place).assume_init_mut();
                let (children, t) = (stacks.add(place * size), ts.add(place * size));
                let done = if leaves {
                    flight.visit::<E>(batch, bundles)
                } else {
                    flight.enter::<E>(tree.nodes.get_unchecked(flight.current as usize), children, t);
                    false
                };
                let goes_on = !done && flight.next(children, t);
                (flight, goes_on)
            };
            if !goes_on {
                bundles[flight.bundle as usize].keep(flight.lane as usize, &flight.progress);
                let Some(&ticket) = tickets.get(taken) else { continue };
                taken += 1;
                *flight = Flight::new(bundles, ticket, from, lazy);
            }
            prefetch(tree, flight.current);
            // Whether it is a leaf is anyone's guess: no branch.
            let at_leaf = flight.current >> 31;
            at_nodes |= (1 - at_leaf) << place;
            at_leaves |= at_leaf << place;
        }
    }
}

#[inline(always)]
fn prefetch(tree: TreeView, child: u32) {
    debug_assert_ne!(child, EMPTY);
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // A node or a block, without a branch. The five lines of a block are a node's and one more.
        const { assert!(size_of::<Node>() < size_of::<Block>() && LEAF == 1 << 31) };
        let is_leaf = (child >> 31) as usize;
        let bases: [*const i8; 2] = [tree.nodes.as_ptr().cast(), tree.blocks.as_ptr().cast()];
        let number = ((child & !(LEAF | SPHERES)) >> (3 * is_leaf)) as usize;
        let from = bases[is_leaf].wrapping_add(number * [size_of::<Node>(), size_of::<Block>()][is_leaf]);
        for line in (0..size_of::<Block>()).step_by(64) {
            // SAFETY: a hint; any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.wrapping_add(line)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (tree, child);
}
