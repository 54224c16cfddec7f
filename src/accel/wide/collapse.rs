//! The wide tree of a binary one, by dynamic programming: of all ways to cut it into nodes of eight children and blocks of eight primitives the one that
//! costs a ray least (Wald, Benthin and Boulos 2008, "Getting Rid of Packets"; Ylitie, Karras and Laine 2017, section 3.1).
//!
//! Subtrees are planned and made side by side, then put together in an order that depends on the binary tree alone.

use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

use super::tree::{Block, EMPTY, LEAF, Node, SPHERES, Tree, WIDTH, put};
use crate::scene::Surfaces;

/// Subtrees that are worked on side by side.
const PARTS: usize = 512;
/// In place of a right child: a whole subtree, whose number is in the other bits.
const SUBTREE: u32 = 1 << 31;

/// Of a left child, which isn't named by its parent.
const NO_PARENT: u32 = u32::MAX;

/// What a visit costs, in visits of a node.
const NODE: f32 = 1.0;
const BLOCK: f32 = 0.6;
const PRIMITIVE: f32 = 0.05;

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
    /// Primitives below it.
    count: u32,
}

/// What is collapsed.
#[derive(Clone, Copy)]
struct Source<'a> {
    binary: &'a Bvh2,
    /// Primitives that the binary tree's leaves stand for.
    ids: &'a [u32],
    surfaces: &'a Surfaces,
}

/// A part of the binary tree: its nodes with their plans, each before all that is below it, left before right.
#[derive(Default)]
struct Part {
    nodes: Vec<u32>,
    /// Where the right child is; the left one comes next. Of the top part's own leaves the subtree's number, with [`SUBTREE`].
    right: Vec<u32>,
    plans: Vec<Plan>,
}

/// A place in the top part (`None`) or in a subtree.
#[derive(Clone, Copy)]
struct Place {
    subtree: Option<u32>,
    at: u32,
}

/// Nodes and blocks made of one place and all below, numbered from 0.
struct Made {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
}

/// Makes the wide tree of a binary one whose leaves hold one primitive each, or a part of one; `ids` names those.
pub fn collapse(binary: &Bvh2, ids: &[u32], surfaces: &Surfaces) -> Tree {
    let source = Source { binary, ids, surfaces };
    let mut top = Part::default();
    let roots = top.list_top(source);
    let subtrees: Vec<Part> = roots
        .par_iter()
        .map(|&root| {
            let mut part = Part::default();
            part.list(source, root);
            part.plan(source, &[]);
            part
        })
        .collect();
    top.plan(source, &subtrees);
    Collapse { source, top, subtrees }.make()
}

impl Part {
    /// Lists the top of the tree down to a level of enough subtrees, whose roots are returned in the order of the list.
    fn list_top(&mut self, source: Source) -> Vec<u32> {
        let (mut depth, mut level) = (0, vec![0u32]);
        while level.len() < PARTS {
            let next: Vec<u32> = level
                .iter()
                .map(|&index| &source.binary.nodes[index as usize])
                .filter(|node| !node.is_leaf())
                .flat_map(|node| [node.first_index, node.first_index + 1])
                .collect();
            if next.is_empty() {
                break;
            }
            (depth, level) = (depth + 1, next);
        }
        let (mut roots, mut waiting) = (Vec::new(), vec![(0u32, NO_PARENT, 0)]);
        while let Some((index, parent, below)) = waiting.pop() {
            let at = self.list_one(index, parent);
            let node = &source.binary.nodes[index as usize];
            if below < depth && !node.is_leaf() {
                waiting.extend([
                    (node.first_index + 1, at, below + 1),
                    (node.first_index, NO_PARENT, below + 1),
                ]);
            } else {
                self.right[at as usize] = SUBTREE | roots.len() as u32;
                roots.push(index);
            }
        }
        roots
    }

    /// Lists all below a node.
    fn list(&mut self, source: Source, root: u32) {
        let mut waiting = vec![(root, NO_PARENT)];
        while let Some((index, parent)) = waiting.pop() {
            let at = self.list_one(index, parent);
            let node = &source.binary.nodes[index as usize];
            if !node.is_leaf() {
                waiting.extend([(node.first_index + 1, at), (node.first_index, NO_PARENT)]);
            }
        }
    }

