//! The stress test: aimed rays through the tracer that renders, each answer judged by the exact referee.
//!
//! Ray `index` of body `number` is a pure function of the seed, so a run is the same for any number of threads and ranks.

use std::path::Path;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::aim::{Aim, Dice, Target};
use super::dyadic::{self, Dyadic, exact};
use super::judge::{Court, Judged, Verdict};
use super::meshes::{self, Body};
use super::referee::{ExactRay, Referee};
use super::tally::Tally;
use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::geometry::Ray;
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::scene::build::SceneBuilder;
use crate::scene::mesh::{Mesh, has_area};
use crate::scene::{Material, Scene, SceneHeader, Shading};
use crate::settings::{AccelKind, BuildPreset};
use crate::simd::Level;
use crate::transport::surface::Interaction;

/// Rays that are traced in one go by one thread.
const CHUNK: u64 = 64;

/// Something to trace, with a name for its shape and one for where it was put.
#[derive(Clone, Debug, Default)]
pub struct Subject {
    pub shape: String,
    pub place: String,
    pub body: Body,
}

/// All generated bodies in all places.
pub fn generated() -> Vec<Subject> {
    let all = (0..meshes::SHAPES.len()).flat_map(|shape| meshes::PLACES.map(|place| (shape, place)));
    all.map(|(shape, (place, factor, offset))| Subject {
        shape: meshes::SHAPES[shape].into(),
        place: place.into(),
        body: meshes::body(shape, factor, offset),
    })
    .collect()
}

/// Which rays are traced, and by what.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Plan {
    /// Of all bodies together.
    pub rays: u64,
    pub seed: u64,
    pub accels: Vec<AccelKind>,
    /// Of the hierarchy.
    pub build: BuildPreset,
}

impl Plan {
    /// The number of rays for one of `bodies` bodies.
    pub fn rays_of(&self, number: usize, bodies: usize) -> u64 {
        let (number, bodies) = (number as u64, bodies as u64);
        self.rays / bodies + u64::from(number < self.rays % bodies)
    }
}

/// What is put to the test.
pub trait Tracer: Sync {
    fn closest(&self, ray: &Ray) -> Answer;
    fn occluded(&self, ray: &Ray) -> bool;
}

/// One of the renderer's own structures over a scene.
struct Structure<'a> {
    accel: Accel,
    scene: &'a Scene,
}

impl Tracer for Structure<'_> {
    fn closest(&self, ray: &Ray) -> Answer {
        self.accel.closest(&self.scene.surfaces, ray)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.accel.occluded(&self.scene.surfaces, ray)
    }
}

/// The same structure's packets: each ray goes with companions that go nearly its way.
struct Packets<'a>(&'a Structure<'a>);

/// Rays of a packet.
const PACKET: usize = 16;

impl Packets<'_> {
    fn answer(&self, ray: &Ray, any: bool) -> Answer {
        let mut rays = [*ray; PACKET];
        // Each component on its own, by up to 2^-8 of itself: zeros and signs stay.
        for (number, companion) in rays.iter_mut().enumerate().skip(1) {
            let aside = |step: usize| 1.0 + (number * step % PACKET) as f64 / 4096.0;
            companion.direction *= DVec3::new(aside(3), aside(5), aside(7));
        }
        let mut answers = [Answer::MISS; PACKET];
        if let Accel::Bvh(wide) = &self.0.accel {
            wide.trace_rays(Level::chosen(), &self.0.scene.surfaces, &rays, any, &mut answers);
        }
        answers[0]
    }
}

impl Tracer for Packets<'_> {
    fn closest(&self, ray: &Ray) -> Answer {
        self.answer(ray, false)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.answer(ray, true).is_hit()
    }
}

/// A body as a scene, put into the frame in which everything is traced, with its judge.
pub struct Bench<'a> {
    pub scene: Scene,
    court: Court,
    world: Target<'a>,
    stored: Body,
}

