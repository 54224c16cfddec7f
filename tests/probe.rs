//! `heliostat probe` as its users meet it: binary files in and out, judged by brute force and by answers known beforehand.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use glam::DVec3;
use heliostat::scene::generate::icosphere::icosphere;

const INFINITY: f32 = f32::INFINITY;

fn heliostat(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_heliostat"))
        .current_dir(folder)
        .args(arguments)
        .env_remove("HELIOSTAT_ACCEL")
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Writes the records, asks, and gives the answers' bytes.
fn ask(folder: &Path, question: &str, mesh: Option<&str>, input: &[u8], more: &[&str]) -> Vec<u8> {
    std::fs::write(folder.join("in.bin"), input).unwrap();
    let mut arguments = vec!["probe", question, "--input", "in.bin", "--output", "out.bin"];
    arguments.extend(mesh.iter().flat_map(|mesh| ["--mesh", mesh]));
    arguments.extend(more);
    let output = heliostat(folder, &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(output.stdout.is_empty());
    std::fs::read(folder.join("out.bin")).unwrap()
}

fn bytes<const N: usize>(records: &[[f32; N]]) -> Vec<u8> {
    records.as_flattened().iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn words(bytes: &[u8]) -> Vec<i32> {
    bytes.as_chunks().0.iter().map(|&word| i32::from_le_bytes(word)).collect()
}

/// (primitive, t), one after the other.
fn hits(bytes: &[u8]) -> Vec<(i32, f32)> {
    let words = words(bytes);
    words.as_chunks().0.iter().map(|&[primitive, t]| (primitive, f32::from_bits(t as u32))).collect()
}

/// A plain generator: the same rays in every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        self.0 >> 33
    }

    /// In [-1, 1].
    fn signed(&mut self) -> f32 {
        (self.next() as f64 / f64::from(1u32 << 30) - 1.0) as f32
    }

    fn point(&mut self) -> [f32; 3] {
        std::array::from_fn(|_| self.signed())
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.next() as usize % from.len()]
    }
}

/// A closed mesh with outward triangles: its file, corners and faces.
fn write_icosphere(path: &Path, level: u32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let mesh = icosphere(level, DVec3::new(0.25, -0.5, 0.125), 0.75);
    let mut obj = String::new();
    for [x, y, z] in &mesh.positions {
        writeln!(obj, "v {x} {y} {z}").unwrap();
    }
    for face in &mesh.triangles {
        let [a, b, c] = face.map(|index| index + 1);
        writeln!(obj, "f {a} {b} {c}").unwrap();
    }
    std::fs::write(path, obj).unwrap();
    (mesh.positions, mesh.triangles)
}

/// Polygons, groups and materials in turn, triangles without area, forward and backward references; the planes z = 1 … 7 over the
/// square [0, 4]².
const LAYERS: &str = "\
o first
v 0 0 1
v 4 0 1
v 4 4 1
v 0 4 1
f 1 2 3 4
f 1 1 2
usemtl red
v 0 0 2
v 4 0 2
v 4 4 2
v 0 4 2
f -4/1 -3/1 -2/1
vt 0 0
f 5 7 8
g second
v 0 0 3
v 4 0 3
v 4 2 3
v 4 4 3
v 0 4 3
usemtl blue
f 9 10 11 12 13
f 9 10 10
usemtl red
f 1 3 2
";

fn up(x: f32, y: f32) -> [f32; 8] {
    [x, y, 0.0, 0.0, 0.0, 0.0, 1.0, INFINITY]
}

