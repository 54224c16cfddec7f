//! A binary tree with spatial splits (Stich, Friedrich and Dietrich 2009, "Spatial Splits in Bounding Volume Hierarchies"): where the boxes of two halves would overlap, triangles may be cut
//! at a plane, and each half holds its part. A primitive may so be in several leaves.
//!
//! How many more leaves there may be than primitives is told beforehand, and shared out from the root down, so that any number of threads builds the same tree.

use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

use super::piece::{Corners, Piece, cut, cut_about};
use super::tree::MOST_BLOCKS;
use crate::scene::Surfaces;

/// Slabs along each axis that pieces are sorted into by their middles.
const BINS: usize = 32;
/// The same where they are cut.
const SLABS: usize = 16;
/// Up to this many pieces all places between them are tried.
const SWEPT: usize = 16;
/// More pieces than this are worked on side by side.
const PARALLEL: usize = 4096;
/// Pieces that one thread looks at together.
const CHUNK: usize = 8192;
/// Below this depth nodes are halved, so that no tree is deeper than a stack.
const DEEPEST: u32 = 64;

/// How readily primitives are cut.
#[derive(Clone, Copy, Debug)]
pub struct Cuts {
    /// How many more leaves than primitives there may be.
    pub more: usize,
    /// Fewer pieces than this aren't cut: they come to lie in few blocks anyway.
    pub fewest: usize,
    /// Halves whose boxes share less than these parts of the root's area and of the node's aren't cut.
    pub of_root: f32,
    pub of_node: f32,
}

impl Cuts {
    /// Measured on interiors and scanned models: three in ten more leaves give nearly all that there is to gain.
    pub fn usual(primitives: usize) -> Cuts {
        // Even with a block for each leaf all of them can be named.
        let more = (primitives / 10 * 3).min(MOST_BLOCKS.saturating_sub(primitives));
        Cuts { more, fewest: 9, of_root: 1e-4, of_node: 0.1 }
    }
}

/// What is built over.
struct Spatial<'a> {
    surfaces: &'a Surfaces,
    /// The primitives.
    ids: &'a [u32],
    cuts: Cuts,
    /// Pieces of a leaf.
    most: usize,
    /// Area of the box around everything.
    root_area: f32,
}

/// A way to divide a node.
#[derive(Clone, Copy)]
struct Division {
    /// Areas times numbers of pieces.
    cost: f32,
    axis: usize,
    plane: f32,
    bounds: [Aabb; 2],
    counts: [usize; 2],
}

/// Pieces sorted into slabs along the axes.
#[derive(Clone)]
struct Bins {
    bounds: [[Aabb; BINS]; 3],
    /// Pieces that begin and that end in each slab.
    begin: [[u32; BINS]; 3],
    end: [[u32; BINS]; 3],
}

/// A tree over pieces.
struct Subtree {
    /// Its root first.
    nodes: Vec<Bvh2Node>,
    /// The primitives of its leaves, one leaf's after the other's.
    order: Vec<u32>,
}

/// The tree over the boxes of the primitives `ids`, of which there is one at least; no leaf has more than `most` pieces. On the current rayon pool.
pub fn build(surfaces: &Surfaces, ids: &[u32], boxes: &[Aabb], cuts: Cuts, most: usize) -> Bvh2 {
    let whole = boxes.par_iter().copied().reduce(Aabb::empty, |a, b| a.union(&b));
    let pieces: Vec<Piece> = (0u32..)
        .zip(boxes)
        .map(|(primitive, b)| Piece { low: b.min.to_array(), primitive, high: b.max.to_array() })
        .collect();
    let spatial = Spatial { surfaces, ids, cuts, most, root_area: whole.half_area() };
    let Subtree { nodes, order } = spatial.subtree(pieces, whole, cuts.more, 0);
    Bvh2 { nodes, primitive_indices: order, uses_spatial_splits: true, ..Bvh2::default() }
}

