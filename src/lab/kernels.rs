//! How many rays the kernels trace in a second: classes of rays over a scene, or rays from a file.
//!
//! A `.rays` file holds eight f32 for each ray, little endian: origin, t_min, direction, t_max, in world space. A `.tri` mesh holds u32 vertices, u32 triangles, f32 x y z for
//! each vertex, u32 a b c for each triangle.

use std::path::Path;
use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;

use super::aim::Dice;
use super::plain_grid;
use crate::accel::Accel;
use crate::accel::wide::traversal::Traversal;
use crate::accel::wide::{PlainRays, Questions, Wide};
use crate::error::{Error, Result};
use crate::geometry::record::Answer;
use crate::geometry::{NONE, Ray};
use crate::scene::frame::Frame;
use crate::scene::{Camera, Surfaces, load};
use crate::settings::{AccelKind, BuildPreset, BuildSettings};
use crate::simd::Level;

/// Rays that one thread answers before it looks for more.
const CHUNK: usize = 4096;
/// Pixels along each side of the image whose camera rays are traced.
pub const SIDE: u32 = 1024;
/// What rays from a surface, of which a file can't name the start, keep away from it, in sizes of the scene.
const OFF: f64 = 1e-4;
/// Reach of ambient occlusion rays, in sizes of the scene.
const AMBIENT: f64 = 0.1;

/// A ray as files hold it.
pub type FileRay = [f32; 8];

/// What a class of rays asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// The first hit.
    Closest,
    /// Whether there is any.
    Occluded,
}

/// A set of rays with a name.
#[derive(Clone, Debug)]
pub struct RaySet {
    pub name: &'static str,
    pub kind: Kind,
    pub rays: Vec<FileRay>,
}

/// How rays are answered.
#[derive(Clone, Copy, Debug)]
pub enum Mode {
    /// By the hierarchy.
    Tree(Traversal, Level),
    /// By the grid, as the renderer walks it.
    Grid,
    /// By the textbook's walk through the same cells.
    PlainGrid,
}

impl Mode {
    /// What the renderer takes.
    pub fn chosen() -> Mode {
        Mode::Tree(Traversal::Chosen, Level::chosen())
    }

    pub fn name(self) -> String {
        match self {
            Mode::Tree(traversal, level) => format!("{} {}", traversal.name(), level.name()),
            Mode::Grid => "grid".into(),
            Mode::PlainGrid => "grid, textbook".into(),
        }
    }
}

/// A scene with its hierarchy.
#[derive(Debug)]
pub struct Subject {
    surfaces: Surfaces,
    frame: Frame,
    camera: Camera,
    /// Half the diagonal of its box, in stored space.
    size: f64,
    center: DVec3,
    wide: Wide,
    grid: Option<Accel>,
    /// What building the hierarchy took.
    pub build: Duration,
}

