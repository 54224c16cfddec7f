//! Rays from a file, answers into a file: the tracer as others can judge it, without a picture between.
//!
//! A mesh comes in as for rendering ([`obj`], [`SceneBuilder`], so in the same exact frame), rays are the same
//! [`RayRecord`]s, hits come from [`Accel::closest`], onward rays start at [`Surfaces::position`](crate::scene::Surfaces::position)
//! as bounces and shadow rays do, and a chain goes on as light through transparent surfaces does. [`FORMATS`] describes
//! the files. Knows no flag.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::geometry::{NONE, Prepared, Ray, sphere};
use crate::output::file;
use crate::scene::build::SceneBuilder;
use crate::scene::frame::power_of_two;
use crate::scene::load::obj;
use crate::scene::load::texture::Textures;
use crate::scene::{Material, Scene, SceneHeader, Shading};
use crate::settings::{AccelKind, BuildPreset};

/// The formats of all files, for people.
pub const FORMATS: &str = "\
Files are plain records without a header, numbers little endian, one answer for
each record, in their order.

  rays     in   f32[8]    origin xyz, tmin, direction xyz, tmax
           out  i32, f32  primitive, t
           The first surface with tmin <= t <= tmax.
  spawn    in   f32[11]   origin xyz, tmin, direction xyz, tmax, w xyz
           out  i32, f32, i32, f32   primitive, t, second primitive, second t
           As rays; then from the exact hit point along w, as reflected,
           refracted and shadow rays start: not to the surface they start on,
           and without an upper bound. The second t is in units of w.
  chain    in   f32[8]    as rays
           out  i32[4]    hits, distinct floor(primitive / 2), repeats, 0
           Straight on through every surface from tmin to tmax. Surfaces at
           the same t come in order of their numbers. Repeats are hits beyond
           the first of a primitive.
  spheres  in   f64[11]   centre xyz, radius, origin xyz, direction xyz, tmin
           out  f64       t, or -1 for a miss
           The first crossing with tmin <= t. Needs no mesh; --accel changes
           nothing.

Primitives are triangles, counted from 0 in the order of the file; a polygon is
a fan of triangles from its first corner. Triangles without area are never hit
but keep their numbers.

A miss is primitive -1 and t = +inf. t is measured in units of the direction,
which may have any length but 0. It is computed in f64 and rounded to the
nearest f32 (beyond f32's range to +inf).

tmin may be negative: then surfaces behind the origin count; tmin and tmax may
be infinite. Everything misses where an origin, direction, centre or radius is
not finite, a direction is 0 0 0, a radius is not above 0, tmin or tmax is NaN,
or tmin > tmax.";

/// Records that are read, answered and written at once.
const CHUNK: usize = 1 << 16;
/// Records that a thread answers without looking for help.
const STRIDE: usize = 64;

/// What is asked about the rays of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Question {
    /// The first surface that each ray meets
    Rays,
    /// The first surface, and the next one from there along another direction
    Spawn,
    /// All surfaces along each ray
    Chain,
    /// Where each ray meets a sphere of its own
    Spheres,
}

/// A mesh ready to be asked.
#[derive(Debug)]
pub struct Target {
    scene: Scene,
    accel: Accel,
}

/// A hit: a triangle in order of the file, or -1, and t, or +inf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub primitive: i32,
    /// In units of the ray's direction.
    pub t: f32,
}

/// All hits along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Chain {
    pub hits: i32,
    /// Distinct values of primitive / 2, rounded down.
    pub pairs: i32,
    /// Hits beyond the first of a primitive.
    pub repeats: i32,
}

impl Target {
    /// Reads an OBJ file; also gives one line for each oddity in it.
    ///
    /// # Errors
    /// As [`obj::read`] and [`SceneBuilder::mesh`].
    pub fn load(mesh: &Path, accel: AccelKind, build: BuildPreset) -> Result<(Target, Vec<String>)> {
        let file = obj::read(mesh, &mut Textures::default())?;
        let mut builder = SceneBuilder::new(mesh);
        let material = builder.material(Material::default());
        for (mesh, _) in file.meshes {
            builder.mesh(mesh, &DAffine3::IDENTITY, material, Shading::Flat)?;
        }
        let scene = builder.finish(SceneHeader::default());
        let accel = Accel::build(accel, build, &scene.surfaces);
        Ok((Target { scene, accel }, file.warnings))
    }

