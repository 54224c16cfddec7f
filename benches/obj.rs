//! Reading an OBJ file of a million triangles beside `tobj` alone, without and with normals and texture coordinates:
//! `cargo bench --bench obj` prints the median of the ratios.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use heliostat::scene::load::obj;
use heliostat::scene::load::texture::Textures;

/// Vertices along an edge: 2 (N - 1)^2 triangles.
const N: usize = 708;
const ROUNDS: usize = 7;

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("grid.obj");
    for full in [false, true] {
        std::fs::write(&path, grid(full)).expect("room for the file");
        let mut rounds: Vec<[f64; 3]> = (0..ROUNDS).map(|_| round(&path)).collect();
        rounds.sort_by(|a, b| a[2].total_cmp(&b[2]));
        let [alone, here, ratio] = rounds[ROUNDS / 2];
        let what = if full { "positions, normals, uvs" } else { "positions only" };
        println!("{what:24} tobj {alone:.3} s, heliostat {here:.3} s, median ratio {ratio:.2}");
    }
}

/// Seconds of `tobj`, seconds of ours, and their ratio.
fn round(path: &Path) -> [f64; 3] {
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ..tobj::LoadOptions::default() };
    let start = Instant::now();
    let (models, _) = tobj::load_obj(path, &options).expect("a good file");
    let alone = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let file = obj::read(path, &mut Textures::default()).expect("a good file");
    let here = start.elapsed().as_secs_f64();
    assert_eq!(models[0].mesh.indices.len() / 3, file.meshes[0].0.triangles.len());
    [alone, here, here / alone]
}

fn grid(full: bool) -> String {
    let mut obj = String::new();
    let mut line = |text: std::fmt::Arguments| obj.write_fmt(text).expect("a string takes everything");
    for i in 0..N {
        for j in 0..N {
            let (x, y) = (i as f32 * 0.013, j as f32 * 0.017);
            line(format_args!("v {x:.6} {y:.6} {:.6}\n", x * y));
            if full {
                line(format_args!("vt {x:.6} {y:.6}\nvn 0.000000 0.000000 1.000000\n"));
            }
        }
    }
    for i in 0..N - 1 {
        for j in 1..N {
            let (a, b) = (i * N + j, (i + 1) * N + j);
            for [a, b, c] in [[a, b, a + 1], [b, b + 1, a + 1]] {
                match full {
                    true => line(format_args!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\n")),
                    false => line(format_args!("f {a} {b} {c}\n")),
                }
            }
        }
    }
    obj
}
