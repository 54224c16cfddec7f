//! A binary tree from the top down: each node is divided where the surface area heuristic expects least work, between slabs that boxes are sorted into by their middles (Wald 2007,
//! "On fast Construction of SAH-based Bounding Volume Hierarchies"). Leaves hold what fits into a block: to divide it further gains rays nothing.
//!
//! Boxes move between two buffers, so that no branch depends on where one goes. What is done side by side depends on the numbers of boxes alone: any number of threads builds the
//! same tree.

use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

use crate::memory::{Array, HugeArray};

/// Most slabs along each axis; a power of two.
const BINS: usize = 32;
/// More boxes than this are worked on side by side.
const PARALLEL: usize = 4096;
/// More than this are sorted and moved side by side, too,
const LARGE: usize = 1 << 17;
/// so many at a time.
const CHUNK: usize = 1 << 14;
/// Below this depth nodes are halved, so that no tree is deeper than a stack.
const DEEPEST: u32 = 64;
/// Middles that lie no farther apart than this lie in one place.
const APART: f32 = 1e-30;

/// Boxes with their numbers, in their present order.
struct Pieces<'a> {
    boxes: &'a mut [Aabb],
    numbers: &'a mut [u32],
}

/// Where the pieces of a node are, and where those of its children go; after that the other way round.
struct Buffers<'a> {
    from: Pieces<'a>,
    to: Pieces<'a>,
    /// What comes before them in the order of all.
    first: usize,
    /// The final order of all numbers, where theirs belong.
    order: &'a mut [u32],
}

/// What is known of a node.
#[derive(Clone, Copy)]
struct Extent {
    bounds: Aabb,
    /// Around twice the middles of all boxes.
    middles: Aabb,
}

/// A node's subtree: with its nodes, root first, or in two halves that were built side by side.
enum Subtree {
    Nodes(Vec<Bvh2Node>),
    Halves(Aabb, Box<[Subtree; 2]>),
}

/// A subtree as one thread builds it.
struct Growth {
    nodes: Vec<Bvh2Node>,
    bins: Bins,
    most: usize,
}

/// Slabs of equal width along each axis.
struct Slabs {
    count: usize,
    low: Vec3A,
    scale: Vec3A,
}

/// What lies in each slab.
struct Bins {
    bounds: [[Aabb; BINS]; 3],
    counts: [[u32; BINS]; 3],
}

/// What lies in slabs before this one goes left.
#[derive(Clone, Copy)]
struct Division {
    axis: usize,
    slab: usize,
    /// Boxes that go left.
    left: usize,
}

/// The tree over boxes, of which there is one at least; no leaf has more than `most`. On the current rayon pool.
///
/// # Panics
/// Out of memory.
pub fn build(mut boxes: HugeArray<Aabb>, most: usize) -> Bvh2 {
    let count = boxes.len();
    let extent = Extent::of(&boxes);
    let mut numbers: Vec<u32> = (0..count as u32).collect();
    let mut other_boxes = HugeArray::zeroed(count).expect("memory to sort boxes in");
    let (mut other_numbers, mut order) = (vec![0; count], vec![0; count]);
    let buffers = Buffers {
        from: Pieces { boxes: &mut boxes, numbers: &mut numbers },
        to: Pieces { boxes: &mut other_boxes, numbers: &mut other_numbers },
        first: 0,
        order: &mut order,
    };
    let nodes = subtree(buffers, &extent, most, 0).flat();
    Bvh2 { nodes, primitive_indices: order, ..Bvh2::default() }
}

fn subtree(buffers: Buffers, extent: &Extent, most: usize, depth: u32) -> Subtree {
    let count = buffers.order.len();
    if count <= PARALLEL {
        // Twice as many nodes as leaves, which are half full at least on the mean.
        let mut nodes = Vec::with_capacity(1 + 4 * count / most);
        nodes.push(Bvh2Node::default());
        let mut growth = Growth { nodes, bins: Bins::EMPTY, most };
        growth.grow(buffers, extent, depth, 0);
        let nodes = growth.nodes;
        return Subtree::Nodes(nodes);
    }
    let mut bins = Bins::EMPTY;
    let ([left, right], [around_left, around_right]) = buffers.divide(extent, depth, &mut bins);
    let halves = rayon::join(
        || subtree(left, &around_left, most, depth + 1),
        || subtree(right, &around_right, most, depth + 1),
    );
    Subtree::Halves(extent.bounds, Box::new(halves.into()))
}

