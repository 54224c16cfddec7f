//! One process: the same bytes for any number of threads, tile size, accelerator and crop; and golden images.

mod common;

use std::path::PathBuf;

use common::{converted, fingerprint, name, render, render_as, repository, scenes, small_work};
use heliostat::accel::Accel;
use heliostat::cluster::Comm;
use heliostat::cluster::comm::memory;
use heliostat::image::Image;
use heliostat::job::Work;
use heliostat::output::write::{Format, WriteOptions, encode};
use heliostat::settings::{AccelKind, BuildPreset, BuildSettings, Crop, RunSettings, Split, Within};

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

/// Ranks as threads, with messages that come late and overtake each other.
#[test]
fn ranks_that_have_parts_only_see_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        let expected = fingerprint(&render(&work, 2));
        let ways = [
            (Split::Stream, 3, 1 << 26, None),
            (Split::Voxels, 1, 1 << 26, None),
            (Split::Voxels, 2, 1 << 26, None),
            (Split::Voxels, 5, 1 << 18, None),
            (Split::Voxels, 3, 1 << 26, Some(100_000)),
            (Split::Voxels, 2, 1 << 18, Some(1 << 40)),
            (Split::Triangles, 3, 1 << 18, None),
        ];
        for (seed, (split, ranks, ray_memory, replicate_hot)) in (0..).zip(ways) {
            work.run = RunSettings { split, ray_memory, replicate_hot, ..RunSettings::default() };
            let group = memory::delayed_group(ranks, seed);
            let found = std::thread::scope(|scope| {
                let work = &work;
                let ranks: Vec<_> = group
                    .into_iter()
                    .map(|comm| {
                        let work = if comm.rank() == 0 { work.clone() } else { Work::default() };
                        scope.spawn(move || render_as(&comm, work, 1))
                    })
                    .collect();
                let images: Vec<_> = ranks.into_iter().map(|rank| rank.join().unwrap()).collect();
                assert!(images[1..].iter().all(Option::is_none), "only rank 0 gets the image");
                images.into_iter().next().flatten().expect("rank 0's image")
            });
            assert_eq!(fingerprint(&found), expected, "{}: {split:?}, {ranks} ranks", name(&scene));
        }
    }
}

#[test]
fn a_converted_scene_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    for scene in scenes() {
        let work = small_work(&scene, AccelKind::Bvh);
        let converted = small_work(&converted(&scene, folder.path()), AccelKind::Bvh);
        assert_eq!(converted.image, work.image);
        let expected = fingerprint(&render(&work, 2));
        assert_eq!(fingerprint(&render(&converted, 2)), expected, "{}", name(&scene));
    }
}

#[test]
fn bounding_spheres_see_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        work.image.spp = 1;
        let expected = fingerprint(&render(&work, 2));
        work.run.accel = AccelKind::Spheres;
        work.accel = Accel::build(AccelKind::Spheres, BuildSettings::default(), &work.scene.surfaces);
        assert_eq!(fingerprint(&render(&work, 2)), expected, "{}", name(&scene));
    }
}

#[test]
fn threads_over_triangles_see_the_same() {
    for scene in scenes() {
        let mut work = small_work(&scene, AccelKind::Bvh);
        work.image.spp = 1;
        let expected = fingerprint(&render(&work, 2));
        let is_large = work.scene.surfaces.len() > 20_000;
        work.run.within = Within::Triangles;
        for (accel, threads) in
            [(AccelKind::Bvh, 3), (AccelKind::Grid, 2), (AccelKind::Spheres, 3), (AccelKind::Brute, 2)]
        {
            if !(is_large && accel == AccelKind::Brute) {
                work.run.accel = accel;
                work.accel = Accel::empty(accel);
                assert_eq!(fingerprint(&render(&work, threads)), expected, "{} {accel:?}", name(&scene));
            }
        }
    }
}

/// What one rank does; rank 0 gives the work and gets the image.
fn render_rank(comm: &dyn Comm, work: &Work) -> Option<Image> {
    render_as(comm, if comm.rank() == 0 { work.clone() } else { Work::default() }, 2)
}

#[test]
fn ranks_get_spheres_and_divide_them_by_themselves() {
    let mut work = small_work(&repository().join("scenes/shading.toml"), AccelKind::Bvh);
    let expected = fingerprint(&render(&work, 2));
    for (accel, within) in [
        (AccelKind::Spheres, Within::Rays),
        (AccelKind::Spheres, Within::Triangles),
        (AccelKind::Bvh, Within::Triangles),
    ] {
        (work.run.accel, work.run.within) = (accel, within);
        work.accel = match within {
            Within::Rays => Accel::build(accel, BuildSettings::default(), &work.scene.surfaces),
            Within::Triangles => Accel::empty(accel),
        };
        let image = std::thread::scope(|scope| {
            let work = &work;
            let ranks =
                memory::group(3).into_iter().map(|comm| scope.spawn(move || render_rank(&comm, work)));
            let ranks: Vec<_> = ranks.collect();
            ranks.into_iter().filter_map(|rank| rank.join().unwrap()).next().expect("rank 0 gets the image")
        });
        assert_eq!(fingerprint(&image), expected, "{accel:?} {within:?}");
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
