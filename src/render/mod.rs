//! One rank's work: tiles of camera rays traced to their end, and the film that they deposit in.

pub mod allotment;
pub mod cost;
pub mod division;
pub mod estimate;
pub mod features;
pub mod film;
pub mod filter;
pub mod metric;
pub mod rate;
pub mod relay;
pub mod rounds;
pub mod shared_film;
pub mod streams;
pub mod tile;

use std::cell::Cell;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::accel::Trace;
use crate::geometry::record::{Answer, RayRecord};
use crate::render::rounds::{Activity, Round};
use crate::scene::{Color, Scene};
use crate::settings::ImageSettings;
use crate::transport::sampler::Cameras;
use crate::transport::{Scratch, Sink, Transport};
use film::TileFilm;
use filter::FilterTable;
use streams::Streams;
use tile::Tile;

/// Records traced at once: enough to be worth a batch, few enough for the second-level cache.
const BATCH: usize = 1024;

/// What a thread traces with, kept between tiles: to make it anew takes longer than to trace some tiles.
#[derive(Default)]
struct Buffers {
    cameras: Cameras,
    waiting: Streams<RayRecord>,
    scratch: Scratch,
    wave: Vec<RayRecord>,
    answers: Vec<Answer>,
}

thread_local! {
    static BUFFERS: Cell<Option<Box<Buffers>>> = const { Cell::new(None) };
}

/// Rays by what made them, in the order of [`RayRecord::ORIGINS`].
pub type RayCounts = [u64; RayRecord::ORIGINS.len()];

/// Rays counted by many threads.
#[derive(Debug, Default)]
pub struct RayTally([AtomicU64; RayRecord::ORIGINS.len()]);

impl RayTally {
    pub fn add(&self, rays: &RayCounts) {
        for (sum, rays) in self.0.iter().zip(rays) {
            sum.fetch_add(*rays, Ordering::Relaxed);
        }
    }

    pub fn counts(&self) -> RayCounts {
        std::array::from_fn(|kind| self.0[kind].load(Ordering::Relaxed))
    }
}

/// Planes of each pixel of a round's film: the filter's for each batch, then those of features.
pub fn planes(settings: &ImageSettings, filter: &FilterTable, round: &Round) -> usize {
    let features = if settings.features { features::PLANES } else { 0 };
    filter.planes() * round.batches as usize + features
}

/// Everything that a thread needs to render any tile.
pub struct Renderer<'a> {
    scene: &'a Scene,
    accel: &'a dyn Trace,
    settings: &'a ImageSettings,
    transport: Transport<'a>,
    filter: FilterTable,
}

impl<'a> Renderer<'a> {
    pub fn new(scene: &'a Scene, accel: &'a dyn Trace, settings: &'a ImageSettings) -> Self {
        Self::with_filter(scene, accel, settings, FilterTable::new(settings.filter))
    }

    /// With a table of the settings' filter that was made before.
    fn with_filter(
        scene: &'a Scene,
        accel: &'a dyn Trace,
        settings: &'a ImageSettings,
        filter: FilterTable,
    ) -> Self {
        let transport = Transport::new(scene, settings);
        Renderer { scene, accel, settings, transport, filter }
    }

    /// Planes of each pixel of a round's film: see [`planes`].
    pub fn planes(&self, round: &Round) -> usize {
        planes(self.settings, &self.filter, round)
    }

    /// Renders a round's samples of one tile. Pure: the same deposits on any rank and thread.
    pub fn tile(&self, tile: Tile, round: &Round, activity: &Activity) -> (TileFilm, RayCounts) {
        let mut film = TileFilm::new(tile, self.settings.width, self.planes(round));
        let pixels = tile.pixels(self.settings.width).filter(|&pixel| activity.holds(pixel));
        let pixels: Vec<u32> = pixels.collect();
        let (mut place, mut sample) = (0, 0);
        let samples = std::iter::from_fn(|| {
            let next = (*pixels.get(place)?, round.first + sample);
            (place, sample) = if sample + 1 < round.count { (place, sample + 1) } else { (place + 1, 0) };
            Some(next)
        });
        let counts = self.trace_to_end(round, samples, &mut film);
        (film, counts)
    }

