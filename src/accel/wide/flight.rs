//! Many rays on their way through the tree at once on one thread, each on its own way: while one waits for memory, others go on.
//!
//! For rays that have little in common, and for what is left of a packet. Boxes and triangles are judged in f32 with bounds (`bundle`, `filter`); f64 decides at once only where
//! the filter is unsure or two bounds overlap.

use super::bundle::{Bundle, RAYS};
use super::lanes::Eight;
use super::lone::{Asking, Lone, Met};
use super::questions::Batch;
use super::tree::{EMPTY, LEAF, Node, SPHERES, TreeView, block_number};

/// Rays in flight.
pub const FLIGHT: usize = 24;
/// Rays at nodes are stepped as long as there are more of them than this; then those at leaves.
const FEW: u32 = 6;

/// One ray on its way.
#[derive(Clone, Copy)]
struct Flight {
    ray: *mut Lone,
    /// Behind the last child that waits on its stack.
    top: *mut u32,
    /// The node or block that it is at.
    current: u32,
    ticket: u16,
}

/// The stack of each ray in flight: children, then the bits of where each is entered. Kept between batches.
#[derive(Default)]
pub struct Stacks(Vec<u32>);

/// Rays to walk: a lane of a bundle each, as its number times 64 plus the lane's.
pub struct Tickets<'t> {
    pub tickets: &'t [u16],
    /// The node or block that they begin at.
    pub from: u32,
    /// See [`Bundle::contradicted`].
    pub lazy: bool,
}

impl Flight {
    /// Takes the nearest waiting child that is still wanted; false if none is left.
    ///
    /// # Safety
    /// Below `top` lie what waits and, first of all, [`EMPTY`] at a t before all others; each child's t lies `size` places behind it.
    #[inline(always)]
    unsafe fn next(&mut self, size: usize) -> bool {
        // SAFETY: the caller's promise: what comes first is always wanted.
        unsafe {
            let limit = (*self.ray).progress.limit;
            self.top = self.top.sub(1);
            while *self.top.add(size).cast::<f32>() > limit {
                self.top = self.top.sub(1);
            }
            self.current = *self.top;
            self.current != EMPTY
        }
    }

    /// Goes on from a node: to the nearest of the children that it enters, or else as [`next`](Self::next).
    ///
    /// # Safety
    /// As of `next`; the level's instructions are there; the stack has room for eight more.
    #[inline(always)]
    unsafe fn enter<E: Eight>(&mut self, node: &Node, size: usize) -> bool {
        // SAFETY: the caller's promise.
        unsafe {
            let ray = &*self.ray;
            let waiting = self.top.sub(1);
            // Read before more is written: what is just written would have to be waited for.
            let (child, t) = (*waiting, *waiting.add(size).cast::<f32>());
            let (entered, nearest) = ray.enter::<E>(node, self.top, self.top.add(size).cast());
            self.top = waiting.add(entered);
            self.current = if entered == 0 { child } else { nearest };
            if entered == 0 && t > ray.progress.limit {
                return self.next(size);
            }
            self.current != EMPTY
        }
    }

    /// Tests the primitives of the current block; whether the ray has found all that it asks.
    ///
    /// # Safety
    /// The level's instructions are there; the ray is one of the bundle that the ticket names.
    #[inline(always)]
    unsafe fn visit<E: Eight>(&self, batch: &Batch, bundles: &mut [Box<Bundle>], lazy: bool) -> bool {
        let number = block_number(self.current);
        let block = &batch.walked.tree.blocks[number as usize];
        let all = (2u32 << (self.current & 7)) - 1;
        let block = (block, self.current & SPHERES != 0);
        // SAFETY: the caller's promise.
        let ray = unsafe { &mut *self.ray };
        let tree = batch.walked.tree;
        let asking = Asking { tree, filter: &ray.filter, start: ray.start, t_min: ray.t_min, any: ray.any };
        let met = if ray.filters {
            // SAFETY: the caller's promise; a ray's axes are below 3.
            unsafe { asking.meet::<E>(block, number, all, lazy, &mut ray.progress) }
        } else {
            Met::Unsure(all)
        };
        let (bundle, lane) = (usize::from(self.ticket) / RAYS, usize::from(self.ticket) % RAYS);
        match met {
            Met::Nothing => false,
            Met::Any => {
                bundles[bundle].found |= 1 << lane;
                true
            }
            Met::Unsure(open) => bundles[bundle].decide(batch, lane, &mut ray.progress, block, open),
        }
    }
}