    /// Lists a node, as the right child of `parent` unless that is none; where it is then.
    fn list_one(&mut self, index: u32, parent: u32) -> u32 {
        let at = self.nodes.len() as u32;
        if let Some(right) = self.right.get_mut(parent as usize) {
            *right = at;
        }
        self.nodes.push(index);
        self.right.push(0);
        at
    }

    /// Plans all nodes, from the last to the first. The top part's leaves are `subtrees`.
    fn plan(&mut self, source: Source, subtrees: &[Part]) {
        self.plans = vec![Plan::default(); self.nodes.len()];
        for at in (0..self.nodes.len()).rev() {
            let node = &source.binary.nodes[self.nodes[at] as usize];
            self.plans[at] = if self.right[at] & SUBTREE != 0 {
                subtrees[(self.right[at] & !SUBTREE) as usize].plans[0]
            } else if node.is_leaf() {
                let id = source.id(self.nodes[at]);
                let is_spheres = source.surfaces.sphere_at(id).is_some();
                let cost = [node.aabb().half_area() * leaf_cost(1); WIDTH];
                Plan { cost, is_leaf: true, is_spheres, count: 1, ..Plan::default() }
            } else {
                let (left, right) = (&self.plans[at + 1], &self.plans[self.right[at] as usize]);
                Plan::of_two(left, right, node.aabb().half_area())
            };
        }
    }
}

impl Plan {
    /// The plan of a node with two children.
    fn of_two(left: &Plan, right: &Plan, area: f32) -> Plan {
        let mut plan = Plan {
            count: left.count + right.count,
            is_spheres: left.is_spheres,
            is_mixed: left.is_mixed || right.is_mixed || left.is_spheres != right.is_spheres,
            ..Plan::default()
        };
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
            area * leaf_cost(plan.count)
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
        plan
    }
}

fn leaf_cost(count: u32) -> f32 {
    BLOCK + count as f32 * PRIMITIVE
}

impl Source<'_> {
    /// The primitive of a binary leaf.
    fn id(&self, index: u32) -> u32 {
        let node = &self.binary.nodes[index as usize];
        self.ids[self.binary.primitive_indices[node.first_index as usize] as usize]
    }
}

/// A planned tree.
struct Collapse<'a> {
    source: Source<'a>,
    top: Part,
    subtrees: Vec<Part>,
}

