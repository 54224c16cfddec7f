//! Hits side by side: what most rays meet, shaded many at a time. The same light and rays, bit for bit, as `path` and `whitted` make of them one by one.
//!
//! What is done for a hit is written once, in functions without branches that both use; loops over lanes are such that the compiler makes vectors of them. Whatever is out of the ordinary
//! goes back to be done alone.

pub mod glossy;
pub mod matt;

use glam::DVec3;

use super::surface::{facing, turned, unit, weighted, widened};
use super::{Sink, Transport};
use crate::geometry::position;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::mesh::{NONE, Part};
use crate::scene::{Color, Material, Shading};

/// Hits that are worked on together.
pub const LANES: usize = 32;
/// Fewer aren't worth it.
const LEAST: usize = 4;

pub type Numbers = [f64; LANES];
/// By axis.
pub type Vectors = [Numbers; 3];
pub type Flags = [bool; LANES];

pub const NOTHING: Numbers = [0.0; LANES];
pub const NOWHERE: Vectors = [NOTHING; 3];

#[inline(always)]
pub fn at(vectors: &Vectors, lane: usize) -> DVec3 {
    DVec3::new(vectors[0][lane], vectors[1][lane], vectors[2][lane])
}

#[inline(always)]
pub fn color_at(vectors: &Vectors, lane: usize) -> Color {
    [vectors[0][lane], vectors[1][lane], vectors[2][lane]]
}

#[inline(always)]
pub fn put(vectors: &mut Vectors, lane: usize, values: [f64; 3]) {
    for axis in 0..3 {
        vectors[axis][lane] = values[axis];
    }
}

/// No light where a ray doesn't go.
#[inline(always)]
pub fn kept([r, g, b]: Color, goes: bool) -> Color {
    let keep = |c: f64| if goes { c } else { 0.0 };
    [keep(r), keep(g), keep(b)]
}

/// Hits of one kind, and how an integrator goes on from them.
pub trait Kind {
    fn hits(&mut self) -> &mut Hits;

    /// Takes a hit, if it is of this kind; whether it is.
    fn take(&mut self, transport: &Transport, place: usize, record: &RayRecord, answer: &Answer) -> bool;

    /// Does with the first `count` that were taken what [`alone`](Self::alone) does with each.
    fn shade(
        &mut self,
        transport: &Transport,
        records: &[RayRecord],
        answers: &[Answer],
        count: usize,
        out: &mut impl Sink,
    );

    /// Goes on from any answer.
    fn alone(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink);
}

/// Goes on from the answers to a batch of records, hits of the kind side by side.
pub fn advance_all<K: Kind>(
    transport: &Transport,
    records: &[RayRecord],
    answers: &[Answer],
    kind: &mut K,
    out: &mut impl Sink,
) {
    for (place, (record, answer)) in records.iter().zip(answers).enumerate() {
        let is_hit = record.query() == Query::Closest && answer.is_hit();
        if !is_hit || !kind.take(transport, place, record, answer) {
            K::alone(transport, record, answer, out);
        } else if kind.hits().count == LANES {
            flush(transport, records, answers, kind, out);
        }
    }
    flush(transport, records, answers, kind, out);
}

fn flush<K: Kind>(
    transport: &Transport,
    records: &[RayRecord],
    answers: &[Answer],
    kind: &mut K,
    out: &mut impl Sink,
) {
    let count = std::mem::take(&mut kind.hits().count);
    if count >= LEAST {
        kind.shade(transport, records, answers, count, out);
        return;
    }
    for lane in 0..count {
        let place = kind.hits().places[lane] as usize;
        K::alone(transport, &records[place], &answers[place], out);
    }
}

/// Surfaces at hits, each in its lane.
#[repr(C, align(64))]
pub struct Hits {
    count: usize,
    /// Places of their records in the batch.
    pub places: [u32; LANES],
    pub primitives: [u32; LANES],
    pub direction: Vectors,
    pub throughput: Vectors,
    /// Of a triangle, by vertex; of a sphere the centre comes first.
    corners: [Vectors; 3],
    /// Barycentric weights of the second and third vertex.
    weights: [Numbers; 2],
    /// Of a triangle at the vertices, where there are any.
    normals: [Vectors; 3],
    smooth: Flags,
    /// Of a sphere.
    round: Flags,
    radius: Numbers,
    /// Where the ray comes to a sphere, but for rounding.
    touched: Vectors,
    pub position: Vectors,
    /// Geometric normal on the side that the ray came from.
    pub geometric: Vectors,
    /// Shading normal on the same side of the surface.
    pub normal: Vectors,
    pub entering: Flags,
}

