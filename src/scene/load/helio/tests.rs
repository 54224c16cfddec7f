use std::io::Cursor;

use glam::DVec3;

use super::*;
use crate::scene::build::Space;
use crate::scene::load::{self, toml};

/// A little of everything: two parts of triangles, one of them textured, spheres, lights.
const SCENE: &str = "
[render]
width = 77
filter = 'tent'
[[material]]
name = 'painted'
texture = 'a.png'
[[light]]
type = 'spot'
position = [1, 2, 3]
look_at = [0, 0, 0]
angle = 30
[[object]]
type = 'terrain'
cells = 4
material = 'painted'
translate = [100, 0, 0]
[[object]]
type = 'icosphere'
level = 0
translate = [100, 0, 0]
[[object]]
type = 'sphereflake'
depth = 1
translate = [100, 0, 0]
";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.toml"), SCENE).unwrap();
    image::RgbImage::from_fn(3, 2, |x, y| image::Rgb([x as u8, y as u8, 9]))
        .save(folder.path().join("a.png"))
        .unwrap();
    folder
}

fn bytes(loaded: &Loaded) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = HelioWriter::new(Cursor::new(&mut bytes)).unwrap();
    write(&mut writer, loaded).unwrap();
    writer.finish().unwrap();
    bytes
}

fn same(a: &Loaded, b: &Loaded) {
    let (s, t) = (&a.scene.surfaces, &b.scene.surfaces);
    assert_eq!((&s.positions, &s.triangles, &s.spheres), (&t.positions, &t.triangles, &t.spheres));
    assert_eq!((&s.normals, &s.uvs, &s.colors), (&t.normals, &t.uvs, &t.colors));
    assert_eq!(a.scene.textures, b.scene.textures);
    assert_eq!(wire::pack(&a.scene.header).unwrap(), wire::pack(&b.scene.header).unwrap());
    assert_eq!((&a.image, a.framed), (&b.image, b.framed));
}

#[test]
fn a_scene_comes_back_mapped() {
    let folder = folder();
    let source = load::load(&folder.path().join("a.toml")).unwrap();
    assert!(source.scene.header.frame.shift.x > 0.0, "a frame of its own");
    let path = folder.path().join("a.helio");
    std::fs::write(&path, bytes(&source)).unwrap();
    let loaded = load::load(&path).unwrap();
    same(&loaded, &source);
    assert!(loaded.scene.surfaces.positions.is_mapped() && loaded.scene.textures[0].texels.is_mapped());
    assert_eq!(loaded.scene.file.as_ref().unwrap().path(), path);
    // Again from the file: the same bytes.
    assert_eq!(bytes(&loaded), std::fs::read(&path).unwrap());
}

#[test]
fn a_scene_made_on_disk_is_the_one_made_in_memory() {
    let folder = folder();
    let path = folder.path().join("a.toml");
    let on_disk = load::load_in(&path, Space::Disk(folder.path())).unwrap();
    same(&on_disk, &load::load(&path).unwrap());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left behind");
    let nowhere = load::load_in(&path, Space::Disk(&folder.path().join("no"))).unwrap_err().to_string();
    assert!(
        nowhere.contains("no: can't write: ") && nowhere.contains("create its folder first"),
        "{nowhere}"
    );
}

#[test]
fn any_changed_or_missing_byte_is_noticed_or_means_nothing() {
    let folder = folder();
    let source = load::load(&folder.path().join("a.toml")).unwrap();
    let good = bytes(&source);
    let path = folder.path().join("bad.helio");
    let mut harmless = 0;
    for place in (0..good.len()).step_by(3) {
        let mut bad = good.clone();
        bad[place] ^= 0x10;
        std::fs::write(&path, &bad).unwrap();
        match load::load(&path) {
            Ok(loaded) => {
                same(&loaded, &source);
                harmless += 1;
            }
            Err(error) => assert!(error.to_string().contains("bad.helio: "), "{error}"),
        }
        std::fs::write(&path, &good[..place]).unwrap();
        let error = load::load(&path).unwrap_err().to_string();
        assert!(error.ends_with("; convert the scene anew"), "{error}");
    }
    assert!(harmless * 3 < 64 * 10, "{harmless} of the changes went unnoticed: more than gaps have bytes");
}

