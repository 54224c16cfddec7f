//! The product's own traversal: a tree of eight children per node, walked by many rays at once.
//!
//! Made of a binary tree that is built from the top down: soon (`binned`), with what overlaps put where it costs less (`reinsert`), or with spatial splits (`spatial`). Any number of
//! threads builds the same tree.

mod beam;
mod binned;
mod bundle;
mod collapse;
mod decide;
mod filter;
mod finish;
mod flight;
mod lanes;
mod lone;
mod packet;
mod piece;
mod questions;
mod reinsert;
pub mod sieve;
pub mod slices;
mod spatial;
mod sphere_filter;
pub mod traversal;
pub mod tree;
mod walk;

use std::cell::RefCell;

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

use super::lattice::Lattice;
use super::solid;
use crate::geometry::record::{Answer, RayRecord};
use crate::geometry::{Ray, round_down, round_up};
use crate::memory::{Array, HugeArray};
use crate::scene::Surfaces;
use crate::settings::BuildPreset;
use crate::simd::Level;
use questions::Walked;
pub use questions::{PlainRays, Questions, prefetch_record};
use slices::Cells;
use spatial::Cuts;
use traversal::Traversal;
use tree::{Tree, TreeView, WIDTH};
use walk::Scratch;

/// Bytes of nodes and blocks for each triangle, about: 57 to 67 were measured on terrains, scanned models and an interior, and 73 to 97 with spatial splits.
pub const BYTES: u64 = 80;
/// The same for each sphere: 145 to 149 were measured on sphereflakes.
pub const BYTES_OF_SPHERE: u64 = 150;

/// Bytes for each primitive while the tree is built: about 100 were measured on a terrain of 4.2 million triangles, and 280 with one in each leaf, as where spheres lie among
/// triangles. With all the leaves that spatial splits may add more in proportion.
pub fn bytes_to_build(preset: BuildPreset) -> u64 {
    match preset {
        BuildPreset::Fast | BuildPreset::Balanced => 300,
        BuildPreset::Best => 520,
    }
}

/// Pieces of a leaf where they may be cut: with more, blocks of interiors are met more often; with fewer, rays gain nothing.
const MOST_CUT: usize = 4;
/// Share of a balanced tree's nodes that reinsertion tries. On scanned models there is little to gain; inside Sponza rays visit 0.89 of the nodes and blocks, and more tries make
/// it 0.85, but views from outside worse.
const BALANCED: f32 = 0.2;

/// The tree and where it lies.
#[derive(Clone, Debug, Default)]
pub struct Wide {
    pub tree: Tree,
    /// Corners of the box around everything.
    pub low: [f32; 3],
    pub high: [f32; 3],
    /// The largest magnitude of a coordinate of what rays may start on, if that is more than what the tree is over.
    pub starts_extent: f64,
}

/// Runs what is compiled for a level, which the processor must have.
macro_rules! at_level {
    ($level:expr, $instructions:ident => $run:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => {
                type $instructions = walk::Avx2;
                $run
            }
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => {
                type $instructions = walk::Avx512;
                $run
            }
            // Other architectures have no other.
            _ => {
                type $instructions = walk::Baseline;
                $run
            }
        }
    };
}

