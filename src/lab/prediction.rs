//! What each rank will hold of a divided scene, before anyone asks for nodes.

use crate::accel::{Accel, wide};
use crate::render::division;
use crate::scene::Scene;
use crate::settings::{AccelKind, BuildPreset, ImageSettings, Split};

/// What one rank will hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RankMemory {
    pub primitives: u64,
    /// Of the arrays of its part, in proportion to those of the whole.
    pub scene_bytes: u64,
    /// Of the hierarchy over its part.
    pub bvh_bytes: u64,
    /// While the hierarchy is built, about: the most that the rank will need at once.
    pub peak_bytes: u64,
}

/// Foretells what each of `ranks` will hold by this split of a scene seen as `image` says, with `replicate_hot` bytes for copies of hot blocks. Counts primitives exactly;
/// bytes are estimates. On the current rayon pool.
pub fn predict(
    scene: &Scene,
    image: &ImageSettings,
    split: Split,
    ranks: usize,
    replicate_hot: Option<u64>,
) -> Vec<RankMemory> {
    let all = scene.surfaces.len() as u64;
    let counts = match split {
        Split::Tiles | Split::Stream => vec![all; ranks],
        Split::Triangles => {
            let end = |rank: usize| all * rank as u64 / ranks as u64;
            (0..ranks).map(|rank| end(rank + 1) - end(rank)).collect()
        }
        Split::Voxels => {
            let copies = replicate_hot.map_or(0, |bytes| division::copies(scene, AccelKind::Bvh, bytes));
            division::divide(scene, image, ranks, copies).counts(&scene.surfaces, ranks)
        }
    };
    let of_scene = scene.memory() as u64 / all.max(1);
    let of_bvh = Accel::bytes_each(AccelKind::Bvh, &scene.surfaces);
    let memory = |primitives: u64| {
        let (scene_bytes, bvh_bytes) = (primitives * of_scene, primitives * of_bvh);
        let peak_bytes = scene_bytes + primitives * wide::bytes_to_build(BuildPreset::Balanced);
        RankMemory { primitives, scene_bytes, bvh_bytes, peak_bytes }
    };
    counts.into_iter().map(memory).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::accel::partition::{along_curve, run_of};
    use crate::scene::load;
    use crate::settings::BuildSettings;

    #[test]
    fn counts_are_what_ranks_get_and_bytes_are_near() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/teapot.toml");
        let scene = load::load(&path).unwrap().scene;
        let (image, ranks) = (ImageSettings::sized(64, 64), 3);
        let equal = predict(&scene, &image, Split::Triangles, ranks, None);
        let along = along_curve(&scene.surfaces);
        let parts: Vec<u64> = (0..ranks).map(|rank| run_of(&along, ranks, rank).len() as u64).collect();
        assert!(equal.iter().zip(&parts).all(|(told, &part)| told.primitives.abs_diff(part) <= 100));
        let budget = 500_000;
        let copies = division::copies(&scene, AccelKind::Bvh, budget);
        let held = [None, Some(budget)].map(|replicate_hot| {
            let voxels = division::divide(&scene, &image, ranks, replicate_hot.map_or(0, |_| copies));
            let foretold = predict(&scene, &image, Split::Voxels, ranks, replicate_hot);
            for (rank, told) in foretold.iter().enumerate() {
                let ids = voxels.part(&scene.surfaces, rank);
                assert_eq!(told.primitives, ids.len() as u64);
                let part = scene.subset(&ids);
                let accel = Accel::build(AccelKind::Bvh, BuildSettings::default(), &part.surfaces);
                let near = |told: u64, found: usize| (0.5..2.0).contains(&(told as f64 / found as f64));
                assert!(near(told.scene_bytes, part.memory()), "{told:?}, {}", part.memory());
                assert!(near(told.bvh_bytes, accel.memory()), "{told:?}, {}", accel.memory());
                let bytes = (part.memory() + accel.memory()) as u64;
                let replicated = voxels.copies(&part.surfaces, rank) * bytes / ids.len() as u64;
                assert!(replicated <= replicate_hot.unwrap_or(0), "rank {rank}: {replicated}");
            }
            foretold.iter().map(|told| told.primitives).sum::<u64>()
        });
        assert!(held[1] > held[0], "{held:?}");
    }
}
