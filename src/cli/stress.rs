//! `heliostat stress`: aimed rays against exact arithmetic, as a table and as JSON.

use std::fmt::Write as _;
use std::io::Write as _;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::{note, print};
use crate::cluster::share::{self, Share};
use crate::cluster::{Comm, threads, wire};
use crate::error::{Error, Result};
use crate::job;
use crate::lab::ladder;
use crate::lab::meshes::Body;
use crate::lab::stress::{self, Plan, Subject};
use crate::lab::tally::{Spread, Tally};
use crate::output::file;
use crate::output::progress::ProgressKind;
use crate::scene::load;
use crate::settings::{AccelKind, BuildPreset};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Rays of all meshes together; 1e7 is a number, too
    #[arg(long, value_name = "N", env = "HELIOSTAT_STRESS_RAYS", default_value = "1e5", value_parser = count)]
    rays: u64,
    /// Seed of the rays
    #[arg(long, value_name = "N", env = "HELIOSTAT_SEED", default_value_t = 0)]
    seed: u64,
    /// The structures that must give the same exact answers; may be repeated
    #[arg(long, value_delimiter = ',', default_value = "bvh,grid,spheres,brute")]
    accel: Vec<AccelKind>,
    /// How the hierarchy is built; never changes an answer
    #[arg(long, env = "HELIOSTAT_BUILD", default_value = "balanced")]
    build: BuildPreset,
    /// Trace these models, too; may be repeated
    #[arg(long, value_name = "FILE.obj")]
    mesh: Vec<PathBuf>,
    /// Leave out the generated meshes
    #[arg(long, requires = "mesh")]
    only_mesh: bool,
    /// Compare textbook arithmetic instead: f32, f64, half boxes and integers beside the tracer's own
    #[arg(long, conflicts_with_all = ["mesh", "accel"])]
    ladder: bool,
    /// Write a picture of spheres for each arithmetic into this folder
    #[arg(long, value_name = "DIR", requires = "ladder")]
    picture: Option<PathBuf>,
    /// Write the table as JSON, of the stress test for every mesh in every place
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// How a long run shows what is done, on standard error; where an answer is wrong it is said at once
    #[arg(long, value_name = "KIND", default_value = "auto")]
    progress: ProgressKind,
    /// Threads of each rank [env: HELIOSTAT_THREADS, each rank's own] [default: the processors, divided among the ranks that share them]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

fn count(text: &str) -> std::result::Result<u64, String> {
    let number: f64 = text.parse().map_err(|_| "give a number such as 1000000 or 1e6".to_string())?;
    if (1.0..=1e15).contains(&number) && number.fract() == 0.0 {
        Ok(number as u64)
    } else {
        Err("give a whole number from 1 to 1e15".into())
    }
}

/// Collective: `args` are rank 0's.
pub fn run(comm: &dyn Comm, args: Option<Args>) -> Result<()> {
    comm.barrier();
    let start = Instant::now();
    let flag = share::computed(comm, || Ok(args.as_ref().and_then(|args| args.threads)))?;
    let pool = job::thread_pool(threads::choose(comm, flag)?)?;
    if share::computed(comm, || Ok(args.as_ref().is_some_and(|args| args.ladder)))? {
        // Its times are one machine's: rank 0 alone.
        return share::outcome(comm, || args.as_ref().map_or(Ok(()), |args| pool.install(|| climb(args))));
    }

    // Rank 0 reads; then everybody has it.
    let (plan, generate) = share::computed(comm, || {
        let args = args.as_ref().ok_or_else(|| Error::usage("stress", "no flags", "run it anew"))?;
        args.json.as_deref().map_or(Ok(()), file::check_writable)?;
        let plan = Plan { rays: args.rays, seed: args.seed, accels: args.accel.clone(), build: args.build };
        Ok((plan, !args.only_mesh))
    })?;
    let mut read = share::outcome(comm, || {
        let files = args.iter().flat_map(|args| &args.mesh);
        files.map(|path| subject(path)).collect::<Result<Vec<_>>>()
    })?;
    share_subjects(&mut read, Share::new(comm))?;
    let mut subjects = if generate { stress::generated() } else { Vec::new() };
    subjects.append(&mut read);

    // Every rank traces its part of each; rank 0 shows how far it is.
    let (rank, size) = (comm.rank(), comm.size());
    let progress = args.as_ref().map_or(ProgressKind::None, |args| args.progress).start();
    progress.begin(plan.rays / size as u64);
    let mut tallies = Vec::with_capacity(subjects.len());
    for (number, subject) in subjects.iter().enumerate() {
        let rays = plan.rays_of(number, subjects.len());
        let traced = || stress::run(subject, number, rays, &plan, rank, size, |rays| progress.advance(rays));
        let tally = pool.install(traced)?;
        if let Some(first) = tally.first_wrong {
            let Subject { shape, place, .. } = subject;
            note(format_args!(
                "heliostat: {} wrong answers for {shape} {place}, first ray {first}",
                tally.wrong()
            ));
        }
        tallies.push(tally);
    }
    progress.end();

    // Rank 0 adds up and says.
    let gathered = comm.gather(&wire::encode(&tallies)?);
    share::outcome(comm, || {
        let mut sums = vec![Tally::default(); subjects.len()];
        for bytes in gathered.iter().flatten() {
            let part: Vec<Tally> = wire::decode(bytes)?;
            sums.iter_mut().zip(&part).for_each(|(sum, part)| sum.merge(part));
        }
        let seconds = start.elapsed().as_secs_f64();
        report(&plan, &subjects, &sums, seconds, args.as_ref().and_then(|args| args.json.as_deref()))
    })
}