    /// The first hit of a ray: origin, tmin, direction, tmax.
    pub fn closest(&self, ray: &[f32; 8]) -> Hit {
        Hit::of(&self.record(ray).map_or(Answer::MISS, |record| self.trace(&record)))
    }

    /// The first hit of a ray, and the first from there along a second direction.
    pub fn spawn(&self, ray: &[f32; 11]) -> [Hit; 2] {
        let [first @ .., wx, wy, wz] = ray;
        let Some(record) = self.record(first) else { return [Hit::MISS; 2] };
        let answer = self.trace(&record);
        let second = match self.stored_direction([*wx, *wy, *wz]) {
            Some(direction) if answer.is_hit() => {
                let from = self.scene.surfaces.position(&record, &answer);
                let onward =
                    record.onward(from, answer.primitive, direction, Query::Closest, Origin::Reflection);
                self.trace(&onward)
            }
            _ => Answer::MISS,
        };
        [Hit::of(&answer), Hit::of(&second)]
    }

    /// All hits along a ray. `primitives` is overwritten with them in ascending order.
    pub fn chain(&self, ray: &[f32; 8], primitives: &mut Vec<u32>) -> Chain {
        primitives.clear();
        let Some(mut record) = self.record(ray) else { return Chain::default() };
        // Hits ascend in (t, primitive), and each primitive has one t: one more than there are would be a fault, which ends here as a
        // repeat.
        while primitives.len() <= self.scene.surfaces.len() {
            let answer = self.trace(&record);
            if !answer.is_hit() {
                break;
            }
            primitives.push(answer.primitive);
            record = record.beyond(&answer);
        }
        primitives.sort_unstable();
        let distinct = |of: fn(u32) -> u32| primitives.chunk_by(|&a, &b| of(a) == of(b)).count() as i32;
        let hits = primitives.len() as i32;
        Chain { hits, pairs: distinct(|id| id / 2), repeats: hits - distinct(|id| id) }
    }

    fn trace(&self, record: &RayRecord) -> Answer {
        self.accel.closest(&self.scene.surfaces, &record.ray())
    }

    /// A world-space ray in stored space; `None` if it can't meet anything.
    fn record(&self, ray: &[f32; 8]) -> Option<RayRecord> {
        let [ox, oy, oz, t_min, dx, dy, dz, t_max] = *ray;
        let origin = DVec3::from([ox, oy, oz].map(f64::from));
        let direction = self.stored_direction([dx, dy, dz])?;
        if !origin.is_finite() || t_min.is_nan() || t_max.is_nan() {
            return None;
        }
        let origin = self.scene.header.frame.to_stored(origin);
        let mut record = RayRecord::camera(origin, direction, 0, 0, 0);
        (record.t_min, record.t_max) = (f64::from(t_min), f64::from(t_max));
        Some(record)
    }

    /// Scaled with the scene, so that t stays as it is; `None` for no direction.
    fn stored_direction(&self, direction: [f32; 3]) -> Option<DVec3> {
        let direction = DVec3::from(direction.map(f64::from));
        (direction.is_finite() && direction != DVec3::ZERO).then(|| direction * self.scene.header.frame.scale)
    }
}

impl Hit {
    const MISS: Hit = Hit { primitive: -1, t: f32::INFINITY };

    fn of(answer: &Answer) -> Hit {
        if answer.is_hit() {
            Hit { primitive: answer.primitive as i32, t: answer.t as f32 }
        } else {
            Hit::MISS
        }
    }

    fn bytes(self) -> [u8; 8] {
        joined(&[self.primitive.to_le_bytes(), self.t.to_le_bytes()])
    }
}

/// The first t >= tmin at which a ray meets a sphere, or -1: centre, radius, origin, direction, tmin.
pub fn sphere(record: &[f64; 11]) -> f64 {
    let [cx, cy, cz, radius, ox, oy, oz, dx, dy, dz, t_min] = *record;
    let direction = DVec3::new(dx, dy, dz);
    let finite = record[..10].iter().all(|number| number.is_finite());
    if !finite || radius <= 0.0 || direction == DVec3::ZERO || t_min.is_nan() {
        return -1.0;
    }
    // As scenes are stored: scaled exactly to where no square leaves f64's range.
    let largest = record[..7].iter().fold(0.0, |largest: f64, number| largest.max(number.abs()));
    let scale = power_of_two(-(libm::ilogb(largest) + 1));
    let ray = Prepared::new(&Ray {
        origin: DVec3::new(ox, oy, oz) * scale,
        direction,
        t_min: t_min * scale,
        t_max: f64::INFINITY,
        first_id: 0,
        start: NONE,
    });
    match sphere::first(&ray, [cx, cy, cz].map(|c| c * scale), radius * scale, 0) {
        Some(t) => t * ray.scale / scale,
        None => -1.0,
    }
}

