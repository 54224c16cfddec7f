//! MTL files read through small OBJ files.

use tempfile::TempDir;

use super::super::obj::{ObjFile, read};
use super::*;
use crate::error::Result;

const FACE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n";

/// Writes `a.obj` (with `head` before a triangle), `a.mtl` and a texture of one texel, and reads them.
fn load(head: &str, mtl: &[u8]) -> (TempDir, Result<ObjFile>) {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("a.obj"), format!("{head}\n{FACE}")).unwrap();
    std::fs::write(at("a.mtl"), mtl).unwrap();
    image::RgbImage::new(1, 1).save(at("my tex.png")).unwrap();
    let file = read(&at("a.obj"), &mut Textures::default());
    (folder, file)
}

/// The material of the only definition in `mtl`, and the warnings without the folder.
fn with_warnings(mtl: &str) -> (Material, Vec<String>) {
    let (folder, file) = load("mtllib a.mtl\nusemtl m", format!("newmtl m\n{mtl}\n").as_bytes());
    let file = file.unwrap();
    assert_eq!(file.meshes[0].1, Some(0));
    let prefix = format!("{}/", folder.path().display());
    let warnings = file.warnings.iter().map(|warning| warning.replace(&prefix, "")).collect();
    (file.materials[0].1.clone(), warnings)
}

fn of(mtl: &str) -> Material {
    let (material, warnings) = with_warnings(mtl);
    assert!(warnings.is_empty(), "{mtl}: {warnings:?}");
    material
}

