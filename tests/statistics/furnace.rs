//! White furnaces: what gives back all light can't be seen in even light.

use heliostat::settings::{Direct, SamplerKind};

use super::judge::{Estimate, LIMIT};
use super::stage::{Stage, mean, picture};

const ALL: [Direct; 3] = [Direct::Both, Direct::Light, Direct::Bsdf];

const CAMERA: &str = "
[camera]
position = [0, 0.8, 6]
look_at = [0, 0.2, 0]
fov = 32
";

const MATERIALS: &str = "
[[material]]
name = \"matt\"
kd = 1
[[material]]
name = \"mirror\"
kd = 0
kr = 1
[[material]]
name = \"glass\"
kd = 0
kt = 1
fresnel = true
";

/// Balls of all three kinds that shine on each other and on a matt block.
fn several(render: &str) -> String {
    let balls = ["matt", "mirror", "glass"].iter().zip([-1.05, 0.0, 1.05]).map(|(material, x)| {
        format!(
            "[[object]]\ntype = \"sphere\"\ncenter = [{x}, 0.5, 0]\nradius = 0.5\nmaterial = \"{material}\"\n"
        )
    });
    let block = "[[object]]\ntype = \"box\"\nsize = [3.4, 0.4, 1.6]\nmaterial = \"matt\"\ntranslate = [0, -0.25, 0]\n";
    format!(
        "{CAMERA}[render]\nwidth = 32\nheight = 32\nspp = 16\nmax_depth = 100000\n{render}\n{MATERIALS}{}{block}",
        balls.collect::<String>()
    )
}

/// A ball that fills the image.
fn single(material: &str, render: &str) -> String {
    format!(
        "[camera]\nposition = [0, 0, 4]\nlook_at = [0, 0, 0]\nfov = 14\n[render]\nwidth = 16\nheight = 16\nspp = 1024\nmax_depth = 100000\n{render}\n\
         {MATERIALS}[[object]]\ntype = \"sphere\"\nmaterial = \"{material}\"\n"
    )
}

/// Without roulette each sample by itself is 1, however long its path.
#[test]
fn nothing_is_lost_on_any_path() {
    let mut stage = Stage::new(&several("background = 1"), &[]);
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
        let stage = Stage::new(&single(material, "background = 1"), &[]);
        let found = mean(&stage.render());
        println!("{material}: {found}");
        assert!((found - 1.0).abs() < 1e-4, "{material}: {found}");
    }
    let mut stage = Stage::new(&several("background = 1"), &[]);
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
        let mut stage = Stage::new(&single(material, "environment = \"ones.exr\""), &ones());
        for direct in ALL {
            stage.image.direct = direct;
            let found = mean(&stage.render());
            println!("{material}, {direct:?}: {found}");
            assert!((found - 1.0).abs() < 1e-4, "{material}, {direct:?}: {found}");
        }
    }
    let mut stage = Stage::new(&several("environment = \"ones.exr\"\nenvironment_rotation = 77"), &ones());
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
    let text = "
[camera]
position = [0.2, 0.1, 0.3]
look_at = [-1, -0.4, -0.7]
fov = 80
[render]
width = 16
height = 16
spp = 64
[[material]]
name = \"wall\"
kd = [0.8, 0.5, 0.2]
emission = [0.2, 0.5, 0.8]
[[object]]
type = \"box\"
size = [2, 2, 2]
material = \"wall\"
";
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