impl<'a> Bench<'a> {
    /// # Errors
    /// A body that no scene can hold, without triangles, or whose vertices aren't stored exactly.
    pub fn new(subject: &'a Subject) -> Result<Self> {
        let name = if subject.place.is_empty() {
            subject.shape.clone()
        } else {
            format!("{} {}", subject.shape, subject.place)
        };
        let body = &subject.body;
        if body.triangles.is_empty() {
            return Err(Error::scene(name, None, "no triangles", "give a mesh with faces"));
        }
        let mut builder = SceneBuilder::new(Path::new(&name));
        let material = builder.material(Material::default());
        let mesh =
            Mesh { positions: body.positions.clone(), triangles: body.triangles.clone(), ..Mesh::default() };
        builder.mesh(mesh, &DAffine3::IDENTITY, material, Shading::Flat)?;
        let scene = builder.finish(SceneHeader::default());
        check_frame(&name, &scene, body)?;
        let surfaces = &scene.surfaces;
        let triangles = (0..surfaces.triangles.len() as u32).map(|id| surfaces.triangle(id)).collect();
        let stored = Body { positions: surfaces.positions.to_vec(), triangles: body.triangles.clone() };
        // Triangles that have lost their area are no surface: where they lie their neighbours have edges of their own.
        let solid = stored.triangles.iter().filter(|t| has_area(&t.map(|v| stored.positions[v as usize])));
        let border = Body { triangles: solid.copied().collect(), ..stored.clone() }.border();
        let court = Court { referee: Referee::new(triangles), border };
        Ok(Bench { scene, court, world: Target::new(body), stored })
    }

    /// Aims, traces and judges a range of rays. The first tracer is judged; the others must say the same.
    pub fn run(
        &self,
        tracers: &[&dyn Tracer],
        seed: u64,
        number: u64,
        indices: std::ops::Range<u64>,
    ) -> Tally {
        let stored = Target::new(&self.stored);
        let mut tally = Tally::default();
        for index in indices {
            let (judged, differs) = self.try_ray(tracers, &stored, Dice::new([seed, number, index]), index);
            tally.count(index, &judged, differs);
        }
        tally
    }

    fn try_ray(
        &self,
        tracers: &[&dyn Tracer],
        stored: &Target,
        mut dice: Dice,
        index: u64,
    ) -> (Judged, bool) {
        let frame = &self.scene.header.frame;
        // Every other ray starts on the surface that an aimed ray has found.
        let spawn = index % 2 == 1;
        let aim = Aim::ALL[((index / 2) % Aim::ALL.len() as u64) as usize];
        let (world_origin, direction) = self.world.ray(aim, &mut dice);
        // As a camera comes into the scene.
        let record = RayRecord::camera(frame.to_stored(world_origin), direction, 0, 0, 0);
        let answer = tracers[0].closest(&record.ray());
        if !spawn || !answer.is_hit() {
            let ray = ExactRay::new(
                dyadic::minus(&exact(world_origin.to_array()), &exact(frame.shift.to_array()))
                    .map(|c| c.times(&Dyadic::new(frame.scale))),
                direction,
            );
            let mut judged = self.court.judge(&ray, found(&answer));
            self.judge_point(&mut judged, &ray, &record, &answer);
            return (judged, differs(tracers, &record.ray(), &answer, &mut dice));
        }
        // As light goes on from a hit.
        let hit = Interaction::new(&self.scene, &record, &answer);
        let onward = stored.onward(hit.primitive, hit.position, direction, &mut dice);
        let record = record.onward(hit.position, hit.primitive, onward, Query::Closest, Origin::Reflection);
        let second = tracers[0].closest(&record.ray());
        let uv = [answer.u, answer.v];
        let mut judged = self.court.judge_spawned(answer.primitive, uv, onward, found(&second));
        // The rounding of the start is in it: no measure of how exactly t is found.
        judged.error = None;
        (judged, differs(tracers, &record.ray(), &second, &mut dice))
    }

    /// Where light goes on must be where the ray has come.
    fn judge_point(&self, judged: &mut Judged, ray: &ExactRay, record: &RayRecord, answer: &Answer) {
        if !answer.is_hit() || !matches!(judged.verdict, Verdict::Right | Verdict::TooClose) {
            return;
        }
        let point = Interaction::new(&self.scene, record, answer).position;
        let inside = answer.u >= 0.0 && answer.v >= 0.0 && answer.u <= 1.0 && answer.v <= 1.0;
        if !inside || !self.court.referee.holds_point(ray, answer.primitive, point, 0.0) {
            judged.verdict = Verdict::FalseHit;
        }
    }
}

