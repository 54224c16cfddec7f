//! Cutting a scene into parts for ranks: by place, along a Morton curve through blocks of voxels, or by equal numbers of primitives. Knows no rank but by number.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::lattice::Lattice;
use super::morton::morton;
use super::voxels::{EVERYBODY, NOBODY, Voxels};
use super::{bounds, solid, solid_ids};
use crate::geometry::{Prepared, Ray};
use crate::scene::Surfaces;

/// Voxels for each primitive.
const DENSITY: f64 = 0.25;
/// Fewest voxels, for scenes of few large primitives, and fewest for each rank: 64 blocks.
const FEWEST: f64 = 4096.0;
const FEWEST_PER_RANK: f64 = 4096.0;
/// Most voxels that scenes get for being large, 2^24 where there are very many ranks.
const MOST: f64 = (1u32 << 21) as f64;
/// The weight of the rays that were looked at beside that of the primitives; memory is what this way of working is for.
const RAYS_SHARE: f64 = 0.25;
/// The last place along an axis of the curve.
const PLACES: f64 = ((1u32 << 21) - 1) as f64;

/// What lies where, before anything is anyone's.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    pub lattice: Lattice,
    pub occupied: Vec<u64>,
    /// Primitives that reach into each block.
    pub(super) entries: Vec<u32>,
}

impl Survey {
    /// Looks at all primitives that can be hit. On the current rayon pool.
    pub fn new(surfaces: &Surfaces, ranks: usize) -> Survey {
        let count = solid_ids(surfaces).count();
        let Some((low, high)) = surfaces.bounds().filter(|_| count > 0) else {
            return Survey::default();
        };
        let fewest = FEWEST.max(FEWEST_PER_RANK * ranks as f64);
        let voxels = (DENSITY * count as f64).clamp(FEWEST, MOST).max(fewest.min(8.0 * MOST));
        let lattice = Lattice::over(low.to_array(), high.to_array(), voxels);
        let occupied: Vec<AtomicU64> = (0..lattice.blocks()).map(|_| AtomicU64::new(0)).collect();
        let entries: Vec<AtomicU32> = (0..lattice.blocks()).map(|_| AtomicU32::new(0)).collect();
        solid_ids(surfaces).for_each(|id| {
            lattice.each_block(surfaces, id, |block, bits| {
                occupied[block].fetch_or(bits, Ordering::Relaxed);
                entries[block].fetch_add(1, Ordering::Relaxed);
            });
        });
        Survey {
            lattice,
            occupied: occupied.into_iter().map(AtomicU64::into_inner).collect(),
            entries: entries.into_iter().map(AtomicU32::into_inner).collect(),
        }
    }

    /// Where a ray first comes to something: its block, and the middle of the voxel.
    pub fn first(&self, ray: &Ray) -> Option<(usize, DVec3)> {
        let mut first = None;
        if self.lattice.serves(ray.origin.to_array()) {
            let occupied = |block: usize| self.occupied[block];
            self.lattice.walk(&Prepared::new(ray), occupied, |cell, block| {
                let Lattice { low, size, .. } = self.lattice;
                let middle = DVec3::from(cell.map(f64::from)) + 0.5;
                first = Some((block, DVec3::from(low) + middle * DVec3::from(size)));
                None
            });
        }
        first
    }

    /// Gives each block with something in it to one of `ranks`: runs along a Morton curve of about equal weight, which is that of the primitives and of the `looks`, rays that
    /// tell which blocks are looked at. The blocks `hot` go to all ranks.
    pub fn divide(&self, ranks: usize, looks: &[Ray], hot: &[usize]) -> Voxels {
        let mut voxels = Voxels {
            lattice: self.lattice,
            occupied: self.occupied.clone(),
            owners: vec![NOBODY; self.occupied.len()],
        };
        let mut visits = vec![0u32; self.occupied.len()];
        // A ray is shaded, and shadow rays begin, where it first comes to something.
        looks.iter().filter_map(|ray| self.first(ray)).for_each(|(block, _)| visits[block] += 1);
        // What all have weighs on all alike.
        let mut entries = self.entries.clone();
        for &block in hot {
            voxels.owners[block] = EVERYBODY;
            (entries[block], visits[block]) = (0, 0);
        }
        let sum = |counts: &[u32]| counts.iter().map(|&count| f64::from(count)).sum::<f64>().max(1.0);
        let (all_entries, all_visits) = (sum(&entries), sum(&visits));
        let share = if visits.iter().any(|&count| count > 0) { RAYS_SHARE } else { 0.0 };
        let weight = |block: usize| {
            (1.0 - share) * f64::from(entries[block]) / all_entries
                + share * f64::from(visits[block]) / all_visits
        };
        let is_owned = |block: &usize| self.occupied[*block] != 0 && voxels.owners[*block] == NOBODY;
        let mut blocks: Vec<usize> = (0..self.occupied.len()).filter(is_owned).collect();
        blocks.sort_by_key(|&block| morton(self.lattice.block_place(block)));
        let mut before = 0.0;
        for block in blocks {
            // The rank in whose share the block's middle lies.
            let middle = before + 0.5 * weight(block);
            voxels.owners[block] = ((middle * ranks as f64) as u32).min(ranks as u32 - 1);
            before += weight(block);
        }
        voxels
    }
}