impl Subject {
    /// Reads a scene (.toml), a model (.obj) or a plain mesh (.tri) and builds its hierarchy on the current rayon pool.
    ///
    /// # Errors
    /// A file that can't be read or has nothing to trace.
    pub fn load(path: &Path, preset: BuildPreset) -> Result<Subject> {
        let is_mesh = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("tri"));
        let (surfaces, frame, camera) = if is_mesh {
            let mut surfaces = read_mesh(path)?;
            let frame = Frame::apply(&mut surfaces);
            (surfaces, frame, None)
        } else {
            let scene = load::load(path)?.scene;
            (scene.surfaces, scene.header.frame, Some(scene.header.camera))
        };
        if surfaces.is_empty() {
            return Err(Error::scene(path, None, "nothing to trace", "give a scene with surfaces"));
        }
        let start = Instant::now();
        let wide = Wide::build(&surfaces, preset);
        let build = start.elapsed();
        let (low, high) = (DVec3::from(wide.low.map(f64::from)), DVec3::from(wide.high.map(f64::from)));
        let (center, size) = (0.5 * (low + high), 0.5 * (high - low).length());
        let eye = center + DVec3::new(0.45, 0.55, 1.0).normalize() * (2.0 * size);
        let camera = camera.or_else(|| Camera::perspective(eye, center, DVec3::Y, 50.0));
        let camera = camera.ok_or_else(|| {
            Error::scene(path, None, "all surfaces lie in one point", "give a mesh with an extent")
        })?;
        Ok(Subject { surfaces, frame, camera, size, center, wide, grid: None, build })
    }

    /// Builds a grid, too, of about so many cells for each primitive: for [`Mode::Grid`] and [`Mode::PlainGrid`].
    pub fn build_grid(&mut self, density: f64) {
        let settings = BuildSettings { grid_density: density, ..BuildSettings::default() };
        self.grid = Some(Accel::build(AccelKind::Grid, settings, &self.surfaces));
    }

    /// Number of primitives.
    pub fn primitives(&self) -> usize {
        self.surfaces.len()
    }

    /// Traces all rays, some rounds of it; seconds of each and the number of hits.
    pub fn time(&self, mode: Mode, rays: &[FileRay], kind: Kind, rounds: usize) -> (Vec<f64>, usize) {
        let mut hits = 0;
        let seconds = (0..rounds)
            .map(|_| {
                let start = Instant::now();
                hits = rays
                    .par_chunks(CHUNK)
                    .map_init(
                        || vec![Answer::MISS; CHUNK],
                        |answers, rays| {
                            let answers = &mut answers[..rays.len()];
                            let any = kind == Kind::Occluded;
                            let asked = PlainRays { rays, frame: &self.frame, any };
                            self.answer(mode, &asked, answers);
                            answers.iter().filter(|answer| answer.is_hit()).count()
                        },
                    )
                    .sum();
                start.elapsed().as_secs_f64()
            })
            .collect();
        (seconds, hits)
    }

    fn answer(&self, mode: Mode, asked: &PlainRays, answers: &mut [Answer]) {
        let grid = self.grid.as_ref();
        let hit = |is_hit: bool| Answer { primitive: if is_hit { 0 } else { NONE }, ..Answer::MISS };
        for (index, answer) in answers.iter_mut().enumerate() {
            let (ray, any) = asked.question(index);
            *answer = match (mode, grid) {
                (Mode::Tree(traversal, level), _) => {
                    return self.wide.trace_at(level, traversal, &self.surfaces, asked, answers);
                }
                (Mode::Grid, Some(Accel::Grid(grid))) => {
                    return grid.trace(Level::chosen(), &self.surfaces, asked, answers);
                }
                (Mode::PlainGrid, Some(Accel::Grid(grid))) => {
                    hit(plain_grid::is_hit(grid, &self.surfaces, &ray, any))
                }
                (Mode::Grid | Mode::PlainGrid, _) => hit(false),
            };
        }
    }

    /// The classes: primary, shadow, diffuse, random (diffuse shuffled) and ambient occlusion.
    pub fn classes(&self, seed: u64) -> Vec<RaySet> {
        let primary: Vec<Ray> = (0..SIDE * SIDE)
            .into_par_iter()
            .map(|index| {
                let (x, y) = (even_bits(index), even_bits(index >> 1));
                let side = f64::from(SIDE);
                let (origin, direction) =
                    self.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5, side, side, [0.5; 2]);
                ray(origin, direction, f64::INFINITY)
            })
            .collect();
        let light = self.center + DVec3::new(-0.6, 1.4, 0.8) * self.size;
        let off = OFF * self.size;
        let from_hit = |index: usize, from: &Ray| {
            let mut answer = [Answer::MISS];
            self.wide.trace_rays(
                Level::chosen(),
                &self.surfaces,
                std::slice::from_ref(from),
                false,
                &mut answer,
            );
            let [answer] = answer;
            if !answer.is_hit() {
                return None;
            }
            let position = from.origin + from.direction * answer.t;
            let normal = self.normal(answer.primitive, position);
            let facing = if normal.dot(from.direction) > 0.0 { -normal } else { normal };
            let mut dice = Dice::new([seed, 1, index as u64]);
            // The density of a point on a sphere that touches the surface, over its distance, is the cosine.
            let bounced = (facing + dice.direction() * (1.0 - 1e-6)).normalize();
            Some((position + facing * off, light - position, bounced))
        };
        let hits: Vec<_> =
            primary.par_iter().enumerate().filter_map(|(index, from)| from_hit(index, from)).collect();
        let shadow = hits.iter().map(|&(from, to_light, _)| ray(from, to_light, 1.0 - 1e-4));
        let diffuse: Vec<Ray> =
            hits.iter().map(|&(from, _, bounced)| ray(from, bounced, f64::INFINITY)).collect();
        let ambient = hits.iter().map(|&(from, _, bounced)| ray(from, bounced, AMBIENT * self.size));
        let mut random = diffuse.clone();
        let mut dice = Dice::new([seed, 2, 0]);
        for last in (1..random.len()).rev() {
            random.swap(last, dice.below(last + 1));
        }
        let set = |name, kind, rays: Vec<Ray>| RaySet {
            name,
            kind,
            rays: rays.iter().map(|ray| self.to_file(ray)).collect(),
        };
        vec![
            set("shad", Kind::Occluded, shadow.collect()),
            set("ao", Kind::Occluded, ambient.collect()),
            set("diff", Kind::Closest, diffuse),
            set("rand", Kind::Closest, random),
            set("prim", Kind::Closest, primary),
        ]
    }

    /// The unit normal of a primitive at a point of it.
    fn normal(&self, primitive: u32, at: DVec3) -> DVec3 {
        match self.surfaces.sphere_at(primitive) {
            Some(sphere) => (at - DVec3::from(sphere.center.map(f64::from))).normalize(),
            None => {
                let [a, b, c] = self.surfaces.triangle(primitive).map(|v| DVec3::from(v.map(f64::from)));
                (b - a).cross(c - a).normalize()
            }
        }
    }

    fn to_file(&self, ray: &Ray) -> FileRay {
        let origin = self.frame.to_world(ray.origin);
        let t = |t: f64| (t / self.frame.scale) as f32;
        let d = ray.direction;
        [
            origin.x as f32,
            origin.y as f32,
            origin.z as f32,
            t(ray.t_min),
            d.x as f32,
            d.y as f32,
            d.z as f32,
            t(ray.t_max),
        ]
    }
}

