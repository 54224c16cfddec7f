//! Packets through a uniform grid: rays that go much the same way go slice by slice along their main axis, and the cells that they may reach in a slice are looked into for all
//! of them at once (Wald, Ize, Kensler, Knoll and Parker 2006, "Ray Tracing Animated Scenes Using Coherent Grid Traversal").
//!
//! Every point where a ray may meet something lies in a cell whose list has it (`lattice`); the cells of a slice that are looked into hold the part of each ray between the slice's planes,
//! which is known to within 11uL for what rounding does to the ray (`filter`), 2uL for the planes, and 6uL for the numbers of the cells: all in all less than the 24uL by which the
//! part is grown (and four times what moving origins from far outside costs). A primitive is tested once, against all rays that still want what lies in that slice or behind it, wherever it is.

use super::bundle::{Bundle, RAYS, axes};
use super::lanes::Vector;
use super::packet::{Packet, group_mask};
use super::questions::{Batch, Walked};
use super::tree::{Block, LEAF, SPHERE_CANDIDATE, SPHERES, TreeView, WIDTH, block_number, put};
use super::walk::{Instructions, Scratch};
use crate::accel::lattice::{BLOCK, Lattice};
use crate::scene::Surfaces;

/// What the rays go through.
#[derive(Clone, Copy)]
pub struct Cells<'c> {
    pub lattice: &'c Lattice,
    /// Where each cell's list begins; one more than cells.
    pub starts: &'c [u32],
    pub primitives: &'c [u32],
    /// For each block of cells which of them have something.
    pub occupied: &'c [u64],
    /// The largest magnitude of a coordinate of what rays may start on, if that is more than what is in the cells.
    pub starts_extent: f64,
}

/// Most cells of a slice that rays may reach and still are a packet.
const WIDEST: i32 = 48;
/// Places of the table of primitives that a packet has met.
const REMEMBERED: usize = 1024;

/// Primitives that the packets of a bundle have met, as blocks: those of candidates, and the newest.
pub struct Gathered {
    blocks: Vec<Block>,
    /// The blocks that are being filled, of triangles and of spheres, and how many primitives they have.
    open: [(Block, usize); 2],
    /// Primitives met by a packet: the primitive and the packet's number.
    met: Vec<[u32; 2]>,
    packet: u32,
}

impl Default for Gathered {
    fn default() -> Self {
        let empty = (bytemuck::Zeroable::zeroed(), 0);
        Gathered { blocks: Vec::new(), open: [empty; 2], met: vec![[0; 2]; REMEMBERED], packet: 0 }
    }
}

impl Gathered {
    /// Forgets what was met for other bundles.
    pub fn clear(&mut self) {
        self.blocks.clear();
    }

    /// As the blocks of a tree.
    pub fn view(&self) -> TreeView<'_> {
        TreeView { nodes: &[], blocks: &self.blocks, stack_size: 0 }
    }

    fn begin_packet(&mut self) {
        self.packet = self.packet.wrapping_add(1);
        if self.packet == 0 {
            self.met.fill([0; 2]);
            self.packet = 1;
        }
    }

    /// Adds a primitive unless the packet has met it. A block that is full by that is named as a child of a node would be.
    #[inline(always)]
    fn add(&mut self, surfaces: &Surfaces, id: u32) -> Option<u32> {
        let met = &mut self.met[id as usize % REMEMBERED];
        if *met == [id, self.packet] {
            return None;
        }
        *met = [id, self.packet];
        let kind = usize::from(id as usize >= surfaces.triangles.len());
        let (block, count) = &mut self.open[kind];
        put(&mut block.corners, *count, surfaces, id);
        block.ids[*count] = id;
        *count += 1;
        if *count == WIDTH { self.close(kind) } else { None }
    }

    /// Closes a block that is being filled, if there is something in it, and names it as a child of a node would be.
    #[inline(always)]
    fn close(&mut self, kind: usize) -> Option<u32> {
        let (block, count) = &mut self.open[kind];
        let last = count.checked_sub(1)?;
        *count = 0;
        let child =
            LEAF | (self.blocks.len() as u32) << 3 | last as u32 | if kind == 1 { SPHERES } else { 0 };
        self.blocks.push(*block);
        Some(child)
    }
}

/// The least and largest coordinates, along the two minor axes, of what rays have in a slice; a lane for each of a group's.
#[repr(C, align(64))]
struct Reach {
    least: [[f32; 16]; 2],
    most: [[f32; 16]; 2],
}

/// A packet's way through the slices.
struct Way<'c> {
    cells: Cells<'c>,
    /// The minor axes and the main one.
    axes: [usize; 3],
    forwards: bool,
    /// What the reach is grown by.
    pad: f32,
}

