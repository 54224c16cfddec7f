//! Sampling until an error is met: the same bytes however it is run, and an error that is what was told.

mod common;

use common::{fingerprint, render, rendered_as, rendered_on, repository, small_work};
use heliostat::accel::Accel;
use heliostat::cluster::Solo;
use heliostat::image::Image;
use heliostat::job::{Rendered, Work};
use heliostat::output::compare::compare;
use heliostat::settings::{
    AccelKind, BuildPreset, Crop, ErrorMetric, ErrorTarget, Filter, SamplerKind, Split,
};

fn adaptive(scene: &str, metric: ErrorMetric, value: f64) -> Work {
    let path = repository().join("scenes").join(scene).with_extension("toml");
    let mut work = small_work(&path, AccelKind::Bvh);
    work.image.spp = 64;
    work.image.error_target = Some(ErrorTarget { metric, value });
    work
}

/// All that comes of one process.
fn rendered(work: &Work) -> Rendered {
    rendered_as(&Solo::new(), work.clone(), 2).expect("rank 0")
}

#[test]
fn it_is_the_same_for_threads_tiles_ranks_splits_accelerators_and_crops() {
    for (scene, metric, value, filter) in [
        ("cornell-path", ErrorMetric::Rmse, 0.04, Filter::Box),
        ("glass", ErrorMetric::Display, 0.02, Filter::Mitchell),
        ("sphereflake", ErrorMetric::Relmse, 2e-3, Filter::Gaussian),
    ] {
        let mut work = adaptive(scene, metric, value);
        work.image.filter = filter;
        let image = render(&work, 1);
        let expected = fingerprint(&image);
        for (threads, tile_size) in [(3, 5), (2, 33)] {
            work.run.tile_size = tile_size;
            assert_eq!(fingerprint(&render(&work, threads)), expected, "{scene}, tiles of {tile_size}");
        }
        for split in [Split::Tiles, Split::Stream, Split::Voxels, Split::Triangles] {
            let work = &{
                let mut work = work.clone();
                work.run.split = split;
                work
            };
            let found = rendered_on(3, work).image;
            assert_eq!(fingerprint(&found), expected, "{scene}, {split:?}");
        }
        // A crop whose blocks reach beyond it.
        let crop = Crop { x0: 11, y0: 3, x1: 30, y1: 38 };
        work.image.crop = crop;
        work.accel = Accel::build(AccelKind::Grid, BuildPreset::Balanced, &work.scene.surfaces);
        work.run.accel = AccelKind::Grid;
        let part = render(&work, 2);
        for y in crop.y0..crop.y1 {
            for x in crop.x0..crop.x1 {
                let own = part.pixels[((y - crop.y0) * crop.width() + x - crop.x0) as usize];
                assert_eq!(own, image.pixels[(y * image.width + x) as usize], "{scene}, {x}, {y}");
            }
        }
    }
}

#[test]
fn a_clock_beside_a_target_ends_nothing_early() {
    let mut work = adaptive("sphereflake", ErrorMetric::Rmse, 0.02);
    work.run.time_limit = Some(3600.0);
    let Rendered { error, complete, .. } = rendered(&work);
    let error = error.unwrap();
    assert!(complete && error.spp >= 4.0 && (0.005..0.02).contains(&error.rmse), "{error:?}");
    // A single sample of each pixel tells no error.
    (work.image.spp, work.image.error_target) = (1, None);
    assert_eq!(rendered(&work).error, None);
}

#[test]
fn samples_go_where_they_are_needed() {
    let mut work = adaptive("sphereflake", ErrorMetric::Rmse, 0.02);
    let some = rendered(&work).error.unwrap();
    work.image.error_target = Some(ErrorTarget { metric: ErrorMetric::Rmse, value: 1e-6 });
    let most = rendered(&work).error.unwrap();
    assert!(some.spp < 30.0 && most.spp > 50.0 && some.spp >= 10.0, "{} {}", some.spp, most.spp);
    assert!(some.rmse < 0.02 && most.rmse < some.rmse);
}

