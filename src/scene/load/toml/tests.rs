//! Tests of the scene format: what is read, and that what is wrong is named with its line.

use std::path::{Path, PathBuf};

use glam::DVec3;
use proptest::prelude::*;

use super::source::Source;
use super::{build, describe};
use crate::error::Result;
use crate::scene::light::LightShape;
use crate::scene::load::{Loaded, load};
use crate::scene::material::Physical;
use crate::scene::metal::Metal;
use crate::scene::{Camera, Shading};
use crate::settings::{Encoding, Filter, Integrator};

fn read(text: &str) -> Result<Loaded> {
    let source = Source { file: Path::new("scene.toml"), text };
    build(&source, describe(&source)?, super::Space::Memory)
}

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut scenes: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    scenes.sort();
    scenes
}

#[test]
fn every_scene_is_read_without_warning_and_says_what_it_shows() {
    let scenes = scenes();
    assert!(scenes.len() >= 9);
    for path in scenes {
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# ") && text.lines().next().unwrap().len() > 40, "{path:?}");
        let loaded = load(&path).unwrap();
        assert_eq!(loaded.warnings, [""; 0], "{path:?}");
        let header = &loaded.scene.header;
        let shines = header.materials.iter().any(|material| material.emission != [0.0; 3]);
        let lit = !header.lights.is_empty() || header.environment.is_some() || header.background != [0.0; 3];
        assert!(!loaded.framed && !loaded.scene.surfaces.is_empty() && (lit || shines), "{path:?}");
    }
}

#[test]
fn the_reference_is_read() {
    let reference = include_str!("../../../../docs/scene-format.md");
    let examples: Vec<_> =
        reference.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap()).collect();
    assert!(!examples.is_empty());
    for example in examples {
        let loaded = read(example).unwrap();
        assert_eq!(loaded.warnings, [""; 0]);
    }
}

#[test]
fn an_empty_file_is_a_black_image() {
    let loaded = read("").unwrap();
    assert!(loaded.scene.surfaces.is_empty() && loaded.framed);
    assert_eq!(loaded.warnings, ["scene.toml: no objects: the image shows the background"]);
    assert_eq!(loaded.scene.header.background, [0.0; 3]);
}

#[test]
fn image_settings_are_optional() {
    assert_eq!(read("").unwrap().image, Default::default());
    let image = read(
        "[render]\nwidth = 320\nheight = 200\nspp = 4\nseed = 7\nmax_depth = 3\nmin_weight = 0.01\n\
         integrator = 'whitted'\nfilter = 'mitchell'\nencoding = 'linear'",
    )
    .unwrap()
    .image;
    assert_eq!((image.width, image.height, image.spp, image.seed), (Some(320), Some(200), Some(4), Some(7)));
    assert_eq!((image.max_depth, image.min_weight), (Some(3), Some(0.01)));
    assert_eq!(image.integrator, Some(Integrator::Whitted));
    assert_eq!((image.filter, image.encoding), (Some(Filter::Mitchell), Some(Encoding::Linear)));
}

#[test]
fn header_colours() {
    let header = read("[render]\nbackground = [0.1, 0.2, 0.3]\nambient = 1\nambient_floor = 0.25")
        .unwrap()
        .scene
        .header;
    assert_eq!(header.background, [0.1, 0.2, 0.3]);
    assert_eq!((header.ambient, header.ambient_floor), ([1.0; 3], 0.25));
}

#[test]
fn cameras() {
    let camera = |text: &str| read(text).unwrap().scene.header.camera;
    let (eye, target) = (DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO);
    let plain = camera("[camera]\nposition = [1, 2, 3]\nlook_at = [0, 0, 0]");
    assert_eq!(plain, Camera::perspective(eye, target, DVec3::Y, 45.0).unwrap());
    let turned = camera("[camera]\nposition = [1, 2, 3]\nlook_at = [0, 0, 0]\nup = [0, 0, 1]\nfov = 30");
    assert_eq!(turned, Camera::perspective(eye, target, DVec3::Z, 30.0).unwrap());
    let flat =
        camera("[camera]\ntype = 'orthographic'\nposition = [1, 2, 3]\nlook_at = [0, 0, 0]\nheight = 4");
    assert_eq!(flat, Camera::orthographic(eye, target, DVec3::Y, 4.0).unwrap());
}

