//! Where more samples are worth their time: a few pixels hold most of an image's error, and get the most of them.

use rayon::prelude::*;

use super::estimate::Estimate;
use super::rate::Rate;
use super::rounds::{Activity, BLOCK};
use crate::settings::{Crop, ErrorMetric, ErrorTarget, ImageSettings};

/// As how many of a pixel's own samples its neighbours count where it is asked what its samples vary by.
const NEIGHBOURS: f64 = 64.0;

/// Pixels whose errors one thread adds up.
const PART: usize = 1 << 14;

/// What decides whether a pixel goes on.
#[derive(Clone, Copy, Debug, Default)]
struct Sampled {
    samples: f64,
    /// The squared error of n samples, times n^rate, weighted as the metric does.
    spread: f64,
}

/// A square of pixels that decides by itself.
struct Block {
    corner: (u32, u32),
    /// Columns and rows.
    size: (usize, usize),
    pixels: [[Sampled; BLOCK as usize]; BLOCK as usize],
}

impl Block {
    /// Its pixels with their places in the image.
    fn all(&self) -> impl Iterator<Item = ((u32, u32), Sampled)> {
        let ((left, top), (columns, rows)) = (self.corner, self.size);
        let row = move |(y, row): (u32, &[Sampled; BLOCK as usize])| {
            (left..).zip(*row).take(columns).map(move |(x, pixel)| ((x, y), pixel))
        };
        (top..).zip(&self.pixels[..rows]).flat_map(row)
    }

    /// Each spread weighed against the mean of those around it, which counts as [`NEIGHBOURS`] samples.
    fn smooth(&self) -> Block {
        let (columns, rows) = self.size;
        let around = |at: usize, most: usize| at.saturating_sub(1)..(at + 2).min(most);
        let mut pixels = self.pixels;
        for row in 0..rows {
            for column in 0..columns {
                let (mut sum, mut weights) = (0.0, 0.0);
                for y in around(row, rows) {
                    for x in around(column, columns) {
                        let Sampled { samples, spread } = self.pixels[y][x];
                        let samples = if (x, y) == (column, row) { 0.0 } else { samples };
                        sum += samples * spread;
                        weights += samples;
                    }
                }
                let Sampled { samples, spread } = self.pixels[row][column];
                if weights > 0.0 {
                    pixels[row][column].spread =
                        (NEIGHBOURS * (sum / weights) + samples * spread) / (NEIGHBOURS + samples);
                }
            }
        }
        Block { pixels, ..*self }
    }
}

/// What becomes of a pixel that needs more samples.
struct Prospect {
    /// It gets so many over a root of what a sample must be worth, the (1 + rate)-th; of its squared error that leaves as much over the rate, times that root to the power of
    /// the rate.
    samples: f64,
    /// The samples that it has, and its squared error by these.
    now: (f64, f64),
}

impl Prospect {
    fn of(&Sampled { samples, spread }: &Sampled, rate: &Rate) -> Self {
        let r = rate.value();
        let wanted = libm::pow(r * spread, 1.0 / (1.0 + r));
        Prospect { samples: wanted, now: (samples, spread / rate.power(samples.max(1.0))) }
    }
}

/// The squared error that a sample of any pixel must still take away to be worth its time, so that the whole image gets to its target with the fewest samples: as the first
/// round tells it, which all pixels have had.
///
/// With c the spread of a pixel and r the rate, n samples leave c / n^r of its squared error, and one more takes r c / n^(1 + r) away. The fewest samples in all are those where that is
/// the same for every pixel, n^(1 + r) = r c / worth, but for those that need no more than they have (for r = 1 Neyman 1934, "On the Two Different Aspects of the Representative Method",
/// section IV). What the most that any may have leaves isn't made up for by others.
pub fn worth(estimate: &Estimate, target: ErrorTarget) -> f64 {
    let goal = match target.metric {
        ErrorMetric::Relmse => target.value,
        ErrorMetric::Rmse | ErrorMetric::Display => target.value * target.value,
    };
    let rate = estimate.rate();
    let mut pixels = Vec::new();
    let mut take = |block: &Block| pixels.extend(block.all().map(|(_, pixel)| Prospect::of(&pixel, rate)));
    blocks(estimate, target.metric, |_, _| true, &mut take);
    let allowed = goal * pixels.len() as f64;
    let is_enough = |root: f64| -> bool {
        let factor = libm::pow(root, rate.value()) / rate.value();
        let left = |pixel: &Prospect| {
            let (samples, error) = pixel.now;
            if pixel.samples > samples * root { pixel.samples * factor } else { error }
        };
        // Sums of the same numbers in the same order, whoever adds them.
        let parts: Vec<f64> =
            pixels.par_chunks(PART).map(|part| part.iter().map(left).sum::<f64>()).collect();
        parts.iter().sum::<f64>() <= allowed
    };
    // The root, between where all pixels get more than they have, and where none does.
    let (sum, mut high) =
        pixels.iter().fold((0.0, 0.0), |(sum, most): (f64, f64), p| (sum + p.samples, most.max(p.samples)));
    if sum == 0.0 {
        return 0.0;
    }
    let mut low = libm::pow(rate.value() * allowed / sum, 1.0 / rate.value());
    while high > 1.001 * low {
        let middle = low.sqrt() * high.sqrt();
        if is_enough(middle) { low = middle } else { high = middle }
    }
    libm::pow(low, 1.0 + rate.value())
}

