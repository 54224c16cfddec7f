//! What a batch asks, and of what.

use super::slices::Cells;
use super::tree::TreeView;
use crate::geometry::Ray;
use crate::geometry::record::{Query, RayRecord};
use crate::scene::Surfaces;

/// What is walked.
#[derive(Clone, Copy)]
pub struct Walked<'a> {
    pub tree: TreeView<'a>,
    pub surfaces: &'a Surfaces,
    /// The largest magnitude of a coordinate of the boxes.
    pub extent: f64,
    /// The same of all that rays may start on.
    pub starts_extent: f64,
    /// Corners of the scene's box.
    pub low: [f32; 3],
    pub high: [f32; 3],
    /// The grid that packets go through in place of the tree.
    pub cells: Option<Cells<'a>>,
}

/// The rays of a batch.
pub trait Questions {
    /// A ray, and whether anything that it meets will do.
    fn question(&self, index: usize) -> (Ray, bool);

    /// Fetches what a question will be read from into the cache.
    fn prefetch(&self, index: usize);
}

/// Fetches a record ahead of its use; one beyond the end is none.
#[inline(always)]
pub fn prefetch_record<T>(records: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let from: *const i8 = records.as_ptr().wrapping_add(index).cast();
        for line in (0..size_of::<T>()).step_by(64) {
            // SAFETY: a hint; any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.wrapping_add(line)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (records, index);
}

impl Questions for [RayRecord] {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (self[index].ray(), self[index].query() == Query::Occluded)
    }

    #[inline(always)]
    fn prefetch(&self, index: usize) {
        prefetch_record(self, index);
    }
}

impl Questions for (&[Ray], bool) {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (self.0[index], self.1)
    }

    #[inline(always)]
    fn prefetch(&self, index: usize) {
        prefetch_record(self.0, index);
    }
}

impl<Q: Questions + ?Sized> Questions for &Q {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (**self).question(index)
    }

    #[inline(always)]
    fn prefetch(&self, index: usize) {
        (**self).prefetch(index);
    }
}

/// The batch, and what its rays go through. Kernels are compiled once for all kinds of questions: only where bundles are filled each ray is read by its own kind's code.
#[derive(Clone, Copy)]
pub struct Batch<'a, 'q> {
    pub walked: &'q Walked<'a>,
    pub questions: &'q dyn Questions,
}