#[test]
fn a_scene_without_camera_is_framed_for_any_shape_of_image() {
    let mut loaded = read("[render]\nambient = 1\n[[object]]\ntype = 'box'").unwrap();
    assert!(loaded.framed);
    let before = loaded.scene.header.camera.clone();
    loaded.fit(200, 100);
    assert_eq!(loaded.scene.header.camera, before);
    loaded.fit(100, 200);
    assert_eq!(loaded.scene.header.camera.up, before.up * 2.0);
}

#[test]
fn materials() {
    let scene = read(
        "[[material]]\nname = 'a'\nkd = [0.1, 0.2, 0.3]\nkt = 0.5\nfresnel = true\n\
         [[material]]\nname = 'b'\nka = 0.1\nreflectivity = 0.4\nks = 1\nshininess = 9\nior = 2\nemission = 3\n\
         [[object]]\ntype = 'box'\nmaterial = 'b'\n[[object]]\ntype = 'plane'\n[[object]]\ntype = 'plane'",
    )
    .unwrap()
    .scene;
    let [a, b, grey] = &scene.header.materials[..] else { panic!("{:?}", scene.header.materials) };
    assert_eq!((a.ka, a.kd, a.kt, a.fresnel), ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.5; 3], true));
    assert_eq!((b.ka, b.kd, b.reflectivity, b.ks), ([0.1; 3], [0.7; 3], 0.4, [1.0; 3]));
    assert_eq!((b.shininess, b.ior, b.emission), (9.0, 2.0, [3.0; 3]));
    assert_eq!(*grey, Default::default());
    assert_eq!(scene.header.parts.iter().map(|part| part.material).collect::<Vec<_>>(), [1, 2, 2]);
}

#[test]
fn physical_materials_bring_the_coefficients_of_the_whitted_integrator() {
    let scene = read(
        "[[material]]\nname = 'mirror'\ntype = 'conductor'\nmetal = 'gold'\n\
         [[material]]\nname = 'brushed'\ntype = 'conductor'\neta = 0\nk = [1, 2, 3]\nroughness = 0.5\nkd = 0.1\n\
         [[material]]\nname = 'frosted'\ntype = 'dielectric'\nroughness = 0.25\nior = 1.3\n\
         [[material]]\nname = 'matt'\ntype = 'phong'\n[[object]]\ntype = 'box'",
    )
    .unwrap()
    .scene;
    let [mirror, brushed, frosted, matt, ..] = &scene.header.materials[..] else { panic!() };
    let (eta, k) = Metal::Gold.index();
    assert_eq!(mirror.physical, Some(Physical::Conductor { eta, k, roughness: 0.0 }));
    // Gold reflects red as good as a mirror and blue hardly half: ((1.332 - 1)² + 1.869²) / ((1.332 + 1)² + 1.869²).
    assert_eq!((mirror.kd, mirror.ks), ([0.0; 3], [0.0; 3]));
    assert!((mirror.kr[2] - 0.403_452).abs() < 1e-5 && mirror.kr[0] > 0.94, "{:?}", mirror.kr);
    let physical = Physical::Conductor { eta: [0.0; 3], k: [1.0, 2.0, 3.0], roughness: 0.5 };
    assert_eq!(brushed.physical, Some(physical));
    // α is 1/4.
    assert_eq!((brushed.kd, brushed.ks, brushed.kr, brushed.shininess), ([0.1; 3], [1.0; 3], [0.0; 3], 30.0));
    assert_eq!(frosted.physical, Some(Physical::Dielectric { roughness: 0.25 }));
    assert_eq!((frosted.kd, frosted.kt, frosted.fresnel, frosted.ior), ([0.0; 3], [1.0; 3], true, 1.3));
    assert_eq!(*matt, Default::default());
}

