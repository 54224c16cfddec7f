//! Real MPI: this program starts itself under `mpirun` with 1 to 4 ranks. Each launch renders every scene in several ways, since
//! a launch costs more than a small image; what rank 0 says is compared with one process alone.

#![cfg_attr(not(feature = "mpi"), allow(dead_code, unused_imports))]

mod common;

use std::collections::BTreeMap;
use std::process::{Command, ExitCode};

use common::{fingerprint, name, render, scenes, small_work};
use heliostat::accel::Accel;
use heliostat::cluster::share::Share;
use heliostat::cluster::{self, Comm};
use heliostat::error::Result;
use heliostat::job::{self, Crew, Work};
use heliostat::output::progress::ProgressKind;
use heliostat::output::stats::RankStats;
use heliostat::output::timeline::Timeline;
use heliostat::settings::{AccelKind, BuildSettings, Within};

/// Set for the processes that are ranks.
const RANK_PROCESS: &str = "HELIOSTAT_TEST_RANK";

/// Threads of each rank, tile size, bytes per step of a broadcast.
const WAYS: [(usize, u32, usize); 4] = [(1, 16, 1 << 28), (2, 8, 1_000), (3, 33, 65_536), (1, 64, 4_097)];

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
    for scene in scenes() {
        let mut origin = if comm.rank() == 0 { small_work(&scene, AccelKind::Bvh) } else { Work::default() };
        for (way, (threads, tile_size, chunk_bytes)) in WAYS.into_iter().enumerate() {
            // A large scene in small steps would only be slow.
            let small = share_small(comm, &origin)?;
            comm.set_chunk_bytes(if small { chunk_bytes } else { chunk_bytes.max(65_536) });
            origin.run.tile_size = tile_size;
            // The second way is over triangles.
            origin.run.within = if way == 1 { Within::Triangles } else { Within::Rays };
            // The last way goes through the grid, too.
            if way == WAYS.len() - 1 && comm.rank() == 0 {
                origin.run.accel = AccelKind::Grid;
                origin.accel =
                    Accel::build(AccelKind::Grid, BuildSettings::default(), &origin.scene.surfaces);
            }
            let mut work = if comm.rank() == 0 { origin.clone() } else { Work::default() };
            work.share(Share::new(comm))?;
            let pool = job::thread_pool(threads)?;
            let progress = ProgressKind::None.start();
            let crew =
                Crew { comm, pool: &pool, wide: &pool, timeline: &Timeline::off(), progress: &*progress };
            let image = job::render(&crew, &work, &mut RankStats::default())?;
            if let Some(image) = image {
                println!("{} {way} {}", name(&scene), fingerprint(&image));
            }
        }
    }
    Ok(())
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
        for way in 0..WAYS.len() {
            alone.insert(format!("{} {way}", name(&scene)), fingerprint(&image));
        }
    }
    for ranks in 1..=4 {
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
