//! A box cut into cells of one size, and the way of a ray through them (Amanatides and Woo 1987, "A Fast Voxel Traversal Algorithm for Ray Tracing").
//! Knows which cells a primitive reaches into; must not know what is kept in a cell.
//!
//! No hit is lost: with Q = |origin|∞ + extent, u = 2^-53, a crossing of a plane is computed anew for each step (nothing adds up) and lies within 8uQ of where
//! it is, so the cells walked hold every point of the line to within that. Primitives are entered into all cells whose box, grown by 2^-30 of the extent, they reach (triangles: their
//! boxes, which hold every point where one may be met); that is more
//! for origins up to 2^20 extents away ([`Lattice::serves`]). A walk ends where the next cell begins beyond the best hit by more than 2^-22 Q: t is
//! off by less than 2^-32 Q of triangles (`triangle::GRAZING`) and by less than the root of 2^-53 of spheres that it hardly touches.

use serde::{Deserialize, Serialize};

use crate::geometry::{Prepared, norm_max, sub};
use crate::scene::Surfaces;

/// Most cells.
const MOST_CELLS: f64 = (1u32 << 30) as f64;
/// Most cells along an axis.
const MOST_ALONG: f64 = 4096.0;
/// What boxes of cells are grown by when primitives are entered, in extents.
const PAD: f64 = 1.0 / (1u64 << 30) as f64;
/// How far beyond a hit cells are walked, in Q.
const SLACK: f64 = 1.0 / (1u64 << 22) as f64;
/// What the box of a span is grown by, in Q: more than the planes' crossings, the box's and the cell of a point are off from one another, and nothing beside a cell.
const GROWN: f64 = 1.0 / (1u64 << 46) as f64;
/// The farthest origin, in extents, for which cells are walked.
const FARTHEST: f64 = (1u64 << 20) as f64;
/// Cells along an edge of a block; a bit of a `u64` for each cell of it.
pub const BLOCK: u32 = 4;

/// Some of the cells along each axis: from the first on, and before the second.
pub type Span = [[i32; 2]; 3];

/// Cells of a box: cell (x, y, z) has the number (z * ny + y) * nx + x. Blocks of 4³ cells are numbered alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Lattice {
    /// The lowest corner, and the size of a cell.
    pub low: [f64; 3],
    pub size: [f64; 3],
    /// Cells along the axes; 0 where there is nothing.
    pub counts: [u32; 3],
    /// The largest magnitude of a coordinate of the box.
    pub extent: f64,
}

impl Lattice {
    /// Cells over the box of something, about so many, as near to cubes as can be.
    pub fn over(low: [f64; 3], high: [f64; 3], cells: f64) -> Lattice {
        let extent = norm_max(low).max(norm_max(high)).max(f64::MIN_POSITIVE);
        let pad = 4.0 * PAD * extent;
        let low = low.map(|c| c - pad);
        let widths: [f64; 3] = std::array::from_fn(|axis| high[axis] + pad - low[axis]);
        let cells = cells.clamp(1.0, MOST_CELLS);
        let mut along = [f64::NAN; 3];
        // Axes along which not even one cell of the common size fits have one cell; the others share the rest.
        loop {
            let open = (0..3).filter(|&axis| along[axis].is_nan());
            let volume: f64 = open.clone().map(|axis| widths[axis]).product();
            let per_length = libm::pow(cells / volume, 1.0 / open.clone().count().max(1) as f64);
            match open.clone().find(|&axis| widths[axis] * per_length < 1.0) {
                Some(flat) => along[flat] = 1.0,
                None => {
                    open.collect::<Vec<_>>()
                        .into_iter()
                        .for_each(|axis| along[axis] = widths[axis] * per_length);
                    break;
                }
            }
        }
        let counts = along.map(|count| count.round().clamp(1.0, MOST_ALONG) as u32);
        let size = std::array::from_fn(|axis| widths[axis] / f64::from(counts[axis]));
        Lattice { low, size, counts, extent: extent + pad }
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.block_counts().iter().map(|&count| count as usize).product()
    }

    /// Where a block lies, in blocks.
    pub fn block_place(&self, block: usize) -> [u32; 3] {
        let [nx, ny, _] = self.block_counts().map(|count| count as usize);
        [block % nx, block / nx % ny, block / nx / ny].map(|c| c as u32)
    }

    fn block_counts(&self) -> [u32; 3] {
        self.counts.map(|count| count.div_ceil(BLOCK))
    }

    pub fn number(&self, [x, y, z]: [u32; 3]) -> usize {
        (z as usize * self.counts[1] as usize + y as usize) * self.counts[0] as usize + x as usize
    }

    /// A cell's block and its bit there.
    #[inline]
    pub fn block(&self, cell: [u32; 3]) -> (usize, u32) {
        let ([x, y, z], [bx, by, _]) = (cell.map(|c| c / BLOCK), self.block_counts());
        let [i, j, k] = cell.map(|c| c % BLOCK);
        ((z as usize * by as usize + y as usize) * bx as usize + x as usize, (k * BLOCK + j) * BLOCK + i)
    }