/// Walks the rays of all tickets; what is found goes into their bundles.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn fly<E: Eight>(
    batch: &Batch,
    bundles: &mut [Box<Bundle>],
    rays: &mut [Lone],
    &Tickets { tickets, from, lazy }: &Tickets,
    stacks: &mut Stacks,
) {
    let tree = batch.walked.tree;
    // What marks the end comes first.
    let size = tree.stack_size + 1;
    if stacks.0.len() < 2 * FLIGHT * size {
        stacks.0.resize(2 * FLIGHT * size, 0);
    }
    let (nodes, stacks) = (tree.nodes.as_ptr(), stacks.0.as_mut_ptr());
    let last = tickets.iter().fold(0, |last, &ticket| if ticket > last { ticket } else { last });
    assert!(usize::from(last) < rays.len());
    let rays = rays.as_mut_ptr();
    let mut flights = [Flight { ray: rays, top: stacks, current: from, ticket: 0 }; FLIGHT];
    let mut taken = tickets.len().min(FLIGHT);
    for (place, (flight, &ticket)) in flights.iter_mut().zip(tickets).enumerate() {
        // SAFETY: each flight has two times `size` places; tickets are of rays.
        unsafe {
            let bottom = stacks.add(2 * place * size);
            *bottom = EMPTY;
            *bottom.add(size) = f32::NEG_INFINITY.to_bits();
            let ray = rays.add(usize::from(ticket));
            *flight = Flight { ray, top: bottom.add(1), current: from, ticket };
        }
    }
    let all = (1u32 << taken) - 1;
    let (mut at_nodes, mut at_leaves) = if from & LEAF == 0 { (all, 0u32) } else { (0, all) };
    while at_nodes | at_leaves != 0 {
        let leaves = at_nodes == 0 || (at_leaves != 0 && at_nodes.count_ones() <= FEW);
        let mut turn = if leaves { at_leaves } else { at_nodes };
        // All of them leave where they are.
        (at_nodes, at_leaves) = (at_nodes & !turn, at_leaves & !turn);
        while turn != 0 {
            let place = turn.trailing_zeros() as usize;
            turn &= turn - 1;
            // SAFETY: places at nodes or leaves hold a flight; each has `size` entries of the stacks, more than the deepest walk takes, one that marks the end and eight to
            // spare; `current` names a node or block of the tree, as all children do; the level's instructions are the caller's promise.
            let (flight, goes_on) = unsafe {
                let flight = flights.get_unchecked_mut(place);
                let goes_on = if leaves {
                    !flight.visit::<E>(batch, bundles, lazy) && flight.next(size)
                } else {
                    flight.enter::<E>(&*nodes.add(flight.current as usize), size)
                };
                (flight, goes_on)
            };
            if !goes_on {
                let ticket = usize::from(flight.ticket);
                // SAFETY: a flight's ray is there, and nobody else's.
                bundles[ticket / RAYS].keep(ticket % RAYS, unsafe { &(*flight.ray).progress });
                let Some(&ticket) = tickets.get(taken) else { continue };
                taken += 1;
                // SAFETY: as above.
                let (ray, top) = unsafe { (rays.add(usize::from(ticket)), stacks.add(2 * place * size + 1)) };
                *flight = Flight { ray, top, current: from, ticket };
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
        use super::tree::Block;
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // A node or a block, without a branch.
        const { assert!(size_of::<Node>() == 256 && size_of::<Block>() == 320) };
        let node: *const i8 = tree.nodes.as_ptr().wrapping_add(child as usize).cast();
        let block: *const i8 = tree.blocks.as_ptr().wrapping_add(block_number(child) as usize).cast();
        let from = if child & LEAF == 0 { node } else { block };
        for line in (0..size_of::<Node>()).step_by(64) {
            // SAFETY: a hint; any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.wrapping_add(line)) };
        }
        // The fifth line of a block, or once more the first of a node.
        let last = from.wrapping_add((child >> 31) as usize * size_of::<Node>());
        // SAFETY: as above.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(last) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (tree, child);
}
