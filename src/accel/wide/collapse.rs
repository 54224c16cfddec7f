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

/// How much is made of one place and all below, and which places there in subtrees are left to others.
struct Size {
    nodes: usize,
    blocks: usize,
    wanted: Vec<Place>,
}

/// Where it goes: the root first.
struct Room<'t> {
    nodes: &'t mut [Node],
    blocks: &'t mut [Block],
    first_node: u32,
    first_block: u32,
}

/// Makes the wide tree of a binary one, or a part of one. Its leaves hold primitives of one kind, no more than a block; `ids` names those.
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
                let count = node.prim_count;
                let cost = [node.aabb().half_area() * leaf_cost(count); WIDTH];
                Plan { cost, is_leaf: true, is_spheres, count, ..Plan::default() }
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
    /// The first primitive of a binary leaf.
    fn id(&self, index: u32) -> u32 {
        self.leaf(index).next().expect("a leaf has a primitive")
    }

    /// The primitives of a binary leaf.
    fn leaf(&self, index: u32) -> impl Iterator<Item = u32> {
        let node = &self.binary.nodes[index as usize];
        let (first, count) = (node.first_index as usize, node.prim_count as usize);
        self.binary.primitive_indices[first..first + count].iter().map(|&k| self.ids[k as usize])
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
        let root = self.place(Place { subtree: None, at: 0 });
        // Nodes above all subtrees, and what is to be made below them; each finds its room laid out.
        let above = self.size(root, true);
        let below: Vec<Size> = above.wanted.par_iter().map(|&place| self.size(place, false)).collect();
        let sum = |of: fn(&Size) -> usize| of(&above) + below.iter().map(of).sum::<usize>();
        let mut tree = Tree::zeroed(sum(|size| size.nodes), sum(|size| size.blocks));
        let (mut nodes, mut blocks): (&mut [Node], &mut [Block]) = (&mut tree.nodes, &mut tree.blocks);
        let (mut first_node, mut first_block) = (0, 0);
        let mut room = |size: &Size| {
            let room = Room {
                nodes: nodes.split_off_mut(..size.nodes).expect("room was counted"),
                blocks: blocks.split_off_mut(..size.blocks).expect("room was counted"),
                first_node,
                first_block,
            };
            first_node += size.nodes as u32;
            first_block += size.blocks as u32;
            room
        };
        let room_above = room(&above);
        let rooms: Vec<(Place, Room)> =
            above.wanted.iter().copied().zip(below.iter().map(&mut room)).collect();
        self.make_from(root, room_above, Some(&mut rooms.iter().map(|(_, room)| room.first_node)));
        rooms.into_par_iter().for_each(|(place, room)| self.make_from(place, room, None));
        drop(self);
        tree.measure();
        tree
    }

    /// What is made of a place and of all below. With `above` what lies in subtrees is only listed.
    fn size(&self, from: Place, above: bool) -> Size {
        let mut size = Size { nodes: 1, blocks: 0, wanted: Vec::new() };
        let (mut waiting, mut roots) = (vec![from], Vec::with_capacity(WIDTH));
        while let Some(place) = waiting.pop() {
            self.roots(place, &mut roots);
            for &root in &roots {
                if self.plan(root).is_leaf {
                    size.blocks += 1;
                } else if above && root.subtree.is_some() {
                    size.wanted.push(root);
                } else {
                    size.nodes += 1;
                    waiting.push(root);
                }
            }
        }
        size
    }

    /// Makes nodes and blocks of a place and of all below, as many as were counted. What was only listed is already numbered `below`.
    fn make_from(&self, from: Place, room: Room, mut below: Option<&mut dyn Iterator<Item = u32>>) {
        let (mut nodes, mut blocks) = (1, 0);
        let (mut waiting, mut roots) = (vec![(from, 0)], Vec::with_capacity(WIDTH));
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
                    let (block, mut count) = (&mut room.blocks[blocks], 0);
                    block.ids = [EMPTY; WIDTH];
                    self.fill(block, &mut count, root);
                    blocks += 1;
                    LEAF | kind | (room.first_block + blocks as u32 - 1) << 3 | (count as u32 - 1)
                } else if let Some(below) = &mut below
                    && root.subtree.is_some()
                {
                    below.next().expect("all were listed")
                } else {
                    waiting.push((root, nodes));
                    nodes += 1;
                    room.first_node + nodes as u32 - 1
                };
            }
            node.sort();
            room.nodes[to] = node;
        }
    }

    /// Adds the primitives below a place to the `count` that a block has; of one in several leaves there once is enough.
    fn fill(&self, block: &mut Block, count: &mut usize, place: Place) {
        let index = self.part(place).nodes[place.at as usize];
        if !self.source.binary.nodes[index as usize].is_leaf() {
            return self.children(place).into_iter().for_each(|child| self.fill(block, count, child));
        }
        for id in self.source.leaf(index) {
            if !block.ids[..*count].contains(&id) {
                put(&mut block.corners, *count, self.source.surfaces, id);
                block.ids[*count] = id;
                *count += 1;
            }
        }
    }
}
