//! Counts of verdicts and the spread of errors, in constant memory. Sums of whole numbers and maxima: the same however the
//! rays were divided.

use serde::{Deserialize, Serialize};

use super::judge::{Judged, Verdict};

/// What became of the rays of one body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    pub rays: u64,
    pub leaks: u64,
    pub misses: u64,
    pub skipped: u64,
    pub false_hits: u64,
    pub self_hits: u64,
    /// Rays to which two structures, or the questions "closest" and "occluded", gave different answers.
    pub differ: u64,
    pub too_close: u64,
    /// |t - exact t| in ulps of f32 at the exact t.
    pub ulps: Spread,
    /// |t - exact t| over 2^-53 (|origin| + |vertex|) / |direction|.
    pub fine: Spread,
    /// The first ray that was judged wrong.
    pub first_wrong: Option<u64>,
}

impl Tally {
    pub fn count(&mut self, index: u64, judged: &Judged, differs: bool) {
        self.rays += 1;
        self.differ += u64::from(differs);
        let column = match judged.verdict {
            Verdict::Right => None,
            Verdict::TooClose => Some(&mut self.too_close),
            Verdict::Leak => Some(&mut self.leaks),
            Verdict::Miss => Some(&mut self.misses),
            Verdict::Skipped => Some(&mut self.skipped),
            Verdict::FalseHit => Some(&mut self.false_hits),
            Verdict::SelfHit => Some(&mut self.self_hits),
        };
        if let Some(column) = column {
            *column += 1;
        }
        if differs || !matches!(judged.verdict, Verdict::Right | Verdict::TooClose) {
            self.first_wrong = earlier(self.first_wrong, Some(index));
        }
        if let Some(error) = judged.error {
            // At t = 0 there is no ulp to measure by.
            if error.t != 0.0 {
                self.ulps.add(error.error / libm::scalbn(1.0, libm::ilogb(error.t) - 23));
            }
            self.fine.add(error.fine);
        }
    }

    pub fn merge(&mut self, other: &Tally) {
        for (sum, more) in [
            (&mut self.rays, other.rays),
            (&mut self.leaks, other.leaks),
            (&mut self.misses, other.misses),
            (&mut self.skipped, other.skipped),
            (&mut self.false_hits, other.false_hits),
            (&mut self.self_hits, other.self_hits),
            (&mut self.differ, other.differ),
            (&mut self.too_close, other.too_close),
        ] {
            *sum += more;
        }
        self.ulps.merge(&other.ulps);
        self.fine.merge(&other.fine);
        self.first_wrong = earlier(self.first_wrong, other.first_wrong);
    }

    /// The number of wrong answers.
    pub fn wrong(&self) -> u64 {
        self.leaks + self.misses + self.skipped + self.false_hits + self.self_hits + self.differ
    }
}

fn earlier(a: Option<u64>, b: Option<u64>) -> Option<u64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        _ => a.or(b),
    }
}

/// A histogram of numbers >= 0: eight classes for each power of two from 2^-64 to 2^64.
#[derive(Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Class 0 is 0 itself and what is smaller. Empty until there is something to count.
    classes: Vec<u64>,
    pub largest: f64,
}

impl std::fmt::Debug for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} numbers up to {:e}", self.classes.iter().sum::<u64>(), self.largest)
    }
}

const CLASSES: usize = 1 + 128 * 8;
/// The upper bits of 2^-64: exponent and three bits of the fraction.
const LOWEST: u64 = (1023 - 64) << 3;

impl Spread {
    pub fn add(&mut self, value: f64) {
        self.classes.resize(CLASSES, 0);
        let class = (value.to_bits() >> 49).saturating_sub(LOWEST - 1).min(CLASSES as u64 - 1);
        self.classes[class as usize] += 1;
        self.largest = self.largest.max(value);
    }

    fn merge(&mut self, other: &Spread) {
        if other.classes.len() == CLASSES {
            self.classes.resize(CLASSES, 0);
            self.classes.iter_mut().zip(&other.classes).for_each(|(sum, more)| *sum += more);
        }
        self.largest = self.largest.max(other.largest);
    }

    /// An upper limit, at most an eighth too large, of this part of all numbers; 0 where there are none.
    pub fn quantile(&self, part: f64) -> f64 {
        let total: u64 = self.classes.iter().sum();
        let wanted = (total as f64 * part).ceil() as u64;
        let mut below = 0;
        for (class, count) in self.classes.iter().enumerate() {
            below += count;
            if below >= wanted {
                let end = if class == 0 { 0.0 } else { f64::from_bits((LOWEST + class as u64) << 49) };
                return end.min(self.largest);
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_upper_limits_within_an_eighth() {
        let mut spread = Spread::default();
        assert_eq!(spread.quantile(0.5), 0.0);
        (1..=1000).for_each(|k| spread.add(f64::from(k) / 8.0));
        for part in [0.1, 0.5, 0.999] {
            let exact = f64::ceil(1000.0 * part) / 8.0;
            let limit = spread.quantile(part);
            assert!(limit >= exact && limit <= exact * 1.13, "{part}: {limit} for {exact}");
        }
        assert_eq!(spread.quantile(1.0), 125.0);
    }

    #[test]
    fn parts_in_any_order_give_the_same() {
        let tally = |indices: std::ops::Range<u64>| {
            let mut tally = Tally::default();
            for index in indices {
                let verdict = if index % 7 == 3 { Verdict::Leak } else { Verdict::Right };
                let error =
                    super::super::judge::TError { t: 1.5, error: 1e-9 * index as f64, fine: index as f64 };
                tally.count(index, &Judged { verdict, error: Some(error) }, index == 90);
            }
            tally
        };
        let whole = tally(0..100);
        let mut parts = tally(40..100);
        parts.merge(&Tally::default());
        parts.merge(&tally(0..40));
        assert_eq!(parts, whole);
        assert_eq!((whole.leaks, whole.differ, whole.first_wrong), (14, 1, Some(3)));
        assert_eq!(whole.wrong(), 15);
    }
}
