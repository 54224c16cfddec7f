//! A ray that goes its own way: what a node and a block ask of it on two cache lines, while `bundle` has it in a lane of many arrays.

use std::mem::offset_of;

use super::bundle::{Bundle, Progress, RAYS};
use super::filter::FilterRay;
use super::lanes::Eight;
use super::questions::Walked;
use super::tree::{Block, EMPTY, Node, TreeView, WIDTH, candidate};
use crate::geometry::NONE;

/// One ray, and what has been found for it.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub struct Lone {
    inverse: [f32; 3],
    pub t_min: f32,
    near_origin: [f32; 3],
    pub start: u32,
    far_origin: [f32; 3],
    class: u32,
    pub progress: Progress,
    pub filter: FilterRay,
    /// Rows of [`Node::planes`] that are entered by, as numbers before them.
    near: [u16; 3],
    pub any: bool,
    /// Whether f32 can hold the filter's numbers.
    pub filters: bool,
}

/// What came of meeting a block, beside the progress.
pub enum Met {
    Nothing,
    /// Something is surely hit by a ray that asks for no more.
    Any,
    /// These f64 has to decide.
    Unsure(u32),
}

/// What follows from a class: the axes of the filter, and [`Lone::near`].
static OF_CLASS: [([u8; 3], [u16; 3]); 24] = {
    let mut table = [([0; 3], [0; 3]); 24];
    let mut class = 0;
    while class < 24 {
        let main = class as u8 / 8;
        table[class].0 = [(main + 1) % 3, (main + 2) % 3, main];
        let mut axis = 0;
        while axis < 3 {
            let row = if class >> axis & 1 == 1 { axis + 3 } else { axis };
            table[class].1[axis] = (row * WIDTH) as u16;
            axis += 1;
        }
        class += 1;
    }
    table
};

impl Lone {
    pub const NONE: Lone = Lone {
        inverse: [0.0; 3],
        t_min: 0.0,
        near_origin: [0.0; 3],
        start: NONE,
        far_origin: [0.0; 3],
        class: 0,
        progress: Progress { limit: 0.0, sure: [0.0; 2], low: 0.0, high: 0.0, candidate: NONE },
        filter: FilterRay {
            origin: [0.0; 3],
            inverse_z: 0.0,
            shear: [0.0; 2],
            over_square: 0.0,
            linear: 0.0,
            squared: 0.0,
            t_delta: 0.0,
            axes: [0; 3],
        },
        near: [0; 3],
        any: false,
        filters: false,
    };

    /// Takes a bundle's ray, as far as it has come. In place: a ray that is moved right after it was put together number by number would have to be waited for.
    #[inline(always)]
    pub fn take(&mut self, bundle: &Bundle, lane: usize) {
        let lane = lane & (RAYS - 1);
        for axis in 0..3 {
            self.inverse[axis] = bundle.inverse[axis][lane];
            self.near_origin[axis] = bundle.near_origin[axis][lane];
            self.far_origin[axis] = bundle.far_origin[axis][lane];
        }
        self.class = bundle.class[lane];
        (self.t_min, self.start) = (bundle.t_min[lane], bundle.start[lane]);
        self.filter = bundle.filter_ray(lane);
        self.progress = bundle.progress(lane);
        self.take_common(bundle, lane);
    }

    /// What isn't in lanes of the bundle.
    #[inline(always)]
    fn take_common(&mut self, bundle: &Bundle, lane: usize) {
        let (axes, near) = OF_CLASS[bundle.class[lane] as usize];
        (self.filter.linear, self.filter.squared) = (bundle.linear, bundle.squared);
        (self.filter.t_delta, self.filter.over_square) = (bundle.t_delta, bundle.over_square[lane]);
        (self.filter.axes, self.near) = (axes, near);
        (self.any, self.filters) = (bundle.any >> lane & 1 == 1, bundle.filters);
    }

    /// Packs the children of a node that it enters, far ones first, with where it enters them. Eight places are written at both. Returns their number, and
    /// the nearest if there is one.
    ///
    /// # Safety
    /// The level's instructions are there; the places are.
    #[inline(always)]
    pub unsafe fn enter<E: Eight>(&self, node: &Node, children: *mut u32, t: *mut f32) -> (usize, u32) {
        // SAFETY: the caller's promise; a node's planes are aligned as it is, and rows are 0 to 5.
        unsafe {
            let planes: *const f32 = node.planes.as_ptr().cast();
            let (mut near, mut far) = (E::splat(self.t_min), E::splat(self.progress.limit));
            for axis in 0..3 {
                let row = usize::from(self.near[axis]);
                let other = (2 * axis + 3) * WIDTH - row;
                let inverse = E::splat(self.inverse[axis]);
                let enters = E::load(planes.add(row)).mul_sub(inverse, E::splat(self.near_origin[axis]));
                let leaves = E::load(planes.add(other)).mul_sub(inverse, E::splat(self.far_origin[axis]));
                (near, far) = (enters.max(near), leaves.min(far));
            }
            let order = *node.order.get_unchecked((self.class & 7) as usize);
            let places = near.pack(far, order, node.children.as_ptr(), children, t);
            // The last place is the nearest child's; of none the number is any.
            let nearest = order >> (28 - places.leading_zeros() % 8 * 4) & 7;
            (places.count_ones() as usize, *node.children.get_unchecked(nearest as usize))
        }
    }
}

/// What one ray asks of a block.
pub struct Asking<'r> {
    pub tree: TreeView<'r>,
    pub filter: &'r FilterRay,
    pub start: u32,
    pub t_min: f32,
    pub any: bool,
}

