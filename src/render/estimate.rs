//! What a film knows of itself: means of pixels, the variances of these, and so how far the image is from its limit.
//!
//! Variances come from the means of batches: for n samples in B batches of n_b samples and means m_b the variance of one sample is estimated as Σ n_b (m_b − m)² / (B − 1), that
//! of the mean m as its n-th part. It holds for independent batches; of samples that are spread evenly it says too much, not too little. How much it is, the first round
//! tells where an error is to be met: see `rate`.

use rayon::prelude::*;

use super::features::{Features, PLANES};
use super::film::{Cell, Film};
use super::metric::{ErrorReached, Moments, weight};
use super::rate::{self, Halving, Halvings, QUARTERS, Rate};
use super::rounds::{BLOCK, Round};
use crate::image::Image;
use crate::memory::{Array, HugeArray};
use crate::scene::Frame;
use crate::settings::{Crop, ErrorMetric};

/// The film of all rounds so far.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub(super) area: Crop,
    /// Of the filter: 1 or 2.
    planes: usize,
    /// See `FilterTable::negative_mass`.
    negative_mass: f64,
    /// `cells[pixel * planes + plane]`.
    cells: HugeArray<Cell>,
    /// Of each cell Σ n_b m_b² and the number of batches; empty where nobody asks for variances.
    squares: Vec<([f64; 3], u32)>,
    /// Whether the first round shall tell the rate.
    finds_rate: bool,
    /// Of each cell, right after a first round that tells them; else empty.
    halvings: Vec<Halving>,
    /// By which squared errors of pixels fall.
    rate: Rate,
    /// Of each pixel the planes of [`Features`]; empty where nobody asks for them.
    features: Vec<[Cell; PLANES]>,
}

/// How well the means of an image's pixels are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spread {
    /// Of each pixel's mean.
    pub variance: Vec<[f32; 3]>,
    /// The degrees of freedom of that: of B batches B - 1, or what Welch gives both planes together. 0 where it isn't known.
    pub freedom: Vec<f32>,
}

/// A pixel's mean and the variance of that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    mean: [f64; 3],
    variance: [f64; 3],
    /// See [`Spread::freedom`].
    freedom: f64,
    pub samples: u64,
}

impl Pixel {
    /// The squared error that is expected of the mean, as the metric counts it, if that of B batches falls as B^-rate.
    pub fn error(&self, metric: ErrorMetric, rate: &Rate) -> f64 {
        let weighted = |k: usize| weight(metric, self.mean[k]) * self.variance[k];
        let independent = (weighted(0) + weighted(1) + weighted(2)) / 3.0;
        let batches = self.freedom + 1.0;
        independent * (batches / rate.power(batches))
    }
}

/// A row of the image; what nobody asks for is empty.
struct Row<'e> {
    planes: usize,
    cells: &'e mut [Cell],
    squares: &'e mut [([f64; 3], u32)],
    halvings: &'e mut [Halving],
    features: &'e mut [[Cell; PLANES]],
}

impl Row<'_> {
    /// Takes in what a round's film has of a pixel: a part for each batch, and features.
    fn absorb(&mut self, pixel: usize, (parts, features): (&[Cell], &[Cell])) {
        for (own, new) in self.features.get_mut(pixel).into_iter().flatten().zip(features) {
            own.merge(new);
        }
        for plane in 0..self.planes {
            let index = pixel * self.planes + plane;
            let parts = parts.iter().skip(plane).step_by(self.planes);
            if let Some(halving) = self.halvings.get_mut(index) {
                let mut means = parts.clone().map(Cell::mean);
                if let [Some(a), Some(b), Some(c), Some(d)] = [(); QUARTERS].map(|()| means.next().flatten())
                {
                    *halving = Halving::of_quarters([a, b, c, d]);
                }
            }
            for part in parts.filter(|part| part.count > 0) {
                self.cells[index].merge(part);
                if let Some((squares, count)) = self.squares.get_mut(index) {
                    let mean = part.mean().unwrap_or_default();
                    for k in 0..3 {
                        squares[k] += part.count as f64 * (mean[k] * mean[k]);
                    }
                    *count += 1;
                }
            }
        }
    }
}