fn error(mtl: &[u8]) -> String {
    let (folder, file) = load("mtllib a.mtl\nusemtl m", mtl);
    file.unwrap_err().to_string().replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn numbers_arrive() {
    let m = of("Ka 0.25 0.5 0.75 # c\n\tKd 1 0.5 0\r\nKs 0.5\nKe 2 3 4\nNs 10\nNi 1.25\nillum 2");
    assert_eq!((m.ka, m.kd, m.ks), ([0.25, 0.5, 0.75], [1.0, 0.5, 0.0], [0.5; 3]));
    assert_eq!((m.emission, m.shininess), ([2.0, 3.0, 4.0], 10.0));
    assert_eq!((m.kr, m.kt, m.fresnel), ([0.0; 3], [0.0; 3], false));
    let m = of("Kd 0.5 0.25 0");
    assert_eq!((m.ka, m.ks), ([0.5, 0.25, 0.0], [0.0; 3]));
    assert_eq!(of("").kd, Material::default().kd);
    // A highlight without illum counts, and one of exponent 0 doesn't.
    assert_eq!(of("Ks 1 1 1\nNs 5").ks, [1.0; 3]);
    assert_eq!(of("Ks 1 1 1\nNs 5\nillum 1").ks, [0.0; 3]);
    assert_eq!(of("Ks 1 1 1\nNs 0\nillum 2").ks, [0.0; 3]);
}

#[test]
fn illumination_models_follow_the_table() {
    let base = "Ka 0 0 0\nKd 0.5 0.5 0.5\nKs 0.25 0.25 0.25\nNs 9\nNi 1.25\n";
    let of = |more: &str| of(&format!("{base}{more}"));
    let local = |m: &Material| (m.kd[0], m.ks[0], m.kr[0], m.kt[0], m.ior, m.fresnel, m.emission[0]);
    assert_eq!(local(&of("illum 0")), (0.0, 0.0, 0.0, 0.0, 1.0, false, 0.5));
    assert_eq!(local(&of("illum 1")), (0.5, 0.0, 0.0, 0.0, 1.0, false, 0.0));
    for model in [2, 10] {
        assert_eq!(local(&of(&format!("illum {model}"))), (0.5, 0.25, 0.0, 0.0, 1.0, false, 0.0));
    }
    for model in [3, 4, 5, 8, 9] {
        assert_eq!(local(&of(&format!("illum {model}"))), (0.5, 0.25, 0.25, 0.0, 1.0, false, 0.0));
    }
    assert_eq!(local(&of("illum 4\nd 0.5")), (0.25, 0.125, 0.125, 0.5, 1.0, false, 0.0));
    assert_eq!(local(&of("illum 9\nd 0")), (0.0, 0.0, 0.0, 1.0, 1.0, false, 0.0));
    assert_eq!(local(&of("illum 6")), (0.5, 0.25, 0.25, 0.75, 1.25, false, 0.0));
    assert_eq!(local(&of("illum 6\nd 0.5")), (0.25, 0.25, 0.25, 0.375, 1.25, false, 0.0));
    assert_eq!(local(&of("illum 7\nd 1")), (0.5, 0.25, 0.0, 1.0, 1.25, true, 0.0));
    assert_eq!(local(&of("illum 7\nTr 1\nTf 0.5 0.5 0.5")), (0.0, 0.25, 0.0, 0.5, 1.25, true, 0.0));
    assert_eq!(local(&of("illum 2\nTr 0.25")), (0.375, 0.1875, 0.0, 0.25, 1.0, false, 0.0));
}

#[test]
fn contradictions_of_d_and_tr_are_settled_with_a_warning() {
    let kt = |mtl: &str| {
        let (material, warnings) = with_warnings(mtl);
        (material.kt[0], warnings.len())
    };
    assert_eq!(kt("d 0.75\nTr 0.5"), (0.25, 1));
    assert_eq!(kt("Tr 0.5\nd 0.75"), (0.25, 1));
    assert_eq!(kt("Tr 0.25\nd 0.75"), (0.25, 0));
    assert_eq!(kt("d 1\nTr 1"), (0.0, 1));
    // Invisible surfaces: what some exporters write for opaque ones.
    assert_eq!(kt("Tr 1"), (0.0, 1));
    assert_eq!(kt("d 0"), (0.0, 1));
    assert_eq!(kt("d -halo 0.5"), (0.5, 0));
    assert_eq!(kt("d 2"), (0.0, 1));
    assert_eq!(kt("d -2\nillum 7"), (1.0, 1));
}

#[test]
fn texture_names_and_options() {
    let texture = |map: &str| {
        let (material, warnings) = with_warnings(&format!("Kd 0 0 0\nmap_Kd {map}"));
        assert_eq!(material.kd, if material.texture.is_some() { [1.0; 3] } else { [0.0; 3] });
        (material.texture, warnings.len())
    };
    for map in [
        "my tex.png",
        r".\my tex.png",
        "\"my tex.png\"",
        "-s 1 1 1 -o 0 0 my tex.png",
        "-bm 0.5 -clamp off -blendu on -imfchan r my tex.png",
        "my tex.png -bm 0.5 -s 1",
        "-colorspace sRGB   -type sphere  -texres 512 my tex.png",
    ] {
        assert_eq!(texture(map), (Some(0), 0), "{map}");
    }
    for map in
        ["MY TEX.png", r"C:\maps\my tex.png", "-s 2 2 my tex.png", "my tex.png -o 0.5", "-mm 0 2 my tex.png"]
    {
        assert_eq!(texture(map), (Some(0), 1), "{map}");
    }
    for map in ["missing.png", "", "-s 1 1 1", "a.mtl", "..", "/"] {
        assert_eq!(texture(map), (None, 1), "{map}");
    }
    assert_eq!(
        with_warnings("map_Kd missing.png").1,
        ["a.mtl: material `m`: texture `missing.png` not found: Kd is used alone"]
    );
    assert_eq!(of("map_Kd my tex.png\nmap_Bump gone.png\nrefl gone.png").ka, [1.0; 3]);
}

#[test]
fn malformed_numbers_name_the_file_and_line() {
    for (mtl, expected) in [
        ("newmtl m\nKd abc\n", "a.mtl:2: Kd: `abc` is not a number"),
        ("newmtl m\nKd 1 2\n", "a.mtl:2: Kd: a number is missing"),
        ("newmtl m\r\n\r\nNs\r\n", "a.mtl:3: Ns: a number is missing"),
        ("d nan\n", "a.mtl:1: d: `nan` is not finite"),
        ("newmtl m\nKs 1e99 0 0", "a.mtl:2: Ks: `1e99` is not finite"),
        ("illum x", "a.mtl:1: illum: `x` is not a number"),
        ("newmtl \0", "a.mtl: this is not a text file"),
    ] {
        assert!(error(mtl.as_bytes()).starts_with(expected), "{mtl:?}: {}", error(mtl.as_bytes()));
    }
}

#[test]
fn what_can_be_left_out_is_a_warning() {
    for mtl in ["Kd spectral a.rfl 1", "Ks xyz 1 1 1", "illum 11", "illum 2.5", "Kd -1 0 0"] {
        assert_eq!(with_warnings(mtl).1.len(), 1, "{mtl}");
    }
    assert!(of("Pr 0.5\ncrazy x\nmap_Ks a.png\nKm abc\n# Kd abc").kd == Material::default().kd);
}

#[test]
fn material_files_are_found() {
    let cases: [(&str, Option<u32>, usize); 11] = [
        ("mtllib a.mtl\nusemtl m", Some(0), 0),
        ("mtllib\ta.mtl\nusemtl\tm", Some(0), 0),
        ("usemtl m\nmtllib a.mtl", None, 1),
        ("  mtllib  a.mtl  \n usemtl  m ", Some(0), 0),
        ("mtllib \"a.mtl\" my\\ tex.png\nusemtl m", Some(0), 0),
        ("mtllib gone.mtl a.mtl\nusemtl m", Some(0), 1),
        ("mtllib a.mtl\nmtllib a.mtl\nmtllib ./a.mtl\nusemtl m", Some(0), 0),
        ("mtllib A.MTL\nusemtl m", Some(0), 1),
        ("mtllib gone.mtl\nmtllib gone.mtl\nusemtl m", None, 2),
        ("mtllib\nusemtl m", None, 2),
        ("usemtl\nusemtl x\nusemtl x", None, 1),
    ];
    for (head, material, warnings) in cases {
        let head = head.replace(" my\\ tex.png", "");
        let (_folder, file) = load(&head, b"\xef\xbb\xbfnewmtl m\nKd 1 0 0\nnewmtl m\nKd 0 1 0\n");
        let file = file.unwrap();
        assert_eq!(
            (file.meshes[0].1, file.warnings.len()),
            (material, warnings),
            "{head}: {:?}",
            file.warnings
        );
        if material.is_some() {
            assert_eq!(file.materials.len(), 1);
            assert_eq!(file.materials[0].1.kd, [1.0, 0.0, 0.0]);
        }
    }
}

#[test]
fn several_files_and_names_with_blanks() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("one two.mtl"), "newmtl a b\nKd 1 0 0\n").unwrap();
    std::fs::write(at("three.mtl"), "newmtl c\nKd 0 1 0\nnewmtl a b\nKd 0 0 1\n").unwrap();
    for mtllib in [
        "mtllib one two.mtl\nmtllib three.mtl",
        r"mtllib one\ two.mtl three.mtl",
        "mtllib \"one two.mtl\" three.mtl",
    ] {
        let faces = "usemtl c\nf 1 2 3\nusemtl a b\nf 3 2 1\n";
        std::fs::write(at("a.obj"), format!("{mtllib}\n{FACE}{faces}")).unwrap();
        let file = read(&at("a.obj"), &mut Textures::default()).unwrap();
        assert!(file.warnings.is_empty(), "{:?}", file.warnings);
        let colors: Vec<_> =
            file.meshes.iter().map(|(_, id)| id.map(|i| file.materials[i as usize].1.kd)).collect();
        assert_eq!(colors, [None, Some([0.0, 1.0, 0.0]), Some([1.0, 0.0, 0.0])], "{mtllib}");
    }
}

#[test]
fn unlit_means_emission_unless_there_is_a_texture() {
    let (material, warnings) = with_warnings("Kd 1 1 1\nillum 0\nmap_Kd my tex.png");
    assert_eq!((material.kd, material.emission, warnings.len()), ([1.0; 3], [0.0; 3], 1));
}
