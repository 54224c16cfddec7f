//! Sine and cosine of small angles.

/// Sine and cosine of |x| <= π/4, within an ulp of theirs: Taylor's series, whose first missing terms are below 5e-17. Without a branch, so that the compiler can work on many side by
/// side; the same numbers everywhere, as `libm`'s are.
#[inline(always)]
pub fn sincos_of_eighth(x: f64) -> (f64, f64) {
    /// ∓1 / n! from n = 3 on.
    const SINE: [f64; 7] = [
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 1_307_674_368_000.0,
    ];
    /// ±1 / n! from n = 4 on.
    const COSINE: [f64; 7] = [
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 20_922_789_888_000.0,
    ];
    let z = x * x;
    let (mut sine, mut cosine) = (SINE[6], COSINE[6]);
    for k in (0..6).rev() {
        sine = sine * z + SINE[k];
        cosine = cosine * z + COSINE[k];
    }
    (x + x * z * sine, 1.0 - (0.5 * z - z * z * cosine))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_4;

    #[test]
    fn as_exact_as_libm() {
        for k in -20_000..=20_000 {
            let x = FRAC_PI_4 * f64::from(k) / 20_000.0;
            let (sine, cosine) = sincos_of_eighth(x);
            let (expected_sine, expected_cosine) = libm::sincos(x);
            assert!((sine - expected_sine).abs() <= f64::EPSILON * expected_sine.abs(), "sin {x}");
            assert!((cosine - expected_cosine).abs() <= f64::EPSILON * expected_cosine, "cos {x}");
        }
    }
}