#[test]
fn lights() {
    let lights = read(
        "[[light]]\ntype = 'point'\nposition = [1, 2, 3]\ncolor = 0.5\nspecular = 0\nfalloff = [1, 0, 2]\n\
         [[light]]\ntype = 'directional'\ndirection = [0, -2, 0]\nambient = 0.1\n\
         [[light]]\ntype = 'spot'\nposition = [0, 1, 0]\nlook_at = [0, 0, 0]\nangle = 60\n\
         [[light]]\ntype = 'spot'\nposition = [0, 1, 0]\ndirection = [0, 0, 3]\nangle = 90\ninner_angle = 60",
    )
    .unwrap()
    .scene
    .header
    .lights;
    assert_eq!(lights[0].shape, LightShape::Point { position: DVec3::new(1.0, 2.0, 3.0) });
    assert_eq!((lights[0].diffuse, lights[0].specular), ([0.5; 3], [0.0; 3]));
    assert_eq!(lights[0].falloff, Some([1.0, 0.0, 2.0]));
    assert_eq!(lights[1].shape, LightShape::Directional { direction: DVec3::NEG_Y });
    assert_eq!((lights[1].diffuse, lights[1].ambient), ([1.0; 3], [0.1; 3]));
    let spot = |k: usize| match lights[k].shape {
        LightShape::Spot { direction, cos_inner, cos_outer, .. } => (direction, cos_inner, cos_outer),
        _ => panic!("{:?}", lights[k]),
    };
    let (direction, inner, outer) = spot(2);
    assert_eq!(direction, DVec3::NEG_Y);
    assert!(inner == outer && (outer - 0.5).abs() < 1e-15);
    let (direction, inner, outer) = spot(3);
    assert_eq!((direction, outer), (DVec3::Z, 0.0));
    assert!((inner - 0.5).abs() < 1e-15);
}

/// World-space corners of a box of size 2 under a transform.
fn placed(transform: &str) -> Vec<[f64; 3]> {
    let scene = read(&format!("[[object]]\ntype = 'box'\nsize = 2\n{transform}")).unwrap().scene;
    let world = |p: &[f32; 3]| scene.header.frame.to_world(DVec3::from(p.map(f64::from))).to_array();
    scene.surfaces.positions.iter().map(world).collect()
}

#[test]
fn transforms_scale_then_rotate_then_translate() {
    let plain = placed("");
    let moved = placed("translate = [10, 0, 0]\nrotate = [0, 0, 90]\nscale = [2, 3, 4]");
    for ([x, y, z], moved) in plain.iter().zip(moved) {
        assert_eq!(moved, [10.0 - 3.0 * y, 2.0 * x, 4.0 * z]);
    }
    let about = placed("rotate = { axis = [0, 0, 2], angle = 90 }");
    assert_eq!(about, placed("rotate = [0, 0, 90]"));
    // About x first: y goes to z, which z's turn leaves alone.
    let twice = placed("rotate = [90, 0, 90]\nscale = [1, 2, 3]");
    for ([x, y, z], twice) in plain.iter().zip(twice) {
        assert_eq!(twice, [3.0 * z, *x, 2.0 * y]);
    }
    let matrix = placed("matrix = [[0, -3, 0, 10], [2, 0, 0, 0], [0, 0, 4, 0], [0, 0, 0, 1]]");
    assert_eq!(matrix, placed("translate = [10, 0, 0]\nrotate = [0, 0, 90]\nscale = [2, 3, 4]"));
}

