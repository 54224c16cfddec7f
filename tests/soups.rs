//! Soups of hostile triangles: every structure answers as brute force does and as exact arithmetic says, "occluded" fits "closest",
//! and a ray turned round sees the same surfaces.

use glam::DVec3;
use heliostat::accel::Accel;
use heliostat::geometry::{NONE, Ray};
use heliostat::lab::meshes::Body;
use heliostat::lab::stress::{self, Plan, Subject};
use heliostat::scene::Surfaces;
use heliostat::settings::{AccelKind, BuildPreset};
use proptest::prelude::*;

const ACCELS: [AccelKind; 4] = [AccelKind::Bvh, AccelKind::Grid, AccelKind::Spheres, AccelKind::Brute];

/// Lattice points make edges, vertices and planes coincide; the others make slivers, specks and plain triangles.
fn vertex() -> impl Strategy<Value = [f32; 3]> {
    let coordinate = || {
        prop_oneof![
            4 => (-4i8..=4).prop_map(|c| f32::from(c) / 4.0),
            2 => -1.0f32..1.0,
            1 => (-4i8..=4).prop_map(|c| (f32::from(c) / 4.0).next_up()),
        ]
    };
    prop::array::uniform3(coordinate())
}

fn soup() -> impl Strategy<Value = Body> {
    let scale = prop_oneof![3 => Just(1.0f32), 1 => Just(1e-12), 1 => Just(1e12)];
    let offset = prop_oneof![3 => Just(0.0f32), 1 => Just(1e4), 1 => Just(-1e7)];
    // Vertices are shared, so that there are edges and fans.
    let corner = 0..24u32;
    (
        prop::collection::vec(vertex(), 24),
        prop::collection::vec(prop::array::uniform3(corner), 1..60),
        scale,
        offset,
    )
        .prop_map(|(positions, triangles, scale, offset)| Body {
            positions: positions
                .into_iter()
                .map(|[x, y, z]| [x * scale + offset, y * scale, z * scale - offset])
                .collect(),
            triangles,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn closest_is_what_brute_force_and_exact_arithmetic_say(body in soup(), seed in any::<u64>()) {
        let subject = Subject { shape: "soup".into(), place: String::new(), body };
        let build = if seed % 2 == 0 { BuildPreset::Balanced } else { BuildPreset::Best };
        let plan = Plan { rays: 88, seed, accels: ACCELS.to_vec(), build };
        let tally = stress::run(&subject, 0, plan.rays, &plan, 0, 1, |_| ()).expect("it has triangles");
        prop_assert_eq!(tally.wrong(), 0, "ray {:?}: {} leaks, {} misses, {} skipped, {} false, {} self, {} differ", tally.first_wrong, tally.leaks, tally.misses, tally.skipped, tally.false_hits, tally.self_hits, tally.differ);
    }

    #[test]
    fn a_ray_turned_round_sees_the_same_surfaces(
        triangles in prop::collection::vec(prop::array::uniform3(vertex()), 1..60),
        ends in prop::array::uniform2(prop::array::uniform3((-16i8..=16).prop_map(|c| f64::from(c) / 8.0))),
        aside in prop_oneof![Just(0.0), -0.01f64..0.01],
    ) {
        let surfaces = Surfaces {
            positions: triangles.concat().into(),
            triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            objects: (0..triangles.len() as u32).step_by(7).collect(),
            ..Surfaces::default()
        };
        let [a, b] = ends.map(|end| DVec3::from(end) * 4.0 + aside);
        prop_assume!(a != b);
        let whole = ACCELS.map(|kind| Accel::build(kind, BuildPreset::Best, &surfaces));
        let divided = ACCELS.map(|kind| Accel::divide(kind, BuildPreset::Balanced, &surfaces, 3));
        let expected = passed(&Accel::Brute, &surfaces, a, b);
        for accel in whole.into_iter().chain(divided) {
            let mut there = passed(&accel, &surfaces, a, b);
            let mut back = passed(&accel, &surfaces, b, a);
            prop_assert_eq!(&there, &expected);
            there.sort_unstable();
            back.sort_unstable();
            prop_assert_eq!(there, back);
        }
    }
}

/// All triangles between two points in the order in which they are met.
fn passed(accel: &Accel, surfaces: &Surfaces, from: DVec3, to: DVec3) -> Vec<u32> {
    let mut ray =
        Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 1.0, first_id: 0, start: NONE };
    let mut all = Vec::new();
    loop {
        let answer = accel.closest(surfaces, &ray);
        assert_eq!(accel.occluded(surfaces, &ray), answer.is_hit());
        if !answer.is_hit() {
            return all;
        }
        all.push(answer.primitive);
        (ray.t_min, ray.first_id) = (answer.t, answer.primitive + 1);
    }
}
