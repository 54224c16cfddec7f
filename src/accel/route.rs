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

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::accel::Accel;
    use crate::accel::partition::Survey;
    use crate::geometry::NONE;
    use crate::scene::Surfaces;
    use crate::scene::mesh::Sphere;

    /// All ranks that a ray asks.
    fn asked(route: &Route, ray: &Ray, t_best: f64, ranks: usize, home: u32) -> Vec<usize> {
        let mut all = Vec::new();
        while let Some(rank) = route.next(ray, t_best, ranks, Progress { home, hops: all.len() as u32 }) {
            all.push(rank);
        }
        all
    }

    fn surfaces() -> impl Strategy<Value = Surfaces> {
        let point =
            || prop::array::uniform3(prop_oneof![(-4i8..=4).prop_map(|c| f32::from(c) / 4.0), -1.0f32..1.0]);
        let sphere = (point(), 0.01f32..0.4).prop_map(|(center, radius)| Sphere { center, radius });
        let triangle = (point(), point(), point(), 0.05f32..1.0).prop_map(|(a, b, c, size)| {
            let towards = |p: [f32; 3]| std::array::from_fn(|axis| a[axis] + size * (p[axis] - a[axis]));
            [a, towards(b), towards(c)]
        });
        (prop::collection::vec(triangle, 0..200), prop::collection::vec(sphere, 0..10)).prop_map(
            |(triangles, spheres)| Surfaces {
                positions: triangles.concat().into(),
                triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
                spheres: spheres.into(),
                ..Surfaces::default()
            },
        )
    }

    fn direction() -> impl Strategy<Value = [f64; 3]> {
        let component = prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-0.5), Just(1e-310), -1.0f64..1.0];
        prop::array::uniform3(component).prop_filter("a direction", |d| d.iter().any(|c| c.abs() > 1e-3))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn every_hit_is_held_by_a_rank_that_is_asked_for_it(
            surfaces in surfaces(),
            ranks in prop_oneof![1usize..6, Just(70)],
            origins in prop::collection::vec(prop::array::uniform3(-2.0f64..2.0), 6),
            directions in prop::collection::vec(direction(), 6),
            far in prop_oneof![Just(1.0), Just(1e3), Just(1e9)],
        ) {
            let voxels = Survey::new(&surfaces, ranks).divide(ranks, &[]);
            let parts: Vec<Vec<u32>> = (0..ranks).map(|rank| voxels.part(&surfaces, rank)).collect();
            let route = Route::Voxels(voxels);
            for (origin, direction) in origins.iter().zip(&directions) {
                let (inside, along) = (DVec3::from(*origin), DVec3::from(*direction));
                let from = if far > 1.0 { inside - along * far } else { inside };
                let mut ray = Ray {
                    origin: from, direction: along, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
                };
                let all = asked(&route, &ray, f64::INFINITY, ranks, 0);
                let mut once = all.clone();
                once.sort_unstable();
                once.dedup();
                prop_assert_eq!(once.len(), all.len(), "a rank is asked twice");
                // Every surface along the way, one after the other.
                loop {
                    let hit = Accel::Brute.closest(&surfaces, &ray);
                    if !hit.is_hit() {
                        break;
                    }
                    let before = asked(&route, &ray, hit.t, ranks, 0);
                    let held = |&rank: &usize| parts[rank].binary_search(&hit.primitive).is_ok();
                    prop_assert!(before.iter().any(held), "{hit:?} of {ray:?}: asked {before:?}");
                    prop_assert!(asked(&route, &ray, f64::INFINITY, ranks, 0).starts_with(&before));
                    (ray.t_min, ray.first_id) = (hit.t, hit.primitive + 1);
                }
            }
        }
    }

    #[test]
    fn where_all_are_asked_the_own_rank_is_first() {
        let ray = Ray {
            origin: DVec3::ZERO,
            direction: DVec3::X,
            t_min: 0.0,
            t_max: 1.0,
            first_id: 0,
            start: NONE,
        };
        assert_eq!(asked(&Route::All, &ray, f64::INFINITY, 4, 2), [2, 3, 0, 1]);
        assert!(asked(&Route::Voxels(Voxels::default()), &ray, f64::INFINITY, 4, 2).is_empty());
    }
}