fn ray(origin: DVec3, direction: DVec3, t_max: f64) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max, first_id: 0, start: NONE }
}

/// Every second bit of a number: one coordinate of its place along a Morton curve.
fn even_bits(index: u32) -> u32 {
    (0..16).fold(0, |bits, k| bits | (index >> (2 * k) & 1) << k)
}

/// Reads the rays of a file.
///
/// # Errors
/// A file that can't be read, isn't a whole number of rays, or holds numbers that no ray can have.
pub fn read_rays(path: &Path) -> Result<Vec<FileRay>> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let wrong = |what: String| {
        Error::scene(path, None, what, "give f32[8] for each ray: origin, t_min, direction, t_max")
    };
    if bytes.len() % size_of::<FileRay>() != 0 {
        return Err(wrong(format!("{} bytes are no whole number of rays", bytes.len())));
    }
    let rays: Vec<FileRay> = bytes.chunks_exact(32).map(bytemuck::pod_read_unaligned).collect();
    let bad = rays.iter().position(|ray| {
        let [x, y, z, t_min, dx, dy, dz, t_max] = *ray;
        ![x, y, z, t_min, dx, dy, dz].iter().all(|c| c.is_finite())
            || (dx, dy, dz) == (0.0, 0.0, 0.0)
            || t_max.is_nan()
    });
    match bad {
        Some(index) => Err(wrong(format!("ray {index} is no ray: {:?}", rays[index]))),
        None => Ok(rays),
    }
}