#[test]
fn primitives_are_numbered_as_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.obj"), LAYERS).unwrap();
    // 0, 1: the quad at z = 1. 2: no area. 3, 4: z = 2. 5, 6, 7: the fan at z = 3. 8: no area. 9: on 0, turned round.
    let from = |z: f32, x: f32, y: f32| [x, y, z, 0.0, 0.0, 0.0, 0.5, INFINITY];
    let rays = [
        from(0.0, 3.0, 1.0),
        from(0.0, 1.0, 3.0),
        from(1.5, 3.0, 1.0),
        from(1.5, 1.0, 3.0),
        from(2.5, 3.0, 0.5),
        from(2.5, 3.5, 2.5),
        from(2.5, 1.0, 3.0),
        from(3.5, 1.0, 3.0),
        from(0.0, 5.0, 1.0),
        [3.0, 1.0, 2.5, 0.0, 0.0, 0.0, -1.0, INFINITY],
    ];
    let expected = [
        (0, 2.0),
        (1, 2.0),
        (3, 1.0),
        (4, 1.0),
        (5, 1.0),
        (6, 1.0),
        (7, 1.0),
        (-1, INFINITY),
        (-1, INFINITY),
        (3, 0.5),
    ];
    for accel in ["bvh", "brute"] {
        let found = ask(folder.path(), "rays", Some("m.obj"), &bytes(&rays), &["--accel", accel]);
        assert_eq!(hits(&found), expected, "{accel}");
        let chains = ask(
            folder.path(),
            "chain",
            Some("m.obj"),
            &bytes(&[up(3.0, 1.0), up(1.0, 3.0), up(9.0, 9.0)]),
            &["--accel", accel],
        );
        // 0, 9, 3, 6 or 5; and 1, 4, 7.
        assert_eq!(words(&chains), [4, 4, 0, 0, 3, 3, 0, 0, 0, 0, 0, 0], "{accel}");
    }
}

#[test]
fn chains_through_stacks_and_duplicates() {
    let folder = tempfile::tempdir().unwrap();
    let mut obj = String::new();
    for layer in 0..50 {
        // Every fifth quad stands three times in the same place.
        for _ in 0..if layer % 5 == 0 { 3 } else { 1 } {
            for (x, y) in [(0, 0), (2, 0), (2, 2), (0, 2)] {
                writeln!(obj, "v {x} {y} {}", 1.0 + f64::from(layer) * 0.1).unwrap();
            }
            obj += "f -4 -3 -2 -1\n";
        }
    }
    std::fs::write(folder.path().join("stack.obj"), obj).unwrap();
    // Through one triangle of each quad; through the diagonal, both; straight, slanted, grazing.
    let slanted = |x: f32, y: f32| [x, y, 0.0, 0.0, 0.01, -0.005, 1.0, INFINITY];
    let rays = [up(1.5, 0.5), up(1.0, 1.0), slanted(1.5, 0.5), [0.5, 1.0, 0.5, 0.5, 0.0, 0.0, 1.0, 0.5]];
    for accel in ["bvh", "brute"] {
        let found = ask(folder.path(), "chain", Some("stack.obj"), &bytes(&rays), &["--accel", accel]);
        assert_eq!(words(&found), [70, 70, 0, 0, 140, 70, 0, 0, 70, 70, 0, 0, 3, 3, 0, 0], "{accel}");
    }
}

