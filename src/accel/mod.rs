//! Closest hits and occlusion over the surfaces of a scene. Knows no material, light or rank.

mod brute;
pub mod divided;
pub mod grid;
pub mod hot;
pub mod lattice;
pub mod morton;
pub mod owners;
pub mod partition;
pub mod route;
pub mod spheres;
mod tester;
pub mod voxels;
pub mod wide;

use crate::geometry::Ray;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::Surfaces;
use crate::scene::mesh::has_area;
use crate::settings::{AccelKind, BuildPreset, BuildSettings};
use crate::simd::Level;
use divided::Divided;
use glam::DVec3;
use grid::Grid;
use rayon::prelude::*;
use spheres::Spheres;
use wide::Wide;

/// What answers rays: [`Accel`] in every render, and what experiments put in its place.
pub trait Trace: Sync {
    /// As [`Accel::trace`].
    fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>);
}

impl Trace for Accel {
    fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        Accel::trace(self, surfaces, records, answers);
    }
}

/// The structure that answers rays.
#[derive(Clone, Debug)]
pub enum Accel {
    Bvh(Wide),
    Grid(Grid),
    Spheres(Spheres),
    Brute,
    /// Structures over parts of the primitives.
    Divided(Divided),
}

/// The primitives that rays can meet: all but triangles without area. On the current rayon pool.
fn solid(surfaces: &Surfaces) -> Vec<u32> {
    const CHUNK: usize = 1 << 14;
    let chunk = |first: usize| {
        let ids = first as u32..(first + CHUNK).min(surfaces.len()) as u32;
        ids.filter(|&id| is_solid(surfaces, id)).collect::<Vec<u32>>()
    };
    (0..surfaces.len()).into_par_iter().step_by(CHUNK).map(chunk).collect::<Vec<_>>().concat()
}

fn solid_ids(surfaces: &Surfaces) -> impl ParallelIterator<Item = u32> + '_ {
    (0..surfaces.len() as u32).into_par_iter().filter(|&id| is_solid(surfaces, id))
}

fn is_solid(surfaces: &Surfaces, id: u32) -> bool {
    surfaces.sphere_at(id).is_some() || has_area(&surfaces.triangle(id))
}

/// Lower and upper corner of these primitives, or `None` if there are none. On the current rayon pool.
fn bounds(surfaces: &Surfaces, ids: &[u32]) -> Option<(DVec3, DVec3)> {
    ids.par_iter()
        .flat_map_iter(|&id| surfaces.balls(id))
        .map(|(center, radius)| (DVec3::from(center) - radius, DVec3::from(center) + radius))
        .reduce_with(|(low, high), (l, h)| (low.min(l), high.max(h)))
}

/// The largest magnitude of a coordinate of these primitives.
fn extent(surfaces: &Surfaces, ids: &[u32]) -> f64 {
    bounds(surfaces, ids).map_or(0.0, |(low, high)| low.abs().max(high.abs()).max_element())
}

impl Accel {
    /// Nothing in it: to be filled by what another rank has built.
    pub fn empty(kind: AccelKind) -> Accel {
        match kind {
            AccelKind::Bvh => Accel::Bvh(Wide::default()),
            AccelKind::Grid => Accel::Grid(Grid::default()),
            AccelKind::Spheres => Accel::Spheres(Spheres::default()),
            AccelKind::Brute => Accel::Brute,
        }
    }

    pub fn kind(&self) -> AccelKind {
        match self {
            Accel::Bvh(_) => AccelKind::Bvh,
            Accel::Grid(_) => AccelKind::Grid,
            Accel::Spheres(_) => AccelKind::Spheres,
            Accel::Brute => AccelKind::Brute,
            Accel::Divided(divided) => divided.kind,
        }
    }

    /// Builds the structure of the given kind.
    pub fn build(kind: AccelKind, build: impl Into<BuildSettings>, surfaces: &Surfaces) -> Accel {
        let build = build.into();
        match kind {
            AccelKind::Bvh => Accel::Bvh(Wide::build(surfaces, build.preset)),
            AccelKind::Grid => Accel::Grid(Grid::build(surfaces, build.grid_density)),
            AccelKind::Spheres => Accel::Spheres(Spheres::build(surfaces)),
            AccelKind::Brute => Accel::Brute,
        }
    }

    /// Builds such structures over so many parts of the primitives, which answer each batch of records side by side.
    pub fn divide(
        kind: AccelKind,
        build: impl Into<BuildSettings>,
        surfaces: &Surfaces,
        parts: usize,
    ) -> Accel {
        Accel::Divided(Divided::build(kind, build.into(), surfaces, parts))
    }

    /// Bytes that building the structure takes beside the surfaces, about.
    pub fn memory_to_build(kind: AccelKind, preset: BuildPreset, surfaces: &Surfaces) -> u64 {
        match kind {
            AccelKind::Bvh => surfaces.len() as u64 * wide::bytes_to_build(preset),
            AccelKind::Grid => surfaces.len() as u64 * grid::BYTES_TO_BUILD,
            AccelKind::Spheres => surfaces.len() as u64 * spheres::BYTES_TO_BUILD,
            AccelKind::Brute => 0,
        }
    }

    /// Bytes that a structure holds for each of these primitives, about, on the mean.
    pub fn bytes_each(kind: AccelKind, surfaces: &Surfaces) -> u64 {
        let (triangles, spheres) = (surfaces.triangles.len() as u64, surfaces.spheres.len() as u64);
        match kind {
            AccelKind::Bvh => {
                let all = wide::BYTES * triangles + wide::BYTES_OF_SPHERE * spheres;
                all.div_ceil((triangles + spheres).max(1))
            }
            AccelKind::Grid => grid::BYTES_TO_BUILD,
            AccelKind::Spheres => spheres::BYTES_TO_BUILD,
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
            Accel::Spheres(spheres) => spheres.answer(surfaces, ray, any),
            Accel::Brute => brute::answer(surfaces, 0..surfaces.len() as u32, ray, any),
            Accel::Divided(divided) => divided.answer(surfaces, ray, any),
        }
    }

    /// Answers a batch of records in their order. Of a ray that asks only whether anything is in the way, a hit is primitive 0.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        answers.clear();
        match self {
            Accel::Divided(divided) => divided.trace(surfaces, records, answers),
            Accel::Bvh(wide) => {
                answers.resize(records.len(), Answer::MISS);
                wide.trace(surfaces, records, answers);
            }
            Accel::Grid(grid) => {
                answers.resize(records.len(), Answer::MISS);
                grid.trace(Level::chosen(), surfaces, &records, answers);
            }
            Accel::Spheres(_) | Accel::Brute => answers.extend(
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
            Accel::Spheres(spheres) => spheres.memory(),
            Accel::Brute => 0,
            Accel::Divided(divided) => divided.memory(),
        }
    }
}
