//! Small files with one trait each; then files of other people's, and random ones.

use std::path::PathBuf;

use proptest::prelude::*;
use tempfile::TempDir;

use super::*;

const CORNERS: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        std::fs::write(folder.path().join(name), content).unwrap();
    }
    folder
}

fn load(folder: &TempDir) -> Result<ObjFile> {
    read(&folder.path().join("a.obj"), &mut Textures::default())
}

fn good(obj: &str) -> ObjFile {
    load(&folder(&[("a.obj", obj.as_bytes())])).unwrap()
}

/// The error without the folder's name.
fn bad(obj: &[u8]) -> String {
    let folder = folder(&[("a.obj", obj)]);
    let text = load(&folder).unwrap_err().to_string();
    assert!(!text.contains('\n'), "{text}");
    text.replace(&format!("{}/", folder.path().display()), "")
}

/// The corners of all triangles in order, as numbers to compare.
fn triangles(file: &ObjFile) -> Vec<[[f32; 3]; 3]> {
    let corner = |mesh: &Mesh, triangle: &[u32; 3]| triangle.map(|index| mesh.positions[index as usize]);
    let of = |mesh: &Mesh| mesh.triangles.iter().map(|t| corner(mesh, t)).collect::<Vec<_>>();
    file.meshes.iter().flat_map(|(mesh, _)| of(mesh)).collect()
}

/// The x of each triangle's first corner: tells the triangles of `numbered` apart.
fn order(file: &ObjFile) -> Vec<f32> {
    triangles(file).iter().map(|triangle| triangle[0][0]).collect()
}

/// Vertices of five triangles; that of number n begins at x = n.
fn numbered() -> String {
    (0..5).map(|n| format!("v {n} 0 0\nv {n}.5 1 0\nv {n}.25 0 1\n")).collect()
}

#[test]
fn polygons_are_fans_from_their_first_vertex() {
    let file = good(&format!("{CORNERS}v -1 0.5 0\nf 2 3 4 5 1\nf 4 3 2 1\n"));
    let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]];
    let expected = [[1, 2, 3], [1, 3, 4], [1, 4, 0], [3, 2, 1], [3, 1, 0]].map(|t| t.map(|i| p[i]));
    assert_eq!(triangles(&file), expected);
    assert!(file.meshes[0].0.normals.is_empty() && file.warnings.is_empty());
    assert_eq!(file.meshes[0].0.positions.len(), 5);
}

#[test]
fn triangles_keep_the_order_of_the_file() {
    let mtl = b"newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n";
    let obj = format!(
        "mtllib m.mtl\n{}usemtl a\nf 1 2 3\np 1\nl 1 2 3 4\nusemtl b\no x\nf 4 5 6\ng y\nusemtl a\nf 7 8 9\n\
         l 1 2\nusemtl b\nusemtl a\nf 10 10 10\nf 13 14 15\n",
        numbered()
    );
    let file = load(&folder(&[("a.obj", obj.as_bytes()), ("m.mtl", mtl)])).unwrap();
    assert_eq!(order(&file), [0.0, 1.0, 2.0, 3.0, 4.0]);
    let materials: Vec<_> = file.meshes.iter().map(|(mesh, id)| (mesh.triangles.len(), *id)).collect();
    assert_eq!(materials, [(1, Some(0)), (1, Some(1)), (1, Some(0)), (2, Some(0))]);
    assert_eq!(file.warnings.len(), 1);
    assert!(file.warnings[0].ends_with("2 lines and 1 points are left out"), "{:?}", file.warnings);
}

#[test]
fn relative_indices_count_back_from_the_face() {
    let file =
        good("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\nf 1 -2 -1\n");
    assert_eq!(order(&file), [0.0, 5.0, 0.0]);
}

#[test]
fn forward_references_are_fine_if_they_come() {
    assert_eq!(order(&good(&format!("f 4 5 6\n{}f 1 2 3\n", numbered()))), [1.0, 0.0]);
}

