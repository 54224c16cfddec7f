//! Local illumination, shadows, mirror and refraction rays: Whitted, "An Improved Illumination Model for Shaded
//! Display", 1980. Iterative: each branch is a record of its own.

use glam::DVec3;

use super::surface::Interaction;
use super::{Sink, Transport, add, is_black, phong, scaled, times};
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::scene::Color;
use crate::scene::camera::Projection;

pub fn advance(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    match record.query() {
        Query::Closest if answer.is_hit() => shade(transport, record, answer, out),
        Query::Closest => {
            out.deposit(record, times(record.throughput, transport.scene.header.background));
        }
        Query::Occluded | Query::Attenuated if !answer.is_hit() => out.deposit(record, record.throughput),
        Query::Occluded => {}
        Query::Attenuated => attenuate(transport, record, answer, out),
    }
}

/// Goes on towards the light through a transparent surface, weakened by its kt.
fn attenuate(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    let scene = transport.scene;
    let material = &scene.header.materials[scene.part(answer.primitive).material as usize];
    let throughput = times(record.throughput, material.kt);
    if !is_black(throughput) {
        let mut onward = record.beyond(answer);
        onward.throughput = throughput;
        out.push(onward);
    }
}

fn shade(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
    let hit = Interaction::new(transport.scene, record, answer);
    let direction = DVec3::from(record.direction);
    let local = scaled(record.throughput, 1.0 - hit.material.reflectivity);

    // What the surface shows by itself.
    let glow = times(local, phong::unshadowed(&hit, transport.ambient));
    if !is_black(glow) {
        out.deposit(record, glow);
    }

    // A shadow ray to each light that would add something.
    let header = &transport.scene.header;
    let parallel = record.bounce == 0 && header.camera.projection == Projection::Orthographic;
    let view = phong::View { eye: DVec3::from(record.origin), to_viewer: -direction, parallel };
    let world_unit = 1.0 / header.frame.scale;
    let query = if transport.transparent { Query::Attenuated } else { Query::Occluded };
    for (number, light) in header.lights.iter().enumerate() {
        let arrival = light.arrival(hit.position, world_unit);
        let throughput = times(local, phong::illuminate(&hit, light, &arrival, &view, world_unit));
        if !is_black(throughput) {
            let mut ray = record.onward(hit.position, hit.primitive, arrival.to_light, query, Origin::Shadow);
            ray.throughput = throughput;
            ray.t_max = arrival.t_max;
            ray.towards(number);
            out.push(ray);
        }
    }

    // The mirror and the refracted ray.
    if record.bounce < transport.max_depth {
        bounce(transport, record, &hit, direction, out);
    }
}

fn bounce(
    transport: &Transport,
    record: &RayRecord,
    hit: &Interaction,
    direction: DVec3,
    out: &mut impl Sink,
) {
    let (material, start) = (hit.material, (hit.position, hit.primitive));
    let mut mirrored = add(material.kr, [material.reflectivity; 3]);
    if material.is_transparent() {
        let eta = if hit.entering { 1.0 / material.ior } else { material.ior };
        match refract(direction, hit, eta) {
            Some(refraction) => {
                let back = if material.fresnel { refraction.reflectance } else { 0.0 };
                mirrored = add(mirrored, scaled(material.kt, back));
                let weight = scaled(material.kt, 1.0 - back);
                branch(transport, record, start, refraction.direction, weight, Origin::Refraction, out);
            }
            // Total internal reflection: everything turns back.
            None => mirrored = add(mirrored, material.kt),
        }
    }
    if !is_black(mirrored) {
        let reflected = self::mirrored(direction, hit.normal, hit.geometric);
        branch(transport, record, start, reflected, mirrored, Origin::Reflection, out);
    }
}

/// The ray from a point of a primitive on, if it carries enough.
pub(super) fn branch(
    transport: &Transport,
    record: &RayRecord,
    (from, primitive): (DVec3, u32),
    direction: DVec3,
    weight: Color,
    made_by: Origin,
    out: &mut impl Sink,
) {
    let throughput = times(record.throughput, weight);
    if is_black(throughput) || throughput.iter().all(|&c| c < transport.min_weight) {
        return;
    }
    let mut ray = record.onward(from, primitive, direction, Query::Closest, made_by);
    ray.throughput = throughput;
    ray.bounce = record.bounce + 1;
    ray.path = record.path.wrapping_mul(4).wrapping_add(made_by as u64);
    out.push(ray);
}

/// The mirror direction about the shading normal, or, where that would lead into the surface, about the geometric one.
#[inline(always)]
pub(super) fn mirrored(direction: DVec3, normal: DVec3, geometric: DVec3) -> DVec3 {
    let by_shading = direction - normal * (2.0 * direction.dot(normal));
    let by_geometry = direction - geometric * (2.0 * direction.dot(geometric));
    let mirrored = if by_shading.dot(geometric) > 0.0 { by_shading } else { by_geometry };
    mirrored.normalize()
}

struct Refraction {
    direction: DVec3,
    /// The part that is reflected by Fresnel's equations, unpolarised.
    reflectance: f64,
}

/// Snell's law with `eta`, the index on this side over the one behind; `None` where all is reflected. About the
/// geometric normal where the shading normal faces away from the viewer or would keep the ray on this side.
fn refract(direction: DVec3, hit: &Interaction, eta: f64) -> Option<Refraction> {
    // One index on both sides: nothing bends or turns back, whatever the normals say.
    if eta == 1.0 {
        return Some(Refraction { direction, reflectance: 0.0 });
    }
    let about = |normal: DVec3| {
        let cosine = (-direction.dot(normal)).clamp(0.0, 1.0);
        let sine2 = eta * eta * (1.0 - cosine * cosine);
        if sine2 >= 1.0 {
            return None;
        }
        let behind = (1.0 - sine2).sqrt();
        let refracted = direction * eta + normal * (eta * cosine - behind);
        let parallel = (eta * behind - cosine) / (eta * behind + cosine);
        let perpendicular = (eta * cosine - behind) / (eta * cosine + behind);
        let reflectance = 0.5 * (parallel * parallel + perpendicular * perpendicular);
        Some(Refraction { direction: refracted.normalize(), reflectance })
    };
    if direction.dot(hit.normal) < 0.0 {
        let refraction = about(hit.normal)?;
        if refraction.direction.dot(hit.geometric) < 0.0 {
            return Some(refraction);
        }
    }
    about(hit.geometric)
}
