//! FLIP: how much of a difference is seen when two images are shown in turn. Knows no file.

use flip_rs::{DEFAULT_PPD, ErrorMap, FlipError, HdrOptions, RgbImage};

use super::transfer::srgb_from_linear;
use crate::error::{Error, Result};
use crate::image::Image;

/// Mean LDR-FLIP (Andersson et al. 2020) of the sRGB images clamped to [0, 1], at its default of 67
/// pixels a degree. NaN is shown as black.
///
/// # Errors
/// Images that differ in size or have no pixels.
pub fn ldr(reference: &Image, test: &Image) -> Result<f64> {
    let failed = |error: FlipError| Error::Differs(format!("FLIP can't compare the images: {error}"));
    let shown = |image: &Image| {
        let values = image.pixels.as_flattened().iter().map(|&v| {
            let linear = if v.is_nan() { 0.0 } else { f64::from(v).clamp(0.0, 1.0) };
            srgb_from_linear(linear) as f32
        });
        RgbImage::new(image.width as usize, image.height as usize, values.collect()).map_err(failed)
    };
    let map = flip_rs::ldr_flip(&shown(reference)?, &shown(test)?, DEFAULT_PPD).map_err(failed)?;
    Ok(mean(&map))
}

/// Mean HDR-FLIP (Andersson et al. 2021): each pixel's largest LDR-FLIP over a range of exposures that
/// the reference asks for, with the ACES tone curve. Of scene-linear images only.
///
/// `None` where it isn't defined: values that aren't finite, a reference that is black, or one whose
/// exposures span more than 128 stops.
pub fn hdr(reference: &Image, test: &Image) -> Option<f64> {
    let linear = |image: &Image| {
        let values = image.pixels.as_flattened().to_vec();
        RgbImage::new(image.width as usize, image.height as usize, values).ok()
    };
    let mut options = HdrOptions::default();
    options.return_exposure_map = false;
    let found = flip_rs::hdr_flip(&linear(reference)?, &linear(test)?, options).ok()?;
    Some(mean(&found.error_map)).filter(|mean| mean.is_finite())
}

/// The crate's own mean is summed in f32, which loses digits in large images.
fn mean(map: &ErrorMap) -> f64 {
    map.pixels().iter().map(|&v| f64::from(v)).sum::<f64>() / map.pixels().len() as f64
}

#[cfg(test)]
mod tests {
    use super::super::transfer::linear_from_srgb;
    use super::*;

    fn picture(value: impl Fn(u32, u32) -> [f32; 3]) -> Image {
        let mut image = Image::new(32, 24);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = value(i as u32 % 32, i as u32 / 32);
        }
        image
    }

    /// The values are those of NVIDIA's own implementation (flip-evaluator 1.7, default settings).
    #[test]
    fn both_agree_with_the_original() {
        let reference: fn(u32, u32) -> [u32; 3] = |x, y| [x * 8, y * 10, x * x + y * 3];
        let test: fn(u32, u32) -> [u32; 3] = |x, y| [x * 8, y * 10 + (x * 7 + y * 5) % 13 * 4, x * x + y * 3];
        let display = |byte: fn(u32, u32) -> [u32; 3]| {
            picture(|x, y| byte(x, y).map(|b| linear_from_srgb(f64::from(b % 256) / 255.0) as f32))
        };
        let found = ldr(&display(reference), &display(test)).unwrap();
        assert!((found - 0.425_260_8).abs() < 1e-5, "{found}");

        let linear = |number: fn(u32, u32) -> [u32; 3]| {
            picture(|x, y| {
                let [r, g, b] = number(x, y);
                [r % 64, g % 256, b % 128].map(|v| v as f32 / 16.0)
            })
        };
        let found = hdr(&linear(reference), &linear(test)).unwrap();
        assert!((found - 0.428_990_2).abs() < 1e-5, "{found}");
    }

    #[test]
    fn exposures_show_what_the_display_cuts_off() {
        // Beyond 1 both are white on a display.
        let bright = |value: f32| picture(|_, _| [value; 3]);
        assert_eq!(ldr(&bright(2.0), &bright(8.0)).unwrap(), 0.0);
        assert!(hdr(&bright(2.0), &bright(8.0)).unwrap() > 0.01);
        assert_eq!(hdr(&bright(2.0), &bright(2.0)), Some(0.0));
        assert_eq!(hdr(&bright(0.0), &bright(1.0)), None);
        assert_eq!(hdr(&bright(1.0), &bright(f32::NAN)), None);
    }
}
