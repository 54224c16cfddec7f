//! The tree: nodes of eight children, leaves of up to eight primitives side by side.

use bytemuck::{Pod, Zeroable};

use crate::geometry::NONE;
use crate::memory::{Array, HugeArray};
use crate::scene::Surfaces;

/// Children of a node, and primitives of a block.
pub const WIDTH: usize = 8;
/// A child that is a block: its number times 8, plus the number of its primitives less 1.
pub const LEAF: u32 = 1 << 31;
/// With [`LEAF`]: the primitives are spheres.
pub const SPHERES: u32 = 1 << 30;
/// No child.
pub const EMPTY: u32 = u32::MAX;
/// Blocks that a child can name.
pub const MOST_BLOCKS: usize = 1 << 27;

/// The candidate of a walk: a block's number times 8 plus the primitive's lane, with this added if it is a sphere.
pub const SPHERE_CANDIDATE: u32 = 1 << 30;

/// The candidate that a primitive of a block is.
#[inline(always)]
pub fn candidate(block: u32, lane: u32, is_sphere: bool) -> u32 {
    block << 3 | lane | if is_sphere { SPHERE_CANDIDATE } else { 0 }
}

/// Puts a primitive into a lane, as [`Block::corners`] says.
pub fn put(corners: &mut [[[f32; WIDTH]; 3]; 3], lane: usize, surfaces: &Surfaces, id: u32) {
    let values = match surfaces.sphere_at(id) {
        None => surfaces.triangle(id),
        Some(sphere) => [sphere.center, [sphere.radius; 3], [0.0; 3]],
    };
    for vertex in 0..3 {
        for axis in 0..3 {
            corners[vertex][axis][lane] = values[vertex][axis];
        }
    }
}

/// The number of the block that a leaf child names.
#[inline(always)]
pub fn block_number(child: u32) -> u32 {
    child >> 3 & (MOST_BLOCKS as u32 - 1)
}

/// Eight boxes with what is in them.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Node {
    /// Least x, y, z, then largest; of a missing child inside out.
    pub planes: [[f32; WIDTH]; 6],
    pub children: [u32; WIDTH],
    /// For each octant of directions (bit k: component k is negative) the children from far to near, four bits each.
    pub order: [u32; 8],
}

/// Up to eight primitives: of triangles `corners[vertex][axis][lane]`, of spheres `corners[0]` the centre and `corners[1][0]` the radius.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Block {
    pub corners: [[[f32; WIDTH]; 3]; 3],
    pub ids: [u32; WIDTH],
}

/// The tree as flat arrays.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    /// Node 0 is the root. Empty where there is nothing to hit.
    pub nodes: HugeArray<Node>,
    pub blocks: HugeArray<Block>,
    /// Places on a stack that the deepest walk can take, with eight to spare for what is written ahead.
    pub stack_size: usize,
}

impl Node {
    /// No children yet.
    pub const NONE: Node = Node {
        planes: [
            [f32::INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
        ],
        children: [EMPTY; WIDTH],
        order: [0; 8],
    };

    /// Sorts the children by the middles of their boxes along each octant's diagonal.
    pub fn sort(&mut self) {
        let mut middles = [[0.0; WIDTH]; 3];
        for axis in 0..3 {
            for lane in 0..WIDTH {
                middles[axis][lane] = self.planes[axis][lane] + self.planes[axis + 3][lane];
            }
        }
        for octant in 0..8 {
            let mut along = [0.0; WIDTH];
            for axis in 0..3 {
                let sign = if octant >> axis & 1 == 1 { -1.0 } else { 1.0 };
                for lane in 0..WIDTH {
                    along[lane] += sign * middles[axis][lane];
                }
            }
            // Where a lane stands: behind all that are farther, and behind equals of lower number. Missing ones come first.
            for lane in 0..WIDTH {
                if self.children[lane] == EMPTY {
                    along[lane] = f32::INFINITY;
                }
            }
            let mut order = 0;
            for lane in 0..WIDTH {
                let mut place = 0;
                for other in 0..WIDTH {
                    let is_before =
                        along[other] > along[lane] || (along[other] == along[lane] && other < lane);
                    place += u32::from(is_before);
                }
                order |= (lane as u32) << (4 * place);
            }
            self.order[octant] = order;
        }
    }
}

/// A tree as its arrays' slices.
#[derive(Clone, Copy)]
pub struct TreeView<'a> {
    pub nodes: &'a [Node],
    pub blocks: &'a [Block],
    pub stack_size: usize,
}

impl TreeView<'_> {
    /// The block of a candidate, and the lane in it.
    #[inline(always)]
    pub fn candidate(&self, candidate: u32) -> (&Block, usize) {
        (&self.blocks[((candidate & !SPHERE_CANDIDATE) >> 3) as usize], candidate as usize & (WIDTH - 1))
    }

    /// Whether a candidate, which may be none, is this primitive: it may be in several blocks.
    #[inline(always)]
    pub fn is_candidate(&self, candidate: u32, primitive: u32) -> bool {
        candidate != NONE && {
            let (block, lane) = self.candidate(candidate);
            block.ids[lane] == primitive
        }
    }
}

impl Tree {
    pub fn view(&self) -> TreeView<'_> {
        TreeView { nodes: &self.nodes, blocks: &self.blocks, stack_size: self.stack_size }
    }

    /// Room for so many.
    ///
    /// # Panics
    /// Out of memory, or more blocks than can be named: 43 GB of them.
    pub fn zeroed(nodes: usize, blocks: usize) -> Tree {
        assert!(blocks <= MOST_BLOCKS, "{blocks} blocks of primitives are more than {MOST_BLOCKS}");
        let nodes = HugeArray::zeroed(nodes).expect("memory for the hierarchy's nodes");
        let blocks = HugeArray::zeroed(blocks).expect("memory for the hierarchy's blocks");
        Tree { nodes, blocks, stack_size: 0 }
    }

    /// Sets the size of the stack, when all nodes are there; children come after their parents.
    pub fn measure(&mut self) {
        let mut most = vec![0u32; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate().rev() {
            let filled = node.children.iter().filter(|&&child| child != EMPTY).count() as u32;
            let inner = node.children.iter().filter(|&&child| child & LEAF == 0);
            let below = inner.map(|&child| most[child as usize]).max().unwrap_or(0);
            most[index] = filled.max((filled + below).saturating_sub(1));
        }
        self.stack_size = most.first().map_or(0, |&most| most as usize) + WIDTH + 1;
    }
}
