//! Failures under a real launcher: each ends the whole job at once, by one readable line and the right exit code, and
//! leaves no file behind. And what must go right there: one voice, the same file bytes, rank 0's environment.
//!
//! This program starts `heliostat` under `mpirun`, and itself as ranks that fail on purpose. It says for each case how
//! long the job took: from the failure where that moment is known, else from the start.

#![cfg_attr(not(feature = "mpi"), allow(dead_code, unused_imports))]

#[path = "../common/mod.rs"]
mod common;
mod launch;
mod ranks;

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitCode};
use std::time::Instant;

use common::repository;
use launch::{LONGEST, Launch};

fn main() -> ExitCode {
    if let Some(case) = std::env::var_os(ranks::CASE) {
        return ranks::run(&case.to_string_lossy());
    }
    #[cfg(feature = "mpi")]
    for test in [
        errors_that_rank_0_finds,
        errors_of_a_rank_alone,
        panics,
        killed_ranks,
        launchers_that_do_not_fit,
        one_voice,
        same_files,
        environment_of_rank_0,
        folder_that_vanishes,
        interrupt,
    ] {
        test();
    }
    #[cfg(not(feature = "mpi"))]
    println!("skipped: built without the feature mpi");
    ExitCode::SUCCESS
}

fn scene(name: &str) -> String {
    repository().join("scenes").join(name).display().to_string()
}

fn errors_that_rank_0_finds() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    let inputs = tempfile::tempdir().unwrap();
    let input = |name: &str, text: &str| {
        std::fs::write(inputs.path().join(name), text).unwrap();
        inputs.path().join(name).display().to_string()
    };
    let not_a_number = input("nan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n");
    let no_size = input("size.toml", "[render]\nwidth = 0\n");
    let cases: [(&[&str], i32, &[&str]); 9] = [
        (&["render", &spheres, "--widht", "3"], 2, &["--widht"]),
        (&["rendr"], 2, &["rendr"]),
        (&["render", &spheres, "--width", "0"], 2, &["--width", "1..=65536"]),
        (&["render", &no_size], 1, &["size.toml:2", "width"]),
        (&["render", "nowhere.toml"], 1, &["nowhere.toml", "check the path"]),
        (&["render", &not_a_number], 1, &["nan.obj:2"]),
        (&["render", &spheres, "-o", "no/such/a.png"], 1, &["no/such", "create its folder"]),
        (&["render", &spheres, "-o", "/proc/a.png"], 1, &["/proc/a.png"]),
        (&["validate", "nowhere.toml"], 1, &["nowhere.toml"]),
    ];
    for (arguments, code, hints) in cases {
        launch.end(&arguments.join(" "), launch.heliostat(2, arguments)).fails(code, hints);
    }
}

fn errors_of_a_rank_alone() {
    let launch = Launch::new();
    let fails = |ranks, case: &str, code, hints: &[&str]| {
        launch.end(case, launch.failing(ranks, case, &[])).fails(code, hints);
    };
    fails(3, "error:1", 1, &["[rank 1] heliostat: an error on purpose"]);
    fails(2, "deposit:0", 1, &["[rank 0] heliostat: an error on purpose"]);
    // Each rank's own environment, but one answer.
    let spheres = scene("orthographic.toml");
    let arguments = ["render", &spheres, "-o", "a.png"];
    for (case, variables, who) in [
        ("wrong HELIOSTAT_THREADS on rank 1", ["", "HELIOSTAT_THREADS=some"], "rank 1:"),
        ("wrong HELIOSTAT_THREADS everywhere", ["HELIOSTAT_THREADS=some"; 2], "rank 0 and 1 more:"),
    ] {
        let end = launch.end(case, launch.heliostat_each(variables, &arguments));
        end.fails(2, &[who, "HELIOSTAT_THREADS", "some"]);
    }
}

fn panics() {
    let launch = Launch::new();
    for (ranks, case, who) in [
        (2, "panic in a worker:0", "[rank 0]"),
        (3, "panic in a worker:1", "[rank 1]"),
        (2, "panic in main:1", "[rank 1]"),
        (2, "panic in a thread:1", "[rank 1]"),
    ] {
        let line =
            format!("{who} heliostat: internal error: a panic on purpose (tests/mpi_failures/ranks.rs:");
        launch.end(case, launch.failing(ranks, case, &[])).fails(101, &[&line]);
    }
}

/// Nobody is left to speak for a killed rank but the launcher.
fn killed_ranks() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    let endless = ["render", &spheres, "--spp", "65536", "-o", "a.png", "-o", "a.exr"];
    for case in ["kill:1", "kill:0", "abort:1"] {
        launch.end(case, launch.failing(2, case, &endless)).fails_silently(None);
    }
}