/// The pixels to which another sample is worth its time, of blocks that had any such before. What a pixel's samples vary by is told by its neighbours', too, which may have
/// met what it has missed.
pub fn wanting(
    estimate: &Estimate,
    settings: &ImageSettings,
    metric: ErrorMetric,
    worth: f64,
    before: &Activity,
) -> Activity {
    let mut wanting = Activity::none(settings, estimate.area);
    let rate = estimate.rate();
    let mut decide = |block: &Block| {
        for ((x, y), pixel) in block.all() {
            if rate.value() * pixel.spread > worth * (pixel.samples * rate.power(pixel.samples)) {
                wanting.add(x, y);
            }
        }
    };
    blocks(estimate, metric, |x, y| before.holds(y * settings.width + x), &mut decide);
    wanting
}

/// All blocks of the area that have such a pixel, row by row. Many are looked at side by side, on the current rayon pool.
fn blocks(
    estimate: &Estimate,
    metric: ErrorMetric,
    having: impl Fn(u32, u32) -> bool + Sync,
    each: &mut dyn FnMut(&Block),
) {
    let Crop { x0, y0, x1, y1 } = estimate.area;
    let look = |left: u32, top: u32| {
        let (right, bottom) = ((left + BLOCK).min(x1), (top + BLOCK).min(y1));
        if !(top..bottom).any(|y| (left..right).any(|x| having(x, y))) {
            return None;
        }
        let mut pixels = [[Sampled::default(); BLOCK as usize]; BLOCK as usize];
        for (y, row) in (top..bottom).zip(&mut pixels) {
            for (x, own) in (left..right).zip(row) {
                let pixel = estimate.pixel(estimate.place(x, y));
                let (samples, rate) = (pixel.samples as f64, estimate.rate());
                *own = Sampled { samples, spread: pixel.error(metric, rate) * rate.power(samples) };
            }
        }
        let size = ((right - left) as usize, (bottom - top) as usize);
        Some(Block { corner: (left, top), size, pixels }.smooth())
    };
    let columns = (x1 - x0).div_ceil(BLOCK);
    for top in (y0..y1).step_by(BLOCK as usize) {
        let row: Vec<Option<Block>> =
            (0..columns).into_par_iter().map(|column| look(x0 + column * BLOCK, top)).collect();
        row.iter().flatten().for_each(&mut *each);
    }
}

#[cfg(test)]
mod tests {
    use super::super::estimate::tests::{dice, film};
    use super::super::rounds::{self, Round};
    use super::*;

    #[test]
    fn blocks_that_are_good_enough_are_left_alone() {
        let settings = ImageSettings::sized(16, 8);
        let round = Round { first: 0, count: 16, batches: 8 };
        let mut estimate = Estimate::new(settings.crop, 1, 0.0).with_variances();
        let noise = |pixel: u32, sample| if pixel % 16 < 8 { 0.5 } else { dice(pixel, sample) };
        estimate.absorb(film(&round, |_| true, noise), &round);
        let target = |value| ErrorTarget { metric: ErrorMetric::Rmse, value };
        let all = Activity::all(&settings);
        let wanted = |target: ErrorTarget, before| {
            wanting(&estimate, &settings, target.metric, worth(&estimate, target), before)
        };
        // √(1/12 / 16 / 2) = 0.051 of the whole image.
        let some = wanted(target(0.04), &all);
        let right = (0..128).filter(|pixel| pixel % 16 >= 8).all(|pixel| some.holds(pixel));
        assert!(right && (0..128).filter(|pixel| pixel % 16 < 8).all(|pixel| !some.holds(pixel)));
        assert!(wanted(target(0.06), &all).is_over());
        // What was good enough once isn't looked at again.
        let none = Activity::none(&settings, settings.crop);
        assert!(wanted(target(0.001), &none).is_over());
    }