impl Spatial<'_> {
    fn subtree(&self, pieces: Vec<Piece>, bounds: Aabb, more: usize, depth: u32) -> Subtree {
        let count = pieces.len();
        if count <= self.most {
            let nodes = vec![Bvh2Node::new(bounds, count as u32, 0)];
            return Subtree { nodes, order: pieces.iter().map(|piece| piece.primitive).collect() };
        }
        let [left, right] = self.divide(pieces, &bounds, more, depth);
        let left_over = more - (left.len() + right.len() - count);
        let left_share =
            (left_over as u128 * left.len() as u128 / (left.len() + right.len()) as u128) as usize;
        let right_share = left_over - left_share;
        let (around_left, around_right) = (around(&left), around(&right));
        let build_left = || self.subtree(left, around_left, left_share, depth + 1);
        let build_right = || self.subtree(right, around_right, right_share, depth + 1);
        let (left, right) = if count > PARALLEL {
            rayon::join(build_left, build_right)
        } else {
            (build_left(), build_right())
        };
        Subtree::over(bounds, left, right)
    }

    /// The pieces of two children. Not inlined: what it needs shall not lie on the stack of all levels.
    #[inline(never)]
    fn divide(&self, pieces: Vec<Piece>, bounds: &Aabb, more: usize, depth: u32) -> [Vec<Piece>; 2] {
        if depth >= DEEPEST {
            return halve(pieces);
        }
        let (order, best) = if pieces.len() <= SWEPT {
            let (order, best) = sweep(&pieces);
            (Some(order), best)
        } else {
            let Some(best) = by_middles(&pieces) else { return halve(pieces) };
            (None, best)
        };
        let Cuts { fewest, of_root, of_node, .. } = self.cuts;
        let shared = best.bounds[0].intersection(&best.bounds[1]);
        let overlaps = shared.valid()
            && shared.half_area() > (of_root * self.root_area).max(of_node * bounds.half_area());
        if more > 0
            && pieces.len() >= fewest
            && overlaps
            && let Some(cut) = self.by_planes(&pieces, bounds)
            && cut.cost < best.cost
            && let Some(children) = self.cut_all(&pieces, &cut, more)
        {
            return children;
        }
        if let Some(mut order) = order {
            let right = order.split_off(best.counts[0]);
            return [order, right].map(|side| side.iter().map(|&k| pieces[k as usize]).collect());
        }
        let (left, right) =
            pieces.iter().partition::<Vec<_>, _>(|piece| middle(piece, best.axis) < best.plane);
        if left.is_empty() || right.is_empty() { halve(pieces) } else { [left, right] }
    }

    /// The best plane to cut at.
    fn by_planes(&self, pieces: &[Piece], bounds: &Aabb) -> Option<Division> {
        let planes = planes(bounds, SLABS);
        gathered(pieces, |bins, piece| self.enter(bins, piece, &planes)).best(&planes)
    }

    /// Enters the parts of a piece into the slabs that it reaches.
    fn enter(&self, bins: &mut Bins, piece: &Piece, planes: &[[f32; BINS + 1]; 3]) {
        let id = self.ids[piece.primitive as usize];
        let triangle = if self.surfaces.sphere_at(id).is_some() {
            None
        } else {
            let [a, b, c] = self.surfaces.triangle(id);
            Some([Vec3A::from_array(a), Vec3A::from_array(b), Vec3A::from_array(c)])
        };
        let bounds = piece.bounds();
        for axis in 0..3 {
            let planes = &planes[axis];
            let slab = |coordinate| slab(planes, coordinate);
            let Some(triangle) = &triangle else {
                let k = slab(middle(piece, axis));
                bins.bounds[axis][k] = bins.bounds[axis][k].union(&bounds);
                bins.begin[axis][k] += 1;
                bins.end[axis][k] += 1;
                continue;
            };
            let (mut rest, mut begin, mut end) = (bounds, None, 0);
            let mut k = slab(piece.low[axis]);
            loop {
                // What only touches the next slab needn't be there.
                let (part, next) = if k + 1 < BINS && rest.max[axis] > planes[k + 1] {
                    let [part, next] = cut_about(&rest, triangle, axis, planes[k + 1]);
                    (part, Some(next))
                } else {
                    (rest, None)
                };
                if part.valid() {
                    bins.bounds[axis][k] = bins.bounds[axis][k].union(&part);
                    begin = begin.or(Some(k));
                    end = k;
                }
                match next {
                    Some(next) if next.valid() => (rest, k) = (next, k + 1),
                    _ => break,
                }
            }
            if let Some(begin) = begin {
                bins.begin[axis][begin] += 1;
                bins.end[axis][end] += 1;
            }
        }
    }

    /// Cuts at a plane what lies on both sides, unless it costs less to leave it whole on one of them. None if nothing is won.
    fn cut_all(&self, pieces: &[Piece], at: &Division, mut left_to_cut: usize) -> Option<[Vec<Piece>; 2]> {
        let (axis, plane) = (at.axis, at.plane);
        let [left, right] = &at.bounds;
        let areas = at.bounds.map(|b| b.half_area());
        let numbers = at.counts.map(|count| count as f32);
        let mut sides = [Vec::with_capacity(at.counts[0]), Vec::with_capacity(at.counts[1])];
        for piece in pieces {
            let bounds = piece.bounds();
            let id = self.ids[piece.primitive as usize];
            let side = usize::from(piece.low[axis] >= plane);
            if side == 1 || piece.high[axis] <= plane {
                sides[side].push(*piece);
                continue;
            }
            let Some(triangle) = Corners::of(self.surfaces, id) else {
                sides[usize::from(middle(piece, axis) >= plane)].push(*piece);
                continue;
            };
            let [below, above] = cut(&bounds, &triangle, axis, plane);
            match (below.valid(), above.valid()) {
                (true, false) => sides[0].push(piece.with(&below)),
                (false, true) => sides[1].push(piece.with(&above)),
                (false, false) => sides[0].push(*piece),
                (true, true) => {
                    let cut = areas[0] * numbers[0] + areas[1] * numbers[1];
                    let to_left =
                        left.union(&bounds).half_area() * numbers[0] + areas[1] * (numbers[1] - 1.0);
                    let to_right =
                        areas[0] * (numbers[0] - 1.0) + right.union(&bounds).half_area() * numbers[1];
                    if cut < to_left.min(to_right) && left_to_cut > 0 {
                        left_to_cut -= 1;
                        sides[0].push(piece.with(&below));
                        sides[1].push(piece.with(&above));
                    } else {
                        sides[usize::from(to_right < to_left)].push(*piece);
                    }
                }
            }
        }
        let most = pieces.len();
        let wins = sides.iter().all(|side| !side.is_empty() && side.len() < most);
        wins.then_some(sides)
    }
}

