//! What the rays of a packet have in common, judged as one by interval arithmetic (Boulos, Wald and Shirley 2006, "Geometric and Arithmetic Culling Methods for Entire
//! Ray Packets").

use super::bundle::{Bundle, RAYS};
use super::lanes::{Eight, Vector};
use super::tree::{Block, Node, WIDTH};

/// Bounds of what the rays of a packet have in common.
pub struct Beam {
    /// Least and largest of the origin's coordinates, of the inverse directions, and of the shears.
    pub origin: [[f32; 2]; 3],
    inverse: [[f32; 2]; 3],
    pub shear: [[f32; 2]; 2],
    /// The error of a sheared coordinate.
    delta: f32,
    /// What slabs are padded by.
    pad: f32,
    t_min: f32,
}

/// Least and largest of the values of some lanes.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
unsafe fn range<V: Vector>(values: &[f32; RAYS], lanes: u64) -> [f32; 2] {
    if lanes == u64::MAX {
        // SAFETY: the array lies in a bundle, aligned to 64 bytes; the rest is the caller's promise.
        unsafe {
            let first = V::load(values.as_ptr());
            let (mut least, mut most) = (first, first);
            let mut at = V::COUNT;
            while at < RAYS {
                let next = V::load(values.as_ptr().add(at));
                (least, most) = (least.min(next), most.max(next));
                at += V::COUNT;
            }
            return [-V::splat(0.0).sub(least).largest(), most.largest()];
        }
    }
    let (mut least, mut most, mut left) = (f32::INFINITY, f32::NEG_INFINITY, lanes);
    while left != 0 {
        let value = values[left.trailing_zeros() as usize];
        left &= left - 1;
        (least, most) = (least.min(value), most.max(value));
    }
    [least, most]
}

/// The largest of the values of some lanes.
///
/// # Safety
/// The level's instructions are there.
#[inline(always)]
pub unsafe fn largest<V: Vector>(values: &[f32; RAYS], lanes: u64) -> f32 {
    if lanes == u64::MAX {
        // SAFETY: the array lies in a bundle, aligned to 64 bytes; the rest is the caller's promise.
        unsafe {
            let (mut most, mut at) = (V::load(values.as_ptr()), V::COUNT);
            while at < RAYS {
                most = most.max(V::load(values.as_ptr().add(at)));
                at += V::COUNT;
            }
            return most.largest();
        }
    }
    // SAFETY: the caller's promise.
    unsafe { range::<V>(values, lanes)[1] }
}

impl Beam {
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn new<V: Vector>(bundle: &Bundle, lanes: u64) -> Beam {
        // SAFETY: the caller's promise.
        unsafe {
            Beam {
                origin: [
                    range::<V>(&bundle.origin[0], lanes),
                    range::<V>(&bundle.origin[1], lanes),
                    range::<V>(&bundle.origin[2], lanes),
                ],
                inverse: [
                    range::<V>(&bundle.inverse[0], lanes),
                    range::<V>(&bundle.inverse[1], lanes),
                    range::<V>(&bundle.inverse[2], lanes),
                ],
                shear: [range::<V>(&bundle.shear[0], lanes), range::<V>(&bundle.shear[1], lanes)],
                delta: bundle.delta,
                pad: bundle.pad,
                t_min: range::<V>(&bundle.t_min, lanes)[0],
            }
        }
    }

    /// A bit for each of the triangles of a block that some ray may meet. Of the others all three sheared vertices lie on one side of every ray, farther than `delta`.
    ///
    /// # Safety
    /// The level's instructions are there.
    #[inline(always)]
    pub unsafe fn touches<E: Vector>(&self, block: &Block, [kx, ky, kz]: [usize; 3]) -> u32 {
        // SAFETY: corners are aligned as their block is; the rest is the caller's promise.
        unsafe {
            let (mut least, mut most) = ([E::splat(f32::INFINITY); 2], [E::splat(f32::NEG_INFINITY); 2]);
            for vertex in 0..3 {
                let corner = block.corners.get_unchecked(vertex);
                let z = E::load(corner.get_unchecked(kz).as_ptr());
                let (first, last) =
                    (z.sub(E::splat(self.origin[kz][1])), z.sub(E::splat(self.origin[kz][0])));
                for component in 0..2 {
                    let axis = if component == 0 { kx } else { ky };
                    let [low, high] = self.shear[component];
                    let (low, high) = (E::splat(low), E::splat(high));
                    let (a, b, c, d) = (low.mul(first), low.mul(last), high.mul(first), high.mul(last));
                    let at = E::load(corner.get_unchecked(axis).as_ptr());
                    let from = at.sub(E::splat(self.origin[axis][1])).sub(a.max(b).max(c.max(d)));
                    let to = at.sub(E::splat(self.origin[axis][0])).sub(a.min(b).min(c.min(d)));
                    least[component] = least[component].min(from);
                    most[component] = most[component].max(to);
                }
            }
            let (delta, minus) = (E::splat(self.delta), E::splat(-self.delta));
            !(least[0].gt(delta) | least[1].gt(delta) | minus.gt(most[0]) | minus.gt(most[1]))
        }
    }

    /// The children of a node that some ray may enter, in the order that `order` names, and their number.
    ///
    /// # Safety
    /// The level's instructions are there; rows are below six.
    #[inline(always)]
    pub unsafe fn enters<E: Eight>(
        &self,
        node: &Node,
        rows: [[usize; 2]; 3],
        last: f32,
        order: u32,
        entered: &mut [u32; WIDTH],
        places: &mut usize,
    ) {
        static CHILDREN: [u32; WIDTH] = [0, 1, 2, 3, 4, 5, 6, 7];
        let mut t = [0.0; WIDTH];
        // SAFETY: a node's planes are aligned as it is; the rest is the caller's promise.
        unsafe {
            let (mut near, mut far) = (E::splat(self.t_min), E::splat(last));
            for axis in 0..3 {
                let [least, most] = self.inverse[axis];
                let ([low, high], forwards) = (self.origin[axis], rows[axis][0] == axis);
                // From the origin that comes first and from the one that comes last along the axis.
                let (late, early) = if forwards {
                    (high + self.pad, low - self.pad)
                } else {
                    (low - self.pad, high + self.pad)
                };
                let first = E::load(node.planes.get_unchecked(rows[axis][0]).as_ptr()).sub(E::splat(late));
                let second = E::load(node.planes.get_unchecked(rows[axis][1]).as_ptr()).sub(E::splat(early));
                let (least, most) = (E::splat(least), E::splat(most));
                near = first.mul(least).min(first.mul(most)).max(near);
                far = second.mul(least).max(second.mul(most)).min(far);
            }
            let packed = near.pack(far, order, CHILDREN.as_ptr(), entered.as_mut_ptr(), t.as_mut_ptr());
            *places = packed.count_ones() as usize;
        }
    }
}
