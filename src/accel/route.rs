//! Which rank a ray asks next where each has a part of the scene: by place, as the ray comes through the parts, or all in turn.

use std::cell::Cell;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use super::lattice::Lattice;
use crate::geometry::{Prepared, Ray};

/// A block that has nothing, in [`Voxels::owners`].
pub const NOBODY: u32 = u32::MAX;
/// A block that every rank has, in [`Voxels::owners`].
pub const EVERYBODY: u32 = u32::MAX - 1;

/// The space of a scene in voxels, and whose they are: what every rank knows of all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Voxels {
    pub lattice: Lattice,
    /// Of each block of voxels the bits of those that hold something.
    pub occupied: Vec<u64>,
    /// Of each block the rank that holds all that reaches into its voxels, [`NOBODY`] or [`EVERYBODY`].
    pub owners: Vec<u32>,
    /// Ranks that have blocks of their own.
    pub owning: u32,
}

/// How rays find the parts of a scene that they may meet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Route {
    /// By place: a ray visits the owners of the occupied voxels that it comes through, each once, in the order in which it first comes to them. Any of them
    /// answers for what all have; where a ray comes to that first, the rank that made it does.
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
                voxels.owner_after(progress, &Ray { t_max: ray.t_max.min(t_best), ..*ray }, ranks)
            }
        }
    }
}

impl Voxels {
    /// The owner that the ray comes to after so many others.
    fn owner_after(&self, Progress { home, hops }: Progress, ray: &Ray, ranks: usize) -> Option<usize> {
        // The first may have been one without blocks of its own.
        if hops > self.owning {
            return None;
        }
        let prepared = Prepared::new(ray);
        let seen = Seen::new(ranks);
        let mut found = None;
        // Once an owner is counted its other blocks are as good as empty, and with the first those that all have.
        let others = |block: usize| match self.owners[block] {
            EVERYBODY if !seen.is_empty() => 0,
            owner if seen.holds(owner) => 0,
            _ => self.occupied[block],
        };
        self.lattice.walk(&prepared, others, |_, block| {
            let owner = if self.owners[block] == EVERYBODY { home } else { self.owners[block] };
            if seen.insert(owner) == hops {
                found = Some(owner as usize);
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
    count: Cell<u32>,
}

impl Seen {
    fn new(ranks: usize) -> Self {
        let more = if ranks > 64 { vec![Cell::new(0); ranks.div_ceil(64)] } else { Vec::new() };
        Seen { few: Cell::new(0), more, count: Cell::new(0) }
    }

    #[inline]
    fn is_empty(&self) -> bool {
        self.count.get() == 0
    }

    fn word(&self, rank: u32) -> &Cell<u64> {
        if self.more.is_empty() { &self.few } else { &self.more[rank as usize / 64] }
    }

    #[inline]
    fn holds(&self, rank: u32) -> bool {
        rank < EVERYBODY && self.word(rank).get() >> (rank % 64) & 1 == 1
    }

    /// Adds a rank that isn't there yet; how many there were.
    fn insert(&self, rank: u32) -> u32 {
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
            copies in prop_oneof![Just(0u64), 1u64..500, Just(u64::MAX)],
            home in 0u32..70,
        ) {
            let survey = Survey::new(&surfaces, ranks);
            let hot = survey.hottest(&vec![1.0; survey.occupied.len()], copies);
            let voxels = survey.divide(ranks, &[], &hot);
            let home = home % ranks as u32;
            let parts: Vec<Vec<u32>> = (0..ranks).map(|rank| voxels.part(&surfaces, rank)).collect();
            let route = Route::Voxels(voxels);
            for (origin, direction) in origins.iter().zip(&directions) {
                let (inside, along) = (DVec3::from(*origin), DVec3::from(*direction));
                let from = if far > 1.0 { inside - along * far } else { inside };
                let mut ray = Ray {
                    origin: from, direction: along, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
                };
                let all = asked(&route, &ray, f64::INFINITY, ranks, home);
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
                    let before = asked(&route, &ray, hit.t, ranks, home);
                    let held = |&rank: &usize| parts[rank].binary_search(&hit.primitive).is_ok();
                    prop_assert!(before.iter().any(held), "{hit:?} of {ray:?}: asked {before:?}");
                    prop_assert!(asked(&route, &ray, f64::INFINITY, ranks, home).starts_with(&before));
                    (ray.t_min, ray.first_id) = (hit.t, hit.primitive + 1);
                }
            }
        }
    }

    #[test]
    fn what_all_have_is_asked_of_whom_the_ray_is_with() {
        let balls = (0..6).map(|x| Sphere { center: [x as f32, 0.0, 0.0], radius: 1e-4 });
        let surfaces = Surfaces { spheres: balls.collect::<Vec<_>>().into(), ..Surfaces::default() };
        let survey = Survey::new(&surfaces, 3);
        let along = |direction: DVec3, origin: f64| Ray {
            origin: DVec3::new(origin, 0.0, 0.0),
            direction,
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        // Two balls for each rank; what is left of them once the first ball, or all, are everybody's.
        let route = |hot: &[usize]| Route::Voxels(survey.divide(3, &[], hot));
        let asked = |hot: &[usize], ray: &Ray, home: u32| asked(&route(hot), ray, f64::INFINITY, 3, home);
        let (forth, back) = (along(DVec3::X, -1.0), along(-DVec3::X, 6.0));
        assert_eq!(asked(&[], &forth, 1), [0, 1, 2]);
        let heat = survey.heat(&[along(DVec3::Y, 0.0)]);
        let first = survey.hottest(&heat, u64::MAX);
        assert_eq!(first.len(), 1);
        for home in 0..3 {
            // The rank that made it is asked first, and as an owner not again.
            let mut expected: Vec<usize> = vec![home as usize];
            expected.extend((0..3).filter(|&rank| rank != home as usize));
            assert_eq!(asked(&first, &forth, home), expected);
            assert_eq!(asked(&first, &back, home), [2, 1, 0]);
            let all = survey.hottest(&vec![1.0; survey.occupied.len()], u64::MAX);
            assert_eq!(asked(&all, &forth, home), [home as usize]);
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