impl Subtree {
    /// Both under a new root.
    fn over(bounds: Aabb, left: Subtree, right: Subtree) -> Subtree {
        let mut nodes = Vec::with_capacity(1 + left.nodes.len() + right.nodes.len());
        nodes.extend([Bvh2Node::new(bounds, 0, 1), left.nodes[0], right.nodes[0]]);
        // Where the children and the primitives of a half's nodes are, less where it has them itself.
        let moved = [(2, 0), (left.nodes.len() as u32 + 1, left.order.len() as u32)];
        for (side, half) in [&left, &right].into_iter().enumerate() {
            let move_on = |node: &mut Bvh2Node| {
                node.first_index += if node.is_leaf() { moved[side].1 } else { moved[side].0 };
            };
            move_on(&mut nodes[1 + side]);
            let first = nodes.len();
            nodes.extend_from_slice(&half.nodes[1..]);
            nodes[first..].iter_mut().for_each(move_on);
        }
        let mut order = left.order;
        order.extend(right.order);
        Subtree { nodes, order }
    }
}

fn middle(piece: &Piece, axis: usize) -> f32 {
    0.5 * piece.low[axis] + 0.5 * piece.high[axis]
}

fn around(pieces: &[Piece]) -> Aabb {
    let union = |a: Aabb, b: Aabb| a.union(&b);
    if pieces.len() > CHUNK {
        pieces.par_iter().map(Piece::bounds).reduce(Aabb::empty, union)
    } else {
        pieces.iter().map(Piece::bounds).fold(Aabb::empty(), union)
    }
}

/// Two halves, along the axis on which the middles lie farthest apart.
fn halve(mut pieces: Vec<Piece>) -> [Vec<Piece>; 2] {
    let spread = middles(&pieces).diagonal();
    let axis = (0..3).fold(0, |best, axis| if spread[axis] > spread[best] { axis } else { best });
    pieces.sort_by(|a, b| middle(a, axis).total_cmp(&middle(b, axis)));
    let right = pieces.split_off(pieces.len() / 2);
    [pieces, right]
}

fn middles(pieces: &[Piece]) -> Aabb {
    pieces.iter().fold(Aabb::empty(), |mut all, piece| {
        all.extend(Vec3A::from_array(std::array::from_fn(|axis| middle(piece, axis))));
        all
    })
}

/// The planes between so many slabs of equal width, and the ends; further slabs are empty.
fn planes(bounds: &Aabb, slabs: usize) -> [[f32; BINS + 1]; 3] {
    let mut planes = [[0.0; BINS + 1]; 3];
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis], bounds.max[axis]);
        for (k, plane) in planes[axis].iter_mut().enumerate() {
            let along = (k as f32 / slabs as f32).min(1.0);
            *plane = (low * (1.0 - along) + high * along).clamp(low, high);
        }
    }
    planes
}