#[test]
fn odd_spelling_changes_nothing() {
    let plain = good("v 0 0 0\nv 1 0 0\nv 0 1 0.5\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\n");
    let odd = [
        "v 0 0 0\r\nv 1 0 0\r\nv 0 1 0.5\r\nvt 0 0\r\nvn 0 0 1\r\nf 1/1/1 2/1/1 3/1/1\r\n",
        "\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0.5\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1",
        "  v\t+0 0. .0\n\tv 1e0 0 0 # here\nv 0 1 5E-1\n#c\nvt 0 #x\nvn 0 0 2\nf 1/1/1 2/1/1 3/1/1#\n"
            .trim_end(),
        "v 0 \\\n0 0\nv 1 0 \\\r\n0\nv 0 1 0.5\nvt 0 0 0\nvn 0 0 1 \n\n\nf 1/1/1 \\\n 2/1/1 \\\n 3/1/1 # f\n",
        "v 0 0 0 1\nv 2 0 0 2\nv 0 0.5 0.25 0.5\nvt 0 0\nvn 0 0 1\nunknown x y\nvp 1\nf -3/-1/-1 -2/+1/-1 -1/1/1\n",
    ];
    for text in odd {
        let text = text.replace("3/1/1#", "3/1/1 #");
        let mesh = &good(&text).meshes[0].0;
        let expected = &plain.meshes[0].0;
        assert_eq!(mesh.positions, expected.positions, "{text}");
        assert_eq!(mesh.triangles, expected.triangles, "{text}");
        assert_eq!(mesh.normals, [[0.0, 0.0, 1.0]; 3], "{text}");
        assert_eq!(mesh.uvs, [[0.0; 2]; 3], "{text}");
    }
}

#[test]
fn faces_with_and_without_normals_are_kept_apart() {
    let obj = format!("{CORNERS}vn 0 0 4\nvt 0.5 0.25\nf 1//1 2//1 3//1\nf 1 2 4\nf 1/1 2/1 3/1\n");
    let file = good(&obj);
    let normals: Vec<_> = file.meshes.iter().map(|(mesh, _)| mesh.normals.len()).collect();
    let uvs: Vec<_> = file.meshes.iter().map(|(mesh, _)| mesh.uvs.len()).collect();
    assert_eq!((normals, uvs), (vec![3, 0, 0], vec![0, 0, 3]));
    assert_eq!(file.meshes[0].0.normals, [[0.0, 0.0, 1.0]; 3]);
    assert!(file.warnings.is_empty());
    // Within one face there is nothing to be kept apart.
    let file = good(&format!("{CORNERS}vn 0 0 4\nvt 0.5 0.25\nf 1/1/1 2/1 3//1\n"));
    assert!(file.meshes[0].0.normals.is_empty() && file.meshes[0].0.uvs.is_empty());
    assert_eq!(file.warnings.len(), 2);
}

#[test]
fn indices_of_what_the_file_has_none_of_are_left_out() {
    let file = good(&format!("{CORNERS}f 1/1/7 2/1/8 3/2/9\nf 1 2 4\n"));
    assert!(file.meshes.iter().all(|(mesh, _)| mesh.normals.is_empty() && mesh.uvs.is_empty()));
    assert_eq!(triangles(&file).len(), 2);
    assert_eq!(file.warnings.len(), 1);
}

#[test]
fn splitting_has_an_end() {
    let faces: String = (0..6000).map(|_| "f 1 2 3\nf 1//1 2//1 3//1\n").collect();
    let file = good(&format!("{CORNERS}vn 0 0 1\n{faces}"));
    assert_eq!(triangles(&file).len(), 12000);
    assert!(file.meshes.len() < 5000, "{}", file.meshes.len());
}

#[test]
fn colors_of_some_vertices_leave_the_others_white() {
    let file = good("v 0 0 0\nv 1 0 0 0.5 0 1\nv 0 1 0 0.1 0.2 0.3 1\nv 2 2 2 2\nf 1 2 3\nf 4 2 1\n");
    let mesh = &file.meshes[0].0;
    assert_eq!(mesh.colors, [[1.0; 3], [0.5, 0.0, 1.0], [0.1, 0.2, 0.3], [1.0; 3]]);
    assert_eq!(mesh.positions[3], [1.0; 3]);
    assert_eq!(file.warnings.len(), 1);
    let all = good("v 0 0 0 1 2 3\nv 1 0 0 0.5 0 1\nv 0 1 0 0 0 0\nf 3 2 1\n");
    assert_eq!(all.meshes[0].0.colors, [[0.0; 3], [0.5, 0.0, 1.0], [1.0, 2.0, 3.0]]);
    assert!(all.warnings.is_empty());
}

