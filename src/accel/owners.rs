//! Blocks of voxels as a tree of boxes: whose block a ray comes to next, without a step for each that is empty or of a rank that it has asked.
//!
//! A box only says where a walk may find something; whether it does, the walk through that one block says. So boxes are tested in f32 and grown by more than all that is rounded.
//! In units of the lattice's extent E, from its lowest corner, with u = 2^-24 and Q = |origin|∞ + 3: rounding a plane takes 2u, the origin uQ, and a plane's distance
//! from it 3uQ of the product with the inverse and the difference, which is off by 2u of itself more: in all below 8uQ. A walk goes beyond a hit by 2^-22 = 4u of
//! |origin|∞ + E in units of a direction that may be twice as long (`lattice`): no more than 8uQ. Boxes are grown by 32uQ.

use super::lattice::{BLOCK, Lattice, Span};
use super::morton::morton;
use super::voxels::{NOBODY, Voxels};
use crate::geometry::{Prepared, Ray, round_down, round_up};

/// Children of a node.
const WIDTH: usize = 8;
/// Ranks that a set has a bit for.
pub const MOST_RANKS: usize = 64;
/// A child that is a leaf.
const LEAF: u32 = 1 << 31;
/// What boxes are grown by, in Q.
const PAD: f64 = 1.0 / (1u64 << 19) as f64;
/// Cut of 1 / direction: over all the way through the boxes a component this small comes nowhere near as far as they are grown.
const STEEPEST: f64 = 1e18;

/// The set of one rank.
pub fn set_of(rank: usize) -> u64 {
    1 << rank
}

/// Blocks that have an owner, in boxes within boxes.
#[derive(Clone, Debug, Default)]
pub struct OwnerTree {
    /// The root is the first; empty where there is no block.
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

/// Up to eight boxes.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Node {
    /// Least x, y, z, then largest; of a missing child inside out.
    planes: [[f32; WIDTH]; 6],
    /// The owners of all blocks in each.
    owners: [u64; WIDTH],
    /// Numbers of nodes, or of leaves with [`LEAF`].
    children: [u32; WIDTH],
}

/// A block.
#[derive(Clone, Debug)]
struct Leaf {
    block: u32,
    owner: u64,
    span: Span,
    /// Its place along a Morton curve.
    code: u64,
    /// The box of what is in it, as in [`Node`].
    bounds: [f32; 6],
}

/// A ray on its way through the tree.
struct Search<'s> {
    tree: &'s OwnerTree,
    voxels: &'s Voxels,
    ray: &'s Ray,
    wanted: u64,
    /// As `accel::wide` tests boxes: where a plane is crossed is (plane · inverse) − origin, `origin` being its product with `inverse`.
    inverse: [f32; 3],
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    /// Rows of `Node::planes` that are entered and left by.
    near: [usize; 3],
    far: [usize; 3],
    t_min: f32,
    t_max: f32,
    /// Where the box of the nearest block found is entered, and that block.
    found: Option<(f32, u32)>,
    /// The ray's end, in units of its direction.
    end: f64,
    /// The ray made ready to walk through voxels, once it has to.
    prepared: Option<Prepared>,
}

impl OwnerTree {
    /// Over all blocks of such owners, which must be below [`MOST_RANKS`].
    pub fn new(voxels: &Voxels, is_meant: impl Fn(u32) -> bool) -> OwnerTree {
        let meant = (0..voxels.owners.len()).filter(|&block| {
            let owner = voxels.owners[block];
            owner != NOBODY && is_meant(owner)
        });
        let mut leaves: Vec<Leaf> = meant.map(|block| Leaf::new(voxels, block)).collect();
        leaves.sort_unstable_by_key(|leaf| leaf.code);
        let mut tree = OwnerTree { nodes: Vec::new(), leaves };
        if !tree.leaves.is_empty() {
            tree.add(0, tree.leaves.len());
        }
        tree
    }

