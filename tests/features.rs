//! What is written beside the image: the same however it is run, and what the scene says.

mod common;

use common::{render, rendered_as, rendered_on, repository, small_work};
use glam::DVec3;
use heliostat::cluster::Solo;
use heliostat::job::Work;
use heliostat::settings::{AccelKind, Crop, Split};

fn work(scene: &str) -> Work {
    let mut work = small_work(&repository().join("scenes").join(scene), AccelKind::Bvh);
    work.image.features = true;
    work
}

#[test]
fn features_are_the_same_for_all_splits_and_don_t_change_the_image() {
    for scene in ["cornell-path.toml", "textured.toml", "glass.toml"] {
        let mut work = work(scene);
        let expected = rendered_as(&Solo::new(), work.clone(), 2).unwrap();
        for split in [Split::Tiles, Split::Stream, Split::Voxels, Split::Triangles] {
            work.run.split = split;
            let found = rendered_on(3, &work);
            assert_eq!(found.image, expected.image, "{scene}, {split:?}");
            assert!(found.features == expected.features, "{scene}, {split:?}");
        }
        work.run.split = Split::Tiles;
        work.image.features = false;
        assert_eq!(render(&work, 1), expected.image, "{scene}");
    }
}

#[test]
fn features_are_those_of_the_surfaces() {
    let mut work = work("cornell-path.toml");
    (work.image.spp, work.image.width, work.image.height) = (1, 40, 30);
    work.image.crop = Crop { x0: 0, y0: 0, x1: 40, y1: 30 };
    let features = rendered_as(&Solo::new(), work.clone(), 2).unwrap().features.unwrap();
    let header = &work.scene.header;
    let mut hits = 0;
    for (pixel, &id) in features.id.iter().enumerate() {
        let (x, y) = (pixel as u32 % 40, pixel as u32 / 40);
        let (origin, direction) =
            header.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5, 40.0, 30.0, [0.5; 2]);
        if id == 0 {
            assert_eq!((features.depth[pixel], features.normal[pixel]), (f32::INFINITY, [0.0; 3]));
            continue;
        }
        hits += 1;
        let [normal, position] =
            [&features.normal, &features.position].map(|v| DVec3::from(v[pixel].map(f64::from)));
        assert!((normal.length() - 1.0).abs() < 1e-6 && normal.dot(direction) < 0.0);
        let along = header.frame.to_world(origin) + direction * f64::from(features.depth[pixel]);
        assert!((position - along).length() < 1e-3, "{position} {along}");
        let material = &header.materials[work.scene.part(id - 1).material as usize];
        for k in 0..3 {
            assert!((f64::from(features.albedo[pixel][k]) - material.kd[k]).abs() < 1e-6);
        }
    }
    assert!((600..1200).contains(&hits), "{hits}");
}
