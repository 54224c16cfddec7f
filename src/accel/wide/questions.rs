//! What a batch asks, and of what.

use std::mem::{MaybeUninit, offset_of};
use std::ops::Range;

use glam::DVec3;

use super::bundle::{Exact, RAYS};
use super::lanes::Eight;
use super::slices::Cells;
use super::tree::TreeView;
use crate::geometry::record::{Query, RayRecord};
use crate::geometry::{NONE, Ray};
use crate::scene::Surfaces;
use crate::scene::frame::Frame;

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

    /// Reads the questions from `first` on into the first lanes; a bit for each that asks for any hit.
    ///
    /// # Safety
    /// The level's instructions are there; there are `count` questions, at most 64.
    #[inline(always)]
    unsafe fn gather<E: Eight>(
        &self,
        first: usize,
        count: usize,
        exact: &mut Exact,
        start: &mut [u32; RAYS],
    ) -> u64
    where
        Self: Sized,
    {
        one_by_one(self, first, 0..count, exact, start)
    }
}

/// Reads the questions of some lanes; a bit for each that asks for any hit.
#[inline(always)]
fn one_by_one(
    questions: &impl Questions,
    first: usize,
    lanes: Range<usize>,
    exact: &mut Exact,
    start: &mut [u32; RAYS],
) -> u64 {
    let mut some = 0;
    for lane in lanes {
        questions.prefetch(first + lane + RAYS);
        let (ray, any) = questions.question(first + lane);
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        for axis in 0..3 {
            exact.origin[axis][lane] = origin[axis];
            exact.direction[axis][lane] = direction[axis];
        }
        (exact.t_min[lane], exact.t_max[lane]) = (ray.t_min, ray.t_max);
        start[lane] = ray.start;
        some |= u64::from(any) << lane;
    }
    some
}

