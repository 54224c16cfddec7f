//! How much two images differ, as numbers. Knows no file.

use std::fmt;

use serde::Serialize;

use super::flip;
use super::statistics::{PIXEL_LEVEL, ZTest};
use crate::error::{Error, Result};
use crate::image::Image;

/// Keeps SMAPE finite too.
pub use crate::render::metric::RELATIVE_EPSILON;

/// Differences of a test image from a reference. All but FLIP are taken over the linear values of all
/// three channels; r is the reference's value, t the test's. Equal infinities and two NaN differ by 0, a
/// NaN from anything else by infinity. JSON shows an infinity as null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub width: u32,
    pub height: u32,
    /// √ mean (t − r)².
    pub rmse: f64,
    /// mean (t − r)² / (r² + ε), ε = [`RELATIVE_EPSILON`]: errors count by how bright the reference is
    /// (after Rousselle, Knaus and Zwicker 2011).
    pub rel_mse: f64,
    /// mean |t − r| / (|r| + |t| + ε), from 0 to 1: a bright or dark outlier counts as one pixel at most
    /// (as in Vogels et al. 2018).
    pub smape: f64,
    /// −20 log₁₀ RMSE in decibels: the peak is 1. Infinite for equal images.
    pub psnr: f64,
    /// The largest |t − r| of any channel.
    pub maximum: f64,
    /// Column and row of its first pixel, (0, 0) on top left.
    pub maximum_at: (u32, u32),
    /// [`flip::ldr`].
    pub flip: f64,
    /// [`flip::hdr`] of scene-linear images.
    pub hdr_flip: Option<f64>,
    /// Where an image has variances.
    pub z_test: Option<ZTest>,
}

/// Compares two images of one size, but for [`Comparison::hdr_flip`] and [`Comparison::z_test`].
pub fn compare(reference: &Image, test: &Image) -> Result<Comparison> {
    if (reference.width, reference.height) != (test.width, test.height) {
        return Err(Error::Differs(format!(
            "the images differ in size, {} × {} and {} × {}; compare images of one size",
            reference.width, reference.height, test.width, test.height
        )));
    }
    let count = reference.pixels.len() * 3;
    if count == 0 || test.pixels.len() != reference.pixels.len() {
        return Err(Error::Differs("the images have no pixels; compare images of at least one pixel".into()));
    }

    let (mut squares, mut relative, mut symmetric) = (0.0, 0.0, 0.0);
    let (mut maximum, mut maximum_at) = (0.0, 0);
    let values = reference.pixels.as_flattened().iter().zip(test.pixels.as_flattened());
    for (i, (&r, &t)) in values.enumerate() {
        let (r, t) = (f64::from(r), f64::from(t));
        let difference = distance(r, t);
        squares += difference * difference;
        if difference > 0.0 {
            // An infinite difference stays one, also where r is infinite or NaN.
            let scale = r * r + RELATIVE_EPSILON;
            relative += if difference.is_finite() { difference * difference / scale } else { f64::INFINITY };
            let both = r.abs() + t.abs() + RELATIVE_EPSILON;
            symmetric += if difference.is_finite() { difference / both } else { 1.0 };
        }
        if difference > maximum {
            (maximum, maximum_at) = (difference, i / 3);
        }
    }
    let mse = squares / count as f64;
    Ok(Comparison {
        width: reference.width,
        height: reference.height,
        rmse: mse.sqrt(),
        rel_mse: relative / count as f64,
        smape: symmetric / count as f64,
        psnr: if mse == 0.0 { f64::INFINITY } else { -10.0 * libm::log10(mse) },
        maximum,
        maximum_at: (
            (maximum_at % reference.width as usize) as u32,
            (maximum_at / reference.width as usize) as u32,
        ),
        flip: flip::ldr(reference, test)?,
        hdr_flip: None,
        z_test: None,
    })
}

