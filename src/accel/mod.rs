//! Closest hits and occlusion over the surfaces of a scene. Knows no material, light or rank.

pub mod brute;
pub mod bvh;
mod tester;

use crate::geometry::record::{Answer, Query, RayRecord};
use crate::geometry::{NONE, Ray};
use crate::scene::Surfaces;
use crate::settings::AccelKind;
use bvh::Bvh;
use tester::Tester;

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