    /// Adds a node over a run of leaves, and what is below it: octants, but where one of them has all. Its number, owners and box.
    fn add(&mut self, from: usize, to: usize) -> (u32, u64, [f32; 6]) {
        let number = self.nodes.len();
        self.nodes.push(Node::NONE);
        // The highest digit of three bits in which they differ; a few are not worth a tree.
        let apart = self.leaves[from].code ^ self.leaves[to - 1].code;
        let shift = if to - from <= WIDTH { 0 } else { (63 - apart.leading_zeros()) / 3 * 3 };
        let (mut owners, mut bounds) = (0, NOWHERE);
        let (mut first, mut lane) = (from, 0);
        while first < to {
            let octant = self.leaves[first].code >> shift;
            let after = first + self.leaves[first..to].partition_point(|leaf| leaf.code >> shift == octant);
            let (child, theirs, around) = if after - first == 1 {
                let leaf = &self.leaves[first];
                (LEAF | first as u32, leaf.owner, leaf.bounds)
            } else {
                self.add(first, after)
            };
            let node = &mut self.nodes[number];
            (node.children[lane], node.owners[lane]) = (child, theirs);
            for axis in 0..3 {
                node.planes[axis][lane] = around[axis];
                node.planes[axis + 3][lane] = around[axis + 3];
                bounds[axis] = bounds[axis].min(around[axis]);
                bounds[axis + 3] = bounds[axis + 3].max(around[axis + 3]);
            }
            owners |= theirs;
            (first, lane) = (after, lane + 1);
        }
        (number as u32, owners, bounds)
    }

    /// The nearest block of one of the owners `wanted` whose occupied voxels a ray comes through before `t_best`, in units of its direction. The ray's origin must be served by the
    /// lattice.
    pub fn nearest(&self, voxels: &Voxels, ray: &Ray, t_best: f64, wanted: u64) -> Option<usize> {
        let root = self.nodes.first()?;
        let mut search = Search::new(self, voxels, ray, t_best, wanted);
        search.visit(root);
        search.found.map(|(_, block)| block as usize)
    }
}

/// The box of nothing.
const NOWHERE: [f32; 6] = {
    let (low, high) = (f32::INFINITY, f32::NEG_INFINITY);
    [low, low, low, high, high, high]
};

impl Leaf {
    fn new(voxels: &Voxels, block: usize) -> Leaf {
        let Lattice { size, extent, .. } = voxels.lattice;
        let place = voxels.lattice.block_place(block);
        let bits = voxels.occupied[block];
        let mut bounds = NOWHERE;
        for bit in (0..u64::BITS).filter(|bit| bits >> bit & 1 == 1) {
            let inside = [bit % BLOCK, bit / BLOCK % BLOCK, bit / BLOCK / BLOCK];
            for axis in 0..3 {
                let (cell, width) = (f64::from(BLOCK * place[axis] + inside[axis]), size[axis] / extent);
                bounds[axis] = bounds[axis].min(round_down(cell * width));
                bounds[axis + 3] = bounds[axis + 3].max(round_up((cell + 1.0) * width));
            }
        }
        Leaf {
            block: block as u32,
            owner: set_of(voxels.owners[block] as usize),
            span: voxels.lattice.block_span(block),
            code: morton(place),
            bounds,
        }
    }
}

impl Node {
    const NONE: Node = {
        let [low, high] = [[NOWHERE[0]; WIDTH], [NOWHERE[3]; WIDTH]];
        Node { planes: [low, low, low, high, high, high], owners: [0; WIDTH], children: [0; WIDTH] }
    };
}

impl<'s> Search<'s> {
    fn new(tree: &'s OwnerTree, voxels: &'s Voxels, ray: &'s Ray, t_best: f64, wanted: u64) -> Self {
        let Lattice { low, extent, .. } = voxels.lattice;
        let (direction, per_extent) = (ray.direction.to_array(), 1.0 / extent);
        let longest = ray.direction.abs().max_element();
        // t of the search is that of the ray times this.
        let scale = longest * per_extent;
        let end = ray.t_max.min(t_best);
        // Of lengths that no product can hold nothing is left out.
        let (t_min, t_max) =
            if scale.is_normal() { (ray.t_min * scale, end * scale) } else { (0.0, f64::INFINITY) };
        let pad = (ray.origin.abs().max_element() * per_extent + 3.0) * PAD;
        let mut search = Search {
            tree,
            voxels,
            ray,
            wanted,
            inverse: [0.0; 3],
            near_origin: [0.0; 3],
            far_origin: [0.0; 3],
            near: [0, 1, 2],
            far: [3, 4, 5],
            t_min: round_down(t_min),
            t_max: round_up(t_max),
            found: None,
            end,
            prepared: None,
        };
        for axis in 0..3 {
            let inverse = longest / direction[axis];
            let inverse = if inverse.abs() < STEEPEST { inverse } else { STEEPEST.copysign(inverse) };
            let mut pad = pad;
            if inverse < 0.0 {
                (search.near[axis], search.far[axis]) = (axis + 3, axis);
                pad = -pad;
            }
            let origin = (ray.origin[axis] - low[axis]) * per_extent;
            search.inverse[axis] = inverse as f32;
            search.near_origin[axis] = ((origin + pad) * inverse) as f32;
            search.far_origin[axis] = ((origin - pad) * inverse) as f32;
        }
        search
    }