impl Growth {
    /// Adds all below a node, which itself has a place already.
    fn grow(&mut self, buffers: Buffers, extent: &Extent, depth: u32, at: usize) {
        let count = buffers.order.len();
        if count <= self.most {
            buffers.order.copy_from_slice(buffers.from.numbers);
            self.nodes[at] = Bvh2Node::new(extent.bounds, count as u32, buffers.first as u32);
            return;
        }
        let children = self.nodes.len();
        self.nodes[at] = Bvh2Node::new(extent.bounds, 0, children as u32);
        self.nodes.extend([Bvh2Node::default(); 2]);
        let (halves, extents) = buffers.divide(extent, depth, &mut self.bins);
        for (side, (half, extent)) in halves.into_iter().zip(&extents).enumerate() {
            self.grow(half, extent, depth + 1, children + side);
        }
    }
}

impl Subtree {
    /// All nodes, root first.
    fn flat(self) -> Vec<Bvh2Node> {
        // Above all subtrees that were built by one thread: the others' roots have places here, and the rest of them comes behind.
        let (mut nodes, mut parts) = (vec![Bvh2Node::default()], Vec::new());
        let mut waiting = vec![(self, 0)];
        while let Some((subtree, at)) = waiting.pop() {
            match subtree {
                Subtree::Nodes(part) => parts.push((part, at)),
                Subtree::Halves(bounds, halves) => {
                    let children = nodes.len();
                    nodes[at] = Bvh2Node::new(bounds, 0, children as u32);
                    nodes.extend([Bvh2Node::default(); 2]);
                    waiting.extend(halves.into_iter().zip(children..));
                }
            }
        }
        let above = nodes.len();
        nodes
            .resize(above + parts.iter().map(|(part, _)| part.len() - 1).sum::<usize>(), Bvh2Node::default());
        let (above, mut below) = nodes.split_at_mut(above);
        let (mut first, mut places) = (above.len() as u32, Vec::with_capacity(parts.len()));
        for (part, at) in parts {
            above[at] = part[0];
            if !part[0].is_leaf() {
                above[at].first_index += first - 1;
            }
            let rest = part.len() - 1;
            places.push((below.split_off_mut(..rest).expect("a place for each"), part, first - 1));
            first += rest as u32;
        }
        places.into_par_iter().for_each(|(slots, part, moved)| {
            for (slot, node) in slots.iter_mut().zip(&part[1..]) {
                *slot = *node;
                if !node.is_leaf() {
                    slot.first_index += moved;
                }
            }
        });
        nodes
    }
}