fn launchers_that_do_not_fit() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    let arguments = ["render", &spheres, "-o", "a.png"];
    // What another MPI's launcher would set.
    let version = launch.launcher().arg("--version").output().expect("the launcher starts").stdout;
    let ours = String::from_utf8_lossy(&version).into_owned();
    let (size, rank) = if ours.contains("HYDRA") {
        ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK")
    } else {
        ("PMI_SIZE", "PMI_RANK")
    };
    for (number, speaks) in [("0", true), ("1", false)] {
        let mut command = launch.command(env!("CARGO_BIN_EXE_heliostat"));
        command.args(arguments).env(size, "2").env(rank, number);
        let end = launch.end(&format!("{size}=2 {rank}={number}"), command);
        if speaks {
            end.fails(1, &["2 processes", "MPI sees 1"]);
        } else {
            assert!(end.complaints().is_empty(), "{}", end.stderr);
            end.fails_silently(Some(1));
        }
    }
    let Some(plain) = std::env::var_os("HELIOSTAT_TEST_PLAIN") else {
        println!("skipped: HELIOSTAT_TEST_PLAIN names no build without the feature mpi; launch/test does");
        return;
    };
    let mut command = launch.launcher();
    command.args(["-n", "2"]).arg(plain).args(arguments);
    launch.end("a build without mpi", command).fails(1, &["2 processes", "no MPI", "--features mpi"]);
}

fn one_voice() {
    let launch = Launch::new();
    for (arguments, hint) in [(&["render", "--help"][..], "Usage:"), (&["--version"], "heliostat 0")] {
        let end = launch.end(&arguments.join(" "), launch.heliostat(3, arguments)).succeeds();
        let said = String::from_utf8_lossy(&end.stdout).into_owned();
        assert_eq!(said.matches(hint).count(), 1, "{said}");
        assert!(end.files.is_empty());
    }
}

/// Files and standard output, with and without a launcher.
fn same_files() {
    let spheres = scene("orthographic.toml");
    let rendered = |ranks: Option<usize>| {
        let launch = Launch::new();
        let arguments = [
            "render",
            &spheres,
            "--width",
            "61",
            "--spp",
            "2",
            "--tile-size",
            "8",
            "-q",
            "-o",
            "a.png",
            "-o",
            "a.exr",
            "-o",
            "a.pfm",
            "-o",
            "-",
        ];
        let (case, command) = match ranks {
            Some(ranks) => (format!("render by {ranks} ranks"), launch.heliostat(ranks, &arguments)),
            None => {
                let mut alone = launch.command(env!("CARGO_BIN_EXE_heliostat"));
                alone.args(arguments);
                ("render alone".to_string(), alone)
            }
        };
        let end = launch.end(&case, command).succeeds();
        assert_eq!(end.files.len(), 3, "{:?}", end.files);
        let mut all =
            ["a.png", "a.exr", "a.pfm"].map(|name| std::fs::read(launch.path(name)).unwrap()).to_vec();
        assert_eq!(end.stdout, all[0], "{case}: standard output is the PNG");
        all.push(end.stdout);
        all
    };
    let alone = rendered(None);
    for ranks in [1, 2, 3] {
        assert!(rendered(Some(ranks)) == alone, "{ranks} ranks");
    }
}

/// The others follow rank 0, whatever their own environment says.
fn environment_of_rank_0() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    for (case, variables, width) in [
        ("HELIOSTAT_WIDTH of rank 0", ["HELIOSTAT_WIDTH=24", ""], 24),
        ("HELIOSTAT_WIDTH of rank 1", ["", "HELIOSTAT_WIDTH=24"], 48),
    ] {
        let arguments = ["render", &spheres, "--height", "48", "-q", "-o", "a.pfm"];
        launch.end(case, launch.heliostat_each(variables, &arguments)).succeeds();
        let image = heliostat::output::read::read(&launch.path("a.pfm")).unwrap();
        assert_eq!((image.width, image.height), (width, 48), "{case}");
    }
}

/// Starts a render whose first progress is awaited, so that it is under way.
fn under_way(mut command: Command) -> (Child, BufReader<std::process::ChildStderr>) {
    let mut child = command.spawn().expect("the launcher starts");
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("\"progress\"") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "the render ended before it could be disturbed");
    }
    (child, stderr)
}

/// The folder of one of two images goes away during the render: an error, but the other image is saved.
fn folder_that_vanishes() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    std::fs::create_dir(launch.path("gone")).unwrap();
    // One thread each: some seconds on any machine, and its progress is told five times a second.
    let long = ["render", &spheres, "--width", "100", "--spp", "300", "--threads", "1", "--progress", "json"];
    let outputs = ["-o", "gone/a.png", "-o", "b.png"];
    let (mut child, mut stderr) = under_way(launch.heliostat(2, &[&long[..], &outputs].concat()));
    std::fs::remove_dir(launch.path("gone")).unwrap();
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1), "{rest}");
    let said: Vec<&str> = rest.lines().filter(|line| line.contains("heliostat: ")).collect();
    assert!(said.len() == 1 && said[0].contains("gone/a.png: can't write"), "{rest}");
    assert_eq!(launch.files(), [launch.path("b.png")]);
}

/// As by Ctrl-C.
fn interrupt() {
    let launch = Launch::new();
    let spheres = scene("orthographic.toml");
    let endless = ["render", &spheres, "--spp", "65536", "--progress", "json", "-o", "a.png"];
    let (mut child, mut stderr) = under_way(launch.heliostat(2, &endless));
    let begin = Instant::now();
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill starts");
    assert!(sent.success());
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    let status = child.wait().unwrap();
    println!("interrupt: ended {:.2} s after it, {status}", begin.elapsed().as_secs_f64());
    assert!(begin.elapsed() < LONGEST && !status.success(), "{status}: {rest}");
    assert!(!rest.contains("panicked"), "{rest}");
    assert!(launch.files().is_empty(), "{:?}", launch.files());
}
