//! Mirror and refracted rays: their weights, their directions, and where they end.

use glam::DVec3;
use heliostat::scene::{Color, Material, Shading, load};

use crate::tiny::*;

const ROOF: Color = [0.5, 1.5, 0.25];
const CELLAR: Color = [0.75, 0.125, 1.0];

/// A surface at y = 0 seen along `eye` to the origin, between a glowing roof and a glowing cellar.
fn between_glows(eye: DVec3, material: &Material) -> Tiny {
    let mut tiny = Tiny::new(eye, DVec3::ZERO);
    tiny.level(0.0, material);
    tiny.patch([0.0, 10.0, 0.0], 100.0, &glowing(ROOF));
    tiny.patch([0.0, -10.0, 0.0], 100.0, &glowing(CELLAR));
    tiny
}

/// Snell's law by angles: the direction behind a surface with normal `n` towards the ray.
fn bend(direction: DVec3, n: DVec3, ratio: f64) -> DVec3 {
    let along = direction - direction.dot(n) * n;
    let sine = ratio * along.length();
    assert!(sine < 1.0);
    along.normalize() * sine - n * (1.0 - sine * sine).sqrt()
}

/// Where the ray from `from` meets height `y`, as (x, z).
fn at_height(from: DVec3, direction: DVec3, y: f64) -> [f64; 2] {
    let hit = from + direction * ((y - from.y) / direction.y);
    [hit.x, hit.z]
}

#[test]
fn reflectivity_blends_and_kr_and_kt_add() {
    let (eye, lamp) = (v(1.0, 2.0, 1.5), v(-1.0, 4.0, 0.5));
    let light = point_light(lamp);
    let local = Material { ka: [0.2; 3], kd: [0.5; 3], ks: [0.4; 3], emission: [0.1, 0.0, 0.2], ..BLACK };
    let lit = Around::new(DVec3::ZERO, DVec3::Y, lamp, eye).phong(&local, &light);
    let lit = sum(lit, sum([0.2 * 0.5; 3], local.emission));
    let seen = |material: &Material| {
        let mut tiny = between_glows(eye, material);
        tiny.header.ambient = [0.5; 3];
        tiny.light(&light);
        tiny.color()
    };
    for r in [0.0, 0.25, 1.0] {
        let blended = sum(scaled(lit, 1.0 - r), scaled(ROOF, r));
        assert_color(seen(&Material { reflectivity: r, ..local.clone() }), blended);
    }
    let (kr, kt) = ([0.3, 0.0, 0.9], [0.5, 0.25, 2.0]);
    assert_color(seen(&Material { kr, ..local.clone() }), sum(lit, product(kr, ROOF)));
    assert_color(seen(&Material { kt, ..local.clone() }), sum(lit, product(kt, CELLAR)));
    let both = sum(product(kr, ROOF), product(kt, CELLAR));
    assert_color(seen(&Material { kr, kt, ..local }), sum(lit, both));
}

#[test]
fn what_leaves_the_scene_sees_the_background() {
    let mut tiny = Tiny::new(v(1.0, 2.0, 1.5), DVec3::ZERO);
    tiny.level(0.0, &Material { kr: [0.25, 0.5, 1.0], kt: [0.5; 3], ..BLACK });
    tiny.header.background = [0.5, 0.25, 1.0];
    assert_color(tiny.color(), [0.75 * 0.5, 0.25, 1.5]);
}

#[test]
fn reflectivity_is_refused_beside_kr_and_kt() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("both.toml");
    for key in ["kr", "kt"] {
        std::fs::write(&file, format!("[[material]]\nname = \"m\"\n{key} = 0.5\nreflectivity = 0.5\n"))
            .unwrap();
        let error = load::load(&file).expect_err("a contradiction").to_string();
        assert!(
            error.contains("both.toml:4") && error.contains("reflectivity") && error.contains(key),
            "{error}"
        );
    }
}

#[test]
fn mirrors_turn_about_the_shading_normal_unless_that_leads_inside() {
    let mirror = Material { kr: [1.0; 3], ..BLACK };
    let seen = |eye: DVec3, normal: DVec3| {
        let mut tiny = Tiny::new(eye, DVec3::ZERO);
        let mut mesh = quad(square(0.0, 1.0));
        mesh.normals = vec![normal.to_array().map(|c| c as f32); 4];
        tiny.mesh(mesh, &mirror, Shading::Phong);
        tiny.map(4.0);
        mapped(tiny.color())
    };
    let mirrored = |direction: DVec3, n: DVec3| direction - 2.0 * direction.dot(n) * n;
    let eye = v(1.0, 3.0, 0.5);
    for normal in [DVec3::Y, v(0.28, 0.96, 0.0), v(0.0, 0.96, -0.28)] {
        assert_place(seen(eye, normal), at_height(DVec3::ZERO, mirrored(-eye, normal), 4.0));
    }
    let (flat, normal) = (v(-3.0, 3.0, 0.0), v(0.8, 0.6, 0.0));
    assert!(mirrored(-flat, normal).y < 0.0);
    assert_place(seen(flat, normal), at_height(DVec3::ZERO, mirrored(-flat, DVec3::Y), 4.0));
}

