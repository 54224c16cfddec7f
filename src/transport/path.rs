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
use crate::scene::lighting::Choice;
use crate::settings::Direct;

pub fn advance(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    match record.query() {
        Query::Closest if answer.is_hit() => scatter(transport, record, answer, out),
        Query::Closest => miss(transport, record, out),
        Query::Occluded | Query::Attenuated if !answer.is_hit() => out.deposit(record, record.throughput),
        Query::Occluded | Query::Attenuated => {}
    }
}

/// The weight of light that a bounce found and that might have been chosen, or the other way round (power heuristic).
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
    /// Of the shading normal, or, where that faces away from the viewer, of the geometric one.
    fn at(hit: &Interaction, direction: DVec3) -> Self {
        let normal = if direction.dot(hit.normal) < 0.0 { hit.normal } else { hit.geometric };
        let (across, along) = normal.any_orthonormal_pair();
        let mut frame = Frame { across, along, normal, wo: DVec3::ZERO };
        frame.wo = frame.local(-direction);
        frame
    }

    fn local(&self, v: DVec3) -> DVec3 {
        DVec3::new(v.dot(self.across), v.dot(self.along), v.dot(self.normal))
    }

    fn world(&self, v: DVec3) -> DVec3 {
        (self.across * v.x + self.along * v.y) + self.normal * v.z
    }
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
    // Of few lights the number that chose one still has digits enough for a point on it.
    let few = scene.header.emitters.len() + scene.header.lights.len() < 64;
    let Some(chosen) = scene.choose_light(if few { a } else { c }) else { return };
    let point = [if few { chosen.rest } else { a }, b];
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
    let share = match transport.direct {
        _ if pdf.is_infinite() => 1.0 / chosen.chance,
        Direct::Both => weight(pdf, bsdf_pdf) / pdf,
        Direct::Light | Direct::Bsdf => 1.0 / pdf,
    };
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
    let mut throughput = times(record.throughput, scattered.weight);
    if record.bounce >= transport.roulette {
        let chance = throughput.iter().fold(0.0, |most: f64, &c| most.max(c)).min(0.95);
        if chance_number >= chance {
            return;
        }
        throughput = scaled(throughput, 1.0 / chance);
    }
    if is_black(throughput) {
        return;
    }
    let made_by = if scattered.transmitted { Origin::Refraction } else { Origin::Reflection };
    let mut ray = record.onward(hit.position, hit.primitive, direction, Query::Closest, made_by);
    ray.throughput = throughput;
    ray.pdf = scattered.pdf;
    ray.bounce = record.bounce + 1;
    out.push(ray);
}
