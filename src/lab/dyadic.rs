//! Exact numbers of the form m 2^e: every f64 is one, and so are their sums, differences and products. Slow, plain, and
//! never rounded. Knows no geometry.

use std::cmp::Ordering;

use num_bigint::{BigInt, Sign};

/// m 2^e with an integer m of any length.
#[derive(Clone, Debug, Default)]
pub struct Dyadic {
    mantissa: BigInt,
    exponent: i32,
}

/// A point or direction of exact numbers.
pub type Exact3 = [Dyadic; 3];

impl Dyadic {
    /// The exact value of a finite f64.
    pub fn new(value: f64) -> Self {
        let bits = value.to_bits();
        let biased = ((bits >> 52) & 0x7ff) as i32;
        debug_assert!(biased < 0x7ff, "{value} is not finite");
        let fraction = bits & ((1 << 52) - 1);
        let (mantissa, exponent) =
            if biased == 0 { (fraction, -1074) } else { (fraction | 1 << 52, biased - 1075) };
        if mantissa == 0 {
            return Dyadic::default();
        }
        let spare = mantissa.trailing_zeros();
        let signed = (mantissa >> spare) as i64;
        Dyadic {
            mantissa: BigInt::from(if value < 0.0 { -signed } else { signed }),
            exponent: exponent + spare as i32,
        }
    }

    pub fn plus(&self, other: &Dyadic) -> Dyadic {
        self.combine(other, |a, b| a + b)
    }

    pub fn minus(&self, other: &Dyadic) -> Dyadic {
        self.combine(other, |a, b| a - b)
    }

    pub fn times(&self, other: &Dyadic) -> Dyadic {
        Dyadic { mantissa: &self.mantissa * &other.mantissa, exponent: self.exponent + other.exponent }
    }

    /// -1, 0 or 1.
    pub fn sign(&self) -> i32 {
        match self.mantissa.sign() {
            Sign::Minus => -1,
            Sign::NoSign => 0,
            Sign::Plus => 1,
        }
    }

    /// Brings both to the lower exponent, then combines the mantissas.
    fn combine(&self, other: &Dyadic, with: impl Fn(&BigInt, &BigInt) -> BigInt) -> Dyadic {
        let (a, b) = (&self.mantissa, &other.mantissa);
        let down = i64::from(self.exponent) - i64::from(other.exponent);
        match down.cmp(&0) {
            Ordering::Equal => Dyadic { mantissa: with(a, b), exponent: self.exponent },
            Ordering::Greater => Dyadic { mantissa: with(&(a << down), b), exponent: other.exponent },
            Ordering::Less => Dyadic { mantissa: with(a, &(b << -down)), exponent: self.exponent },
        }
    }

    /// The nearest f64, off by at most 2^-52 of it; infinite or 0 beyond its range.
    pub fn approximate(&self) -> f64 {
        ratio(self, &Dyadic::new(1.0))
    }
}

/// a / b as f64, off by at most 2^-51 of it. NaN where b is 0.
pub fn ratio(a: &Dyadic, b: &Dyadic) -> f64 {
    if b.sign() == 0 {
        return f64::NAN;
    }
    if a.sign() == 0 {
        return 0.0;
    }
    let (top_a, down_a) = top(a);
    let (top_b, down_b) = top(b);
    let exponent = (down_a - down_b).clamp(-4000, 4000) as i32;
    libm::scalbn(top_a / top_b, exponent)
}

/// The leading 63 bits as f64, and the power of two that they count.
fn top(value: &Dyadic) -> (f64, i64) {
    let bits = value.mantissa.bits() as i64;
    let shift = (bits - 63).max(0);
    let leading = i64::try_from(&value.mantissa >> shift).expect("63 bits fit");
    (leading as f64, shift + i64::from(value.exponent))
}

/// The exact value of three f64.
pub fn exact(v: [f64; 3]) -> Exact3 {
    v.map(Dyadic::new)
}

pub fn minus(a: &Exact3, b: &Exact3) -> Exact3 {
    std::array::from_fn(|k| a[k].minus(&b[k]))
}

pub fn plus(a: &Exact3, b: &Exact3) -> Exact3 {
    std::array::from_fn(|k| a[k].plus(&b[k]))
}

pub fn cross(a: &Exact3, b: &Exact3) -> Exact3 {
    std::array::from_fn(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i].times(&b[j]).minus(&a[j].times(&b[i]))
    })
}

pub fn dot(a: &Exact3, b: &Exact3) -> Dyadic {
    a[0].times(&b[0]).plus(&a[1].times(&b[1])).plus(&a[2].times(&b[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_f64_loses_is_kept() {
        let (big, tiny) = (Dyadic::new(1e300), Dyadic::new(-5e-324));
        let sum = big.plus(&tiny);
        assert_eq!(sum.minus(&big).approximate(), -5e-324);
        assert_eq!(sum.minus(&big).minus(&tiny).sign(), 0);
        let tenth = Dyadic::new(0.1);
        // 0.1 is a little more than a tenth: ten of it are a little more than 1.
        assert_eq!(tenth.times(&Dyadic::new(10.0)).minus(&Dyadic::new(1.0)).sign(), 1);
    }

    #[test]
    fn values_and_ratios_come_back() {
        for value in [0.0, 1.0, -1.5, 0.1, 1e-310, -5e-324, f64::MAX, f64::MIN_POSITIVE] {
            assert_eq!(Dyadic::new(value).approximate(), value);
        }
        assert_eq!(ratio(&Dyadic::new(-3.0), &Dyadic::new(0.5)), -6.0);
        assert_eq!(ratio(&Dyadic::new(5e-324), &Dyadic::new(1e-323)), 0.5);
        assert!(ratio(&Dyadic::new(1.0), &Dyadic::default()).is_nan());
        let third = ratio(&Dyadic::new(1.0), &Dyadic::new(3.0));
        assert!((third - 1.0 / 3.0).abs() <= f64::EPSILON / 4.0);
    }

    #[test]
    fn products_of_vectors() {
        let (a, b) = (exact([1.0, 2.0, 3.0]), exact([-4.0, 0.5, 2.0]));
        assert_eq!(cross(&a, &b).map(|c| c.approximate()), [2.5, -14.0, 8.5]);
        assert_eq!(dot(&a, &b).approximate(), 3.0);
        assert_eq!(dot(&a, &cross(&a, &b)).sign(), 0);
    }
}
