//! Which rank a ray asks next where each has a part of the scene: by place, as the ray comes through the parts, or all in turn.

use std::cell::Cell;

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
        let seen = Seen::new(ranks);
        let mut found = None;
        // Once an owner is counted its other blocks are as good as empty.
        let others = |block: usize| if seen.holds(self.owners[block]) { 0 } else { self.occupied[block] };
        self.lattice.walk(&prepared, others, |_, block| {
            if seen.insert(self.owners[block]) == hops {
                found = Some(self.owners[block] as usize);
                return None;
            }
            Some(prepared.t_max)
        });
        found
    }
}

/// A set of ranks, without any allocation for few.
struct Seen {
    few: Cell<u64>,
    more: Vec<Cell<u64>>,
    count: Cell<usize>,
}

impl Seen {
    fn new(ranks: usize) -> Self {
        let more = if ranks > 64 { vec![Cell::new(0); ranks.div_ceil(64)] } else { Vec::new() };
        Seen { few: Cell::new(0), more, count: Cell::new(0) }
    }

    fn word(&self, rank: u32) -> &Cell<u64> {
        if self.more.is_empty() { &self.few } else { &self.more[rank as usize / 64] }
    }

    #[inline]
    fn holds(&self, rank: u32) -> bool {
        rank != NOBODY && self.word(rank).get() >> (rank % 64) & 1 == 1
    }

    /// Adds a rank that isn't there yet; how many there were.
    fn insert(&self, rank: u32) -> usize {
        let word = self.word(rank);
        word.set(word.get() | 1 << (rank % 64));
        self.count.replace(self.count.get() + 1)
    }
}