/// Answers a question about every record of `input` into `output`, which is written whole or not at all. The bytes are the same for any
/// number of threads; memory is constant but for the mesh. `target` is what the rays meet; [`Question::Spheres`] needs none.
///
/// # Errors
/// A missing target, files that can't be read or written, an input that isn't a whole number of records.
pub fn answer(question: Question, target: Option<&Target>, input: &Path, output: &Path) -> Result<()> {
    match (question, target) {
        (Question::Spheres, _) => {
            stream(input, output, || (), |(), record: &[u8; 88]| sphere(&doubles(record)).to_le_bytes())
        }
        (Question::Rays, Some(target)) => {
            stream(input, output, || (), |(), record: &[u8; 32]| target.closest(&singles(record)).bytes())
        }
        (Question::Spawn, Some(target)) => stream(
            input,
            output,
            || (),
            |(), record: &[u8; 44]| -> [u8; 16] { joined(&target.spawn(&singles(record)).map(Hit::bytes)) },
        ),
        (Question::Chain, Some(target)) => {
            stream(input, output, Vec::new, |primitives, record: &[u8; 32]| {
                let chain = target.chain(&singles(record), primitives);
                let words = [chain.hits, chain.pairs, chain.repeats, 0].map(i32::to_le_bytes);
                let bytes: [u8; 16] = joined(&words);
                bytes
            })
        }
        (_, None) => Err(Error::usage("--mesh", "missing", "name the OBJ file that the rays meet")),
    }
}

/// Maps records of `IN` bytes to answers of `OUT` bytes, chunk by chunk. `scratch` is made once for a run of records.
fn stream<S: Send, const IN: usize, const OUT: usize>(
    input: &Path,
    output: &Path,
    scratch: impl Fn() -> S + Sync + Send,
    answer: impl Fn(&mut S, &[u8; IN]) -> [u8; OUT] + Sync + Send,
) -> Result<()> {
    let unreadable = |source| Error::read(input, source);
    let reader = File::open(input).map_err(unreadable)?;
    // Known now for a plain file; a pipe tells at its end.
    let metadata = reader.metadata().map_err(unreadable)?;
    if metadata.is_file() {
        whole_records(input, metadata.len(), IN)?;
    }
    let mut records = Vec::new();
    let mut answers: Vec<[u8; OUT]> = std::iter::repeat_n([0; OUT], CHUNK).collect();
    let next_chunk = |records: &mut Vec<u8>| {
        records.clear();
        (&reader).take((IN * CHUNK) as u64).read_to_end(records).map_err(unreadable)?;
        whole_records(input, records.len() as u64, IN)
    };
    let mut unread = None;
    let written = file::write_whole(output, |out| {
        loop {
            if let Err(error) = next_chunk(&mut records) {
                unread = Some(error);
                return Err(std::io::ErrorKind::Other.into());
            }
            let chunk = records.as_chunks::<IN>().0;
            if chunk.is_empty() {
                return Ok(());
            }
            let answers = &mut answers[..chunk.len()];
            (chunk, &mut *answers)
                .into_par_iter()
                .with_min_len(STRIDE)
                .for_each_init(&scratch, |scratch, (record, place)| *place = answer(scratch, record));
            out.write_all(answers.as_flattened())?;
        }
    });
    unread.map_or(written, Err)
}

fn whole_records(input: &Path, bytes: u64, record: usize) -> Result<()> {
    if bytes.is_multiple_of(record as u64) {
        return Ok(());
    }
    Err(Error::scene(
        input,
        None,
        format!("{bytes} bytes are no whole number of records of {record} bytes"),
        "write each record whole; `heliostat probe --help` describes them",
    ))
}

/// `N` numbers from 4 N bytes.
fn singles<const N: usize>(bytes: &[u8]) -> [f32; N] {
    let words = bytes.as_chunks().0;
    std::array::from_fn(|k| f32::from_le_bytes(words[k]))
}