/// Rays aimed at corners, edges and faces of a closed mesh, with every kind of awkward number.
fn awkward_rays(positions: &[[f32; 3]], faces: &[[u32; 3]], count: usize) -> Vec<[f32; 11]> {
    let mut numbers = Numbers(7);
    let odd = [0.0, -0.0, 1e-45, -1e-45, 1e-38, 1.0, -1.0, 3e38, -3e38, 1e-10, f32::NAN, INFINITY];
    (0..count)
        .map(|_| {
            let face = numbers.pick(faces).map(|index| positions[index as usize]);
            let aim: [f32; 3] = match numbers.next() % 3 {
                0 => face[0],
                1 => std::array::from_fn(|k| 0.5 * (face[0][k] + face[1][k])),
                _ => std::array::from_fn(|k| (face[0][k] + face[1][k] + face[2][k]) / 3.0),
            };
            let far = numbers.pick(&[0.5f32, 3.0, 1e3, 1e6]);
            let mut origin = numbers.point().map(|c| c * far);
            let length = numbers.pick(&[1.0f32, 1e-30, 1e30]);
            let mut direction: [f32; 3] = std::array::from_fn(|k| (aim[k] - origin[k]) * length);
            match numbers.next() % 6 {
                // Along an axis.
                0 => {
                    let axis = numbers.next() as usize % 3;
                    origin = aim;
                    origin[axis] = numbers.pick(&[-5.0f32, 5.0]);
                    direction = [numbers.pick(&[0.0, -0.0]); 3];
                    direction[axis] = -origin[axis];
                }
                1 => direction[numbers.next() as usize % 3] = numbers.pick(&odd),
                2 => origin[numbers.next() as usize % 3] = numbers.pick(&odd),
                _ => {}
            }
            let t_min = numbers.pick(&[0.0f32, 0.0, 0.0, -1.0, 0.5, f32::NAN, f32::NEG_INFINITY]);
            let t_max = numbers.pick(&[INFINITY, INFINITY, 1.0, 1e30, -2.0]);
            let [wx, wy, wz] = numbers.point();
            let w =
                [wx, wy, wz].map(|c| if numbers.next().is_multiple_of(8) { numbers.pick(&odd) } else { c });
            let ([ox, oy, oz], [dx, dy, dz]) = (origin, direction);
            [ox, oy, oz, t_min, dx, dy, dz, t_max, w[0], w[1], w[2]]
        })
        .collect()
}

#[test]
fn every_accelerator_and_number_of_threads_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (positions, faces) = write_icosphere(&folder.path().join("ball.obj"), 2);
    let spawned = awkward_rays(&positions, &faces, 30_000);
    let plain: Vec<[f32; 8]> = spawned.iter().map(|ray| std::array::from_fn(|number| ray[number])).collect();
    for (question, input) in [("rays", bytes(&plain)), ("chain", bytes(&plain)), ("spawn", bytes(&spawned))] {
        let run = |more: &[&str]| ask(folder.path(), question, Some("ball.obj"), &input, more);
        let expected = run(&["--accel", "brute", "--threads", "1"]);
        let hit = words(&expected).iter().step_by(2).filter(|&&word| word > 0).count();
        assert!(hit > 5_000, "only {hit} rays of {question} hit");
        assert!(run(&["--accel", "bvh", "--threads", "2"]) == expected, "{question}: bvh differs");
        assert!(run(&["--accel", "bvh", "--threads", "3"]) == expected, "{question}: threads differ");
    }
}

#[test]
fn more_records_than_are_held_at_once_come_in_order() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let rays: Vec<[f32; 8]> =
        (0..150_001).map(|n| [0.25, 0.25, -(n as f32), 0.0, 0.0, 0.0, 1.0, INFINITY]).collect();
    let found = hits(&ask(folder.path(), "rays", Some("m.obj"), &bytes(&rays), &[]));
    assert_eq!(found.len(), rays.len());
    assert!(found.iter().enumerate().all(|(n, &hit)| hit == (0, n as f32)));
    assert!(ask(folder.path(), "rays", Some("m.obj"), &[], &[]).is_empty());
}