impl Default for Hits {
    fn default() -> Self {
        Hits {
            count: 0,
            places: [0; LANES],
            primitives: [NONE; LANES],
            direction: NOWHERE,
            throughput: NOWHERE,
            corners: [NOWHERE; 3],
            weights: [NOTHING; 2],
            normals: [NOWHERE; 3],
            smooth: [false; LANES],
            round: [false; LANES],
            radius: NOTHING,
            touched: NOWHERE,
            position: NOWHERE,
            geometric: NOWHERE,
            normal: NOWHERE,
            entering: [false; LANES],
        }
    }
}

/// What a primitive is made of, if its colours are the same everywhere on it.
#[inline]
pub fn plain_material<'a>(transport: &Transport<'a>, primitive: u32) -> Option<(&'a Part, &'a Material)> {
    let scene = transport.scene;
    let part = scene.part(primitive);
    let material = &scene.header.materials[part.material as usize];
    let is_even = part.colors == NONE && (material.texture.is_none() || part.uvs == NONE);
    (is_even && part.shading != Shading::Gouraud).then_some((part, material))
}

impl Hits {
    /// Takes a hit on a primitive of this part; its lane.
    #[inline]
    pub fn take(
        &mut self,
        transport: &Transport,
        part: &Part,
        place: usize,
        record: &RayRecord,
        answer: &Answer,
    ) -> usize {
        let surfaces = &transport.scene.surfaces;
        let lane = self.count;
        self.count += 1;
        self.places[lane] = place as u32;
        self.primitives[lane] = answer.primitive;
        put(&mut self.direction, lane, record.direction);
        put(&mut self.throughput, lane, record.throughput);
        let triangle = surfaces.triangles.get(answer.primitive as usize);
        self.round[lane] = triangle.is_none();
        self.smooth[lane] = triangle.is_some() && part.normals != NONE;
        if let Some(&indices) = triangle {
            for vertex in 0..3 {
                let corner = surfaces.positions[indices[vertex] as usize];
                put(&mut self.corners[vertex], lane, widened(corner).to_array());
            }
            if part.normals != NONE {
                for vertex in 0..3 {
                    let normal =
                        surfaces.normals[(part.normals + (indices[vertex] - part.vertices)) as usize];
                    put(&mut self.normals[vertex], lane, widened(normal).to_array());
                }
            }
            (self.weights[0][lane], self.weights[1][lane]) = (answer.u, answer.v);
        } else if let Some(sphere) = surfaces.sphere_at(answer.primitive) {
            put(&mut self.corners[0], lane, widened(sphere.center).to_array());
            self.radius[lane] = f64::from(sphere.radius);
            let touched = DVec3::from(record.origin) + DVec3::from(record.direction) * answer.t;
            put(&mut self.touched, lane, touched.to_array());
        }
        lane
    }

    /// Where the rays end.
    #[inline(always)]
    pub fn meet(&mut self) {
        for lane in 0..LANES {
            let corners @ [a, b, c] =
                [at(&self.corners[0], lane), at(&self.corners[1], lane), at(&self.corners[2], lane)];
            let weights = position::weights(self.weights[0][lane], self.weights[1][lane]);
            let direction = at(&self.direction, lane);
            let on_triangle = position::on_triangle(corners, weights);
            let (on_sphere, radial) = position::on_sphere(a, self.radius[lane], at(&self.touched, lane));
            let round = self.round[lane];
            let position = if round { on_sphere } else { on_triangle };
            let outward = if round { radial } else { unit((b - a).cross(c - a)) };
            let entering = outward.dot(direction) < 0.0;
            let geometric = if entering { outward } else { -outward };
            let stored = [at(&self.normals[0], lane), at(&self.normals[1], lane), at(&self.normals[2], lane)];
            let smooth = facing(weighted(turned(stored, geometric), weights), geometric);
            let normal = if self.smooth[lane] { smooth } else { geometric };
            put(&mut self.position, lane, position.to_array());
            put(&mut self.geometric, lane, geometric.to_array());
            put(&mut self.normal, lane, normal.to_array());
            self.entering[lane] = entering;
        }
    }
}

#[cfg(test)]
mod tests;
