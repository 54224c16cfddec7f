//! Absurd files: whatever they ask for ends soon, with a scene or with one clear line.

use std::path::Path;

use super::obj::{parse, parse_materials};
use super::texture::Textures;
use super::{Budget, MAX_WARNINGS, toml};
use crate::error::Result;

const SCENE: &str = "scene.toml";

fn within(text: &str, budget: u64) -> Result<super::Loaded> {
    toml::parse(text.as_bytes(), Path::new(SCENE), Budget::of_bytes(budget))
}

fn refused(text: &str) -> String {
    let error = within(text, 1 << 30).map(|_| ()).expect_err("absurd").to_string();
    assert!(error.starts_with("scene.toml:") && !error.contains('\n') && error.len() < 1000, "{error}");
    error
}

fn obj(text: &str) -> Result<super::ObjFile> {
    parse(text.as_bytes(), Path::new("a.obj"), &mut Textures::default())
}

#[test]
fn a_scene_beyond_memory_is_refused_where_it_grows_too_large() {
    let terrain = "[[object]]\ntype = 'box'\n[[object]]\ntype = 'terrain'\ncells = 32000\n";
    assert_eq!(
        within(terrain, 16 << 30).map(|_| ()).unwrap_err().to_string(),
        "scene.toml:3: column 1: with this object the scene needs about 53.4 GiB of memory, but 16.0 GiB are \
         available; use fewer cells or levels"
    );
    for object in
        ["type = 'sphereflake'\ndepth = 9", "type = 'teapot'\nlevel = 2048", "type = 'icosphere'\nlevel = 11"]
    {
        let error = refused(&format!("[[object]]\n{object}\n"));
        assert!(error.contains("scene.toml:1: column 1: with this object"), "{error}");
    }
    // Many small objects are a large one.
    let many = "[[object]]\ntype = 'terrain'\n".repeat(1000);
    assert!(refused(&many).contains("but 1.0 GiB are available"));
    assert!(within("[[object]]\ntype = 'terrain'\n", 8 << 20).is_ok());
    // A mesh counts by the size of its file.
    let folder = tempfile::tempdir().unwrap();
    let mesh = std::fs::File::create(folder.path().join("a.obj")).unwrap();
    mesh.set_len(1 << 40).unwrap();
    let text = "[[object]]\ntype = 'mesh'\nfile = 'a.obj'";
    let error = toml::parse(text.as_bytes(), &folder.path().join(SCENE), Budget::of_bytes(1 << 30));
    let error = error.map(|_| ()).unwrap_err().to_string();
    assert!(error.ends_with("but 1.0 GiB are available; use fewer or coarser meshes"), "{error}");
}

#[test]
fn absurd_numbers_have_a_line() {
    let sphere = "[[object]]\ntype = 'sphere'\n";
    assert!(refused(&format!("{sphere}radius = 1e400")).contains(":3: column 10: "));
    assert!(refused(&format!("{sphere}radius = 1e39")).contains("radius inf"));
    assert!(refused(&format!("{sphere}radius = {}", "9".repeat(1000))).contains(":3: column 10: "));
    assert!(refused(&format!("{sphere}rotate = [1e309, 0, 0]")).contains(":3: column 1"));
    assert!(refused("[render]\nseed = 18446744073709551616").contains(":2: column 8: "));
    assert!(refused("[render]\nwidth = 4294967296").contains(":2: column 9: "));
    assert!(within(&format!("{sphere}radius = 0.{}1", "0".repeat(30)), 1 << 20).is_ok());
    let error = |text: &str| obj(text).unwrap_err().to_string();
    assert!(error("v 1e400 0 0\nf 1 1 1").starts_with("a.obj:1: inf is not a number"));
    assert!(error("v 0 0 0\nf 1 1 4294967295").starts_with("a.obj:2: index 4294967295"));
    assert!(error("v 0 0 0\nf 1 1 18446744073709551616").starts_with("a.obj:2: index 18446744073709551615"));
    let mtl = parse_materials(b"newmtl a\nKd 1e400 0 0", Path::new("a.mtl"), &mut Textures::default());
    assert!(mtl.unwrap_err().to_string().starts_with("a.mtl:2: Kd: `1e400` is not finite"));
}

