//! What the ranks of this test do: fail, each in the way and on the rank that its case says.

use std::process::{Command, ExitCode};
use std::time::Duration;

use heliostat::cluster::deal::{self, Plan};
use heliostat::cluster::{self, Comm};
use heliostat::error::{Error, Result};
use heliostat::{cli, job};

/// Set for the processes that are ranks: the failure, a colon, and the rank that fails.
pub const CASE: &str = "HELIOSTAT_TEST_CASE";
/// The file that is made at the moment of the failure.
pub const MARK: &str = "HELIOSTAT_TEST_MARK";

const UNITS: u32 = 400;

pub fn run(case: &str) -> ExitCode {
    let (failure, rank) = case.rsplit_once(':').expect("a failure and a rank");
    let rank: usize = rank.parse().expect("a rank");
    match failure {
        "kill" => render_until(rank, || {
            let _ = Command::new("kill").args(["-KILL", &std::process::id().to_string()]).status();
        }),
        "abort" => render_until(rank, || std::process::abort()),
        _ => cluster::run(|comm| fail(comm, failure, comm.rank() == rank)),
    }
}

/// The whole program, with a thread that ends this rank in the middle of a long render.
fn render_until(rank: usize, end: fn()) -> ExitCode {
    let own = ["OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK"]
        .into_iter()
        .find_map(|name| std::env::var(name).ok());
    if own.expect("the launcher names the rank") == rank.to_string() {
        std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(700));
            mark();
            end();
        });
    }
    cli::main()
}

/// Collective: the rank that is `guilty` fails, the others wait for it or work.
fn fail(comm: &dyn Comm, failure: &str, guilty: bool) -> Result<()> {
    match failure {
        "panic in main" if guilty => panic_now(),
        "panic in a thread" if guilty => _ = std::thread::spawn(panic_now),
        "error" if guilty => return Err(error_now()),
        "panic in a worker" => {
            return deal(
                comm,
                &|| {
                    if guilty {
                        panic_now()
                    }
                },
                &|| Ok(()),
            );
        }
        "deposit" => return deal(comm, &|| (), &|| if guilty { Err(error_now()) } else { Ok(()) }),
        _ => {}
    }
    comm.barrier();
    // The guilty rank, if it comes here, has a thread that fails meanwhile.
    std::thread::sleep(Duration::from_secs(20));
    Ok(())
}

/// A deal of units that take a while, in the middle of which `render` or `deposit` may fail.
fn deal(comm: &dyn Comm, render: &(dyn Fn() + Sync), deposit: &dyn Fn() -> Result<()>) -> Result<()> {
    let pool = job::thread_pool(2)?;
    let plan = (comm.rank() == 0).then(|| Plan::new((0..UNITS).map(|unit| (unit, 1.0))));
    let render = |unit: u32, bytes: &mut Vec<u8>| {
        std::thread::sleep(Duration::from_millis(20));
        bytes.push(unit as u8);
        render();
    };
    deal::run(comm, &pool, plan.as_ref(), &render, &mut |_, _| deposit(), &mut |_| ())?;
    Ok(())
}

fn panic_now() {
    mark();
    panic!("a panic on purpose");
}

fn error_now() -> Error {
    mark();
    Error::launch("an error on purpose", "nothing can mend it")
}

/// Only the first failure counts.
fn mark() {
    let path = std::env::var_os(MARK).expect("the test names the file");
    let _ = std::fs::OpenOptions::new().write(true).create_new(true).open(path);
}
