//! The traversal kernels alone, over generated meshes: `cargo bench --bench kernels`. `heliostat bench kernels` does the same for any scene.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use heliostat::accel::wide::Wide;
use heliostat::accel::wide::traversal::Traversal;
use heliostat::geometry::record::Answer;
use heliostat::geometry::{NONE, Ray};
use heliostat::scene::Surfaces;
use heliostat::scene::generate::icosphere::icosphere;
use heliostat::settings::BuildPreset;
use heliostat::simd::Level;

/// Rays of each class.
const RAYS: usize = 16_384;

fn ray(origin: DVec3, direction: DVec3) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
}

/// A point of the unit cube around 0, one of a sequence that fills it evenly.
fn point(index: usize) -> DVec3 {
    let part = |factor: f64| 2.0 * (index as f64 * factor).fract() - 1.0;
    DVec3::new(part(0.819_172_513), part(0.671_043_607), part(0.549_700_478))
}

fn classes() -> [(&'static str, bool, Vec<Ray>); 3] {
    // Blocks of 8 x 8 pixels, as tiles go.
    let camera = |index: usize| {
        let (block, inside) = (index / 64, index % 64);
        let (x, y) = (block % 16 * 8 + inside % 8, block / 16 * 8 + inside / 8);
        ray(DVec3::new(0.0, 0.0, 4.0), DVec3::new(x as f64 / 64.0 - 1.0, y as f64 / 64.0 - 1.0, -3.0))
    };
    [
        ("camera", false, (0..RAYS).map(camera).collect()),
        ("shadow", true, (0..RAYS).map(camera).collect()),
        ("scattered", false, (0..RAYS).map(|index| ray(1.5 * point(index), point(7 * index + 1))).collect()),
    ]
}

fn kernels(criterion: &mut Criterion) {
    for subdivisions in [3, 6] {
        let mesh = icosphere(subdivisions, DVec3::ZERO, 1.0);
        let count = mesh.triangles.len();
        let surfaces = Surfaces {
            positions: mesh.positions.into(),
            triangles: mesh.triangles.into(),
            ..Surfaces::default()
        };
        let wide = Wide::build(&surfaces, BuildPreset::Balanced);
        let mut answers = vec![Answer::MISS; RAYS];
        for (class, any, rays) in classes() {
            let mut group = criterion.benchmark_group(format!("{class}, {count} triangles"));
            group.throughput(Throughput::Elements(RAYS as u64));
            for level in Level::ALL.into_iter().filter(|level| level.is_available()) {
                for traversal in Traversal::ALL {
                    let id = BenchmarkId::new(traversal.name(), level.name());
                    group.bench_function(id, |bencher| {
                        bencher.iter(|| {
                            wide.trace_at(level, traversal, &surfaces, &(rays.as_slice(), any), &mut answers);
                        });
                    });
                }
            }
        }
        criterion.bench_function(&format!("build, {count} triangles"), |bencher| {
            bencher.iter(|| Wide::build(&surfaces, BuildPreset::Balanced));
        });
    }
}

criterion_group!(benches, kernels);
criterion_main!(benches);
