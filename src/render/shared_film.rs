//! A film that several threads deposit in: each gathers what it has, and adds it now and then.

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::features::PLANES;
use super::film::{Cell, Film};
use crate::geometry::record::RayRecord;
use crate::scene::Color;
use crate::settings::Crop;

/// Rows of pixels under one lock: tiles that are sampled at once hardly share any.
const ROWS: usize = 32;
/// Deposits that a thread gathers before it adds them.
const MOST: usize = 4096;

/// A film of the whole rendered part of the image, in stripes of rows.
#[derive(Debug)]
pub struct SharedFilm {
    crop: Crop,
    image_width: u32,
    planes: usize,
    /// As in [`Film`], [`ROWS`] rows each.
    stripes: Vec<Mutex<Vec<Cell>>>,
}

impl SharedFilm {
    pub fn new(crop: Crop, image_width: u32, planes: usize) -> Self {
        let mut film = SharedFilm { crop, image_width, planes, stripes: Vec::new() };
        let cells = crop.width() as usize * crop.height() as usize * planes;
        let of_stripe =
            |first: usize| Mutex::new(vec![Cell::default(); film.cells_of_stripe().min(cells - first)]);
        film.stripes = (0..cells).step_by(film.cells_of_stripe()).map(of_stripe).collect();
        film
    }

    fn cells_of_stripe(&self) -> usize {
        (self.crop.width() as usize * self.planes * ROWS).max(1)
    }

    /// Where a record deposits.
    fn cell(&self, record: &RayRecord) -> usize {
        let x = (record.pixel % self.image_width - self.crop.x0) as usize;
        let y = (record.pixel / self.image_width - self.crop.y0) as usize;
        (y * self.crop.width() as usize + x) * self.planes + usize::from(record.plane)
    }

    /// A panic elsewhere leaves cells whole.
    fn stripe(&self, number: usize) -> MutexGuard<'_, Vec<Cell>> {
        self.stripes[number].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The film as it is now that all threads are done.
    pub fn into_film(self) -> Film {
        let mut film = Film::new(self.crop, self.planes);
        let length = self.cells_of_stripe();
        for (cells, stripe) in film.cells_mut().chunks_mut(length).zip(self.stripes) {
            cells.copy_from_slice(&stripe.into_inner().unwrap_or_else(PoisonError::into_inner));
        }
        film
    }
}

/// What one thread has for a film: cells and what is to be added to them.
#[derive(Debug, Default)]
pub struct Deposits {
    list: Vec<(usize, Cell)>,
}

impl Deposits {
    /// Counts a sample of the record's pixel.
    pub fn count(&mut self, film: &SharedFilm, record: &RayRecord) {
        self.put(film, film.cell(record), Cell::SAMPLE);
    }

    /// Adds light to the record's pixel.
    pub fn add(&mut self, film: &SharedFilm, record: &RayRecord, radiance: Color) {
        let light = Cell::of(radiance);
        if light.sum != [0; 3] {
            self.put(film, film.cell(record), light);
        }
    }

    /// Adds to the last planes of the record's pixel.
    pub fn add_features(&mut self, film: &SharedFilm, record: &RayRecord, features: &[Color; PLANES]) {
        for (plane, value) in (film.planes - PLANES..).zip(features) {
            let cell = film.cell(&RayRecord { plane: plane as u8, ..*record });
            self.put(film, cell, Cell { count: 1, ..Cell::of(*value) });
        }
    }

    fn put(&mut self, film: &SharedFilm, cell: usize, add: Cell) {
        self.list.push((cell, add));
        if self.list.len() >= MOST {
            self.go_to(film);
        }
    }

    /// Adds all of them to the film.
    pub fn go_to(&mut self, film: &SharedFilm) {
        let length = film.cells_of_stripe();
        let mut list = self.list.drain(..).peekable();
        while let Some(&(first, _)) = list.peek() {
            // As long as one lock serves.
            let number = first / length;
            let mut stripe = film.stripe(number);
            while let Some((cell, add)) = list.next_if(|&(cell, _)| cell / length == number) {
                stripe[cell - number * length].merge(&add);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::estimate::Estimate;
    use super::super::rounds::Round;
    use super::*;
    use crate::image::Image;
    use glam::DVec3;

    fn resolve(film: &Film, crop: Crop) -> Image {
        let mut estimate = Estimate::new(crop, 1, 0.0);
        estimate.absorb(film.clone(), &Round::all(1));
        estimate.resolve(crop, 0.0).0
    }

    #[test]
    fn films_of_ranks_add_up() {
        let crop = Crop { x0: 10, y0: 20, x1: 14, y1: 23 };
        let shared = || SharedFilm::new(crop, 100, 1);
        let record = RayRecord::camera(DVec3::ZERO, DVec3::X, 22 * 100 + 13, 0, 0);
        let (one, other) = (shared(), shared());
        let mut deposits = Deposits::default();
        deposits.count(&one, &record);
        deposits.add(&one, &record, [0.25, 0.5, f64::INFINITY]);
        deposits.go_to(&one);
        deposits.add(&other, &record, [0.25, -1.0, f64::INFINITY]);
        deposits.go_to(&other);
        let mut film = one.into_film();
        film.add(other.into_film().as_bytes()).unwrap();
        let image = resolve(&film, crop);
        assert_eq!(image.pixels[2 * 4 + 3], [0.5, 0.5, 4_294_967_296.0]);
        assert_eq!(image.pixels.iter().filter(|p| **p != [0.0; 3]).count(), 1);
        assert!(film.add(&[0; 32]).is_err());
    }

    #[test]
    fn threads_that_deposit_at_once_lose_nothing() {
        let crop = Crop { x0: 3, y0: 5, x1: 20, y1: 105 };
        let shared = SharedFilm::new(crop, 50, 1);
        std::thread::scope(|scope| {
            for thread in 0..4u32 {
                let shared = &shared;
                scope.spawn(move || {
                    let mut deposits = Deposits::default();
                    for turn in 0..17 * 100 * 5 {
                        let (x, y) = (3 + turn % 17, 5 + (turn / 17 + thread * 31) % 100);
                        let record = RayRecord::camera(DVec3::ZERO, DVec3::X, y * 50 + x, 0, 0);
                        deposits.count(shared, &record);
                        deposits.add(shared, &record, [f64::from(x), f64::from(y), 0.0]);
                    }
                    deposits.go_to(shared);
                });
            }
        });
        let image = resolve(&shared.into_film(), crop);
        for (place, pixel) in image.pixels.iter().enumerate() {
            assert_eq!(*pixel, [(3 + place % 17) as f32, (5 + place / 17) as f32, 0.0]);
        }
    }
}