/// Traces a body's rays, this rank's share of them. Runs on the current rayon pool and tells `done` how many rays more it has
/// judged.
///
/// # Errors
/// As [`Bench::new`].
pub fn run(
    subject: &Subject,
    number: usize,
    rays: u64,
    plan: &Plan,
    rank: usize,
    size: usize,
    done: impl Fn(u64) + Sync,
) -> Result<Tally> {
    if rays == 0 {
        return Ok(Tally::default());
    }
    let bench = Bench::new(subject)?;
    let structures: Vec<Structure> = plan
        .accels
        .iter()
        .map(|&kind| Structure {
            accel: Accel::build(kind, plan.build, &bench.scene.surfaces),
            scene: &bench.scene,
        })
        .collect();
    let packets: Vec<Packets> =
        structures.iter().filter(|structure| matches!(structure.accel, Accel::Bvh(_))).map(Packets).collect();
    let tracers: Vec<&dyn Tracer> = structures
        .iter()
        .map(|structure| structure as &dyn Tracer)
        .chain(packets.iter().map(|packets| packets as &dyn Tracer))
        .collect();
    let chunks = rays.div_ceil(CHUNK);
    Ok((0..chunks)
        .into_par_iter()
        .filter(|chunk| chunk % size as u64 == rank as u64)
        .map(|chunk| {
            let indices = chunk * CHUNK..rays.min((chunk + 1) * CHUNK);
            let tally = bench.run(&tracers, plan.seed, number as u64, indices);
            done(tally.rays);
            tally
        })
        .reduce(Tally::default, |mut sum, part| {
            sum.merge(&part);
            sum
        }))
}

fn found(answer: &Answer) -> Option<(u32, f64)> {
    answer.is_hit().then_some((answer.primitive, answer.t))
}

/// Whether another tracer answers differently by a single bit, or one's "occluded" doesn't fit its "closest".
fn differs(tracers: &[&dyn Tracer], ray: &Ray, answer: &Answer, dice: &mut Dice) -> bool {
    let bits = |a: &Answer| (a.primitive, a.t.to_bits(), a.u.to_bits(), a.v.to_bits());
    // Up to the hit, up to just before it, or somewhere. What a denormal number says in one unit of t it can't say in another.
    let limit = match dice.below(3) {
        _ if answer.t < 4.0 * f64::MIN_POSITIVE => f64::MIN_POSITIVE * 8.0,
        0 => answer.t,
        1 => answer.t.next_down(),
        _ => answer.t.min(f64::MAX) * (2.0 * dice.unit()),
    };
    let occluded = limit >= answer.t && answer.is_hit();
    // As a shadow ray goes on through what is transparent.
    let beyond = Ray { t_min: answer.t, first_id: answer.primitive.wrapping_add(1), ..*ray };
    let onward = (answer.is_hit() && dice.below(4) == 0).then(|| bits(&tracers[0].closest(&beyond)));
    tracers.iter().enumerate().any(|(which, tracer)| {
        let disagrees = || {
            bits(&tracer.closest(ray)) != bits(answer)
                || onward.is_some_and(|onward| bits(&tracer.closest(&beyond)) != onward)
        };
        (which > 0 && disagrees())
            || (limit >= 0.0 && tracer.occluded(&Ray { t_max: limit, ..*ray }) != occluded)
    })
}

