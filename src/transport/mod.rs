//! What happens at the end of a ray: light is deposited, and more rays are made. Written once for every split;
//! knows nothing of threads, tiles, ranks or accelerators.
//!
//! Shading is done in f64.

pub mod bsdf;
mod lanes;
mod path;
mod phong;
pub mod sampler;
mod sobol;
pub mod surface;
mod whitted;

use crate::geometry::record::{Answer, RayRecord};
use crate::scene::{Color, Scene};
use crate::settings::{Direct, ImageSettings, Integrator};
use sampler::Sampler;

/// Where [`Transport::advance`] sends what it makes.
pub trait Sink {
    /// A new ray.
    fn push(&mut self, record: RayRecord);
    /// Linear RGB radiance for the record's pixel and film plane.
    fn deposit(&mut self, record: &RayRecord, radiance: Color);
}

/// What is kept between batches.
#[derive(Default)]
pub struct Scratch {
    matt: Box<lanes::matt::Matt>,
    glossy: Box<lanes::glossy::Glossy>,
}

/// A scene seen with the settings that decide how far light is followed.
#[derive(Clone, Copy, Debug)]
pub struct Transport<'a> {
    scene: &'a Scene,
    integrator: Integrator,
    max_depth: u32,
    min_weight: f64,
    roulette: u32,
    direct: Direct,
    pub sampler: Sampler,
    /// The scene's ambient light and that of all lights.
    ambient: Color,
    /// Whether a shadow ray may pass through something.
    transparent: bool,
}

impl<'a> Transport<'a> {
    pub fn new(scene: &'a Scene, settings: &ImageSettings) -> Self {
        let header = &scene.header;
        let lights = header.lights.iter();
        Transport {
            scene,
            integrator: settings.integrator,
            max_depth: settings.max_depth,
            min_weight: settings.min_weight,
            roulette: settings.roulette,
            direct: settings.direct,
            sampler: Sampler::new(settings),
            ambient: lights.fold(header.ambient, |sum, light| add(sum, light.ambient)),
            transparent: header.materials.iter().any(|material| material.is_transparent()),
        }
    }

    fn chances(&self) -> path::Chances {
        path::Chances { direct: self.direct, roulette: self.roulette }
    }

    /// As [`advance`](Self::advance) for a batch of records.
    pub fn advance_all(
        &self,
        records: &[RayRecord],
        answers: &[Answer],
        scratch: &mut Scratch,
        out: &mut impl Sink,
    ) {
        match self.integrator {
            Integrator::Whitted => lanes::advance_all(self, records, answers, &mut *scratch.glossy, out),
            Integrator::Path => lanes::advance_all(self, records, answers, &mut *scratch.matt, out),
        }
    }

    /// Goes on from the answer to a record: deposits what is complete and pushes what must be traced. Pure but for `out`.
    pub fn advance(&self, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
        match self.integrator {
            Integrator::Whitted => whitted::advance(self, record, answer, out),
            Integrator::Path => path::advance(self, record, answer, out),
        }
    }
}

// Written out, as closures over arrays aren't always inlined.

#[inline(always)]
fn add(a: Color, b: Color) -> Color {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
fn times(a: Color, b: Color) -> Color {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
fn scaled(a: Color, factor: f64) -> Color {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

const BLACK: Color = [0.0; 3];

#[inline(always)]
fn is_black(color: Color) -> bool {
    color[0] == 0.0 && color[1] == 0.0 && color[2] == 0.0
}