impl Collapse<'_> {
    /// A place as its subtree has it, if it is one.
    fn place(&self, place: Place) -> Place {
        let right = self.part(place).right[place.at as usize];
        if right & SUBTREE == 0 { place } else { Place { subtree: Some(right & !SUBTREE), at: 0 } }
    }

    fn part(&self, place: Place) -> &Part {
        place.subtree.map_or(&self.top, |number| &self.subtrees[number as usize])
    }

    fn plan(&self, place: Place) -> &Plan {
        &self.part(place).plans[place.at as usize]
    }

    /// Left and right child.
    fn children(&self, place: Place) -> [Place; 2] {
        let right = self.part(place).right[place.at as usize];
        [place.at + 1, right].map(|at| self.place(Place { at, ..place }))
    }

    /// The places that become the children of the wide node made of `of`.
    fn roots(&self, of: Place, roots: &mut Vec<Place>) {
        roots.clear();
        let plan = self.plan(of);
        // The whole tree may be a single block.
        if plan.is_leaf {
            roots.push(of);
            return;
        }
        let split = usize::from(plan.split);
        let [left, right] = self.children(of);
        let mut waiting = vec![(right, WIDTH - split), (left, split)];
        while let Some((place, mut count)) = waiting.pop() {
            let plan = self.plan(place);
            while count > 1 && plan.left[count - 1] == 0 {
                count -= 1;
            }
            if count == 1 {
                roots.push(place);
            } else {
                let share = usize::from(plan.left[count - 1]);
                let [left, right] = self.children(place);
                waiting.extend([(right, count - share), (left, share)]);
            }
        }
    }

    fn make(self) -> Tree {
        // The nodes above all subtrees, and what is to be made below them.
        let mut above = self.make_from(self.place(Place { subtree: None, at: 0 }), true);
        let wanted = std::mem::take(&mut above.1);
        let made: Vec<Made> = wanted.par_iter().map(|&place| self.make_from(place, false).0).collect();
        drop(self);
        let Made { nodes: mut first, blocks } = above.0;
        let (mut nodes_before, mut blocks_before) = (first.len(), blocks.len());
        let offsets: Vec<(u32, u32)> = made
            .iter()
            .map(|part| {
                let offsets = (nodes_before as u32, blocks_before as u32);
                nodes_before += part.nodes.len();
                blocks_before += part.blocks.len();
                offsets
            })
            .collect();
        // What has been wanted is named by its number for now.
        for child in first.iter_mut().flat_map(|node| &mut node.children) {
            if *child & (LEAF | SPHERES) == SPHERES {
                *child = offsets[(*child & !SPHERES) as usize].0;
            }
        }
        let mut tree = Tree::zeroed(nodes_before, blocks_before);
        let (mut node_slots, mut block_slots): (&mut [Node], &mut [Block]) =
            (&mut tree.nodes, &mut tree.blocks);
        node_slots.split_off_mut(..first.len()).into_iter().for_each(|slots| slots.copy_from_slice(&first));
        block_slots
            .split_off_mut(..blocks.len())
            .into_iter()
            .for_each(|slots| slots.copy_from_slice(&blocks));
        let mut places = Vec::with_capacity(made.len());
        for (part, &offsets) in made.into_iter().zip(&offsets) {
            let nodes = node_slots.split_off_mut(..part.nodes.len());
            let blocks = block_slots.split_off_mut(..part.blocks.len());
            places.extend(nodes.zip(blocks).map(|(nodes, blocks)| (part, offsets, nodes, blocks)));
        }
        places.into_par_iter().for_each(|(part, (first_node, first_block), nodes, blocks)| {
            for (node, made) in nodes.iter_mut().zip(&part.nodes) {
                let children = made.children.map(|child| match child {
                    EMPTY => EMPTY,
                    leaf if leaf & LEAF != 0 => leaf + (first_block << 3),
                    inner => inner + first_node,
                });
                *node = Node { children, ..*made };
            }
            blocks.copy_from_slice(&part.blocks);
        });
        tree.measure();
        tree
    }

    /// Makes nodes and blocks of a place and of all below; with `above` those in subtrees are only listed, and named by their number with the bit [`SPHERES`].
    fn make_from(&self, from: Place, above: bool) -> (Made, Vec<Place>) {
        let mut made = Made { nodes: vec![Node::NONE], blocks: Vec::new() };
        let mut wanted = Vec::new();
        let mut waiting = vec![(from, 0usize)];
        let mut roots = Vec::with_capacity(WIDTH);
        while let Some((place, to)) = waiting.pop() {
            self.roots(place, &mut roots);
            let mut node = Node::NONE;
            for (lane, &root) in roots.iter().enumerate() {
                let bounds = &self.source.binary.nodes[self.part(root).nodes[root.at as usize] as usize];
                for axis in 0..3 {
                    node.planes[axis][lane] = bounds.min[axis];
                    node.planes[axis + 3][lane] = bounds.max[axis];
                }
                let plan = self.plan(root);
                node.children[lane] = if plan.is_leaf {
                    let kind = if plan.is_spheres { SPHERES } else { 0 };
                    let (block, count) = self.block(root);
                    made.blocks.push(block);
                    LEAF | kind | (made.blocks.len() as u32 - 1) << 3 | (count - 1)
                } else if above && root.subtree.is_some() {
                    wanted.push(root);
                    SPHERES | (wanted.len() as u32 - 1)
                } else {
                    waiting.push((root, made.nodes.len()));
                    made.nodes.push(Node::NONE);
                    made.nodes.len() as u32 - 1
                };
            }
            node.sort();
            made.nodes[to] = node;
        }
        (made, wanted)
    }

    /// The primitives below a place, whose plan is to be a block, and their number. Of one in several leaves there once is enough.
    fn block(&self, root: Place) -> (Block, u32) {
        let mut block = Block { corners: [[[0.0; WIDTH]; 3]; 3], ids: [EMPTY; WIDTH] };
        let (mut waiting, mut lane) = (vec![root], 0);
        while let Some(place) = waiting.pop() {
            let index = self.part(place).nodes[place.at as usize];
            if !self.source.binary.nodes[index as usize].is_leaf() {
                let [left, right] = self.children(place);
                waiting.extend([right, left]);
                continue;
            }
            let id = self.source.id(index);
            if block.ids[..lane].contains(&id) {
                continue;
            }
            put(&mut block.corners, lane, self.source.surfaces, id);
            block.ids[lane] = id;
            lane += 1;
        }
        (block, lane as u32)
    }
}
