//! Matt surfaces that paths meet.

use super::{
    Flags, Hits, Kind, LANES, NOTHING, NOWHERE, Numbers, Vectors, at, color_at, kept, plain_material, put,
};
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::geometry::triangle::meet_plainly;
use crate::scene::emitter::Towards;
use crate::scene::lighting::Choice;
use crate::scene::mesh::Shape;
use crate::settings::Direct;
use crate::simd::compiled;
use crate::transport::bsdf::diffuse;
use crate::transport::path::{self, Chances};
use crate::transport::sampler::{Branches, Purpose, Sampler};
use crate::transport::surface::widened;
use crate::transport::{Sink, Transport, is_black, scaled, times};

/// Hits, and what goes on from them.
#[repr(C, align(64))]
pub struct Matt {
    hits: Hits,
    branches: Branches<LANES>,
    albedo: Vectors,
    /// The frame that light is scattered in: the z axis and the others.
    normal: Vectors,
    across: Vectors,
    along: Vectors,
    /// Cosine of the normal with where the ray came from.
    cosine: Numbers,
    light: Lamps,
    onward: Onward,
}

/// The points on triangular lights that hits ask for light, and the shadow rays to them.
#[repr(C, align(64))]
struct Lamps {
    /// A sampler's set of numbers.
    numbers: [Numbers; 4],
    corners: [Vectors; 3],
    radiance: Vectors,
    chance: Numbers,
    point: [Numbers; 2],
    both_sides: Flags,
    lights: [u32; LANES],
    /// Whether the lane asks a triangle.
    asked: Flags,
    direction: Vectors,
    t_max: Numbers,
    throughput: Vectors,
    /// Whether it is known what becomes of the shadow ray.
    known: Flags,
}

/// The rays that go on.
#[repr(C, align(64))]
struct Onward {
    numbers: [Numbers; 4],
    direction: Vectors,
    throughput: Vectors,
    pdf: Numbers,
}

impl Default for Matt {
    fn default() -> Self {
        let branches =
            Branches { pixel: [0; LANES], sample: [0; LANES], path: [1; LANES], bounce: [0; LANES] };
        Matt {
            hits: Hits::default(),
            branches,
            albedo: NOWHERE,
            normal: NOWHERE,
            across: NOWHERE,
            along: NOWHERE,
            cosine: NOTHING,
            light: Lamps {
                numbers: [NOTHING; 4],
                corners: [NOWHERE; 3],
                radiance: NOWHERE,
                chance: NOTHING,
                point: [NOTHING; 2],
                both_sides: [false; LANES],
                lights: [0; LANES],
                asked: [false; LANES],
                direction: NOWHERE,
                t_max: NOTHING,
                throughput: NOWHERE,
                known: [false; LANES],
            },
            onward: Onward { numbers: [NOTHING; 4], direction: NOWHERE, throughput: NOWHERE, pdf: NOTHING },
        }
    }
}

compiled! {
    fn surfaces(matt: &mut Matt, sampler: &Sampler) = Matt::surfaces;
}

compiled! {
    fn rays(matt: &mut Matt, chances: &Chances) = Matt::rays;
}

impl Kind for Matt {
    fn hits(&mut self) -> &mut Hits {
        &mut self.hits
    }

    #[inline]
    fn take(&mut self, transport: &Transport, place: usize, record: &RayRecord, answer: &Answer) -> bool {
        if record.bounce >= transport.max_depth {
            return false;
        }
        let Some((part, material)) = plain_material(transport, answer.primitive) else { return false };
        if !transport.scene.is_matt(part.material) {
            return false;
        }
        let lane = self.hits.take(transport, part, place, record, answer);
        self.branches.pixel[lane] = record.pixel;
        self.branches.sample[lane] = record.sample;
        self.branches.path[lane] = record.path;
        self.branches.bounce[lane] = record.bounce;
        put(&mut self.albedo, lane, material.kd);
        true
    }

    fn shade(
        &mut self,
        transport: &Transport,
        records: &[RayRecord],
        answers: &[Answer],
        count: usize,
        out: &mut impl Sink,
    ) {
        surfaces(self, &transport.sampler);
        for lane in 0..count {
            self.choose_light(transport, lane);
        }
        rays(self, &transport.chances());
        for lane in 0..count {
            let place = self.hits.places[lane] as usize;
            let record = &records[place];
            if self.light.known[lane] {
                self.push_shadow(record, lane, out);
            } else {
                path::light_of(transport, record, &answers[place], out);
            }
            self.push_onward(record, lane, out);
        }
    }

    fn alone(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
        path::advance(transport, record, answer, out);
    }
}

impl Matt {
    /// Where the rays end, and the numbers that decide how they go on.
    #[inline(always)]
    fn surfaces(&mut self, sampler: &Sampler) {
        self.light.numbers = sampler.bounces(&self.branches, Purpose::Light);
        self.onward.numbers = sampler.bounces(&self.branches, Purpose::Bsdf);
        self.hits.meet();
        for lane in 0..LANES {
            let direction = at(&self.hits.direction, lane);
            let (shading, geometric) = (at(&self.hits.normal, lane), at(&self.hits.geometric, lane));
            let normal = path::frame_normal(shading, geometric, direction);
            let (across, along) = normal.any_orthonormal_pair();
            put(&mut self.normal, lane, normal.to_array());
            put(&mut self.across, lane, across.to_array());
            put(&mut self.along, lane, along.to_array());
            self.cosine[lane] = (-direction).dot(normal);
        }
    }