fn read_mesh(path: &Path) -> Result<Surfaces> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let wrong = |what: &str| {
        let layout = "give u32 vertices, u32 triangles, f32[3] for each vertex, u32[3] for each triangle";
        Error::scene(path, None, what, layout)
    };
    let Some((head, rest)) = bytes.split_first_chunk::<8>() else {
        return Err(wrong("it ends within its head"));
    };
    let [vertices, triangles]: [u32; 2] = bytemuck::pod_read_unaligned(head);
    let (vertices, triangles) = (vertices as usize, triangles as usize);
    if rest.len() != 12 * (vertices + triangles) {
        return Err(wrong("its length doesn't fit its head"));
    }
    let (positions, corners) = rest.split_at(12 * vertices);
    let positions: Vec<[f32; 3]> = positions.chunks_exact(12).map(bytemuck::pod_read_unaligned).collect();
    let triangles: Vec<[u32; 3]> = corners.chunks_exact(12).map(bytemuck::pod_read_unaligned).collect();
    if !positions.iter().flatten().all(|c| c.is_finite()) {
        return Err(wrong("a vertex isn't finite"));
    }
    if triangles.iter().flatten().any(|&corner| corner as usize >= vertices) {
        return Err(wrong("a triangle names a vertex that isn't there"));
    }
    Ok(Surfaces { positions: positions.into(), triangles: triangles.into(), ..Surfaces::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh_file(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("square.tri");
        let mut bytes = bytemuck::cast_slice::<u32, u8>(&[4, 2]).to_vec();
        let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        bytes.extend(bytemuck::cast_slice::<_, u8>(&corners));
        bytes.extend(bytemuck::cast_slice::<_, u8>(&[[0u32, 1, 2], [0, 2, 3]]));
        std::fs::write(&path, bytes).unwrap();
        path
    }

    #[test]
    fn classes_come_from_what_the_camera_sees() {
        let folder = tempfile::tempdir().unwrap();
        let mut subject = Subject::load(&mesh_file(folder.path()), BuildPreset::Fast).unwrap();
        subject.build_grid(40.0);
        let classes = subject.classes(0);
        let hits = |name: &str| {
            let set = classes.iter().find(|set| set.name == name).unwrap();
            let (seconds, hits) = subject.time(Mode::chosen(), &set.rays, set.kind, 2);
            assert_eq!(seconds.len(), 2);
            for mode in [Mode::Grid, Mode::PlainGrid] {
                assert_eq!(subject.time(mode, &set.rays, set.kind, 1).1, hits, "{name} by {}", mode.name());
            }
            (set.rays.len(), hits)
        };
        let (rays, seen) = hits("prim");
        assert_eq!(rays, 1024 * 1024);
        assert!(seen > rays / 20 && seen < rays, "{seen}");
        // A square alone shadows and lights nothing.
        for name in ["shad", "ao", "diff", "rand"] {
            let (rays, met) = hits(name);
            // Files round their rays to f32: a few at the border may have missed.
            assert!(rays.abs_diff(seen) < 10 && met == 0, "{name}: {rays} rays for {seen}, {met} met");
        }
    }

    #[test]
    fn broken_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.rays");
        std::fs::write(&path, [0u8; 33]).unwrap();
        assert!(read_rays(&path).unwrap_err().to_string().contains("33 bytes"));
        std::fs::write(&path, [0u8; 32]).unwrap();
        assert!(read_rays(&path).unwrap_err().to_string().contains("ray 0 is no ray"));
        let mesh = mesh_file(folder.path());
        let mut bytes = std::fs::read(&mesh).unwrap();
        bytes.pop();
        std::fs::write(&mesh, &bytes).unwrap();
        let message = Subject::load(&mesh, BuildPreset::Fast).unwrap_err().to_string();
        assert!(message.contains("doesn't fit its head"), "{message}");
    }

    #[test]
    fn the_curve_visits_every_pixel() {
        let mut seen = vec![false; 64];
        (0..64).for_each(|index| seen[(even_bits(index) + 8 * even_bits(index >> 1)) as usize] = true);
        assert!(seen.into_iter().all(|seen| seen));
    }
}
