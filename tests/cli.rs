//! The program as a user meets it: good commands, wrong ones, and what they leave behind.

mod common;

use std::path::Path;
use std::process::{Command, Output};

use common::repository;

fn heliostat(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    command.current_dir(folder).args(arguments).env_remove("HELIOSTAT_OUTPUT");
    command.output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn scene(name: &str) -> String {
    repository().join("scenes").join(name).display().to_string()
}

/// Fails, says one thing on standard error that holds each of `hints`, prints nothing else and writes nothing.
fn refuses(arguments: &[&str], code: i32, hints: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    refuses_in(folder.path(), arguments, code, hints);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{arguments:?} left files");
}

fn refuses_in(folder: &Path, arguments: &[&str], code: i32, hints: &[&str]) {
    let output = heliostat(folder, arguments);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
    assert!(error.starts_with("heliostat: "), "{error}");
    assert!(!error.contains("panicked"), "{error}");
    for hint in hints {
        assert!(error.contains(hint), "{arguments:?}: no {hint:?} in {error}");
    }
    assert!(output.stdout.is_empty());
}

#[test]
fn renders_under_the_scenes_name_by_default() {
    let folder = tempfile::tempdir().unwrap();
    let output = heliostat(folder.path(), &["render", &scene("orthographic.toml"), "--width", "32"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(output.stdout.is_empty());
    assert!(text(&output.stderr).contains("wrote orthographic.png"));
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["orthographic.png"]);
}

#[test]
fn a_converted_scene_is_rendered_as_the_scene_itself() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let output = heliostat(folder.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
        (text(&output.stdout), text(&output.stderr))
    };
    let textured = scene("textured.toml");
    let (_, said) = run(&["convert", &textured]);
    assert!(said.contains("wrote textured.helio: ") && said.contains(" triangles, 0 spheres"), "{said}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    run(&["render", &textured, "--width", "50", "-q", "-o", "a.png"]);
    run(&["render", "textured.helio", "--width", "50", "-q", "-o", "b.png"]);
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(read("a.png") == read("b.png"));
    assert_eq!(run(&["info", "--json", "textured.helio"]).0, run(&["info", "--json", &textured]).0);
    assert_eq!(run(&["validate", "textured.helio"]).0, "textured.helio: good\n");
    // Onto itself, from itself.
    let first = read("textured.helio");
    assert_eq!(run(&["convert", "-q", "textured.helio", "-o", "textured.helio"]), Default::default());
    assert!(read("textured.helio") == first);

    let mut damaged = first.clone();
    damaged[1000] ^= 1;
    std::fs::write(folder.path().join("damaged.helio"), damaged).unwrap();
    std::fs::write(folder.path().join("short.helio"), &first[..first.len() / 2]).unwrap();
    let anew = "convert the scene anew";
    refuses_in(folder.path(), &["render", "damaged.helio"], 1, &["damaged.helio: its section", anew]);
    refuses_in(folder.path(), &["validate", "short.helio"], 1, &["short.helio: it has ", anew]);
}

#[test]
fn conversions_that_cant_end_well_dont_begin() {
    refuses(&["convert", &scene("glass.toml"), "-o", "glass.png"], 2, &["--output: glass.png", ".helio"]);
    refuses(
        &["convert", &scene("glass.toml"), "-o", "no/a.helio"],
        1,
        &["no/a.helio", "create its folder first"],
    );
    refuses(&["convert", "no.toml"], 1, &["no.toml: can't read"]);
}

#[test]
fn formats_hold_the_same_image_and_files_are_the_same_bytes_again() {
    let folder = tempfile::tempdir().unwrap();
    let spheres = scene("orthographic.toml");
    let flags = ["render", &spheres, "--width", "40", "--spp", "3", "-q"];
    let run = |outputs: &[&str], more: &[&str]| {
        let arguments: Vec<&str> = flags
            .iter()
            .copied()
            .chain(outputs.iter().flat_map(|o| ["-o", o]))
            .chain(more.iter().copied())
            .collect();
        let output = heliostat(folder.path(), &arguments);
        assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
        output.stdout
    };
    run(&["a.png", "a.exr", "a.pfm"], &["--threads", "1"]);
    let piped = run(&["-", "b.exr", "b.PFM"], &["--threads", "2", "--tile-size", "7"]);
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(piped, read("a.png"));
    assert_eq!(read("a.exr"), read("b.exr"));
    assert_eq!(read("a.pfm"), read("b.PFM"));
    let compare = |a: &str, b: &str, limit: &str| {
        heliostat(folder.path(), &["compare", a, b, "--max-difference", limit]).status.code()
    };
    assert_eq!(compare("a.exr", "b.PFM", "0"), Some(0));
    assert_eq!(compare("a.exr", "a.png", "0.2"), Some(0));
    run(&["other.png"], &["--seed", "5", "--max-depth", "0"]);
    assert_eq!(compare("a.png", "other.png", "0.0001"), Some(1));
    let error = text(&heliostat(folder.path(), &["compare", "a.png", "other.png", "--max-rmse", "0"]).stderr);
    assert!(error.contains("other.png differs too much: RMSE"), "{error}");
}

#[test]
fn bounds_are_shown_by_every_structure_alike() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("teapot.toml");
    let show = |output: &str, more: &[&str]| {
        let flags = ["render", &scene, "--width", "60", "-o", output];
        let output = heliostat(folder.path(), &[&flags, more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let bounds = ["--show", "bounds", "--accel"];
    assert!(!show("scene.png", &[]).contains("warning"));
    // The table's sphere is all around.
    assert!(show("bvh.png", &[&bounds[..], &["bvh"]].concat()).contains("which are left out: 1"));
    show("spheres.png", &[&bounds[..], &["spheres"]].concat());
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(read("bvh.png") == read("spheres.png"));
    let output = heliostat(folder.path(), &["compare", "scene.png", "bvh.png", "--max-rmse", "0.02"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
}

#[test]
fn strategies_are_measured_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["bench", "strategies", "--levels", "0,2", "--objects", "3", "--side", "16", "--rounds", "1"];
    let run = |more: &[&str]| {
        let output = heliostat(folder.path(), &[&flags, more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let table = run(&["--threads", "2", "--plot", "plot.svg"]);
    assert_eq!(table.lines().count(), 2 + 2 * 3, "{table}");
    assert!(table.contains("      960  spheres") && !table.contains("left out"), "{table}");
    let svg = std::fs::read_to_string(folder.path().join("plot.svg")).unwrap();
    assert_eq!(svg.matches("<polyline").count(), 9);
    // All that takes time at all takes too long.
    let json = run(&["--json", "--accel", "brute,grid", "--limit", "1e-9"]);
    let rows: Vec<serde_json::Value> = json.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(rows.len(), 2 * 2 * 3);
    assert!(rows.iter().all(|row| row["seconds"].is_null() && row["left_out_s"].as_f64() > Some(0.0)));
    refuses(&["bench", "strategies", "--levels", "12"], 2, &["--levels", "0..=11"]);
    refuses(&["bench", "strategies", "--limit", "0"], 2, &["--limit", "above 0"]);
    refuses(&["bench", "strategies", "--plot", "no/such/a.svg"], 1, &["no/such"]);
}

#[test]
fn error_against_time_is_measured_written_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let (path, whitted) = (scene("cornell-path.toml"), scene("orthographic.toml"));
    let small = ["bench", "error", "--width", "16", "--height", "12", "--seeds", "2", "--rounds", "1"];
    let run = |more: &[&str]| {
        let output = heliostat(folder.path(), &[&small[..], more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        (text(&output.stdout), text(&output.stderr))
    };
    let flags =
        ["--samplers", "independent,sobol", "--reference-spp", "64", "--cache", "kept", "--limit", "1e6"];
    let files = ["--csv", "a.csv", "--json", "a.json", "--svg", "a.svg"];
    let (table, said) = run(&[&[&*path, &*whitted][..], &flags, &files, &["--max-spp", "16"]].concat());
    assert!(table.contains("cornell-path: 16 × 12, path") && table.contains("slope -0."), "{table}");
    assert!(said.contains("cornell-path: rendering a reference of 64 samples per pixel"), "{said}");
    let csv = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    let cells: Vec<usize> = csv.lines().map(|line| line.split(',').count()).collect();
    // Two curves each of 4 and 16 samples, without paths of 1, too.
    assert_eq!(cells, vec![cells[0]; 1 + 2 * 2 + 2 * 3], "{csv}");
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap()
    };
    let json = read("a.json");
    assert_eq!((&json["ranks"], &json["scenes"][1]["integrator"]), (&1.into(), &"whitted".into()));
    let first = &json["scenes"][0]["curves"][0];
    assert_eq!((&first["sampler"], &first["rungs"][1]["spp"]), (&"independent".into(), &16.into()));
    assert!(first["rungs"][1]["rmse"].as_f64() < first["rungs"][0]["rmse"].as_f64());
    for name in ["a-cornell-path.svg", "a-orthographic.svg"] {
        let svg = std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(svg.matches("<polyline").count() == 2 && svg.contains("on the Pareto front"), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path().join("kept")).unwrap().count(), 2);

    let more = [
        "--adaptive",
        "--targets",
        "0.3",
        "--spp",
        "4",
        "--filters",
        "box,tent",
        "--accels",
        "bvh,grid",
        "--precisions",
        "exact,f32",
    ];
    let (table, said) = run(&[&[&*path][..], &flags, &more, &["--json", "b.json"]].concat());
    // That of the box filter is kept.
    assert_eq!(said.lines().count(), 1, "{said}");
    for name in ["sobol tent grid exact adaptive", "sobol box bvh f32"] {
        assert!(table.contains(name), "{name} in {table}");
    }
    assert_eq!(read("b.json")["scenes"][0]["curves"].as_array().unwrap().len(), 2 * 2 * 3 * 2);

    refuses(&["bench", "error"], 2, &["SCENE", "no scenes/cornell-path.toml here", "name a scene"]);
    refuses(&["bench", "error", &path, "--samplers", "halton"], 2, &["--samplers", "sobol"]);
    refuses(&["bench", "error", &path, "--reference-spp", "7"], 2, &["--reference-spp", "8..=65536"]);
    refuses(&["bench", "error", &path, "--targets", "0.1"], 2, &["--adaptive"]);
    refuses(&["bench", "error", &path, "--csv", "no/such/a.csv"], 1, &["no/such"]);
    refuses(&["bench", "error", "nowhere.toml"], 1, &["nowhere.toml"]);
}

#[test]
fn means_are_tested_by_the_variances_of_exr_layers() {
    use heliostat::image::{Image, Layer};
    use heliostat::output::write::{Target, WriteOptions, write_with_layers};
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, value: f32, layers: &[Layer]| {
        let image = Image { width: 8, height: 4, pixels: vec![[value; 3]; 32] };
        let target = Target::parse(folder.path().join(name).to_str().unwrap()).unwrap();
        write_with_layers(&image, layers, &target, &WriteOptions::default()).unwrap();
    };
    // The mean of 32 pixels of deviation 0.1 has the standard error 0.0177, the pixels' own is 0.1.
    write("reference.exr", 0.5, &[]);
    write("sound.exr", 0.52, &[Layer::variance(vec![[0.01; 3]; 32]), Layer::depth(vec![1.0; 32])]);
    write("biased.exr", 0.6, &[Layer::variance(vec![[0.01; 3]; 32])]);
    write("reference.png", 0.5, &[]);
    let compare = |test: &str, more: &[&str]| {
        heliostat(folder.path(), &[&["compare", "reference.exr", test, "--min-p", "0.01"], more].concat())
    };

    let output = compare("sound.exr", &["--json", "--heat-map", "map.png", "--max-hdr-flip", "0.5"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("wrote map.png: root mean square"));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let z = json["z_test"]["z"][1].as_f64().unwrap();
    assert!((z - 0.02 / 0.1 * 32_f64.sqrt()).abs() < 1e-4, "{z}");
    assert!(json["hdr_flip"].as_f64().unwrap() > 0.0);
    let map = heliostat::output::read::read(&folder.path().join("map.png")).unwrap();
    assert_eq!((map.width, map.height), (8, 4));

    let output = compare("biased.exr", &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("biased.exr differs too much: the means' p"));
    let table = text(&output.stdout);
    assert!(table.contains("z +5.657") && table.contains("pixels    0 beyond 1 %"), "{table}");

    let none = compare("reference.png", &[]);
    assert_eq!(none.status.code(), Some(2));
    assert!(text(&none.stderr).contains("--min-p: neither image has a layer `variance`"));
    let flags = ["compare", "reference.png", "reference.exr", "--max-hdr-flip", "1"];
    let display = heliostat(folder.path(), &flags);
    assert_eq!(display.status.code(), Some(2));
    assert!(text(&display.stderr).contains("EXR or PFM"));
    refuses(&["compare", "a.exr", "b.exr", "--heat-map", "map.exr"], 2, &["--heat-map", ".png"]);
    refuses(&["compare", "a.exr", "b.exr", "--min-p", "2"], 2, &["--min-p", "0 to 1"]);
}

#[test]
fn wrong_flags_are_usage_errors() {
    let spheres = scene("orthographic.toml");
    refuses(&["render"], 2, &["<SCENE>"]);
    refuses(&["rendr"], 2, &["rendr"]);
    refuses(&["render", &spheres, "--widht", "3"], 2, &["--widht", "--width"]);
    refuses(&["render", &spheres, "--width", "0"], 2, &["--width", "1..=65536"]);
    refuses(&["render", &spheres, "--spp", "x"], 2, &["--spp"]);
    refuses(&["render", &spheres, "--accel", "kd"], 2, &["--accel", "bvh", "brute"]);
    refuses(&["render", &spheres, "--crop", "4,4,2,9"], 2, &["--crop", "X0 < X1"]);
    refuses(&["render", &spheres, "--crop", "0,0,9999,9"], 2, &["--crop", "9999"]);
    refuses(&["render", &spheres, "-o", "image.gif"], 2, &["image.gif", ".png"]);
    refuses(&["render", &spheres, "--width", "65536", "--height", "65536"], 2, &["--width", "2^32"]);
    refuses(&["render", &spheres, "-q", "-v"], 2, &["--quiet", "--verbose"]);
    let hot = ["--replicate-hot", "8M"];
    refuses(&[&["render", &spheres], &hot[..]].concat(), 2, &["--replicate-hot", "--split voxels"]);
    refuses(
        &["render", &spheres, "--split", "voxels", "--replicate-hot", "0"],
        2,
        &["--replicate-hot", "256M"],
    );
    refuses(
        &["render", &spheres, "--split", "voxels", "--replicate-hot", "all"],
        2,
        &["--replicate-hot", "none"],
    );
    let triangles = ["info", &spheres, "--split", "triangles", "--ranks", "2"];
    refuses(&[&triangles[..], &hot].concat(), 2, &["--replicate-hot", "--split voxels"]);
    refuses(&["compare", "a.png"], 2, &["<TEST>"]);
}

#[test]
fn missing_and_unwritable_files_are_named() {
    let spheres = scene("orthographic.toml");
    refuses(&["render", "nowhere.toml"], 1, &["nowhere.toml", "check the path"]);
    refuses(&["render", "nowhere.obj"], 1, &["nowhere.obj", "check the path"]);
    refuses(&["render", "scene.blend"], 1, &["scene.blend", ".toml"]);
    refuses(&["validate", "nowhere.toml"], 1, &["nowhere.toml"]);
    refuses(&["info", "nowhere.toml"], 1, &["nowhere.toml"]);
    refuses(&["render", &spheres, "-o", "no/such/folder/a.png"], 1, &["no/such/folder", "folder"]);
    refuses(&["render", &spheres, "--stats", "no/such/stats.json"], 1, &["no/such"]);
    refuses(&["render", &spheres, "-o", &("a".repeat(256) + ".png")], 1, &["aaa.png", "long"]);
    refuses(&["compare", "a.png", "b.png"], 1, &["a.png"]);
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("taken.png")).unwrap();
    refuses_in(folder.path(), &["render", &spheres, "-o", "taken.png"], 1, &["taken.png"]);
}

/// As in `heliostat render … 2>&1 | head -n 1`.
#[test]
fn a_reader_that_went_away_does_not_end_a_render() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_heliostat"))
        .current_dir(folder.path())
        .args([
            "render",
            &scene("orthographic.toml"),
            "--width",
            "32",
            "-v",
            "--progress",
            "json",
            "-o",
            "a.png",
        ])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stderr.take());
    assert!(child.wait().unwrap().success());
    assert!(folder.path().join("a.png").is_file());
}

#[test]
fn broken_scenes_name_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &str| std::fs::write(folder.path().join(name), content).unwrap();
    write("key.toml", "[camera]\nposition = [0, 0, 5]\nlook_at = [0, 0, 0]\nfow = 40\n");
    refuses_in(folder.path(), &["render", "key.toml"], 1, &["key.toml:4", "fow"]);
    write("size.toml", "[render]\nwidth = 0\n");
    refuses_in(folder.path(), &["render", "size.toml"], 1, &["size.toml:2", "width"]);
    write("nan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n");
    refuses_in(folder.path(), &["render", "nan.obj"], 1, &["nan.obj:2"]);
    write("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
    refuses_in(folder.path(), &["render", "index.obj"], 1, &["index.obj:4", "9"]);
    std::fs::write(folder.path().join("bytes.toml"), [0xff, 0xfe, 0x00, 0x80]).unwrap();
    refuses_in(folder.path(), &["render", "bytes.toml"], 1, &["bytes.toml"]);
    std::fs::write(folder.path().join("noise.png"), b"\x89PNG\r\n\x1a\nnoise").unwrap();
    refuses_in(folder.path(), &["compare", "noise.png", "noise.png"], 1, &["noise.png"]);
}

#[test]
fn a_bare_model_is_framed_and_lit() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("tent.obj"),
        "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv 0 1 0\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 4 3 2 1\n",
    )
    .unwrap();
    let output = heliostat(folder.path(), &["render", "tent.obj", "--width", "48", "--height", "40", "-q"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let image = heliostat::output::read::read(&folder.path().join("tent.png")).unwrap();
    let corner = image.pixels[0];
    let center = image.pixels[20 * 48 + 24];
    assert_ne!(center, corner, "the model fills the middle");
    assert!(center.iter().all(|&c| c > 0.02), "the model is lit: {center:?}");
    for edge in [24, 20 * 48, 20 * 48 + 47, 39 * 48 + 24] {
        assert_eq!(image.pixels[edge], corner, "the whole model is seen, with a margin");
    }
}

#[test]
fn reports_are_written_and_hold_what_they_promise() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "render",
        &scene("glass.toml"),
        "--width",
        "30",
        "--height",
        "20",
        "--threads",
        "2",
        "-v",
        "--progress",
        "json",
        "--stats",
        "stats.json",
        "--timeline",
        "timeline.json",
        "-o",
        "a.png",
    ];
    let output = heliostat(folder.path(), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap()
    };
    let stats = json("stats.json");
    let rank = &stats["ranks"][0];
    assert_eq!(rank["rays"]["camera"], 600);
    assert!(rank["rays"]["refraction"].as_u64().unwrap() > 0 && rank["rays"]["shadow"].as_u64().unwrap() > 0);
    assert_eq!(rank["threads"], 2);
    for phase in ["load", "build", "broadcast", "trace", "gather", "write"] {
        assert!(rank["seconds"][phase].as_f64().unwrap() >= 0.0, "{phase}");
    }
    let timeline = json("timeline.json");
    let events = timeline["traceEvents"].as_array().unwrap();
    for name in ["load", "build", "prepass", "tile", "write"] {
        assert!(events.iter().any(|event| event["name"] == name), "no {name}");
    }
    let error = text(&output.stderr);
    assert!(error.lines().any(|line| line.starts_with('{')), "{error}");
    assert!(error.contains("max_depth: ") && error.contains("rank 0: 2 threads"), "{error}");
}

#[test]
fn the_environment_sets_flags_and_flags_win() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_heliostat"))
            .current_dir(folder.path())
            .args(["render", &scene("orthographic.toml"), "-q", "-o", name])
            .args(arguments)
            .env("HELIOSTAT_WIDTH", "24")
            .env("HELIOSTAT_HEIGHT", "10")
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let image = heliostat::output::read::read(&folder.path().join(name)).unwrap();
        (image.width, image.height)
    };
    assert_eq!(run("a.png", &[]), (24, 10));
    assert_eq!(run("b.png", &["--width", "12"]), (12, 10));
}

#[test]
fn images_tell_how_they_were_made_but_not_where() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "render",
        &scene("orthographic.toml"),
        "--width",
        "16",
        "--seed",
        "99",
        "-q",
        "-o",
        "a.png",
        "-o",
        "a.exr",
    ];
    assert!(heliostat(folder.path(), &arguments).status.success());
    for name in ["a.png", "a.exr"] {
        let bytes = text(&std::fs::read(folder.path().join(name)).unwrap());
        for part in ["heliostat ", "seed", "99", "max_depth", "whitted"] {
            assert!(bytes.contains(part), "no {part:?} in {name}");
        }
        assert!(!bytes.contains("orthographic"), "{name} holds a path");
    }
}

