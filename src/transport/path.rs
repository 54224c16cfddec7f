//! Paths: at each hit one light is asked (next-event estimation) and one direction goes on, both weighted against each other where either could have
//! found the same light (Kajiya 1986, "The Rendering Equation"; Veach 1997, "Robust Monte Carlo Methods", chapters 9 and 10).
//!
//! `ka`, ambient light and `min_weight` mean nothing here. A light without extent counts as Whitted's integrator shows it: on a matt surface that it shines on from above
//! it leaves kd times its colour.

use std::f64::consts::PI;

use glam::DVec3;

use super::bsdf::Bsdf;
use super::sampler::Purpose;
use super::surface::Interaction;
use super::{Sink, Transport, is_black, scaled, times};
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::scene::lighting::{Choice, Chosen};
use crate::scene::{Color, Scene};
use crate::settings::Direct;

pub fn advance(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    match record.query() {
        Query::Closest if answer.is_hit() => scatter(transport, record, answer, out),
        Query::Closest => miss(transport, record, out),
        Query::Occluded | Query::Attenuated if !answer.is_hit() => out.deposit(record, record.throughput),
        Query::Occluded | Query::Attenuated => {}
    }
}

/// How light is weighted and paths end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chances {
    pub direct: Direct,
    /// See [`ImageSettings::roulette`](crate::settings::ImageSettings::roulette).
    pub roulette: u32,
}

/// No path goes on for sure once it may end.
const MOST: f64 = 0.95;

impl Chances {
    /// What light that was chosen with the density `pdf` counts, where a bounce would have found it with `bsdf_pdf`.
    #[inline(always)]
    pub fn share(&self, pdf: f64, bsdf_pdf: f64) -> f64 {
        match self.direct {
            Direct::Both => weight(pdf, bsdf_pdf) / pdf,
            Direct::Light | Direct::Bsdf => 1.0 / pdf,
        }
    }

    /// Russian roulette: what a path that goes on carries, and whether it does, by a number in [0, 1).
    #[inline(always)]
    pub fn roulette(&self, bounce: u32, throughput: Color, number: f64) -> (Color, bool) {
        let [r, g, b] = throughput;
        let larger = |a: f64, b: f64| if a > b { a } else { b };
        let most = larger(larger(r, g), b);
        let chance = if most < MOST { most } else { MOST };
        if bounce >= self.roulette {
            (scaled(throughput, 1.0 / chance), number < chance)
        } else {
            (throughput, true)
        }
    }
}

/// The light that three numbers in [0, 1) choose, and a point of the unit square that names one on it. `None` where nothing shines.
#[inline]
pub(super) fn choose_light(scene: &Scene, [a, b, c]: [f64; 3]) -> Option<(Chosen<'_>, [f64; 2])> {
    // Of few lights the number that chose one still has digits enough for a point on it.
    let few = scene.header.emitters.len() + scene.header.lights.len() < 64;
    let chosen = scene.choose_light(if few { a } else { c })?;
    let first = if few { chosen.rest } else { a };
    Some((chosen, [first, b]))
}

/// A hit's shadow ray alone, of a smooth surface that doesn't shine.
pub(super) fn light_of(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    let hit = Interaction::new(transport.scene, record, answer);
    let frame = Frame::at(&hit, DVec3::from(record.direction));
    let bsdf = Bsdf::new(hit.material, hit.diffuse_tint, hit.entering);
    light(transport, record, &hit, &frame, &bsdf, transport.sampler.bounce(record, Purpose::Light), out);
}

/// The weight of light that a bounce found and that might have been chosen, or the other way round (power heuristic).
#[inline(always)]
fn weight(own: f64, other: f64) -> f64 {
    if own.is_infinite() {
        return 1.0;
    }
    let (own, other) = (own * own, other * other);
    if own > 0.0 { own / (own + other) } else { 0.0 }
}

/// The weight of light that this ray's last bounce found, `chosen` being the density with which it would have been chosen.
fn weight_of_found(transport: &Transport, record: &RayRecord, chosen: f64) -> f64 {
    // A ray that had no choice, the camera's among them, finds what nothing else finds.
    match transport.direct {
        _ if record.pdf.is_infinite() || chosen == 0.0 => 1.0,
        Direct::Both => weight(record.pdf, chosen),
        Direct::Light => 0.0,
        Direct::Bsdf => 1.0,
    }
}

fn miss(transport: &Transport, record: &RayRecord, out: &mut impl Sink) {
    let scene = transport.scene;
    let Some((environment, table)) = scene.environment() else {
        let background = times(record.throughput, scene.header.background);
        if !is_black(background) {
            out.deposit(record, background);
        }
        return;
    };
    let direction = DVec3::from(record.direction);
    let chosen = if record.pdf.is_infinite() {
        0.0
    } else {
        scene.environment_chance() * table.pdf(environment, direction)
    };
    let weight = weight_of_found(transport, record, chosen);
    out.deposit(record, scaled(times(record.throughput, environment.radiance(direction)), weight));
}