/// What a file says that is whole, but wasn't written by a converter.
fn forged(change: impl FnOnce(&mut Scene, &mut ImageDefaults)) -> String {
    let folder = folder();
    let mut loaded = load::load(&folder.path().join("a.toml")).unwrap();
    change(&mut loaded.scene, &mut loaded.image);
    let path = folder.path().join("forged.helio");
    std::fs::write(&path, bytes(&loaded)).unwrap();
    let error = load::load(&path).map(drop).unwrap_err().to_string();
    assert!(error.contains("forged.helio: ") && error.ends_with("; convert the scene anew"), "{error}");
    error
}

#[test]
fn arrays_that_lead_nowhere_are_refused() {
    let says = |what: &str, error: String| assert!(error.contains(what), "{error}");
    says("its triangle 3 is", forged(|scene, _| scene.surfaces.triangles[3][1] = 25 + 12));
    // The icosphere's first triangle, with a vertex of the terrain.
    says("its triangle 32 is", forged(|scene, _| scene.surfaces.triangles[32][0] = 0));
    says("its vertex 5 is", forged(|scene, _| scene.surfaces.positions[5][2] = f32::NAN));
    says("its vertex 0 is", forged(|scene, _| scene.surfaces.positions[0][0] = 1.5));
    says("its sphere 9 is", forged(|scene, _| scene.surfaces.spheres[9].radius = -1.0));
    says("its normal 2 is", forged(|scene, _| scene.surfaces.normals[2][0] = f32::INFINITY));
    says("its texture coordinate 1 is", forged(|scene, _| scene.surfaces.uvs[1][0] = f32::NAN));
    // One texture coordinate too few for the last vertex of the terrain.
    says(
        "its triangle 31 is",
        forged(|scene, _| scene.surfaces.uvs = scene.surfaces.uvs[1..].to_vec().into()),
    );
}

#[test]
fn headers_that_dont_fit_are_refused() {
    let says = |what: &str, error: String| assert!(error.contains(what), "{error}");
    let parts = |change: fn(&mut Vec<crate::scene::Part>)| forged(|scene, _| change(&mut scene.header.parts));
    says("its parts", parts(|parts| parts.swap(0, 1)));
    says("its parts", parts(|parts| parts[0].first = 1));
    says("its parts", parts(|parts| parts[2].first += 1));
    says("its parts", parts(|parts| parts[2].first = 1000));
    says("its parts", parts(Vec::clear));
    says("a part has no material", parts(|parts| parts[1].material = 9));
    says("a part begins", parts(|parts| parts[1].vertices = 99));
    says("a part begins", parts(|parts| parts[0].normals = 99));
    says("a material's texture", forged(|scene, _| scene.header.materials[0].texture = Some(1)));
    says("a texture has no size", forged(|scene, _| scene.textures[0].width = 2));
    says("its camera", forged(|scene, _| scene.header.camera.position.x = f64::NAN));
    says("its camera", forged(|scene, _| scene.header.camera.up = DVec3::ZERO));
    says("its frame", forged(|scene, _| scene.header.frame.scale = 0.3));
    says("its frame", forged(|scene, _| scene.header.frame.scale = -0.5));
    says("a light", forged(|scene, _| scene.header.lights[0].diffuse[1] = -1.0));
    says("a material has", forged(|scene, _| scene.header.materials[0].ior = 0.0));
    says("its background", forged(|scene, _| scene.header.background[2] = f64::INFINITY));
    says("its image", forged(|_, image| image.width = Some(0)));
}

/// Whoever changes what is stored in a header has to raise the version of the format with it: bincode doesn't tell old fields from new ones.
#[test]
fn the_header_is_that_of_version_3() {
    let loaded = toml::parse(
        SCENE.replace("texture = 'a.png'", "").as_bytes(),
        Path::new("a.toml"),
        super::super::Budget::of_bytes(1 << 20),
    )
    .unwrap();
    let contents = Contents {
        scene: Cow::Borrowed(&loaded.scene.header),
        image: Cow::Borrowed(&loaded.image),
        framed: loaded.framed,
        textures: vec![(3, 2)],
    };
    let bytes = wire::pack(&contents).unwrap();
    assert_eq!(
        (bytes.len(), crc32fast::hash(&bytes)),
        (834, 832_457_500),
        "raise VERSION in scene/helio/mod.rs, then change this"
    );
}