#[test]
fn closed_meshes_have_no_leak_and_no_self_hit() {
    let folder = tempfile::tempdir().unwrap();
    let (positions, faces) = write_icosphere(&folder.path().join("ball.obj"), 3);
    let center = [0.25f32, -0.5, 0.125];
    let mut numbers = Numbers(3);
    let mut rays: Vec<[f32; 11]> = Vec::new();
    for face in &faces {
        let corners = face.map(|index| positions[index as usize].map(f64::from));
        let normal = (DVec3::from(corners[1]) - DVec3::from(corners[0]))
            .cross(DVec3::from(corners[2]) - DVec3::from(corners[0]));
        for edge in 0..3 {
            // From the centre to a corner, or to a point of an edge: out there, away from the ball and back into it.
            let weight = numbers.pick(&[0.0, 0.5, 0.25, 0.123, 1.0]);
            let (a, b) = (DVec3::from(corners[edge]), DVec3::from(corners[(edge + 1) % 3]));
            let aim = a + (b - a) * weight;
            let outward = aim - DVec3::from(center.map(f64::from));
            let tangent = DVec3::from(numbers.point().map(f64::from)).cross(outward);
            for (w, sign) in
                [(outward, 1.0), (outward + tangent, 1.0), (normal, 1.0), (outward + tangent * 0.5, -1.0)]
            {
                let [wx, wy, wz] = (w * sign).to_array().map(|c| c as f32);
                let [dx, dy, dz] = outward.to_array().map(|c| c as f32);
                rays.push([center[0], center[1], center[2], 0.0, dx, dy, dz, INFINITY, wx, wy, wz]);
            }
        }
    }
    let found = hits(&ask(folder.path(), "spawn", Some("ball.obj"), &bytes(&rays), &[]));
    let mut bad = 0;
    for (index, pair) in found.as_chunks::<2>().0.iter().enumerate() {
        let [(first, t), (second, onward)] = *pair;
        assert!(first >= 0 && (t - 1.0).abs() < 1e-3, "leak at {:?}: {first} {t}", rays[index]);
        if index % 4 == 3 {
            // Inwards: the far side, at about one diameter.
            assert!(second >= 0 && second != first && onward > 0.1, "{second} {onward} at {:?}", rays[index]);
        } else if second != -1 {
            bad += 1;
        }
    }
    assert_eq!(bad, 0, "self-hits of {}", rays.len());
}

#[test]
fn the_start_is_left_out_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    // Two floors one f32 step apart, and a copy of the lower one.
    let above = 1.0f32.next_up();
    let mut obj = String::new();
    for z in [1.0, above, 1.0] {
        writeln!(obj, "v 0 0 {z}\nv 4 0 {z}\nv 0 4 {z}\nf -3 -2 -1").unwrap();
    }
    std::fs::write(folder.path().join("m.obj"), obj).unwrap();
    let from = |z: f32, d: f32, w: f32| [1.0, 1.0, z, 0.0, 0.0, 0.0, d, INFINITY, 0.0, 0.0, w];
    let rays = [
        from(0.0, 1.0, 1.0),
        from(0.0, 1.0, -1.0),
        from(3.0, -1.0, -1.0),
        from(3.0, -1.0, 1.0),
        from(5.0, 1.0, 1.0),
    ];
    let found = hits(&ask(folder.path(), "spawn", Some("m.obj"), &bytes(&rays), &[]));
    let (step, far) = (above - 1.0, 2.0 - (above - 1.0));
    let miss = (-1, INFINITY);
    let expected =
        [[(0, 1.0), (1, step)], [(0, 1.0), miss], [(1, far), (0, step)], [(1, far), miss], [miss, miss]];
    assert_eq!(found, expected.as_flattened());
}

#[test]
fn spheres_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let records: [[f64; 11]; 6] = [
        [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 4.5],
        [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 6.5],
        // A floor of radius 10^10 from 1 above.
        [0.0, -1e10, 0.0, 1e10, 0.0, 1.0, 0.0, 0.0, -4.0, 0.0, 0.0],
        // From its inside.
        [1.0, 2.0, 3.0, 2.0, 1.0, 2.0, 3.0, 0.0, 0.5, 0.0, 0.0],
        [0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0, -2.0, 0.0, 0.0, 1.0, 0.0],
    ];
    let input: Vec<u8> = records.as_flattened().iter().flat_map(|number| number.to_le_bytes()).collect();
    let found = ask(folder.path(), "spheres", None, &input, &[]);
    let found: Vec<f64> = found.as_chunks().0.iter().map(|&word| f64::from_le_bytes(word)).collect();
    assert_eq!([found[0], found[1], found[2], found[4], found[5]], [4.0, 6.0, -1.0, 4.0, -1.0]);
    assert!((found[3] - 0.25).abs() < 1e-5, "{}", found[3]);
}