impl Packet {
    /// Goes through the cells; the rays that must go alone from their start on.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn through_cells<I: Instructions>(
        &self,
        batch: &Batch,
        cells: Cells,
        scratch: &mut Scratch,
    ) -> u64 {
        let mut gathered = scratch.gathered.take().unwrap_or_default();
        // SAFETY: the caller's promise.
        let alone = unsafe { self.slice_by_slice::<I>(batch, cells, &mut gathered, scratch) };
        scratch.gathered = Some(gathered);
        alone
    }

    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn slice_by_slice<I: Instructions>(
        &self,
        batch: &Batch,
        cells: Cells,
        gathered: &mut Gathered,
        scratch: &mut Scratch,
    ) -> u64 {
        let surfaces = batch.walked.surfaces;
        let axes = axes(self.class);
        let forwards = self.class >> axes[2] & 1 == 0;
        let way = Way { cells, axes, forwards, pad: 2.0 * scratch.bundles[self.number].pad };
        gathered.begin_packet();
        let last_slice = cells.lattice.counts[axes[2]] as i32 - 1;
        let step = if forwards { 1 } else { -1 };
        let edge = BLOCK as i32;
        let mut slice = way.first_slice(&scratch.bundles[self.number], self.lanes);
        while (0..=last_slice).contains(&slice) {
            let bundle = &*scratch.bundles[self.number];
            let alive = self.lanes & !bundle.found;
            // A layer of blocks at once, where one begins.
            let layer = slice / edge;
            let [low, high] = [layer * edge, (layer * edge + edge - 1).min(last_slice)];
            let layer_ends @ [layer_begin, layer_end] = if forwards { [low, high] } else { [high, low] };
            // SAFETY: the caller's promise.
            unsafe {
                if slice == layer_begin {
                    let (wanting, reach) = way.reach::<I::Most>(bundle, alive, layer_ends);
                    if wanting == 0 {
                        break;
                    }
                    if !reach.is_some_and(|reach| way.is_occupied(reach, layer)) {
                        slice = layer_end + step;
                        continue;
                    }
                }
                let (wanting, reach) = way.reach::<I::Most>(bundle, alive, [slice, slice]);
                if wanting == 0 {
                    break;
                }
                if let Some([[x0, x1], [y0, y1]]) = reach {
                    if (x1 - x0 + 1) * (y1 - y0 + 1) > WIDEST {
                        return wanting;
                    }
                    for y in y0..=y1 {
                        for x in x0..=x1 {
                            let mut cell = [0; 3];
                            (cell[axes[0]], cell[axes[1]], cell[axes[2]]) =
                                (x as u32, y as u32, slice as u32);
                            let number = cells.lattice.number(cell);
                            let list = cells.starts[number] as usize..cells.starts[number + 1] as usize;
                            for &id in &cells.primitives[list] {
                                if let Some(child) = gathered.add(surfaces, id) {
                                    self.meet_gathered::<I>(batch, child, wanting, gathered, scratch);
                                }
                            }
                        }
                    }
                    for kind in 0..2 {
                        if let Some(child) = gathered.close(kind) {
                            self.meet_gathered::<I>(batch, child, wanting, gathered, scratch);
                        }
                    }
                }
            }
            slice += step;
        }
        0
    }

    /// Tests a gathered block against rays.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn meet_gathered<I: Instructions>(
        &self,
        batch: &Batch,
        child: u32,
        rays: u64,
        gathered: &mut Gathered,
        scratch: &mut Scratch,
    ) {
        let walked = Walked { tree: gathered.view(), ..*batch.walked };
        let batch = Batch { walked: &walked, questions: batch.questions };
        // Some may have found what they ask since the slice was begun.
        let rays = rays & !scratch.bundles[self.number].found;
        // SAFETY: the caller's promise.
        unsafe { self.visit::<I>(&batch, child, rays, scratch) };
        // Only blocks of candidates are asked for again.
        let number = block_number(child);
        let mut is_named = false;
        for candidate in &scratch.bundles[self.number].candidate {
            is_named |= (candidate & !SPHERE_CANDIDATE) >> 3 == number;
        }
        if !is_named {
            gathered.blocks.pop();
        }
    }
}