impl Voxels {
    /// How many primitives each rank has. On the current rayon pool.
    pub fn counts(&self, surfaces: &Surfaces, ranks: usize) -> Vec<u64> {
        // The last count is of what all have.
        let none = || (vec![0; ranks + 1], vec![u32::MAX; ranks]);
        if self.owners.is_empty() {
            return vec![0; ranks];
        }
        let replicates = self.owners.contains(&EVERYBODY);
        let counted = solid_ids(surfaces).fold(none, |(mut counts, mut last), id| {
            if replicates && self.reaches(surfaces, id, |owner| owner == EVERYBODY) {
                counts[ranks] += 1;
                return (counts, last);
            }
            self.lattice.each_block(surfaces, id, |block, _| {
                // Each primitive once, in however many blocks it is.
                let owner = self.owners[block] as usize;
                counts[owner] += u64::from(std::mem::replace(&mut last[owner], id) != id);
            });
            (counts, last)
        });
        let sum = |a: Vec<u64>, b: Vec<u64>| a.iter().zip(&b).map(|(a, b)| a + b).collect();
        let mut counts: Vec<u64> = counted.map(|(counts, _)| counts).reduce(|| none().0, sum);
        let all = counts.pop().unwrap_or_default();
        counts.into_iter().map(|own| own + all).collect()
    }

    /// The primitives, ascending, of one rank: all that reach into voxels of its blocks and of those that all have. On the current rayon pool.
    pub fn part(&self, surfaces: &Surfaces, rank: usize) -> Vec<u32> {
        if self.owners.is_empty() {
            return Vec::new();
        }
        let is_held = |owner| owner == rank as u32 || owner == EVERYBODY;
        solid_ids(surfaces).filter(|&id| self.reaches(surfaces, id, is_held)).collect()
    }

    /// How many primitives of its part a rank has only because all have them. On the current rayon pool.
    pub fn copies(&self, part: &Surfaces, rank: usize) -> u64 {
        if !self.owners.contains(&EVERYBODY) {
            return 0;
        }
        let is_own = |owner| owner == rank as u32;
        solid_ids(part).filter(|&id| !self.reaches(part, id, is_own)).count() as u64
    }

    /// Whether a primitive reaches into a block of such an owner.
    fn reaches(&self, surfaces: &Surfaces, id: u32, is_meant: impl Fn(u32) -> bool) -> bool {
        let mut reaches = false;
        self.lattice.each_block(surfaces, id, |block, _| reaches |= is_meant(self.owners[block]));
        reaches
    }
}

/// All primitives that can be hit, along a Morton curve (Morton 1966) through their middles. On the current rayon pool.
pub fn along_curve(surfaces: &Surfaces) -> Vec<u32> {
    let ids = solid(surfaces);
    let Some((low, high)) = bounds(surfaces, &ids) else { return Vec::new() };
    let per_length = PLACES / (high - low).max_element();
    let mut along: Vec<(u64, u32)> = ids
        .into_par_iter()
        .map(|id| {
            let balls = surfaces.balls(id);
            let place = std::array::from_fn(|axis| {
                let middle = (balls[0].0[axis] + balls[1].0[axis] + balls[2].0[axis]) / 3.0;
                ((middle - low[axis]) * per_length) as u32
            });
            (morton(place), id)
        })
        .collect();
    along.par_sort_unstable();
    along.into_iter().map(|(_, id)| id).collect()
}

/// Part `part` of `parts` equal ones of primitives along a curve, in ascending order.
pub fn run_of(along: &[u32], parts: usize, part: usize) -> Vec<u32> {
    let mut ids = along[along.len() * part / parts..along.len() * (part + 1) / parts].to_vec();
    ids.par_sort_unstable();
    ids
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::terrain::Terrain;

    fn surfaces() -> Surfaces {
        let terrain = Terrain { cells: 60, ..Terrain::default() };
        let cells = (0..60).flat_map(|j| (0..60).map(move |i| (i, j)));
        Surfaces {
            positions: (0..61 * 61).map(|place| terrain.vertex(place % 61, place / 61).position).collect(),
            triangles: cells.flat_map(|(i, j)| terrain.cell(i, j)).collect(),
            ..Surfaces::default()
        }
    }

    #[test]
    fn parts_cover_everything_and_are_about_equal() {
        let surfaces = surfaces();
        for ranks in [1, 2, 3, 8] {
            let voxels = Survey::new(&surfaces, ranks).divide(ranks, &[], &[]);
            let parts: Vec<_> = (0..ranks).map(|rank| voxels.part(&surfaces, rank)).collect();
            let mut all: Vec<u32> = parts.concat();
            all.sort_unstable();
            let entries = all.len();
            all.dedup();
            assert_eq!(all, (0..surfaces.len() as u32).collect::<Vec<_>>());
            assert!((entries as f64) < 1.4 * all.len() as f64, "{entries} entries of {}", all.len());
            let fair = entries as f64 / ranks as f64;
            for part in &parts {
                assert!(part.is_sorted() && (0.7 * fair..1.4 * fair).contains(&(part.len() as f64)));
            }
        }
    }

    #[test]
    fn equal_numbers_are_equal() {
        let surfaces = surfaces();
        let along = along_curve(&surfaces);
        let parts: Vec<_> = (0..7).map(|part| run_of(&along, 7, part)).collect();
        assert!(parts.iter().all(|part| part.is_sorted() && part.len().abs_diff(7200 / 7) <= 1));
        let mut all = parts.concat();
        all.sort_unstable();
        assert_eq!(all, (0..7200).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_is_nobodys() {
        let survey = Survey::new(&Surfaces::default(), 3);
        assert!(survey.divide(3, &[], &[]).part(&Surfaces::default(), 1).is_empty());
        assert!(run_of(&along_curve(&Surfaces::default()), 2, 1).is_empty());
    }
}
