//! What threads gain that divide a process' rays or its triangles among themselves, against one thread: the same camera rays at a field of tessellated spheres, whatever structure answers.

use std::path::Path;
use std::time::Instant;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::geometry::record::{Answer, RayRecord};
use crate::scene::build::SceneBuilder;
use crate::scene::generate::icosphere::icosphere;
use crate::scene::{Camera, Material, Scene, SceneHeader, Shading};
use crate::settings::{AccelKind, BuildSettings};

/// Rays that are answered at once, and an edge of the tiles that they come from: as in a render.
const BATCH: usize = 1024;
const TILE: u32 = 32;
/// To foretell the time of all rays: how many are traced at first, how often, and how long that must take to be believed.
const LOOK: usize = 16;
const LOOKS: usize = 3;
const LOOK_SECONDS: f64 = 0.004;

/// How threads divide the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// They don't: one thread does all.
    Single,
    /// Each tests all rays against its part of the triangles.
    Triangles,
    /// Each tests its part of the rays against all triangles.
    Rays,
}

impl Strategy {
    pub const ALL: [Strategy; 3] = [Strategy::Single, Strategy::Triangles, Strategy::Rays];

    pub fn name(self) -> &'static str {
        match self {
            Strategy::Single => "single",
            Strategy::Triangles => "over triangles",
            Strategy::Rays => "over rays",
        }
    }
}

/// Tessellated spheres side by side, and the camera rays of a fixed view of them.
#[derive(Debug)]
pub struct Field {
    scene: Scene,
    records: Vec<RayRecord>,
}

impl Field {
    /// `objects` icospheres of `level`, seen by `side` * `side` rays, each of them 1 to 4096.
    ///
    /// # Errors
    /// More triangles than can be numbered.
    pub fn new(objects: u32, level: u32, side: u32) -> Result<Field> {
        let mut builder = SceneBuilder::new(Path::new("field of spheres"));
        let material = builder.material(Material::default());
        let columns = f64::from(objects).sqrt().ceil() as u32;
        let rows = objects.div_ceil(columns);
        for number in 0..objects {
            let (column, row) = (number % columns, number / columns);
            let middle = |place: u32, places: u32| f64::from(place) - 0.5 * f64::from(places - 1);
            // Staggered in depth, so that some hide others.
            let depth = f64::from(number * 7 % objects) / f64::from(objects) - 0.5;
            let center = DVec3::new(middle(column, columns), middle(row, rows), depth * 3.0);
            builder.mesh(icosphere(level, center, 0.47), &DAffine3::IDENTITY, material, Shading::Flat)?;
        }
        let eye = DVec3::new(0.6, 0.9, 3.0) * f64::from(columns.max(2));
        let camera = Camera::perspective(eye, DVec3::ZERO, DVec3::Y, 24.0)
            .ok_or_else(|| Error::usage("--objects", "no view of them", "give fewer"))?;
        let scene = builder.finish(SceneHeader { camera, ..SceneHeader::default() });
        let tiles = side.div_ceil(TILE);
        let pixels = (0..tiles * tiles).flat_map(|tile| {
            let (x0, y0) = (tile % tiles * TILE, tile / tiles * TILE);
            let columns = x0..(x0 + TILE).min(side);
            (y0..(y0 + TILE).min(side)).flat_map(move |y| columns.clone().map(move |x| (x, y)))
        });
        let records = pixels
            .map(|(x, y)| {
                let size = f64::from(side);
                let (origin, direction) =
                    scene.header.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5, size, size, [0.5; 2]);
                RayRecord::camera(origin, direction, y * side + x, 0, 0)
            })
            .collect();
        Ok(Field { scene, records })
    }

    pub fn triangles(&self) -> usize {
        self.scene.surfaces.len()
    }

    pub fn rays(&self) -> usize {
        self.records.len()
    }

    /// The structure as a strategy needs it. On the current rayon pool.
    pub fn build(&self, kind: AccelKind, strategy: Strategy) -> Accel {
        let surfaces = &self.scene.surfaces;
        match strategy {
            Strategy::Triangles => {
                Accel::divide(kind, BuildSettings::default(), surfaces, rayon::current_num_threads())
            }
            Strategy::Single | Strategy::Rays => Accel::build(kind, BuildSettings::default(), surfaces),
        }
    }

    /// Traces all rays once on the current rayon pool: seconds, and a sum over all answers that no order of rays or triangles changes.
    pub fn round(&self, accel: &Accel, strategy: Strategy) -> (f64, u64) {
        let start = Instant::now();
        let digest = self.trace(accel, strategy, &self.records);
        (start.elapsed().as_secs_f64(), digest)
    }

    /// Seconds that a round will take, from rays picked evenly. The least of several looks, as other work may come between.
    pub fn foretell(&self, accel: &Accel, strategy: Strategy) -> f64 {
        let mut picked = LOOK.min(self.records.len());
        loop {
            let records: Vec<RayRecord> =
                (0..picked).map(|k| self.records[k * self.records.len() / picked]).collect();
            let look = |_| {
                let start = Instant::now();
                std::hint::black_box(self.trace(accel, strategy, &records));
                start.elapsed().as_secs_f64()
            };
            let seconds = (0..LOOKS).map(look).fold(f64::INFINITY, f64::min);
            if seconds > LOOK_SECONDS || picked == self.records.len() {
                return seconds * self.records.len() as f64 / picked as f64;
            }
            picked = (4 * picked).min(self.records.len());
        }
    }

    fn trace(&self, accel: &Accel, strategy: Strategy, records: &[RayRecord]) -> u64 {
        let batch = |answers: &mut Vec<Answer>, records: &[RayRecord]| {
            accel.trace(&self.scene.surfaces, records, answers);
            records
                .iter()
                .zip(answers)
                .map(|(record, answer)| mixed(record, answer))
                .fold(0, u64::wrapping_add)
        };
        match strategy {
            Strategy::Rays => {
                records.par_chunks(BATCH).map_init(Vec::new, batch).reduce(|| 0, u64::wrapping_add)
            }
            Strategy::Single | Strategy::Triangles => {
                let mut answers = Vec::new();
                records.chunks(BATCH).map(|records| batch(&mut answers, records)).fold(0, u64::wrapping_add)
            }
        }
    }
}

/// All bits of a ray's answer in one number.
fn mixed(record: &RayRecord, answer: &Answer) -> u64 {
    let parts =
        [u64::from(record.pixel), u64::from(answer.primitive), answer.t.to_bits(), answer.u.to_bits()];
    parts.iter().fold(0, |sum, part| (sum ^ part).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(31))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_strategy_finds_the_same() {
        let field = Field::new(5, 1, 40).unwrap();
        assert_eq!((field.triangles(), field.rays()), (5 * 80, 1600));
        let mut pixels: Vec<u32> = field.records.iter().map(|record| record.pixel).collect();
        pixels.sort_unstable();
        assert_eq!(pixels, (0..1600).collect::<Vec<_>>());
        let mut digests = Vec::new();
        for kind in [AccelKind::Brute, AccelKind::Spheres, AccelKind::Bvh, AccelKind::Grid] {
            for strategy in Strategy::ALL {
                let accel = field.build(kind, strategy);
                assert!(field.foretell(&accel, strategy) > 0.0);
                digests.push(field.round(&accel, strategy).1);
            }
        }
        assert!(digests.iter().all(|&digest| digest == digests[0]), "{digests:?}");
        let missed =
            field.records.iter().map(|record| mixed(record, &Answer::MISS)).fold(0, u64::wrapping_add);
        assert_ne!(digests[0], missed);
    }
}