#[test]
fn what_is_endlessly_far_is_refused() {
    let tiny = "[[object]]\ntype = 'sphere'\nradius = 1e-38\n";
    let camera =
        "[camera]\ntype = 'orthographic'\nheight = 1e300\nposition = [1e9, 0, 0]\nlook_at = [0, 0, 0]\n";
    assert!(
        refused(&format!("{camera}{tiny}")).contains(":1: column 1: the camera is endlessly far or wide")
    );
    let light = "[[light]]\ntype = 'point'\nposition = [0, 0, 1e299]\n";
    assert!(refused(&format!("{tiny}{light}")).contains(":4: column 1: the light is endlessly far or wide"));
    let near = "[[object]]\ntype = 'sphere'\n";
    assert!(within(&format!("{camera}{near}{light}"), 1 << 20).is_ok());
    let plane = "[[object]]\ntype = 'plane'\n";
    assert!(refused(&format!("{plane}repeat = 1e300")).contains(":3: column 10: `repeat` isn't a length"));
}

#[test]
fn deep_nesting_is_an_error_not_a_full_stack() {
    for (open, close) in [("[", "]"), ("{ a = ", " }")] {
        let deep = format!("[render]\nambient = {}0{}", open.repeat(100_000), close.repeat(100_000));
        assert!(refused(&deep).contains(":2: column "));
    }
    assert!(refused(&format!("[a{}]", ".a".repeat(100_000))).contains(":1: column "));
    assert!(refused(&format!("a{} = 1", ".a".repeat(100_000))).contains(":1: column "));
}

#[test]
fn long_lines_are_shown_short() {
    let long = "x".repeat(1 << 22);
    assert!(refused(&format!("[render]\n{long} = 1")).contains("scene.toml:2"));
    refused(&format!("[[object]]\ntype = '{long}'"));
    refused(&format!("[[object]]\ntype = 'box'\nmaterial = '{long}'"));
    refused(&format!("[[object]]\ntype = 'mesh'\nfile = '{long}'"));
    refused(&format!("[[material]]\nname = '{long}'\n[[material]]\nname = '{long}'"));
    let error = |text: String| obj(&text).unwrap_err().to_string();
    assert!(error(format!("v {long}")).len() < 200);
    assert!(error(format!("v 0 0 0\nf 1 1 {long}")).len() < 200);
    let face = "f 1 1 1".to_owned() + &" 1".repeat(1 << 20);
    let file = obj(&format!("# {long}\nv 0 0 0\nusemtl {long}\nmtllib {long}\n{face}")).unwrap();
    assert_eq!(file.meshes[0].0.triangles.len(), (1 << 20) + 1);
    assert!(file.warnings.iter().all(|warning| warning.len() < 300), "{:?}", file.warnings);
}

#[test]
fn thousands_of_materials_and_warnings_stay_few_lines() {
    let materials: String =
        (0..5000).map(|n| format!("newmtl m{n}\nKd spectral a\nd 2\nTr 0\nillum 99\n")).collect();
    let (materials, warnings) =
        parse_materials(materials.as_bytes(), Path::new("a.mtl"), &mut Textures::default()).unwrap();
    assert_eq!((materials.len(), warnings.len()), (5000, MAX_WARNINGS + 1));
    assert_eq!(warnings[MAX_WARNINGS], "a.mtl: more warnings are left out");
    let uses: String = (0..5000).map(|n| format!("usemtl m{n}\nmtllib m{n}.mtl\nf 1 1 1\n")).collect();
    let file = obj(&format!("v 0 0 0\n{uses}")).unwrap();
    assert!(file.warnings.len() <= MAX_WARNINGS + 2, "{}", file.warnings.len());
    let scene: String = (0..5000)
        .map(|n| format!("[[material]]\nname = 'm{n}'\nfresnel = true\n[[object]]\ntype = 'sphere'\n"))
        .collect();
    let loaded = within(&scene, 1 << 20).unwrap();
    assert_eq!(loaded.scene.header.materials.len(), 5001);
    assert!(loaded.warnings.len() <= MAX_WARNINGS + 2, "{}", loaded.warnings.len());
}
