//! Closest hits and occlusion over the surfaces of a scene. Knows no material, light or rank.

mod brute;
pub mod grid;
mod tester;
pub mod wide;

use crate::geometry::Ray;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::Surfaces;
use crate::scene::mesh::has_area;
use crate::settings::{AccelKind, BuildPreset, BuildSettings};
use grid::Grid;
use rayon::prelude::*;
use wide::Wide;
use wide::level::Level;

/// The structure that answers rays.
#[derive(Clone, Debug)]
pub enum Accel {
    Bvh(Wide),
    Grid(Grid),
    Brute,
}

/// The primitives that rays can meet: all but triangles without area. On the current rayon pool.
fn solid(surfaces: &Surfaces) -> Vec<u32> {
    (0..surfaces.len() as u32)
        .into_par_iter()
        .filter(|&id| surfaces.sphere_at(id).is_some() || has_area(&surfaces.triangle(id)))
        .collect()
}

impl Accel {
    /// Nothing in it: to be filled by what another rank has built.
    pub fn empty(kind: AccelKind) -> Accel {
        match kind {
            AccelKind::Bvh => Accel::Bvh(Wide::default()),
            AccelKind::Grid => Accel::Grid(Grid::default()),
            AccelKind::Brute => Accel::Brute,
        }
    }

    pub fn kind(&self) -> AccelKind {
        match self {
            Accel::Bvh(_) => AccelKind::Bvh,
            Accel::Grid(_) => AccelKind::Grid,
            Accel::Brute => AccelKind::Brute,
        }
    }

    /// Builds the structure of the given kind.
    pub fn build(kind: AccelKind, build: impl Into<BuildSettings>, surfaces: &Surfaces) -> Accel {
        let build = build.into();
        match kind {
            AccelKind::Bvh => Accel::Bvh(Wide::build(surfaces, build.preset)),
            AccelKind::Grid => Accel::Grid(Grid::build(surfaces, build.grid_density)),
            AccelKind::Brute => Accel::Brute,
        }
    }

    /// Bytes that building the structure takes beside the surfaces, about.
    pub fn memory_to_build(kind: AccelKind, preset: BuildPreset, surfaces: &Surfaces) -> u64 {
        match kind {
            AccelKind::Bvh => surfaces.len() as u64 * wide::bytes_to_build(preset),
            AccelKind::Grid => surfaces.len() as u64 * grid::BYTES_TO_BUILD,
            AccelKind::Brute => 0,
        }
    }

    /// The least (t, primitive id) that the ray meets.
    pub fn closest(&self, surfaces: &Surfaces, ray: &Ray) -> Answer {
        self.single(surfaces, ray, false)
    }

    /// Whether the ray meets anything.
    pub fn occluded(&self, surfaces: &Surfaces, ray: &Ray) -> bool {
        self.single(surfaces, ray, true).is_hit()
    }

    fn single(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        match self {
            Accel::Bvh(wide) => {
                let mut answer = [Answer::MISS];
                wide.trace_rays(Level::chosen(), surfaces, std::slice::from_ref(ray), any, &mut answer);
                answer[0]
            }
            Accel::Grid(grid) => grid.answer(surfaces, ray, any),
            Accel::Brute => brute::answer(surfaces, ray, any),
        }
    }

    /// Answers a batch of records in their order. Of a ray that asks only whether anything is in the way, a hit is primitive 0.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        answers.clear();
        match self {
            Accel::Bvh(wide) => {
                answers.resize(records.len(), Answer::MISS);
                wide.trace(surfaces, records, answers);
            }
            Accel::Grid(_) | Accel::Brute => answers.extend(
                records
                    .iter()
                    .map(|record| self.single(surfaces, &record.ray(), record.query() == Query::Occluded)),
            ),
        }
    }

    /// Bytes of the structure itself.
    pub fn memory(&self) -> usize {
        match self {
            Accel::Bvh(wide) => wide.memory(),
            Accel::Grid(grid) => grid.memory(),
            Accel::Brute => 0,
        }
    }
}
