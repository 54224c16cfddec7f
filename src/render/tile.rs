//! Rectangles of pixels, and how a set of them covers the image.

use crate::settings::Crop;

/// Pixels x0 <= x < x1, y0 <= y < y1 of the whole image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    pub x0: u32,
    pub y0: u32,
    pub x1: u32,
    pub y1: u32,
}

impl Tile {
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }

    pub fn area(&self) -> usize {
        self.width() as usize * (self.y1 - self.y0) as usize
    }

    /// Pixel indices y * width + x, by squares of 8 × 8 from the tile's corner on: rays of neighbours are traced together.
    pub fn pixels(self, image_width: u32) -> impl Iterator<Item = u32> {
        const EDGE: usize = 8;
        let Tile { x0, y0, x1, y1 } = self;
        (y0..y1).step_by(EDGE).flat_map(move |top| {
            (x0..x1).step_by(EDGE).flat_map(move |left| {
                let (right, bottom) = ((left + EDGE as u32).min(x1), (top + EDGE as u32).min(y1));
                (top..bottom).flat_map(move |y| (left..right).map(move |x| y * image_width + x))
            })
        })
    }
}

/// A cover of the rendered part by squares of equal size, cut at the right and lower edge.
#[derive(Clone, Copy, Debug)]
pub struct Tiling {
    crop: Crop,
    size: u32,
}

impl Tiling {
    pub fn new(crop: Crop, size: u32) -> Self {
        Tiling { crop, size }
    }

    /// Edge of a tile in pixels.
    pub fn size(&self) -> u32 {
        self.size
    }

    fn columns(&self) -> u32 {
        self.crop.width().div_ceil(self.size)
    }

    /// Number of tiles.
    pub fn len(&self) -> u32 {
        self.columns() * self.crop.height().div_ceil(self.size)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Tile `index`, row by row.
    pub fn tile(&self, index: u32) -> Tile {
        let x0 = self.crop.x0 + index % self.columns() * self.size;
        let y0 = self.crop.y0 + index / self.columns() * self.size;
        let (x1, y1) = ((x0 + self.size).min(self.crop.x1), (y0 + self.size).min(self.crop.y1));
        Tile { x0, y0, x1, y1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn tiles_partition_the_crop(x0 in 0u32..50, y0 in 0u32..50, w in 1u32..90, h in 1u32..90, size in 1u32..70) {
            let crop = Crop { x0, y0, x1: x0 + w, y1: y0 + h };
            let tiling = Tiling::new(crop, size);
            let mut pixels: Vec<u32> = (0..tiling.len()).flat_map(|i| tiling.tile(i).pixels(200)).collect();
            pixels.sort_unstable();
            let whole = Tile { x0: crop.x0, y0: crop.y0, x1: crop.x1, y1: crop.y1 };
            prop_assert!(pixels.iter().copied().eq((y0..y0 + h).flat_map(|y| (x0..x0 + w).map(move |x| y * 200 + x))));
            let mut of_one: Vec<u32> = whole.pixels(200).collect();
            of_one.sort_unstable();
            prop_assert_eq!(pixels, of_one);
        }
    }
}
