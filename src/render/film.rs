//! The film: sums that don't depend on the order in which light arrives.
//!
//! A deposit is a non-negative number in units of 2^-32, rounded to nearest; NaN and negative numbers count as 0, and one deposit is at most
//! 2^31. Deposits are added as u64, saturating at 2^32: addition of non-negative integers that saturates gives the same sum in any order. A pixel
//! has one plane, or two where the filter has negative lobes: then the second holds the samples of negative weight.

use bytemuck::{Pod, Zeroable};

use super::features::PLANES;
use super::tile::Tile;
use crate::error::{Error, Result};
use crate::geometry::record::RayRecord;
use crate::memory::{Array, HugeArray};
use crate::scene::Color;
use crate::settings::Crop;

/// 2^32: how many of the film's units are 1.
const ONE: f64 = 4_294_967_296.0;
/// The largest single deposit, in units: 2^31 as a radiance.
const LARGEST: f64 = 2_147_483_648.0 * ONE;

/// What one plane of a pixel has gathered.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Cell {
    /// Radiance in units of 2^-32.
    pub sum: [u64; 3],
    /// Samples taken.
    pub count: u64,
}

impl Cell {
    /// One sample without light.
    pub const SAMPLE: Cell = Cell { sum: [0; 3], count: 1 };

    /// So much light.
    pub fn of(radiance: Color) -> Cell {
        Cell { sum: radiance.map(to_fixed), count: 0 }
    }

    fn deposit(&mut self, radiance: Color) {
        self.merge(&Cell::of(radiance));
    }

    pub fn merge(&mut self, other: &Cell) {
        for (sum, value) in self.sum.iter_mut().zip(other.sum) {
            *sum = sum.saturating_add(value);
        }
        self.count += other.count;
    }

    /// Radiance; `None` without samples.
    pub fn mean(&self) -> Option<Color> {
        (self.count > 0).then(|| self.sum.map(|sum| sum as f64 / ONE / self.count as f64))
    }
}

/// Units of 2^-32, rounded to nearest. Neither less than nothing nor no number adds anything.
#[inline(always)]
fn to_fixed(value: f64) -> u64 {
    let units = value * ONE + 0.5;
    let units = if units > 0.5 { units } else { 0.0 };
    // Signed integers: processors convert to those.
    if units < LARGEST { units as i64 as u64 } else { 1 << 63 }
}

/// The film of one tile.
#[derive(Clone, Debug, PartialEq)]
pub struct TileFilm {
    tile: Tile,
    image_width: u32,
    planes: usize,
    /// `cells[((y - y0) * width + (x - x0)) * planes + plane]`.
    cells: Vec<Cell>,
}

impl TileFilm {
    pub fn new(tile: Tile, image_width: u32, planes: usize) -> Self {
        TileFilm { tile, image_width, planes, cells: vec![Cell::default(); tile.area() * planes] }
    }

    /// Counts a sample of the record's pixel.
    pub fn count(&mut self, record: &RayRecord) {
        self.cell(record).count += 1;
    }

    /// Adds light to the record's pixel.
    pub fn deposit(&mut self, record: &RayRecord, radiance: Color) {
        self.cell(record).deposit(radiance);
    }

    /// Adds to the last planes of the record's pixel.
    pub fn add_features(&mut self, record: &RayRecord, features: &[Color; PLANES]) {
        for (plane, value) in (self.planes - PLANES..).zip(features) {
            let cell = self.cell(&RayRecord { plane: plane as u8, ..*record });
            cell.deposit(*value);
            cell.count += 1;
        }
    }

    /// The cells as bytes, to be sent or kept.
    pub fn as_bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.cells)
    }

    fn cell(&mut self, record: &RayRecord) -> &mut Cell {
        let x = record.pixel % self.image_width - self.tile.x0;
        let y = record.pixel / self.image_width - self.tile.y0;
        let index = y as usize * self.tile.width() as usize + x as usize;
        &mut self.cells[index * self.planes + usize::from(record.plane)]
    }
}

/// The film of the whole rendered part of the image.
#[derive(Clone, Debug)]
pub struct Film {
    crop: Crop,
    planes: usize,
    /// Untouched pages of it cost nothing.
    cells: HugeArray<Cell>,
}

impl Film {
    /// # Panics
    /// Out of memory.
    pub fn new(crop: Crop, planes: usize) -> Self {
        let pixels = crop.width() as usize * crop.height() as usize;
        let cells = HugeArray::zeroed(pixels * planes).expect("memory for a film");
        Film { crop, planes, cells }
    }

    /// `cells[(y * width + x) * planes + plane]`.
    pub(super) fn cells_mut(&mut self) -> &mut [Cell] {
        &mut self.cells
    }

    /// The same.
    pub(super) fn into_cells(self) -> HugeArray<Cell> {
        self.cells
    }