#[test]
fn help_names_every_environment_twin_and_other_commands_print() {
    let folder = tempfile::tempdir().unwrap();
    let stdout = |arguments: &[&str]| {
        let output = heliostat(folder.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let help = stdout(&["render", "--help"]);
    let twins = help.matches("[env: HELIOSTAT_").count();
    let flags = help.lines().filter(|line| line.trim_start().starts_with('-') && line.contains("--")).count();
    // All but --help have one.
    assert_eq!(twins, flags - 1, "{help}");
    assert!(stdout(&["--version"]).starts_with("heliostat "));
    assert!(stdout(&["completions", "bash"]).contains("--tile-size"));
    assert!(stdout(&["man"]).contains(".TH heliostat"));
    assert!(stdout(&["validate", &scene("teapot.toml"), &scene("cornell.toml")]).lines().count() == 2);
    let info: serde_json::Value =
        serde_json::from_str(&stdout(&["info", &scene("sphereflake.toml"), "--json"])).unwrap();
    assert!(info["spheres"].as_u64().unwrap() >= 7381);
    stdout(&["man", "--dir", "."]);
    assert!(folder.path().join("heliostat-render.1").is_file());
}

/// Every model that others' readers stumbled over renders, or is refused with its name.
#[test]
fn nasty_models_render_or_are_refused() {
    let Some(data) = common::shared_data() else { return };
    let mut waiting = vec![data.join("nasty")];
    let folder = tempfile::tempdir().unwrap();
    let (mut rendered, mut refused) = (0, 0);
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            waiting.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
            continue;
        }
        if path.extension().is_none_or(|extension| extension != "obj") {
            continue;
        }
        let model = path.display().to_string();
        let output = heliostat(folder.path(), &["render", &model, "--width", "16", "-q", "-o", "a.png"]);
        let error = text(&output.stderr);
        match output.status.code() {
            Some(0) => rendered += 1,
            Some(1) => {
                let file = path.file_name().unwrap().to_string_lossy();
                assert!(error.contains(&*file) && error.lines().count() == 1, "{error}");
                refused += 1;
            }
            code => panic!("{model}: {code:?} {error}"),
        }
    }
    println!("{rendered} rendered, {refused} refused");
    assert!(rendered > 50 && refused > 10, "{rendered} rendered, {refused} refused");
}

