//! Bytes that once made a reader panic, hang or grow, and whole files of each kind: `tests/corpus/<reader>/`, the
//! starting point of the fuzzers too.

mod targets;

use std::path::Path;

use proptest::prelude::*;
use proptest::sample::select;

fn each(reader: &str, target: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(reader);
    let mut files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty(), "{folder:?} is empty");
    for file in files {
        eprintln!("{}", file.display());
        target(&std::fs::read(&file).unwrap());
    }
}

#[test]
fn obj() {
    each("obj", targets::obj);
}

#[test]
fn mtl() {
    each("mtl", targets::mtl);
}

#[test]
fn toml() {
    each("toml", targets::toml);
}

#[test]
fn wire() {
    each("wire", targets::wire);
}

/// Tables with the keys that they may have; `N` stands for a number, `V` and `C` for three.
const TABLES: [(&str, &[&str]); 17] = [
    ("[camera]", &["position = V", "look_at = V", "up = V", "fov = N"]),
    ("[camera]\ntype = 'orthographic'", &["position = V", "look_at = V", "up = V", "height = N"]),
    ("[render]", &["background = C", "ambient = C", "ambient_floor = N", "min_weight = N", "max_depth = N"]),
    (
        "[[material]]\nname = 'm'",
        &[
            "ka = C",
            "kd = C",
            "ks = C",
            "shininess = N",
            "kr = C",
            "kt = C",
            "ior = N",
            "emission = C",
            "reflectivity = N",
        ],
    ),
    ("[[material]]\nname = 'm'\ntype = 'conductor'", &["eta = C", "k = C", "roughness = N", "kd = C"]),
    ("[[material]]\nname = 'm'\ntype = 'dielectric'", &["ior = N", "roughness = N", "kt = C"]),
    ("[[light]]\ntype = 'point'", &["position = V", "color = C", "falloff = V"]),
    ("[[light]]\ntype = 'directional'", &["direction = V", "diffuse = C", "ambient = C"]),
    (
        "[[light]]\ntype = 'spot'",
        &["position = V", "look_at = V", "angle = N", "inner_angle = N", "direction = V"],
    ),
    ("[[object]]\ntype = 'sphere'", &["center = V", "radius = N"]),
    ("[[object]]\ntype = 'sphereflake'", &["depth = 1", "radius = N"]),
    (
        "[[object]]\ntype = 'terrain'\ncells = 3",
        &["extent = N", "height = N", "roughness = N", "octaves = N"],
    ),
    ("[[object]]\ntype = 'teapot'\nlevel = 1", &[]),
    ("[[object]]\ntype = 'icosphere'\nlevel = 0", &["center = V", "radius = N"]),
    ("[[object]]\ntype = 'box'", &["size = V", "size = N"]),
    ("[[object]]\ntype = 'box'", &["min = V", "max = V"]),
    ("[[object]]\ntype = 'plane'", &["size = N", "repeat = N"]),
];

const PLACES: [&str; 7] = [
    "translate = V",
    "rotate = V",
    "rotate = { axis = V, angle = N }",
    "scale = N",
    "scale = V",
    "matrix = [[N, 0, 0, N], [0, N, N, 0], [0, 0, N, 0], [0, 0, 0, 1]]",
    "shading = 'flat'",
];

const NUMBERS: [&str; 22] = [
    "0", "1", "-1", "2", "3", "0.5", "90", "1e-3", "1e6", "1e-38", "1e-45", "1e-46", "1e19", "3e38",
    "3.5e38", "1e100", "1e154", "1e300", "1.7e308", "1e-300", "5e-324", "-1e30",
];

/// A table of these keys, each of them there or not, and sane numbers among the absurd ones.
fn table() -> impl Strategy<Value = String> {
    let number = || prop_oneof![3 => select(vec!["1", "2", "0.5"]), 2 => select(NUMBERS.to_vec())];
    let numbers = prop::collection::vec(number(), 40);
    (select(TABLES.to_vec()), any::<u16>(), prop::option::of(select(PLACES.to_vec())), numbers).prop_map(
        |((head, keys), there, place, numbers)| {
            let place = place.filter(|_| head.starts_with("[[object]]"));
            let keys = keys.iter().enumerate().filter(|(k, _)| there >> k & 1 == 1).map(|(_, key)| *key);
            let template: Vec<&str> = std::iter::once(head).chain(keys).chain(place).collect();
            let template = template.join("\n").replace(['V', 'C'], "[N, N, N]");
            let mut numbers = numbers.iter().cycle();
            let mut text: String = template
                .chars()
                .map(|c| if c == 'N' { (*numbers.next().unwrap()).to_owned() } else { c.to_string() })
                .collect();
            text.push('\n');
            text
        },
    )
}

proptest! {
    #[test]
    fn scenes_of_absurd_numbers(tables in prop::collection::vec(table(), 1..4)) {
        targets::toml(tables.concat().as_bytes());
    }
}
