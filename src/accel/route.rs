//! Which rank a ray asks next where each has a part of the scene: by place, as the ray comes through the parts, or all in turn.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use super::lattice::Lattice;
use crate::geometry::{Prepared, Ray};

/// A block that has nothing, in [`Voxels::owners`].
pub const NOBODY: u32 = u32::MAX;

/// The space of a scene in voxels, and whose they are: what every rank knows of all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Voxels {
    pub lattice: Lattice,
    /// Of each block of voxels the bits of those that hold something.
    pub occupied: Vec<u64>,
    /// Of each block the rank that holds all that reaches into its voxels, or [`NOBODY`].
    pub owners: Vec<u32>,
}

/// How rays find the parts of a scene that they may meet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Route {
    /// By place: a ray visits the owners of the occupied voxels that it comes through, each once, in the order in which it first comes to them.
    Voxels(Voxels),
    /// Every ray asks every rank, its own first.
    All,
}

/// How far a ray has come on its route.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Progress {
    /// The rank that made it.
    pub home: u32,
    /// Ranks that it has asked.
    pub hops: u32,
}

impl Route {
    /// The rank, one of `ranks`, that a ray asks next, if one is left whose part may have a hit at up to `t_best`, in units of the ray's direction.
    ///
    /// The ranks before are the same for any `t_best`: a nearer one only ends the route sooner.
    pub fn next(&self, ray: &Ray, t_best: f64, ranks: usize, progress: Progress) -> Option<usize> {
        let hops = progress.hops as usize;
        let in_turn = || Some((progress.home as usize + hops) % ranks);
        match self {
            _ if hops >= ranks => None,
            Route::All => in_turn(),
            Route::Voxels(voxels) if voxels.owners.is_empty() => None,
            Route::Voxels(voxels) if !voxels.lattice.serves(ray.origin.to_array()) => in_turn(),
            Route::Voxels(voxels) => {
                voxels.owner_after(hops, &Ray { t_max: ray.t_max.min(t_best), ..*ray }, ranks)
            }
        }
    }
}

impl Voxels {
    /// The owner that the ray comes to after `hops` others.
    fn owner_after(&self, hops: usize, ray: &Ray, ranks: usize) -> Option<usize> {
        let prepared = Prepared::new(ray);
        let mut seen = Seen::new(ranks);
        let (mut last, mut count, mut found) = (NOBODY, 0, None);
        self.lattice.walk(&self.occupied, &prepared, |_, block| {
            let owner = self.owners[block];
            if owner != last && seen.insert(owner) {
                last = owner;
                if count == hops {
                    found = Some(owner as usize);
                    return None;
                }
                count += 1;
            }
            Some(prepared.t_max)
        });
        found
    }
}

/// A set of ranks, without any allocation for few.
struct Seen {
    few: u64,
    more: Vec<u64>,
}

impl Seen {
    fn new(ranks: usize) -> Self {
        Seen { few: 0, more: if ranks > 64 { vec![0; ranks.div_ceil(64)] } else { Vec::new() } }
    }

    /// Whether it wasn't there before.
    fn insert(&mut self, rank: u32) -> bool {
        let word = match self.more.is_empty() {
            true => &mut self.few,
            false => &mut self.more[rank as usize / 64],
        };
        let bit = 1 << (rank % 64);
        let is_new = *word & bit == 0;
        *word |= bit;
        is_new
    }
}
