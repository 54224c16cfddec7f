//! Exact numbers of the form m 2^e: every f64 is one, and so are their sums, differences and products. Plain and never
//! rounded. Knows no geometry.

use std::borrow::Cow;
use std::cmp::Ordering;

use ethnum::I256;
use num_bigint::{BigInt, Sign};

/// m 2^e with an integer m of any length.
#[derive(Clone, Debug, Default)]
pub struct Dyadic {
    mantissa: Mantissa,
    exponent: i32,
}

/// An integer of any length, without an allocation as long as it is short. Equal numbers may be held either way.
#[derive(Clone, Debug)]
enum Mantissa {
    Short(I256),
    Long(BigInt),
}

impl Default for Mantissa {
    fn default() -> Self {
        Mantissa::Short(I256::ZERO)
    }
}

impl Mantissa {
    fn long(&self) -> Cow<'_, BigInt> {
        match self {
            Mantissa::Short(short) => Cow::Owned(BigInt::from_signed_bytes_le(&short.to_le_bytes())),
            Mantissa::Long(long) => Cow::Borrowed(long),
        }
    }

    /// The result of the short form if both are short and it has one, else of the long form.
    fn combine(
        &self,
        other: &Mantissa,
        short: impl Fn(I256, I256) -> Option<I256>,
        long: impl Fn(&BigInt, &BigInt) -> BigInt,
    ) -> Mantissa {
        if let (Mantissa::Short(a), Mantissa::Short(b)) = (self, other)
            && let Some(result) = short(*a, *b)
        {
            return Mantissa::Short(result);
        }
        Mantissa::Long(long(&self.long(), &other.long()))
    }

    fn plus(&self, other: &Mantissa) -> Mantissa {
        self.combine(other, I256::checked_add, |a, b| a + b)
    }

    fn minus(&self, other: &Mantissa) -> Mantissa {
        self.combine(other, I256::checked_sub, |a, b| a - b)
    }

    fn times(&self, other: &Mantissa) -> Mantissa {
        self.combine(other, short_product, |a, b| a * b)
    }

    /// This times 2^up.
    fn shifted(&self, up: u32) -> Mantissa {
        match self {
            Mantissa::Short(I256::ZERO) => Mantissa::Short(I256::ZERO),
            Mantissa::Short(short) if short_bits(*short) + up < I256::BITS => Mantissa::Short(short << up),
            _ => Mantissa::Long(&*self.long() << up),
        }
    }
}

/// Digits of the magnitude.
fn short_bits(short: I256) -> u32 {
    I256::BITS - short.unsigned_abs().leading_zeros()
}

/// Unless it may not fit.
fn short_product(a: I256, b: I256) -> Option<I256> {
    (short_bits(a) + short_bits(b) < I256::BITS).then(|| a.wrapping_mul(b))
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
            mantissa: Mantissa::Short(I256::from(if value < 0.0 { -signed } else { signed })),
            exponent: exponent + spare as i32,
        }
    }

    pub fn plus(&self, other: &Dyadic) -> Dyadic {
        self.combine(other, Mantissa::plus)
    }

    pub fn minus(&self, other: &Dyadic) -> Dyadic {
        self.combine(other, Mantissa::minus)
    }

    pub fn times(&self, other: &Dyadic) -> Dyadic {
        let mantissa = self.mantissa.times(&other.mantissa);
        Dyadic { mantissa, exponent: self.exponent + other.exponent }
    }

    /// -1, 0 or 1.
    pub fn sign(&self) -> i32 {
        match &self.mantissa {
            Mantissa::Short(short) => short.signum128() as i32,
            Mantissa::Long(long) => match long.sign() {
                Sign::Minus => -1,
                Sign::NoSign => 0,
                Sign::Plus => 1,
            },
        }
    }

    /// Brings both to the lower exponent, then combines the mantissas.
    fn combine(&self, other: &Dyadic, with: impl Fn(&Mantissa, &Mantissa) -> Mantissa) -> Dyadic {
        let (a, b) = (&self.mantissa, &other.mantissa);
        let apart = self.exponent.abs_diff(other.exponent);
        let mantissa = match self.exponent.cmp(&other.exponent) {
            Ordering::Equal => with(a, b),
            Ordering::Greater => with(&a.shifted(apart), b),
            Ordering::Less => with(a, &b.shifted(apart)),
        };
        Dyadic { mantissa, exponent: self.exponent.min(other.exponent) }
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
    let (leading, shift) = match &value.mantissa {
        Mantissa::Short(short) => {
            let shift = short_bits(*short).saturating_sub(63);
            ((short >> shift).as_i64(), i64::from(shift))
        }
        Mantissa::Long(long) => {
            let shift = (long.bits() as i64 - 63).max(0);
            (i64::try_from(long >> shift).expect("63 bits fit"), shift)
        }
    };
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
    fn short_and_long_integers_say_the_same() {
        // Mantissas around every length at which the short form runs out, in either form.
        let powers = [1u32, 50, 62, 63, 64, 65, 126, 127, 128, 190, 192, 250, 253, 254];
        let near = |power: u32| [-1i8, 0, 1].map(|off| (I256::ONE << power) + I256::from(off));
        let edges = [I256::ZERO, I256::MAX];
        let mut shorts: Vec<I256> = powers.into_iter().flat_map(near).chain(edges).collect();
        shorts.extend(shorts.clone().into_iter().map(|short| -short));
        shorts.push(I256::MIN);
        let number = |mantissa, exponent| Dyadic { mantissa, exponent };
        let same = |short: &Dyadic, long: &Dyadic| {
            assert!(matches!(long.mantissa, Mantissa::Long(_)));
            assert_eq!(short.mantissa.long(), long.mantissa.long(), "{short:?} {long:?}");
            assert_eq!((short.exponent, short.sign()), (long.exponent, long.sign()));
            assert_eq!(short.approximate().to_bits(), long.approximate().to_bits(), "{short:?}");
        };
        for &a in &shorts {
            for &b in &shorts {
                for exponents in [[0, 0], [0, 1], [3, -60], [-70, 58], [-1074, 971]] {
                    let short = [a, b].map(Mantissa::Short);
                    let long = short.clone().map(|m| Mantissa::Long(m.long().into_owned()));
                    let [a, b] = std::array::from_fn(|k| number(short[k].clone(), exponents[k]));
                    let [c, d] = std::array::from_fn(|k| number(long[k].clone(), exponents[k]));
                    same(&a.plus(&b), &c.plus(&d));
                    same(&a.minus(&b), &c.minus(&d));
                    same(&a.times(&b), &c.times(&d));
                    assert_eq!(ratio(&a, &b).to_bits(), ratio(&c, &d).to_bits());
                }
            }
        }
    }

    #[test]
    fn products_of_vectors() {
        let (a, b) = (exact([1.0, 2.0, 3.0]), exact([-4.0, 0.5, 2.0]));
        assert_eq!(cross(&a, &b).map(|c| c.approximate()), [2.5, -14.0, 8.5]);
        assert_eq!(dot(&a, &b).approximate(), 3.0);
        assert_eq!(dot(&a, &cross(&a, &b)).sign(), 0);
    }
}
