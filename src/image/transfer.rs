//! The sRGB curve and the rounding to eight bits. Knows no image and no file.
//!
//! All powers come from `libm`: the system's differ in the last bit between machines, and a byte of
//! the image would with them.

use std::sync::LazyLock;

use crate::settings::Encoding;

/// Display value of a linear value (IEC 61966-2-1); not clamped.
pub fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 }
}

/// Linear value of a display value (IEC 61966-2-1); not clamped.
pub fn linear_from_srgb(display: f64) -> f64 {
    if display <= 0.040_45 { display / 12.92 } else { libm::pow((display + 0.055) / 1.055, 2.4) }
}

/// Eight bits of a linear value: encoded, clamped, rounded to nearest. NaN gives 0.
pub fn quantize(linear: f32, encoding: Encoding) -> u8 {
    let linear = f64::from(linear);
    match encoding {
        // The curve is monotonic, so the byte is the number of rounding borders at or below the
        // value: eight comparisons instead of a power. NaN is above no border.
        Encoding::Srgb => SRGB_BORDERS.partition_point(|&border| border <= linear) as u8,
        // A float-to-integer cast saturates, and sends NaN to 0.
        Encoding::Linear => (linear * 255.0 + 0.5) as u8,
    }
}

/// Linear value from which on a value rounds to byte `i + 1`.
static SRGB_BORDERS: LazyLock<[f64; 255]> =
    LazyLock::new(|| std::array::from_fn(|i| linear_from_srgb((i as f64 + 0.5) / 255.0)));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_meets_known_points() {
        // 0.5 displayed is 0.21404114 linear; 18 % grey displays at 0.46135613.
        assert!((linear_from_srgb(0.5) - 0.214_041_140_482_232_6).abs() < 1e-15);
        assert!((srgb_from_linear(0.18) - 0.461_356_129_500_442).abs() < 1e-12);
        assert_eq!((srgb_from_linear(0.0), linear_from_srgb(0.0)), (0.0, 0.0));
        assert!((srgb_from_linear(1.0) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn borders_agree_with_the_curve() {
        for i in 0..=200_000 {
            let linear = i as f32 / 180_000.0 - 0.05;
            let direct = (srgb_from_linear(f64::from(linear)) * 255.0 + 0.5) as u8;
            assert_eq!(quantize(linear, Encoding::Srgb), direct, "at {linear}");
        }
    }

    #[test]
    fn every_byte_comes_back() {
        for byte in 0..=255u8 {
            let display = f64::from(byte) / 255.0;
            assert_eq!(quantize(linear_from_srgb(display) as f32, Encoding::Srgb), byte);
            assert_eq!(quantize(display as f32, Encoding::Linear), byte);
        }
    }

    #[test]
    fn what_has_no_byte_is_clamped() {
        for encoding in [Encoding::Srgb, Encoding::Linear] {
            assert_eq!(quantize(f32::NAN, encoding), 0);
            assert_eq!(quantize(-1.0, encoding), 0);
            assert_eq!(quantize(f32::NEG_INFINITY, encoding), 0);
            assert_eq!(quantize(7.5, encoding), 255);
            assert_eq!(quantize(f32::INFINITY, encoding), 255);
        }
    }
}
