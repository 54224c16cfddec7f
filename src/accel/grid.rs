//! A uniform grid: cells of one size with lists of what reaches into them, walked cell by cell along the ray (Amanatides and Woo 1987, "A Fast Voxel Traversal
//! Algorithm for Ray Tracing"). Slower than the tree; it can be cut into pieces by place alone.
//!
//! No hit is lost: with Q = |origin|∞ + extent, u = 2^-53, a crossing of a plane is computed anew for each step (nothing adds up) and lies within 4uQ of where
//! it is, so the cells walked hold every point of the line to within that. Primitives are entered into all cells whose box, grown by 2^-30 of the extent, they reach (triangles: their
//! boxes, which hold every point where one may be met); that is more
//! for origins up to 2^20 extents away, and beyond those every primitive is tested. A walk ends where the next cell begins beyond the best hit by more than 2^-22 Q: t is
//! off by less than 2^-32 Q of triangles (`triangle::GRAZING`) and by less than the root of 2^-53 of spheres that it hardly touches.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::tester::Tester;
use super::wide::level::Level;
use super::wide::sieve::Sieve;
use super::wide::tree::WIDTH;
use super::{brute, solid};
use crate::geometry::record::Answer;
use crate::geometry::{NONE, Ray, norm_max, sub};
use crate::memory::{Array, HugeArray};
use crate::scene::Surfaces;

/// Bytes for each primitive while the grid is built, at up to a cell for each: a list's entry and a cell twice, at some eight entries for each.
pub const BYTES_TO_BUILD: u64 = 120;
/// Most cells.
const MOST_CELLS: f64 = (1u32 << 30) as f64;
/// Most cells along an axis.
const MOST_ALONG: f64 = 4096.0;
/// What boxes of cells are grown by when primitives are entered, in extents.
const PAD: f64 = 1.0 / (1u64 << 30) as f64;
/// How far beyond a hit cells are walked, in Q.
const SLACK: f64 = 1.0 / (1u64 << 22) as f64;
/// The farthest origin, in extents, for which cells are walked.
const FARTHEST: f64 = (1u64 << 20) as f64;
/// Primitives that a ray remembers having been tested against.
const REMEMBERED: usize = 8;
/// Cells along an edge of a block; a bit of a `u64` for each cell of it.
const BLOCK: u32 = 4;

/// The grid: cell (x, y, z) has the number (z * ny + y) * nx + x.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    /// The lowest corner, and the size of a cell.
    pub low: [f64; 3],
    pub size: [f64; 3],
    pub counts: [u32; 3],
    /// The largest magnitude of a coordinate of the grid's box.
    pub extent: f64,
    /// Where each cell's list begins; one more than cells.
    pub starts: HugeArray<u32>,
    pub primitives: HugeArray<u32>,
    /// For each block of cells which of them have something.
    pub occupied: HugeArray<u64>,
}

impl Grid {
    /// Builds over all primitives but triangles without area, with about `density` cells for each. On the current rayon pool; the same grid for any number of threads.
    pub fn build(surfaces: &Surfaces, mut density: f64) -> Grid {
        let ids = solid(surfaces);
        let Some((low, high)) = surfaces.bounds().filter(|_| !ids.is_empty()) else {
            return Grid::default();
        };
        let (low, high) = (low.to_array(), high.to_array());
        loop {
            let mut grid = Grid::laid(low, high, density * ids.len() as f64);
            if grid.fill(surfaces, &ids) {
                return grid;
            }
            // More entries than can be numbered: large primitives in small cells.
            density *= 0.5;
        }
    }

    /// An empty grid over a box with about so many cells, as near to cubes as can be.
    fn laid(low: [f64; 3], high: [f64; 3], cells: f64) -> Grid {
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
        Grid { low, size, counts, extent: extent + pad, ..Grid::default() }
    }