/// |t − r|, in which what no subtraction can compare is either equal or infinitely far.
pub(super) fn distance(r: f64, t: f64) -> f64 {
    if r == t || (r.is_nan() && t.is_nan()) {
        return 0.0;
    }
    let difference = (t - r).abs();
    if difference.is_nan() { f64::INFINITY } else { difference }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (x, y) = self.maximum_at;
        writeln!(f, "size      {} × {}", self.width, self.height)?;
        writeln!(f, "RMSE      {:.6e}", self.rmse)?;
        writeln!(f, "relMSE    {:.6e}", self.rel_mse)?;
        writeln!(f, "SMAPE     {:.6e}", self.smape)?;
        if self.psnr == f64::INFINITY {
            writeln!(f, "PSNR      inf (equal)")?;
        } else {
            writeln!(f, "PSNR      {:.3} dB", self.psnr)?;
        }
        if self.maximum > 0.0 {
            writeln!(f, "maximum   {:.6e} at pixel ({x}, {y})", self.maximum)?;
        } else {
            writeln!(f, "maximum   0")?;
        }
        write!(f, "FLIP      {:.6}", self.flip)?;
        if let Some(hdr_flip) = self.hdr_flip {
            write!(f, "\nHDR-FLIP  {hdr_flip:.6}")?;
        }
        let Some(test) = &self.z_test else { return Ok(()) };
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            let (difference, error) = (test.difference[c], test.standard_error[c]);
            write!(
                f,
                "\nmean {name}    {difference:+.6e} ± {error:.2e}, z {:+.3}, p {:.3e}",
                test.z[c], test.p[c]
            )?;
        }
        write!(f, "\nmeans     p {:.3e} for all channels", test.global_p)?;
        let pixels = &test.pixels;
        let level = 100.0 * PIXEL_LEVEL;
        write!(f, "\npixels    {} beyond {level} % corrected for {} tests", pixels.rejected, pixels.tests)?;
        if pixels.tests > 0 {
            let at = pixels.smallest_p_at;
            let (x, y) = (at % self.width as usize, at / self.width as usize);
            write!(
                f,
                ", smallest p {:.3e} ({:.3e} corrected) at pixel ({x}, {y})",
                pixels.smallest_p, pixels.corrected_p
            )?;
        }
        if pixels.untested > 0 {
            write!(f, "\nuntested  {} pixels that differ have no variance", pixels.untested)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::statistics::{Known, z_test};
    use super::*;

    fn grey(width: u32, height: u32, value: f32) -> Image {
        Image { width, height, pixels: vec![[value; 3]; (width * height) as usize] }
    }

    #[test]
    fn numbers_are_those_computed_by_hand() {
        let reference = Image { width: 2, height: 2, pixels: vec![[0.5, 0.5, 0.5]; 4] };
        let mut test = reference.clone();
        test.pixels[1][2] = 0.75;
        test.pixels[2][0] = 0.0;
        let found = compare(&reference, &test).unwrap();
        // Squares 0.0625 and 0.25 over 12 values; relMSE divides by 0.25 + 0.01.
        let mse: f64 = 0.3125 / 12.0;
        assert!((found.rmse - mse.sqrt()).abs() < 1e-15);
        assert!((found.rel_mse - mse / 0.26).abs() < 1e-15);
        // |t − r| of 0.25 and 0.5, over sums of 1.25 and 0.5, each and 0.01.
        assert!((found.smape - (0.25 / 1.26 + 0.5 / 0.51) / 12.0).abs() < 1e-15, "{}", found.smape);
        assert!((found.psnr - 15.843_312_2).abs() < 1e-6, "{}", found.psnr);
        assert_eq!((found.maximum, found.maximum_at), (0.5, (0, 1)));
        assert!(found.flip > 0.0 && found.flip < 1.0);
    }

    #[test]
    fn equal_images_differ_by_nothing() {
        let mut image = grey(5, 3, 0.25);
        image.pixels[3] = [f32::NAN, f32::INFINITY, -0.0];
        let found = compare(&image, &image).unwrap();
        assert_eq!((found.rmse, found.rel_mse, found.maximum, found.flip), (0.0, 0.0, 0.0, 0.0));
        assert_eq!(found.smape, 0.0);
        assert_eq!(found.psnr, f64::INFINITY);
        assert!(found.to_string().contains("PSNR      inf"));
    }

    #[test]
    fn nan_is_never_taken_for_equal() {
        let reference = grey(2, 2, 0.25);
        for wrong in [f32::NAN, f32::INFINITY] {
            let mut test = reference.clone();
            test.pixels[3][1] = wrong;
            for found in [compare(&reference, &test).unwrap(), compare(&test, &reference).unwrap()] {
                assert_eq!((found.rmse, found.rel_mse), (f64::INFINITY, f64::INFINITY));
                assert_eq!((found.maximum, found.maximum_at), (f64::INFINITY, (1, 1)));
                assert_eq!(found.psnr, f64::NEG_INFINITY);
                assert!(found.flip.is_finite());
                assert!((found.smape - 1.0 / 12.0).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn other_sizes_are_refused() {
        let error = compare(&grey(2, 3, 0.0), &grey(3, 2, 0.0)).unwrap_err().to_string();
        assert!(error.contains("2 × 3 and 3 × 2"), "{error}");
        assert!(compare(&Image::new(0, 0), &Image::new(0, 0)).is_err());
    }

    #[test]
    fn table_and_json_show_every_number() {
        let mut found = compare(&grey(4, 2, 0.5), &grey(4, 2, 0.25)).unwrap();
        let table = found.to_string();
        for line in
            ["4 × 2", "RMSE      2.500000e-1", "relMSE    2.4", "PSNR      12.041 dB", "(0, 0)", "FLIP"]
        {
            assert!(table.contains(line), "{line}\n{table}");
        }
        assert!(!table.contains("HDR-FLIP") && !table.contains("p "), "{table}");
        let (reference, test) = (grey(4, 2, 0.5), grey(4, 2, 0.25));
        let variance = [[0.01, 0.01, 0.0]; 8];
        let known = Known { variance: &variance, freedom: None };
        found.hdr_flip = Some(0.125);
        found.z_test = Some(z_test(&reference.pixels, &test.pixels, Some(known), None).unwrap());
        let table = found.to_string();
        for line in [
            "SMAPE     3.289474e-1",
            "HDR-FLIP  0.125",
            "mean R    -2.500000e-1 ± 3.54e-2, z -7.071, p 1.5",
            "mean B    -2.500000e-1 ± 0.00e0, z -inf, p 0.000e0",
            "pixels    0 beyond 1 % corrected for 16 tests, smallest p 1.242e-2",
            "untested  8 pixels that differ have no variance",
        ] {
            assert!(table.contains(line), "{line}\n{table}");
        }
        let json = serde_json::to_value(found).unwrap();
        assert_eq!(json["rmse"], 0.25);
        assert_eq!(json["maximum_at"], serde_json::json!([0, 0]));
        assert_eq!((&json["hdr_flip"], &json["z_test"]["pixels"]["tests"]), (&0.125.into(), &16.into()));
        assert!(json["z_test"]["z"][2].is_null());
    }
}