#[test]
fn a_slab_shifts_and_keeps_the_direction() {
    for ior in [1.0, 1.33, 1.5, 2.4, 0.8] {
        let (eye, target) = (v(-2.0, 3.0, 1.0), v(0.25, 0.0, 0.125));
        let glass = Material { kt: [1.0; 3], ior, ..BLACK };
        let mut tiny = Tiny::new(eye, target);
        tiny.level(0.0, &glass);
        let mut bottom = square(-1.0, 20.0);
        bottom.reverse();
        tiny.quad(bottom, &glass);
        tiny.map(-3.0);
        let direction = (target - eye).normalize();
        let inside = bend(direction, DVec3::Y, 1.0 / ior);
        let [x, z] = at_height(target, inside, -1.0);
        assert_place(mapped(tiny.color()), at_height(v(x, -1.0, z), direction, -3.0));
    }
}

#[test]
fn a_sphere_bends_twice() {
    let (center, radius) = (v(0.25, 1.0, -0.125), 0.75);
    for ior in [1.0, 1.33, 1.5] {
        let out = v(-0.3, 0.9, 0.2).normalize();
        let (eye, entry) = (v(-1.0, 4.0, 0.5), center + out * radius);
        let mut tiny = Tiny::new(eye, entry);
        tiny.sphere(center, radius, &Material { kt: [1.0; 3], ior, ..BLACK });
        tiny.map(-2.0);
        let inside = bend((entry - eye).normalize(), out, 1.0 / ior);
        let exit = entry + inside * (2.0 * inside.dot(center - entry));
        let outside = bend(inside, (center - exit).normalize(), ior);
        assert_place(mapped(tiny.color()), at_height(exit, outside, -2.0));
    }
}

#[test]
fn refraction_follows_the_shading_normal_unless_that_faces_away() {
    let seen = |eye: DVec3, normal: DVec3, ior: f64| {
        let mut tiny = Tiny::new(eye, DVec3::ZERO);
        let mut mesh = quad(square(0.0, 1.0));
        mesh.normals = vec![normal.to_array().map(|c| c as f32); 4];
        tiny.mesh(mesh, &Material { kt: [1.0; 3], ior, ..BLACK }, Shading::Phong);
        tiny.map(-1.0);
        mapped(tiny.color())
    };
    let normal = v(0.6, 0.8, 0.0);
    let eye = v(1.0, 3.0, 0.5);
    let expected = at_height(DVec3::ZERO, bend(-eye.normalize(), normal, 1.0 / 1.5), -1.0);
    assert_place(seen(eye, normal, 1.5), expected);
    // At a silhouette the interpolated normal faces away from the viewer: nothing must turn back there.
    let eye = v(-4.0, 1.0, 0.5);
    assert!(eye.dot(normal) < 0.0);
    assert_place(seen(eye, normal, 1.0), at_height(DVec3::ZERO, -eye, -1.0));
    let expected = at_height(DVec3::ZERO, bend(-eye.normalize(), DVec3::Y, 1.0 / 1.5), -1.0);
    assert_place(seen(eye, normal, 1.5), expected);
}

#[test]
fn beyond_the_critical_angle_all_turns_back() {
    let critical = libm::asin(1.0 / 1.5);
    for off in [-0.3, -1e-3, -1e-9, 1e-9, 1e-3, 0.3] {
        let angle = critical + off;
        // From inside, below the surface.
        let eye = v(-libm::sin(angle), -libm::cos(angle), 0.0) * 2.0;
        let material = Material { kr: [0.25, 0.5, 0.0], kt: [0.5, 0.25, 1.0], ior: 1.5, ..BLACK };
        let expected = if off > 0.0 {
            product(sum(material.kr, material.kt), CELLAR)
        } else {
            sum(product(material.kr, CELLAR), product(material.kt, ROOF))
        };
        // Close below the critical angle the refracted ray leaves flat, and misses the roof.
        let mut tiny = between_glows(eye, &material);
        tiny.header.background = ROOF;
        assert_color(tiny.color(), expected);
        let fresnel = between_glows(eye, &Material { fresnel: true, ..material }).color();
        if off > 0.0 {
            assert_color(fresnel, expected);
        }
    }
    // The mirror direction.
    let mut tiny = Tiny::new(v(-2.0, -1.0, 0.5), v(0.0, 0.0, 0.5));
    tiny.level(0.0, &Material { kt: [1.0; 3], ..BLACK });
    tiny.map(-2.0);
    assert_place(mapped(tiny.color()), [4.0, 0.5]);
}