#[test]
fn the_stress_test_counts_errors_in_a_table_and_as_json() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("flat.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let flags = ["stress", "--rays", "1e4", "--seed", "3", "--mesh", "flat.obj", "--json", "s.json"];
    let output = heliostat(folder.path(), &flags);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    for row in ["icosphere", "star", "fans", "flat.obj", "moved 1e7", "scaled 1e-12", "all "] {
        assert!(table.contains(row), "no {row} in {table}");
    }
    let json = std::fs::read_to_string(folder.path().join("s.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["total"]["rays"], 10_000);
    for column in ["leaks", "misses", "skipped", "false_hits", "self_hits", "differ"] {
        assert_eq!(json["total"][column], 0, "{table}");
    }
}

#[test]
fn the_ladder_shows_what_digits_buy() {
    let folder = tempfile::tempdir().unwrap();
    let output = heliostat(folder.path(), &["stress", "--ladder", "--rays", "3000", "--picture", "rungs"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("12 bits, t + 6 bits"));
    assert!(folder.path().join("rungs/ladder-sheet.png").exists());
}

#[test]
fn every_level_of_instructions_renders_the_same_and_an_unknown_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let render = |level: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
        command.current_dir(folder.path()).env("HELIOSTAT_SIMD", level);
        command.args(["render", &scene("teapot.toml"), "--width", "64", "-q", "-o", "teapot.pfm"]);
        command.output().expect("the program starts")
    };
    let image = |level: &str| {
        let output = render(level);
        assert!(output.status.success(), "{}", text(&output.stderr));
        std::fs::read(folder.path().join("teapot.pfm")).unwrap()
    };
    let baseline = image("baseline");
    assert_eq!(image("avx2"), baseline);
    assert_eq!(image("avx512"), baseline);
    let refused = render("avx1024");
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("HELIOSTAT_SIMD"), "{}", text(&refused.stderr));
}