/// `N` numbers from 8 N bytes.
fn doubles<const N: usize>(bytes: &[u8]) -> [f64; N] {
    let words = bytes.as_chunks().0;
    std::array::from_fn(|k| f64::from_le_bytes(words[k]))
}

/// All parts one after the other; `N` is their length together.
fn joined<const PART: usize, const N: usize>(parts: &[[u8; PART]]) -> [u8; N] {
    let mut whole = [0; N];
    whole.copy_from_slice(parts.as_flattened());
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::mesh::Mesh;

    /// Triangles as they come, in their order.
    fn target(triangles: &[[[f32; 3]; 3]]) -> Target {
        let mesh = Mesh {
            positions: triangles.as_flattened().to_vec(),
            triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Mesh::default()
        };
        let mut builder = SceneBuilder::new(Path::new("test"));
        builder.mesh(mesh, &DAffine3::IDENTITY, 0, Shading::Flat).unwrap();
        let scene = builder.finish(SceneHeader::default());
        let accel = Accel::build(AccelKind::Bvh, BuildPreset::Balanced, &scene.surfaces);
        Target { scene, accel }
    }

    /// A triangle in the plane z = height over the points with x, y >= 0 and x + y <= 3.
    fn floor(height: f32) -> [[f32; 3]; 3] {
        [[0.0, 0.0, height], [3.0, 0.0, height], [0.0, 3.0, height]]
    }

    #[test]
    fn t_is_the_nearest_f32_to_that_of_f64() {
        let mut rounded = [0; 2];
        for height in (1..200).map(|n| n as f32) {
            let target = target(&[floor(height)]);
            for steps in [3.0f32, 7.0, 11.0, 0.3] {
                // The quotient of two f32 numbers is no f32 number, nor half-way between two.
                let hit = target.closest(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, steps, f32::INFINITY]);
                let exact = f64::from(height) / f64::from(steps);
                let error = (f64::from(hit.t) - exact).abs();
                for other in [hit.t.next_up(), hit.t.next_down()] {
                    assert!(error <= (f64::from(other) - exact).abs(), "{height} / {steps}: {}", hit.t);
                }
                if f64::from(hit.t) != exact {
                    rounded[usize::from(f64::from(hit.t) > exact)] += 1;
                }
            }
        }
        assert!(rounded.iter().all(|&count| count > 50), "rounded down and up: {rounded:?}");
    }

    #[test]
    fn far_and_tiny_meshes_answer_in_the_rays_own_units() {
        for (factor, offset) in [(1.0, 0.0), (f32::MIN_POSITIVE * 1e3, 0.0), (1e30, 0.0), (1.0, 4096.0)] {
            let world = |point: [f32; 3]| point.map(|c| c * factor + offset);
            let target = target(&[floor(2.0).map(world), floor(3.0).map(world)]);
            let [x, y, z] = world([1.0, 1.0, 0.0]);
            for length in [1.0f32, 0.5, 1e-30] {
                let found = target.closest(&[x, y, z, 0.0, 0.0, 0.0, length, f32::INFINITY]);
                let exact = f64::from(2.0 * factor) / f64::from(length);
                assert_eq!(found, Hit { primitive: 0, t: exact as f32 }, "{factor} {offset} {length}");
            }
            let up = [0.0, 0.0, factor];
            let [first, second] =
                target.spawn(&[x, y, z, 0.0, 0.0, 0.0, factor, f32::INFINITY, up[0], up[1], up[2]]);
            // Three times the factor need not be an f32 number.
            let [low, high] = [2.0, 3.0].map(|z| f64::from(world([0.0, 0.0, z])[2]));
            let step = ((high - low) / f64::from(factor)) as f32;
            assert_eq!((first.primitive, first.t, second.primitive, second.t), (0, 2.0, 1, step), "{factor}");
        }
    }

    #[test]
    fn chains_end_and_count_duplicates_once_each() {
        let stack = [floor(1.0), floor(1.0), floor(1.0), floor(2.0), floor(5.0), floor(2.0)];
        let target = target(&stack);
        let chain = |t_min: f32, t_max: f32| {
            let mut primitives = vec![99];
            let counted = target.chain(&[1.0, 1.0, 0.0, t_min, 0.0, 0.0, 1.0, t_max], &mut primitives);
            (counted.hits, counted.pairs, counted.repeats, primitives)
        };
        assert_eq!(chain(0.0, f32::INFINITY), (6, 3, 0, vec![0, 1, 2, 3, 4, 5]));
        assert_eq!(chain(1.0, 2.0), (5, 3, 0, vec![0, 1, 2, 3, 5]));
        assert_eq!(chain(1.5, 3.0), (2, 2, 0, vec![3, 5]));
        assert_eq!(chain(6.0, 7.0), (0, 0, 0, vec![]));
    }

    #[test]
    fn what_is_no_ray_misses() {
        let target = target(&[floor(1.0)]);
        let good = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, f32::INFINITY, 0.0, 0.0, 1.0];
        assert_eq!(target.spawn(&good)[0], Hit { primitive: 0, t: 1.0 });
        let mut broken: Vec<[f32; 11]> = Vec::new();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            broken.extend(
                [0, 1, 2, 4, 5, 6].map(|k| std::array::from_fn(|i| if i == k { bad } else { good[i] })),
            );
        }
        for (k, bad) in [(3, f32::NAN), (3, f32::INFINITY), (7, f32::NAN), (7, -1.0), (6, 0.0), (6, -0.0)] {
            broken.push(std::array::from_fn(|i| if i == k { bad } else { good[i] }));
        }
        for ray in broken {
            let [first @ .., _, _, _] = &ray;
            assert_eq!(target.closest(first), Hit::MISS, "{ray:?}");
            assert_eq!(target.spawn(&ray), [Hit::MISS; 2], "{ray:?}");
            assert_eq!(target.chain(first, &mut Vec::new()), Chain::default(), "{ray:?}");
        }
        for bad in [f32::NAN, f32::INFINITY, 0.0] {
            let ray = std::array::from_fn(|i| if i == 10 { bad } else { good[i] });
            assert_eq!(target.spawn(&ray), [Hit { primitive: 0, t: 1.0 }, Hit::MISS], "w = {bad}");
        }
    }

    #[test]
    fn ranges_are_inclusive_and_may_lie_behind() {
        let target = target(&[floor(1.0)]);
        let hit = |z: f32, t_min: f32, t_max: f32| {
            target.closest(&[1.0, 1.0, z, t_min, 0.0, 0.0, 1.0, t_max]).primitive == 0
        };
        assert!(hit(0.0, 1.0, 1.0) && hit(1.0, 0.0, 0.0) && hit(1.0, -0.0, 0.0));
        assert!(!hit(0.0, 1.0f32.next_up(), 2.0) && !hit(0.0, 0.0, 1.0f32.next_down()));
        assert!(hit(3.0, -2.0, -2.0) && hit(3.0, f32::NEG_INFINITY, f32::INFINITY) && !hit(3.0, 0.0, 9.0));
    }

    #[test]
    fn spheres_near_far_inside_and_behind() {
        let at = |z: f64, t_min: f64| sphere(&[0.0, 0.0, 5.0, 1.0, 0.0, 0.0, z, 0.0, 0.0, 2.0, t_min]);
        assert_eq!([at(0.0, 0.0), at(0.0, 2.0), at(0.0, 2.5), at(0.0, 3.5)], [2.0, 2.0, 3.0, -1.0]);
        assert_eq!([at(5.0, 0.0), at(9.0, 0.0), at(9.0, -9.0)], [0.5, -1.0, -2.5]);
    }

    #[test]
    fn spheres_of_any_size_and_what_is_none() {
        for size in [1e-300, 1e-30, 1.0, 1e30, 1e300] {
            let record = [0.0, 0.0, 4.0 * size, size, 0.0, 0.0, 0.0, 0.0, 0.0, size, 0.0];
            assert!((sphere(&record) - 3.0).abs() < 1e-15, "{size}: {}", sphere(&record));
        }
        let good = [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(sphere(&good), 4.0);
        for (k, bad) in [(3, 0.0), (3, -1.0), (9, 0.0), (10, f64::NAN), (10, f64::INFINITY)]
            .into_iter()
            .chain((0..10).flat_map(|k| [(k, f64::NAN), (k, f64::INFINITY)]))
        {
            let record = std::array::from_fn(|i| if i == k { bad } else { good[i] });
            assert_eq!(sphere(&record), -1.0, "{bad} at {k}");
        }
    }
}