    /// Looks into the boxes of a node that the ray enters, the nearest first.
    fn visit(&mut self, node: &Node) {
        // Loops over lanes, of which the compiler makes vectors.
        let (mut enter, mut leave) = ([self.t_min; WIDTH], [self.t_max; WIDTH]);
        for axis in 0..3 {
            let (first, last) = (&node.planes[self.near[axis]], &node.planes[self.far[axis]]);
            let (near, far, inverse) = (self.near_origin[axis], self.far_origin[axis], self.inverse[axis]);
            for lane in 0..WIDTH {
                let (a, b) = (first[lane] * inverse - near, last[lane] * inverse - far);
                enter[lane] = if a > enter[lane] { a } else { enter[lane] };
                leave[lane] = if b < leave[lane] { b } else { leave[lane] };
            }
        }
        let mut open = 0u32;
        for lane in 0..WIDTH {
            open |= u32::from(enter[lane] <= leave[lane]) << lane;
        }
        let (mut order, mut count) = ([0u8; WIDTH], 0);
        while open != 0 {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            if node.owners[lane] & self.wanted == 0 {
                continue;
            }
            let mut place = count;
            while place > 0 && enter[usize::from(order[place - 1])] > enter[lane] {
                order[place] = order[place - 1];
                place -= 1;
            }
            order[place] = lane as u8;
            count += 1;
        }
        for lane in order[..count].iter().map(|&lane| usize::from(lane)) {
            if self.found.is_some_and(|(nearest, _)| enter[lane] >= nearest) {
                return;
            }
            let (tree, child) = (self.tree, node.children[lane]);
            if child & LEAF == 0 {
                self.visit(&tree.nodes[child as usize]);
                continue;
            }
            let leaf = &tree.leaves[(child & !LEAF) as usize];
            if self.comes_through(leaf) {
                self.found = Some((enter[lane], leaf.block));
                return;
            }
        }
    }

