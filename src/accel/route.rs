//! Which rank a ray asks next where each has a part of the scene: by place, as the ray comes through the parts, or all in turn.

use std::cell::Cell;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use super::owners::{MOST_RANKS, OwnerTree, set_of};
use super::voxels::{EVERYBODY, Voxels};
use crate::geometry::{Prepared, Ray};

/// How rays find the parts of a scene that they may meet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Route {
    /// By place: a ray asks the rank that made it, and then the owners of the occupied voxels that it comes through, each once, in the order in which it first comes to them. The
    /// first of all answers for what all have.
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
    /// Which, of the first [`MOST_RANKS`], as a set of owners.
    asked: u64,
}

impl Progress {
    /// Of a ray that a rank has just made.
    pub fn new(home: usize) -> Self {
        Progress { home: home as u32, ..Progress::default() }
    }

    /// Notes that it has asked a rank.
    pub fn ask(&mut self, rank: usize) {
        self.hops += 1;
        self.asked |= if rank < MOST_RANKS { set_of(rank) } else { 0 };
    }
}

/// What one of the ranks knows of the way on.
#[derive(Debug)]
pub struct Guide<'a> {
    route: &'a Route,
    ranks: usize,
    /// Of blocks that others own, where ranks are so few that a ray carries along whom it has asked; of more that is found out anew from where it began.
    others: Option<OwnerTree>,
}

impl<'a> Guide<'a> {
    pub fn new(route: &'a Route, rank: usize, ranks: usize) -> Self {
        let others = match route {
            Route::Voxels(voxels) if ranks <= MOST_RANKS => {
                Some(OwnerTree::new(voxels, |owner| owner < EVERYBODY && owner != rank as u32))
            }
            _ => None,
        };
        Guide { route, ranks, others }
    }

    /// The rank that a ray asks next, if one is left whose part may have a hit at up to `t_best`, in units of the ray's direction. The ray is new, or has asked this rank last.
    ///
    /// The ranks before are the same for any `t_best`, but for those that a ray hardly touches: a nearer one only ends the route sooner.
    pub fn next(&self, ray: &Ray, t_best: f64, progress: &Progress) -> Option<usize> {
        let hops = progress.hops as usize;
        let in_turn = || Some((progress.home as usize + hops) % self.ranks);
        match self.route {
            _ if hops >= self.ranks => None,
            Route::All => in_turn(),
            Route::Voxels(voxels) if voxels.owners.is_empty() => None,
            // Home knows at least what is beside the start, and what all have.
            Route::Voxels(_) if hops == 0 => in_turn(),
            Route::Voxels(voxels) if !voxels.lattice.serves(ray.origin.to_array()) => in_turn(),
            Route::Voxels(voxels) => match &self.others {
                Some(others) => {
                    let block = others.nearest(voxels, ray, t_best, !progress.asked);
                    block.map(|block| voxels.owners[block] as usize)
                }
                None => {
                    let ray = Prepared::new(&Ray { t_max: ray.t_max.min(t_best), ..*ray });
                    voxels.owner_after(progress, &ray, self.ranks)
                }
            },
        }
    }
}

impl Voxels {
    /// The owner that a ray comes to after so many others, the first of which was its home.
    fn owner_after(&self, progress: &Progress, ray: &Prepared, ranks: usize) -> Option<usize> {
        let seen = Seen::new(ranks);
        seen.insert(progress.home);
        let mut found = None;
        // Once an owner is counted its other blocks are as good as empty.
        let others = |block: usize| match self.owners[block] {
            EVERYBODY => 0,
            owner if seen.holds(owner) => 0,
            _ => self.occupied[block],
        };
        self.lattice.walk(ray, others, |_, block| {
            if seen.insert(self.owners[block]) == progress.hops {
                found = Some(self.owners[block] as usize);
                return None;
            }
            Some(ray.t_max)
        });
        found
    }
}

/// A set of ranks.
struct Seen {
    words: Vec<Cell<u64>>,
    count: Cell<u32>,
}

impl Seen {
    fn new(ranks: usize) -> Self {
        Seen { words: vec![Cell::new(0); ranks.div_ceil(64)], count: Cell::new(0) }
    }