/// Four lanes from `lane` on of what [`Exact`] begins with: origins, directions, `t_min` and `t_max`, as rays begin with them.
///
/// # Safety
/// The level's instructions are there; each row has eight numbers; `lane` is a multiple of four below [`RAYS`].
#[inline(always)]
unsafe fn take_rows<E: Eight>(rows: [*const f64; 4], lane: usize, exact: &mut Exact) {
    const {
        assert!(offset_of!(Exact, direction) == 3 * RAYS * 8 && offset_of!(Exact, t_min) == 6 * RAYS * 8);
        assert!(offset_of!(Exact, t_max) == 7 * RAYS * 8);
    }
    // SAFETY: eight columns of `RAYS` numbers begin where `exact` does, aligned to 64 bytes; the rest is the caller's promise.
    unsafe {
        let to = (&raw mut *exact).cast::<f64>().add(lane);
        E::transpose_doubles(rows, to, RAYS);
        let rows = [rows[0].add(4), rows[1].add(4), rows[2].add(4), rows[3].add(4)];
        E::transpose_doubles(rows, to.add(4 * RAYS), RAYS);
    }
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

impl Questions for &[RayRecord] {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        (self[index].ray(), self[index].query() == Query::Occluded)
    }

    #[inline(always)]
    fn prefetch(&self, index: usize) {
        prefetch_record(self, index);
    }

    #[inline(always)]
    unsafe fn gather<E: Eight>(
        &self,
        first: usize,
        count: usize,
        exact: &mut Exact,
        start: &mut [u32; RAYS],
    ) -> u64 {
        const {
            assert!(offset_of!(RayRecord, origin) == 0 && offset_of!(RayRecord, direction) == 24);
            assert!(offset_of!(RayRecord, t_min) == 48 && offset_of!(RayRecord, t_max) == 56);
        }
        let (records, fours) = (&self[first..first + count], count / 4 * 4);
        let mut some = 0;
        for lane in (0..fours).step_by(4) {
            let four = &records[lane..lane + 4];
            for (k, record) in four.iter().enumerate() {
                self.prefetch(first + lane + k + RAYS);
                start[lane + k] = record.start;
                some |= u64::from(record.query() == Query::Occluded) << (lane + k);
            }
            // SAFETY: records begin with these eight numbers; the rest is the caller's promise.
            unsafe {
                let from: *const RayRecord = four.as_ptr();
                let rows = [from.cast(), from.add(1).cast(), from.add(2).cast(), from.add(3).cast()];
                take_rows::<E>(rows, lane, exact);
            }
        }
        some | one_by_one(self, first, fours..count, exact, start)
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

/// Of the batch, whatever its kind: each ray by a call.
impl Questions for &dyn Questions {
    fn question(&self, index: usize) -> (Ray, bool) {
        (**self).question(index)
    }

    fn prefetch(&self, index: usize) {
        (**self).prefetch(index);
    }
}

/// Rays in f32, as files and other tracers have them: origin, `t_min`, direction, `t_max`, in world space.
pub struct PlainRays<'a> {
    pub rays: &'a [[f32; 8]],
    /// The way into stored space.
    pub frame: &'a Frame,
    pub any: bool,
}

impl Questions for PlainRays<'_> {
    #[inline(always)]
    fn question(&self, index: usize) -> (Ray, bool) {
        let [x, y, z, t_min, dx, dy, dz, t_max] = self.rays[index];
        let ray = Ray {
            origin: self.frame.to_stored(DVec3::new(f64::from(x), f64::from(y), f64::from(z))),
            direction: DVec3::new(f64::from(dx), f64::from(dy), f64::from(dz)),
            t_min: f64::from(t_min) * self.frame.scale,
            t_max: f64::from(t_max) * self.frame.scale,
            first_id: 0,
            start: NONE,
        };
        (ray, self.any)
    }

    #[inline(always)]
    fn prefetch(&self, index: usize) {
        prefetch_record(self.rays, index);
    }

    #[inline(always)]
    unsafe fn gather<E: Eight>(
        &self,
        first: usize,
        count: usize,
        exact: &mut Exact,
        start: &mut [u32; RAYS],
    ) -> u64 {
        if count != RAYS {
            return one_by_one(self, first, 0..count, exact, start);
        }
        #[repr(align(64))]
        struct Columns([[f32; RAYS]; 8]);
        let mut columns = MaybeUninit::<Columns>::uninit();
        let rays = &self.rays[first..first + RAYS];
        for lane in (0..RAYS).step_by(8) {
            let mut rows = [rays[lane].as_ptr(); 8];
            for (k, row) in rows.iter_mut().enumerate() {
                self.prefetch(first + lane + k + RAYS);
                *row = rays[lane + k].as_ptr();
            }
            // SAFETY: eight columns, aligned to 64 bytes; the rest is the caller's promise.
            unsafe { E::transpose(rows, columns.as_mut_ptr().cast::<f32>().add(lane), RAYS) };
        }
        // SAFETY: eight lanes of each of the eight columns have been written eight times: all.
        let columns = unsafe { columns.assume_init_ref() };
        let (shift, scale) = (self.frame.shift.to_array(), self.frame.scale);
        let [x, y, z, t_min, dx, dy, dz, t_max] = &columns.0;
        for (axis, from) in [x, y, z].into_iter().enumerate() {
            for lane in 0..RAYS {
                exact.origin[axis][lane] = (f64::from(from[lane]) - shift[axis]) * scale;
            }
        }
        for (axis, from) in [dx, dy, dz].into_iter().enumerate() {
            for lane in 0..RAYS {
                exact.direction[axis][lane] = f64::from(from[lane]);
            }
        }
        for lane in 0..RAYS {
            exact.t_min[lane] = f64::from(t_min[lane]) * scale;
            exact.t_max[lane] = f64::from(t_max[lane]) * scale;
        }
        *start = [NONE; RAYS];
        if self.any { u64::MAX } else { 0 }
    }
}

/// The batch, and what its rays go through. Kernels are compiled once for all kinds of questions: only where bundles are filled each ray is read by its own kind's code.
#[derive(Clone, Copy)]
pub struct Batch<'a, 'q> {
    pub walked: &'q Walked<'a>,
    pub questions: &'q dyn Questions,
}