#[test]
fn bench_builds_measures_every_structure_at_every_size() {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["bench", "builds", "--json", "--rounds", "1", "--threads", "1", "--sizes"];
    let rows = |more: &[&str]| {
        let output = heliostat(folder.path(), &[&flags, more].concat());
        assert!(output.status.success(), "{output:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        let named = |line: &str| {
            let row: serde_json::Value = serde_json::from_str(line).unwrap();
            assert!(row["seconds"].as_f64().unwrap() > 0.0 && row["bytes"].as_u64().unwrap() > 0, "{row}");
            (row["structure"].as_str().unwrap().to_string(), row["triangles"].as_u64().unwrap())
        };
        text.lines().map(named).collect::<Vec<_>>()
    };
    let expected = [200, 800].map(|n| ["fast", "balanced", "best", "grid"].map(|s| (s.to_string(), n)));
    assert_eq!(rows(&["200,8e2"]), expected.concat());
    assert_eq!(rows(&["200", "--build", "grid"]), [("grid".to_string(), 200)]);
    refuses(&["bench", "builds", "--sizes", "1"], 2, &["--sizes", "2"]);
}

#[test]
fn bench_kernels_writes_rays_and_traces_them() {
    let folder = tempfile::tempdir().unwrap();
    let spheres = scene("orthographic.toml");
    let output = heliostat(folder.path(), &["bench", "kernels", &spheres, "--write-rays", "rays"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    for (class, kind) in [("prim", "closest"), ("shad", "occluded"), ("diff", "closest"), ("rand", "closest")]
    {
        let rays = format!("rays/orthographic.{class}.rays");
        let flags = [
            "bench", "kernels", "--mesh", &spheres, "--rays", &rays, "--kind", kind, "--rounds", "1",
            "--json",
        ];
        let output = heliostat(folder.path(), &flags);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let row: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(row["mrays"].as_f64().unwrap() > 0.0 && row["hits"].as_u64().unwrap() > 0, "{row}");
    }
    refuses(&["bench", "kernels"], 2, &["SCENE"]);
    refuses(&["bench", "kernels", "none.tri"], 1, &["none.tri"]);
}

#[test]
fn stress_refuses_what_it_cannot_do() {
    refuses(&["stress", "--rays", "0"], 2, &["--rays", "1 to 1e15"]);
    refuses(&["stress", "--rays", "many"], 2, &["--rays", "1e6"]);
    refuses(&["stress", "--accel", "octree"], 2, &["--accel", "bvh"]);
    refuses(&["stress", "--mesh", "none.obj"], 1, &["none.obj", "check the path"]);
    refuses(&["stress", "--picture", "here"], 2, &["--ladder"]);
    refuses(&["stress", "--only-mesh"], 2, &["--mesh"]);
}

/// A layer goes into an EXR file, and nowhere else; a render that a clock ends is whole and says so.
#[test]
fn layers_targets_and_limits() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell-path.toml");
    let small = ["render", scene, "--width", "24", "--height", "24"];
    let (exr, png) = (at("a.exr"), at("a.png"));

    let run = |more: &[&str]| {
        let mut command = assert_cmd::Command::cargo_bin("heliostat").unwrap();
        command.args(small).args(more).assert()
    };
    let all = "variance,albedo,normal,position,depth,id";
    run(&["-o", &exr, "--spp", "4", "--aov", all]).success();
    let file = heliostat::image::read::read_layers(exr.as_ref()).unwrap();
    let mut names: Vec<&str> = file.layers.iter().map(|layer| layer.name.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["albedo", "depth", "freedom", "id", "normal", "position", "variance"]);
    // Each of four samples is a batch.
    assert!(file.freedom().unwrap().iter().all(|&freedom| freedom == 3.0));
    assert!(file.variance().unwrap().iter().any(|v| v[0] > 0.0));

    let refused = run(&["-o", &png, "--spp", "4", "--aov", "depth"]).code(2);
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("--aov"));
    run(&["-o", &exr, "--spp", "1", "--aov", "variance"]).code(2);
    for wrong in [["--error-target", "0"], ["--error-target", "x"], ["--time-limit", "0"]] {
        let refused = run(&["-o", &png, wrong[0], wrong[1]]).code(2);
        assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains(wrong[0]));
    }

    let told = run(&["-o", &png, "--error-target", "0.2"]).success();
    assert!(String::from_utf8_lossy(&told.get_output().stderr).contains("95 %"));
    let ended = run(&["-o", &exr, "--time-limit", "0.001"]).code(75);
    let said = String::from_utf8_lossy(&ended.get_output().stderr).into_owned();
    assert!(said.contains("--time-limit") && said.contains("samples per pixel"), "{said}");
    assert_eq!(heliostat::image::read::read(exr.as_ref()).unwrap().width, 24);
}
