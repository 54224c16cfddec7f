//! Light that a formula knows: under a lamp of every kind, in the open and between surfaces that light each other.

use glam::DVec3;
use heliostat::settings::Direct;

use super::geometry::{disc, factor, obj};
use super::judge::{Evidence, Verdict};
use super::stage::Stage;
use super::text::Text;

const ALL: [Direct; 3] = [Direct::Both, Direct::Light, Direct::Bsdf];
const SIZE: u32 = 16;
/// Edge of the square of floor that is seen.
const SEEN: f64 = 4.0;
const KD: f64 = 0.6;

/// A floor seen from below the lamp.
fn floor() -> Text {
    Text::from_above(0.5, SEEN)
        .image(SIZE, 16, "")
        .material("matt", &format!("kd = {KD}"))
        .material("lamp", "kd = 0\nemission = 3")
        .plane(100, "matt", "")
}

/// What is seen where so much of a sky of radiance 1 would arrive at a point of the floor. The formula is averaged over each pixel.
fn expected(share: impl Fn(DVec3) -> f64) -> Evidence {
    const FINE: u32 = 8;
    let step = SEEN / f64::from(SIZE * FINE);
    let place = |i: u32, k: u32| (f64::from(i * FINE + k) + 0.5) * step - 0.5 * SEEN;
    let pixel = |x: u32, y: u32| {
        let places = (0..FINE * FINE).map(|k| DVec3::new(place(x, k % FINE), 0.0, place(y, k / FINE)));
        places.map(&share).sum::<f64>() / f64::from(FINE * FINE) * KD * 3.0
    };
    let pixels: Vec<f64> = (0..SIZE * SIZE).map(|i| pixel(i % SIZE, i / SIZE)).collect();
    Evidence::exact(&pixels)
}

/// All three ways to find a lamp.
fn judge(what: &str, mut stage: Stage, expected: &Evidence, most_error: f64) {
    for direct in ALL {
        stage.image.direct = direct;
        // Bounces that happen to find the lamp are rare.
        stage.image.spp = if direct == Direct::Bsdf { 256 } else { 16 };
        let verdict = Verdict::of(&Evidence::of(&stage.seeds(16)), expected);
        verdict.pass(&format!("{what}, {direct:?}"));
        assert!(verdict.off_error < most_error, "{what}, {direct:?}: too noisy to judge, {verdict}");
    }
}

/// π L sin²θ cos: as if all of a sphere's light came from its centre.
#[test]
fn under_a_sphere() {
    let (height, radius) = (1.5, 0.5);
    let share = |at: DVec3| {
        let squared = at.length_squared() + height * height;
        radius * radius / squared * (height / squared.sqrt())
    };
    let text = floor().sphere([0.0, height, 0.0], radius, "lamp");
    judge("sphere", Stage::new(text, &[]), &expected(share), 4e-3);
}

/// A level disc: (1 - (1 + H² - R²) / sqrt((1 + H² + R²)² - 4 R²)) / 2 with height and radius in units of the distance from the foot of its axis
/// (Howell's catalogue of configuration factors, B-13).
#[test]
fn under_a_disc_of_254_triangles() {
    let (height, radius) = (1.2, 0.8);
    let text = floor().mesh("disc.obj", "lamp", "shading = \"flat\"");
    let share = |at: DVec3| {
        let away = at.length().max(1e-9);
        let (h, r) = (height / away, radius / away);
        let z = 1.0 + h * h + r * r;
        0.5 * (1.0 - (z - 2.0 * r * r) / (z * z - 4.0 * r * r).sqrt())
    };
    let files = [("disc.obj", obj(&disc(radius, height, 256)))];
    judge("disc", Stage::new(text, &files), &expected(share), 4e-3);
}