#[test]
fn objects_and_their_counts() {
    let scene = read(
        "[[object]]\ntype = 'sphere'\ncenter = [1, 0, 0]\nradius = 2\n\
         [[object]]\ntype = 'sphereflake'\ndepth = 2\nscale = 2\n\
         [[object]]\ntype = 'terrain'\ncells = 8\nshading = 'flat'\n\
         [[object]]\ntype = 'teapot'\nlevel = 2\nshading = 'gouraud'\n\
         [[object]]\ntype = 'icosphere'\nlevel = 1\n\
         [[object]]\ntype = 'box'\nmin = [0, 0, 0]\nmax = [1, 1, 1]\n\
         [[object]]\ntype = 'plane'\nsize = [2, 3]\nrepeat = 4",
    )
    .unwrap()
    .scene;
    assert_eq!(scene.surfaces.spheres.len(), 1 + 91);
    assert_eq!(scene.surfaces.triangles.len(), 128 + 240 + 80 + 12 + 2);
    let shadings: Vec<_> = scene.header.parts.iter().map(|part| part.shading).collect();
    assert_eq!(shadings[..3], [Shading::Flat, Shading::Gouraud, Shading::Phong]);
}

/// Each text is wrong at the line that holds `#!`; what the message must say stands behind it.
#[test]
fn what_is_wrong_is_named_with_its_line() {
    let sphere = "[[object]]\ntype = 'sphere'\n";
    let spot = "[[light]]\ntype = 'spot'\nposition = [0, 1, 0]\n";
    let camera = "[camera]\nposition = [0, 0, 1]\nlook_at = [0, 0, 0]\n";
    let material = "[[material]]\nname = 'a'\n";
    let cases = [
        // The format itself
        "[camera #! expected".to_owned(),
        "[render]\nwidth = #! ".into(),
        "[render]\nwidth = 1\nwidth = 2 #! duplicate key".into(),
        "[render]\nwidht = 2 #! unknown field `widht`".into(),
        "[rendre] #! unknown field `rendre`".into(),
        format!("{material}colour = 1 #! unknown field `colour`"),
        "[material] #! double brackets\nname = 'a'".into(),
        // Wrong kinds of value
        "[render]\nwidth = 'wide' #! expected a whole number".into(),
        "[render]\nwidth = -5 #! expected a whole number".into(),
        "[render]\nseed = -1 #! expected a whole number".into(),
        "[render]\nfilter = 'blur' #! unknown variant `blur`".into(),
        "[render]\nambient = true #! a number or a list".into(),
        format!("{sphere}radius = 'big' #! expected a number"),
        format!("{sphere}center = [0, 1] #! length 2"),
        format!("{sphere}rotate = 90 #! [x, y, z] in degrees"),
        format!("{sphere}rotate = [90, 0] #! length 2"),
        format!("{sphere}rotate = [90, 0, 0, 0] #! length 4"),
        format!("{sphere}rotate = {{ axis = [0, 1, 0] }} #! missing field `angle`"),
        format!("{sphere}rotate = {{ axis = [0, 1, 0], angle = 3, o = 1 }} #! unknown field `o`"),
        // Numbers out of range
        "[render]\nwidth = 0 #! from 1 to 65536".into(),
        "[render]\nheight = 65537 #! from 1 to 65536".into(),
        "[render]\nspp = 0 #! from 1 to 65536".into(),
        "[render]\nspp = 65537 #! from 1 to 65536".into(),
        "[render]\nmin_weight = -1 #! at least 0".into(),
        "[render]\nambient_floor = 1.5 #! from 0 to 1".into(),
        "[render]\nbackground = [0, 0, -1] #! at least 0".into(),
        "[render]\nbackground = [0, 0, nan] #! finite".into(),
        "[render]\nbackground = [ #! finite\n0,\n0,\ninf\n]".into(),
        "[render]\nbackground = [0, 0] #! [r, g, b]".into(),
        format!("{material}kd = -0.5 #! at least 0"),
        format!("{material}shininess = -1 #! at least 0"),
        format!("{material}ior = 0 #! above 0"),
        format!("{material}ior = nan #! finite"),
        format!("{material}reflectivity = 2 #! from 0 to 1"),
        format!("{material}reflectivity = 0.5 #! together with `kr`\nkr = 0.5"),
        format!("{material}kt = 0.5\nreflectivity = 0.5 #! together with `kt`"),
        format!("{material}[[material]]\nname = 'a' #! second material"),
        "[[material]] #! without `name`\nkd = 1".into(),
        format!("{material}texture = 'missing.png' #! missing.png: can't read"),
        format!("{material}type = 'glass' #! unknown variant `glass`"),
        format!("{material}roughness = 0.5 #! `roughness` means nothing for a material of coefficients"),
        format!("{material}type = 'conductor'\nior = 1.5 #! `ior` means nothing for a conductor"),
        format!("{material}type = 'dielectric'\nmetal = 'gold' #! `metal` means nothing for a dielectric"),
        format!("{material}type = 'dielectric'\nroughness = 1.5 #! from 0 to 1"),
        format!("{material}type = 'conductor'\nmetal = 'tin' #! unknown variant `tin`"),
        format!("{material}type = 'conductor'\nmetal = 'gold'\nk = 3 #! `k` beside `metal`"),
        format!("{material}type = 'conductor'\neta = -1 #! at least 0"),
        format!("{material}type = 'conductor'\nk = 1\neta = [1, 2000, 1] #! from 0 to 1000"),
        "[[material]]\nname = 'a' #! without `metal`\ntype = 'conductor'".into(),
        "[[material]]\nname = 'a' #! without `k`\ntype = 'conductor'\neta = 1".into(),
        // Cameras
        "[camera] #! without `position`\nlook_at = [0, 0, 0]".into(),
        "[camera] #! without `look_at`\nposition = [0, 0, 0]".into(),
        format!("{camera}fov = 0 #! between 0 and 180"),
        format!("{camera}fov = 180 #! between 0 and 180"),
        format!("{camera}fov = inf #! finite"),
        format!("{camera}height = 2 #! means nothing for a perspective camera"),
        format!("{camera}up = [0, 0, 3] #! along the view"),
        format!("{camera}type = 'fisheye' #! unknown variant"),
        "[camera]\nposition = [1, 2, 3]\nlook_at = [1, 2, 3] #! where the camera stands".into(),
        "[camera]\nposition = [0, 3, 0]\nlook_at = [0, 0, 0] #! along the view".into(),
        "[camera]\ntype = 'orthographic'\nposition = [0, 0, 1]\nlook_at = [0, 0, 0]\nheight = 0 #! above 0"
            .into(),
        "[camera] #! without `height`\ntype = 'orthographic'\nposition = [0, 0, 1]\nlook_at = [0, 0, 0]"
            .into(),
        // Lights
        "[[light]] #! without `type`\ncolor = 1".into(),
        "[[light]] #! without `position`\ntype = 'point'".into(),
        "[[light]]\ntype = 'directional'\ndirection = [0, 0, 0] #! no direction".into(),
        "[[light]]\ntype = 'directional'\ndirection = [1, 0, 0]\nfalloff = [1, 0, 0] #! means nothing".into(),
        "[[light]]\ntype = 'point'\nposition = [0, 0, 0]\nfalloff = [0, 0, 0] #! divides by 0".into(),
        "[[light]]\ntype = 'point'\nposition = [0, 0, 0]\nfalloff = [1, -1, 0] #! at least 0".into(),
        format!("{spot}look_at = [0, 1, 0] #! no direction\nangle = 20"),
        format!("{spot}look_at = [0, 0, 0]\ndirection = [0, 1, 0]\nangle = 20")
            .replace("look_at = [0, 0, 0]", "look_at = [0, 0, 0] #! beside `direction`"),
        format!("{spot}direction = [0, 1, 0]\nangle = 0 #! above 0, up to 90"),
        format!("{spot}direction = [0, 1, 0]\nangle = 91 #! above 0, up to 90"),
        format!("{spot}direction = [0, 1, 0]\nangle = 20\ninner_angle = 21 #! from 0 to `angle`"),
        format!("{spot}direction = [0, 1, 0]").replace("[[light]]", "[[light]] #! without `angle`"),
        format!("{spot}angle = 5").replace("[[light]]", "[[light]] #! without `direction` or `look_at`"),
        // Objects
        "[[object]] #! without `type`\nscale = 1".into(),
        "[[object]]\ntype = 'cube' #! unknown variant `cube`".into(),
        "[[object]] #! without `file`\ntype = 'mesh'".into(),
        "[[object]]\ntype = 'mesh'\nfile = 'missing.obj' #! missing.obj: can't read".into(),
        format!("{sphere}level = 3 #! means nothing for a sphere"),
        format!("{sphere}shading = 'flat' #! means nothing for a sphere"),
        format!("{material}{sphere}material = 'b' #! no material is named `b`"),
        format!("{sphere}radius = 0 #! above 0"),
        format!("{sphere}scale = 0 #! flattens"),
        format!("{sphere}scale = [1, 1] #! one number or three"),
        format!("{sphere}scale = [1, 2, 1]").replace("[[object]]", "[[object]] #! can't be stretched"),
        format!("{sphere}translate = [1e300, 0, 0]")
            .replace("[[object]]", "[[object]] #! a sphere has centre"),
        format!("{sphere}matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]] #! last row"),
        format!("{sphere}matrix = [[1,0,0,0],[0,0,0,0],[0,0,1,0],[0,0,0,1]] #! flattens"),
        format!("{sphere}matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\nscale = 2 #! beside `matrix`"),
        format!("{sphere}rotate = {{ axis = [0, 0, 0], angle = 3 }} #! no direction"),
        "[[object]]\ntype = 'sphereflake'\ndepth = 10 #! from 0 to 9".into(),
        "[[object]]\ntype = 'terrain'\ncells = 0 #! from 1 to 32767".into(),
        "[[object]]\ntype = 'terrain'\nroughness = 2 #! from 0 to 1".into(),
        "[[object]]\ntype = 'terrain'\nheight = 1e60 #! of at least 0 and below 3.4e38".into(),
        "[[object]]\ntype = 'terrain'\nextent = 1e-300 #! above 1e-45 and below 3.4e38".into(),
        "[[object]] #! which f32 can't hold\ntype = 'plane'\ntranslate = [0, 1e60, 0]".into(),
        "[[object]]\ntype = 'terrain'\ncells = 32767\n[[object]] #! 2^31\ntype = 'sphereflake'\ndepth = 6"
            .into(),
        "[[object]]\ntype = 'teapot'\nlevel = 0 #! from 1 to 2048".into(),
        "[[object]]\ntype = 'box'\nsize = [1, 2] #! isn't a length".into(),
        "[[object]]\ntype = 'box'\nsize = [1, 2, 0] #! isn't a length".into(),
        "[[object]]\ntype = 'box'\nmin = [0, 0, 0]\nmax = [1, 0, 1] #! isn't above".into(),
        "[[object]] #! one of `min` and `max`\ntype = 'box'\nmin = [0, 0, 0]".into(),
        "[[object]]\ntype = 'box'\nsize = 1 #! beside `min`\nmin = [0, 0, 0]".into(),
        "[[object]]\ntype = 'plane'\nrepeat = 0 #! isn't a length".into(),
    ];
    for text in cases {
        let line = 1 + text.lines().position(|line| line.contains("#!")).unwrap();
        let expected = text.lines().nth(line - 1).unwrap().split("#!").nth(1).unwrap().trim();
        let message = read(&text).map(|_| ()).expect_err(&text).to_string();
        let place = format!("scene.toml:{line}: column ");
        assert!(message.starts_with(&place), "{text}\n--> {message}");
        assert!(message.contains(expected), "{text}\n--> {message}");
        assert!(!message.contains('\n') && message.contains("; "), "{message:?}");
    }
}