impl<'a> Buffers<'a> {
    /// Moves the pieces of two children to where those belong.
    fn divide(mut self, extent: &Extent, depth: u32, bins: &mut Bins) -> ([Buffers<'a>; 2], [Extent; 2]) {
        let slabs = Slabs::of(&extent.middles, self.order.len());
        bins.gather(self.from.boxes, &slabs);
        let best = if depth < DEEPEST { bins.best(slabs.count) } else { None };
        let left = match best {
            Some(best) => {
                self.part(&slabs, best);
                best.left
            }
            // Nothing tells the boxes apart.
            None => {
                self.to.boxes.copy_from_slice(self.from.boxes);
                self.to.numbers.copy_from_slice(self.from.numbers);
                self.order.len() / 2
            }
        };
        let halves = self.split(left);
        let extents = [Extent::of(halves[0].from.boxes), Extent::of(halves[1].from.boxes)];
        (halves, extents)
    }

    /// Sorts pieces to the front and to the back of where they go.
    fn part(&mut self, slabs: &Slabs, at: Division) {
        let is_left = |b: &Aabb| slab(slabs.along(b)[at.axis]) < at.slab;
        let (from, count) = (&self.from, self.order.len());
        if count > LARGE {
            return part_side_by_side(from, &mut self.to, at.left, is_left);
        }
        let (boxes, numbers) = (&mut self.to.boxes[..count], &mut self.to.numbers[..count]);
        let (mut left, mut right) = (0, count);
        for (piece, &number) in from.boxes.iter().zip(from.numbers.iter()) {
            let goes_left = is_left(piece);
            let to = if goes_left { left } else { right - 1 };
            (boxes[to], numbers[to]) = (*piece, number);
            left += usize::from(goes_left);
            right -= usize::from(!goes_left);
        }
    }

    /// The buffers of two children.
    fn split(self, left: usize) -> [Buffers<'a>; 2] {
        let ([a, b], [c, d]) = (self.to.split(left), self.from.split(left));
        let (left_order, right_order) = self.order.split_at_mut(left);
        [
            Buffers { from: a, to: c, first: self.first, order: left_order },
            Buffers { from: b, to: d, first: self.first + left, order: right_order },
        ]
    }
}

impl<'a> Pieces<'a> {
    fn split(self, at: usize) -> [Pieces<'a>; 2] {
        let (boxes, other_boxes) = self.boxes.split_at_mut(at);
        let (numbers, other_numbers) = self.numbers.split_at_mut(at);
        [Pieces { boxes, numbers }, Pieces { boxes: other_boxes, numbers: other_numbers }]
    }
}

/// As [`Buffers::part`], for many pieces: what goes left in each chunk is counted first.
fn part_side_by_side(from: &Pieces, to: &mut Pieces, left: usize, is_left: impl Fn(&Aabb) -> bool + Sync) {
    let counts: Vec<usize> =
        from.boxes.par_chunks(CHUNK).map(|chunk| chunk.iter().filter(|b| is_left(b)).count()).collect();
    let (mut left_boxes, mut right_boxes) = to.boxes.split_at_mut(left);
    let (mut left_numbers, mut right_numbers) = to.numbers.split_at_mut(left);
    let mut chunks = Vec::with_capacity(counts.len());
    for ((boxes, numbers), count) in from.boxes.chunks(CHUNK).zip(from.numbers.chunks(CHUNK)).zip(counts) {
        let others = boxes.len() - count;
        let slots =
            [(&mut left_boxes, &mut left_numbers, count), (&mut right_boxes, &mut right_numbers, others)]
                .map(|(boxes, numbers, count)| {
                    let boxes = boxes.split_off_mut(..count).expect("a place for each");
                    boxes.iter_mut().zip(numbers.split_off_mut(..count).expect("a place for each"))
                });
        chunks.push((boxes, numbers, slots));
    }
    chunks.into_par_iter().for_each(|(boxes, numbers, [mut left, mut right])| {
        for (piece, &number) in boxes.iter().zip(numbers) {
            let slot = if is_left(piece) { left.next() } else { right.next() };
            let (to, to_number) = slot.expect("as many as were counted");
            (*to, *to_number) = (*piece, number);
        }
    });
}

#[inline(always)]
fn twice_middle(b: &Aabb) -> Vec3A {
    b.min + b.max
}

impl Extent {
    const EMPTY: Extent = Extent { bounds: Aabb::INVALID, middles: Aabb::INVALID };

    fn of(boxes: &[Aabb]) -> Extent {
        if boxes.len() > LARGE {
            return boxes.par_chunks(CHUNK).map(Extent::of).reduce(
                || Extent::EMPTY,
                |a, b| Extent { bounds: a.bounds.union(&b.bounds), middles: a.middles.union(&b.middles) },
            );
        }
        let Extent { mut bounds, mut middles } = Extent::EMPTY;
        for b in boxes {
            let middle = twice_middle(b);
            bounds = bounds.union(b);
            middles = Aabb::new(middles.min.min(middle), middles.max.max(middle));
        }
        Extent { bounds, middles }
    }
}

/// The nearest whole number, of numbers from -0.5 to 31.5: read off where a large number has its units.
#[inline(always)]
fn slab(along: f32) -> usize {
    const UNITS: f32 = (3 << 22) as f32;
    ((along + UNITS).to_bits() & (BINS as u32 - 1)) as usize
}

impl Slabs {
    fn of(middles: &Aabb, boxes: usize) -> Slabs {
        // Few boxes aren't worth many slabs.
        let count = (4 + boxes / 16).min(BINS);
        let (mut low, mut scale) = (middles.min, Vec3A::ZERO);
        for axis in 0..3 {
            let extent = middles.max[axis] - middles.min[axis];
            if extent > APART {
                // Less than to the end of the last; half a slab is taken off, as what is rounded to the nearest is to be rounded down.
                scale[axis] = (count as f32 - 0.01) / extent;
                low[axis] += 0.495 / scale[axis];
            }
        }
        Slabs { count, low, scale }
    }

    /// Where a box lies along each axis, for [`slab`].
    #[inline(always)]
    fn along(&self, b: &Aabb) -> [f32; 3] {
        ((twice_middle(b) - self.low) * self.scale).to_array()
    }
}

impl Bins {
    const EMPTY: Bins = Bins { bounds: [[Aabb::INVALID; BINS]; 3], counts: [[0; BINS]; 3] };