#[test]
fn under_a_triangle_askew() {
    let corners = [DVec3::new(-0.7, 1.2, -0.4), DVec3::new(0.9, 0.9, 0.1), DVec3::new(-0.1, 1.7, 0.8)];
    let text = floor().mesh("triangle.obj", "lamp", "");
    let files = [("triangle.obj", obj(&corners))];
    let share = |at: DVec3| factor(at, DVec3::Y, &corners);
    judge("triangle", Stage::new(text, &files), &expected(share), 8e-3);
}

/// A matt convex body under an even sky shows albedo times the sky.
#[test]
fn a_ball_under_an_even_sky() {
    let text = Text::perspective([0.0, 0.0, 4.0], [0.0; 3], 14.0)
        .image(16, 16, "environment = \"sky.exr\"")
        .material("matt", "kd = 0.37")
        .sphere([0.0; 3], 1.0, "matt");
    let mut stage = Stage::new(text, &[("sky.exr", super::stage::picture(16, 8, |_, _| [2.0; 3]))]);
    let expected = Evidence::exact(&[0.74; 256]);
    for direct in ALL {
        stage.image.direct = direct;
        Verdict::of(&Evidence::of(&stage.seeds(16)), &expected).pass(&format!("even sky, {direct:?}"));
    }
}

/// A ball in a hollow ball, both of which shine and reflect. Each is lit evenly, so two equations say all: the outer one sees the inner one by the ratio of
/// their areas, and itself by the rest.
#[test]
fn a_ball_within_a_ball() {
    let (inner, outer, ratio) = ([0.5, 0.7], [0.6, 0.4], 0.25);
    let glowing = |[kd, emission]: [f64; 2]| format!("kd = {kd}\nemission = {emission}");
    let text = Text::perspective([0.0, 0.2, 1.9], [0.0; 3], 90.0)
        .image(16, 16, "")
        .material("inner", &glowing(inner))
        .material("outer", &glowing(outer))
        .sphere([0.0; 3], 1.0, "inner")
        .sphere([0.0; 3], 2.0, "outer");
    // a = E_a + ρ_a b, b = E_b + ρ_b (r a + (1 - r) b).
    let b = (outer[1] + outer[0] * ratio * inner[1])
        / (1.0 - outer[0] * (1.0 - ratio) - outer[0] * ratio * inner[0]);
    let a = inner[1] + inner[0] * b;
    // Which of both a pixel sees where it sees one only.
    let eye = DVec3::new(0.0, 0.2, 1.9);
    let forward = -eye.normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let up = right.cross(forward);
    let mut stage = Stage::new(text, &[]);
    let all = |x: u32, y: u32, inside: bool| {
        (0..=4u32).all(|i| {
            (0..=4).all(|j| {
                let [x, y] = [f64::from(x) + f64::from(i) / 4.0, f64::from(y) + f64::from(j) / 4.0];
                let direction = (forward + right * (x / 8.0 - 1.0) - up * (y / 8.0 - 1.0)).normalize();
                let near = eye.length_squared() - eye.dot(direction) * eye.dot(direction) < 1.0;
                near == inside
            })
        })
    };
    for direct in ALL {
        stage.image.direct = direct;
        let found = Evidence::of(&stage.seeds(12));
        for (inside, radiance) in [(true, a), (false, b)] {
            let chosen: Vec<_> = (0..256).filter(|&i| all(i % 16, i / 16, inside)).collect();
            assert!(chosen.len() > 20, "{inside}: {} pixels", chosen.len());
            let count = chosen.len() as f64;
            let estimates = chosen.iter().map(|&i| found.pixels[i as usize]);
            let mean = estimates.clone().map(|e| e.mean).sum::<f64>() / count;
            // Pixels are independent of each other.
            let error = estimates.map(|e| e.error2).sum::<f64>().sqrt() / count;
            let z = (mean - radiance) / error;
            println!("{direct:?} {inside}: {mean} ± {error}, formula {radiance}, z = {z:.2}");
            assert!(z.abs() < super::judge::LIMIT, "{direct:?} {inside}: {mean} ± {error}, not {radiance}");
            assert!(error < 3e-3 * radiance);
        }
    }
}