#[test]
fn unusable_normals_are_zero() {
    let file = good(&format!("{CORNERS}vn nan 0 0\nvn 0 0 0\nvn 1e-30 0 0\nf 1//1 2//2 3//3\n"));
    assert_eq!(file.meshes[0].0.normals, [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]]);
    assert_eq!(file.warnings.len(), 1);
}

#[test]
fn errors_name_the_line() {
    let text = |tail: &str| bad(format!("{CORNERS}{tail}").as_bytes());
    for (tail, expected) in [
        ("v 1 x 2\nf 1 2 3\n", "a.obj:5: `x` is not a number"),
        ("v 1 1-2 2\nf 1 2 3\n", "a.obj:5: `1-2` is not a number"),
        ("vt - 2\nf 1 2 3\n", "a.obj:5: `-` is not a number"),
        ("v 1 2\n", "a.obj:5: a vertex of 2 numbers"),
        ("v 1 2 3 4 5\n", "a.obj:5: a vertex of 5 numbers"),
        ("v 1 2 3 0\n", "a.obj:5: the vertex's weight 0"),
        ("v 1 nan 3\n", "a.obj:5: NaN is not a number that a vertex can have"),
        ("v 1 -inf 3\n", "a.obj:5: -inf is not"),
        ("v 1 1e39 3\n", "a.obj:5: inf is not"),
        ("v 1 999999999999999999999999999999999999999 3\n", "a.obj:5: inf is not"),
        ("v 0 0 0 nan 1 1\n", "a.obj:5: NaN is not"),
        ("vn 1 2\n", "a.obj:5: a normal of 2 numbers"),
        ("vt\n", "a.obj:5: a texture coordinate of 0 numbers"),
        ("f 1 2 3\nf 1 2\n", "a.obj:6: a face of 2 corners"),
        ("f\n", "a.obj:5: a face of 0 corners"),
        ("f 1 2 0\n", "a.obj:5: index 0 of a vertex"),
        ("f 1 2 5\nf 1 2 3\n", "a.obj:5: index 5 of a vertex, but the last one is 4"),
        ("f 1 2 5\ng x\n", "a.obj:5: index 5 of a vertex, but the last one is 4"),
        ("f 1 2 -5\n", "a.obj:5: relative index -5 of a vertex, but there are 4 before it"),
        ("vt 0 0\nf 1/1 2/2 3/1\n", "a.obj:6: index 2 of a texture coordinate, but the last one is 1"),
        ("f 1//0 2//0 3//0\n", "a.obj:5: index 0 of a normal"),
        ("f 1//-1 2//1 3//1\n", "a.obj:5: relative index -1 of a normal"),
        ("f 1 2 3x\n", "a.obj:5: `3x` is not a corner of a face"),
        ("f 1 2 /1\n", "a.obj:5: `/1` is not a corner"),
        ("f 1 2 3/1/1/1\n", "a.obj:5: "),
        ("f 1 2 -\n", "a.obj:5: `-` is not a corner"),
        ("f 1/9223372036854775807 2 3\n", "a.obj:5: index 9223372036854775807 of a texture coordinate"),
        ("f 1 2 \\\n 3\nf 1 2 \\\n 9\nf 1 2 3", "a.obj:7: index 9"),
        ("f 1 2 99999999999999999999999999\n", "a.obj:5: index 18446744073709551615"),
    ] {
        let text = text(tail);
        assert!(text.starts_with(expected), "{tail:?} gives {text}");
    }
}

