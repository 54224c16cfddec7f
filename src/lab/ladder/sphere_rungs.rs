//! The rungs for spheres: each arithmetic traces the same small scene of mirrors, beside the renderer's.

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;

use super::aim::Dice;
use super::fixed::Fixed;
use super::gallery::{self, SCENE_SIZE, Scene};
use super::sphere::{Arithmetic, Product, TextbookF32, TextbookF64};
use super::time_blocks;
use crate::error::Result;
use crate::image::Image;

const CHUNK: u64 = 1024;
/// Rays of a timed block.
const TIMED: u64 = 512;
/// Camera rays go through the points of a grid of this many along each side, which 12 bits can tell apart.
const GRID: usize = 1024;

/// What one arithmetic did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SphereRow {
    pub rung: String,
    /// File of its picture, if there is one.
    pub picture: Option<String>,
    pub rays: u64,
    /// Camera rays that hit where the renderer's miss, miss where it hits, or hit another sphere.
    pub disagree: u64,
    /// Where both hit the same sphere: errors of the distance, in sizes of the scene.
    pub t_max: f64,
    pub t_rms: f64,
    /// Angle between the normals, in degrees.
    pub normal_max: f64,
    pub normal_rms: f64,
    /// Reflected rays (of hits that agree), and those that find something else.
    pub mirrored: u64,
    pub mirror_disagree: u64,
    /// As above, of what both see in the mirror.
    pub mirror_t_max: f64,
    pub mirror_t_rms: f64,
    /// One ray against one sphere.
    pub ns: f64,
    #[serde(skip)]
    hits: u64,
    #[serde(skip)]
    mirror_hits: u64,
}

impl SphereRow {
    fn add(&mut self, other: &Self) {
        self.rays += other.rays;
        self.disagree += other.disagree;
        self.t_max = self.t_max.max(other.t_max);
        self.t_rms += other.t_rms;
        self.normal_max = self.normal_max.max(other.normal_max);
        self.normal_rms += other.normal_rms;
        self.mirrored += other.mirrored;
        self.mirror_disagree += other.mirror_disagree;
        self.mirror_t_max = self.mirror_t_max.max(other.mirror_t_max);
        self.mirror_t_rms += other.mirror_t_rms;
        self.hits += other.hits;
        self.mirror_hits += other.mirror_hits;
    }

    /// Turns sums of squares into root mean squares.
    fn finish(mut self) -> Self {
        let rms = |sum: f64, n: u64| if n > 0 { (sum / n as f64).sqrt() } else { 0.0 };
        self.t_rms = rms(self.t_rms, self.hits);
        self.normal_rms = rms(self.normal_rms, self.hits);
        self.mirror_t_rms = rms(self.mirror_t_rms, self.mirror_hits);
        self
    }
}

/// Climbs all rungs with `rays` camera rays each, and writes their pictures and the sheet of them. On the current rayon pool.
///
/// # Errors
/// Pictures that can't be written.
pub fn climb(rays: u64, seed: u64, folder: Option<&Path>) -> Result<(Vec<SphereRow>, Option<String>)> {
    let mut ladder = Ladder { rays, seed, folder, rows: Vec::new(), pictures: Vec::new() };
    // The 1994 real-time ray tracer on Pixel-Planes 5, and what it would have been with wider words.
    ladder.rung("12 bits, t + 0 bits", "ladder-12-bits-t-0.png", &Fixed::<i64>::new(12, 0))?;
    ladder.rung("12 bits, t + 6 bits", "ladder-12-bits-t-6.png", &Fixed::<i64>::new(12, 6))?;
    ladder.rung("16 bits, t + 8 bits", "ladder-16-bits.png", &Fixed::<i64>::new(16, 8))?;
    ladder.rung("20 bits, t + 10 bits", "ladder-20-bits.png", &Fixed::<i128>::new(20, 10))?;
    ladder.rung("24 bits, t + 12 bits", "ladder-24-bits.png", &Fixed::<i128>::new(24, 12))?;
    ladder.rung("28 bits, t + 14 bits", "ladder-28-bits.png", &Fixed::<i128>::new(28, 14))?;
    ladder.rung("32 bits, t + 16 bits", "ladder-32-bits.png", &Fixed::<i128>::new(32, 16))?;
    ladder.rung("quadratic f32", "ladder-f32.png", &TextbookF32)?;
    ladder.rung("quadratic f64", "ladder-f64.png", &TextbookF64)?;
    ladder.rung("heliostat", "ladder-exact.png", &Product)?;
    let sheet = match folder {
        Some(folder) => {
            let name = "ladder-sheet.png";
            gallery::save(&gallery::sheet(&ladder.pictures), folder, name)?;
            Some(name.to_owned())
        }
        None => None,
    };
    Ok((ladder.rows, sheet))
}

struct Ladder<'a> {
    rays: u64,
    seed: u64,
    folder: Option<&'a Path>,
    rows: Vec<SphereRow>,
    pictures: Vec<Image>,
}

