//! Real MPI: this program starts itself under `mpirun` with 1 to 8 ranks. Each launch renders every scene in several ways, since
//! a launch costs more than a small image; what rank 0 says is compared with one process alone.

#![cfg_attr(not(feature = "mpi"), allow(dead_code, unused_imports))]

mod common;

use std::collections::BTreeMap;
use std::process::{Command, ExitCode};

use common::{converted, fingerprint, name, render, scenes, small_work};
use heliostat::accel::Accel;
use heliostat::cluster::{self, Comm};
use heliostat::error::Result;
use heliostat::image::Image;
use heliostat::job::{self, Crew, Work};
use heliostat::output::progress::ProgressKind;
use heliostat::output::stats::RankStats;
use heliostat::output::timeline::Timeline;
use heliostat::settings::{AccelKind, BuildSettings, Deal, RunSettings, Split, Within};

/// Set for the processes that are ranks.
const RANK_PROCESS: &str = "HELIOSTAT_TEST_RANK";

/// How a scene is rendered.
struct Way {
    threads: usize,
    tile_size: u32,
    /// Bytes per step of a broadcast.
    chunk_bytes: usize,
    split: Split,
    deal: Deal,
    accel: AccelKind,
    ray_memory: u64,
    replicate_hot: Option<u64>,
}

const fn way(threads: usize, tile_size: u32, chunk_bytes: usize, split: Split, accel: AccelKind) -> Way {
    let (deal, ray_memory, replicate_hot) = (Deal::Interleaved, 1 << 26, None);
    Way { threads, tile_size, chunk_bytes, split, deal, accel, ray_memory, replicate_hot }
}

const WAYS: [Way; 10] = [
    way(1, 16, 1 << 28, Split::Tiles, AccelKind::Bvh),
    way(2, 8, 1_000, Split::Tiles, AccelKind::Bvh),
    way(1, 64, 4_097, Split::Tiles, AccelKind::Grid),
    way(3, 33, 65_536, Split::Stream, AccelKind::Bvh),
    Way { deal: Deal::Blocks, ..way(1, 16, 1 << 20, Split::Stream, AccelKind::Grid) },
    way(1, 32, 70_000, Split::Voxels, AccelKind::Bvh),
    Way { ray_memory: 300_000, deal: Deal::Blocks, ..way(2, 32, 1 << 28, Split::Voxels, AccelKind::Grid) },
    Way { replicate_hot: Some(200_000), ..way(2, 32, 1 << 28, Split::Voxels, AccelKind::Bvh) },
    way(1, 32, 1 << 28, Split::Triangles, AccelKind::Bvh),
    Way { ray_memory: 300_000, ..way(2, 32, 90_000, Split::Triangles, AccelKind::Grid) },
];

/// The splits that converted scenes are rendered by.
const CONVERTED: [Split; 3] = [Split::Tiles, Split::Voxels, Split::Triangles];

fn main() -> ExitCode {
    if std::env::var_os(RANK_PROCESS).is_some() {
        return cluster::run(render_all);
    }
    #[cfg(feature = "mpi")]
    compare_launches();
    #[cfg(not(feature = "mpi"))]
    println!("skipped: built without the feature mpi");
    ExitCode::SUCCESS
}

/// Collective: prints a line for each scene and way on rank 0.
fn render_all(comm: &dyn Comm) -> Result<()> {
    let folder = if comm.rank() == 0 { tempfile::tempdir().ok() } else { None };
    for scene in scenes() {
        let mut origin = if comm.rank() == 0 { small_work(&scene, AccelKind::Bvh) } else { Work::default() };
        for (number, way) in WAYS.iter().enumerate() {
            // A large scene in small steps would only be slow.
            let small = share_small(comm, &origin)?;
            comm.set_chunk_bytes(if small { way.chunk_bytes } else { way.chunk_bytes.max(65_536) });
            let mut work = Work::default();
            if comm.rank() == 0 {
                if origin.accel.kind() != way.accel {
                    origin.accel = Accel::build(way.accel, BuildSettings::default(), &origin.scene.surfaces);
                }
                work = origin.clone();
                work.run = RunSettings {
                    accel: way.accel,
                    split: way.split,
                    // The second way is over triangles.
                    within: if number == 1 { Within::Triangles } else { Within::Rays },
                    tile_size: way.tile_size,
                    deal: way.deal,
                    ray_memory: way.ray_memory,
                    replicate_hot: way.replicate_hot,
                    ..RunSettings::default()
                };
            }
            if let Some(image) = render_on(comm, work, way.threads)? {
                println!("{} {number} {}", name(&scene), fingerprint(&image));
            }
        }
        // Converted, it is mapped by every rank and not sent; where a rank has a part only, it copies that.
        for (number, split) in (WAYS.len()..).zip(CONVERTED) {
            let mut work = Work::default();
            if let Some(folder) = &folder {
                work = small_work(&converted(&scene, folder.path()), AccelKind::Bvh);
                work.run.split = split;
            }
            if let Some(image) = render_on(comm, work, 1)? {
                println!("{} {number} {}", name(&scene), fingerprint(&image));
            }
        }
    }
    Ok(())
}