/// Shows what more digits buy.
fn climb(args: &Args) -> Result<()> {
    args.json.as_deref().map_or(Ok(()), file::check_writable)?;
    let table = ladder::run(args.rays, args.seed, args.picture.as_deref())?;
    print(&table.to_string())?;
    args.json.as_deref().map_or(Ok(()), |path| write_json(path, &table))
}

fn write_json(path: &Path, table: &impl Serialize) -> Result<()> {
    file::write_whole(path, |out| {
        serde_json::to_writer_pretty(&mut *out, table)?;
        out.write_all(b"\n")
    })
}

/// A model as one body.
fn subject(path: &Path) -> Result<Subject> {
    let surfaces = load::obj::read(path, &mut load::texture::Textures::default())?;
    let mut body = Body::default();
    for (mesh, _) in surfaces.meshes {
        let first = body.positions.len() as u32;
        body.positions.extend(mesh.positions);
        body.triangles.extend(mesh.triangles.into_iter().map(|t| t.map(|v| v + first)));
    }
    let shape =
        path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into());
    let place = if body.is_closed() { "closed" } else { "open" }.into();
    Ok(Subject { shape, place, body })
}

fn share_subjects(subjects: &mut Vec<Subject>, share: Share) -> Result<()> {
    let mut number = subjects.len() as u64;
    share.value(&mut number)?;
    subjects.resize_with(number as usize, Subject::default);
    for subject in subjects {
        share.value(&mut subject.shape)?;
        share.value(&mut subject.place)?;
        share.array(&mut subject.body.positions)?;
        share.array(&mut subject.body.triangles)?;
    }
    Ok(())
}

fn report(
    plan: &Plan,
    subjects: &[Subject],
    tallies: &[Tally],
    seconds: f64,
    json: Option<&Path>,
) -> Result<()> {
    let mut total = Tally::default();
    tallies.iter().for_each(|tally| total.merge(tally));
    let mut text = String::new();
    let head = [
        "",
        "rays",
        "leaks",
        "misses",
        "skipped",
        "false",
        "self",
        "differ",
        "too close",
        "t error p50",
        "p99.9",
        "max",
    ];
    line(&mut text, &head.map(String::from));
    for name in [|s: &Subject| s.shape.clone(), |s: &Subject| s.place.clone()] {
        for (name, tally) in grouped(subjects, tallies, name) {
            line(&mut text, &cells(&name, &tally));
        }
        text.push('\n');
    }
    line(&mut text, &cells("all", &total));
    let unit = |part| total.fine.quantile(part);
    let _ = writeln!(
        text,
        "\nt error in ulps of f32; in units of 2^-53 (|origin| + |vertex|): p50 {:.2}, p99.9 {:.2}, max {:.3e}",
        unit(0.5),
        unit(0.999),
        total.fine.largest
    );
    let _ = writeln!(text, "seed {}, {seconds:.1} s", plan.seed);
    print(&text)?;
    if let Some(path) = json {
        let rows = subjects.iter().zip(tallies).map(|(s, tally)| Row::new(&s.shape, &s.place, tally));
        let all = Report {
            seed: plan.seed,
            accels: &plan.accels,
            seconds,
            meshes: rows.collect(),
            total: Row::new("all", "", &total),
        };
        write_json(path, &all)?;
    }
    verdict(plan, subjects, tallies, &total)
}

