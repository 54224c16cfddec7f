//! Rays under way as plain records, and the answers to them.

use bytemuck::{Pod, Zeroable};
use glam::DVec3;

use super::{NONE, Ray};

/// What a record asks of the surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Query {
    /// The first hit, which will be shaded.
    Closest,
    /// Is anything in the way to the light? If not, `throughput` is deposited.
    Occluded,
    /// The next surface on the way to the light, which may let light through.
    Attenuated,
}

/// What made a ray; for counting only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    Camera,
    Reflection,
    Refraction,
    Shadow,
}

/// One ray under way, complete in itself: any rank can go on with it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct RayRecord {
    pub origin: [f64; 3],
    pub direction: [f64; 3],
    pub t_min: f64,
    pub t_max: f64,
    /// Linear RGB weight of what the ray will find; of a shadow ray the whole pending contribution.
    pub throughput: [f64; 3],
    /// Of a path: the solid-angle density with which its last bounce chose this direction; infinite where it had no choice.
    pub pdf: f64,
    /// Names the branch of the ray tree, for random numbers.
    pub path: u64,
    /// y * width + x of the whole image.
    pub pixel: u32,
    pub sample: u32,
    /// The primitive that it starts on, or [`NONE`].
    pub start: u32,
    /// See [`Ray::first_id`].
    pub first_id: u32,
    /// Bounces behind it: 0 for a camera ray.
    pub bounce: u32,
    pub(crate) query: u8,
    pub(crate) made_by: u8,
    /// The film plane that it deposits in.
    pub plane: u8,
    /// Records of one stream go much the same way, and are traced together. Nothing else depends on it.
    pub stream: u8,
}

impl RayRecord {
    /// Streams that rays are told apart by.
    pub const STREAMS: usize = 8;

    pub const QUERIES: [Query; 3] = [Query::Closest, Query::Occluded, Query::Attenuated];
    pub const ORIGINS: [Origin; 4] = [Origin::Camera, Origin::Reflection, Origin::Refraction, Origin::Shadow];

    /// A camera ray.
    #[inline]
    pub fn camera(origin: DVec3, direction: DVec3, pixel: u32, sample: u32, plane: u8) -> Self {
        RayRecord {
            origin: origin.to_array(),
            direction: direction.to_array(),
            t_min: 0.0,
            t_max: f64::INFINITY,
            throughput: [1.0; 3],
            pdf: f64::INFINITY,
            path: 1,
            pixel,
            sample,
            start: NONE,
            first_id: 0,
            bounce: 0,
            query: Query::Closest as u8,
            made_by: Origin::Camera as u8,
            plane,
            stream: 0,
        }
    }

    /// A ray that goes on from a hit of this one.
    #[inline]
    pub fn onward(&self, from: DVec3, start: u32, direction: DVec3, query: Query, made_by: Origin) -> Self {
        RayRecord {
            origin: from.to_array(),
            direction: direction.to_array(),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start,
            query: query as u8,
            made_by: made_by as u8,
            stream: made_by as u8,
            ..*self
        }
    }

    /// Sets a shadow ray's stream: one for each of the first lights, then by turns.
    #[inline]
    pub fn towards(&mut self, light: usize) {
        let others = Origin::Shadow as usize;
        self.stream = (others + light % (Self::STREAMS - others)) as u8;
    }

    /// The same ray, from just behind a hit on.
    pub fn beyond(&self, answer: &Answer) -> Self {
        RayRecord { t_min: answer.t, first_id: answer.primitive + 1, ..*self }
    }

    #[inline]
    pub fn query(&self) -> Query {
        Self::QUERIES[usize::from(self.query)]
    }

    #[inline]
    pub fn made_by(&self) -> Origin {
        Self::ORIGINS[usize::from(self.made_by)]
    }

    #[inline]
    pub fn ray(&self) -> Ray {
        Ray {
            origin: DVec3::from(self.origin),
            direction: DVec3::from(self.direction),
            t_min: self.t_min,
            t_max: self.t_max,
            first_id: self.first_id,
            start: self.start,
        }
    }
}

/// What the surfaces answer to a record. For [`Query::Occluded`] only whether there is a hit is meant.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Answer {
    /// In units of the ray's direction; infinite for a miss.
    pub t: f64,
    /// Barycentric weights of a triangle's second and third vertex.
    pub u: f64,
    pub v: f64,
    /// [`NONE`] for a miss.
    pub primitive: u32,
    pub _pad: u32,
}

impl Answer {
    pub const MISS: Answer = Answer { t: f64::INFINITY, u: 0.0, v: 0.0, primitive: NONE, _pad: 0 };

    #[inline]
    pub fn is_hit(&self) -> bool {
        self.primitive != NONE
    }
}