    /// Enters the primitives by counting sort; false if there are too many entries.
    fn fill(&mut self, surfaces: &Surfaces, ids: &[u32]) -> bool {
        let cells = self.counts.iter().map(|&count| count as usize).product();
        let counts: Vec<AtomicU32> = (0..cells).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        let total: u64 = ids
            .par_iter()
            .map(|&id| {
                let mut entries = 0;
                self.each_cell(surfaces, id, |cell| {
                    counts[cell].fetch_add(1, Ordering::Relaxed);
                    entries += 1;
                });
                entries
            })
            .sum();
        if total > u64::from(u32::MAX) {
            return false;
        }
        self.starts = HugeArray::zeroed(cells + 1).expect("memory for the grid's cells");
        let mut sum = 0;
        for (start, count) in self.starts.iter_mut().zip(&counts) {
            *start = sum;
            sum += count.swap(sum, Ordering::Relaxed);
        }
        self.starts[cells] = sum;
        let slots: Vec<AtomicU32> = (0..total).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        ids.par_iter().for_each(|&id| {
            self.each_cell(surfaces, id, |cell| {
                let slot = counts[cell].fetch_add(1, Ordering::Relaxed) as usize;
                slots[slot].store(id, Ordering::Relaxed);
            });
        });
        self.primitives = HugeArray::zeroed(total as usize).expect("memory for the grid's lists");
        self.primitives.par_iter_mut().zip(&slots).for_each(|(id, slot)| *id = slot.load(Ordering::Relaxed));
        self.sort();
        self.mark();
        true
    }

    /// Puts each list in order, whatever the threads made of it.
    fn sort(&mut self) {
        let mut lists = Vec::with_capacity(self.starts.len());
        let mut rest: &mut [u32] = &mut self.primitives;
        for ends in self.starts.windows(2) {
            if let Some(list) = rest.split_off_mut(..(ends[1] - ends[0]) as usize)
                && list.len() > 1
            {
                lists.push(list);
            }
        }
        lists.into_par_iter().for_each(|list| list.sort_unstable());
    }

    /// Marks the occupied cells.
    fn mark(&mut self) {
        let blocks: usize = self.block_counts().iter().map(|&count| count as usize).product();
        self.occupied = HugeArray::zeroed(blocks).expect("memory for the grid's blocks");
        for z in 0..self.counts[2] {
            for y in 0..self.counts[1] {
                for x in 0..self.counts[0] {
                    let cell = self.number([x, y, z]);
                    if self.starts[cell] < self.starts[cell + 1] {
                        let (block, bit) = self.block([x, y, z]);
                        self.occupied[block] |= 1 << bit;
                    }
                }
            }
        }
    }

    fn block_counts(&self) -> [u32; 3] {
        self.counts.map(|count| count.div_ceil(BLOCK))
    }

    fn number(&self, [x, y, z]: [u32; 3]) -> usize {
        (z as usize * self.counts[1] as usize + y as usize) * self.counts[0] as usize + x as usize
    }

    /// A cell's block and its bit there.
    fn block(&self, cell: [u32; 3]) -> (usize, u32) {
        let ([x, y, z], [bx, by, _]) = (cell.map(|c| c / BLOCK), self.block_counts());
        let [i, j, k] = cell.map(|c| c % BLOCK);
        ((z as usize * by as usize + y as usize) * bx as usize + x as usize, (k * BLOCK + j) * BLOCK + i)
    }

    /// The cell along an axis that holds a coordinate; the nearest, if none does.
    fn along(&self, axis: usize, coordinate: f64) -> u32 {
        let cell = ((coordinate - self.low[axis]) / self.size[axis]).floor();
        cell.clamp(0.0, f64::from(self.counts[axis] - 1)) as u32
    }