impl Ladder<'_> {
    fn rung<A: Arithmetic>(&mut self, name: &str, file: &str, arithmetic: &A) -> Result<()> {
        let (scene, exact) = (Scene::new(arithmetic), Scene::new(&Product));
        let parts: Vec<SphereRow> = (0..self.rays.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut part = SphereRow::default();
                for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.rays) {
                    count(&mut part, &scene, &exact, self.direction(index));
                }
                part
            })
            .collect();
        let mut row = SphereRow { rung: name.into(), ..SphereRow::default() };
        parts.iter().for_each(|part| row.add(part));
        let mut row = row.finish();
        row.ns = self.time(&scene);
        if let Some(folder) = self.folder {
            let picture = scene.picture();
            gallery::save(&picture, folder, file)?;
            self.pictures.push(picture);
            row.picture = Some(file.into());
        }
        self.rows.push(row);
        Ok(())
    }

    /// Where a camera ray goes through the picture's plane.
    fn direction(&self, index: u64) -> [f64; 2] {
        let mut dice = Dice::new(self.seed, u64::MAX, index);
        [(); 2].map(|()| dice.below(GRID) as f64 / GRID as f64 - 0.5)
    }

    fn time<A: Arithmetic>(&self, scene: &Scene<A>) -> f64 {
        let rays: Vec<A::Ray> = (0..TIMED)
            .map(|index| {
                let [x, y] = self.direction(index);
                let (origin, direction) = gallery::camera(x, y);
                scene.arithmetic.ray(origin, direction)
            })
            .collect();
        time_blocks(rays.len() * scene.balls.len(), || {
            let tests = rays.iter().flat_map(|ray| scene.balls.iter().map(move |ball| (ray, ball)));
            tests.filter(|(ray, ball)| scene.arithmetic.meet(ray, ball).is_some()).count() as f64
        })
    }
}

/// Traces a camera ray and its reflection, and compares.
fn count<A: Arithmetic>(row: &mut SphereRow, scene: &Scene<A>, exact: &Scene<Product>, [x, y]: [f64; 2]) {
    let (origin, direction) = gallery::camera(x, y);
    let found = scene.closest(&scene.arithmetic.ray(origin, direction), None);
    let truth = exact.closest(&Product.ray(origin, direction), None);
    row.rays += 1;
    let (found, truth) = match (found, truth) {
        (None, None) => return,
        (Some(found), Some(truth)) if found.ball == truth.ball => (found, truth),
        _ => {
            row.disagree += 1;
            return;
        }
    };
    let error = (found.distance - truth.distance).abs() / SCENE_SIZE;
    let angle = libm::atan2(found.normal.cross(truth.normal).length(), found.normal.dot(truth.normal));
    let degrees = angle.to_degrees();
    row.hits += 1;
    row.t_max = row.t_max.max(error);
    row.t_rms += error * error;
    row.normal_max = row.normal_max.max(degrees);
    row.normal_rms += degrees * degrees;
    row.mirrored += 1;
    let found = scene.closest(&found.reflected, Some(found.ball));
    let truth = exact.closest(&truth.reflected, Some(truth.ball));
    match (found, truth) {
        (None, None) => {}
        (Some(found), Some(truth)) if found.ball == truth.ball => {
            let error = (found.distance - truth.distance).abs() / SCENE_SIZE;
            row.mirror_hits += 1;
            row.mirror_t_max = row.mirror_t_max.max(error);
            row.mirror_t_rms += error * error;
        }
        _ => row.mirror_disagree += 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_bits_buy_something_and_each_wider_word_more() {
        let (rows, sheet) = climb(20_000, 1, None).unwrap();
        assert_eq!(sheet, None);
        let [whole, six, bits16, bits20, bits24, bits28, bits32, single, double, exact] = &rows[..] else {
            panic!("{} rungs", rows.len())
        };
        assert_eq!((exact.disagree, exact.mirror_disagree), (0, 0));
        assert_eq!((exact.t_max, exact.normal_max, exact.mirror_t_max), (0.0, 0.0, 0.0));
        assert!(exact.hits > 10_000 && exact.mirror_hits > 1_000, "{exact:?}");
        assert!(six.disagree < whole.disagree && six.mirror_disagree < whole.mirror_disagree, "{six:?}");
        let rungs = [whole, six, bits16, bits20, bits24, bits28, bits32];
        for pair in rungs.windows(2) {
            assert!(pair[1].t_rms < 0.5 * pair[0].t_rms, "{pair:?}");
            assert!(pair[1].normal_rms < 0.5 * pair[0].normal_rms, "{pair:?}");
        }
        assert!(double.t_rms < 1e-12 && single.t_rms < 1e-5 && double.t_rms < single.t_rms);
    }

    #[test]
    fn pictures_are_written_and_show_the_errors() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        gallery::make_folder(&folder).unwrap();
        let (rows, sheet) = climb(100, 1, Some(&folder)).unwrap();
        let read = |name: &str| crate::output::read::read(&folder.join(name)).unwrap();
        let names: Vec<&str> = rows.iter().map(|row| row.picture.as_deref().unwrap()).collect();
        let exact = read("ladder-exact.png");
        let wrong = |name: &str| read(name).pixels.iter().zip(&exact.pixels).filter(|(a, b)| a != b).count();
        assert!(wrong(names[0]) > wrong(names[1]) && wrong(names[1]) > wrong(names[3]));
        let sheet = read(&sheet.unwrap());
        assert_eq!((sheet.width, sheet.height), (10 * 260 - 4, 516));
        assert_eq!(sheet.pixels[9 * 260..9 * 260 + 256], exact.pixels[..256]);
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 11);
    }
}
