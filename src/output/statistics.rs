//! Whether two images are estimates of the same truth: tests of their means by the variances that came
//! with them. Pure: knows no file, no layer and no image's size.

use serde::Serialize;

use crate::error::{Error, Result};

/// The chance of one or more pixels beyond [`PixelTests::level`] if the images have the same mean everywhere.
pub const PIXEL_LEVEL: f64 = 0.01;

/// Tests of the hypothesis that two images have the same expectation.
///
/// They hold if the pixels are independent of each other and the images of each other (other seeds!), and if
/// the variances are known well. The global test is robust to badly known ones, as they are summed; the single
/// pixels' are not: where each variance comes from a few batches only, more pixels are rejected than should be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ZTest {
    /// The mean of test − reference over all pixels, for R, G and B.
    pub difference: [f64; 3],
    /// The standard error of that.
    pub standard_error: [f64; 3],
    /// Their quotient: normally distributed with variance 1 under the hypothesis. 0 where both are 0,
    /// infinite where only the standard error is, and where an image has NaN.
    pub z: [f64; 3],
    /// The chance of a |z| as large or larger.
    pub p: [f64; 3],
    /// The smallest of those, corrected for there being three ([`sidak_p`]).
    pub global_p: f64,
    pub pixels: PixelTests,
}

/// The same test for each channel of each pixel alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PixelTests {
    /// Channels of pixels with a variance above 0, all of which are tested.
    pub tests: u64,
    /// The level of each test that makes all together one of [`PIXEL_LEVEL`]: 1 − (1 − [`PIXEL_LEVEL`])^(1/tests).
    pub level: f64,
    /// Pixels with a p below that in any channel.
    pub rejected: u64,
    /// Smallest p of any test, not corrected; 1 if there are none.
    pub smallest_p: f64,
    /// Its pixel, counted from 0 row after row.
    pub smallest_p_at: usize,
    /// The same, corrected for the number of tests.
    pub corrected_p: f64,
    /// Pixels that differ in a channel that has no variance in either image: not tested, as no samples
    /// say how far it may be off, and not rejected.
    pub untested: u64,
}

/// Tests whether two images have the same expectation. The variances are those of the pixels' means;
/// an image without is taken as exact.
///
/// # Errors
/// Slices of other lengths than the reference's, or none at all; a variance that is negative or not finite.
pub fn z_test(
    reference: &[[f32; 3]],
    test: &[[f32; 3]],
    reference_variance: Option<&[[f32; 3]]>,
    test_variance: Option<&[[f32; 3]]>,
) -> Result<ZTest> {
    let count = reference.len();
    let lengths = [Some(test), reference_variance, test_variance];
    if count == 0 || lengths.into_iter().flatten().any(|pixels| pixels.len() != count) {
        let what = "images and variances must have the same number of pixels, and at least one";
        return Err(Error::Differs(what.into()));
    }
    let variance_of = |i: usize, c: usize| -> Result<f64> {
        let mut sum = 0.0;
        for variance in [reference_variance, test_variance].into_iter().flatten() {
            let value = f64::from(variance[i][c]);
            if !(value >= 0.0 && value.is_finite()) {
                let what =
                    format!("pixel {i} has the variance {value}; a variance is a finite number of 0 or more");
                return Err(Error::Differs(what));
            }
            sum += value;
        }
        Ok(sum)
    };

    // The sums of all pixels, and what every single one says.
    let (mut differences, mut variances) = ([0.0; 3], [0.0; 3]);
    let (mut tests, mut untested) = (0, 0);
    let (mut smallest_p, mut smallest_p_at) = (1.0, 0);
    let mut pixel_p = Vec::with_capacity(count);
    for (i, (r, t)) in reference.iter().zip(test).enumerate() {
        let (mut p, mut differs_untested) = (1.0_f64, false);
        for c in 0..3 {
            let (difference, variance) = (difference(r[c], t[c]), variance_of(i, c)?);
            differences[c] += difference;
            variances[c] += variance;
            if variance > 0.0 {
                tests += 1;
                p = p.min(two_sided_p(score(difference, variance)));
            } else {
                differs_untested |= difference != 0.0;
            }
        }
        untested += u64::from(differs_untested);
        if p < smallest_p {
            (smallest_p, smallest_p_at) = (p, i);
        }
        pixel_p.push(p);
    }
    // How many are beyond the level is known only when the number of tests is.
    let level = sidak_level(PIXEL_LEVEL, tests);
    let rejected = pixel_p.iter().filter(|&&p| p < level).count() as u64;

    let n = count as f64;
    let z: [f64; 3] = std::array::from_fn(|c| score(differences[c], variances[c]));
    let p = z.map(two_sided_p);
    Ok(ZTest {
        difference: differences.map(|sum| sum / n),
        standard_error: variances.map(|sum: f64| sum.sqrt() / n),
        z,
        p,
        global_p: sidak_p(p[0].min(p[1]).min(p[2]), 3),
        pixels: PixelTests {
            tests,
            level,
            rejected,
            smallest_p,
            smallest_p_at,
            corrected_p: sidak_p(smallest_p, tests),
            untested,
        },
    })
}