    /// Traces the camera rays of samples of pixels, and all that grows from them, stream by stream.
    fn trace_to_end(
        &self,
        round: &Round,
        mut samples: impl Iterator<Item = (u32, u32)>,
        film: &mut TileFilm,
    ) -> RayCounts {
        let mut counts = RayCounts::default();
        // Taken, not borrowed: a thread that waits for others while it traces may be given another tile.
        let mut buffers = BUFFERS.take().unwrap_or_default();
        let Buffers { cameras, waiting, scratch, wave, answers } = &mut *buffers;
        loop {
            wave.clear();
            waiting.take(wave, BATCH);
            while wave.len() < BATCH {
                let count = cameras.take(&mut samples, BATCH - wave.len());
                if count == 0 {
                    break;
                }
                self.begin(round, cameras, count, |record| {
                    film.count(&record);
                    wave.push(record);
                });
            }
            if wave.is_empty() {
                break;
            }
            self.accel.trace(&self.scene.surfaces, wave, answers);
            for record in &*wave {
                counts[usize::from(record.made_by) % counts.len()] += 1;
            }
            if self.settings.features {
                for (record, answer) in wave.iter().zip(&*answers) {
                    if let Some(features) = features::of_hit(self.scene, record, answer, answer.primitive) {
                        film.add_features(record, &features);
                    }
                }
            }
            let out = &mut Split { waiting, film };
            self.transport.advance_all(wave, answers, scratch, out);
        }
        BUFFERS.set(Some(buffers));
        counts
    }

    /// The rays of the first `count` of these samples of a round, which deposit where their batches do.
    fn begin(&self, round: &Round, cameras: &mut Cameras, count: usize, mut each: impl FnMut(RayRecord)) {
        if self.settings.spp > 1 {
            self.transport.sampler.cameras(cameras, count);
        }
        let Cameras { pixel, sample, numbers: [x, y, u, v] } = cameras;
        for lane in 0..count {
            let numbers = [x[lane], y[lane], u[lane], v[lane]];
            let mut record = self.camera_ray_by(pixel[lane], sample[lane], numbers);
            record.plane += self.filter.planes() as u8 * round.batch(sample[lane]) as u8;
            each(record);
        }
    }

    /// The ray of one sample of a pixel (y * width + x).
    fn camera_ray(&self, pixel: u32, sample: u32) -> RayRecord {
        self.camera_ray_by(pixel, sample, self.transport.sampler.camera(pixel, sample))
    }

    /// The same by the sample's numbers. A single sample goes through the pixel's centre.
    fn camera_ray_by(&self, pixel: u32, sample: u32, [x, y, u, v]: [f64; 4]) -> RayRecord {
        let settings = self.settings;
        let (mut offset, mut plane, mut lens) = ([0.0; 2], 0, [0.5; 2]);
        if settings.spp > 1 {
            (offset, plane) = self.filter.sample([x, y]);
            lens = [u, v];
        }
        let x = f64::from(pixel % settings.width) + 0.5 + offset[0];
        let y = f64::from(pixel / settings.width) + 0.5 + offset[1];
        let (width, height) = (f64::from(settings.width), f64::from(settings.height));
        let (origin, direction) = self.scene.header.camera.ray(x, y, width, height, lens);
        RayRecord::camera(origin, direction, pixel, sample, plane)
    }
}

/// New rays to one side, light to the other.
struct Split<'a> {
    waiting: &'a mut Streams<RayRecord>,
    film: &'a mut TileFilm,
}

impl Sink for Split<'_> {
    #[inline]
    fn push(&mut self, record: RayRecord) {
        self.waiting.push(record.stream, record);
    }

    #[inline]
    fn deposit(&mut self, record: &RayRecord, radiance: Color) {
        self.film.deposit(record, radiance);
    }
}