    /// Sorts boxes into slabs; what was there is forgotten.
    fn gather(&mut self, boxes: &[Aabb], slabs: &Slabs) {
        if boxes.len() > LARGE {
            let of = |chunk: &[Aabb]| {
                let mut bins = Bins::EMPTY;
                bins.gather(chunk, slabs);
                bins
            };
            *self = boxes.par_chunks(CHUNK).map(of).reduce(|| Bins::EMPTY, Bins::merged);
            return;
        }
        for axis in 0..3 {
            self.bounds[axis][..slabs.count].fill(Aabb::INVALID);
            self.counts[axis][..slabs.count].fill(0);
        }
        for b in boxes {
            let along = slabs.along(b);
            for axis in 0..3 {
                let at = slab(along[axis]);
                self.bounds[axis][at] = self.bounds[axis][at].union(b);
                self.counts[axis][at] += 1;
            }
        }
    }

    fn merged(mut self, other: Bins) -> Bins {
        for axis in 0..3 {
            for k in 0..BINS {
                self.bounds[axis][k] = self.bounds[axis][k].union(&other.bounds[axis][k]);
                self.counts[axis][k] += other.counts[axis][k];
            }
        }
        self
    }

    /// The division that costs least; none if all boxes lie in one slab along each axis.
    fn best(&self, slabs: usize) -> Option<Division> {
        let (mut best, mut least) = (None, f32::INFINITY);
        for axis in 0..3 {
            let (bounds, counts) = (&self.bounds[axis], &self.counts[axis]);
            let mut behind = [(0.0f32, 0u32); BINS];
            let (mut around, mut count) = (Aabb::INVALID, 0);
            for k in (1..slabs.min(BINS)).rev() {
                around = around.union(&bounds[k]);
                count += counts[k];
                behind[k] = (around.half_area(), count);
            }
            (around, count) = (Aabb::INVALID, 0);
            for k in 1..slabs.min(BINS) {
                around = around.union(&bounds[k - 1]);
                count += counts[k - 1];
                let (area, others) = behind[k];
                let cost = around.half_area() * count as f32 + area * others as f32;
                if cost < least && count > 0 && others > 0 {
                    (best, least) = (Some(Division { axis, slab: k, left: count as usize }), cost);
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boxes of many sizes at places that fill a cube evenly; every third in one place.
    fn boxes(count: usize) -> HugeArray<Aabb> {
        let mut boxes = HugeArray::zeroed(count).unwrap();
        for (k, b) in boxes.iter_mut().enumerate() {
            let part = |factor: f64| if k % 3 == 0 { 0.5 } else { (k as f64 * factor).fract() as f32 };
            let low = Vec3A::new(part(0.819_172_513), part(0.671_043_607), part(0.549_700_478));
            *b = Aabb::new(low, low + Vec3A::splat(1.0 / (1 + k % 100) as f32));
        }
        boxes
    }

    #[test]
    fn every_box_is_in_one_leaf_and_in_all_nodes_above() {
        for (count, most) in [(1, 1), (2, 1), (9, 8), (1000, 1), (LARGE + 1000, 8)] {
            let boxes = boxes(count);
            let binary = build(boxes.clone(), most);
            let (mut seen, mut waiting) =
                (vec![false; count], vec![(0, binary.nodes[0].aabb().to_owned(), 0)]);
            while let Some((at, around, depth)) = waiting.pop() {
                let node = &binary.nodes[at];
                assert!(node.aabb().union(&around) == around && depth < DEEPEST + 20);
                let first = node.first_index as usize;
                if !node.is_leaf() {
                    waiting.extend([first, first + 1].map(|child| (child, *node.aabb(), depth + 1)));
                    continue;
                }
                assert!(node.prim_count as usize <= most);
                for &number in &binary.primitive_indices[first..first + node.prim_count as usize] {
                    assert!(!std::mem::replace(&mut seen[number as usize], true));
                    assert!(boxes[number as usize].union(node.aabb()) == *node.aabb());
                }
            }
            assert!(seen.iter().all(|&seen| seen));
        }
    }

    #[test]
    fn any_number_of_threads_builds_the_same() {
        let built = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| build(boxes(2 * LARGE), 8))
        };
        let (one, three) = (built(1), built(3));
        assert_eq!(one.primitive_indices, three.primitive_indices);
        assert_eq!(bytemuck::cast_slice::<_, u8>(&one.nodes), bytemuck::cast_slice::<_, u8>(&three.nodes));
    }
}