impl Estimate {
    /// For films of this area and a filter of so many planes.
    ///
    /// # Panics
    /// Out of memory.
    pub fn new(area: Crop, planes: usize, negative_mass: f64) -> Self {
        let cells = area.width() as usize * area.height() as usize * planes;
        let cells = HugeArray::zeroed(cells).expect("memory for an image's sums");
        Estimate {
            area,
            planes,
            negative_mass,
            cells,
            squares: Vec::new(),
            finds_rate: false,
            halvings: Vec::new(),
            rate: Rate::default(),
            features: Vec::new(),
        }
    }

    /// Wants variances to be known.
    pub fn with_variances(mut self) -> Self {
        self.squares = vec![Default::default(); self.cells.len()];
        self
    }

    /// Wants the first round to tell the [`rate`], for samples that are spread evenly.
    pub fn with_rate(mut self) -> Self {
        self.finds_rate = true;
        self
    }

    /// Wants features to be known: the films have planes for them.
    pub fn with_features(mut self) -> Self {
        self.features = vec![Default::default(); self.cells.len() / self.planes];
        self
    }

    /// Takes in the film of a round, which has `round.batches` times the filter's planes. On the current rayon pool.
    pub fn absorb(&mut self, film: Film, round: &Round) {
        if round.batches == 1 && self.squares.is_empty() && self.features.is_empty() && round.first == 0 {
            self.cells = film.into_cells();
            return;
        }
        let planes = self.planes;
        let lights = planes * round.batches as usize;
        let all = lights + if self.features.is_empty() { 0 } else { PLANES };
        let width = self.area.width() as usize;
        let tells = self.finds_rate && round.first == 0 && round.batches as usize == QUARTERS;
        self.halvings = vec![Halving::default(); if tells { self.cells.len() } else { 0 }];
        let mut squares = self.squares.chunks_mut(width * planes);
        let mut halvings = self.halvings.chunks_mut(width * planes);
        let mut features = self.features.chunks_mut(width);
        let rows: Vec<Row> = self
            .cells
            .chunks_mut(width * planes)
            .map(|cells| Row {
                planes,
                cells,
                squares: squares.next().unwrap_or_default(),
                halvings: halvings.next().unwrap_or_default(),
                features: features.next().unwrap_or_default(),
            })
            .collect();
        let film = film.into_cells();
        rows.into_par_iter().zip(film.par_chunks(width * all)).for_each(|(mut row, film)| {
            for (pixel, parts) in film.chunks_exact(all).enumerate() {
                row.absorb(pixel, parts.split_at(lights));
            }
        });
    }

    /// Finds the [`rate`] where it is wanted, right after a first round of [`QUARTERS`] batches; the errors that are told from then on go by it.
    /// On the current rayon pool.
    pub fn find_rate(&mut self, metric: ErrorMetric) {
        if self.halvings.is_empty() {
            return;
        }
        let estimate = &*self;
        let Crop { x0, y0, x1, y1 } = self.area;
        let columns = (x1 - x0).div_ceil(BLOCK);
        let blocks = (0..columns * (y1 - y0).div_ceil(BLOCK)).into_par_iter().map(|block| {
            let (left, top) = (x0 + block % columns * BLOCK, y0 + block / columns * BLOCK);
            let mut sums = Halvings::default();
            for y in top..(top + BLOCK).min(y1) {
                for x in left..(left + BLOCK).min(x1) {
                    let place = estimate.place(x, y);
                    let weights = estimate.pixel(place).mean.map(|mean| weight(metric, mean));
                    for halving in &estimate.halvings[place * self.planes..][..self.planes] {
                        sums.add(halving, weights);
                    }
                }
            }
            sums
        });
        self.rate = Rate::new(rate::find(&blocks.collect::<Vec<_>>()));
    }

    pub(super) fn rate(&self) -> &Rate {
        &self.rate
    }