fn scatter(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    let scene = transport.scene;
    let hit = Interaction::new(scene, record, answer);
    let direction = DVec3::from(record.direction);

    if !is_black(hit.emission()) {
        let chosen = match scene.emitter(answer.primitive) {
            // Nobody chooses a point on the surface that he is on.
            Some((emitter, chance)) if record.start != answer.primitive && !record.pdf.is_infinite() => {
                chance * emitter.pdf(DVec3::from(record.origin), direction, answer.t)
            }
            _ => 0.0,
        };
        let weight = weight_of_found(transport, record, chosen);
        if weight > 0.0 {
            out.deposit(record, scaled(times(record.throughput, hit.emission()), weight));
        }
    }
    if record.bounce >= transport.max_depth {
        return;
    }

    let frame = Frame::at(&hit, direction);
    let bsdf = Bsdf::new(hit.material, hit.diffuse_tint, hit.entering);
    // Both sets at once: neither waits for the other.
    let numbers = transport.sampler.bounce(record, Purpose::Light);
    let onward = transport.sampler.bounce(record, Purpose::Bsdf);
    if bsdf.is_smooth() {
        light(transport, record, &hit, &frame, &bsdf, numbers, out);
    }
    go_on(transport, record, &hit, &frame, &bsdf, (onward, numbers[3]), out);
}

/// Directions in the surface's own terms: z is the normal.
struct Frame {
    across: DVec3,
    along: DVec3,
    normal: DVec3,
    /// To where the ray came from.
    wo: DVec3,
}

impl Frame {
    fn at(hit: &Interaction, direction: DVec3) -> Self {
        let normal = frame_normal(hit.normal, hit.geometric, direction);
        let (across, along) = normal.any_orthonormal_pair();
        let mut frame = Frame { across, along, normal, wo: DVec3::ZERO };
        frame.wo = frame.local(-direction);
        frame
    }

    fn local(&self, v: DVec3) -> DVec3 {
        DVec3::new(v.dot(self.across), v.dot(self.along), v.dot(self.normal))
    }

    fn world(&self, v: DVec3) -> DVec3 {
        to_world(self.across, self.along, self.normal, v)
    }
}

/// The shading normal, or, where that faces away from the viewer, the geometric one.
#[inline(always)]
pub(super) fn frame_normal(normal: DVec3, geometric: DVec3, direction: DVec3) -> DVec3 {
    if direction.dot(normal) < 0.0 { normal } else { geometric }
}

#[inline(always)]
pub(super) fn to_world(across: DVec3, along: DVec3, normal: DVec3, v: DVec3) -> DVec3 {
    (across * v.x + along * v.y) + normal * v.z
}

/// Whether a direction lies on the same side of the surface by both normals: z is that along the shading normal.
fn agrees(hit: &Interaction, direction: DVec3, z: f64) -> bool {
    direction.dot(hit.geometric) * z > 0.0
}

/// A shadow ray to one light.
fn light(
    transport: &Transport,
    record: &RayRecord,
    hit: &Interaction,
    frame: &Frame,
    bsdf: &Bsdf,
    [a, b, c, _]: [f64; 4],
    out: &mut impl Sink,
) {
    let scene = transport.scene;
    let Some((chosen, point)) = choose_light(scene, [a, b, c]) else { return };
    // Towards the light, the shadow ray's end, what comes from there, and the density of the choice: infinite where there is no other direction.
    let (direction, t_max, radiance, pdf) = match chosen.light {
        Choice::Light(light) => {
            let arrival = light.arrival(hit.position, 1.0 / scene.header.frame.scale);
            (arrival.to_light, arrival.t_max, scaled(light.diffuse, PI * arrival.strength), f64::INFINITY)
        }
        _ if transport.direct == Direct::Bsdf => return,
        Choice::Emitter(emitter) => {
            // Only a part of the scene that has the emitter knows it as a primitive.
            if !is_black(hit.material.emission)
                && scene.emitter(hit.primitive).is_some_and(|(own, _)| own.primitive == emitter.primitive)
            {
                return;
            }
            let Some(aim) = emitter.aim(hit.position, point) else { return };
            (aim.direction, aim.t_max, emitter.radiance, aim.pdf * chosen.chance)
        }
        Choice::Environment(environment, table) => {
            let Some((direction, pdf)) = table.choose(environment, point) else { return };
            (direction, f64::INFINITY, environment.radiance(direction), pdf * chosen.chance)
        }
    };
    let Some(unit) = direction.try_normalize() else { return };
    let wi = frame.local(unit);
    if !agrees(hit, unit, wi.z) {
        return;
    }
    let (value, bsdf_pdf) = bsdf.evaluate(frame.wo, wi);
    let share =
        if pdf.is_infinite() { 1.0 / chosen.chance } else { transport.chances().share(pdf, bsdf_pdf) };
    let throughput = scaled(times(times(record.throughput, value), radiance), share);
    if !is_black(throughput) {
        let mut ray = record.onward(hit.position, hit.primitive, direction, Query::Occluded, Origin::Shadow);
        ray.throughput = throughput;
        ray.t_max = t_max;
        ray.towards(chosen.number);
        out.push(ray);
    }
}

/// The next ray of the path, unless it ends here.
fn go_on(
    transport: &Transport,
    record: &RayRecord,
    hit: &Interaction,
    frame: &Frame,
    bsdf: &Bsdf,
    ([u, v, lobe, _], chance_number): ([f64; 4], f64),
    out: &mut impl Sink,
) {
    let Some(scattered) = bsdf.sample(frame.wo, [lobe, u, v]) else { return };
    let direction = frame.world(scattered.wi).normalize();
    if !agrees(hit, direction, scattered.wi.z) {
        return;
    }
    let throughput = times(record.throughput, scattered.weight);
    let (throughput, survives) = transport.chances().roulette(record.bounce, throughput, chance_number);
    if !survives || is_black(throughput) {
        return;
    }
    let made_by = if scattered.transmitted { Origin::Refraction } else { Origin::Reflection };
    let mut ray = record.onward(hit.position, hit.primitive, direction, Query::Closest, made_by);
    ray.throughput = throughput;
    ray.pdf = scattered.pdf;
    ray.bounce = record.bounce + 1;
    out.push(ray);
}
