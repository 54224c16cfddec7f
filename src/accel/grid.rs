//! A uniform grid: cells of one size with lists of what reaches into them, walked cell by cell along the ray (Amanatides and Woo 1987, "A Fast Voxel Traversal
//! Algorithm for Ray Tracing"). Slower than the tree; it can be cut into pieces by place alone.
//!
//! Rays that go much the same way go through it in packets (`wide::slices`). Why no hit is lost: see there and `lattice`. A ray alone whose origin isn't served is tested
//! against every primitive.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::lattice::Lattice;
use super::tester::Tester;
use super::wide::Questions;
use super::wide::sieve::Sieve;
use super::wide::slices::Cells;
use super::wide::tree::WIDTH;
use super::{bounds, brute, solid, wide};
use crate::geometry::record::Answer;
use crate::geometry::{NONE, Ray};
use crate::memory::{Array, HugeArray};
use crate::scene::Surfaces;
use crate::simd::Level;

/// Bytes for each primitive while the grid is built, at up to a cell for each: a list's entry and a cell twice, at some eight entries for each.
pub const BYTES_TO_BUILD: u64 = 120;
/// Primitives that a ray remembers having been tested against.
const REMEMBERED: usize = 8;

/// The grid: its cells, and what reaches into each.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    pub lattice: Lattice,
    /// Where each cell's list begins; one more than cells.
    pub starts: HugeArray<u32>,
    pub primitives: HugeArray<u32>,
    /// For each block of cells which of them have something.
    pub occupied: HugeArray<u64>,
    /// The largest magnitude of a coordinate of what rays may start on, if that is more than what is in the cells.
    pub starts_extent: f64,
}

impl Grid {
    /// Builds over all primitives but triangles without area, with about `density` cells for each. On the current rayon pool; the same grid for any number of threads.
    pub fn build(surfaces: &Surfaces, density: f64) -> Grid {
        Grid::build_over(surfaces, &solid(surfaces), density)
    }

    /// The same over these primitives.
    pub fn build_over(surfaces: &Surfaces, ids: &[u32], mut density: f64) -> Grid {
        let Some((low, high)) = bounds(surfaces, ids) else { return Grid::default() };
        let (low, high) = (low.to_array(), high.to_array());
        loop {
            let lattice = Lattice::over(low, high, density * ids.len() as f64);
            let mut grid = Grid { lattice, ..Grid::default() };
            if grid.fill(surfaces, ids) {
                return grid;
            }
            // More entries than can be numbered: large primitives in small cells.
            density *= 0.5;
        }
    }

    /// Enters the primitives by counting sort; false if there are too many entries.
    fn fill(&mut self, surfaces: &Surfaces, ids: &[u32]) -> bool {
        let cells = self.lattice.counts.iter().map(|&count| count as usize).product();
        let counts: Vec<AtomicU32> = (0..cells).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        let total: u64 = ids
            .par_iter()
            .map(|&id| {
                let mut entries = 0;
                self.lattice.each_cell(surfaces, id, |cell| {
                    counts[self.lattice.number(cell)].fetch_add(1, Ordering::Relaxed);
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
            self.lattice.each_cell(surfaces, id, |cell| {
                let slot = counts[self.lattice.number(cell)].fetch_add(1, Ordering::Relaxed) as usize;
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
        self.occupied = HugeArray::zeroed(self.lattice.blocks()).expect("memory for the grid's blocks");
        for z in 0..self.lattice.counts[2] {
            for y in 0..self.lattice.counts[1] {
                for x in 0..self.lattice.counts[0] {
                    let cell = self.lattice.number([x, y, z]);
                    if self.starts[cell] < self.starts[cell + 1] {
                        let (block, bit) = self.lattice.block([x, y, z]);
                        self.occupied[block] |= 1 << bit;
                    }
                }
            }
        }
    }

    /// Bytes of cells and lists.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.primitives) + size_of_val(&*self.occupied)
    }

    /// Answers a batch: rays that go much the same way in packets, the others one by one.
    pub fn trace(
        &self,
        level: Level,
        surfaces: &Surfaces,
        questions: &impl Questions,
        answers: &mut [Answer],
    ) {
        if self.starts.is_empty() {
            answers.fill(Answer::MISS);
            return;
        }
        let Grid { lattice, starts, primitives, occupied, starts_extent } = self;
        let cells = Cells { lattice, starts, primitives, occupied, starts_extent: *starts_extent };
        let mut alone = Vec::new();
        wide::through_cells(level, cells, surfaces, questions, answers, &mut alone);
        for index in alone {
            let (ray, any) = questions.question(index);
            answers[index] = self.answer(surfaces, &ray, any);
        }
    }

    /// The least (t, primitive id), or with `any` whether there is one.
    pub(super) fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        if self.starts.is_empty() {
            return Answer::MISS;
        }
        if !self.lattice.serves(ray.origin.to_array()) {
            return brute::answer(surfaces, self.distinct(surfaces), ray, any);
        }
        let mut tester = Tester::new(surfaces, ray);
        self.walk(&mut tester, any);
        tester.verdict(any)
    }

    /// Each primitive once, though most reach into several cells.
    fn distinct(&self, surfaces: &Surfaces) -> impl Iterator<Item = u32> + '_ {
        let mut seen = vec![0u64; surfaces.len().div_ceil(64)];
        self.primitives.iter().copied().filter(move |&id| {
            let (word, bit) = (&mut seen[id as usize / 64], 1 << (id % 64));
            let is_new = *word & bit == 0;
            *word |= bit;
            is_new
        })
    }

    fn walk(&self, tester: &mut Tester, any: bool) {
        let ray = tester.ray;
        let (mut remembered, mut oldest) = ([NONE; REMEMBERED], 0);
        let sieve = Sieve::new(Level::chosen(), &ray, self.lattice.extent);
        let mut gathered = Together { ids: [NONE; WIDTH], count: 0 };
        self.lattice.walk(
            &ray,
            |block| self.occupied[block],
            |cell, _| {
                let number = self.lattice.number(cell);
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
                (!(any && tester.found())).then_some(tester.t_best)
            },
        );
    }
}

/// Primitives to be tested together, all triangles or all spheres.
struct Together {
    ids: [u32; WIDTH],
    count: usize,
}

impl Together {
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