#[test]
fn fresnel_splits_kt() {
    for ior in [1.0, 1.1, 1.5, 2.4, 0.9] {
        let material = Material { kr: [0.0, 0.125, 0.0], kt: [1.0, 0.5, 0.25], ior, fresnel: true, ..BLACK };
        let split = |reflectance: f64, mirrored: Color, refracted: Color| {
            let back = sum(scaled(material.kt, reflectance), material.kr);
            sum(product(back, mirrored), product(scaled(material.kt, 1.0 - reflectance), refracted))
        };
        // Straight on, from either side: ((n - 1) / (n + 1))^2.
        let straight = libm::pow((ior - 1.0) / (ior + 1.0), 2.0);
        assert_color(between_glows(v(0.0, 3.0, 0.0), &material).color(), split(straight, ROOF, CELLAR));
        assert_color(between_glows(v(0.0, -3.0, 0.0), &material).color(), split(straight, CELLAR, ROOF));
        // Askew: the mean of sin²(i - t) / sin²(i + t) and tan²(i - t) / tan²(i + t).
        for degrees in [10.0, 35.0, 60.0f64] {
            let i = degrees.to_radians();
            let t = libm::asin(libm::sin(i) / ior);
            let ratio = |f: fn(f64) -> f64| libm::pow(f(i - t) / f(i + t), 2.0);
            let askew = 0.5 * (ratio(libm::sin) + ratio(libm::tan));
            let eye = v(libm::sin(i), libm::cos(i), 0.0) * 3.0;
            assert_color(between_glows(eye, &material).color(), split(askew, ROOF, CELLAR));
        }
    }
}

/// Two mirrors face to face, each glowing with `glow`, seen straight on from between.
fn hall(kr: Color, glow: f64, max_depth: u32, min_weight: f64) -> Color {
    let mirror = Material { kr, ..glowing([glow; 3]) };
    let mut tiny = Tiny::new(v(0.125, 1.0, 0.25), v(0.125, 0.0, 0.25));
    tiny.level(0.0, &mirror);
    tiny.level(2.0, &mirror);
    tiny.header.background = [100.0; 3];
    (tiny.image.max_depth, tiny.image.min_weight) = (max_depth, min_weight);
    tiny.color()
}

#[test]
fn max_depth_counts_bounces_and_nothing_comes_from_beyond() {
    let kr = [0.5, 0.9, 1.0];
    for depth in [0, 1, 2, 7, 100] {
        let expected = kr.map(|k| (0..=depth).map(|n| 0.125 * libm::pow(k, f64::from(n))).sum());
        assert_color(hall(kr, 0.125, depth, 0.0), expected);
    }
    // Refraction is a bounce too; the local light of the last surface still counts.
    for (depth, expected) in [(0, 0.25), (1, 0.25 + 0.5 * 0.25), (2, 0.25 + 0.5 * 0.25 + 0.25)] {
        let pane = Material { kt: [0.5; 3], ..glowing([0.25; 3]) };
        let mut tiny = Tiny::new(v(0.0, 3.0, 0.5), v(0.0, 1.0, 0.25));
        tiny.level(1.0, &pane);
        tiny.level(0.0, &pane);
        tiny.header.background = [1.0; 3];
        tiny.image.max_depth = depth;
        assert_color(tiny.color(), [expected; 3]);
    }
    // Nor does a blend give back to the surface what its mirror ray isn't allowed to see.
    let mut tiny = between_glows(v(1.0, 2.0, 0.0), &Material { reflectivity: 0.75, ..glowing([1.0; 3]) });
    tiny.image.max_depth = 0;
    assert_color(tiny.color(), [0.25; 3]);
}

#[test]
fn min_weight_ends_branches_that_are_weak_in_every_channel() {
    for (min_weight, kept) in [(0.0, 20), (0.125, 3), (0.126, 2), (0.5, 1), (0.51, 0)] {
        let kr = [0.5, 0.125, 0.0];
        let expected = kr.map(|k| (0..=kept).map(|n| libm::pow(k, f64::from(n))).sum());
        assert_color(hall(kr, 1.0, 20, min_weight), expected);
    }
}

#[test]
fn reflections_are_seen_from_the_mirror() {
    // A highlight in a mirror: V points to the mirror, not to the camera.
    let shiny = Material { kd: [0.25; 3], ks: [0.5; 3], shininess: 20.0, ..BLACK };
    let (eye, lamp) = (v(-2.0, 2.0, 0.0), v(3.5, 2.0, 0.0));
    let mut tiny = Tiny::new(eye, DVec3::ZERO);
    tiny.level(0.0, &Material { kr: [0.5; 3], ..BLACK });
    tiny.patch([3.0, 3.0, 0.0], 1.0, &shiny);
    let light = point_light(lamp);
    tiny.light(&light);
    let around = Around::new(v(3.0, 3.0, 0.0), DVec3::NEG_Y, lamp, DVec3::ZERO);
    let expected = scaled(around.phong(&shiny, &light), 0.5);
    assert!(expected[0] > 0.1, "{expected:?}");
    assert_color(tiny.color(), expected);
}
