//! Packets: rays of a bundle that go much the same way walk the tree together.
//!
//! A node's children are first judged for the whole beam (interval arithmetic: Boulos, Wald and Shirley 2006, "Geometric and Arithmetic Culling Methods for Entire Ray Packets"),
//! then each that is left by all its rays side by side. A few rays that are left over go on alone (`flight`).

use super::beam::{Beam, largest};
use super::bundle::{Bundle, RAYS, axes, first_lanes};
use super::filter::{Judged, Rays};
use super::flight::Tickets;
use super::lanes::Vector;
use super::lone::{Asking, Met};
use super::questions::Batch;
use super::tree::{Block, EMPTY, LEAF, Node, SPHERES, WIDTH, block_number, candidate};
use super::walk::{Instructions, Scratch};

/// Fewer rays of a class are no packet.
const LEAST: u32 = 12;
/// The same in a grid, where a ray alone is slower still.
const LEAST_OF_CELLS: u32 = 4;
/// At a node that no more rays than this enter, they go on alone.
const ALONE: u32 = 4;
/// A block is judged for the whole beam if no fewer rays than this reach it.
const WORTH_CULLING: u32 = 12;
/// A beam's directions may differ by this, relative to their largest component.
const WIDEST: f32 = 0.35;
/// Its origins may differ by this part of the extent of the scene.
const BROADEST: f32 = 0.25;

/// A child that waits, for some of the rays.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub struct Entry {
    /// Where each ray enters it.
    t: [f32; RAYS],
    rays: u64,
    child: u32,
}

impl Entry {
    pub const NONE: Entry = Entry { t: [0.0; RAYS], rays: 0, child: EMPTY };
}

/// Lanes of a bundle whose integers are `value`.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
unsafe fn lanes_of<V: Vector>(values: &[u32; RAYS], value: u32) -> u64 {
    let (mut lanes, mut at) = (0, 0);
    while at < RAYS {
        // SAFETY: the array lies in a bundle, aligned to 64 bytes; the rest is the caller's promise.
        lanes |= u64::from(unsafe { V::same(values.as_ptr().add(at), value) }) << at;
        at += V::COUNT;
    }
    lanes
}

/// Walks what rays of a bundle go much the same way; the lanes of those that don't.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn packets<I: Instructions>(batch: &Batch, number: usize, scratch: &mut Scratch) -> u64 {
    let (mut alone, mut left) = (0u64, first_lanes(scratch.bundles[number].count));
    let least = if batch.walked.cells.is_some() { LEAST_OF_CELLS } else { LEAST };
    let broadest = BROADEST * batch.walked.extent as f32;
    while left != 0 {
        let bundle = &*scratch.bundles[number];
        let lane = left.trailing_zeros() as usize;
        let asks_alike = if bundle.any >> lane & 1 == 1 { bundle.any } else { !bundle.any };
        // SAFETY: the caller's promise.
        let lanes = unsafe { lanes_of::<I::Most>(&bundle.class, bundle.class[lane]) } & left & asks_alike;
        left &= !lanes;
        if lanes.count_ones() < least || !bundle.filters {
            alone |= lanes;
            continue;
        }
        // SAFETY: the caller's promise.
        unsafe {
            let beam = Beam::new::<I::Most>(bundle, lanes);
            let wide = |[least, most]: [f32; 2], by: f32| most - least > by;
            if beam.shear.into_iter().any(|shear| wide(shear, WIDEST))
                || beam.origin.into_iter().any(|origin| wide(origin, broadest))
            {
                alone |= lanes;
            } else {
                let any = bundle.any & lanes != 0;
                let packet = Packet { number, lanes, class: bundle.class[lane], beam, any };
                match batch.walked.cells {
                    None => packet.walk::<I>(batch, scratch),
                    Some(cells) => alone |= packet.through_cells::<I>(batch, cells, scratch),
                }
            }
        }
    }
    alone
}

/// Rays of one class that ask the same.
pub struct Packet {
    /// Of the bundle.
    pub number: usize,
    pub lanes: u64,
    pub class: u32,
    beam: Beam,
    any: bool,
}

