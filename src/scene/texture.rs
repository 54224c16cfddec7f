//! Image textures: 8-bit sRGB texels, decoded to linear when they are looked up.

use std::sync::OnceLock;

use crate::memory::Store;

/// An image that repeats over the plane of texture coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Texture {
    pub width: u32,
    pub height: u32,
    /// sRGB-encoded RGB, row 0 on top: `texels[y * width + x]`.
    pub texels: Store<[u8; 3]>,
}

impl Texture {
    /// Linear RGB at (u, v), bilinear between texel centres, repeating; v grows upwards. Not finite: texel (0, 0).
    pub fn sample(&self, u: f64, v: f64) -> [f64; 3] {
        let wrap = |x: f64| if x.is_finite() { x - x.floor() } else { 0.0 };
        let x = wrap(u) * f64::from(self.width) - 0.5;
        let y = (1.0 - wrap(v)) * f64::from(self.height) - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let column = |c: f64| (c as i64).rem_euclid(i64::from(self.width)) as usize;
        let row = |r: f64| (r as i64).rem_euclid(i64::from(self.height)) as usize;
        let (columns, rows) = ([column(x0), column(x0 + 1.0)], [row(y0), row(y0 + 1.0)]);
        let decode = srgb_decode();
        let texel = |i: usize, j: usize| {
            self.texels[rows[j] * self.width as usize + columns[i]].map(|code| decode[usize::from(code)])
        };
        let (a, b, c, d) = (texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy
        })
    }
}

/// Linear value of each 8-bit sRGB code (IEC 61966-2-1).
fn srgb_decode() -> &'static [f64; 256] {
    static TABLE: OnceLock<[f64; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|code| {
            let c = code as f64 / 255.0;
            if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_and_repeating() {
        let texture = Texture { width: 2, height: 1, texels: vec![[0, 0, 0], [255, 255, 255]].into() };
        assert_eq!(texture.sample(0.25, 0.5), [0.0; 3]);
        assert_eq!(texture.sample(0.75, 0.5), [1.0; 3]);
        assert_eq!(texture.sample(0.5, 0.5), [0.5; 3]);
        assert_eq!(texture.sample(-7.5, 3.5), [0.5; 3]);
        assert_eq!(texture.sample(1.75, 12.25), [1.0; 3]);
    }

    #[test]
    fn v_grows_upwards() {
        let texture = Texture { width: 1, height: 2, texels: vec![[255; 3], [0; 3]].into() };
        assert_eq!(texture.sample(0.5, 0.75), [1.0; 3]);
        assert_eq!(texture.sample(0.5, 0.25), [0.0; 3]);
    }
}
