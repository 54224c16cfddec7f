//! The tree: nodes of eight children, leaves of up to eight primitives side by side, collapsed from obvhs's binary tree by dynamic programming
//! (Wald, Benthin and Boulos 2008, "Getting Rid of Packets"; Ylitie, Karras and Laine 2017, section 3.1).

use bytemuck::{Pod, Zeroable};
use obvhs::bvh2::Bvh2;

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
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
    /// Places on a stack that the deepest walk can take, with eight to spare for what is written ahead.
    pub stack_size: usize,
}

/// What a visit costs, in visits of a node.
const NODE: f32 = 1.0;
const BLOCK: f32 = 0.6;
const PRIMITIVE: f32 = 0.05;
const SPHERE: f32 = 0.05;

/// What dynamic programming knows of a binary node.
#[derive(Clone, Copy, Default)]
struct Plan {
    /// Least cost of it as at most k + 1 roots.
    cost: [f32; WIDTH],
    /// How many of k + 1 roots go to the left child; 0: one root fewer does as well.
    left: [u8; WIDTH],
    /// The same for its own eight children.
    split: u8,
    is_leaf: bool,
    /// Both kinds of primitives are below it.
    is_mixed: bool,
    is_spheres: bool,
    count: u32,
}

/// Makes the wide tree of a binary one whose leaves hold one primitive each; `ids` names those.
pub fn collapse(binary: &Bvh2, ids: &[u32], surfaces: &Surfaces) -> Tree {
    let plans = plan(binary, ids, surfaces);
    let mut tree = Tree { nodes: vec![Node::zeroed()], blocks: Vec::new(), stack_size: 0 };
    let mut waiting = vec![(0u32, 0usize)];
    let mut roots = Vec::with_capacity(WIDTH);
    while let Some((from, to)) = waiting.pop() {
        roots.clear();
        children_of(binary, &plans, from, &mut roots);
        let mut node = Node { planes: [[f32::INFINITY; WIDTH]; 6], children: [EMPTY; WIDTH], order: [0; 8] };
        node.planes[3..].fill([f32::NEG_INFINITY; WIDTH]);
        for (lane, &root) in roots.iter().enumerate() {
            let bounds = &binary.nodes[root as usize];
            for axis in 0..3 {
                node.planes[axis][lane] = bounds.min[axis];
                node.planes[axis + 3][lane] = bounds.max[axis];
            }
            let plan = &plans[root as usize];
            if plan.is_leaf {
                let kind = if plan.is_spheres { SPHERES } else { 0 };
                node.children[lane] = LEAF | kind | (tree.blocks.len() as u32) << 3 | (plan.count - 1);
                tree.blocks.push(block(binary, ids, surfaces, root));
            } else {
                node.children[lane] = tree.nodes.len() as u32;
                waiting.push((root, tree.nodes.len()));
                tree.nodes.push(Node::zeroed());
            }
        }
        node.order = orders(&node);
        tree.nodes[to] = node;
    }
    tree.stack_size = tree.stack_size();
    tree
}

fn plan(binary: &Bvh2, ids: &[u32], surfaces: &Surfaces) -> Vec<Plan> {
    let mut order = Vec::with_capacity(binary.nodes.len());
    let mut waiting = vec![0u32];
    while let Some(index) = waiting.pop() {
        order.push(index);
        let node = &binary.nodes[index as usize];
        if !node.is_leaf() {
            waiting.extend([node.first_index, node.first_index + 1]);
        }
    }
    let mut plans = vec![Plan::default(); binary.nodes.len()];
    for &index in order.iter().rev() {
        let node = &binary.nodes[index as usize];
        let area = node.aabb().half_area();
        let mut plan = Plan::default();
        if node.is_leaf() {
            let id = ids[binary.primitive_indices[node.first_index as usize] as usize];
            plan.is_spheres = surfaces.sphere_at(id).is_some();
            plan.count = 1;
            plan.cost = [area * leaf_cost(1, plan.is_spheres); WIDTH];
            plan.is_leaf = true;
        } else {
            let left = plans[node.first_index as usize];
            let right = plans[node.first_index as usize + 1];
            plan.count = left.count + right.count;
            plan.is_spheres = left.is_spheres;
            plan.is_mixed = left.is_mixed || right.is_mixed || left.is_spheres != right.is_spheres;
            let mut parted = [f32::INFINITY; WIDTH];
            let mut shares = [0u8; WIDTH];
            for roots in 2..=WIDTH {
                for share in 1..roots {
                    let cost = left.cost[share - 1] + right.cost[roots - share - 1];
                    if cost < parted[roots - 1] {
                        (parted[roots - 1], shares[roots - 1]) = (cost, share as u8);
                    }
                }
            }
            let as_node = parted[WIDTH - 1] + area * NODE;
            let as_leaf = if plan.count as usize <= WIDTH && !plan.is_mixed {
                area * leaf_cost(plan.count, plan.is_spheres)
            } else {
                f32::INFINITY
            };
            plan.split = shares[WIDTH - 1];
            plan.is_leaf = as_leaf <= as_node;
            plan.cost[0] = as_leaf.min(as_node);
            for roots in 2..=WIDTH {
                let fewer = plan.cost[roots - 2];
                if parted[roots - 1] < fewer {
                    (plan.cost[roots - 1], plan.left[roots - 1]) = (parted[roots - 1], shares[roots - 1]);
                } else {
                    plan.cost[roots - 1] = fewer;
                }
            }
        }
        plans[index as usize] = plan;
    }
    plans
}

