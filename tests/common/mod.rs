//! What the integration tests share.
#![allow(dead_code)]

use std::path::{Path, PathBuf};

use heliostat::accel::Accel;
use heliostat::cluster::comm::memory;
use heliostat::cluster::{Comm, Solo};
use heliostat::image::Image;
use heliostat::job::{self, Crew, Rendered, Work};
use heliostat::output::file::write_whole;
use heliostat::output::progress::ProgressKind;
use heliostat::output::stats::RankStats;
use heliostat::output::timeline::Timeline;
use heliostat::scene::build::Space;
use heliostat::scene::helio::HelioWriter;
use heliostat::scene::load;
use heliostat::settings::{AccelKind, BuildPreset, Crop, ImageSettings, Integrator, RunSettings};

pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The folder of real meshes that developers may have beside the repository.
pub fn shared_data() -> Option<PathBuf> {
    let folder =
        std::env::var_os("HELIOSTAT_DATA").map_or_else(|| repository().join("../shared/data"), PathBuf::from);
    if !folder.is_dir() {
        println!("skipped: no folder of real meshes at {}", folder.display());
        return None;
    }
    Some(folder)
}

/// Renders in this process alone.
pub fn render(work: &Work, threads: usize) -> Image {
    render_as(&Solo::new(), work.clone(), threads).expect("rank 0")
}

/// Collective: renders rank 0's work.
pub fn render_as(comm: &dyn Comm, work: Work, threads: usize) -> Option<Image> {
    rendered_as(comm, work, threads).map(|rendered| rendered.image)
}

/// Collective: all that comes of rank 0's work.
pub fn rendered_as(comm: &dyn Comm, mut work: Work, threads: usize) -> Option<Rendered> {
    let pool = job::thread_pool(threads).unwrap();
    let progress = ProgressKind::None.start();
    let crew = Crew { comm, pool: &pool, wide: &pool, timeline: &Timeline::off(), progress: &*progress };
    job::distribute(&crew, &mut work).unwrap();
    job::render(&crew, &mut work, &mut RankStats::default()).unwrap()
}

/// Renders on several ranks, each a thread of this process.
pub fn rendered_on(ranks: usize, work: &Work) -> Rendered {
    let all: Vec<Option<Rendered>> = std::thread::scope(|scope| {
        let ranks: Vec<_> = memory::group(ranks)
            .into_iter()
            .map(|comm| {
                scope.spawn(move || {
                    let own = if comm.rank() == 0 { work.clone() } else { Work::default() };
                    rendered_as(&comm, own, 1)
                })
            })
            .collect();
        ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
    });
    all.into_iter().next().flatten().expect("rank 0's image")
}

/// Every scene of the repository, in order of name.
pub fn scenes() -> Vec<PathBuf> {
    let mut scenes: Vec<PathBuf> = std::fs::read_dir(repository().join("scenes"))
        .expect("the repository has scenes")
        .map(|entry| entry.expect("a readable entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    scenes.sort();
    assert!(scenes.len() >= 8, "only {} scenes found", scenes.len());
    scenes
}

pub fn name(scene: &Path) -> String {
    scene.file_stem().expect("a file name").to_string_lossy().into_owned()
}

/// A scene at a small size that no tile size divides, with two samples per pixel.
pub fn small_work(scene: &Path, accel: AccelKind) -> Work {
    let mut loaded = load::load(scene).expect("the repository's scenes are good");
    let (width, height) = (54, 41);
    loaded.fit(width, height);
    let defaults = &loaded.image;
    let integrator = defaults.integrator.unwrap_or(Integrator::Whitted);
    let image = ImageSettings {
        width,
        height,
        crop: Crop { x0: 0, y0: 0, x1: width, y1: height },
        spp: 2,
        seed: 7,
        integrator,
        max_depth: defaults.max_depth.unwrap_or(integrator.max_depth()),
        sampler: defaults.sampler.unwrap_or_default(),
        filter: defaults.filter.unwrap_or(heliostat::settings::Filter::Mitchell),
        ..ImageSettings::default()
    };
    let accel_built = Accel::build(accel, BuildPreset::Balanced, &loaded.scene.surfaces);
    let run = RunSettings { accel, ..RunSettings::default() };
    Work { scene: loaded.scene, accel: accel_built, image, run, division: None }
}

/// Converts a scene into a file in `folder`.
pub fn converted(scene: &Path, folder: &Path) -> PathBuf {
    let path = folder.join(name(scene)).with_extension("helio");
    let loaded = load::load_in(scene, Space::Disk(folder)).expect("the repository's scenes are good");
    let written = write_whole(&path, |out| {
        let mut writer = HelioWriter::new(out)?;
        load::helio::write(&mut writer, &loaded)?;
        writer.finish()
    });
    written.expect("a folder that can be written to");
    path
}

/// A fingerprint of every bit of an image.
pub fn fingerprint(image: &Image) -> String {
    let mut bytes = Vec::new();
    for pixel in &image.pixels {
        pixel.iter().for_each(|c| bytes.extend(c.to_bits().to_le_bytes()));
    }
    // Two independent 32-bit sums make an accident unlikely enough.
    let turned: Vec<u8> = bytes.iter().rev().map(|byte| byte.rotate_left(3)).collect();
    let (sum, other) = (crc32fast::hash(&bytes), crc32fast::hash(&turned));
    format!("{}x{}-{sum:08x}{other:08x}", image.width, image.height)
}