    /// All cells as bytes, to be added to another rank's film.
    pub fn as_bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.cells)
    }

    /// Adds the cells of another film of the same shape, as [`Film::as_bytes`] gave them.
    ///
    /// # Errors
    /// A number of bytes that isn't this film's.
    pub fn add(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.len() != self.as_bytes().len() {
            return Err(foreign(format!(
                "a film of {} pixels came with {} bytes",
                self.cells.len(),
                bytes.len()
            )));
        }
        for (cell, bytes) in self.cells.iter_mut().zip(bytes.chunks_exact(size_of::<Cell>())) {
            cell.merge(&bytemuck::pod_read_unaligned(bytes));
        }
        Ok(())
    }

    /// Adds a tile's cells, as [`TileFilm::as_bytes`] gave them.
    ///
    /// # Errors
    /// A number of bytes that isn't the tile's.
    pub fn merge(&mut self, tile: Tile, bytes: &[u8]) -> Result<()> {
        let row_cells = tile.width() as usize * self.planes;
        if bytes.len() != tile.area() * self.planes * size_of::<Cell>() {
            return Err(foreign(format!("a tile of {} pixels came with {} bytes", tile.area(), bytes.len())));
        }
        for (row, bytes) in bytes.chunks_exact(row_cells * size_of::<Cell>()).enumerate() {
            let y = (tile.y0 - self.crop.y0) as usize + row;
            let x = (tile.x0 - self.crop.x0) as usize;
            let first = (y * self.crop.width() as usize + x) * self.planes;
            let cells = self.cells[first..first + row_cells].iter_mut();
            for (cell, bytes) in cells.zip(bytes.chunks_exact(size_of::<Cell>())) {
                cell.merge(&bytemuck::pod_read_unaligned(bytes));
            }
        }
        Ok(())
    }
}

fn foreign(what: String) -> Error {
    Error::launch(what, "run the same build of heliostat on every node")
}

#[cfg(test)]
mod tests {
    use super::super::estimate::Estimate;
    use super::super::rounds::Round;
    use super::*;
    use crate::image::Image;
    use glam::DVec3;
    use proptest::prelude::*;

    fn resolve(film: &Film, negative_mass: f64, floor: f64) -> Image {
        let mut estimate = Estimate::new(film.crop, film.planes, negative_mass);
        estimate.absorb(film.clone(), &Round::all(1));
        estimate.resolve(film.crop, floor).0
    }

    #[test]
    fn deposits_are_rounded_clamped_and_never_negative() {
        assert_eq!(to_fixed(1.0), 1 << 32);
        assert_eq!(to_fixed(0.5 / ONE), 1);
        assert_eq!(to_fixed(0.4 / ONE), 0);
        assert_eq!(to_fixed(f64::NAN), 0);
        assert_eq!(to_fixed(-3.0), 0);
        assert_eq!(to_fixed(f64::NEG_INFINITY), 0);
        assert_eq!(to_fixed(f64::INFINITY), 1 << 63);
        assert_eq!(to_fixed(1e300), 1 << 63);
    }

    proptest! {
        #[test]
        fn sums_do_not_depend_on_order(
            values in prop::collection::vec(prop_oneof![0.0f64..2.0, 1e8f64..1e10, Just(1e-12)], 1..40),
            turn in 0usize..40,
        ) {
            let mut turned = values.clone();
            turned.rotate_left(turn % values.len());
            let sum = |values: &[f64]| {
                let mut cell = Cell::default();
                values.iter().for_each(|&value| cell.deposit([value; 3]));
                cell
            };
            prop_assert_eq!(sum(&values), sum(&turned));
        }
    }

    #[test]
    fn tiles_land_where_they_belong() {
        let crop = Crop { x0: 10, y0: 20, x1: 14, y1: 23 };
        let tile = Tile { x0: 12, y0: 21, x1: 14, y1: 23 };
        let mut film = Film::new(crop, 1);
        let mut part = TileFilm::new(tile, 100, 1);
        let record = RayRecord::camera(DVec3::ZERO, DVec3::X, 22 * 100 + 13, 0, 0);
        part.count(&record);
        part.deposit(&record, [0.25, 0.5, 1.0]);
        film.merge(tile, part.as_bytes()).unwrap();
        let image = resolve(&film, 0.0, 0.0);
        assert_eq!((image.width, image.height), (4, 3));
        assert_eq!(image.pixels[2 * 4 + 3], [0.25, 0.5, 1.0]);
        assert_eq!(image.pixels.iter().filter(|p| **p != [0.0; 3]).count(), 1);
        assert_eq!(resolve(&film, 0.0, 0.5).pixels[0], [0.5; 3]);
        assert!(film.merge(tile, &[0; 7]).is_err());
    }

    #[test]
    fn signed_planes_keep_constants() {
        let mut film = Film::new(Crop { x0: 0, y0: 0, x1: 1, y1: 1 }, 2);
        let record = |plane| RayRecord::camera(DVec3::ZERO, DVec3::X, 0, 0, plane);
        let tile = Tile { x0: 0, y0: 0, x1: 1, y1: 1 };
        let mut part = TileFilm::new(tile, 1, 2);
        for plane in [0, 0, 1] {
            part.count(&record(plane));
            part.deposit(&record(plane), [0.7; 3]);
        }
        film.merge(tile, part.as_bytes()).unwrap();
        let value = resolve(&film, 0.2, 0.0).pixels[0][0];
        assert!((value - 0.7).abs() < 1e-7, "{value}");
    }
}