    /// Where a plane between cells lies along an axis; 0 is the first.
    #[inline]
    pub fn plane(&self, axis: usize, number: i32) -> f64 {
        self.low[axis] + f64::from(number) * self.size[axis]
    }

    /// The number along an axis of the cell that holds a coordinate, or would if there were cells all along it.
    #[inline]
    pub fn beside(&self, axis: usize, coordinate: f64) -> f64 {
        ((coordinate - self.low[axis]) / self.size[axis]).floor()
    }

    /// The cell along an axis that holds a coordinate; the nearest, if none does.
    #[inline]
    fn along(&self, axis: usize, coordinate: f64) -> u32 {
        self.beside(axis, coordinate).clamp(0.0, f64::from(self.counts[axis] - 1)) as u32
    }

    /// Calls `visit` with each cell whose grown box a primitive reaches, or may reach.
    pub fn each_cell(&self, surfaces: &Surfaces, id: u32, mut visit: impl FnMut([u32; 3])) {
        let pad = 2.0 * PAD * self.extent;
        let sphere = surfaces.sphere_at(id).map(|s| (s.center.map(f64::from), f64::from(s.radius)));
        let corners = match sphere {
            None => surfaces.triangle(id).map(|v| v.map(f64::from)),
            Some((center, radius)) => [center.map(|c| c - radius), center.map(|c| c + radius), center],
        };
        let ends: [[u32; 2]; 3] = std::array::from_fn(|axis| {
            let [a, b, c] = corners.map(|v| v[axis]);
            [self.along(axis, a.min(b).min(c) - pad), self.along(axis, a.max(b).max(c) + pad)]
        });
        let single_row = ends.iter().filter(|[first, last]| first != last).count() <= 1;
        let half: [f64; 3] = std::array::from_fn(|axis| 0.5 * self.size[axis] + pad);
        for z in ends[2][0]..=ends[2][1] {
            for y in ends[1][0]..=ends[1][1] {
                for x in ends[0][0]..=ends[0][1] {
                    let cell = [x, y, z];
                    let middle: [f64; 3] = std::array::from_fn(|axis| {
                        self.low[axis] + (f64::from(cell[axis]) + 0.5) * self.size[axis]
                    });
                    // Of a triangle its box decides.
                    let reaches = single_row
                        || sphere.is_none_or(|(center, radius)| {
                            sphere_reaches_box(sub(center, middle), radius, half)
                        });
                    if reaches {
                        visit(cell);
                    }
                }
            }
        }
    }

    /// Calls `visit` with each block that such a cell lies in, and the bits of those cells; with a block maybe more than once.
    pub fn each_block(&self, surfaces: &Surfaces, id: u32, mut visit: impl FnMut(usize, u64)) {
        let (mut last, mut bits) = (usize::MAX, 0);
        self.each_cell(surfaces, id, |cell| {
            let (block, bit) = self.block(cell);
            if block != last {
                if bits != 0 {
                    visit(last, bits);
                }
                (last, bits) = (block, 0);
            }
            bits |= 1 << bit;
        });
        if bits != 0 {
            visit(last, bits);
        }
    }

    /// Whether rays from here can be walked; those from farther out meet who knows what.
    pub fn serves(&self, origin: [f64; 3]) -> bool {
        norm_max(origin) <= FARTHEST * self.extent
    }

    /// The cells of a block.
    pub fn block_span(&self, block: usize) -> Span {
        let place = self.block_place(block);
        std::array::from_fn(|axis| {
            let first = BLOCK * place[axis];
            [first as i32, (first + BLOCK).min(self.counts[axis]) as i32]
        })
    }

    /// Walks the cells along a ray and calls `visit` with each occupied one and its block, in order, until it answers `None` or the next cell lies
    /// beyond the t that it answered last, at first the ray's end. t is in units of the scaled direction. The ray's origin must be served.
    ///
    /// `occupied` tells the cells of a block that are to be visited, at each cell anew; a block without any is passed in one step.
    #[inline]
    pub fn walk(
        &self,
        ray: &Prepared,
        occupied: impl Fn(usize) -> u64,
        visit: impl FnMut([u32; 3], usize) -> Option<f64>,
    ) {
        self.walk_within(self.counts.map(|count| [0, count as i32]), ray, occupied, visit);
    }