/// The slab that begins at or before a coordinate, and ends behind it unless it is the last.
#[inline]
fn slab(planes: &[f32; BINS + 1], coordinate: f32) -> usize {
    // No early end: a fixed number of comparisons is done in vectors.
    planes[1..BINS].iter().map(|&plane| usize::from(plane <= coordinate)).sum()
}

/// The best division by the middles of pieces, none of which is cut. None if all middles are one.
fn by_middles(pieces: &[Piece]) -> Option<Division> {
    let planes = planes(&middles(pieces), BINS);
    let bins = gathered(pieces, |bins, piece| {
        for axis in 0..3 {
            let at = middle(piece, axis);
            let k = slab(&planes[axis], at);
            bins.bounds[axis][k] = bins.bounds[axis][k].union(&piece.bounds());
            bins.begin[axis][k] += 1;
            bins.end[axis][k] += 1;
        }
    });
    bins.best(&planes)
}

/// All pieces, entered into slabs side by side.
fn gathered(pieces: &[Piece], enter: impl Fn(&mut Bins, &Piece) + Sync) -> Bins {
    let of = |chunk: &[Piece]| {
        let mut bins = Bins::empty();
        chunk.iter().for_each(|piece| enter(&mut bins, piece));
        bins
    };
    if pieces.len() > 2 * CHUNK {
        pieces.par_chunks(CHUNK).map(of).reduce(Bins::empty, Bins::merged)
    } else {
        of(pieces)
    }
}

/// The best division of few pieces: their order, of which `counts[0]` come first.
fn sweep(pieces: &[Piece]) -> (Vec<u32>, Division) {
    let mut best: Option<(Vec<u32>, Division)> = None;
    for axis in 0..3 {
        let mut order: Vec<u32> = (0..pieces.len() as u32).collect();
        order.sort_by(|&a, &b| {
            middle(&pieces[a as usize], axis).total_cmp(&middle(&pieces[b as usize], axis))
        });
        let mut behind = vec![Aabb::empty(); pieces.len() + 1];
        for (place, &k) in order.iter().enumerate().rev() {
            behind[place] = behind[place + 1].union(&pieces[k as usize].bounds());
        }
        let mut before = Aabb::empty();
        for left in 1..pieces.len() {
            before = before.union(&pieces[order[left - 1] as usize].bounds());
            let counts = [left, pieces.len() - left];
            let cost = before.half_area() * counts[0] as f32 + behind[left].half_area() * counts[1] as f32;
            if best.as_ref().is_none_or(|(_, best)| cost < best.cost) {
                let bounds = [before, behind[left]];
                best = Some((order.clone(), Division { cost, axis, plane: 0.0, bounds, counts }));
            }
        }
    }
    best.expect("two pieces or more")
}

impl Bins {
    fn empty() -> Bins {
        Bins { bounds: [[Aabb::empty(); BINS]; 3], begin: [[0; BINS]; 3], end: [[0; BINS]; 3] }
    }

    fn merged(mut self, other: Bins) -> Bins {
        for axis in 0..3 {
            for k in 0..BINS {
                self.bounds[axis][k] = self.bounds[axis][k].union(&other.bounds[axis][k]);
                self.begin[axis][k] += other.begin[axis][k];
                self.end[axis][k] += other.end[axis][k];
            }
        }
        self
    }

    /// The plane between slabs that costs least.
    fn best(&self, planes: &[[f32; BINS + 1]; 3]) -> Option<Division> {
        let mut best: Option<Division> = None;
        for axis in 0..3 {
            let mut behind = [(Aabb::empty(), 0); BINS + 1];
            for k in (1..BINS).rev() {
                let (bounds, count) = behind[k + 1];
                behind[k] = (bounds.union(&self.bounds[axis][k]), count + self.end[axis][k] as usize);
            }
            let (mut before, mut count) = (Aabb::empty(), 0);
            for k in 1..BINS {
                before = before.union(&self.bounds[axis][k - 1]);
                count += self.begin[axis][k - 1] as usize;
                let counts = [count, behind[k].1];
                if counts.contains(&0) {
                    continue;
                }
                let bounds = [before, behind[k].0];
                let cost =
                    bounds[0].half_area() * counts[0] as f32 + bounds[1].half_area() * counts[1] as f32;
                if best.is_none_or(|best| cost < best.cost) {
                    best = Some(Division { cost, axis, plane: planes[axis][k], bounds, counts });
                }
            }
        }
        best
    }
}