#[test]
fn broken_inputs_are_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).unwrap();
    write("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    write("bad.obj", b"v 0 0 0\nv 1 0 x\nv 0 1 0\nf 1 2 3\n");
    write("short.bin", &[0; 33]);
    write("good.bin", &[0; 64]);
    let files = ["--input", "good.bin", "--output", "out.bin"];
    let refuses = |arguments: &[&str], code: i32, hints: &[&str]| {
        let output = heliostat(folder.path(), &[&["probe"], arguments].concat());
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(error.starts_with("heliostat: ") && !error.contains("panicked"), "{error}");
        for hint in hints {
            assert!(error.contains(hint), "{arguments:?}: no {hint:?} in {error}");
        }
        let count = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(count, 4, "{arguments:?} left files");
    };
    let rays = ["rays", "--mesh", "m.obj"];
    for question in ["rays", "chain", "spawn"] {
        let arguments = [question, "--mesh", "m.obj", "--input", "short.bin", "--output", "out.bin"];
        refuses(&arguments, 1, &["short.bin", "33 bytes"]);
    }
    refuses(&["spheres", "--input", "good.bin", "--output", "out.bin"], 1, &["good.bin", "64 bytes", "88"]);
    refuses(&[&rays[..], &["--input", "no.bin", "--output", "out.bin"]].concat(), 1, &["no.bin: can't read"]);
    refuses(&[&rays[..], &["--input", ".", "--output", "out.bin"]].concat(), 1, &[".: can't read"]);
    refuses(&[&rays[..], &["--input", "good.bin", "--output", "no/out.bin"]].concat(), 1, &["no/out.bin"]);
    refuses(&[&["rays", "--mesh", "bad.obj"], &files[..]].concat(), 1, &["bad.obj:2", "`x`"]);
    refuses(&[&["rays", "--mesh", "no.obj"], &files[..]].concat(), 1, &["no.obj: can't read"]);
    refuses(&[&["rays"], &files[..]].concat(), 2, &["--mesh"]);
    refuses(&[&["spheres", "--mesh", "m.obj"], &files[..]].concat(), 2, &["--mesh", "leave it out"]);
    refuses(&[&rays[..], &files[..], &["--accel", "magic"]].concat(), 2, &["magic", "brute"]);
    refuses(&[&rays[..], &files[..], &["--threads", "0"]].concat(), 2, &["--threads"]);
    refuses(&rays, 2, &["--input", "--output"]);
}

#[test]
#[cfg(unix)]
fn a_pipe_is_read_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let ray = bytes(&[[0.25f32, 0.25, -3.0, 0.0, 0.0, 0.0, 1.0, INFINITY]]);
    let ask_pipe = |input: &[u8]| {
        use std::io::Write;
        use std::process::Stdio;
        let mut child = Command::new(env!("CARGO_BIN_EXE_heliostat"))
            .current_dir(folder.path())
            .args(["probe", "rays", "--mesh", "m.obj", "--input", "/dev/stdin", "--output", "out.bin"])
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        child.wait_with_output().unwrap()
    };
    assert!(ask_pipe(&ray).status.success());
    let answer = folder.path().join("out.bin");
    assert_eq!(hits(&std::fs::read(&answer).unwrap()), [(0, 3.0)]);
    std::fs::remove_file(&answer).unwrap();
    let output = ask_pipe(&ray[..30]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("/dev/stdin: 30 bytes are no whole number"),
        "{}",
        text(&output.stderr)
    );
    assert!(!answer.exists());
}

#[test]
fn help_and_manual_describe_the_formats() {
    let folder = tempfile::tempdir().unwrap();
    let help = text(&heliostat(folder.path(), &["probe", "--help"]).stdout);
    for part in
        ["f32[11]", "f64[11]", "little endian", "floor(primitive / 2)", "-1 and t = +inf", "HELIOSTAT_ACCEL"]
    {
        assert!(help.contains(part), "no {part:?} in {help}");
    }
    assert!(heliostat(folder.path(), &["man", "--dir", "."]).status.success());
    let page = std::fs::read_to_string(folder.path().join("heliostat-probe.1")).unwrap();
    assert!(page.contains("f32[11]"), "{page}");
}