    /// Calls `visit` with each cell whose grown box a primitive reaches, or may reach.
    fn each_cell(&self, surfaces: &Surfaces, id: u32, mut visit: impl FnMut(usize)) {
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
                        visit(self.number(cell));
                    }
                }
            }
        }
    }

    /// Bytes of cells and lists.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.primitives) + size_of_val(&*self.occupied)
    }

    /// The least (t, primitive id), or with `any` whether there is one.
    pub(super) fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        if self.starts.is_empty() {
            return Answer::MISS;
        }
        if norm_max(ray.origin.to_array()) > FARTHEST * self.extent {
            return brute::answer(surfaces, ray, any);
        }
        let mut tester = Tester::new(surfaces, ray);
        self.walk(&mut tester, any);
        tester.verdict(any)
    }

    fn walk(&self, tester: &mut Tester, any: bool) {
        let (origin, direction) = (tester.ray.origin, tester.ray.direction);
        let slack = (norm_max(origin) + self.extent) * SLACK;
        let (mut enter, mut exit) = (tester.ray.t_min - slack, tester.t_best + slack);
        for axis in 0..3 {
            let high = self.low[axis] + f64::from(self.counts[axis]) * self.size[axis];
            let (first, last) = (self.low[axis] - origin[axis], high - origin[axis]);
            if direction[axis] == 0.0 {
                if first > slack || last < -slack {
                    return;
                }
                continue;
            }
            let (first, last) = (first / direction[axis], last / direction[axis]);
            enter = enter.max(first.min(last) - slack);
            exit = exit.min(first.max(last) + slack);
        }
        if enter > exit {
            return;
        }
        let mut cell: [u32; 3] =
            std::array::from_fn(|axis| self.along(axis, origin[axis] + enter * direction[axis]));
        let (mut remembered, mut oldest) = ([NONE; REMEMBERED], 0);
        let sieve = Sieve::new(Level::chosen(), &tester.ray, self.extent);
        let mut gathered = Gathered { ids: [NONE; WIDTH], count: 0 };
        loop {
            let (block, bit) = self.block(cell);
            let occupied = self.occupied[block];
            if occupied >> bit & 1 == 1 {
                let number = self.number(cell);
                let list = self.starts[number] as usize..self.starts[number + 1] as usize;
                for &id in &self.primitives[list] {
                    if remembered.contains(&id) {
                        continue;
                    }
                    remembered[oldest] = id;
                    oldest = (oldest + 1) % REMEMBERED;
                    gathered.push(id, tester, &sieve);
                }
                gathered.test(tester, &sieve);
                if any && tester.found() {
                    return;
                }
            }
            // Out of the cell, or of the whole block if it is empty.
            let (mut t, mut through) = (f64::INFINITY, 0);
            let mut beyond = [0i64; 3];
            for axis in 0..3 {
                let at = i64::from(cell[axis]);
                let block_edge = i64::from(BLOCK);
                let (first, last) = if occupied == 0 {
                    (at / block_edge * block_edge, at / block_edge * block_edge + block_edge)
                } else {
                    (at, at + 1)
                };
                let forwards = direction[axis] > 0.0;
                let plane = if forwards { last } else { first };
                beyond[axis] = if forwards { last } else { first - 1 };
                if direction[axis] != 0.0 {
                    let next =
                        ((self.low[axis] + plane as f64 * self.size[axis]) - origin[axis]) / direction[axis];
                    if next < t {
                        (t, through) = (next, axis);
                    }
                }
            }
            if t > exit.min(tester.t_best + slack) {
                return;
            }
            if occupied == 0 {
                // The other coordinates have moved on too: never back, and not out of the block.
                for axis in (0..3).filter(|&axis| axis != through && direction[axis] != 0.0) {
                    let now = self.along(axis, origin[axis] + t * direction[axis]);
                    let (first, last) = (cell[axis] / BLOCK * BLOCK, cell[axis] / BLOCK * BLOCK + BLOCK - 1);
                    cell[axis] = if direction[axis] > 0.0 {
                        now.clamp(cell[axis], last.min(self.counts[axis] - 1))
                    } else {
                        now.clamp(first, cell[axis])
                    };
                }
            }
            if beyond[through] < 0 || beyond[through] >= i64::from(self.counts[through]) {
                return;
            }
            cell[through] = beyond[through] as u32;
        }
    }
}

/// Primitives to be tested together, all triangles or all spheres.
struct Gathered {
    ids: [u32; WIDTH],
    count: usize,
}

impl Gathered {
    fn push(&mut self, id: u32, tester: &mut Tester, sieve: &Sieve) {
        let triangles = tester.surfaces.triangles.len() as u32;
        let is_other_kind = self.count > 0 && (self.ids[0] < triangles) != (id < triangles);
        if self.count == WIDTH || is_other_kind {
            self.test(tester, sieve);
        }
        self.ids[self.count] = id;
        self.count += 1;
    }

    /// Tests what the filter lets through.
    fn test(&mut self, tester: &mut Tester, sieve: &Sieve) {
        let ids = &self.ids[..self.count];
        // A single one is as soon decided as sifted.
        let mut left = if ids.len() > 1 {
            sieve.survivors(tester.surfaces, ids, tester.t_best)
        } else {
            ids.len() as u32
        };
        while left != 0 {
            tester.test(ids[left.trailing_zeros() as usize]);
            left &= left - 1;
        }
        self.count = 0;
    }
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
