//! The scene of the sphere rungs: a few mirrors seen in perspective, each with one reflection, shaded in f64; and the pictures of it.
//!
//! Centres, radii and the eye are multiples of 2^-11, directions to pixels multiples of 2^-10: 12 bits hold them exactly, so
//! what differs between pictures is the arithmetic alone.

use std::path::Path;

use glam::DVec3;

use super::sphere::Arithmetic;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::output::write::{Target, WriteOptions, write};

/// Pixels along each side of a picture.
pub const SIDE: u32 = 256;
/// Diameter of the space that coordinates can name; errors of t are told as fractions of it.
pub const SCENE_SIZE: f64 = 2.0;
const EYE: DVec3 = DVec3::new(0.0, 0.0, -0.75);
const GAP: u32 = 4;
/// Differences are shown this much enlarged.
const ENLARGED: f32 = 8.0;

struct Mirror {
    center: [f64; 3],
    radius: f64,
    color: DVec3,
}

const MIRRORS: [Mirror; 6] = [
    Mirror { center: [0.0, 0.0625, 0.375], radius: 0.25, color: DVec3::new(0.85, 0.85, 0.9) },
    Mirror { center: [-0.375, -0.125, 0.25], radius: 0.15625, color: DVec3::new(0.9, 0.25, 0.2) },
    Mirror { center: [0.34375, -0.15625, 0.1875], radius: 0.140625, color: DVec3::new(0.2, 0.5, 0.95) },
    Mirror { center: [0.34375, 0.28125, 0.5], radius: 0.125, color: DVec3::new(0.95, 0.75, 0.15) },
    Mirror { center: [-0.3125, 0.28125, 0.4375], radius: 0.109375, color: DVec3::new(0.3, 0.8, 0.35) },
    Mirror { center: [0.0, -1.0, 0.25], radius: 0.75, color: DVec3::new(0.6, 0.55, 0.5) },
];

/// The direction to a point of the picture's plane, x and y in [-0.5, 0.5], y upwards.
pub fn camera(x: f64, y: f64) -> (DVec3, DVec3) {
    (EYE, DVec3::new(x, y, 1.0))
}

/// The scene as one arithmetic holds it.
pub struct Scene<'a, A: Arithmetic> {
    pub arithmetic: &'a A,
    pub balls: Vec<A::Ball>,
}

/// What a ray found.
#[derive(Clone, Copy, Debug)]
pub struct Found<R> {
    pub ball: usize,
    pub distance: f64,
    pub normal: DVec3,
    pub reflected: R,
}

impl<'a, A: Arithmetic> Scene<'a, A> {
    pub fn new(arithmetic: &'a A) -> Self {
        let balls = MIRRORS.iter().map(|m| arithmetic.ball(DVec3::from(m.center), m.radius)).collect();
        Scene { arithmetic, balls }
    }

    /// The first sphere but for the one that the ray starts on: from outside, that can't be met again.
    pub fn closest(&self, ray: &A::Ray, start: Option<usize>) -> Option<Found<A::Ray>> {
        let mut best: Option<(usize, A::T)> = None;
        for (number, ball) in self.balls.iter().enumerate().filter(|(number, _)| start != Some(*number)) {
            if let Some(t) = self.arithmetic.meet(ray, ball)
                && best.is_none_or(|(_, nearest)| t < nearest)
            {
                best = Some((number, t));
            }
        }
        let (ball, t) = best?;
        let bounce = self.arithmetic.bounce(ray, &self.balls[ball], t);
        let distance = self.arithmetic.distance(ray, t);
        Some(Found { ball, distance, normal: bounce.normal, reflected: bounce.reflected })
    }

    fn color(&self, ray: &A::Ray) -> DVec3 {
        let direction = self.arithmetic.direction(ray);
        let Some(first) = self.closest(ray, None) else { return sky(direction) };
        let mirrored = self.arithmetic.direction(&first.reflected);
        let seen = match self.closest(&first.reflected, Some(first.ball)) {
            Some(second) => local(second.ball, second.normal, mirrored),
            None => sky(mirrored),
        };
        local(first.ball, first.normal, direction) * 0.45 + seen * MIRRORS[first.ball].color * 0.55
    }

    /// The picture, one ray for each pixel.
    pub fn picture(&self) -> Image {
        let mut image = Image::new(SIDE, SIDE);
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(SIDE) - 0.5;
        for (pixel, at) in image.pixels.iter_mut().zip(0..SIDE * SIDE) {
            let (origin, direction) = camera(middle(at % SIDE), -middle(at / SIDE));
            let color = self.color(&self.arithmetic.ray(origin, direction));
            *pixel = color.to_array().map(|c| c as f32);
        }
        image
    }
}

/// Phong's shading under one light from the upper left, without shadows.
fn local(ball: usize, normal: DVec3, direction: DVec3) -> DVec3 {
    let light = DVec3::new(-0.48, 0.6, -0.64);
    let reflected = direction - normal * (2.0 * direction.dot(normal));
    let diffuse = 0.15 + 0.85 * normal.dot(light).max(0.0);
    MIRRORS[ball].color * diffuse + DVec3::splat(0.6 * libm::pow(reflected.dot(light).max(0.0), 50.0))
}

/// Bright at the horizon, darker above, brown below.
fn sky(direction: DVec3) -> DVec3 {
    if direction.y < 0.0 {
        DVec3::new(0.16, 0.13, 0.1) * (1.0 + 2.0 * direction.y.abs())
    } else {
        DVec3::new(0.75, 0.85, 1.0).lerp(DVec3::new(0.1, 0.25, 0.6), direction.y.sqrt())
    }
}

/// The sheet: the rungs' pictures beside each other, the last the exact one, and below each its enlarged difference from that.
pub fn sheet(pictures: &[Image]) -> Image {
    let columns = pictures.len() as u32;
    let mut sheet = Image::new(columns * (SIDE + GAP) - GAP, 2 * SIDE + GAP);
    sheet.pixels.fill([1.0; 3]);
    let exact = pictures.last();
    for (column, picture) in (0..columns).zip(pictures) {
        for at in 0..SIDE * SIDE {
            let pixel = picture.pixels[at as usize];
            let best = exact.map_or(pixel, |exact| exact.pixels[at as usize]);
            let difference = std::array::from_fn(|k| ENLARGED * (pixel[k] - best[k]).abs());
            let place = |row: u32| {
                let (x, y) = (column * (SIDE + GAP) + at % SIDE, row * (SIDE + GAP) + at / SIDE);
                (y * sheet.width + x) as usize
            };
            let (above, below) = (place(0), place(1));
            sheet.pixels[above] = pixel;
            sheet.pixels[below] = difference;
        }
    }
    sheet
}

/// Writes a picture as a PNG file into an existing folder.
///
/// # Errors
/// A file that can't be written.
pub fn save(image: &Image, folder: &Path, name: &str) -> Result<()> {
    let path = folder.join(name);
    let target = Target::File { path, format: crate::output::write::Format::Png };
    write(image, &target, &WriteOptions::default())
}

/// Makes the folder for the pictures, if there is none.
///
/// # Errors
/// A folder that can't be made.
pub fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))
}
