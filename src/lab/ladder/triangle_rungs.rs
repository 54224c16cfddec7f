//! The rungs for triangles: what each kernel makes of rays aimed at closed meshes, beside the renderer's decision.

use rayon::prelude::*;
use serde::Serialize;

use super::aim::{AimedRay, PLACES, Target, targets};
use super::time_blocks;
use super::triangle::{HalfBoxes, MollerTrumboreF32, MollerTrumboreF64, Product, TriangleKernel, WoopF32};

/// Rays that one thread traces in one go.
const CHUNK: u64 = 256;
/// Rays of a timed block.
const TIMED: u64 = 16;

/// What one kernel did in one place.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TriangleRow {
    pub rung: String,
    pub place: String,
    pub rays: u64,
    /// No hit at all, though every ray meets the closed surface.
    pub leaks: u64,
    /// The hit lies behind the first one by more than a thousandth of its distance (or, far away, a twentieth of the mesh).
    pub behind: u64,
    /// The hit lies as much before the first one: nothing is there.
    pub before: u64,
    /// Of all other hits: |t − t of the renderer| / t of the renderer.
    pub t_max: f64,
    pub t_rms: f64,
    /// One ray against one triangle, on average over both meshes.
    pub ns: f64,
}

impl TriangleRow {
    pub fn errors(&self) -> u64 {
        self.leaks + self.behind + self.before
    }

    fn count(&mut self, found: Option<f64>, exact: Option<f64>, tolerance: f64) {
        self.rays += 1;
        // The ray was aimed at t = 1: a witness that doesn't ask the renderer.
        let first = exact.map_or(1.0, |t| t.min(1.0 + tolerance));
        match found {
            None => self.leaks += 1,
            Some(t) if t > first + tolerance => self.behind += 1,
            Some(t) if t < first - tolerance => self.before += 1,
            Some(t) => {
                let error = exact.map_or(0.0, |exact| ((t - exact) / exact).abs());
                self.t_max = self.t_max.max(error);
                self.t_rms += error * error;
            }
        }
    }

    fn add(&mut self, other: &Self) {
        self.rays += other.rays;
        self.leaks += other.leaks;
        self.behind += other.behind;
        self.before += other.before;
        self.t_max = self.t_max.max(other.t_max);
        self.t_rms += other.t_rms;
    }
}

/// Climbs all rungs in all places with `rays` rays in all, which the places and meshes share. On the current rayon pool.
pub fn climb(rays: u64, seed: u64) -> Vec<TriangleRow> {
    let mut rows = Vec::new();
    for (number, place) in PLACES.into_iter().enumerate() {
        let share = rays / 3 + u64::from((number as u64) < rays % 3);
        let course = Course { targets: targets(place), number: number as u64, rays: share, seed };
        // Möller & Trumbore 1997 as it is mostly copied.
        rows.push(course.run("Möller-Trumbore f32, ε = 1e-6", &MollerTrumboreF32 { epsilon: 1e-6 }));
        rows.push(course.run("Möller-Trumbore f32", &MollerTrumboreF32 { epsilon: 0.0 }));
        rows.push(course.run("Möller-Trumbore f64", &MollerTrumboreF64));
        // Woop, Benthin & Wald 2013.
        rows.push(course.run("Woop f32", &WoopF32));
        rows.push(course.run("Woop f32, boxes of f16", &HalfBoxes));
        rows.push(course.run("heliostat", &Product));
    }
    rows
}

/// The rays of one place.
struct Course {
    targets: [Target; 2],
    number: u64,
    rays: u64,
    seed: u64,
}

impl Course {
    fn ray(&self, target: usize, index: u64) -> AimedRay {
        self.targets[target].ray(self.seed, 2 * self.number + target as u64, index)
    }

