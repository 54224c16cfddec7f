//! Every way to the same image has the same mean; and a way that hasn't is found out.

use std::sync::LazyLock;

use heliostat::settings::{Direct, SamplerKind};

use super::geometry::obj;
use super::judge::{Evidence, Verdict};
use super::stage::{Stage, picture};
use super::text::Text;

/// A bit of everything: matt, glossy, mirror and glass, a ball and a square that shine, a point light, and a sky.
fn mixed() -> Stage {
    let text = Text::perspective([0.0, 1.7, 4.6], [0.0, 0.75, 0.0], 42.0)
        .image(12, 64, "environment = \"sky.exr\"\nenvironment_rotation = 40")
        .material("floor", "kd = [0.55, 0.5, 0.4]")
        .material("glossy", "kd = [0.25, 0.2, 0.3]\nks = [0.5, 0.45, 0.4]\nshininess = 10")
        .material("mirror", "kd = 0.2\nkr = 0.6")
        .material("glass", "kd = 0\nkt = [0.95, 0.98, 0.96]\nfresnel = true")
        .material("lamp", "kd = 0.3\nemission = [2.5, 2.2, 1.8]")
        .material("panel", "kd = 0.4\nemission = [0.8, 1.2, 1.7]\nemission_side = \"front\"")
        .point_light([2.0, 3.0, 3.0], 0.12)
        .plane(9, "floor", "")
        .plane("[9, 5]", "floor", "rotate = [90, 0, 0]\ntranslate = [0, 2.5, -1.8]")
        .sphere([-1.15, 0.55, 0.0], 0.55, "glossy")
        .sphere([0.1, 0.45, -0.5], 0.45, "mirror")
        .sphere([1.1, 0.5, 0.3], 0.5, "glass")
        .sphere([1.1, 1.9, -0.8], 0.5, "lamp")
        .plane("[1.8, 1.8]", "panel", "rotate = [180, 0, 0]\ntranslate = [-0.8, 2.6, 0.4]");
    Stage::new(text, &[("sky.exr", sky())])
}

fn sky() -> Vec<u8> {
    picture(16, 8, |x, y| {
        let bright = if x == 3 && y == 2 { 3.0 } else { 0.0 };
        [0.25 + bright, 0.3 + 0.02 * x as f32 + bright, 0.5 - 0.05 * y as f32 + bright]
    })
}

/// What all others must agree with, from seeds of its own.
fn reference() -> &'static Evidence {
    static IMAGES: LazyLock<Evidence> = LazyLock::new(|| {
        let mut stage = mixed();
        stage.image.seed = 1 << 32;
        Evidence::of(&stage.seeds(64))
    });
    &IMAGES
}

#[test]
fn all_estimators_agree() {
    let reference = reference();
    for direct in [Direct::Light, Direct::Bsdf] {
        let mut stage = mixed();
        stage.image.direct = direct;
        Verdict::of(&Evidence::of(&stage.seeds(16)), reference).pass(&format!("{direct:?}"));
    }
    for sampler in [SamplerKind::Independent, SamplerKind::Stratified, SamplerKind::Blue] {
        let mut stage = mixed();
        stage.image.sampler = sampler;
        Verdict::of(&Evidence::of(&stage.seeds(16)), reference).pass(&format!("{sampler:?}"));
    }
    for roulette in [0, 1, u32::MAX] {
        let mut stage = mixed();
        stage.image.roulette = roulette;
        // No path of this scene gets near it with a weight that counts.
        stage.image.max_depth = if roulette == u32::MAX { 60 } else { 1000 };
        Verdict::of(&Evidence::of(&stage.seeds(16)), reference).pass(&format!("roulette after {roulette}"));
    }
}