/// One line of failure, which says how to see it again.
fn verdict(plan: &Plan, subjects: &[Subject], tallies: &[Tally], total: &Tally) -> Result<()> {
    let worst = subjects.iter().zip(tallies).find_map(|(subject, tally)| Some((subject, tally.first_wrong?)));
    match worst {
        None => Ok(()),
        Some((subject, index)) => Err(Error::Inexact(format!(
            "{} of {} answers are wrong, the first of them ray {index} of {} {} (seed {}); the tracer needs mending",
            total.wrong(),
            total.rays,
            subject.shape,
            subject.place,
            plan.seed
        ))),
    }
}

/// Tallies of equal names added up, in the order of their first appearance.
fn grouped(subjects: &[Subject], tallies: &[Tally], name: fn(&Subject) -> String) -> Vec<(String, Tally)> {
    let mut groups: Vec<(String, Tally)> = Vec::new();
    for (subject, tally) in subjects.iter().zip(tallies) {
        let name = name(subject);
        match groups.iter_mut().find(|(known, _)| *known == name) {
            Some((_, sum)) => sum.merge(tally),
            None => groups.push((name, tally.clone())),
        }
    }
    groups
}

fn cells(name: &str, tally: &Tally) -> [String; 12] {
    let ulps = |part| significant(tally.ulps.quantile(part));
    [
        name.into(),
        tally.rays.to_string(),
        tally.leaks.to_string(),
        tally.misses.to_string(),
        tally.skipped.to_string(),
        tally.false_hits.to_string(),
        tally.self_hits.to_string(),
        tally.differ.to_string(),
        tally.too_close.to_string(),
        ulps(0.5),
        ulps(0.999),
        significant(tally.ulps.largest),
    ]
}

fn significant(number: f64) -> String {
    if number == 0.0 { "0".into() } else { format!("{number:.1e}") }
}

fn line(text: &mut String, cells: &[String; 12]) {
    const WIDTHS: [usize; 12] = [16, 10, 7, 7, 8, 7, 7, 7, 10, 12, 8, 8];
    for (column, (cell, width)) in cells.iter().zip(WIDTHS).enumerate() {
        let _ = if column == 0 { write!(text, "{cell:<width$}") } else { write!(text, "{cell:>width$}") };
    }
    text.push('\n');
}

#[derive(Serialize)]
struct Report<'a> {
    seed: u64,
    accels: &'a [AccelKind],
    seconds: f64,
    meshes: Vec<Row<'a>>,
    total: Row<'a>,
}

#[derive(Serialize)]
struct Row<'a> {
    mesh: &'a str,
    place: &'a str,
    rays: u64,
    leaks: u64,
    misses: u64,
    skipped: u64,
    false_hits: u64,
    self_hits: u64,
    differ: u64,
    too_close: u64,
    t_error_f32_ulps: Quantiles,
    t_error_f64_units: Quantiles,
    first_wrong: Option<u64>,
}

#[derive(Serialize)]
struct Quantiles {
    p50: f64,
    p99_9: f64,
    max: f64,
}

impl Quantiles {
    fn new(spread: &Spread) -> Self {
        Quantiles { p50: spread.quantile(0.5), p99_9: spread.quantile(0.999), max: spread.largest }
    }
}

impl<'a> Row<'a> {
    fn new(mesh: &'a str, place: &'a str, tally: &Tally) -> Self {
        Row {
            mesh,
            place,
            rays: tally.rays,
            leaks: tally.leaks,
            misses: tally.misses,
            skipped: tally.skipped,
            false_hits: tally.false_hits,
            self_hits: tally.self_hits,
            differ: tally.differ,
            too_close: tally.too_close,
            t_error_f32_ulps: Quantiles::new(&tally.ulps),
            t_error_f64_units: Quantiles::new(&tally.fine),
            first_wrong: tally.first_wrong,
        }
    }
}
