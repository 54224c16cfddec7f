//! Numbers to sample by, and how far a mean or a histogram may be from what it should be.

use std::f64::consts::SQRT_2;

/// SplitMix64 (Steele, Lea and Flood 2014).
pub struct Random(pub u64);

impl Random {
    pub fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn numbers<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.number())
    }
}

/// Significance of each of `count` independent tests that together are wrong once in a hundred times (Šidák).
pub fn each_of(count: usize) -> f64 {
    1.0 - libm::pow(0.99, 1.0 / count as f64)
}

/// The number that a standard normal variable exceeds with a chance of `tail`.
fn normal_quantile(tail: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if 0.5 * libm::erfc(middle / SQRT_2) > tail { low = middle } else { high = middle }
    }
    high
}

/// The χ² that is exceeded with a chance of `tail` (Wilson and Hilferty 1931).
pub fn chi_square_limit(freedom: usize, tail: f64) -> f64 {
    let part = 2.0 / (9.0 * freedom as f64);
    let root = 1.0 - part + normal_quantile(tail) * part.sqrt();
    freedom as f64 * root * root * root
}

/// χ² of counts against what was expected, and its degrees of freedom. What is expected fewer than 5 times is put together.
pub fn chi_square(counted: &[f64], expected: &[f64]) -> (f64, usize) {
    let (mut sum, mut bins) = (0.0, 0usize);
    let (mut rest_counted, mut rest_expected) = (0.0, 0.0);
    let mut add = |counted: f64, expected: f64| {
        sum += (counted - expected) * (counted - expected) / expected;
        bins += 1;
    };
    for (&counted, &expected) in counted.iter().zip(expected) {
        if expected > 5.0 {
            add(counted, expected);
        } else {
            rest_counted += counted;
            rest_expected += expected;
        }
    }
    // Too few for the approximation, yet what can't happen must not.
    if rest_expected > 5.0 || rest_counted > rest_expected + 20.0 {
        add(rest_counted, rest_expected.max(1e-3));
    }
    (sum, bins.saturating_sub(1).max(1))
}

/// Mean and standard error of independent estimates.
pub fn mean_and_error(estimates: &[f64]) -> [f64; 2] {
    let n = estimates.len() as f64;
    let mean = estimates.iter().sum::<f64>() / n;
    let squares = estimates.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>();
    [mean, (squares / (n * (n - 1.0))).sqrt()]
}
