//! The command line: flags in, validated settings out, one file per subcommand. Rank 0 alone reads and prints.

mod bench;
mod builds;
mod compare;
mod convert;
mod error_curve;
mod error_report;
mod info;
mod manual;
mod probe;
mod render;
mod strategies;
mod stress;
mod validate;

use std::fmt::Display;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use serde::{Deserialize, Serialize};

use crate::accel::Accel;
use crate::cluster::{self, Comm, share};
use crate::error::{Error, Result};
use crate::scene::Surfaces;
use crate::scene::load::Budget;
use crate::settings::{AccelKind, BuildSettings};
use crate::simd::{LEVEL_VARIABLE, Level};

/// A distributed-memory parallel ray tracer: exact surfaces, and the same bytes however it was run.
///
/// Run it alone, or under mpirun or srun to share one image among many processes.
#[derive(Debug, Parser)]
#[command(name = "heliostat", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Render a scene (.toml, .helio) or a bare model (.obj).
    Render(Box<render::Args>),
    /// Print what a scene holds: counts, bounds, memory, what was dropped.
    Info(info::Args),
    /// Check scenes without rendering them.
    Validate(validate::Args),
    /// Write a scene as a binary file (.helio) that is mapped instead of read; it may be larger than memory.
    Convert(convert::Args),
    /// Compare two images; exits with 1 if they differ by more than allowed.
    Compare(compare::Args),
    /// Trace the rays of a binary file against a mesh and write what they meet.
    Probe(probe::Args),
    /// Try the tracer with aimed rays against exact arithmetic; exits with 1 if one answer is wrong.
    Stress(stress::Args),
    /// Measure the tracer.
    #[command(subcommand)]
    Bench(bench::Command),
    /// Print a completion script for a shell.
    Completions(manual::CompletionArgs),
    /// Print the manual page, or write all pages into a folder.
    Man(manual::ManArgs),
}

/// Which commands all ranks run together; the others are rank 0's alone.
#[derive(Clone, Copy, Serialize, Deserialize)]
enum Collective {
    No,
    Render,
    Stress,
    ErrorCurve,
}

/// Runs the program; its exit code.
pub fn main() -> ExitCode {
    cluster::run(run)
}

fn run(comm: &dyn Comm) -> Result<()> {
    // Rank 0 reads the flags; the others follow.
    let command = share::outcome(comm, parse)?;
    check_level()?;
    let collective = share::computed(comm, || {
        Ok(match command {
            Some(Command::Render(_)) => Collective::Render,
            Some(Command::Stress(_)) => Collective::Stress,
            Some(Command::Bench(bench::Command::Error(_))) => Collective::ErrorCurve,
            _ => Collective::No,
        })
    })?;
    match collective {
        Collective::No => {}
        Collective::Render => {
            let args = command.and_then(|command| match command {
                Command::Render(args) => Some(*args),
                _ => None,
            });
            return render::run(comm, args);
        }
        Collective::Stress => {
            let args = command.and_then(|command| match command {
                Command::Stress(args) => Some(args),
                _ => None,
            });
            return stress::run(comm, args);
        }
        Collective::ErrorCurve => {
            let args = command.and_then(|command| match command {
                Command::Bench(bench::Command::Error(args)) => Some(*args),
                _ => None,
            });
            return error_curve::run(comm, args);
        }
    }
    share::outcome(comm, || match command {
        Some(Command::Info(args)) => info::run(&args),
        Some(Command::Validate(args)) => validate::run(&args),
        Some(Command::Convert(args)) => convert::run(&args),
        Some(Command::Compare(args)) => compare::run(&args),
        Some(Command::Probe(args)) => probe::run(&args),
        Some(Command::Bench(bench::Command::Kernels(args))) => bench::kernels(&args),
        Some(Command::Bench(bench::Command::Strategies(args))) => strategies::run(&args),
        Some(Command::Bench(bench::Command::Builds(args))) => builds::run(&args),
        Some(Command::Completions(args)) => manual::completions(&args, Cli::command()),
        Some(Command::Man(args)) => manual::man(&args, Cli::command()),
        Some(Command::Render(_) | Command::Stress(_) | Command::Bench(bench::Command::Error(_))) | None => {
            Ok(())
        }
    })
}

/// Whether this rank's level of instructions, if it is forced, is one.
fn check_level() -> Result<()> {
    match std::env::var(LEVEL_VARIABLE) {
        Ok(name) if !name.is_empty() => match Level::named(&name) {
            Ok(_) => Ok(()),
            Err(what) => {
                Err(Error::usage(LEVEL_VARIABLE, what, "give baseline, avx2 or avx512, or leave it unset"))
            }
        },
        _ => Ok(()),
    }
}

/// The command that was asked for; `None` if help or version were, which are printed here.
fn parse() -> Result<Option<Command>> {
    match Cli::try_parse() {
        Ok(cli) => Ok(Some(cli.command)),
        Err(error) => match error.kind() {
            ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
                print(&error.render().to_string())?;
                Ok(None)
            }
            _ => {
                Err(Error::Flags(error.render().to_string().trim_start_matches("error: ").trim_end().into()))
            }
        },
    }
}

/// Builds the structure for the scene in the file `scene`.
///
/// # Errors
/// It needs more memory than there is.
fn build_accel(
    kind: AccelKind,
    build: impl Into<BuildSettings>,
    surfaces: &Surfaces,
    scene: &Path,
) -> Result<Accel> {
    let build = build.into();
    afford(Accel::memory_to_build(kind, build.preset, surfaces), surfaces, scene)?;
    Ok(Accel::build(kind, build, surfaces))
}

/// Whether there are so many bytes for the accelerator of the scene in the file `scene`.
fn afford(bytes: u64, surfaces: &Surfaces, scene: &Path) -> Result<()> {
    match Budget::of_machine().lacks(bytes) {
        None => Ok(()),
        Some(shortage) => Err(Error::scene(
            scene,
            None,
            format!("the accelerator over its {} primitives needs {shortage}", surfaces.len()),
            "use coarser meshes or fewer levels",
        )),
    }
}

/// Writes to standard output; a reader that closed it early is no error.
fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::write("standard output", error))
        }
        _ => Ok(()),
    }
}

/// A line on standard error; a reader that closed it is no reason to end a render, as `eprintln!` would.
fn note(line: impl Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

fn warn(warnings: &[impl Display]) {
    warnings.iter().for_each(|warning| note(format_args!("heliostat: warning: {warning}")));
}
