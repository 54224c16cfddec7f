//! What each tile will cost, guessed from a coarse look: time of one sample in each block of pixels.

use std::time::Instant;

use rayon::prelude::*;

use super::film::TileFilm;
use super::rounds::Round;
use super::tile::{Tile, Tiling};
use super::{RayCounts, Renderer};
use crate::geometry::Ray;
use crate::settings::Crop;

/// Edge of a block in pixels; its centre is looked at.
const BLOCK: u32 = 16;

/// Estimated costs of all tiles, in arbitrary units, and the rays that it took to learn them.
///
/// Runs on the rayon pool that it is called in. Only the order of work follows from it, never a byte of the image.
pub fn estimate(renderer: &Renderer, crop: Crop, tiling: &Tiling) -> (Vec<f32>, RayCounts) {
    let (columns, rows) = (crop.width().div_ceil(BLOCK), crop.height().div_ceil(BLOCK));
    let looked: Vec<(f32, RayCounts)> = (0..columns * rows)
        .into_par_iter()
        .map(|block| {
            let center = |low: u32, high: u32, index: u32| (low + index * BLOCK + BLOCK / 2).min(high - 1);
            let x0 = center(crop.x0, crop.x1, block % columns);
            let y0 = center(crop.y0, crop.y1, block / columns);
            renderer.look(Tile { x0, y0, x1: x0 + 1, y1: y0 + 1 })
        })
        .collect();
    let counts = looked
        .iter()
        .fold(RayCounts::default(), |sum, (_, counts)| std::array::from_fn(|kind| sum[kind] + counts[kind]));
    let cost = |tile: Tile| {
        let blocks =
            |low: u32, high: u32, origin: u32| (low - origin) / BLOCK..(high - 1 - origin) / BLOCK + 1;
        let (mut sum, mut n) = (0.0, 0.0);
        for row in blocks(tile.y0, tile.y1, crop.y0) {
            for column in blocks(tile.x0, tile.x1, crop.x0) {
                sum += looked[(row * columns + column) as usize].0;
                n += 1.0;
            }
        }
        sum / n * tile.area() as f32
    };
    ((0..tiling.len()).map(|index| cost(tiling.tile(index))).collect(), counts)
}

/// The most camera rays of [`looks`] along an edge of the image.
const LOOKS: u32 = 64;

/// Camera rays spread over the image, one through every so manieth pixel.
pub fn looks(renderer: &Renderer, crop: Crop) -> Vec<Ray> {
    let (step_x, step_y) = (crop.width().div_ceil(LOOKS) as usize, crop.height().div_ceil(LOOKS) as usize);
    let pixels = (crop.y0..crop.y1)
        .step_by(step_y)
        .flat_map(|y| (crop.x0..crop.x1).step_by(step_x).map(move |x| y * renderer.settings.width + x));
    pixels.map(|pixel| renderer.camera_ray(pixel, 0).ray()).collect()
}

impl Renderer<'_> {
    /// Traces one sample of a tile of one pixel; its time in seconds.
    fn look(&self, pixel: Tile) -> (f32, RayCounts) {
        let begin = Instant::now();
        let round = Round::all(1);
        let mut film = TileFilm::new(pixel, self.settings.width, self.planes(&round));
        let index = pixel.y0 * self.settings.width + pixel.x0;
        let counts = self.trace_to_end(&round, std::iter::once((index, 0)), &mut film);
        (begin.elapsed().as_secs_f32(), counts)
    }
}