#[test]
fn what_is_no_obj_file_is_refused() {
    for empty in ["", "\n\n", "# nothing\n", CORNERS, "p 1\nl 1 2\n", "hello\nworld\n"] {
        assert_eq!(bad(empty.as_bytes()), "a.obj: no triangles; give an OBJ file with faces (`f` lines)");
    }
    let utf16: Vec<u8> = "v 0 0 0\nf 1 1 1\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert!(bad(&utf16).starts_with("a.obj:1: this is not a text file"));
    assert!(bad(&[&[0xff, 0xfe], &utf16[..]].concat()).starts_with("a.obj:1: this is UTF-16"));
    assert!(bad(b"# mac\rv 0 0 0\rf 1 1 1\r").starts_with("a.obj:1: lines end in a lone carriage return"));
    assert!(bad(b"v 0 0 0\nv \xff 0 0\n").starts_with("a.obj:2: `\u{fffd}` is not a number"));
    let folder = folder(&[]);
    assert!(matches!(load(&folder), Err(Error::Read { .. })));
    std::fs::create_dir(folder.path().join("a.obj")).unwrap();
    assert!(matches!(load(&folder), Err(Error::Read { .. })));
}

#[test]
fn names_need_no_utf8() {
    let obj = [CORNERS.as_bytes(), b"mtllib m.mtl\ng d\xe9\nusemtl br\xfbl\xe9 #1\nf 1 2 3\n"].concat();
    let file = load(&folder(&[("a.obj", &obj), ("m.mtl", b"newmtl x\nnewmtl  br\xfbl\xe9 #1 \nKd 0 0 1\n")]))
        .unwrap();
    assert_eq!(file.meshes[0].1, Some(1));
    assert!(file.warnings.is_empty(), "{:?}", file.warnings);
}

/// Folder with the test data, if this machine has it.
fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("HELIOSTAT_DATA")
        .map_or(Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let found = folder.is_dir();
    if !found {
        eprintln!("skipped: no test data in {} (set HELIOSTAT_DATA)", folder.display());
    }
    found.then_some(folder)
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, files);
        } else if path.to_string_lossy().ends_with(".obj") || path.to_string_lossy().ends_with(".obj.xz") {
            files.push(path);
        }
    }
}

/// The file, unpacked beside a copy of its MTL and textures' folder where it is packed.
fn unpacked(path: &Path, temporary: &TempDir) -> Option<PathBuf> {
    if path.extension().is_some_and(|extension| extension == "obj") {
        return Some(path.to_owned());
    }
    let target = temporary.path().join(path.file_stem().unwrap());
    let out = std::fs::File::create(&target).unwrap();
    let done = std::process::Command::new("xz").arg("-dkc").arg(path).stdout(out).status();
    if !done.is_ok_and(|status| status.success()) {
        eprintln!("skipped: {} (no xz)", path.display());
        return None;
    }
    for entry in std::fs::read_dir(path.parent().unwrap()).unwrap() {
        let from = entry.unwrap().path();
        if from.extension().is_some_and(|extension| ["mtl", "jpg"].iter().any(|&e| extension == e)) {
            std::fs::copy(&from, temporary.path().join(from.file_name().unwrap())).unwrap();
        }
    }
    Some(target)
}

#[test]
fn files_of_others_load_or_are_refused_clearly() {
    let Some(data) = data() else { return };
    let mut files = Vec::new();
    for folder in ["cornell", "many", "meshes", "nasty", "sponza", "veach"] {
        collect(&data.join(folder), &mut files);
    }
    assert!(!files.is_empty());
    for path in files {
        let temporary = tempfile::tempdir().unwrap();
        let Some(file) = unpacked(&path, &temporary) else { continue };
        let shown = path.strip_prefix(&data).unwrap().display();
        match read(&file, &mut Textures::default()) {
            Ok(loaded) => {
                let count = triangles(&loaded).len();
                eprintln!(
                    "{shown} | {count} triangles, {} meshes | {:?}",
                    loaded.meshes.len(),
                    loaded.warnings
                );
                check(&loaded);
            }
            Err(error) => {
                let text = error.to_string();
                eprintln!("{shown} | refused | {text}");
                assert!(text.contains(file.file_stem().unwrap().to_str().unwrap()) && !text.contains('\n'));
            }
        }
    }
}