    /// The same of the cells of a span alone.
    #[inline]
    pub fn walk_within(
        &self,
        span: Span,
        ray: &Prepared,
        occupied: impl Fn(usize) -> u64,
        mut visit: impl FnMut([u32; 3], usize) -> Option<f64>,
    ) {
        let (origin, direction) = (ray.origin, ray.direction);
        let away = norm_max(origin) + self.extent;
        let (slack, grown) = (away * SLACK, away * GROWN);
        let (mut enter, mut exit) = (ray.t_min - slack, ray.t_max + slack);
        // Plane p of an axis is crossed at zero + p * width.
        let (mut zero, mut width, mut per_length) = ([f64::INFINITY; 3], [0.0; 3], [0.0; 3]);
        let (mut step, mut ahead) = ([-1; 3], [0; 3]);
        let count = self.counts.map(|count| count as i32);
        for axis in 0..3 {
            per_length[axis] = 1.0 / self.size[axis];
            let [low, high] = span[axis].map(|plane| self.plane(axis, plane));
            let (first, last) = (low - origin[axis], high - origin[axis]);
            if !moves(direction[axis]) {
                if first > slack || last < -slack {
                    return;
                }
                continue;
            }
            if direction[axis] > 0.0 {
                (step[axis], ahead[axis]) = (1, 1);
            }
            let inverse = 1.0 / direction[axis];
            (zero[axis], width[axis]) =
                ((self.low[axis] - origin[axis]) * inverse, self.size[axis] * inverse);
            // Of a ray that hardly moves along this axis the slack of t is less than rounding moves the planes.
            let (first, last) = ((first - grown) * inverse, (last + grown) * inverse);
            enter = enter.max(first.min(last) - slack);
            exit = exit.min(first.max(last) + slack);
        }
        if enter > exit {
            return;
        }
        let crossing = |axis: usize, plane: i32| zero[axis] + f64::from(plane) * width[axis];
        // Truncation is floor where it matters: below 0 everything is clamped to 0.
        let at = |axis: usize, t: f64| {
            ((origin[axis] + t * direction[axis] - self.low[axis]) * per_length[axis]) as i32
        };
        let edge = BLOCK as i32;
        let row = (count[0] + edge - 1) / edge;
        let layer = row * ((count[1] + edge - 1) / edge);
        let (mut cell, mut next) = ([0; 3], [0.0; 3]);
        for axis in 0..3 {
            cell[axis] = at(axis, enter).clamp(span[axis][0], span[axis][1] - 1);
            next[axis] = crossing(axis, cell[axis] + ahead[axis]);
        }
        let mut end = exit;
        loop {
            let [x, y, z] = cell;
            let block = (z / edge * layer + y / edge * row + x / edge) as usize;
            let bit = (z % edge * edge + y % edge) * edge + x % edge;
            let bits = occupied(block);
            if bits != 0 {
                if bits >> bit & 1 == 1 {
                    match visit([x as u32, y as u32, z as u32], block) {
                        Some(t) => end = exit.min(t + slack),
                        None => return,
                    }
                }
                // Out of the cell.
                let through = least(next);
                if next[through] > end {
                    return;
                }
                cell[through] += step[through];
                if cell[through] < span[through][0] || cell[through] >= span[through][1] {
                    return;
                }
                next[through] = crossing(through, cell[through] + ahead[through]);
                continue;
            }
            // Out of the whole block, which is empty.
            let (mut low, mut out) = ([0; 3], [0.0; 3]);
            for axis in 0..3 {
                low[axis] = cell[axis] / edge * edge;
                out[axis] = crossing(axis, low[axis] + edge * ahead[axis]);
            }
            let through = least(out);
            let t = out[through];
            if t > end {
                return;
            }
            for axis in 0..3 {
                if axis == through {
                    cell[axis] = if ahead[axis] == 1 { low[axis] + edge } else { low[axis] - 1 };
                    if cell[axis] < span[axis][0] || cell[axis] >= span[axis][1] {
                        return;
                    }
                } else if ahead[axis] == 1 {
                    // The other coordinates have moved on too: never back, and not out of the block.
                    cell[axis] = at(axis, t).min((low[axis] + edge).min(count[axis]) - 1).max(cell[axis]);
                } else if moves(direction[axis]) {
                    cell[axis] = at(axis, t).max(low[axis]).min(cell[axis]);
                }
                next[axis] = crossing(axis, cell[axis] + ahead[axis]);
            }
        }
    }
}

/// Whether a component of a direction, whose largest is 1 at least, takes a ray anywhere: less, over all the way that is walked, stays far below the slack, and its inverse
/// may not be a number.
#[inline]
fn moves(component: f64) -> bool {
    component.abs() > 1e-200
}

/// The axis of the least of three numbers; of equals the first.
#[inline]
fn least(t: [f64; 3]) -> usize {
    let second = if t[1] < t[0] { 1 } else { 0 };
    if t[2] < t[second] { 2 } else { second }
}

/// Whether a sphere's surface reaches a box around 0.
fn sphere_reaches_box(center: [f64; 3], radius: f64, half: [f64; 3]) -> bool {
    let (mut nearest, mut farthest) = (0.0, 0.0);
    for axis in 0..3 {
        let beside = (center[axis].abs() - half[axis]).max(0.0);
        let across = center[axis].abs() + half[axis];
        nearest += beside * beside;
        farthest += across * across;
    }
    // Rounding a sum of squares takes some 2^-51 of it; half the pad of a box is more unless the sphere is far larger than the scene's extent.
    let slack = 1e-12 * (radius * radius + farthest);
    nearest <= radius * radius + slack && farthest >= radius * radius - slack
}
