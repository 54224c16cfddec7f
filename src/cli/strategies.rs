//! `heliostat bench strategies`: one thread, threads over triangles and threads over rays against the number of triangles.

use std::fmt::Write as _;
use std::io::Write as _;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use serde::Serialize;

use super::print;
use crate::cluster::{Solo, threads};
use crate::error::{Error, Result};
use crate::job;
use crate::lab::strategies::{Field, Strategy};
use crate::output::file;
use crate::output::plot::{Plot, Scale, Series};
use crate::scene::generate::icosphere;
use crate::settings::AccelKind;

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Tessellated spheres in the view, each an object
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=4096))]
    objects: u32,
    /// Levels of tessellation; each has four times the triangles of the one before, 20 for each sphere at level 0
    #[arg(long, value_name = "L,...", value_delimiter = ',', default_value = "0,1,2,3,4,5,6", value_parser = clap::value_parser!(u32).range(0..=i64::from(icosphere::MAX_LEVEL)))]
    levels: Vec<u32>,
    /// The structures
    #[arg(long, value_delimiter = ',', default_value = "brute,spheres,bvh")]
    accel: Vec<AccelKind>,
    /// Pixels along each side of the image whose camera rays are traced
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    side: u32,
    /// Rounds of each measurement; their median is told
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Leave out what would take all its rounds longer than this
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    limit: f64,
    /// A line of JSON for each measurement
    #[arg(long)]
    json: bool,
    /// Draw time against triangles, both logarithmic
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Threads that divide the work [env: HELIOSTAT_THREADS] [default: the processors]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// One measurement.
#[derive(Serialize)]
struct Row {
    triangles: usize,
    accel: AccelKind,
    strategy: &'static str,
    threads: usize,
    rays: usize,
    /// Median of the rounds; of what was left out `None`.
    seconds: Option<f64>,
    mrays: Option<f64>,
    /// Over the single thread.
    speedup: Option<f64>,
    /// Seconds that a round was foretold to take, where that was too long.
    left_out_s: Option<f64>,
}

pub fn run(args: &Args) -> Result<()> {
    args.plot.as_deref().map_or(Ok(()), file::check_writable)?;
    let pool = job::thread_pool(threads::choose(&Solo::new(), args.threads)?)?;
    if !args.json {
        print(&heading(pool.current_num_threads(), u64::from(args.side).pow(2), args.rounds))?;
    }
    let mut rows = Vec::new();
    for &level in &args.levels {
        let field = Field::new(args.objects, level, args.side)?;
        let mut expected = None;
        for &accel in &args.accel {
            let measured = pool.install(|| measure(args, &field, accel, &mut expected))?;
            print(&if args.json { json(&measured)? } else { line(&measured) })?;
            rows.extend(measured);
        }
    }
    let Some(path) = &args.plot else { return Ok(()) };
    let svg = draw(args, &rows, pool.current_num_threads());
    file::write_whole(path, |out| out.write_all(svg.as_bytes()))
}

/// All strategies of one structure, round by round in turn, so that whatever else the machine does meets them alike.
fn measure(args: &Args, field: &Field, kind: AccelKind, expected: &mut Option<u64>) -> Result<Vec<Row>> {
    let accels = Strategy::ALL.map(|strategy| field.build(kind, strategy));
    let foretold: Vec<f64> =
        Strategy::ALL.iter().zip(&accels).map(|(&strategy, accel)| field.foretell(accel, strategy)).collect();
    let is_left_out = |which: usize| foretold[which] * f64::from(args.rounds) > args.limit;
    let mut seconds = Strategy::ALL.map(|_| Vec::new());
    for _ in 0..args.rounds {
        for (which, strategy) in
            Strategy::ALL.into_iter().enumerate().filter(|&(which, _)| !is_left_out(which))
        {
            let (took, digest) = field.round(&accels[which], strategy);
            if *expected.get_or_insert(digest) != digest {
                let what = format!("{} and {kind:?}: other answers than before", strategy.name());
                return Err(Error::Inexact(what));
            }
            seconds[which].push(took);
        }
    }
    let medians = seconds.map(|mut seconds| {
        seconds.sort_by(f64::total_cmp);
        seconds.get(seconds.len() / 2).copied()
    });
    let row = |(which, strategy): (usize, Strategy)| Row {
        triangles: field.triangles(),
        accel: kind,
        strategy: strategy.name(),
        threads: if strategy == Strategy::Single { 1 } else { rayon::current_num_threads() },
        rays: field.rays(),
        seconds: medians[which],
        mrays: medians[which].map(|seconds| field.rays() as f64 / seconds / 1e6),
        speedup: medians[0].zip(medians[which]).map(|(single, seconds)| single / seconds),
        left_out_s: is_left_out(which).then_some(foretold[which]),
    };
    Ok(Strategy::ALL.into_iter().enumerate().map(row).collect())
}

fn heading(threads: usize, rays: u64, rounds: u32) -> String {
    let strategies: String =
        Strategy::ALL.iter().map(|strategy| format!("  {:>26}", strategy.name())).collect();
    format!(
        "{rays} camera rays, {threads} threads, median of {rounds} rounds: milliseconds, million rays in a second, speed-up over the single thread\n\
         {:>9}  {:<8}{strategies}\n",
        "triangles", "accel"
    )
}

/// All strategies of one structure side by side.
fn line(rows: &[Row]) -> String {
    let mut text = String::new();
    if let Some(row) = rows.first() {
        let _ = write!(text, "{:>9}  {:<8}", row.triangles, format!("{:?}", row.accel).to_lowercase());
    }
    for row in rows {
        let cell = match (row.seconds, row.mrays, row.left_out_s) {
            (Some(seconds), Some(mrays), _) => {
                let speedup = row.speedup.map_or("     -".into(), |speedup| format!("{speedup:>5.2}x"));
                format!("{:>9.2} {mrays:>9.4} {speedup}", 1e3 * seconds)
            }
            (_, _, left_out) => format!("left out: {:.0} s a round", left_out.unwrap_or(0.0)),
        };
        let _ = write!(text, "  {cell:>26}");
    }
    text.push('\n');
    text
}

fn json(rows: &[Row]) -> Result<String> {
    let mut text = String::new();
    for row in rows {
        let line =
            serde_json::to_string(row).map_err(|error| Error::write("standard output", error.into()))?;
        text.push_str(&line);
        text.push('\n');
    }
    Ok(text)
}

/// Dashes tell the strategy, markers the structure.
fn draw(args: &Args, rows: &[Row], threads: usize) -> String {
    let mut curves = Vec::new();
    for (markers, &accel) in args.accel.iter().enumerate() {
        for (dashes, strategy) in Strategy::ALL.into_iter().enumerate() {
            let of_curve = rows.iter().filter(|row| row.accel == accel && row.strategy == strategy.name());
            let points = of_curve.filter_map(|row| Some((row.triangles as f64, row.seconds?))).collect();
            let name = format!("{}, {}", format!("{accel:?}").to_lowercase(), strategy.name());
            curves.push(Series { name, points, on_front: Vec::new(), dashes, markers });
        }
    }
    let title =
        format!("{} camera rays, {threads} threads, {} spheres", u64::from(args.side).pow(2), args.objects);
    Plot::new(&title, ("triangles", Scale::Log), ("seconds", Scale::Log), curves).svg()
}

fn seconds(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 => Ok(value),
        _ => Err("give a number of seconds above 0".into()),
    }
}