    pub(super) fn pixel(&self, pixel: usize) -> Pixel {
        let mut found = Pixel { mean: [0.0; 3], variance: [0.0; 3], freedom: 0.0, samples: 0 };
        let mut known = [(0.0, 0.0); 2];
        let both = self.planes == 2 && (0..2).all(|plane| self.cells[pixel * 2 + plane].count > 0);
        for plane in 0..self.planes {
            let index = pixel * self.planes + plane;
            let cell = &self.cells[index];
            let Some(mean) = cell.mean() else { continue };
            let factor = match plane {
                _ if !both => 1.0,
                0 => 1.0 + self.negative_mass,
                _ => -self.negative_mass,
            };
            found.samples += cell.count;
            for k in 0..3 {
                found.mean[k] += factor * mean[k];
            }
            if let Some(&(squares, batches)) = self.squares.get(index)
                && batches > 1
            {
                let (n, freedom) = (cell.count as f64, f64::from(batches - 1));
                let mut sum = 0.0;
                for k in 0..3 {
                    let spread = (squares[k] - n * (mean[k] * mean[k])).max(0.0);
                    let variance = factor * factor * spread / (freedom * n);
                    found.variance[k] += variance;
                    sum += variance;
                }
                known[plane] = (sum, freedom);
            }
        }
        // Welch 1947; where nothing varies, that of the plane of more batches.
        let sum = known[0].0 + known[1].0;
        let parts = known.iter().filter(|(variance, _)| *variance > 0.0).map(|(v, freedom)| v * v / freedom);
        found.freedom = if sum > 0.0 { sum * sum / parts.sum::<f64>() } else { known[0].1.max(known[1].1) };
        found
    }

    /// The asked-for part of the image: mean radiance of each pixel, blended with `floor` as (1 - floor) * radiance + floor; and, if that is known, how well these means are.
    /// On the current rayon pool.
    pub fn resolve(&self, crop: Crop, floor: f64) -> (Image, Option<Spread>) {
        let mut image = Image::new(crop.width(), crop.height());
        let known = if self.squares.is_empty() { 0 } else { image.pixels.len() };
        let mut spread = Spread { variance: vec![[0.0; 3]; known], freedom: vec![0.0; known] };
        let width = (crop.width() as usize).max(1);
        let (mut variances, mut freedoms) =
            (spread.variance.chunks_mut(width), spread.freedom.chunks_mut(width));
        let rows: Vec<_> = (crop.y0..)
            .zip(image.pixels.chunks_mut(width))
            .map(|(y, pixels)| {
                (y, pixels, variances.next().unwrap_or_default(), freedoms.next().unwrap_or_default())
            })
            .collect();
        rows.into_par_iter().for_each(|(y, pixels, variance, freedom)| {
            for (column, (x, colour)) in (crop.x0..).zip(pixels).enumerate() {
                let pixel = self.pixel(self.place(x, y));
                *colour = pixel.mean.map(|c| ((1.0 - floor) * c + floor) as f32);
                if let (Some(variance), Some(freedom)) = (variance.get_mut(column), freedom.get_mut(column)) {
                    *variance = pixel.variance.map(|v| ((1.0 - floor) * (1.0 - floor) * v) as f32);
                    *freedom = pixel.freedom as f32;
                }
            }
        });
        (image, (!self.squares.is_empty()).then_some(spread))
    }

    /// What the first surfaces of the asked-for part are, if that is known.
    pub fn features(&self, crop: Crop, frame: &Frame) -> Option<Features> {
        let mut features = Features::default();
        for y in crop.y0..crop.y1 {
            for x in crop.x0..crop.x1 {
                let place = self.place(x, y);
                let cells = self.cells[place * self.planes..][..self.planes].iter();
                let samples = cells.map(|cell| cell.count).sum();
                features.push(self.features.get(place)?, samples, frame);
            }
        }
        Some(features)
    }

    pub(super) fn place(&self, x: u32, y: u32) -> usize {
        (y - self.area.y0) as usize * self.area.width() as usize + (x - self.area.x0) as usize
    }