/// t − r, which is 0 for equal infinities and two NaN.
fn difference(r: f32, t: f32) -> f64 {
    if r == t || (r.is_nan() && t.is_nan()) { 0.0 } else { f64::from(t) - f64::from(r) }
}

fn score(difference: f64, variance: f64) -> f64 {
    match difference {
        0.0 => 0.0,
        _ if difference.is_finite() => difference / variance.sqrt(),
        _ if difference < 0.0 => f64::NEG_INFINITY,
        _ => f64::INFINITY,
    }
}

/// The chance that a normally distributed number of mean 0 and variance 1 is as far from 0 as `z` or farther.
pub fn two_sided_p(z: f64) -> f64 {
    libm::erfc(z.abs() * std::f64::consts::FRAC_1_SQRT_2)
}

/// The level for each of `tests` tests that makes the chance of one or more rejections `level`, if they are
/// independent; of normally distributed numbers it is never more, however they depend (Šidák 1967).
pub fn sidak_level(level: f64, tests: u64) -> f64 {
    -libm::expm1(libm::log1p(-level) / tests.max(1) as f64)
}

/// The chance that the smallest p of `tests` independent tests is `p` or less: what [`sidak_level`] inverts.
pub fn sidak_p(p: f64, tests: u64) -> f64 {
    if p >= 1.0 { 1.0 } else { -libm::expm1(tests as f64 * libm::log1p(-p)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two-sided tails as R and SciPy give them.
    #[test]
    fn tails_are_the_normal_distributions() {
        for (z, p) in [
            (0.0, 1.0),
            (1.0, 0.317_310_507_862_914_15),
            (-1.959_963_984_540_054, 0.05),
            (5.0, 5.733_031_437_583_866e-7),
            (30.0, 9.813_427_854_295_816e-198),
        ] {
            let found = two_sided_p(z);
            assert!((found - p).abs() <= 1e-12 * p, "{z}: {found}");
        }
        assert_eq!(two_sided_p(f64::INFINITY), 0.0);
    }

    #[test]
    fn corrections_are_those_computed_by_hand() {
        assert!((sidak_level(0.19, 2) - 0.1).abs() < 1e-15);
        assert!((sidak_p(0.1, 2) - 0.19).abs() < 1e-15);
        // Not lost to rounding: 1e-17 is no step of 1.
        assert!((sidak_p(1e-17, 1000) - 1e-14).abs() < 1e-20);
        assert_eq!((sidak_p(1.0, 0), sidak_p(0.0, 5)), (1.0, 0.0));
    }

    #[test]
    fn two_pixels_by_hand() {
        let reference = [[0.5, 1.0, 0.0], [0.5, 2.0, 0.0]];
        let test = [[0.75, 1.0, 0.0], [1.0, 1.0, 0.0]];
        let (of_reference, of_test) = ([[0.25, 0.0, 0.0]; 2], [[0.0, 0.0, 0.5], [0.75, 0.0, 0.5]]);
        let found = z_test(&reference, &test, Some(&of_reference), Some(&of_test)).unwrap();
        // R: the sum of differences is 0.75, of variances 0.25 + 0.25 + 0.75 = 1.25.
        assert_eq!(found.difference, [0.375, -0.5, 0.0]);
        assert_eq!(found.standard_error, [1.25_f64.sqrt() / 2.0, 0.0, 0.5]);
        assert!((found.z[0] - 0.75 / 1.25_f64.sqrt()).abs() < 1e-15);
        assert_eq!((found.z[1], found.z[2]), (f64::NEG_INFINITY, 0.0));
        assert!((found.p[0] - 0.502_334_954).abs() < 1e-8, "{}", found.p[0]);
        assert_eq!((found.p[1], found.p[2], found.global_p), (0.0, 1.0, 0.0));
        // Two tests in R (z = 0.5 both), two in B; the second pixel differs in G without any variance.
        let pixels = found.pixels;
        assert_eq!((pixels.tests, pixels.rejected, pixels.untested), (4, 0, 1));
        assert!((pixels.smallest_p - 0.617_075_077).abs() < 1e-8, "{}", pixels.smallest_p);
        assert_eq!(pixels.smallest_p_at, 0);
        assert!((pixels.level - 0.002_509_430_066).abs() < 1e-11, "{}", pixels.level);
    }

    /// Noise of a known variance, drawn as the sum of twelve uniform numbers.
    fn noisy(mean: f64, deviation: f64, count: usize, seed: u64) -> Vec<[f32; 3]> {
        let mut state = seed;
        let mut uniform = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1_u64 << 24) as f64
        };
        let mut normal = move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        (0..count).map(|_| std::array::from_fn(|_| (mean + deviation * normal()) as f32)).collect()
    }

    #[test]
    fn sound_images_pass_and_a_small_bias_fails_only_globally() {
        const COUNT: usize = 40_000;
        let variance = [[0.01; 3]; COUNT];
        let reference = noisy(0.3, 0.1, COUNT, 1);
        let test = |bias: f64| {
            let image = noisy(0.3 * (1.0 + bias), 0.1, COUNT, 2);
            z_test(&reference, &image, Some(&variance), Some(&variance)).unwrap()
        };
        let sound = test(0.0);
        assert!(sound.global_p > 0.01 && sound.pixels.rejected == 0, "{sound:?}");
        // 1.2 % of 0.3 is 5 standard errors of √(2 · 0.01 / 40000).
        let biased = test(0.012);
        assert!(biased.global_p < 1e-4 && biased.pixels.rejected == 0, "{biased:?}");
        // Taken as exact, the reference's noise must look like a difference of single pixels.
        let exact = z_test(&reference, &noisy(0.3, 0.01, COUNT, 3), None, Some(&[[1e-4; 3]; COUNT])).unwrap();
        assert!(exact.pixels.rejected > 1000 && exact.pixels.corrected_p < 1e-12, "{exact:?}");
    }

    #[test]
    fn one_wrong_pixel_fails_only_by_itself() {
        const COUNT: usize = 40_000;
        let variance = [[0.01; 3]; COUNT];
        let reference = noisy(0.3, 0.1, COUNT, 1);
        let mut image = noisy(0.3, 0.1, COUNT, 2);
        image[777][1] = 1.8;
        let found = z_test(&reference, &image, Some(&variance), Some(&variance)).unwrap();
        assert_eq!((found.pixels.rejected, found.pixels.smallest_p_at), (1, 777));
        assert!(found.global_p > 0.01 && found.pixels.corrected_p < 1e-6, "{found:?}");
        image[777][1] = f32::NAN;
        let found = z_test(&reference, &image, Some(&variance), None).unwrap();
        assert_eq!((found.global_p, found.pixels.smallest_p), (0.0, 0.0));
    }

    #[test]
    fn what_is_no_variance_is_refused() {
        let pixel = [[1.0_f32; 3]];
        for wrong in [-1e-9, f32::NAN, f32::INFINITY] {
            let message = z_test(&pixel, &pixel, None, Some(&[[0.0, wrong, 0.0]])).unwrap_err().to_string();
            assert!(message.contains("pixel 0 has the variance"), "{message}");
        }
        assert!(z_test(&pixel, &[[1.0; 3]; 2], None, None).is_err());
        assert!(z_test(&pixel, &pixel, Some(&[]), None).is_err());
        assert!(z_test(&[], &[], None, None).is_err());
    }
}