/// Spheres are sampled by solid angle, triangles by area, and one of very many lights otherwise than one of few.
#[test]
fn a_ball_shines_as_its_triangles_do() {
    let text = |kind: &str, ball: &str| {
        Text::from_above(0.5, 5.0)
            .image(16, 16, "")
            .material("floor", "kd = 0.6")
            .material("lamp", "kd = 0\nemission = 4")
            .plane(50, "floor", "")
            .object(kind, "lamp", &format!("center = [0, 1.4, 0]\n{ball}"))
    };
    // In stored units, which are the same in both scenes.
    let area =
        |stage: &Stage| stage.scene().header.emitters.iter().map(|emitter| emitter.area()).sum::<f64>();
    let mut sphere = Stage::new(text("sphere", "radius = 0.5"), &[]);
    let rough = Stage::new(text("icosphere", "level = 4\nradius = 0.5\nshading = \"flat\""), &[]);
    // By Cauchy's theorem a convex body of the same area looks as large from all around.
    let radius = 0.5 * (area(&sphere) / area(&rough)).sqrt();
    assert!((1.0..1.01).contains(&(radius / 0.5)), "{radius}");
    let ball = format!("level = 4\nradius = {radius}\nshading = \"flat\"");
    let mut icosphere = Stage::new(text("icosphere", &ball), &[]);
    let expected = Evidence::of(&sphere.seeds(16));
    for direct in [Direct::Both, Direct::Light] {
        icosphere.image.direct = direct;
        icosphere.image.spp = 64;
        let verdict = Verdict::of(&Evidence::of(&icosphere.seeds(16)), &expected);
        verdict.pass(&format!("icosphere, {direct:?}"));
    }
}

/// The same judges, given what isn't right.
#[test]
fn an_error_of_half_a_percent_is_found() {
    let reference = reference();
    let right = Evidence::of(&mixed().seeds(64));
    Verdict::of(&right, reference).pass("as it should be");

    let verdict = Verdict::of(&right.scaled(|_| 1.005), reference);
    println!("0.5 % too bright: {verdict}");
    assert!(!verdict.whole_is_right(), "{verdict}");
    let verdict = Verdict::of(&right.scaled(|_| 0.995), reference);
    println!("0.5 % too dark: {verdict}");
    assert!(!verdict.whole_is_right(), "{verdict}");

    // An error in one place, which the mean doesn't show.
    let verdict = Verdict::of(&right.scaled(|pixel| if pixel == 77 { 1.2 } else { 1.0 }), reference);
    println!("one pixel: {verdict}");
    assert!(verdict.whole_is_right() && !verdict.pixels_are_right(), "{verdict}");
}

/// The estimator's own mistake: points chosen on lamps are worth half a percent more than the same light found by a bounce.
#[test]
fn an_estimator_that_is_half_a_percent_off_is_found() {
    let corners = [[-2.0, 1.5, -2.0], [2.0, 1.5, -2.0], [2.0, 1.5, 2.0], [-2.0, 1.5, 2.0]];
    let text = Text::from_above(0.5, 2.0)
        .image(16, 16, "")
        .material("floor", "kd = 0.5")
        .material("lamp", "kd = 0.5\nemission = 1")
        .plane(4, "floor", "")
        .mesh("lamp.obj", "lamp", "");
    let files = || [("lamp.obj", obj(&corners.map(Into::into)))];
    let mut right = Stage::new(&text, &files());
    right.image.seed = 1 << 32;
    right.image.direct = Direct::Bsdf;
    right.image.spp = 64;
    let reference = Evidence::of(&right.seeds(32));
    for direct in [Direct::Both, Direct::Light] {
        for factor in [1.0, 1.005] {
            let mut stage = Stage::new(&text, &files());
            (stage.image.direct, stage.image.spp) = (direct, 64);
            // What points on lamps are worth; the materials, which bounces find, stay.
            stage.meddle(|scene| {
                for emitter in &mut scene.header.emitters {
                    emitter.radiance = emitter.radiance.map(|c| c * factor);
                }
            });
            let verdict = Verdict::of(&Evidence::of(&stage.seeds(24)), &reference);
            println!("{direct:?} × {factor}: {verdict}");
            if factor == 1.0 {
                verdict.pass(&format!("{direct:?}"));
            } else {
                assert!(!verdict.whole_is_right(), "{verdict}");
            }
        }
    }
}
