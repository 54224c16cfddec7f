//! The primitives divided among threads: a structure over each part, and every ray is put to all of them at once. What they say is reduced to the least (t, primitive id).
//!
//! The parts are equal runs along a Morton curve (Morton 1966), so that each is a small box of the scene.

use rayon::prelude::*;

use super::grid::Grid;
use super::partition::{along_curve, run_of};
use super::spheres::Spheres;
use super::tester::Tester;
use super::wide::Wide;
use super::{Accel, brute, extent, solid};
use crate::geometry::Ray;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::Surfaces;
use crate::settings::{AccelKind, BuildSettings};

/// Bytes for each primitive while the parts are made, beside what building their structures takes.
pub const BYTES_TO_DIVIDE: u64 = 24;

/// Structures over parts of the primitives.
#[derive(Clone, Debug)]
pub struct Divided {
    pub kind: AccelKind,
    parts: Vec<Part>,
}

/// One of them.
#[derive(Clone, Debug)]
struct Part {
    accel: Accel,
    /// What brute force tests; empty for other structures.
    ids: Vec<u32>,
}

impl Divided {
    /// Divides all primitives but triangles without area into `parts`, fewer if there are fewer primitives. On the current rayon pool.
    pub fn build(kind: AccelKind, build: BuildSettings, surfaces: &Surfaces, parts: usize) -> Divided {
        // Rays start on what is in other parts, too.
        let starts_extent = extent(surfaces, &solid(surfaces));
        let runs = runs(surfaces, parts);
        let part = |ids| Part::build(kind, build, surfaces, ids, starts_extent);
        let parts = runs.into_iter().map(part).collect();
        Divided { kind, parts }
    }

    /// Bytes of all structures.
    pub fn memory(&self) -> usize {
        self.parts.iter().map(|part| part.accel.memory() + size_of_val(&*part.ids)).sum()
    }

    /// The least (t, primitive id), or with `any` whether there is one.
    pub(super) fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        let answers = self.parts.iter().map(|part| part.answer(surfaces, ray, any));
        answers.fold(Answer::MISS, |a, b| least(surfaces, ray, any, a, b))
    }

    /// As [`Accel::trace`]. On the current rayon pool, a task for each part.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        let reduced =
            self.parts.par_iter().with_max_len(1).map(|part| part.trace(surfaces, records)).reduce_with(
                |mut all, more| {
                    for ((a, b), record) in all.iter_mut().zip(more).zip(records) {
                        *a = least(surfaces, &record.ray(), record.query() == Query::Occluded, *a, b);
                    }
                    all
                },
            );
        *answers = reduced.unwrap_or_else(|| vec![Answer::MISS; records.len()]);
    }
}

impl Part {
    fn build(
        kind: AccelKind,
        build: BuildSettings,
        surfaces: &Surfaces,
        ids: Vec<u32>,
        starts_extent: f64,
    ) -> Part {
        let accel = match kind {
            AccelKind::Bvh => {
                Accel::Bvh(Wide { starts_extent, ..Wide::build_over(surfaces, &ids, build.preset) })
            }
            AccelKind::Grid => {
                Accel::Grid(Grid { starts_extent, ..Grid::build_over(surfaces, &ids, build.grid_density) })
            }
            AccelKind::Spheres => Accel::Spheres(Spheres::build_over(surfaces, &ids)),
            AccelKind::Brute => return Part { accel: Accel::Brute, ids },
        };
        Part { accel, ids: Vec::new() }
    }

    fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        match &self.accel {
            Accel::Brute => brute::answer(surfaces, self.ids.iter().copied(), ray, any),
            accel => accel.single(surfaces, ray, any),
        }
    }

    fn trace(&self, surfaces: &Surfaces, records: &[RayRecord]) -> Vec<Answer> {
        let mut answers = Vec::with_capacity(records.len());
        match &self.accel {
            Accel::Brute => answers.extend(
                records
                    .iter()
                    .map(|record| self.answer(surfaces, &record.ray(), record.query() == Query::Occluded)),
            ),
            accel => accel.trace(surfaces, records, &mut answers),
        }
        answers
    }
}

/// The one of two parts' answers to a ray that counts.
fn least(surfaces: &Surfaces, ray: &Ray, any: bool, a: Answer, b: Answer) -> Answer {
    if !b.is_hit() || (any && a.is_hit()) {
        return a;
    }
    if !a.is_hit() || any {
        return b;
    }
    // Hits are ordered by t in units of the scaled direction; a power of two keeps the order, but for what it drives out of f64's range.
    if a.t.is_normal() && b.t.is_normal() {
        return if (a.t, a.primitive) < (b.t, b.primitive) { a } else { b };
    }
    let mut tester = Tester::new(surfaces, ray);
    tester.test(a.primitive);
    tester.test(b.primitive);
    tester.verdict(false)
}

/// The primitives as equal runs along a curve, each in ascending order; at most one for each primitive.
fn runs(surfaces: &Surfaces, parts: usize) -> Vec<Vec<u32>> {
    let along = along_curve(surfaces);
    let parts = parts.max(1).min(along.len());
    (0..parts).map(|part| run_of(&along, parts, part)).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::NONE;
    use crate::scene::mesh::Sphere;

    /// Spheres along a line, the last one without neighbours.
    fn row() -> Surfaces {
        let at = |x: f32| Sphere { center: [x, 0.0, 0.0], radius: 0.25 };
        Surfaces { spheres: (0..7).map(|k| at(k as f32)).chain([at(100.0)]).collect(), ..Surfaces::default() }
    }

    #[test]
    fn parts_are_equal_and_hold_neighbours() {
        assert_eq!(runs(&row(), 2), [vec![0, 1, 2, 3], vec![4, 5, 6, 7]]);
        assert_eq!(runs(&row(), 3).iter().map(Vec::len).collect::<Vec<_>>(), [2, 3, 3]);
        assert_eq!(runs(&row(), 100).len(), 8);
        assert!(runs(&Surfaces::default(), 4).is_empty());
        // A sphere and another in the same place, and triangles without area, which are in no part.
        let mut surfaces = row();
        surfaces.spheres[1] = surfaces.spheres[0];
        surfaces.positions = vec![[0.0; 3], [1.0; 3], [2.0; 3]].into();
        surfaces.triangles = vec![[0, 1, 2]].into();
        let mut all = runs(&surfaces, 3).concat();
        all.sort_unstable();
        assert_eq!(all, (1..9).collect::<Vec<_>>());
    }

    #[test]
    fn the_least_counts_even_out_of_range() {
        let surfaces = row();
        let ray = |direction: DVec3| Ray {
            origin: DVec3::new(-1000.0, 0.0, 0.0),
            direction,
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        // In so small a unit t overflows for all of them.
        for direction in [DVec3::X, DVec3::X * 1e-307] {
            for kind in [AccelKind::Bvh, AccelKind::Grid, AccelKind::Spheres, AccelKind::Brute] {
                let divided = Divided::build(kind, BuildSettings::default(), &surfaces, 3);
                let found = divided.answer(&surfaces, &ray(direction), false);
                assert_eq!((found.primitive, found.t.is_finite()), (0, direction == DVec3::X), "{kind:?}");
                let other = Answer { primitive: 3, ..Accel::Brute.closest(&surfaces, &ray(direction)) };
                assert_eq!(least(&surfaces, &ray(direction), false, other, found), found);
                assert_eq!(least(&surfaces, &ray(direction), false, found, other), found);
            }
        }
    }
}