    /// What the samples say of the error of the asked-for part; `None` where variances aren't known: of single samples they aren't.
    pub fn error(&self, crop: Crop) -> Option<ErrorReached> {
        if self.squares.is_empty() {
            return None;
        }
        let (mut samples, mut pixels, mut known) = (0.0, 0.0, false);
        let mut sums = [Moments::default(); 2];
        for y in crop.y0..crop.y1 {
            for x in crop.x0..crop.x1 {
                let pixel = self.pixel(self.place(x, y));
                samples += pixel.samples as f64;
                pixels += 1.0;
                known |= pixel.freedom > 0.0;
                for (sums, metric) in sums.iter_mut().zip([ErrorMetric::Rmse, ErrorMetric::Relmse]) {
                    sums.add(pixel.error(metric, &self.rate));
                }
            }
        }
        if !known {
            return None;
        }
        let [(mse, most), (rel_mse, rel_most)] = sums.map(|sums| sums.estimate());
        Some(ErrorReached {
            rmse: mse.sqrt(),
            rmse_at_most: most.sqrt(),
            rel_mse,
            rel_mse_at_most: rel_most,
            spp: samples / pixels,
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::DVec3;

    use super::super::film::TileFilm;
    use super::super::tile::Tile;
    use super::*;
    use crate::geometry::record::RayRecord;
    use crate::settings::ImageSettings;

    /// These pixels' samples of a round of an image of 16 x 8 pixels.
    pub fn film(round: &Round, holds: impl Fn(u32) -> bool, noise: impl Fn(u32, u32) -> f64) -> Film {
        let area = Crop { x0: 0, y0: 0, x1: 16, y1: 8 };
        let tile = Tile { x0: 0, y0: 0, x1: 16, y1: 8 };
        let mut part = TileFilm::new(tile, 16, round.batches as usize);
        for pixel in (0..128).filter(|&pixel| holds(pixel)) {
            for sample in round.first..round.first + round.count {
                let record =
                    RayRecord::camera(DVec3::ZERO, DVec3::X, pixel, sample, round.batch(sample) as u8);
                part.count(&record);
                part.deposit(&record, [noise(pixel, sample); 3]);
            }
        }
        let mut film = Film::new(area, round.batches as usize);
        film.merge(tile, part.as_bytes()).unwrap();
        film
    }

    /// A number in [0, 1).
    pub fn dice(pixel: u32, sample: u32) -> f64 {
        let mut z = (u64::from(pixel) << 32 | u64::from(sample)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / 9_007_199_254_740_992.0
    }

    #[test]
    fn the_variance_is_that_of_the_samples() {
        let settings = ImageSettings::sized(16, 8);
        let rounds = [
            Round { first: 0, count: 16, batches: 8 },
            Round { first: 16, count: 8, batches: 4 },
            Round { first: 24, count: 24, batches: 4 },
        ];
        let mut estimate = Estimate::new(settings.crop, 1, 0.0).with_variances();
        for round in &rounds {
            estimate.absorb(film(round, |_| true, |pixel, sample| 2.0 + dice(pixel, sample)), round);
        }
        let (image, spread) = estimate.resolve(settings.crop, 0.0);
        let Spread { variance, freedom } = spread.unwrap();
        assert_eq!(freedom, [15.0; 128]);
        // Of one sample 1/12.
        let expected = 1.0 / 12.0 / 48.0;
        let mean: f64 = variance.iter().map(|v| f64::from(v[1])).sum::<f64>() / 128.0;
        assert!((mean / expected - 1.0).abs() < 0.1, "{mean} instead of {expected}");
        let error = estimate.error(settings.crop).unwrap();
        assert!((error.rmse * error.rmse / mean - 1.0).abs() < 1e-5 && error.spp == 48.0);
        let truth: f64 = image
            .pixels
            .iter()
            .map(|p| {
                let d = f64::from(p[0]) - 2.5;
                d * d
            })
            .sum::<f64>()
            / 128.0;
        assert!(truth.sqrt() < error.rmse_at_most && error.rmse_at_most < 1.3 * error.rmse);
        assert!((error.rel_mse / (mean / 6.26) - 1.0).abs() < 0.05);
    }
}