impl Asking<'_> {
    /// Judges the primitives `all` of a block, and takes the nearest that is surely met as the candidate. Unless it is `lazy`, f32 may be sure of nothing but misses.
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
        let (judged, open) = unsafe {
            let own = E::same(block.ids.as_ptr(), self.start);
            if are_spheres {
                let spheres = self.filter.judge_spheres::<E>(&block.corners, self.t_min, progress.limit, all);
                (spheres.judged, all & !(spheres.judged.out | (spheres.leaving & own)))
            } else {
                // A triangle that the ray starts on isn't met again.
                let wanted = all & !own;
                let judged = self.filter.judge::<E>(&block.corners, self.t_min, progress.limit, wanted);
                (judged, wanted & !judged.out)
            }
        };
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
                if low > progress.limit {
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

/// Makes rays of a bundle, none of which has gone anywhere, ready to go alone: those of the lanes that enter some child of the root, which are returned; the others meet nothing.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn set_out<E: Eight>(walked: &Walked, bundle: &Bundle, lanes: u64, rays: &mut [Lone]) -> u64 {
    const { assert!(offset_of!(Lone, progress) == 12 * 4 && offset_of!(Lone, filter) == 18 * 4) };
    const { assert!(size_of::<Lone>() == 128) };
    let rays = &mut rays[..RAYS];
    let mut lanes = lanes;
    // Of numbers that f32 can't hold it can't tell what is entered first.
    if bundle.filters {
        // SAFETY: the caller's promise.
        lanes = unsafe { entering::<E>(&walked.tree.nodes[0], bundle, lanes) };
    }
    for group in 0..RAYS / WIDTH {
        let at = group * WIDTH;
        if lanes >> at & 0xff == 0 {
            continue;
        }
        // No closures: the compiler doesn't always inline the instructions of a level into them.
        macro_rules! from {
            ($array:expr) => {
                $array.as_ptr().add(at).cast::<f32>()
            };
        }
        // SAFETY: a bundle's arrays are aligned to 64 bytes and hold eight numbers from `at` on; these are the first 24 numbers of a ray; the rest is the
        // caller's promise.
        unsafe {
            let to: *mut f32 = rays.as_mut_ptr().add(at).cast();
            let ([ix, iy, iz], [nx, ny, nz]) = (&bundle.inverse, &bundle.near_origin);
            let rows = [
                from!(ix),
                from!(iy),
                from!(iz),
                from!(bundle.t_min),
                from!(nx),
                from!(ny),
                from!(nz),
                from!(bundle.start),
            ];
            E::transpose(rows, to, PER_RAY);
            let ([fx, fy, fz], [after, before]) = (&bundle.far_origin, &bundle.sure);
            let rows = [
                from!(fx),
                from!(fy),
                from!(fz),
                from!(bundle.class),
                from!(bundle.limit),
                from!(after),
                from!(before),
                from!(bundle.low),
            ];
            E::transpose(rows, to.add(8), PER_RAY);
            let ([ox, oy, oz], [sx, sy]) = (&bundle.origin, &bundle.shear);
            let rows = [
                from!(bundle.high),
                from!(bundle.candidate),
                from!(ox),
                from!(oy),
                from!(oz),
                from!(bundle.inverse_z),
                from!(sx),
                from!(sy),
            ];
            E::transpose(rows, to.add(16), PER_RAY);
        }
        for lane in at..at + WIDTH {
            rays[lane].take_common(bundle, lane);
        }
    }
    lanes
}

/// Numbers that a [`Lone`] is.
const PER_RAY: usize = size_of::<Lone>() / size_of::<f32>();

/// Which of these lanes enter some child of a node.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
unsafe fn entering<E: Eight>(node: &Node, bundle: &Bundle, lanes: u64) -> u64 {
    let mut entering = 0;
    for at in (0..RAYS).step_by(WIDTH) {
        let (wanted, mut some, mut k) = ((lanes >> at) as u32 & 0xff, 0, 0);
        // SAFETY: a bundle's arrays are aligned to 64 bytes and hold eight numbers from `at` on; the rest is the caller's promise.
        unsafe {
            let zero = E::splat(0.0);
            let (mut inverse, mut near_origin, mut far_origin) = ([zero; 3], [zero; 3], [zero; 3]);
            for axis in 0..3 {
                inverse[axis] = E::load(bundle.inverse[axis].as_ptr().add(at));
                near_origin[axis] = E::load(bundle.near_origin[axis].as_ptr().add(at));
                far_origin[axis] = E::load(bundle.far_origin[axis].as_ptr().add(at));
            }
            while k < WIDTH && wanted & !some != 0 {
                let mut near = E::load(bundle.t_min.as_ptr().add(at));
                let mut far = E::load(bundle.limit.as_ptr().add(at));
                for axis in 0..3 {
                    // By which of the two planes a lane enters is its own: the one that comes first.
                    let (low, high) = (E::splat(node.planes[axis][k]), E::splat(node.planes[axis + 3][k]));
                    let (inverse, near_origin, far_origin) =
                        (inverse[axis], near_origin[axis], far_origin[axis]);
                    let first = low.mul_sub(inverse, near_origin).min(high.mul_sub(inverse, near_origin));
                    let last = low.mul_sub(inverse, far_origin).max(high.mul_sub(inverse, far_origin));
                    (near, far) = (first.max(near), last.min(far));
                }
                // The planes of a missing child are none.
                if node.children[k] != EMPTY {
                    some |= !near.gt(far);
                }
                k += 1;
            }
        }
        entering |= u64::from(some & wanted) << at;
    }
    entering
}
