//! How fast the means of a pixel's samples come together. Samples that are spread evenly do so faster than independent ones; by how much depends on the scene.
//!
//! Supposed is that n samples from anywhere in their sequence leave the squared error c / n^rate. Then means of half of a pixel's first samples differ in mean squares by 2^-rate of what means
//! of quarters do: the mean of all pixels tells the rate, and is taken to be as low as it may be with 95 % confidence. Only half of what it gains is counted on: pixels end when their own samples look good, and what is left in the
//! end falls more slowly than what goes first.

use super::metric::QUANTILE;
use crate::scene::Color;

/// Batches of a first round that tells the rate.
pub const QUARTERS: usize = 4;

/// The rate of independent samples.
const INDEPENDENT: f64 = 1.0;
/// That of the best points where there are edges. Two samples may be better than one by more, but not so many samples.
const BEST: f64 = 1.5;
/// How much of what a rate is above that of independent samples is counted on.
const TRUSTED: f64 = 0.5;

/// A rate, with powers of small numbers at hand: each pixel asks for some.
#[derive(Clone, Debug)]
pub struct Rate {
    value: f64,
    /// `powers[n]` is n^rate; empty where that is n.
    powers: Vec<f64>,
}

impl Rate {
    /// Numbers whose powers are at hand.
    const SMALL: usize = 1024;

    pub fn new(value: f64) -> Self {
        Rate { value, powers: (0..Rate::SMALL).map(|n| libm::pow(n as f64, value)).collect() }
    }

    pub fn value(&self) -> f64 {
        self.value
    }

    /// n^rate, of n from 0 on.
    pub fn power(&self, n: f64) -> f64 {
        match self.powers.get(n as usize) {
            Some(&power) if n == f64::from(n as u32) => power,
            _ if self.value == INDEPENDENT => n,
            _ => libm::pow(n, self.value),
        }
    }
}

impl Default for Rate {
    /// That of independent samples.
    fn default() -> Self {
        Rate { value: INDEPENDENT, powers: Vec::new() }
    }
}

/// Squares by which means of a cell's first samples differ, by channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Halving {
    /// The first two quarters, and the last two, on average.
    quarters: [f32; 3],
    halves: [f32; 3],
}

impl Halving {
    pub fn of_quarters([a, b, c, d]: [Color; QUARTERS]) -> Self {
        let mut found = Halving::default();
        for k in 0..3 {
            let (first, second) = (a[k] - b[k], c[k] - d[k]);
            let halves = 0.5 * ((a[k] + b[k]) - (c[k] + d[k]));
            found.quarters[k] = (0.5 * (first * first + second * second)) as f32;
            found.halves[k] = (halves * halves) as f32;
        }
        found
    }
}

/// Sums over the cells of a block of pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Halvings {
    quarters: f64,
    halves: f64,
}

impl Halvings {
    /// Adds a cell whose channels count by these weights.
    pub fn add(&mut self, cell: &Halving, weights: [f64; 3]) {
        for k in 0..3 {
            self.quarters += weights[k] * f64::from(cell.quarters[k]);
            self.halves += weights[k] * f64::from(cell.halves[k]);
        }
    }

    /// The sums over their standard deviation: so blocks count as the samples do that they will get.
    fn by_deviation(self) -> Self {
        // Of independent samples the first sum is expected to be twice the other.
        let deviation = (self.quarters + 2.0 * self.halves).sqrt();
        let over = if deviation > 0.0 { 1.0 / deviation } else { 0.0 };
        Halvings { quarters: over * self.quarters, halves: over * self.halves }
    }
}

/// The rate that is counted on by what blocks of pixels tell, 1 to 1.25; that of independent samples where nothing differs, or where a single block tells it all.
pub fn find(blocks: &[Halvings]) -> f64 {
    let (mut all, mut squares) = (Halvings::default(), 0.0);
    let blocks = || blocks.iter().map(|block| block.by_deviation());
    for block in blocks() {
        all.quarters += block.quarters;
        all.halves += block.halves;
        squares += block.quarters * block.quarters;
    }
    if all.quarters == 0.0 || all.halves == 0.0 {
        return INDEPENDENT;
    }
    // The ratio of two sums over blocks, and how far it is off (Cochran 1977, "Sampling Techniques", section 6.3): of as many blocks as count alike.
    let count = all.quarters * all.quarters / squares;
    let ratio = all.quarters / all.halves;
    let residues: f64 =
        blocks().map(|block| block.quarters - ratio * block.halves).map(|off| off * off).sum();
    let off = QUANTILE * (residues * count / (count - 1.0).max(0.0)).sqrt() / all.quarters;
    // Nothing is known where that isn't a number.
    let least = if off < 1.0 { libm::log2(ratio * (1.0 - off)) } else { INDEPENDENT };
    INDEPENDENT + TRUSTED * (least.clamp(INDEPENDENT, BEST) - INDEPENDENT)
}

#[cfg(test)]
mod tests {
    use super::super::estimate::tests::dice;
    use super::*;

    /// The rate by 4096 pixels whose samples 0 .. 16 are these numbers.
    fn told(sample: impl Fn(u32, u32) -> f64) -> f64 {
        let blocks: Vec<Halvings> = (0..64)
            .map(|block| {
                let mut sums = Halvings::default();
                for pixel in 64 * block..64 * (block + 1) {
                    let mean = |q: u32| (4 * q..4 * q + 4).map(|s| sample(pixel, s)).sum::<f64>() / 4.0;
                    let quarters = [0, 1, 2, 3].map(|q| [mean(q); 3]);
                    sums.add(&Halving::of_quarters(quarters), [1.0; 3]);
                }
                sums
            })
            .collect();
        find(&blocks)
    }

    #[test]
    fn independent_samples_tell_a_rate_of_one() {
        let rate = told(dice);
        assert!((1.0..1.05).contains(&rate), "{rate}");
    }

    #[test]
    fn samples_spread_evenly_tell_more() {
        // Strata of a sixteenth in bit-reversed order: every aligned run of 2^k samples has one in each 2^-k of the way.
        let rate = told(|pixel, sample| {
            let stratum = (sample.reverse_bits() >> 28) ^ (dice(pixel, 99) * 16.0) as u32;
            (f64::from(stratum) + dice(pixel, sample)) / 16.0
        });
        assert_eq!(rate, 1.25);
    }

    #[test]
    fn what_never_differs_tells_nothing_nor_does_a_single_block() {
        assert_eq!(told(|_, _| 0.25), 1.0);
        let alone =
            |pixel, sample: u32| if pixel < 64 { f64::from(sample.reverse_bits() >> 28) } else { 0.25 };
        assert_eq!(told(alone), 1.0);
        let some =
            |pixel, sample: u32| if pixel < 640 { f64::from(sample.reverse_bits() >> 28) } else { 0.25 };
        assert_eq!(told(some), 1.25);
    }
}