    #[inline]
    fn holds(&self, rank: u32) -> bool {
        rank < EVERYBODY && self.words[rank as usize / 64].get() >> (rank % 64) & 1 == 1
    }

    /// Adds a rank that isn't there yet; how many there were.
    fn insert(&self, rank: u32) -> u32 {
        let word = &self.words[rank as usize / 64];
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

    /// What each of so many ranks knows.
    fn guides(route: &Route, ranks: usize) -> Vec<Guide<'_>> {
        (0..ranks).map(|rank| Guide::new(route, rank, ranks)).collect()
    }

    /// All ranks that a ray asks.
    fn asked(guides: &[Guide], ray: &Ray, t_best: f64, home: usize) -> Vec<usize> {
        let mut progress = Progress::new(home);
        let (mut all, mut at) = (Vec::new(), home);
        while let Some(rank) = guides[at].next(ray, t_best, &progress) {
            progress.ask(rank);
            all.push(rank);
            at = rank;
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
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn every_hit_is_held_by_a_rank_that_is_asked_for_it(
            surfaces in surfaces(),
            ranks in prop_oneof![4 => 1usize..6, 1 => Just(70)],
            origins in prop::collection::vec(prop::array::uniform3(-2.0f64..2.0), 6),
            directions in prop::collection::vec(direction(), 6),
            far in prop_oneof![Just(1.0), Just(1e3), Just(1e9)],
            copies in prop_oneof![Just(0u64), 1u64..500, Just(u64::MAX)],
            home in 0usize..70,
        ) {
            let survey = Survey::new(&surfaces, ranks);
            let hot = survey.hottest(&vec![1.0; survey.occupied.len()], copies);
            let voxels = survey.divide(ranks, &[], &hot);
            let home = home % ranks;
            let parts: Vec<Vec<u32>> = (0..ranks).map(|rank| voxels.part(&surfaces, rank)).collect();
            let route = Route::Voxels(voxels);
            let guides = guides(&route, ranks);
            for (origin, direction) in origins.iter().zip(&directions) {
                let (inside, along) = (DVec3::from(*origin), DVec3::from(*direction));
                let from = if far > 1.0 { inside - along * far } else { inside };
                let mut ray = Ray {
                    origin: from, direction: along, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
                };
                let all = asked(&guides, &ray, f64::INFINITY, home);
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
                    let before = asked(&guides, &ray, hit.t, home);
                    let held = |&rank: &usize| parts[rank].binary_search(&hit.primitive).is_ok();
                    prop_assert!(before.iter().any(held), "{hit:?} of {ray:?}: asked {before:?}");
                    let all = asked(&guides, &ray, f64::INFINITY, home);
                    prop_assert!(all.starts_with(&before));
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
        let asked =
            |hot: &[usize], ray: &Ray, home: usize| asked(&guides(&route(hot), 3), ray, f64::INFINITY, home);
        let (forth, back) = (along(DVec3::X, -1.0), along(-DVec3::X, 6.0));
        assert_eq!(asked(&[], &forth, 1), [1, 0, 2]);
        let heat = survey.heat(&[along(DVec3::Y, 0.0)]);
        let first = survey.hottest(&heat, u64::MAX);
        assert_eq!(first.len(), 1);
        for home in 0..3 {
            // The rank that made it is asked first, and as an owner not again.
            let (mut there, mut again) = (vec![home], vec![home]);
            there.extend((0..3).filter(|&rank| rank != home));
            again.extend((0..3).rev().filter(|&rank| rank != home));
            assert_eq!(asked(&first, &forth, home), there);
            assert_eq!(asked(&first, &back, home), again);
            let all = survey.hottest(&vec![1.0; survey.occupied.len()], u64::MAX);
            assert_eq!(asked(&all, &forth, home), [home]);
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
        assert_eq!(asked(&guides(&Route::All, 4), &ray, f64::INFINITY, 2), [2, 3, 0, 1]);
        assert!(asked(&guides(&Route::Voxels(Voxels::default()), 4), &ray, f64::INFINITY, 2).is_empty());
    }
}