impl Way<'_> {
    /// Where a plane of the lattice is along an axis.
    #[inline(always)]
    fn plane(&self, axis: usize, number: i32) -> f32 {
        self.cells.lattice.plane(axis, number) as f32
    }

    /// Cells along an axis, unclamped, from its least to its largest coordinate.
    #[inline(always)]
    fn along(&self, axis: usize, [least, most]: [f32; 2]) -> [i32; 2] {
        // Casts saturate.
        let at = |coordinate: f32| self.cells.lattice.beside(axis, f64::from(coordinate)) as i32;
        [at(least - self.pad), at(most + self.pad)]
    }

    /// The slice in which the first ray begins.
    fn first_slice(&self, bundle: &Bundle, lanes: u64) -> i32 {
        let axis = self.axes[2];
        let (mut least, mut most, mut left) = (f32::INFINITY, f32::NEG_INFINITY, lanes);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let at = bundle.origin[axis][lane] + bundle.t_min[lane] * bundle.direction[axis][lane];
            (least, most) = (least.min(at), most.max(at));
        }
        let [first, last] = self.along(axis, [least, most]);
        let most = self.cells.lattice.counts[axis] as i32 - 1;
        if self.forwards { first.max(0) } else { last.min(most) }
    }

    /// The rays that still want what lies in slices `first` to `last`, in the order in which rays come to them, or beyond; and the cells along the minor axes that those of
    /// these rays reach that have begun, if there are any.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    unsafe fn reach<V: Vector>(
        &self,
        bundle: &Bundle,
        alive: u64,
        [first, last]: [i32; 2],
    ) -> (u64, Option<[[i32; 2]; 2]>) {
        let [kx, ky, kz] = self.axes;
        let (begin, end) = if self.forwards { (first, last + 1) } else { (first + 1, last) };
        let (begin, end) = (self.plane(kz, begin), self.plane(kz, end));
        let mut reach = Reach { least: [[f32::INFINITY; 16]; 2], most: [[f32::NEG_INFINITY; 16]; 2] };
        let (mut wanting, mut any, mut at) = (0, 0, 0);
        // SAFETY: the bundle's arrays and those of the reach are aligned to 64 bytes, and hold `COUNT` numbers from `at` on; the rest is the caller's promise.
        unsafe {
            let (begin, end) = (V::splat(begin), V::splat(end));
            while at < RAYS {
                let group = (alive >> at) as u32 & group_mask::<V>();
                if group != 0 {
                    // No closure: the compiler doesn't inline the instructions of a level into one.
                    let inverse = V::load(bundle.inverse[kz].as_ptr().add(at));
                    let enter = begin.mul_sub(inverse, V::load(bundle.near_origin[kz].as_ptr().add(at)));
                    let leave = end.mul_sub(inverse, V::load(bundle.far_origin[kz].as_ptr().add(at)));
                    let group = group & !enter.gt(V::load(bundle.limit.as_ptr().add(at)));
                    wanting |= u64::from(group) << at;
                    let group = group & !V::load(bundle.t_min.as_ptr().add(at)).gt(leave);
                    any |= group;
                    let origin = V::load(bundle.origin[kz].as_ptr().add(at));
                    let (from, to) = (begin.sub(origin), end.sub(origin));
                    for minor in 0..2 {
                        let shear = V::load(bundle.shear[minor].as_ptr().add(at));
                        let origin = V::load(bundle.origin[[kx, ky][minor]].as_ptr().add(at));
                        let (a, b) = (from.mul_add(shear, origin), to.mul_add(shear, origin));
                        let (least, most) = (reach.least[minor].as_mut_ptr(), reach.most[minor].as_mut_ptr());
                        a.min(b).min(V::load(least)).store_where(group, least);
                        a.max(b).max(V::load(most)).store_where(group, most);
                    }
                }
                at += V::COUNT;
            }
            if any == 0 {
                return (wanting, None);
            }
            let mut cells = [[0; 2]; 2];
            for (minor, axis) in [kx, ky].into_iter().enumerate() {
                let least = V::splat(0.0).sub(V::load(reach.least[minor].as_ptr())).largest();
                let most = V::load(reach.most[minor].as_ptr()).largest();
                let [from, to] = self.along(axis, [-least, most]);
                let (from, to) = (from.max(0), to.min(self.cells.lattice.counts[axis] as i32 - 1));
                if from > to {
                    return (wanting, None);
                }
                cells[minor] = [from, to];
            }
            (wanting, Some(cells))
        }
    }

    /// Whether a block that the rays reach in a layer of blocks has something.
    #[inline(always)]
    fn is_occupied(&self, [[x0, x1], [y0, y1]]: [[i32; 2]; 2], layer: i32) -> bool {
        let edge = BLOCK as i32;
        let mut cell = [0; 3];
        cell[self.axes[2]] = (layer * edge) as u32;
        (y0 / edge..=y1 / edge).any(|y| {
            (x0 / edge..=x1 / edge).any(|x| {
                let mut cell = cell;
                (cell[self.axes[0]], cell[self.axes[1]]) = ((x * edge) as u32, (y * edge) as u32);
                self.cells.occupied[self.cells.lattice.block(cell).0] != 0
            })
        })
    }
}