    /// Whether the ray comes through an occupied voxel of a block.
    fn comes_through(&mut self, leaf: &Leaf) -> bool {
        let (ray, t_max) = (self.ray, self.end);
        let ray = self.prepared.get_or_insert_with(|| Prepared::new(&Ray { t_max, ..*ray }));
        let mut found = false;
        let bits = self.voxels.occupied[leaf.block as usize];
        self.voxels.lattice.walk_within(
            leaf.span,
            ray,
            |_| bits,
            |_, _| {
                found = true;
                None
            },
        );
        found
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::NONE;
    use crate::geometry::bounds::Slabs;

    fn voxels(counts: [u32; 3], occupied: &[u64], ranks: u32) -> Voxels {
        let lattice =
            Lattice { low: [-1.0; 3], size: counts.map(|c| 2.0 / f64::from(c)), counts, extent: 1.0 };
        let occupied: Vec<u64> = occupied.iter().copied().cycle().take(lattice.blocks()).collect();
        // Bits of cells outside the lattice mean nothing; there are none, as counts are multiples of a block's.
        let owner = |(block, bits): (usize, &u64)| if *bits == 0 { NOBODY } else { block as u32 % ranks };
        let owners = occupied.iter().enumerate().map(owner).collect();
        Voxels { lattice, occupied, owners }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn the_nearest_is_what_a_walk_comes_to_first(
            blocks in prop::array::uniform3(1u32..7),
            occupied in prop::collection::vec(prop_oneof![Just(0u64), any::<u64>(), (0u32..64).prop_map(|bit| 1 << bit)], 1..40),
            ranks in 1u32..5,
            asked in any::<u64>(),
            rays in prop::collection::vec((
                prop::array::uniform3(-1.5f64..1.5),
                prop::array::uniform3(prop_oneof![Just(0.0), Just(6e-17), Just(-2e-17), Just(1e-12), -1.0f64..1.0]),
                prop::option::of((0usize..3, 0u32..7, -3i64..4)),
            ), 20),
            t_best in prop_oneof![Just(f64::INFINITY), 0.0f64..3.0],
        ) {
            let voxels = voxels(blocks.map(|count| BLOCK * count), &occupied, ranks);
            let tree = OwnerTree::new(&voxels, |_| true);
            for (mut origin, direction, on_face) in rays {
                // Some begin within rounding of a face between blocks, and may hardly move away from it.
                if let Some((axis, block, ulps)) = on_face {
                    let plane = voxels.lattice.plane(axis, (block % (blocks[axis] + 1) * BLOCK) as i32);
                    origin[axis] = plane + ulps as f64 * (0.5 * f64::EPSILON);
                }
                let (origin, direction) = (DVec3::from(origin), DVec3::from(direction));
                if direction == DVec3::ZERO {
                    continue;
                }
                let ray = Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE };
                let is_wanted = |block: usize| voxels.owners[block] != NOBODY && set_of(voxels.owners[block] as usize) & !asked != 0;
                let mut walked = None;
                let prepared = Prepared::new(&Ray { t_max: t_best, ..ray });
                let wanted = |block: usize| if is_wanted(block) { voxels.occupied[block] } else { 0 };
                voxels.lattice.walk(&prepared, wanted, |_, block| {
                    walked = Some(block);
                    None
                });
                let found = tree.nearest(&voxels, &ray, t_best, !asked);
                // What padding lets in beside that is close by.
                prop_assert!(found.is_some() || walked.is_none(), "{ray:?}: {walked:?}");
                if let Some(found) = found {
                    prop_assert!(is_wanted(found));
                    let span = voxels.lattice.block_span(found);
                    let corner = |k: usize| -> [f32; 3] {
                        let side = if k == 0 { -1e-5 } else { 1e-5 };
                        std::array::from_fn(|axis| {
                            (-1.0 + f64::from(span[axis][k]) * voxels.lattice.size[axis] + side) as f32
                        })
                    };
                    let entered = Slabs::new(&prepared, 1.0).enter(corner(0), corner(1), prepared.t_max + 1e-5);
                    prop_assert!(entered.is_some(), "{found} is not on the way of {ray:?}");
                }
            }
        }
    }

    #[test]
    fn the_nearest_of_a_row_is_found_whoever_is_left() {
        // Eight blocks along x, each its own rank's.
        let mut row = voxels([4 * 8, 4, 4], &[u64::MAX], 63);
        row.owners = (0..8).collect();
        let tree = OwnerTree::new(&row, |_| true);
        let ray = |x: f64, direction: f64| Ray {
            origin: DVec3::new(x, 0.1, 0.1),
            direction: DVec3::X * direction,
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        let mut asked = 0;
        for expected in 0..8 {
            let found = tree.nearest(&row, &ray(-2.0, 1.0), f64::INFINITY, !asked);
            assert_eq!(found, Some(expected));
            asked |= set_of(expected);
        }
        assert_eq!(tree.nearest(&row, &ray(-2.0, 1.0), f64::INFINITY, !asked), None);
        // Backwards, not beyond a hit, and past all of them.
        assert_eq!(tree.nearest(&row, &ray(2.0, -3.0), f64::INFINITY, !0), Some(7));
        assert_eq!(tree.nearest(&row, &ray(-2.0, 0.5), 1.9, !0), None);
        assert_eq!(tree.nearest(&row, &ray(-2.0, 0.5), 2.1, !0), Some(0));
        assert_eq!(tree.nearest(&row, &ray(-2.0, 0.5), 2.1, !1), None);
        assert_eq!(tree.nearest(&row, &ray(2.0, 1.0), f64::INFINITY, !0), None);
        let few = OwnerTree::new(&row, |owner| owner % 3 == 2);
        assert_eq!(few.nearest(&row, &ray(-2.0, 1.0), f64::INFINITY, !0), Some(2));
        assert_eq!(few.nearest(&row, &ray(2.0, -1.0), f64::INFINITY, !0), Some(5));
        assert_eq!(OwnerTree::new(&row, |owner| owner == 8).nearest(&row, &ray(-2.0, 1.0), 9.0, !0), None);
    }
}