fn leaf_cost(count: u32, spheres: bool) -> f32 {
    BLOCK + count as f32 * if spheres { SPHERE } else { PRIMITIVE }
}

/// The binary nodes that become the children of the wide node made of `of`.
fn children_of(binary: &Bvh2, plans: &[Plan], of: u32, roots: &mut Vec<u32>) {
    let node = &binary.nodes[of as usize];
    let plan = &plans[of as usize];
    // The whole tree may be a single block.
    if plan.is_leaf {
        roots.push(of);
        return;
    }
    let split = usize::from(plan.split);
    let mut waiting = vec![(node.first_index + 1, WIDTH - split), (node.first_index, split)];
    while let Some((index, mut count)) = waiting.pop() {
        let plan = &plans[index as usize];
        while count > 1 && plan.left[count - 1] == 0 {
            count -= 1;
        }
        if count == 1 {
            roots.push(index);
        } else {
            let left = usize::from(plan.left[count - 1]);
            let first = binary.nodes[index as usize].first_index;
            waiting.extend([(first + 1, count - left), (first, left)]);
        }
    }
}

fn block(binary: &Bvh2, ids: &[u32], surfaces: &Surfaces, root: u32) -> Block {
    let mut block = Block { corners: [[[0.0; WIDTH]; 3]; 3], ids: [EMPTY; WIDTH] };
    let (mut waiting, mut lane) = (vec![root], 0);
    while let Some(index) = waiting.pop() {
        let node = &binary.nodes[index as usize];
        if !node.is_leaf() {
            waiting.extend([node.first_index + 1, node.first_index]);
            continue;
        }
        let id = ids[binary.primitive_indices[node.first_index as usize] as usize];
        let corners = match surfaces.sphere_at(id) {
            None => surfaces.triangle(id),
            Some(sphere) => [sphere.center, [sphere.radius; 3], [0.0; 3]],
        };
        for vertex in 0..3 {
            for axis in 0..3 {
                block.corners[vertex][axis][lane] = corners[vertex][axis];
            }
        }
        block.ids[lane] = id;
        lane += 1;
    }
    block
}

/// Sorts by the middles of the boxes along the octant's diagonal.
fn orders(node: &Node) -> [u32; 8] {
    std::array::from_fn(|octant| {
        let along = |lane: usize| {
            if node.children[lane] == EMPTY {
                return f32::INFINITY;
            }
            let middle = |axis: usize| node.planes[axis][lane] + node.planes[axis + 3][lane];
            (0..3).map(|axis| if octant >> axis & 1 == 1 { -middle(axis) } else { middle(axis) }).sum()
        };
        let mut lanes: [usize; WIDTH] = std::array::from_fn(|lane| lane);
        lanes.sort_by(|&a, &b| along(b).total_cmp(&along(a)));
        lanes.iter().rev().fold(0, |order, &lane| order << 4 | lane as u32)
    })
}

impl Tree {
    /// The block of a candidate, and the lane in it.
    #[inline(always)]
    pub fn candidate(&self, candidate: u32) -> (&Block, usize) {
        (&self.blocks[((candidate & !SPHERE_CANDIDATE) >> 3) as usize], candidate as usize & (WIDTH - 1))
    }

    fn stack_size(&self) -> usize {
        let (mut most, mut waiting) = (0, vec![(0u32, 0usize)]);
        while let Some((index, below)) = waiting.pop() {
            let Some(node) = self.nodes.get(index as usize) else { break };
            let filled = node.children.iter().filter(|&&child| child != EMPTY).count();
            let height = below + filled;
            most = most.max(height);
            let inner = node.children.iter().filter(|&&child| child & LEAF == 0);
            waiting.extend(inner.map(|&child| (child, height.saturating_sub(1))));
        }
        most + WIDTH + 1
    }
}