/// Collective: renders rank 0's work.
fn render_on(comm: &dyn Comm, mut work: Work, threads: usize) -> Result<Option<Image>> {
    let pool = job::thread_pool(threads)?;
    let progress = ProgressKind::None.start();
    let crew = Crew { comm, pool: &pool, wide: &pool, timeline: &Timeline::off(), progress: &*progress };
    let is_mapped = cluster::share::computed(comm, || Ok(work.scene.file.is_some()))?;
    job::distribute(&crew, &mut work)?;
    let has_all = work.division.is_none();
    assert!(!has_all || work.scene.file.is_some() == is_mapped, "rank {} has mapped nothing", comm.rank());
    Ok(job::render(&crew, &mut work, &mut RankStats::default())?.map(|rendered| rendered.image))
}

fn share_small(comm: &dyn Comm, work: &Work) -> Result<bool> {
    cluster::share::computed(comm, || Ok(work.scene.surfaces.len() < 20_000))
}

#[cfg(feature = "mpi")]
fn compare_launches() {
    let mut alone = BTreeMap::new();
    for scene in scenes() {
        let work = small_work(&scene, AccelKind::Bvh);
        let image = render(&work, 2);
        for way in 0..WAYS.len() + CONVERTED.len() {
            alone.insert(format!("{} {way}", name(&scene)), fingerprint(&image));
        }
    }
    for ranks in [1, 2, 3, 4, 8] {
        let said = launch(ranks);
        let found: BTreeMap<String, String> = said
            .lines()
            .filter_map(|line| line.rsplit_once(' '))
            .map(|(key, value)| (key.to_string(), value.to_string()))
            .collect();
        assert_eq!(found, alone, "with {ranks} ranks");
        println!("{ranks} ranks: {} images, each the same bytes as alone", found.len());
    }
    let alone = stress(Command::new(HELIOSTAT));
    let mut words = launcher();
    words.args(["-n", "3", HELIOSTAT]);
    assert_eq!(stress(words), alone);
    println!("3 ranks: the stress test's counts as alone");
    let alone = error_curve(Command::new(HELIOSTAT));
    // Two curves of two rungs, and the names of the columns.
    assert_eq!(alone.lines().count(), 5, "{alone}");
    let mut words = launcher();
    words.args(["-n", "2", HELIOSTAT]);
    assert_eq!(error_curve(words), alone);
    println!("2 ranks: the errors of bench error as alone");
}

#[cfg(feature = "mpi")]
const HELIOSTAT: &str = env!("CARGO_BIN_EXE_heliostat");

/// The table of the stress test, but for the time it took.
#[cfg(feature = "mpi")]
fn stress(mut command: Command) -> String {
    let output = command.args(["stress", "--rays", "20000", "--accel", "bvh"]).output().expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8_lossy(&output.stdout);
    table.lines().filter(|line| !line.starts_with("seed ")).collect::<Vec<_>>().join("\n")
}

/// What `bench error` finds that no clock and no number of threads has a part in.
#[cfg(feature = "mpi")]
fn error_curve(mut command: Command) -> String {
    let scene = common::repository().join("scenes/cornell-path.toml");
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("errors.csv");
    let output = command
        .args(["bench", "error"])
        .arg(scene)
        .args(["--width", "16", "--samplers", "sobol", "--precisions", "exact,f32", "--spp", "2,8"])
        .args(["--reference-spp", "32", "--rounds", "1", "--seeds", "1", "--limit", "1000", "--threads", "1"])
        .arg("--csv")
        .arg(&csv)
        .output()
        .expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(csv).unwrap();
    let kept =
        ["scene", "sampler", "precision", "asked", "rays", "rmse", "rel_mse", "flip", "reference_rmse"];
    let names: Vec<&str> = text.lines().next().unwrap_or_default().split(',').collect();
    let places = kept.map(|name| names.iter().position(|&n| n == name).expect(name));
    let line = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        places.map(|place| cells[place]).join(",")
    };
    text.lines().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(feature = "mpi")]
fn launcher() -> Command {
    let launcher = std::env::var("HELIOSTAT_TEST_MPIRUN")
        .expect("HELIOSTAT_TEST_MPIRUN holds the launcher's command; launch/test sets it");
    let mut words = launcher.split_whitespace();
    let mut command = Command::new(words.next().expect("a launcher"));
    command.args(words);
    command
}

#[cfg(feature = "mpi")]
fn launch(ranks: usize) -> String {
    let output = launcher()
        .args(["-n", &ranks.to_string()])
        .arg(std::env::current_exe().unwrap())
        .env(RANK_PROCESS, "1")
        .output()
        .expect("the launcher starts");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{ranks} ranks ended with {}: {errors}", output.status);
    String::from_utf8_lossy(&output.stdout).into_owned()
}