/// The frame's promise: stored vertices are the world's, without any rounding.
fn check_frame(name: &str, scene: &Scene, body: &Body) -> Result<()> {
    let frame = &scene.header.frame;
    let shift = exact(frame.shift.to_array());
    for (index, (world, stored)) in body.positions.iter().zip(&scene.surfaces.positions).enumerate() {
        let wanted =
            dyadic::minus(&exact(world.map(f64::from)), &shift).map(|c| c.times(&Dyadic::new(frame.scale)));
        let off = dyadic::minus(&wanted, &exact(stored.map(f64::from)));
        // What falls below f32's least number can't be kept.
        let lost = |c: &Dyadic| c.approximate().abs() > f64::from(f32::from_bits(1));
        if off.iter().any(|c| c.sign() != 0 && lost(c)) {
            let point = DVec3::from(world.map(f64::from));
            return Err(Error::Inexact(format!("{name}: vertex {index} at {point} isn't stored exactly")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

    use super::*;

    fn subject(shape: &str, place: &str) -> Subject {
        let found = generated().into_iter().find(|subject| subject.shape == shape && subject.place == place);
        found.expect("a generated body")
    }

    /// Möller and Trumbore 1997 in f32 with a tuned epsilon, as in textbooks.
    struct Textbook<'a>(&'a Scene);

    impl Textbook<'_> {
        fn meet(&self, ray: &Ray, id: u32) -> Option<f32> {
            use glam::Vec3;
            let [a, b, c] = self.0.surfaces.triangle(id).map(Vec3::from);
            let (origin, direction) = (ray.origin.as_vec3(), ray.direction.as_vec3());
            let (e1, e2) = (b - a, c - a);
            let p = direction.cross(e2);
            let determinant = e1.dot(p);
            if determinant.abs() < 1e-7 {
                return None;
            }
            let from = origin - a;
            let u = from.dot(p) / determinant;
            let q = from.cross(e1);
            let v = direction.dot(q) / determinant;
            let t = e2.dot(q) / determinant;
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-6).then_some(t)
        }
    }

    impl Tracer for Textbook<'_> {
        fn closest(&self, ray: &Ray) -> Answer {
            let ids = 0..self.0.surfaces.triangles.len() as u32;
            let hits = ids.filter_map(|id| Some((self.meet(ray, id)?, id)));
            match hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((t, primitive)) => Answer { t: f64::from(t), primitive, ..Answer::MISS },
                None => Answer::MISS,
            }
        }

        fn occluded(&self, ray: &Ray) -> bool {
            self.closest(ray).t <= ray.t_max
        }
    }

    #[test]
    fn a_textbook_tracer_is_found_out() {
        let subject = subject("icosphere", "as it is");
        let bench = Bench::new(&subject).unwrap();
        let tally = bench.run(&[&Textbook(&bench.scene)], 0, 0, 0..2000);
        assert!(tally.leaks > 0, "{tally:?}");
        assert!(tally.misses + tally.skipped + tally.false_hits > 100, "{tally:?}");
    }

    #[test]
    fn a_tracer_without_a_rule_for_starts_is_found_out() {
        struct Forgetful<'a>(Structure<'a>);
        impl Tracer for Forgetful<'_> {
            fn closest(&self, ray: &Ray) -> Answer {
                self.0.closest(&Ray { start: crate::geometry::NONE, ..*ray })
            }
            fn occluded(&self, ray: &Ray) -> bool {
                self.0.occluded(&Ray { start: crate::geometry::NONE, ..*ray })
            }
        }
        let subject = subject("bumpy", "as it is");
        let bench = Bench::new(&subject).unwrap();
        let tracer = Forgetful(Structure { accel: Accel::Brute, scene: &bench.scene });
        let tally = bench.run(&[&tracer], 0, 0, 0..2000);
        assert!(tally.self_hits > 100, "{tally:?}");
    }

    #[test]
    fn every_wrong_answer_has_its_verdict() {
        let subject = subject("torus", "as it is");
        let bench = Bench::new(&subject).unwrap();
        let court = &bench.court;
        // Through the ring from above: four surfaces.
        let ray = ExactRay::plain(DVec3::new(0.31, 5.0, 0.17), DVec3::NEG_Y);
        let mut met = court.referee.meetings(&ray);
        met.retain(|meeting| meeting.ahead());
        met.sort_by(|a, b| a.order(b));
        let verdict = |found| court.judge(&ray, found).verdict;
        assert_eq!(met.len() % 2, 0);
        let (near, far) = (&met[0], &met[met.len() - 1]);
        assert_eq!(verdict(Some((near.primitive, near.t))), Verdict::Right);
        assert_eq!(verdict(Some((near.primitive, near.t + 1e-9))), Verdict::FalseHit);
        assert_eq!(verdict(Some((near.primitive ^ 64, near.t))), Verdict::FalseHit);
        assert_eq!(verdict(Some((far.primitive, far.t))), Verdict::Skipped);
        assert_eq!(verdict(None), Verdict::Miss);
    }

    #[test]
    fn the_renderer_passes_and_any_division_gives_the_same() {
        let plan = Plan {
            rays: 2000,
            seed: 7,
            accels: vec![AccelKind::Bvh, AccelKind::Brute],
            build: BuildPreset::Best,
        };
        for subject in
            [subject("saddles", "as it is"), subject("dust", "scaled 1e-6"), subject("box", "moved 1e4")]
        {
            let whole = run(&subject, 3, plan.rays, &plan, 0, 1, |_| ()).unwrap();
            assert_eq!(whole.rays, plan.rays);
            assert_eq!(whole.wrong(), 0, "{} {}: {whole:?}", subject.shape, subject.place);
            assert!(whole.ulps.quantile(0.999) <= 1.0, "{whole:?}");
            let mut parts = Tally::default();
            let counted = AtomicU64::new(0);
            for rank in 0..3 {
                let count = |rays| _ = counted.fetch_add(rays, Relaxed);
                parts.merge(&run(&subject, 3, plan.rays, &plan, rank, 3, count).unwrap());
            }
            assert_eq!(parts, whole);
            assert_eq!(counted.into_inner(), whole.rays);
        }
    }
}
