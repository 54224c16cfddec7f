//! One process: the same bytes for any number of threads, tile size, accelerator and crop; and golden images.

mod common;

use std::path::PathBuf;

use common::{fingerprint, name, render, repository, scenes, small_work};
use heliostat::accel::Accel;
use heliostat::image::Image;
use heliostat::output::write::{Format, WriteOptions, encode};
use heliostat::settings::{AccelKind, BuildPreset, BuildSettings, Crop};

#[test]
fn threads_and_tiles_change_nothing() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        let expected = fingerprint(&render(&work, 1));
        for (threads, tile_size) in [(2, 8), (3, 16), (1, 33), (2, 64), (3, 1)] {
            work.run.tile_size = tile_size;
            let found = fingerprint(&render(&work, threads));
            assert_eq!(found, expected, "{}: {threads} threads, tiles of {tile_size}", name(&scene));
        }
    }
}

#[test]
fn brute_force_sees_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        let primitives = work.scene.surfaces.len();
        if primitives > 20_000 {
            println!("{}: {primitives} primitives are too many for brute force here", name(&scene));
            continue;
        }
        work.image.spp = 1;
        let expected = fingerprint(&render(&work, 2));
        work.run.accel = AccelKind::Brute;
        work.accel = Accel::Brute;
        assert_eq!(fingerprint(&render(&work, 2)), expected, "{}", name(&scene));
    }
}

#[test]
fn the_grid_sees_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        work.image.spp = 1;
        let expected = fingerprint(&render(&work, 2));
        work.run.accel = AccelKind::Grid;
        work.accel = Accel::build(AccelKind::Grid, BuildSettings::default(), &work.scene.surfaces);
        assert_eq!(fingerprint(&render(&work, 2)), expected, "{}", name(&scene));
    }
}

#[test]
fn trees_of_all_presets_see_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        work.image.spp = 1;
        let expected = fingerprint(&render(&work, 2));
        for preset in [BuildPreset::Fast, BuildPreset::Balanced, BuildPreset::Best] {
            work.accel = Accel::build(AccelKind::Bvh, preset, &work.scene.surfaces);
            assert_eq!(fingerprint(&render(&work, 2)), expected, "{} {preset:?}", name(&scene));
        }
    }
}

#[test]
fn a_crop_is_that_part_of_the_whole() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        let whole = render(&work, 2);
        let crop = Crop { x0: 13, y0: 5, x1: 48, y1: 31 };
        work.image.crop = crop;
        let part = render(&work, 2);
        for y in crop.y0..crop.y1 {
            let row = |image: &Image, x0: u32, y: u32| {
                let first = (y * image.width + x0) as usize;
                image.pixels[first..first + crop.width() as usize].to_vec()
            };
            assert_eq!(row(&part, 0, y - crop.y0), row(&whole, crop.x0, y), "{} row {y}", name(&scene));
        }
    }
}

/// Exact: the arithmetic is the same on every machine. `HELIOSTAT_BLESS=1 cargo test golden` writes them anew.
#[test]
fn golden_images() {
    let bless = std::env::var_os("HELIOSTAT_BLESS").is_some();
    for scene in scenes() {
        let image = render(&small_work(&scene, AccelKind::Bvh), 2);
        let bytes = encode(&image, Format::Png, &WriteOptions::default()).unwrap();
        let path: PathBuf = repository().join("tests/golden").join(name(&scene) + ".png");
        if bless {
            std::fs::write(&path, &bytes).unwrap();
        }
        let golden = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert!(bytes == golden, "{} differs from {}", name(&scene), path.display());
    }
}