thread_local! {
    /// Kept between batches.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl Wide {
    /// Builds over all primitives but triangles without area. On the current rayon pool.
    pub fn build(surfaces: &Surfaces, preset: BuildPreset) -> Wide {
        Wide::build_over(surfaces, &solid(surfaces), preset)
    }

    /// Builds over these primitives.
    pub fn build_over(surfaces: &Surfaces, ids: &[u32], preset: BuildPreset) -> Wide {
        if ids.is_empty() {
            return Wide::default();
        }
        let mut boxes = HugeArray::zeroed(ids.len()).expect("memory for boxes");
        boxes.par_iter_mut().zip(ids).for_each(|(slot, &id)| *slot = bounds(surfaces, id));
        let most = in_a_leaf(surfaces);
        let binary = match preset {
            BuildPreset::Fast => binned::build(boxes, most),
            BuildPreset::Balanced => {
                let mut binary = binned::build(boxes, most);
                reinsert::reinsert(&mut binary, BALANCED);
                binary
            }
            BuildPreset::Best => {
                spatial::build(surfaces, ids, &boxes, Cuts::usual(ids.len()), most.min(MOST_CUT))
            }
        };
        Wide::of(&binary, ids, surfaces)
    }

    /// The wide tree of a binary one over the primitives `ids`.
    fn of(binary: &Bvh2, ids: &[u32], surfaces: &Surfaces) -> Wide {
        let tree = collapse::collapse(binary, ids, surfaces);
        let root = &binary.nodes[0];
        Wide { tree, low: root.min.to_array(), high: root.max.to_array(), starts_extent: 0.0 }
    }

    /// Bytes of nodes and blocks.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.tree.nodes) + size_of_val(&*self.tree.blocks)
    }

    /// Answers a batch of records in their order.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut [Answer]) {
        self.answer(Level::chosen(), Traversal::Chosen, surfaces, &records, answers);
    }

    /// The least (t, primitive id) that each ray meets, or whether it meets anything: then a hit is primitive 0.
    ///
    /// # Panics
    /// At a level that the processor lacks.
    pub fn trace_at(
        &self,
        level: Level,
        traversal: Traversal,
        surfaces: &Surfaces,
        questions: &impl Questions,
        answers: &mut [Answer],
    ) {
        assert!(level.is_available(), "{} isn't there", level.name());
        self.answer(level, traversal, surfaces, questions, answers);
    }

    /// As [`trace_at`](Self::trace_at) for plain rays, of which all or none ask only whether there is `any` hit.
    pub fn trace_rays(
        &self,
        level: Level,
        surfaces: &Surfaces,
        rays: &[Ray],
        any: bool,
        answers: &mut [Answer],
    ) {
        self.trace_at(level, Traversal::Chosen, surfaces, &(rays, any), answers);
    }

    fn answer(
        &self,
        level: Level,
        traversal: Traversal,
        surfaces: &Surfaces,
        questions: &impl Questions,
        answers: &mut [Answer],
    ) {
        if self.tree.nodes.is_empty() {
            answers.fill(Answer::MISS);
            return;
        }
        let extent = self.low.iter().chain(&self.high).fold(0.0, |m: f64, c| m.max(f64::from(c.abs())));
        let (tree, low, high, starts_extent) =
            (self.tree.view(), self.low, self.high, self.starts_extent.max(extent));
        let walked = Walked { tree, surfaces, extent, starts_extent, low, high, cells: None };
        SCRATCH.with_borrow_mut(|scratch| {
            // SAFETY: levels that the processor lacks are never chosen, and refused by `trace_at`.
            unsafe { at_level!(level, I => walk::walk::<I>(&walked, traversal, questions, answers, scratch)) }
        });
    }
}

/// Answers the rays of a batch that can go through a grid's cells in packets, and adds the others to `alone`.
///
/// # Panics
/// At a level that the processor lacks.
pub fn through_cells(
    level: Level,
    cells: Cells,
    surfaces: &Surfaces,
    questions: &impl Questions,
    answers: &mut [Answer],
    alone: &mut Vec<usize>,
) {
    assert!(level.is_available(), "{} isn't there", level.name());
    let Lattice { low, counts, extent, .. } = *cells.lattice;
    let high = std::array::from_fn(|axis| round_up(cells.lattice.plane(axis, counts[axis] as i32)));
    let low = low.map(round_down);
    let tree = TreeView { nodes: &[], blocks: &[], stack_size: 0 };
    let starts_extent = cells.starts_extent.max(extent);
    let walked = Walked { tree, surfaces, extent, starts_extent, low, high, cells: Some(cells) };
    SCRATCH.with_borrow_mut(|scratch| {
        // SAFETY: asked above.
        unsafe {
            at_level!(level, I => walk::through_cells::<I>(&walked, questions, answers, scratch, alone))
        }
    });
}

/// How many primitives a binary leaf may have: as many as a block, but a block has primitives of one kind.
fn in_a_leaf(surfaces: &Surfaces) -> usize {
    if surfaces.spheres.is_empty() || surfaces.triangles.is_empty() { WIDTH } else { 1 }
}

fn bounds(surfaces: &Surfaces, id: u32) -> Aabb {
    match surfaces.sphere_at(id) {
        None => {
            let [a, b, c] = surfaces.triangle(id).map(glam::Vec3A::from);
            Aabb::new(a.min(b).min(c), a.max(b).max(c))
        }
        Some(sphere) => {
            let side = |sign: f64| {
                let c = sphere.center.map(|c| f64::from(c) + sign * f64::from(sphere.radius));
                // Rounded outwards: a sphere's box has no f32 corners of its own.
                glam::Vec3A::from(
                    c.map(|c| if sign < 0.0 { (c as f32).next_down() } else { (c as f32).next_up() }),
                )
            };
            Aabb::new(side(-1.0), side(1.0))
        }
    }
}

#[cfg(test)]
mod tests;