    #[test]
    fn pixels_without_error_are_left_alone_but_for_neighbours_of_others() {
        let settings = ImageSettings::sized(16, 8);
        let round = Round { first: 0, count: 16, batches: 8 };
        let mut estimate = Estimate::new(settings.crop, 1, 0.0).with_variances();
        // One noisy pixel, (10, 0).
        estimate.absorb(
            film(&round, |_| true, |pixel, sample| if pixel == 10 { dice(pixel, sample) } else { 0.5 }),
            &round,
        );
        let target = ErrorTarget { metric: ErrorMetric::Rmse, value: 0.001 };
        let worth = worth(&estimate, target);
        let wanting = wanting(&estimate, &settings, target.metric, worth, &Activity::all(&settings));
        let held: Vec<u32> = (0..128).filter(|&pixel| wanting.holds(pixel)).collect();
        assert_eq!(held, [9, 10, 11, 25, 26, 27]);
    }

    #[test]
    fn samples_follow_the_deviation_and_the_image_meets_its_target() {
        let settings = ImageSettings { spp: 4096, ..ImageSettings::sized(16, 8) };
        let target = ErrorTarget { metric: ErrorMetric::Rmse, value: 0.1 };
        // Left and right half, 1 and 8 times √(1/12) apart; halves don't share a block.
        let noise = |pixel: u32, sample| dice(pixel, sample) * if pixel % 16 < 8 { 1.0 } else { 8.0 };
        let mut estimate = Estimate::new(settings.crop, 1, 0.0).with_variances();
        let (mut activity, mut allowed) = (Activity::all(&settings), None);
        for round in
            rounds::schedule(&ImageSettings { error_target: Some(target), ..settings.clone() }, false)
        {
            estimate.absorb(film(&round, |pixel| activity.holds(pixel), noise), &round);
            let worth = *allowed.get_or_insert_with(|| worth(&estimate, target));
            activity = wanting(&estimate, &settings, target.metric, worth, &activity);
        }
        assert!(activity.is_over());
        let samples = |columns: std::ops::Range<usize>| -> f64 {
            let pixels = columns.flat_map(|x| (0..8).map(move |y| y * 16 + x));
            pixels.map(|pixel| estimate.pixel(pixel).samples as f64).sum::<f64>() / 64.0
        };
        let (few, many) = (samples(0..8), samples(8..16));
        // 37 and 300, but that rounds are up to half as long as all before.
        assert!((5.6..11.4).contains(&(many / few)), "{few} and {many}");
        let error = estimate.error(settings.crop).unwrap();
        assert!((0.8..1.1).contains(&(error.rmse / 0.1)), "{error:?}");
        // As many of each pixel would leave √(c / n), c being the mean of 1/12 and 64/12.
        let uniform = (65.0 / 24.0 / error.spp).sqrt();
        assert!(error.rmse < 0.85 * uniform, "{error:?} instead of {uniform}");
    }

    #[test]
    fn the_worth_of_a_sample_is_what_the_target_leaves() {
        let settings = ImageSettings::sized(16, 8);
        let round = Round { first: 0, count: 16, batches: 8 };
        let mut estimate = Estimate::new(settings.crop, 1, 0.0).with_variances();
        estimate.absorb(film(&round, |_| true, dice), &round);
        let target = |value| ErrorTarget { metric: ErrorMetric::Rmse, value };
        // Of n samples each takes 1/12 / n² away, n being 1/12 / target².
        for value in [0.001, 0.01, 0.05] {
            let expected = 12.0 * libm::pow(value, 4.0);
            let worth = worth(&estimate, target(value));
            assert!((worth / expected - 1.0).abs() < 0.1, "{worth} instead of {expected} for {value}");
        }
        // All need no more than they have.
        let worth = worth(&estimate, target(0.1));
        let all = Activity::all(&settings);
        assert!(wanting(&estimate, &settings, ErrorMetric::Rmse, worth, &all).is_over());
        // Nothing varies.
        let mut still = Estimate::new(settings.crop, 1, 0.0).with_variances();
        still.absorb(film(&round, |_| true, |_, _| 0.5), &round);
        assert!(
            wanting(&still, &settings, ErrorMetric::Rmse, super::worth(&still, target(0.1)), &all).is_over()
        );
    }
}
