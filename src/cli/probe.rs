//! `heliostat probe`: rays from a file, answers into a file.

use std::io::Write;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use crate::cluster::{Solo, threads};
use crate::error::{Error, Result};
use crate::job;
use crate::lab::probe::{self, FORMATS, Question, Target};
use crate::output::file;
use crate::settings::{AccelKind, BuildPreset};

#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` describes the files.", after_long_help = FORMATS)]
pub struct Args {
    /// What is asked
    question: Question,
    /// The mesh that the rays meet; not for spheres
    #[arg(
        long,
        value_name = "MODEL.obj",
        required_if_eq_any([("question", "rays"), ("question", "spawn"), ("question", "chain")])
    )]
    mesh: Option<PathBuf>,
    /// Records, binary
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Where the answers go, binary; written whole or not at all
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// The structure that finds hits; never changes an answer
    #[arg(long, env = "HELIOSTAT_ACCEL", default_value = "bvh")]
    accel: AccelKind,
    /// How the hierarchy is built; never changes an answer
    #[arg(long, env = "HELIOSTAT_BUILD", default_value = "balanced")]
    build: BuildPreset,
    /// Threads [env: HELIOSTAT_THREADS] [default: the processors]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

pub fn run(args: &Args) -> Result<()> {
    if args.question == Question::Spheres && args.mesh.is_some() {
        return Err(Error::usage("--mesh", "spheres come with their rays", "leave it out"));
    }
    file::check_writable(&args.output)?;
    let pool = job::thread_pool(threads::choose(&Solo::new(), args.threads)?)?;
    pool.install(|| {
        let target = match &args.mesh {
            Some(mesh) => {
                let (target, warnings) = Target::load(mesh, args.accel, args.build)?;
                for warning in warnings {
                    let _ = writeln!(std::io::stderr(), "heliostat: warning: {warning}");
                }
                Some(target)
            }
            None => None,
        };
        probe::answer(args.question, target.as_ref(), &args.input, &args.output)
    })
}
