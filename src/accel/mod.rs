//! Closest hits and occlusion over the surfaces of a scene. Knows no material, light or rank.

pub mod brute;
pub mod bvh;
mod tester;

use crate::geometry::record::{Answer, Query, RayRecord};
use crate::geometry::{NONE, Prepared, Ray};
use crate::scene::Surfaces;
use crate::settings::AccelKind;
use bvh::Bvh;
use tester::Tester;

/// Most primitives that a structure offers at once, and triangles that the f32 filter judges at once.
pub const LANES: usize = 4;

/// What a structure leads through the primitives near a ray.
pub trait Visitor {
    /// The walk begins; `extent` is the largest magnitude of a coordinate of the primitives.
    fn begin(&mut self, extent: f64);
    fn ray(&self) -> &Prepared;
    /// What lies beyond this t, in units of the scaled direction, isn't wanted.
    fn limit(&self) -> f64;
    /// At most [`LANES`] primitive ids.
    fn visit(&mut self, primitives: &[u32]);
    /// Whether anything has been hit.
    fn found(&self) -> bool;
}

/// The structure that answers rays.
#[derive(Clone, Debug)]
pub enum Accel {
    Bvh(Bvh),
    Brute,
}

impl Accel {
    /// Builds the structure of the given kind.
    pub fn build(kind: AccelKind, surfaces: &Surfaces) -> Accel {
        match kind {
            AccelKind::Bvh => Accel::Bvh(Bvh::build(surfaces)),
            AccelKind::Brute => Accel::Brute,
        }
    }

    /// Bytes that building the structure takes beside the surfaces, about.
    pub fn memory_to_build(kind: AccelKind, surfaces: &Surfaces) -> u64 {
        match kind {
            AccelKind::Bvh => surfaces.len() as u64 * bvh::BYTES_TO_BUILD,
            AccelKind::Brute => 0,
        }
    }

    /// The least (t, primitive id) that the ray meets.
    pub fn closest(&self, surfaces: &Surfaces, ray: &Ray) -> Answer {
        let mut tester = Tester::new(surfaces, ray);
        match self {
            Accel::Bvh(bvh) => bvh.traverse::<false>(&mut tester),
            Accel::Brute => brute::traverse::<false>(&mut tester),
        }
        tester.answer()
    }

    /// Whether the ray meets anything.
    pub fn occluded(&self, surfaces: &Surfaces, ray: &Ray) -> bool {
        let mut tester = Tester::new(surfaces, ray);
        match self {
            Accel::Bvh(bvh) => bvh.traverse::<true>(&mut tester),
            Accel::Brute => brute::traverse::<true>(&mut tester),
        }
        tester.found()
    }

    /// Answers a batch of records in their order.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        answers.clear();
        answers.extend(records.iter().map(|record| match record.query() {
            Query::Closest | Query::Attenuated => self.closest(surfaces, &record.ray()),
            Query::Occluded if self.occluded(surfaces, &record.ray()) => {
                Answer { primitive: 0, ..Answer::MISS }
            }
            Query::Occluded => Answer { primitive: NONE, ..Answer::MISS },
        }));
    }

    /// Bytes of the structure itself.
    pub fn memory(&self) -> usize {
        match self {
            Accel::Bvh(bvh) => bvh.memory(),
            Accel::Brute => 0,
        }
    }
}
