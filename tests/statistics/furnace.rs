//! White furnaces: what gives back all light can't be seen in even light.

use heliostat::settings::{Direct, SamplerKind};

use super::judge::{Estimate, LIMIT};
use super::stage::{Stage, mean, picture};
use super::text::Text;

const ALL: [Direct; 3] = [Direct::Both, Direct::Light, Direct::Bsdf];

/// Of everything that comes in all goes out.
fn materials(text: Text) -> Text {
    text.material("matt", "kd = 1")
        .material("mirror", "kd = 0\nkr = 1")
        .material("glass", "kd = 0\nkt = 1\nfresnel = true")
}

/// Balls of all three kinds that shine on each other and on a matt block.
fn several(render: &str) -> Text {
    let empty = Text::perspective([0.0, 0.8, 6.0], [0.0, 0.2, 0.0], 32.0);
    materials(empty.image(32, 16, &format!("max_depth = 100000\n{render}")))
        .sphere([-1.05, 0.5, 0.0], 0.5, "matt")
        .sphere([0.0, 0.5, 0.0], 0.5, "mirror")
        .sphere([1.05, 0.5, 0.0], 0.5, "glass")
        .object("box", "matt", "size = [3.4, 0.4, 1.6]\ntranslate = [0, -0.25, 0]")
}

/// A ball that fills the image.
fn single(material: &str, render: &str) -> Text {
    let empty = Text::perspective([0.0, 0.0, 4.0], [0.0; 3], 14.0);
    materials(empty.image(16, 1024, &format!("max_depth = 100000\n{render}"))).sphere([0.0; 3], 1.0, material)
}

/// Without roulette each sample by itself is 1, however long its path.
#[test]
fn nothing_is_lost_on_any_path() {
    let mut stage = Stage::new(several("background = 1"), &[]);
    stage.image.roulette = u32::MAX;
    for direct in ALL {
        stage.image.direct = direct;
        for pixel in &stage.render().pixels {
            assert!(pixel.iter().all(|c| (c - 1.0).abs() < 1e-6), "{direct:?}: {pixel:?}");
        }
    }
}

#[test]
fn roulette_loses_nothing() {
    for material in ["matt", "mirror", "glass"] {
        let stage = Stage::new(single(material, "background = 1"), &[]);
        let found = mean(&stage.render());
        println!("{material}: {found}");
        assert!((found - 1.0).abs() < 1e-4, "{material}: {found}");
    }
    let mut stage = Stage::new(several("background = 1"), &[]);
    for sampler in [SamplerKind::Independent, SamplerKind::Sobol] {
        stage.image.sampler = sampler;
        for roulette in [4, 1] {
            stage.image.roulette = roulette;
            let found = Estimate::of(stage.seeds(12).iter().map(mean).collect::<Vec<_>>().into_iter());
            let z = found.z(&Estimate::exact(1.0));
            println!(
                "{sampler:?}, roulette after {roulette}: {} ± {}, z = {z:.2}",
                found.mean,
                found.error()
            );
            assert!(z.abs() < LIMIT && found.error() < 1e-3, "{sampler:?} {roulette}: {found:?}");
        }
    }
}

/// The same light as an image, which is then asked as lights are.
#[test]
fn an_image_of_ones_is_as_good_as_a_background() {
    let ones = || [("ones.exr", picture(8, 4, |_, _| [1.0; 3]))];
    for material in ["matt", "mirror", "glass"] {
        let mut stage = Stage::new(single(material, "environment = \"ones.exr\""), &ones());
        for direct in ALL {
            stage.image.direct = direct;
            let found = mean(&stage.render());
            println!("{material}, {direct:?}: {found}");
            assert!((found - 1.0).abs() < 1e-4, "{material}, {direct:?}: {found}");
        }
    }
    let mut stage = Stage::new(several("environment = \"ones.exr\"\nenvironment_rotation = 77"), &ones());
    for direct in ALL {
        stage.image.direct = direct;
        let found = Estimate::of(stage.seeds(12).iter().map(mean).collect::<Vec<_>>().into_iter());
        let z = found.z(&Estimate::exact(1.0));
        println!("{direct:?}: {} ± {}, z = {z:.2}", found.mean, found.error());
        assert!(z.abs() < LIMIT && found.error() < 2e-3, "{direct:?}: {found:?}");
    }
}

/// A closed box whose walls shine and reflect: emission / (1 - albedo) everywhere.
#[test]
fn a_closed_box_that_glows() {
    let text = Text::perspective([0.2, 0.1, 0.3], [-1.0, -0.4, -0.7], 80.0)
        .image(16, 64, "")
        .material("wall", "kd = [0.8, 0.5, 0.2]\nemission = [0.2, 0.5, 0.8]")
        .object("box", "wall", "size = [2, 2, 2]");
    let mut stage = Stage::new(text, &[]);
    // Where nothing is left to chance but directions, the sum over bounces is one of powers.
    (stage.image.direct, stage.image.roulette) = (Direct::Bsdf, u32::MAX);
    stage.image.max_depth = 100;
    stage.image.spp = 4;
    for pixel in &stage.render().pixels {
        assert!(pixel.iter().all(|c| (c - 1.0).abs() < 1e-6), "{pixel:?}");
    }
    (stage.image.roulette, stage.image.max_depth, stage.image.spp) = (4, 1000, 64);
    for direct in ALL {
        stage.image.direct = direct;
        let found = Estimate::of(stage.seeds(8).iter().map(mean).collect::<Vec<_>>().into_iter());
        let z = found.z(&Estimate::exact(1.0));
        println!("{direct:?}: {} ± {}, z = {z:.2}", found.mean, found.error());
        // Many a point chosen on a wall is too near.
        let most = if direct == Direct::Light { 1e-2 } else { 2e-3 };
        assert!(z.abs() < LIMIT && found.error() < most, "{direct:?}: {found:?}");
    }
}
