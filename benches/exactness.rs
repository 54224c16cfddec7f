//! The price of exactness: the same hierarchy and walk with the f64 decision behind its f32 filter, and with a plain f32 test (Woop, Benthin
//! and Wald 2013, no f64, t interpolated) that misses rays. Prints the ratio of their times, median of interleaved rounds.
//!
//!     cargo bench --bench exactness

use std::hint::black_box;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use heliostat::accel::bvh::Bvh;
use heliostat::accel::{Accel, Visitor};
use heliostat::geometry::{NONE, Prepared, Ray};
use heliostat::scene::build::SceneBuilder;
use heliostat::scene::generate::icosphere::icosphere;
use heliostat::scene::generate::teapot::teapot;
use heliostat::scene::generate::terrain::Terrain;
use heliostat::scene::mesh::Mesh;
use heliostat::scene::{Camera, Material, SceneHeader, Shading, Surfaces};

const ROUNDS: usize = 9;
const EDGE: u32 = 384;

/// The plain test.
struct F32<'a> {
    surfaces: &'a Surfaces,
    ray: Prepared,
    origin: [f32; 3],
    shear: [f32; 2],
    inverse_z: f32,
    start: u32,
    best: f32,
    primitive: u32,
}

impl<'a> F32<'a> {
    fn new(surfaces: &'a Surfaces, ray: &Ray) -> Self {
        let prepared = Prepared::new(ray);
        F32 {
            surfaces,
            origin: [prepared.kx, prepared.ky, prepared.kz].map(|axis| prepared.origin[axis] as f32),
            shear: [prepared.shear_x as f32, prepared.shear_y as f32],
            inverse_z: (1.0 / prepared.direction[prepared.kz]) as f32,
            start: ray.start,
            best: prepared.t_max as f32,
            primitive: NONE,
            ray: prepared,
        }
    }

    #[inline]
    fn test(&mut self, primitive: u32) {
        let axes = [self.ray.kx, self.ray.ky, self.ray.kz];
        let [a, b, c] = self.surfaces.triangle(primitive).map(|v| {
            let [x, y, z]: [f32; 3] = std::array::from_fn(|k| v[axes[k]] - self.origin[k]);
            [x - self.shear[0] * z, y - self.shear[1] * z, z * self.inverse_z]
        });
        let (u, v, w) = (c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]);
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return;
        }
        let sum = u + v + w;
        let t = (u * a[2] + v * b[2] + w * c[2]) / sum;
        if t > 0.0 && t < self.best && primitive != self.start {
            (self.best, self.primitive) = (t, primitive);
        }
    }
}

impl Visitor for F32<'_> {
    fn begin(&mut self, _: f64) {}

    #[inline]
    fn ray(&self) -> &Prepared {
        &self.ray
    }

    #[inline]
    fn limit(&self) -> f64 {
        f64::from(self.best)
    }

    #[inline]
    fn visit(&mut self, primitives: &[u32]) {
        primitives.iter().for_each(|&primitive| self.test(primitive));
    }

    #[inline]
    fn found(&self) -> bool {
        self.primitive != NONE
    }
}

fn main() {
    let terrain = Terrain { cells: 512, ..Terrain::default() };
    let meshes =
        [("teapot", teapot(24)), ("icosphere", icosphere(6, DVec3::ZERO, 1.0)), ("terrain", terrain.mesh())];
    println!("{:10} {:10} {:>9} {:>9} {:>7}", "mesh", "rays", "f32 Mr/s", "f64 Mr/s", "price");
    for (name, mesh) in meshes {
        let surfaces = place(mesh);
        let bvh = Bvh::build(&surfaces);
        let primary = primary_rays(&surfaces);
        let bounced = bounced_rays(&surfaces, &Accel::Bvh(bvh.clone()), &primary);
        for (kind, rays) in [("primary", &primary), ("bounce", &bounced)] {
            report(name, kind, &surfaces, &bvh, rays);
        }
    }
}

fn report(name: &str, kind: &str, surfaces: &Surfaces, bvh: &Bvh, rays: &[Ray]) {
    let accel = Accel::Bvh(bvh.clone());
    let plain = || {
        rays.iter().for_each(|ray| {
            let mut visitor = F32::new(surfaces, ray);
            bvh.traverse::<false>(&mut visitor);
            black_box((visitor.best, visitor.primitive));
        });
    };
    let exact = || {
        rays.iter().for_each(|ray| {
            black_box(accel.closest(surfaces, ray));
        });
    };
    let mut rounds: Vec<(Duration, Duration)> = (0..ROUNDS).map(|_| (timed(plain), timed(exact))).collect();
    rounds.sort_by(|a, b| ratio(a).total_cmp(&ratio(b)));
    let median = rounds[ROUNDS / 2];
    let speed = |time: Duration| rays.len() as f64 / 1e6 / time.as_secs_f64();
    println!("{name:10} {kind:10} {:9.2} {:9.2} {:7.2}", speed(median.0), speed(median.1), ratio(&median));
}

fn ratio((plain, exact): &(Duration, Duration)) -> f64 {
    exact.as_secs_f64() / plain.as_secs_f64()
}

fn timed(work: impl Fn()) -> Duration {
    let begin = Instant::now();
    work();
    begin.elapsed()
}

fn place(mesh: Mesh) -> Surfaces {
    let mut builder = SceneBuilder::new("bench".as_ref());
    let material = builder.material(Material::default());
    builder.mesh(mesh, &DAffine3::IDENTITY, material, Shading::Phong).expect("a sound mesh");
    builder.finish(SceneHeader::default()).surfaces
}

fn primary_rays(surfaces: &Surfaces) -> Vec<Ray> {
    let (low, high) = surfaces.bounds().expect("a mesh");
    let (center, radius) = ((low + high) * 0.5, (high - low).length() * 0.5);
    let eye = center + DVec3::new(0.5, 0.7, 1.0).normalize() * radius * 2.5;
    let camera = Camera::perspective(eye, center, DVec3::Y, 45.0).expect("a camera");
    (0..EDGE * EDGE)
        .map(|pixel| {
            let (x, y) = (f64::from(pixel % EDGE) + 0.5, f64::from(pixel / EDGE) + 0.5);
            let (origin, direction) = camera.ray(x, y, f64::from(EDGE), f64::from(EDGE));
            Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
        })
        .collect()
}

/// From each hit a ray in a direction that is spread over the upper half space of the ray's way back.
fn bounced_rays(surfaces: &Surfaces, accel: &Accel, primary: &[Ray]) -> Vec<Ray> {
    let spread = |index: usize, factor: f64| (index as f64 * factor).fract() * 2.0 - 1.0;
    primary
        .iter()
        .enumerate()
        .filter_map(|(index, ray)| {
            let hit = accel.closest(surfaces, ray);
            hit.is_hit().then(|| {
                let turn =
                    DVec3::new(spread(index, 0.754_877), spread(index, 0.569_84), spread(index, 0.618_03));
                let origin = ray.origin + ray.direction * hit.t;
                Ray { origin, direction: turn - ray.direction, start: hit.primitive, ..*ray }
            })
        })
        .collect()
}
