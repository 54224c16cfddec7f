//! Numbers as unevaluated sums of two f64: about 104 bits, from plain operations that round one by one (Dekker 1971, "A Floating-Point
//! Technique for Extending the Available Precision"). No fused multiply-add: the same bits on every processor.

use std::ops::{Add, Mul, Sub};

/// high + low, |low| at most half an ulp of high. Products beyond 2^990 give NaN.
#[derive(Clone, Copy, Debug)]
pub struct Twofold {
    high: f64,
    low: f64,
}

impl From<f64> for Twofold {
    fn from(high: f64) -> Self {
        Twofold { high, low: 0.0 }
    }
}

impl Twofold {
    /// a + b, exactly (Knuth).
    fn sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let b_part = high - a;
        let a_part = high - b_part;
        Twofold { high, low: (a - a_part) + (b - b_part) }
    }

    /// a - b, exactly.
    pub fn difference(a: f64, b: f64) -> Self {
        Twofold::sum(a, -b)
    }

    /// a * b, exactly but for underflow.
    fn product(a: f64, b: f64) -> Self {
        let ((a1, a2), (b1, b2)) = (halves(a), halves(b));
        let high = a * b;
        Twofold { high, low: ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2 }
    }

    /// Rounded to f64.
    pub fn value(self) -> f64 {
        self.high + self.low
    }

    /// self / other, rounded to f64.
    pub fn ratio(self, other: Twofold) -> f64 {
        let first = self.high / other.high;
        let rest = self - other * Twofold::from(first);
        first + (rest.high + rest.low) / other.high
    }
}

impl Add for Twofold {
    type Output = Twofold;

    fn add(self, other: Twofold) -> Twofold {
        let (high, low) = (Twofold::sum(self.high, other.high), Twofold::sum(self.low, other.low));
        let sum = Twofold::sum(high.high, high.low + low.high);
        Twofold::sum(sum.high, sum.low + low.low)
    }
}

impl Sub for Twofold {
    type Output = Twofold;

    fn sub(self, other: Twofold) -> Twofold {
        self + Twofold { high: -other.high, low: -other.low }
    }
}

impl Mul for Twofold {
    type Output = Twofold;

    fn mul(self, other: Twofold) -> Twofold {
        let product = Twofold::product(self.high, other.high);
        let cross = self.high * other.low + self.low * other.high;
        Twofold::sum(product.high, product.low + cross)
    }
}

/// p - q, exactly.
pub fn differences(p: [f64; 3], q: [f64; 3]) -> [Twofold; 3] {
    std::array::from_fn(|axis| Twofold::difference(p[axis], q[axis]))
}

pub fn twofold_dot(p: &[Twofold; 3], q: &[Twofold; 3]) -> Twofold {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

pub fn twofold_cross(p: &[Twofold; 3], q: &[Twofold; 3]) -> [Twofold; 3] {
    std::array::from_fn(|axis| {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        p[i] * q[j] - p[j] * q[i]
    })
}

/// A number as two of 26 bits each (Veltkamp).
fn halves(a: f64) -> (f64, f64) {
    let wide = a * 134_217_729.0;
    let upper = wide - (wide - a);
    (upper, a - upper)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_f64_would_drop_is_kept() {
        let tiny = libm::exp2(-90.0);
        let one = Twofold::from(1.0) + Twofold::from(tiny);
        assert_eq!((one - Twofold::from(1.0)).high, tiny);
        // (1 + e)(1 - e) = 1 - e² with e = 2^-40
        let e = libm::exp2(-40.0);
        let product = Twofold::from(1.0 + e) * Twofold::from(1.0 - e);
        assert_eq!((product - Twofold::from(1.0)).high, -libm::exp2(-80.0));
        assert_eq!(Twofold::difference(1.0, 1e-30).low, -1e-30);
        assert_eq!((one * Twofold::from(3.0)).ratio(one), 3.0);
    }
}