    fn run<K: TriangleKernel>(&self, name: &str, kernel: &K) -> TriangleRow {
        let place = self.targets[0].place;
        let mut row = TriangleRow { rung: name.into(), place: place.name.into(), ..TriangleRow::default() };
        for target in 0..self.targets.len() {
            let share = (self.rays + 1 - target as u64) / 2;
            let stored = store(kernel, &self.targets[target]);
            let exact = store(&Product, &self.targets[target]);
            let parts: Vec<TriangleRow> = (0..share.div_ceil(CHUNK))
                .into_par_iter()
                .map(|chunk| {
                    let mut part = TriangleRow::default();
                    for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(share) {
                        let ray = self.ray(target, index);
                        let length = ray.direction.iter().fold(0.0, |l: f32, c| l.max(c.abs()));
                        let tolerance = (0.05 * place.factor / f64::from(length)).min(1e-3);
                        part.count(
                            closest(kernel, &ray, &stored),
                            closest(&Product, &ray, &exact),
                            tolerance,
                        );
                    }
                    part
                })
                .collect();
            // In order: sums of f64 depend on it.
            parts.iter().for_each(|part| row.add(part));
            row.ns += 0.5 * self.time(kernel, target, &stored);
        }
        let good = row.rays - row.errors();
        row.t_rms = if good > 0 { (row.t_rms / good as f64).sqrt() } else { 0.0 };
        row
    }

    fn time<K: TriangleKernel>(&self, kernel: &K, target: usize, stored: &[K::Stored]) -> f64 {
        let rays: Vec<K::Ray> = (0..TIMED).map(|index| kernel.ray(&self.ray(target, index))).collect();
        time_blocks(rays.len() * stored.len(), || {
            rays.iter().map(|ray| nearest(kernel, ray, stored).unwrap_or(0.0)).sum()
        })
    }
}

fn store<K: TriangleKernel>(kernel: &K, target: &Target) -> Vec<K::Stored> {
    target.triangles.iter().map(|triangle| kernel.store(triangle)).collect()
}

fn closest<K: TriangleKernel>(kernel: &K, ray: &AimedRay, stored: &[K::Stored]) -> Option<f64> {
    nearest(kernel, &kernel.ray(ray), stored)
}

/// Tries every triangle.
#[inline]
fn nearest<K: TriangleKernel>(kernel: &K, ray: &K::Ray, stored: &[K::Stored]) -> Option<f64> {
    let hits = stored.iter().filter_map(|triangle| kernel.intersect(ray, triangle));
    hits.fold(None, |best, t| if best.is_none_or(|best| t < best) { Some(t) } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exact_rung_has_no_errors_and_naive_ones_have() {
        let rows = climb(12_000, 1);
        assert_eq!(rows.len(), 18);
        let errors = |name: &str, place: usize| {
            rows.iter().find(|row| row.rung == name && row.place == PLACES[place].name).expect(name).errors()
        };
        for (place, rows) in rows.chunks(6).enumerate() {
            assert!(rows.iter().all(|row| row.rays == 4_000 && row.place == PLACES[place].name));
            let exact = &rows[5];
            assert_eq!((exact.errors(), exact.t_max), (0, 0.0), "{exact:?}");
            assert!(errors("Möller-Trumbore f32, ε = 1e-6", place) > 0, "{place}");
            assert!(errors("Woop f32, boxes of f16", place) > errors("Woop f32", place), "{place}");
        }
        assert!(errors("Möller-Trumbore f32", 0) > 0);
        // Smaller than ε altogether.
        assert!(errors("Möller-Trumbore f32, ε = 1e-6", 1) > errors("Möller-Trumbore f32", 1));
    }

    #[test]
    fn a_run_can_be_repeated() {
        let counts = |rows: Vec<TriangleRow>| -> Vec<_> {
            rows.into_iter().map(|row| (row.errors(), row.t_max.to_bits(), row.t_rms.to_bits())).collect()
        };
        assert_eq!(counts(climb(600, 3)), counts(climb(600, 3)));
        assert_ne!(counts(climb(600, 3)), counts(climb(600, 4)));
    }
}