#[test]
fn known_models_have_their_known_counts() {
    let Some(data) = data() else { return };
    for (name, positions, count, materials, warnings) in [
        ("many/sphereflake_7382_objects.obj.xz", 88576, 147622, 3, 0),
        ("meshes/stanford-bunny.obj.xz", 34834, 69451, 0, 0),
        ("meshes/armadillo.obj.xz", 43243, 86482, 0, 0),
        ("meshes/teapot.obj", 3644, 6320, 0, 0),
        ("meshes/suzanne.obj", 0, 968, 0, 0),
        ("sponza/sponza.obj.xz", 0, 66454, 20, 0),
        ("cornell/mcguire/CornellBox-Original.obj", 0, 36, 8, 0),
    ] {
        let temporary = tempfile::tempdir().unwrap();
        let path = data.join(name);
        let Some(file) = unpacked(&path, &temporary) else { continue };
        let mut textures = Textures::default();
        let loaded = read(&file, &mut textures).unwrap();
        assert_eq!(triangles(&loaded).len(), count, "{name}");
        assert_eq!(loaded.materials.len(), materials, "{name}");
        assert_eq!(loaded.warnings.len(), warnings, "{name}: {:?}", loaded.warnings);
        let vertices: usize = loaded.meshes.iter().map(|(mesh, _)| mesh.positions.len()).sum();
        assert!(positions == 0 || vertices == positions, "{name}: {vertices}");
        if name.starts_with("sponza") {
            let textured = loaded.materials.iter().filter(|(_, material)| material.texture.is_some()).count();
            assert!(textured >= 15 && textures.into_vec().len() >= 11, "{textured}");
        }
    }
}

/// What everything that is loaded must hold.
fn check(file: &ObjFile) {
    for (mesh, material) in &file.meshes {
        let vertices = mesh.positions.len();
        assert!(!mesh.triangles.is_empty());
        assert!(mesh.triangles.iter().flatten().all(|&index| (index as usize) < vertices));
        for length in [mesh.normals.len(), mesh.uvs.len(), mesh.colors.len()] {
            assert!(length == 0 || length == vertices);
        }
        let threes = [&mesh.positions, &mesh.normals, &mesh.colors];
        assert!(threes.iter().all(|array| array.iter().flatten().all(|c| c.is_finite())));
        assert!(mesh.uvs.iter().flatten().all(|c| c.is_finite()));
        assert!(material.is_none_or(|index| (index as usize) < file.materials.len()));
    }
    for (name, material) in &file.materials {
        let colors = [material.ka, material.kd, material.ks, material.kr, material.kt, material.emission];
        assert!(colors.iter().flatten().all(|&c| c.is_finite() && c >= 0.0), "{name}: {material:?}");
        assert!(material.ior > 0.0 && material.shininess >= 0.0, "{name}: {material:?}");
    }
}

/// Pieces that OBJ and MTL files are made of, and what breaks them.
fn piece() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec![
        "v",
        "vt",
        "vn",
        "f",
        "l",
        "p",
        "g",
        "o",
        "s",
        "usemtl",
        "mtllib",
        "a.mtl",
        "newmtl",
        "Kd",
        "Ks",
        "Ka",
        "Ke",
        "Ns",
        "Ni",
        "d",
        "Tr",
        "Tf",
        "illum",
        "map_Kd",
        "-s",
        "-o",
        "-halo",
        "a.png",
        "x",
        "0",
        "1",
        "2",
        "3",
        "4",
        "-1",
        "-2",
        "-9",
        "0.5",
        "1e39",
        "nan",
        "-inf",
        "1/1",
        "1//1",
        "1/1/1",
        "-1/-1/-1",
        "/",
        "//",
        "99999999999",
        "18446744073709551615",
        "-9223372036854775808",
        "6148914691236517206",
        "\n",
        "\n",
        "\n",
        "\n",
        "\r\n",
        "\\\n",
        "#",
        " ",
        "\t",
        "\r",
        "\0",
        "\u{feff}",
        "\u{a0}",
        "\u{b}",
        "\u{3000}",
        "é",
        "\"",
        "\\",
        "\nv 0 0 0\n",
        "\nv 1 0 0 1 1 1\n",
        "\nf 1 2 3\n",
        "\nf -1 -2 -3\n",
        "\nusemtl x\n",
        "\nnewmtl x\n",
    ])
}

