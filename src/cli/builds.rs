//! `heliostat bench builds`: what building the structures costs, as a table and as JSON.

use std::num::NonZeroUsize;
use std::process::{Command, Stdio};

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use super::print;
use crate::cluster::{Solo, threads};
use crate::error::{Error, Result};
use crate::job;
use crate::lab::builds::{MOST, Structure, terrain};
use crate::scene::load::Budget;

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Triangles of the terrains; 1e7 is a number, too
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "1e4,1e5,1e6,1e7", value_parser = triangles)]
    sizes: Vec<u64>,
    /// Build these alone [default: all]
    #[arg(long, value_name = "STRUCTURE,…", value_delimiter = ',')]
    build: Vec<Structure>,
    /// Rounds of each measurement; their median is told
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// A line of JSON for each measurement
    #[arg(long)]
    json: bool,
    /// Threads [env: HELIOSTAT_THREADS] [default: the processors]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

fn triangles(text: &str) -> std::result::Result<u64, String> {
    let number: f64 = text.parse().map_err(|_| "give a number such as 1000000 or 1e6".to_string())?;
    if (2.0..=MOST as f64).contains(&number) && number.fract() == 0.0 {
        Ok(number as u64)
    } else {
        Err(format!("give a whole number from 2 to {MOST}"))
    }
}

/// One structure over one terrain.
#[derive(Deserialize, Serialize)]
struct Row {
    structure: Structure,
    triangles: usize,
    threads: usize,
    /// The median of the rounds, and the fastest.
    seconds: f64,
    fastest: f64,
    ns_per_triangle: f64,
    /// Of the structure.
    bytes: usize,
    bytes_per_triangle: f64,
    /// What the process grew by while building, for each triangle; null where the system doesn't tell.
    peak_bytes_per_triangle: Option<f64>,
}

pub fn run(args: &Args) -> Result<()> {
    let structures = if args.build.is_empty() { Structure::value_variants() } else { &args.build };
    if !args.json {
        print(
            "structure   triangles   seconds  [fastest]  ns/triangle   bytes/triangle   peak bytes/triangle\n",
        )?;
    }
    let is_single = args.sizes.len() * structures.len() == 1;
    for &size in &args.sizes {
        for &structure in structures {
            let row = if is_single { measure(args, size, structure)? } else { apart(args, size, structure)? };
            print(&if args.json { json(&row)? } else { row.line() })?;
        }
    }
    Ok(())
}

fn measure(args: &Args, size: u64, structure: Structure) -> Result<Row> {
    let pool = job::thread_pool(threads::choose(&Solo::new(), args.threads)?)?;
    pool.install(|| {
        let surfaces = terrain(size);
        if let Some(shortage) = Budget::of_machine().lacks(structure.memory_to_build(&surfaces)) {
            let problem = format!("building over {size} triangles needs {shortage}");
            return Err(Error::usage("--sizes", problem, "give smaller ones"));
        }
        let mut built = structure.build(&surfaces, args.rounds as usize);
        built.seconds.sort_by(f64::total_cmp);
        let (seconds, triangles) = (built.seconds[built.seconds.len() / 2], surfaces.len());
        let each = |total: f64| total / triangles as f64;
        Ok(Row {
            structure,
            triangles,
            threads: rayon::current_num_threads(),
            seconds,
            fastest: built.seconds[0],
            ns_per_triangle: each(1e9 * seconds),
            bytes: built.bytes,
            bytes_per_triangle: each(built.bytes as f64),
            peak_bytes_per_triangle: built.peak.map(|peak| each(peak as f64)),
        })
    })
}

/// The same in a process of its own: memory that was used before would be used again, and not be counted.
fn apart(args: &Args, size: u64, structure: Structure) -> Result<Row> {
    let failed = |error| Error::read("this program, to run it for one measurement", error);
    let mut command = Command::new(std::env::current_exe().map_err(failed)?);
    let name = structure.to_possible_value().map_or_else(String::new, |value| value.get_name().into());
    command.args(["bench", "builds", "--json", "--build", &name]);
    command.args(["--sizes", &size.to_string(), "--rounds", &args.rounds.to_string()]);
    if let Some(threads) = args.threads {
        command.args(["--threads", &threads.to_string()]);
    }
    let output = command.stderr(Stdio::inherit()).output().map_err(failed)?;
    if !output.status.success() {
        let problem = format!("building over {size} triangles failed, see above");
        return Err(Error::usage("--sizes", problem, "give smaller ones"));
    }
    serde_json::from_slice(&output.stdout).map_err(|error| failed(error.into()))
}

fn json(row: &Row) -> Result<String> {
    let line = serde_json::to_string(row).map_err(|error| Error::write("standard output", error.into()))?;
    Ok(line + "\n")
}

impl Row {
    fn line(&self) -> String {
        let name =
            self.structure.to_possible_value().map_or_else(String::new, |value| value.get_name().into());
        let peak = self.peak_bytes_per_triangle.map_or_else(|| "-".into(), |peak| format!("{peak:.0}"));
        format!(
            "{name:<9} {:>11} {:>9.3}  [{:.3}] {:>12.0} {:>16.0} {peak:>21}\n",
            self.triangles, self.seconds, self.fastest, self.ns_per_triangle, self.bytes_per_triangle
        )
    }
}