impl Packet {
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn walk<I: Instructions>(&self, batch: &Batch, scratch: &mut Scratch) {
        let tree = batch.walked.tree;
        if scratch.entries.len() < tree.stack_size {
            scratch.entries.resize(tree.stack_size, Entry::NONE);
        }
        let octant = self.class & 7;
        let rows: [[usize; 2]; 3] =
            std::array::from_fn(
                |axis| if octant >> axis & 1 == 1 { [axis + 3, axis] } else { [axis, axis + 3] },
            );
        let mut alive = self.lanes;
        let mut waiting = 1;
        scratch.entries[0] = Entry { t: scratch.bundles[self.number].t_min, rays: alive, child: 0 };
        // SAFETY: the caller's promise; the stack has a place for each entry of the deepest walk and eight to spare; children name nodes and blocks of the tree.
        unsafe {
            let mut last = largest::<I::Most>(&scratch.bundles[self.number].limit, self.lanes);
            while waiting > 0 {
                waiting -= 1;
                let entry: *const Entry = scratch.entries.as_ptr().add(waiting);
                let child = (*entry).child;
                let rays = still_wanted::<I::Most>(
                    &(*entry).t,
                    &scratch.bundles[self.number].limit,
                    (*entry).rays & alive,
                );
                if rays == 0 {
                    continue;
                }
                let is_block = child & LEAF != 0;
                if !is_block && rays.count_ones() > ALONE {
                    let node = tree.nodes.get_unchecked(child as usize);
                    waiting = self.enter::<I>(node, rays, last, rows, scratch, waiting);
                    continue;
                }
                if is_block {
                    self.visit::<I>(batch, child, rays, scratch);
                } else {
                    self.go_alone::<I>(batch, child, rays, scratch);
                }
                let bundle = &*scratch.bundles[self.number];
                alive = self.lanes & !bundle.found;
                if alive == 0 {
                    break;
                }
                last = largest::<I::Most>(&bundle.limit, self.lanes);
            }
        }
    }

    /// Pushes the children of a node that rays enter, far ones first; the new number of entries.
    ///
    /// # Safety
    /// The level's instructions are there; the stack has room for eight more.
    #[inline(always)]
    unsafe fn enter<I: Instructions>(
        &self,
        node: &Node,
        rays: u64,
        last: f32,
        rows: [[usize; 2]; 3],
        scratch: &mut Scratch,
        mut waiting: usize,
    ) -> usize {
        let Scratch { bundles, entries, .. } = scratch;
        let bundle = &*bundles[self.number];
        // SAFETY: rows are below six; all arrays are aligned to 64 bytes; the rest is the caller's promise.
        unsafe {
            let (mut entered, mut places) = ([0u32; WIDTH], 0);
            // Rays that ask for any hit come from the other side: large things far away stop them sooner than what lies about their starts.
            let octant = (self.class & 7) ^ if self.any { 7 } else { 0 };
            let order = *node.order.get_unchecked(octant as usize);
            self.beam.enters::<I::Eight>(node, rows, last, order, &mut entered, &mut places);
            for &k in entered.get_unchecked(..places) {
                let k = k as usize & (WIDTH - 1);
                let planes: [[f32; 2]; 3] = [
                    [node.planes[rows[0][0]][k], node.planes[rows[0][1]][k]],
                    [node.planes[rows[1][0]][k], node.planes[rows[1][1]][k]],
                    [node.planes[rows[2][0]][k], node.planes[rows[2][1]][k]],
                ];
                let entry = &mut *entries.as_mut_ptr().add(waiting);
                let (mut inside, mut at) = (0u64, 0);
                while at < RAYS {
                    if rays >> at & u64::from(group_mask::<I::Most>()) == 0 {
                        at += <I::Most>::COUNT;
                        continue;
                    }
                    let mut near = <I::Most>::load(bundle.t_min.as_ptr().add(at));
                    let mut far = <I::Most>::load(bundle.limit.as_ptr().add(at));
                    for axis in 0..3 {
                        let inverse = <I::Most>::load(bundle.inverse[axis].as_ptr().add(at));
                        let near_origin = <I::Most>::load(bundle.near_origin[axis].as_ptr().add(at));
                        let far_origin = <I::Most>::load(bundle.far_origin[axis].as_ptr().add(at));
                        near = <I::Most>::splat(planes[axis][0]).mul_sub(inverse, near_origin).max(near);
                        far = <I::Most>::splat(planes[axis][1]).mul_sub(inverse, far_origin).min(far);
                    }
                    near.store(entry.t.as_mut_ptr().add(at));
                    inside |= u64::from(!near.gt(far) & group_mask::<I::Most>()) << at;
                    at += <I::Most>::COUNT;
                }
                inside &= rays;
                if inside != 0 {
                    entry.rays = inside;
                    entry.child = node.children[k];
                    waiting += 1;
                }
            }
        }
        waiting
    }