fn pieces() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec((piece(), prop::bool::weighted(0.8)), 0..60).prop_map(|pieces| {
        let spaced =
            |(piece, space): &(&str, bool)| if *space { format!("{piece} ") } else { piece.to_string() };
        pieces.iter().map(spaced).collect::<String>().into_bytes()
    })
}

/// A valid file in which some bytes are changed, removed or doubled.
fn mutated(text: &'static str) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec((0..text.len(), any::<u8>(), 0..4), 0..6).prop_map(move |changes| {
        let mut bytes = text.as_bytes().to_vec();
        for (at, byte, how) in changes {
            let at = at.min(bytes.len().saturating_sub(1));
            match how {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                2 => bytes.truncate(at.max(40)),
                _ => bytes[at] = b"0123456789-/. \n"[usize::from(byte) % 15],
            }
        }
        bytes
    })
}

const VALID_OBJ: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1e-1\nvt 0 0\nvt 1 0\nvn 0 0 1\ng one\n\
    usemtl x\nf 1/1/1 2/2/1 3/1/1 4/2/1\nusemtl y\nf -4//-1 -3//-1 -2//-1\nl 1 2 3\nf 1 2 4\n";
const VALID_MTL: &str = "newmtl x\nKa 0.1 0.1 0.1\nKd 0.5 0.5 0.5\nKs 1 1 1\nNs 20\nNi 1.5\nd 0.5\nTr 0.5\nillum 7\n\
    map_Kd -s 1 1 1 a.png\nnewmtl y\nKd 1 0 0\nKe 2 2 2\nTf 1 0.5 1\nillum 4\nTr 0.25\n";

fn survives(obj: &[u8], mtl: &[u8]) -> std::result::Result<(), TestCaseError> {
    let folder = folder(&[("a.obj", obj), ("a.mtl", mtl)]);
    match load(&folder) {
        Ok(file) => check(&file),
        Err(error) => {
            let text = error.to_string();
            prop_assert!(text.contains("a.obj") || text.contains("a.mtl"), "{}", text);
            prop_assert!(!text.contains('\n'), "{}", text);
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn random_bytes_never_panic(obj in prop::collection::vec(any::<u8>(), 0..300), mtl in pieces()) {
        survives(&obj, &mtl)?;
    }

    #[test]
    fn random_statements_never_panic(obj in pieces(), mtl in pieces()) {
        survives(&obj, &mtl)?;
        survives(&[VALID_OBJ.as_bytes(), &obj].concat(), &mtl)?;
    }

    #[test]
    fn damaged_files_never_panic(obj in mutated(VALID_OBJ), mtl in mutated(VALID_MTL)) {
        survives(&obj, VALID_MTL.as_bytes())?;
        survives(VALID_OBJ.as_bytes(), &mtl)?;
    }

    /// However statements are mixed, the triangles are those of the faces in their order.
    #[test]
    fn ids_follow_the_file(statements in prop::collection::vec(0..8usize, 1..60)) {
        let mut obj = String::from("mtllib a.mtl\nvn 0 0 1\nvt 0 0\n");
        let mut expected = Vec::new();
        for (n, statement) in statements.iter().enumerate() {
            obj.push_str(&format!("v {n} 0 0\nv {n} 1 0\nv {n} 0 1\nv {n} 1 1\n"));
            let (text, count) = match statement {
                0 => ("f -4 -3 -2\n", 1),
                1 => ("f -4//1 -3//1 -2//1 -1//1\n", 2),
                2 => ("f -4/1 -3/1 -2/1 -1/1 -2/1\n", 3),
                3 => ("l -4 -3 -2\np -1\n", 0),
                4 => ("usemtl x\n", 0),
                5 => ("usemtl y\nusemtl none\n", 0),
                6 => ("usemtl x\ng x\ng\no y\n", 0),
                _ => ("f -4 -3/1/1 -3\n", 1),
            };
            obj.push_str(text);
            expected.extend(std::iter::repeat_n(n as f32, count));
        }
        match load(&folder(&[("a.obj", obj.as_bytes()), ("a.mtl", VALID_MTL.as_bytes())])) {
            Ok(file) => prop_assert_eq!(order(&file), expected),
            Err(_) => prop_assert!(expected.is_empty()),
        }
    }
}