#[test]
fn a_message_as_a_whole() {
    let message = |text: &str| read(text).map(|_| ()).unwrap_err().to_string();
    assert_eq!(
        message("[render]\n  spp = 0"),
        "scene.toml:2: column 9: `spp` is 0; give a number from 1 to 65536"
    );
    assert_eq!(
        message("[[material]]\nname = 'ä'\n[[object]]\ntype = 'box'\nmaterial = 'a'"),
        "scene.toml:5: column 12: no material is named `a`; add a [[material]] with this name, or use `ä`"
    );
}

#[test]
fn a_bare_model_is_framed_and_lit() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/textured.obj");
    let loaded = load(&path).unwrap();
    assert!(loaded.framed && loaded.warnings.is_empty());
    assert_eq!((loaded.scene.header.lights.len(), loaded.scene.textures.len()), (2, 1));
    assert_eq!(loaded.scene.header.materials.len(), 3);
}

#[test]
fn files_that_are_no_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let error = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        load(&path).map(|_| ()).unwrap_err().to_string()
    };
    assert!(error("a.toml", b"# one\n\xff").contains("a.toml:2: the text isn't UTF-8"));
    assert!(error("a.ply", b"").contains("give a .toml scene, an .obj model or a .helio file"));
    assert!(error("bare", b"").contains("give a .toml scene, an .obj model or a .helio file"));
    assert!(load(&folder.path().join("none.toml")).unwrap_err().to_string().contains("check the path"));
    assert!(load(folder.path()).is_err());
}