/// Which pixels go on is decided by samples that are kept: who looks good by chance stops, and where light is a rare find that is who found none. README says how large the bias is,
/// as it was measured over 1,200 seeds and more.
#[test]
fn the_bias_of_stopping_is_what_is_said_of_it() {
    const SEEDS: u64 = 400;
    // Some blocks meet these targets at the first look, some much later. The last number is the most that the standard error may be.
    for (scene, target, sampler, said, sharp) in [
        ("cornell-path", 0.2, SamplerKind::Independent, -0.015, 0.004),
        ("cornell-path", 0.2, SamplerKind::Sobol, -0.005, 0.003),
        ("sphereflake", 0.03, SamplerKind::Sobol, -0.0004, 0.0005),
    ] {
        let mut work = adaptive(scene, ErrorMetric::Rmse, target);
        (work.image.width, work.image.height) = (16, 16);
        work.image.crop = Crop { x0: 0, y0: 0, x1: 16, y1: 16 };
        (work.image.sampler, work.image.spp) = (sampler, 256);
        let mut spp = 0.0;
        let found: Vec<f64> = (0..SEEDS)
            .map(|seed| {
                // Not those that it was measured by.
                work.image.seed = 10_000 + seed;
                let rendered = rendered(&work);
                spp += rendered.error.unwrap().spp / SEEDS as f64;
                brightness(&rendered.image)
            })
            .collect();
        // The truth, of few renders as Sobol's points make each a good one.
        (work.image.error_target, work.image.spp, work.image.sampler) = (None, 1024, SamplerKind::Sobol);
        let truth: Vec<f64> = (0..8)
            .map(|seed| {
                work.image.seed = 1_000_000 + seed;
                brightness(&render(&work, 2))
            })
            .collect();
        let ([mean, error], [truth, truth_error]) = (mean_and_error(&found), mean_and_error(&truth));
        let (bias, error) = (mean / truth - 1.0, libm::hypot(error, truth_error) / truth);
        println!(
            "{scene} to {target}, {sampler:?}: {spp:.1} samples, bias {:+.3} % ± {:.3} %",
            100.0 * bias,
            100.0 * error
        );
        assert!(error < sharp, "{scene}: ± {error} is too much to judge by");
        assert!((bias - said).abs() < 3.5 * error, "{scene}, {sampler:?}: biased by {bias} ± {error}");
    }
}

fn brightness(image: &Image) -> f64 {
    let values = image.pixels.as_flattened();
    values.iter().map(|&c| f64::from(c)).sum::<f64>() / values.len() as f64
}

/// Of independent numbers.
fn mean_and_error(numbers: &[f64]) -> [f64; 2] {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let squares = numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>();
    [mean, (squares / (count - 1.0) / count).sqrt()]
}

/// In 40 runs with other seeds the error against a reference is below what was told, but for two at most.
#[test]
fn the_error_that_is_told_is_the_error() {
    for (scene, value, sampler) in [
        // Independent samples are what the estimate is exact for.
        ("cornell-path", 0.03, SamplerKind::Independent),
        ("sphereflake", 0.02, SamplerKind::Independent),
        ("cornell-path", 0.02, SamplerKind::Sobol),
        ("sphereflake", 0.01, SamplerKind::Sobol),
        ("sphereflake", 0.01, SamplerKind::Stratified),
    ] {
        let mut work = adaptive(scene, ErrorMetric::Rmse, value);
        work.image.sampler = sampler;
        (work.image.width, work.image.height) = (32, 24);
        work.image.crop = Crop { x0: 0, y0: 0, x1: 32, y1: 24 };
        work.image.spp = 256;
        let mut reference = work.clone();
        reference.image.error_target = None;
        reference.image.sampler = SamplerKind::Sobol;
        (reference.image.seed, reference.image.spp) = (1000, 4096);
        let reference = render(&reference, 2);
        let (mut above, mut ratio, mut spp) = (0, 0.0, 0.0);
        for seed in 0..40 {
            work.image.seed = seed;
            let found = rendered(&work);
            let truth = compare(&reference, &found.image).unwrap().rmse;
            let told = found.error.unwrap();
            above += usize::from(truth > told.rmse_at_most);
            ratio += truth / told.rmse / 40.0;
            spp += told.spp / 40.0;
        }
        println!(
            "{scene} to {value}, {sampler:?}: {spp:.1} samples, error {ratio:.2} of what was told, {above} above"
        );
        assert!(above <= 2, "{scene}: {above} of 40 are above");
        // Samples that are spread evenly are better than can be known of them.
        let least = if sampler == SamplerKind::Independent { 0.8 } else { 0.5 };
        assert!((least..1.1).contains(&ratio), "{scene}: the error is {ratio} of what was told");
    }
}
