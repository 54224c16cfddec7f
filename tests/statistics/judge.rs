//! Whether two sets of images have the same mean, or one has that of a formula. Each image of a set has a seed of its own, and nothing is assumed of
//! how the samples of one image hang together: that is what makes quasi-random points judgeable.

use heliostat::image::Image;
use heliostat::output::student::two_sided_p;

use super::stage::brightness;

/// The largest |z| of the mean of whole images that passes.
pub const LIMIT: f64 = 4.0;
/// The chance with which a test of all pixels condemns what is right.
pub const LEVEL: f64 = 0.01;

/// Mean and its squared standard error, of independent numbers.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    pub mean: f64,
    pub error2: f64,
    /// How many numbers it is of.
    pub count: f64,
}

impl Estimate {
    pub fn of(numbers: impl Iterator<Item = f64> + Clone) -> Self {
        let count = numbers.clone().count() as f64;
        let mean = numbers.clone().sum::<f64>() / count;
        let squares = numbers.map(|x| (x - mean) * (x - mean)).sum::<f64>();
        Estimate { mean, error2: squares / (count - 1.0) / count, count }
    }

    /// What is known exactly.
    pub fn exact(mean: f64) -> Self {
        Estimate { mean, error2: 0.0, count: f64::INFINITY }
    }

    pub fn error(&self) -> f64 {
        self.error2.sqrt()
    }

    /// How many standard errors this is above the other.
    pub fn z(&self, other: &Estimate) -> f64 {
        let difference = self.mean - other.mean;
        // Film sums are in steps of 2^-32 and images in f32: what differs by less than that is the same.
        if difference.abs() <= 1e-6 * self.mean.abs() {
            return 0.0;
        }
        difference / (self.error2 + other.error2).sqrt()
    }

    /// The chance of a difference as large as that to the other if both had the same mean (Welch 1947).
    pub fn chance(&self, other: &Estimate) -> f64 {
        let z = self.z(other);
        if z == 0.0 || z.is_infinite() {
            return if z == 0.0 { 1.0 } else { 0.0 };
        }
        let part = |e: &Estimate| if e.error2 > 0.0 { e.error2 * e.error2 / (e.count - 1.0) } else { 0.0 };
        let sum = self.error2 + other.error2;
        two_sided_p(z, sum * sum / (part(self) + part(other)))
    }
}

/// A set of images, or what a formula says of them.
#[derive(Clone, Debug)]
pub struct Evidence {
    pub pixels: Vec<Estimate>,
    /// Of the mean of all pixels.
    pub whole: Estimate,
}

impl Evidence {
    pub fn of(images: &[Image]) -> Self {
        let pixel = |i: usize| Estimate::of(images.iter().map(move |image| brightness(&image.pixels[i])));
        let whole = Estimate::of(images.iter().map(super::stage::mean));
        Evidence { pixels: (0..images[0].pixels.len()).map(pixel).collect(), whole }
    }

    pub fn exact(pixels: &[f64]) -> Self {
        let whole = Estimate::exact(pixels.iter().sum::<f64>() / pixels.len() as f64);
        Evidence { pixels: pixels.iter().map(|&mean| Estimate::exact(mean)).collect(), whole }
    }

    /// Of pixels of the image that are told.
    pub fn scaled(&self, factor: impl Fn(usize) -> f64) -> Self {
        let scale = |e: &Estimate, f: f64| Estimate { mean: e.mean * f, error2: e.error2 * f * f, ..*e };
        let pixels: Vec<_> = self.pixels.iter().enumerate().map(|(i, e)| scale(e, factor(i))).collect();
        let sum = |pixels: &[Estimate]| pixels.iter().map(|e| e.mean).sum::<f64>();
        let whole = scale(&self.whole, sum(&pixels) / sum(&self.pixels));
        Evidence { pixels, whole }
    }
}

/// What both tests say.
#[derive(Clone, Copy, Debug)]
pub struct Verdict {
    /// Of the mean of whole images.
    pub z: f64,
    /// The relative difference of those means, and its standard error.
    pub off: f64,
    pub off_error: f64,
    /// The worst of all pixels, and the chance that it is as bad as it is (Šidák's correction).
    pub pixel: usize,
    pub chance: f64,
}

impl Verdict {
    pub fn of(found: &Evidence, expected: &Evidence) -> Self {
        let pairs = found.pixels.iter().zip(&expected.pixels);
        let chances = pairs.map(|(a, b)| a.chance(b)).enumerate();
        let (pixel, least) = chances.min_by(|(_, a), (_, b)| a.total_cmp(b)).expect("a pixel");
        let (a, b) = (&found.whole, &expected.whole);
        Verdict {
            z: a.z(b),
            off: a.mean / b.mean - 1.0,
            off_error: (a.error2 + b.error2).sqrt() / b.mean,
            pixel,
            chance: -libm::expm1(found.pixels.len() as f64 * libm::log1p(-least)),
        }
    }

    pub fn whole_is_right(&self) -> bool {
        self.z.abs() < LIMIT
    }

    pub fn pixels_are_right(&self) -> bool {
        self.chance > LEVEL
    }

    /// Fails the test where one of both fails.
    pub fn pass(&self, what: &str) {
        println!("{what}: {self}");
        assert!(self.whole_is_right() && self.pixels_are_right(), "{what}: {self}");
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Verdict { z, off, off_error, pixel, chance } = self;
        let (off, off_error) = (100.0 * off, 100.0 * off_error);
        write!(f, "z = {z:+.2}, off by {off:+.4} % ± {off_error:.4} %, pixel {pixel} worst, p = {chance:.3}")
    }
}