    /// The triangle that a lane asks for light, or nothing, or that it is to be asked alone.
    fn choose_light(&mut self, transport: &Transport, lane: usize) {
        let lamps = &mut self.light;
        let [a, b, c] = [lamps.numbers[0][lane], lamps.numbers[1][lane], lamps.numbers[2][lane]];
        (lamps.asked[lane], lamps.known[lane]) = (false, true);
        let Some((chosen, point)) = path::choose_light(transport.scene, [a, b, c]) else { return };
        match chosen.light {
            Choice::Emitter(_) if transport.direct == Direct::Bsdf => {}
            Choice::Emitter(emitter) if let Shape::Triangle(corners) = &emitter.shape => {
                for vertex in 0..3 {
                    put(&mut lamps.corners[vertex], lane, widened(corners[vertex]).to_array());
                }
                put(&mut lamps.radiance, lane, emitter.radiance);
                lamps.chance[lane] = chosen.chance;
                (lamps.point[0][lane], lamps.point[1][lane]) = (point[0], point[1]);
                lamps.both_sides[lane] = emitter.both_sides;
                lamps.lights[lane] = chosen.number as u32;
                lamps.asked[lane] = true;
            }
            _ => lamps.known[lane] = false,
        }
    }

    /// Shadow rays, and those that go on.
    #[inline(always)]
    fn rays(&mut self, chances: &Chances) {
        let (lamps, hits) = (&mut self.light, &self.hits);
        for lane in 0..LANES {
            let (from, normal) = (at(&hits.position, lane), at(&self.normal, lane));
            let corners =
                [at(&lamps.corners[0], lane), at(&lamps.corners[1], lane), at(&lamps.corners[2], lane)];
            let towards = Towards::triangle(&corners, from, lamps.point[0][lane], lamps.point[1][lane]);
            let direction = towards.direction;
            let vertices = [corners[0].to_array(), corners[1].to_array(), corners[2].to_array()];
            let t = meet_plainly(from.to_array(), direction.to_array(), &vertices);
            // `next_down` of a positive number.
            let t_max = f64::from_bits(t.to_bits().wrapping_sub(1));
            let is_dark = (towards.facing == 0.0) | ((towards.facing > 0.0) & !lamps.both_sides[lane]);
            let is_sound = (t > 0.0) & (t_max > 0.0) & (towards.pdf < f64::INFINITY);
            let pdf = towards.pdf * lamps.chance[lane];
            let inverse = direction.length_recip();
            let unit = direction * inverse;
            let cosine = unit.dot(normal);
            let agrees = unit.dot(at(&hits.geometric, lane)) * cosine > 0.0;
            let is_seen = (inverse > 0.0) & (inverse < f64::INFINITY) & agrees;
            let lit = (self.cosine[lane] > 0.0) & (cosine > 0.0);
            let bsdf_pdf = if lit { diffuse::pdf(cosine) } else { 0.0 };
            let value = scaled(color_at(&self.albedo, lane), bsdf_pdf);
            let share = chances.share(pdf, bsdf_pdf);
            let throughput = times(color_at(&hits.throughput, lane), value);
            let throughput = scaled(times(throughput, color_at(&lamps.radiance, lane)), share);
            let goes = lamps.asked[lane] & !is_dark & is_sound & is_seen & lit;
            put(&mut lamps.direction, lane, direction.to_array());
            put(&mut lamps.throughput, lane, kept(throughput, goes));
            lamps.t_max[lane] = t_max;
            // Where it isn't plain that the light is met it has to be asked once more.
            lamps.known[lane] &= !lamps.asked[lane] | is_dark | is_sound;
        }
        let onward = &mut self.onward;
        for lane in 0..LANES {
            let wi = diffuse::sample([onward.numbers[0][lane], onward.numbers[1][lane]]);
            let pdf = diffuse::pdf(wi.z);
            let (across, along) = (at(&self.across, lane), at(&self.along, lane));
            let direction = path::to_world(across, along, at(&self.normal, lane), wi).normalize();
            let throughput = times(color_at(&hits.throughput, lane), color_at(&self.albedo, lane));
            let number = lamps.numbers[3][lane];
            let (throughput, survives) = chances.roulette(self.branches.bounce[lane], throughput, number);
            let agrees = direction.dot(at(&hits.geometric, lane)) * wi.z > 0.0;
            let goes = (self.cosine[lane] > 0.0) & (pdf > 0.0) & agrees & survives;
            put(&mut onward.direction, lane, direction.to_array());
            put(&mut onward.throughput, lane, kept(throughput, goes));
            onward.pdf[lane] = pdf;
        }
    }

    fn push_shadow(&self, record: &RayRecord, lane: usize, out: &mut impl Sink) {
        let throughput = color_at(&self.light.throughput, lane);
        if is_black(throughput) {
            return;
        }
        let (from, direction) = (at(&self.hits.position, lane), at(&self.light.direction, lane));
        let primitive = self.hits.primitives[lane];
        let mut ray = record.onward(from, primitive, direction, Query::Occluded, Origin::Shadow);
        ray.throughput = throughput;
        ray.t_max = self.light.t_max[lane];
        ray.towards(self.light.lights[lane] as usize);
        out.push(ray);
    }

    fn push_onward(&self, record: &RayRecord, lane: usize, out: &mut impl Sink) {
        let throughput = color_at(&self.onward.throughput, lane);
        if is_black(throughput) {
            return;
        }
        let (from, direction) = (at(&self.hits.position, lane), at(&self.onward.direction, lane));
        let primitive = self.hits.primitives[lane];
        let mut ray = record.onward(from, primitive, direction, Query::Closest, Origin::Reflection);
        ray.throughput = throughput;
        ray.pdf = self.onward.pdf[lane];
        ray.bounce = record.bounce + 1;
        out.push(ray);
    }
}
