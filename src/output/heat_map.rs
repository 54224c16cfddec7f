//! Where two images differ, as a picture that can be read without colour. Knows no file.

use flip_rs::MAGMA;

use super::compare::distance;
use super::transfer::linear_from_srgb;
use crate::image::Image;

/// The difference that is shown darkest is 10 to this power, or less; the one shown brightest is 1, or more.
const DARKEST: f64 = -4.0;

/// What the colours mean.
pub const SCALE: &str = "root mean square of each pixel's differences over its channels, linear values; \
    colours of magma, lightness rises with the logarithm: 1e-4 or less black, 1e-3 dark violet, 1e-2 red violet, \
    0.1 orange, 1 or more light yellow";

/// A picture of the differences, to be written as sRGB. The scale is always the same ([`SCALE`]), so that
/// two maps can be compared. What no subtraction can compare is shown as the largest difference.
pub fn heat_map(reference: &Image, test: &Image) -> Image {
    let pixels = reference.pixels.iter().zip(&test.pixels).map(|(r, t)| {
        let squares: f64 = (0..3).map(|c| distance(f64::from(r[c]), f64::from(t[c]))).map(|d| d * d).sum();
        color((squares / 3.0).sqrt())
    });
    Image { width: reference.width, height: reference.height, pixels: pixels.collect() }
}

fn color(difference: f64) -> [f32; 3] {
    let height = (libm::log10(difference) / -DARKEST + 1.0).clamp(0.0, 1.0);
    let entry = MAGMA[(height * (MAGMA.len() - 1) as f64).round() as usize];
    entry.map(|display| linear_from_srgb(f64::from(display)) as f32)
}

#[cfg(test)]
mod tests {
    use super::super::transfer::quantize;
    use super::*;
    use crate::settings::Encoding;

    #[test]
    fn colours_are_those_of_the_scale() {
        let mut test = Image::new(6, 1);
        let values = [0.0, 1e-5, 1e-2, 1.0, 50.0, f32::NAN];
        for (pixel, value) in test.pixels.iter_mut().zip(values) {
            *pixel = [value; 3];
        }
        let map = heat_map(&Image::new(6, 1), &test);
        let bytes: Vec<[u8; 3]> = map.pixels.iter().map(|p| p.map(|v| quantize(v, Encoding::Srgb))).collect();
        // Magma's ends, and the entry below its middle: the float 0.01 is less than 0.01.
        let (black, middle, yellow) = ([0, 0, 4], [181, 54, 122], [252, 253, 191]);
        assert_eq!(bytes, [black, black, middle, yellow, yellow, yellow]);
        // One channel of three: a difference of √(1e-4 / 3) lies below 1e-2.
        test.pixels[0] = [0.0, 0.01, 0.0];
        let single = heat_map(&Image::new(6, 1), &test).pixels[0];
        assert!(single != map.pixels[2] && single != map.pixels[0]);
    }

    #[test]
    fn lightness_rises_with_the_difference() {
        let luminance = |[r, g, b]: [f32; 3]| 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let shades: Vec<f32> =
            (0..=80).map(|i| luminance(color(libm::pow(10.0, f64::from(i) / 20.0 - 4.0)))).collect();
        assert!(shades.windows(2).all(|pair| pair[0] < pair[1]), "{shades:?}");
    }
}
