//! Scenes written in tests, and their images.

use std::path::Path;

use heliostat::accel::Accel;
use heliostat::cluster::Solo;
use heliostat::image::Image;
use heliostat::job::{self, Crew, Work};
use heliostat::output::progress::ProgressKind;
use heliostat::output::stats::RankStats;
use heliostat::output::timeline::Timeline;
use heliostat::output::write::{Format, WriteOptions, encode};
use heliostat::scene::{Scene, load};
use heliostat::settings::{AccelKind, BuildPreset, Crop, ImageSettings, Integrator, RunSettings, Split};
use rayon::ThreadPool;

/// A scene that is ready to be rendered as often as a test wants.
pub struct Stage {
    work: Work,
    pool: ThreadPool,
    /// For the next image.
    pub image: ImageSettings,
}

impl Stage {
    /// A scene file's text, and the files that it names.
    pub fn new(text: impl AsRef<str>, files: &[(&str, Vec<u8>)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let path = folder.path().join("stage.toml");
        std::fs::write(&path, text.as_ref()).unwrap();
        Stage::open(&path)
    }

    /// A scene file.
    pub fn open(path: &Path) -> Self {
        let loaded = load::load(path).unwrap_or_else(|error| panic!("{error}"));
        let defaults = loaded.image;
        let (width, height) = (defaults.width.unwrap(), defaults.height.unwrap());
        let image = ImageSettings {
            spp: defaults.spp.unwrap(),
            integrator: Integrator::Path,
            max_depth: defaults.max_depth.unwrap_or(Integrator::Path.max_depth()),
            ..ImageSettings::sized(width, height)
        };
        let accel = Accel::build(AccelKind::Bvh, BuildPreset::Balanced, &loaded.scene.surfaces);
        let run = RunSettings { split: Split::Stream, ..RunSettings::default() };
        let mut work = Work { scene: loaded.scene, accel, image: image.clone(), run, division: None };
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        let pool = job::thread_pool(threads).unwrap();
        with_crew(&pool, |crew| job::distribute(crew, &mut work).unwrap());
        Stage { work, pool, image }
    }

    pub fn sized(mut self, width: u32, height: u32) -> Self {
        (self.image.width, self.image.height) = (width, height);
        self.image.crop = Crop { x0: 0, y0: 0, x1: width, y1: height };
        self
    }

    pub fn scene(&self) -> &Scene {
        &self.work.scene
    }

    /// Changes the scene behind the loader's back: a fault to be found.
    pub fn meddle(&mut self, change: impl FnOnce(&mut Scene)) {
        change(&mut self.work.scene);
    }

    pub fn render(&self) -> Image {
        let mut work = self.work.clone();
        work.image = self.image.clone();
        let image = with_crew(&self.pool, |crew| job::render(crew, &mut work, &mut RankStats::default()));
        image.unwrap().expect("one process is rank 0").image
    }

    /// Images of `count` seeds that nothing else has.
    pub fn seeds(&mut self, count: u64) -> Vec<Image> {
        let first = self.image.seed + 1;
        (first..first + count)
            .map(|seed| {
                self.image.seed = seed;
                self.render()
            })
            .collect()
    }
}

fn with_crew<T>(pool: &ThreadPool, job: impl FnOnce(&Crew) -> T) -> T {
    let (progress, timeline) = (ProgressKind::None.start(), Timeline::off());
    job(&Crew { comm: &Solo::new(), pool, wide: pool, timeline: &timeline, progress: &*progress })
}

/// An image file of `width` * `height` texels.
pub fn picture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [f32; 3]) -> Vec<u8> {
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let image = Image { width, height, pixels: pixels.map(|(x, y)| texel(x, y)).collect() };
    encode(&image, Format::Exr, &WriteOptions::default()).unwrap()
}

/// The mean of all three channels.
pub fn brightness(pixel: &[f32; 3]) -> f64 {
    pixel.iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0
}

/// The brightness of a whole image.
pub fn mean(image: &Image) -> f64 {
    image.pixels.iter().map(brightness).sum::<f64>() / image.pixels.len() as f64
}
