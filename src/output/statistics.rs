//! Whether two images are estimates of the same truth: tests of their means by the variances that came
//! with them. Pure: knows no file, no layer and no image's size.

use serde::Serialize;

use super::student::{joint_freedom, two_sided_p};
use crate::error::{Error, Result};

/// The chance of one or more pixels beyond [`PixelTests::level`] if the images have the same mean everywhere.
pub const PIXEL_LEVEL: f64 = 0.01;

/// Tests of the hypothesis that two images have the same expectation.
///
/// They hold if the pixels are independent of each other and the images of each other (other seeds!), and if
/// the variances are known well. The global test is robust to badly known ones, as they are summed; of single pixels
/// it is told how badly they are known, and Student's distribution allows for it.
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

/// What is known of how far an image's pixels may be off.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// Of the pixels' means.
    pub variance: &'a [[f32; 3]],
    /// The degrees of freedom of each pixel's variance; `None`: they are taken as exact.
    pub freedom: Option<&'a [f32]>,
}

/// Tests whether two images have the same expectation; one of which nothing is known is taken as exact. A pixel's difference over its standard error follows Student's
/// distribution, of as many degrees of freedom as Welch gives both variances together.
///
/// # Errors
/// Slices of other lengths than the reference's, or none at all; a variance that is negative or not finite, or has no degree of freedom.
pub fn z_test(
    reference: &[[f32; 3]],
    test: &[[f32; 3]],
    reference_known: Option<Known>,
    test_known: Option<Known>,
) -> Result<ZTest> {
    let count = reference.len();
    let known = || [reference_known, test_known].into_iter().flatten();
    let fits = |known: Known| {
        known.variance.len() == count && known.freedom.is_none_or(|freedom| freedom.len() == count)
    };
    if count == 0 || test.len() != count || !known().all(fits) {
        let what = "images and variances must have the same number of pixels, and at least one";
        return Err(Error::Differs(what.into()));
    }
    // Of each image, with its degrees of freedom.
    let variances_of = |i: usize, c: usize| -> Result<[(f64, f64); 2]> {
        let mut found = [(0.0, f64::INFINITY); 2];
        for (found, known) in found.iter_mut().zip(known()) {
            let variance = f64::from(known.variance[i][c]);
            if !(variance >= 0.0 && variance.is_finite()) {
                let what = format!(
                    "pixel {i} has the variance {variance}; a variance is a finite number of 0 or more"
                );
                return Err(Error::Differs(what));
            }
            let freedom = known.freedom.map_or(f64::INFINITY, |freedom| f64::from(freedom[i]));
            if variance > 0.0 && (freedom.is_nan() || freedom <= 0.0) {
                let what = format!(
                    "pixel {i} has a variance of {freedom} degrees of freedom, which must be more than 0; render the image anew with --aov variance, or leave its layer `freedom` out"
                );
                return Err(Error::Differs(what));
            }
            *found = (variance, freedom);
        }
        Ok(found)
    };

    // The sums of all pixels, and what every single one says.
    let (mut differences, mut variances) = ([0.0; 3], [0.0; 3]);
    let (mut tests, mut untested) = (0, 0);
    let (mut smallest_p, mut smallest_p_at) = (1.0, 0);
    let mut pixel_p = Vec::with_capacity(count);
    for (i, (r, t)) in reference.iter().zip(test).enumerate() {
        let (mut p, mut differs_untested) = (1.0_f64, false);
        for c in 0..3 {
            let (difference, both) = (difference(r[c], t[c]), variances_of(i, c)?);
            let variance = both[0].0 + both[1].0;
            differences[c] += difference;
            variances[c] += variance;
            if variance > 0.0 {
                tests += 1;
                p = p.min(two_sided_p(score(difference, variance), joint_freedom(both)));
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
    // Of sums over so many pixels the variances are known.
    let p = z.map(|z| two_sided_p(z, f64::INFINITY));
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
            let found = two_sided_p(z, f64::INFINITY);
            assert!((found - p).abs() <= 1e-12 * p, "{z}: {found}");
        }
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
        let found = z_test(&reference, &test, sure(&of_reference), sure(&of_test)).unwrap();
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

    /// Variances that are exact.
    fn sure(variance: &[[f32; 3]]) -> Option<Known<'_>> {
        Some(Known { variance, freedom: None })
    }

    /// A pixel's variance of four batches is a guess: by the normal distribution sound images are full of wrong pixels, by Student's they are not.
    #[test]
    fn pixels_of_few_batches_are_judged_by_student() {
        const COUNT: usize = 40_000;
        const BATCHES: usize = 4;
        let estimated = |samples: &[[f32; 3]]| -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
            let pixel = |batches: &[[f32; 3]]| {
                let of = |c: usize| batches.iter().map(move |batch| f64::from(batch[c]));
                let mean = |c: usize| of(c).sum::<f64>() / BATCHES as f64;
                let squares = |c: usize| of(c).map(|x| (x - mean(c)) * (x - mean(c))).sum::<f64>();
                let variance = |c: usize| squares(c) / (BATCHES * (BATCHES - 1)) as f64;
                (std::array::from_fn(|c| mean(c) as f32), std::array::from_fn(|c| variance(c) as f32))
            };
            samples.chunks_exact(BATCHES).map(pixel).unzip()
        };
        // One stream, as those of seeds in a row are alike.
        let noise = noisy(0.3, 0.1, 2 * BATCHES * COUNT, 1);
        let (first, second) = noise.split_at(BATCHES * COUNT);
        let (reference, reference_variance) = estimated(first);
        let (mut test, test_variance) = estimated(second);
        let found = |test: &[[f32; 3]], freedom: Option<&[f32]>| {
            let known = |variance| Some(Known { variance, freedom });
            z_test(&reference, test, known(&reference_variance), known(&test_variance)).unwrap()
        };
        let freedom = vec![(BATCHES - 1) as f32; COUNT];
        let (normal, student) = (found(&test, None), found(&test, Some(&freedom)));
        assert!(normal.pixels.rejected > 100, "{normal:?}");
        assert!(student.pixels.rejected == 0 && student.pixels.corrected_p > PIXEL_LEVEL, "{student:?}");
        assert_eq!((normal.z, normal.p), (student.z, student.p));
        // And yet a pixel that is far off is found.
        test[777][1] += 100.0;
        let wrong = found(&test, Some(&freedom));
        assert_eq!((wrong.pixels.rejected, wrong.pixels.smallest_p_at), (1, 777), "{wrong:?}");
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
            z_test(&reference, &image, sure(&variance), sure(&variance)).unwrap()
        };
        let sound = test(0.0);
        assert!(sound.global_p > 0.01 && sound.pixels.rejected == 0, "{sound:?}");
        // 1.2 % of 0.3 is 5 standard errors of √(2 · 0.01 / 40000).
        let biased = test(0.012);
        assert!(biased.global_p < 1e-4 && biased.pixels.rejected == 0, "{biased:?}");
        // Taken as exact, the reference's noise must look like a difference of single pixels.
        let exact = z_test(&reference, &noisy(0.3, 0.01, COUNT, 3), None, sure(&[[1e-4; 3]; COUNT])).unwrap();
        assert!(exact.pixels.rejected > 1000 && exact.pixels.corrected_p < 1e-12, "{exact:?}");
    }

    #[test]
    fn one_wrong_pixel_fails_only_by_itself() {
        const COUNT: usize = 40_000;
        let variance = [[0.01; 3]; COUNT];
        let reference = noisy(0.3, 0.1, COUNT, 1);
        let mut image = noisy(0.3, 0.1, COUNT, 2);
        image[777][1] = 1.8;
        let found = z_test(&reference, &image, sure(&variance), sure(&variance)).unwrap();
        assert_eq!((found.pixels.rejected, found.pixels.smallest_p_at), (1, 777));
        assert!(found.global_p > 0.01 && found.pixels.corrected_p < 1e-6, "{found:?}");
        image[777][1] = f32::NAN;
        let found = z_test(&reference, &image, sure(&variance), None).unwrap();
        assert_eq!((found.global_p, found.pixels.smallest_p), (0.0, 0.0));
    }

    #[test]
    fn what_is_no_variance_is_refused() {
        let pixel = [[1.0_f32; 3]];
        for wrong in [-1e-9, f32::NAN, f32::INFINITY] {
            let message = z_test(&pixel, &pixel, None, sure(&[[0.0, wrong, 0.0]])).unwrap_err().to_string();
            assert!(message.contains("pixel 0 has the variance"), "{message}");
        }
        for wrong in [0.0, -1.0, f32::NAN] {
            let freedom = Some(&[wrong][..]);
            let test = |variance| z_test(&pixel, &pixel, Some(Known { variance, freedom }), None);
            let message = test(&[[0.0, 1.0, 0.0]]).unwrap_err().to_string();
            assert!(message.contains("pixel 0 has a variance of"), "{message}");
            // What nothing says can't be wrong.
            assert_eq!(test(&[[0.0; 3]]).unwrap().pixels.tests, 0);
        }
        let short = Known { variance: &pixel, freedom: Some(&[]) };
        assert!(z_test(&pixel, &pixel, None, Some(short)).is_err());
        assert!(z_test(&pixel, &[[1.0; 3]; 2], None, None).is_err());
        assert!(z_test(&pixel, &pixel, sure(&[]), None).is_err());
        assert!(z_test(&[], &[], None, None).is_err());
    }
}
