//! Noise without a pattern: the errors of pixels have nothing to do with each other, inside tiles or across their borders.

use heliostat::image::Image;
use heliostat::settings::SamplerKind;

use super::judge::LIMIT;
use super::stage::{Stage, brightness};
use super::text::Text;

/// Jittered reflections under a lamp: much noise, of all kinds.
fn jittered() -> Text {
    Text::perspective([0.0, 1.6, 4.0], [0.0, 0.4, 0.0], 45.0)
        .image(SIZE as u32, 4, "background = [0.3, 0.4, 0.5]")
        .material("floor", "kd = 0.15\nks = 0.7\nshininess = 60")
        .material("ball", "kd = 0.3\nks = 0.5\nshininess = 15")
        .material("lamp", "kd = 0\nemission = 6")
        .plane(40, "floor", "")
        .sphere([-0.6, 0.5, 0.0], 0.5, "ball")
        .sphere([0.8, 1.1, -0.8], 0.35, "lamp")
}

const SIZE: usize = 48;
const SEEDS: usize = 16;
const TILE: usize = 16;

/// What each image is off the mean of all, in standard deviations of each pixel. `None` where nothing is left to chance.
fn errors(images: &[Image]) -> Vec<Vec<Option<f64>>> {
    let count = images.len() as f64;
    let value = |image: &Image, i: usize| brightness(&image.pixels[i]);
    let about: Vec<(f64, f64)> = (0..SIZE * SIZE)
        .map(|i| {
            let mean = images.iter().map(|image| value(image, i)).sum::<f64>() / count;
            let squares = images.iter().map(|image| (value(image, i) - mean) * (value(image, i) - mean));
            (mean, (squares.sum::<f64>() / (count - 1.0)).sqrt())
        })
        .collect();
    let error = |image: &Image, i: usize| {
        let (mean, deviation) = about[i];
        (deviation > 1e-6 * mean).then(|| (value(image, i) - mean) / deviation)
    };
    images.iter().map(|image| (0..SIZE * SIZE).map(|i| error(image, i)).collect()).collect()
}

/// Mean product of errors of pixels (dx, dy) apart among those pairs that are told, and its standard error if they are independent.
fn correlation(
    errors: &[Vec<Option<f64>>],
    [dx, dy]: [usize; 2],
    among: impl Fn(usize, usize) -> bool,
) -> (f64, f64) {
    let (mut sum, mut pairs) = (0.0, 0u32);
    for image in errors {
        for y in 0..SIZE - dy {
            for x in (0..SIZE - dx).filter(|&x| among(x, y)) {
                if let (Some(a), Some(b)) = (image[y * SIZE + x], image[(y + dy) * SIZE + x + dx]) {
                    sum += a * b;
                    pairs += 1;
                }
            }
        }
    }
    let pairs = f64::from(pairs);
    // One of the images of each pixel is spent on its mean.
    let free = pairs * (SEEDS - 1) as f64 / SEEDS as f64;
    (sum / pairs * (SEEDS as f64 / (SEEDS - 1) as f64), 1.0 / free.sqrt())
}

fn noise(sampler: SamplerKind) -> Vec<Image> {
    let mut stage = Stage::new(jittered(), &[]);
    stage.image.sampler = sampler;
    stage.seeds(SEEDS as u64)
}

const AXES: [fn(usize) -> [usize; 2]; 2] = [|lag| [lag, 0], |lag| [0, lag]];

#[test]
fn the_errors_of_pixels_are_independent() {
    for sampler in [SamplerKind::Independent, SamplerKind::Sobol, SamplerKind::Stratified] {
        let errors = errors(&noise(sampler));
        let mut most: f64 = 0.0;
        for lag in 1..=8 {
            for step in AXES.map(|axis| axis(lag)).into_iter().chain([[lag, lag]]) {
                let (found, error) = correlation(&errors, step, |_, _| true);
                most = most.max((found / error).abs());
                assert!(found.abs() < LIMIT * error, "{sampler:?}, {step:?} apart: {found} ± {error}");
            }
        }
        println!("{sampler:?}: at most {most:.2} standard errors");
    }
}

#[test]
fn nothing_shows_where_tiles_meet() {
    for sampler in [SamplerKind::Independent, SamplerKind::Sobol, SamplerKind::Stratified] {
        let errors = errors(&noise(sampler));
        for (axis, step) in [[1, 0], [0, 1]].into_iter().enumerate() {
            let meets = |x: usize, y: usize| [x, y][axis] % TILE == TILE - 1;
            let (across, across_error) = correlation(&errors, step, meets);
            let (inside, inside_error) = correlation(&errors, step, |x, y| !meets(x, y));
            let error = libm::hypot(across_error, inside_error);
            println!("{sampler:?} {step:?}: {across:.4} across, {inside:.4} inside, ± {error:.4}");
            assert!(
                (across - inside).abs() < LIMIT * error,
                "{sampler:?} {step:?}: {across} {inside} ± {error}"
            );
        }
    }
}

/// The judge isn't blind: neighbours of the blue sampler err to opposite sides, as they are meant to, and a blurred image's to the same.
#[test]
fn correlation_is_found_where_there_is_some() {
    let (found, error) = correlation(&errors(&noise(SamplerKind::Blue)), [1, 0], |_, _| true);
    println!("blue: {found} ± {error}");
    assert!(found < -LIMIT * error, "blue: {found} ± {error}");
    let mut images = noise(SamplerKind::Independent);
    for image in &mut images {
        let sharp = image.pixels.clone();
        for i in 1..sharp.len() {
            image.pixels[i] = std::array::from_fn(|k| 0.95 * sharp[i][k] + 0.05 * sharp[i - 1][k]);
        }
    }
    let (found, error) = correlation(&errors(&images), [1, 0], |_, _| true);
    println!("blurred: {found} ± {error}");
    assert!(found > LIMIT * error, "blurred: {found} ± {error}");
    // A seam that only shows where tiles meet.
    let mut images = noise(SamplerKind::Independent);
    for image in &mut images {
        for i in (0..SIZE * SIZE).filter(|i| (i % SIZE).is_multiple_of(TILE) && i % SIZE > 0) {
            let [left, own] = [image.pixels[i - 1], image.pixels[i]];
            image.pixels[i] = std::array::from_fn(|k| 0.85 * own[k] + 0.15 * left[k]);
        }
    }
    let errors = errors(&images);
    let meets = |x: usize, _: usize| x % TILE == TILE - 1;
    let (across, across_error) = correlation(&errors, [1, 0], meets);
    let (inside, inside_error) = correlation(&errors, [1, 0], |x, y| !meets(x, y));
    let error = libm::hypot(across_error, inside_error);
    println!("seam: {across} across, {inside} inside, ± {error}");
    assert!((across - inside).abs() > LIMIT * error);
}
