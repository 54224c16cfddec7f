//! How much two images differ, as numbers. Knows no file.

use std::fmt;

use flip_rs::{DEFAULT_PPD, RgbImage, ldr_flip};
use serde::Serialize;

use super::transfer::srgb_from_linear;
use crate::error::{Error, Result};
use crate::image::Image;

/// Keeps relMSE finite in black pixels.
pub const RELATIVE_EPSILON: f64 = 1e-2;

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
    /// −20 log₁₀ RMSE in decibels: the peak is 1. Infinite for equal images.
    pub psnr: f64,
    /// The largest |t − r| of any channel.
    pub maximum: f64,
    /// Column and row of its first pixel, (0, 0) on top left.
    pub maximum_at: (u32, u32),
    /// Mean LDR-FLIP (Andersson et al. 2020) of the sRGB images clamped to [0, 1], at its default of 67
    /// pixels a degree. NaN is shown as black.
    pub flip: f64,
}

/// Compares two images of one size.
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

    let (mut squares, mut relative) = (0.0, 0.0);
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
        psnr: if mse == 0.0 { f64::INFINITY } else { -10.0 * libm::log10(mse) },
        maximum,
        maximum_at: (
            (maximum_at % reference.width as usize) as u32,
            (maximum_at / reference.width as usize) as u32,
        ),
        flip: flip(reference, test)?,
    })
}

/// |t − r|, in which what no subtraction can compare is either equal or infinitely far.
fn distance(r: f64, t: f64) -> f64 {
    if r == t || (r.is_nan() && t.is_nan()) {
        return 0.0;
    }
    let difference = (t - r).abs();
    if difference.is_nan() { f64::INFINITY } else { difference }
}

fn flip(reference: &Image, test: &Image) -> Result<f64> {
    let failed =
        |error: flip_rs::FlipError| Error::Differs(format!("FLIP can't compare the images: {error}"));
    let shown = |image: &Image| {
        let values = image.pixels.as_flattened().iter().map(|&v| {
            let linear = if v.is_nan() { 0.0 } else { f64::from(v).clamp(0.0, 1.0) };
            srgb_from_linear(linear) as f32
        });
        RgbImage::new(image.width as usize, image.height as usize, values.collect()).map_err(failed)
    };
    let map = ldr_flip(&shown(reference)?, &shown(test)?, DEFAULT_PPD).map_err(failed)?;
    // The crate's own mean is summed in f32, which loses digits in large images.
    Ok(map.pixels().iter().map(|&v| f64::from(v)).sum::<f64>() / map.pixels().len() as f64)
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (x, y) = self.maximum_at;
        writeln!(f, "size      {} × {}", self.width, self.height)?;
        writeln!(f, "RMSE      {:.6e}", self.rmse)?;
        writeln!(f, "relMSE    {:.6e}", self.rel_mse)?;
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
        write!(f, "FLIP      {:.6}", self.flip)
    }
}

#[cfg(test)]
mod tests {
    use super::super::transfer::linear_from_srgb;
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
            }
        }
    }

    #[test]
    fn other_sizes_are_refused() {
        let error = compare(&grey(2, 3, 0.0), &grey(3, 2, 0.0)).unwrap_err().to_string();
        assert!(error.contains("2 × 3 and 3 × 2"), "{error}");
        assert!(compare(&Image::new(0, 0), &Image::new(0, 0)).is_err());
    }

    /// The value is that of NVIDIA's own implementation (flip-evaluator 1.7, LDR, default settings).
    #[test]
    fn flip_agrees_with_the_original() {
        let image = |byte: fn(u32, u32) -> [u32; 3]| {
            let mut image = Image::new(32, 24);
            for (i, pixel) in image.pixels.iter_mut().enumerate() {
                let bytes = byte(i as u32 % 32, i as u32 / 32);
                *pixel = bytes.map(|b| linear_from_srgb(f64::from(b % 256) / 255.0) as f32);
            }
            image
        };
        let reference = image(|x, y| [x * 8, y * 10, x * x + y * 3]);
        let test = image(|x, y| [x * 8, y * 10 + (x * 7 + y * 5) % 13 * 4, x * x + y * 3]);
        let found = compare(&reference, &test).unwrap();
        assert!((found.flip - 0.425_260_8).abs() < 1e-5, "{}", found.flip);
    }

    #[test]
    fn table_and_json_show_every_number() {
        let found = compare(&grey(4, 2, 0.5), &grey(4, 2, 0.25)).unwrap();
        let table = found.to_string();
        for line in
            ["4 × 2", "RMSE      2.500000e-1", "relMSE    2.4", "PSNR      12.041 dB", "(0, 0)", "FLIP"]
        {
            assert!(table.contains(line), "{line}\n{table}");
        }
        let json = serde_json::to_value(found).unwrap();
        assert_eq!(json["rmse"], 0.25);
        assert_eq!(json["maximum_at"], serde_json::json!([0, 0]));
    }
}