    /// Tests a block's primitives against the rays.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn visit<I: Instructions>(&self, batch: &Batch, child: u32, rays: u64, scratch: &mut Scratch) {
        let number = block_number(child);
        let block = &batch.walked.tree.blocks[number as usize];
        let all = (2u32 << (child & 7)) - 1;
        let bundle = &mut *scratch.bundles[self.number];
        let are_spheres = child & SPHERES != 0;
        let block = (block, are_spheres);
        let axes = axes(self.class);
        let culls = !are_spheres && rays.count_ones() >= WORTH_CULLING;
        // SAFETY: the caller's promise.
        let touched = if culls { all & unsafe { self.beam.touches::<I::Eight>(block.0, axes) } } else { all };
        let mut at = 0;
        while at < RAYS {
            let group = (rays >> at) as u32 & group_mask::<I::Most>();
            // SAFETY: the caller's promise.
            unsafe {
                if group.count_ones() * 4 < touched.count_ones() * 3 {
                    let mut left = group;
                    while left != 0 {
                        let lane = at + left.trailing_zeros() as usize;
                        left &= left - 1;
                        self.meet_alone::<I>(batch, bundle, lane, block, number, touched);
                    }
                } else if group != 0 {
                    self.meet::<I>(batch, bundle, at, group, block, number, touched);
                }
            }
            at += <I::Most>::COUNT;
        }
    }

    /// One ray and the triangles of a block.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn meet_alone<I: Instructions>(
        &self,
        batch: &Batch,
        bundle: &mut Bundle,
        lane: usize,
        block: (&Block, bool),
        number: u32,
        touched: u32,
    ) {
        let (filter, mut progress) = (bundle.filter_ray(lane), bundle.progress(lane));
        let (tree, start, t_min) = (batch.walked.tree, bundle.start[lane], bundle.t_min[lane]);
        let ray = Asking { tree, filter: &filter, start, t_min, any: self.any };
        // SAFETY: the caller's promise; axes are below 3.
        match unsafe { ray.meet::<I::Eight>(block, number, touched, true, &mut progress) } {
            Met::Nothing => {}
            Met::Any => bundle.found |= 1 << lane,
            Met::Unsure(open) => {
                bundle.decide(batch, lane, &mut progress, block, open);
            }
        }
        bundle.keep(lane, &progress);
    }

    /// A group of rays side by side and the triangles of a block, one after the other.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "inlined: what a visit knows")]
    unsafe fn meet<I: Instructions>(
        &self,
        batch: &Batch,
        bundle: &mut Bundle,
        at: usize,
        mut group: u32,
        (block, are_spheres): (&Block, bool),
        number: u32,
        mut touched: u32,
    ) {
        let [kx, ky, kz] = axes(self.class);
        // SAFETY: the bundle's arrays are aligned to 64 bytes and hold `COUNT` numbers from `at` on; the rest is the caller's promise.
        unsafe {
            let load = <I::Most>::load;
            let splat = <I::Most>::splat;
            let mut beside = Rays {
                origin: [
                    load(bundle.origin[kx].as_ptr().add(at)),
                    load(bundle.origin[ky].as_ptr().add(at)),
                    load(bundle.origin[kz].as_ptr().add(at)),
                ],
                shear: [load(bundle.shear[0].as_ptr().add(at)), load(bundle.shear[1].as_ptr().add(at))],
                inverse_z: load(bundle.inverse_z.as_ptr().add(at)),
                over_square: load(bundle.over_square.as_ptr().add(at)),
                linear: splat(bundle.linear),
                squared: splat(bundle.squared),
                t_delta: splat(bundle.t_delta),
                t_min: load(bundle.t_min.as_ptr().add(at)),
                limit: load(bundle.limit.as_ptr().add(at)),
            };
            while touched != 0 {
                let k = touched.trailing_zeros() as usize;
                touched &= touched - 1;
                let [a, b, c] = &block.corners;
                let first = [splat(a[kx][k]), splat(a[ky][k]), splat(a[kz][k])];
                let own = <I::Most>::same(bundle.start.as_ptr().add(at), block.ids[k]);
                let judged = if are_spheres {
                    let spheres = beside.judge_spheres(&first, splat(b[0][k]), group);
                    Judged { out: spheres.judged.out | spheres.leaving & own, ..spheres.judged }
                } else {
                    let second = [splat(b[kx][k]), splat(b[ky][k]), splat(b[kz][k])];
                    let third = [splat(c[kx][k]), splat(c[ky][k]), splat(c[kz][k])];
                    let judged = beside.judge(&[first, second, third], group);
                    Judged { out: judged.out | own, ..judged }
                };
                let open = group & !judged.out;
                if open == 0 {
                    continue;
                }
                let ends = [load(bundle.sure[0].as_ptr().add(at)), load(bundle.sure[1].as_ptr().add(at))];
                let in_range = judged.low.gt(ends[0]) & ends[1].gt(judged.high);
                let mut sure = open & judged.inside & in_range;
                if self.any {
                    bundle.found |= u64::from(sure) << at;
                    group &= !sure;
                } else {
                    // Beside another candidate nothing is sure.
                    sure &= load(bundle.low.as_ptr().add(at)).gt(judged.high);
                    judged.low.store_where(sure, bundle.low.as_mut_ptr().add(at));
                    judged.high.store_where(sure, bundle.high.as_mut_ptr().add(at));
                    let named = splat(f32::from_bits(candidate(number, k as u32, are_spheres)));
                    named.store_where(sure, bundle.candidate.as_mut_ptr().add(at).cast());
                    beside.limit.min(judged.high).store_where(sure, bundle.limit.as_mut_ptr().add(at));
                }
                let mut unsure = open & !sure;
                while unsure != 0 {
                    let bit = unsure.trailing_zeros();
                    unsure &= unsure - 1;
                    let lane = at + bit as usize;
                    if judged.inside >> bit & 1 == 1
                        && batch.walked.tree.is_candidate(bundle.candidate[lane], block.ids[k])
                    {
                        continue;
                    }
                    let mut progress = bundle.progress(lane);
                    if bundle.decide(batch, lane, &mut progress, (block, are_spheres), 1 << k) {
                        group &= !(1 << bit);
                    }
                    bundle.keep(lane, &progress);
                }
                if group == 0 {
                    break;
                }
                beside.limit = load(bundle.limit.as_ptr().add(at));
            }
        }
    }

    /// Lets a few rays go on alone from a node.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn go_alone<I: Instructions>(&self, batch: &Batch, from: u32, rays: u64, scratch: &mut Scratch) {
        let (mut tickets, mut count, mut left) = ([0u16; ALONE as usize], 0, rays);
        while left != 0 && count < tickets.len() {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let ticket = self.number * RAYS + lane;
            scratch.rays[ticket].take(&scratch.bundles[self.number], lane);
            tickets[count] = ticket as u16;
            count += 1;
        }
        let tickets = Tickets { tickets: &tickets[..count], from, lazy: true };
        // SAFETY: the caller's promise.
        unsafe { I::fly(batch, &mut scratch.bundles, &mut scratch.rays, &tickets, &mut scratch.stacks) };
    }
}

#[inline(always)]
pub const fn group_mask<V: Vector>() -> u32 {
    (1 << V::COUNT) - 1
}

/// Those of the rays that enter before their limits.
///
/// # Safety
/// The level's instructions are there; both arrays are aligned to 64 bytes.
#[inline(always)]
unsafe fn still_wanted<V: Vector>(t: &[f32; RAYS], limit: &[f32; RAYS], rays: u64) -> u64 {
    let (mut late, mut at) = (0, 0);
    while at < RAYS {
        // SAFETY: the caller's promise.
        late |= u64::from(unsafe { V::load(t.as_ptr().add(at)).gt(V::load(limit.as_ptr().add(at))) }) << at;
        at += V::COUNT;
    }
    rays & !late
}