#[test]
fn line_ends_and_a_byte_order_mark_are_no_matter() {
    let text = "\u{feff}[render]\r\nwidth = 3\r\n";
    assert_eq!(read(text).unwrap().image.width, Some(3));
    let error = read("[render]\r\nwidth = 0\r\n").unwrap_err().to_string();
    assert!(error.starts_with("scene.toml:2: column 9:"), "{error}");
}

#[test]
fn what_has_no_effect_is_warned_of() {
    let warnings = |text: &str| read(text).unwrap().warnings;
    assert_eq!(
        warnings("[render]\nambient = 1\n[[material]]\nname = 'a'\nfresnel = true\n[[object]]\ntype = 'box'"),
        ["scene.toml:4: `fresnel` has no effect on a material without `kt`"]
    );
    let dark = ["scene.toml: no light: all surfaces are black"];
    assert_eq!(warnings("[[object]]\ntype = 'box'"), dark);
    assert_eq!(warnings("[render]\nbackground = 1\n[[object]]\ntype = 'box'"), dark);
    let text = "[render]\nbackground = 1\nintegrator = 'path'\n[[object]]\ntype = 'box'";
    assert!(warnings(text).is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1024))]

    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let text = String::from_utf8_lossy(&bytes);
        let _ = describe(&Source { file: Path::new("scene.toml"), text: &text });
    }

    #[test]
    fn no_mutation_of_a_scene_panics(
        scene in 0..64usize,
        edits in proptest::collection::vec((any::<prop::sample::Index>(), 0..6u8, any::<char>(), 0..12usize), 1..4),
    ) {
        let scenes = scenes();
        let mut text: Vec<char> =
            std::fs::read_to_string(&scenes[scene % scenes.len()]).unwrap().chars().collect();
        for (place, edit, character, length) in edits {
            let at = place.index(text.len().max(1)).min(text.len());
            let end = (at + length).min(text.len());
            match edit {
                0 => { text.drain(at..end); }
                1 => text.insert(at, character),
                2 => text.insert(at, char::from(b'0' + length as u8 % 10)),
                3 => { let copy = text[at..end].to_vec(); text.splice(at..at, copy); }
                4 => { text.splice(at..at, "1e308".chars()); }
                _ => text.insert(at, ['-', '.', '[', ']', '=', '"', '\n', 'e'][length % 8]),
            }
        }
        let text: String = text.into_iter().collect();
        let source = Source { file: Path::new("scene.toml"), text: &text };
        if let Ok(description) = describe(&source)
            && description.objects.iter().map(|object| object.shape.count()).sum::<u64>() < 20_000
        {
            let _ = build(&source, description, super::Space::Memory);
        }
    }
}
