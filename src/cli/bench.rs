//! `heliostat bench`: what the tracer costs, as tables and as JSON.

use std::fmt::Write as _;
use std::io::Write as _;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{builds, error_curve, print, strategies};
use crate::accel::wide::traversal::Traversal;
use crate::cluster::{Solo, threads};
use crate::error::{Error, Result};
use crate::job;
use crate::lab::kernels::{self, FileRay, Kind, Mode, RaySet, Subject};
use crate::output::file;
use crate::settings::{BuildPreset, BuildSettings};
use crate::simd::Level;

#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Rays in a second, by class of rays, traversal and level of instructions.
    Kernels(KernelsArgs),
    /// One thread, threads over triangles and threads over rays, by number of triangles and structure.
    Strategies(strategies::Args),
    /// Time and memory of building each structure on terrain of growing size.
    Builds(builds::Args),
    /// Error against time: images of growing effort beside a reference. Under mpirun all ranks render them.
    Error(Box<error_curve::Args>),
}

#[derive(Debug, clap::Args)]
pub struct KernelsArgs {
    /// Scenes (.toml or .helio), models (.obj) or plain meshes (.tri: u32 vertices, u32 triangles, f32[3] each, u32[3] each)
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// The same, by a flag; may be repeated
    #[arg(long, value_name = "FILE")]
    mesh: Vec<PathBuf>,
    /// Trace the rays of this file alone: f32[8] each, origin, t_min, direction, t_max
    #[arg(long, value_name = "FILE", requires = "kind", conflicts_with = "write_rays")]
    rays: Option<PathBuf>,
    /// What the rays of --rays ask
    #[arg(long, requires = "rays")]
    kind: Option<Kind>,
    /// Write the classes prim, shad, diff and rand as NAME.CLASS.rays into this folder, and measure nothing
    #[arg(long, value_name = "DIR")]
    write_rays: Option<PathBuf>,
    /// Time given to building the hierarchy
    #[arg(long, env = "HELIOSTAT_BUILD", default_value = "balanced")]
    build: BuildPreset,
    /// Measure the uniform grid, too, beside the textbook's walk through the same cells
    #[arg(long, conflicts_with_all = ["rays", "write_rays"])]
    grid: bool,
    /// Cells of the grid for each primitive
    #[arg(long, value_name = "N", default_value_t = BuildSettings::GRID_DENSITY, requires = "grid", value_parser = super::render::density)]
    grid_density: f64,
    /// Rounds of each measurement; their median is told
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Seed of the rays
    #[arg(long, value_name = "N", env = "HELIOSTAT_SEED", default_value_t = 0)]
    seed: u64,
    /// A line of JSON for each measurement
    #[arg(long)]
    json: bool,
    /// Threads [env: HELIOSTAT_THREADS] [default: the processors]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// One measurement.
#[derive(Serialize)]
struct Row<'a> {
    scene: &'a str,
    primitives: usize,
    build_s: f64,
    class: &'a str,
    /// The traversal and its level of instructions.
    mode: String,
    threads: usize,
    rays: usize,
    hits: usize,
    /// Million rays in a second: the median of the rounds, the slowest and the fastest.
    mrays: f64,
    slowest: f64,
    fastest: f64,
}

pub fn kernels(args: &KernelsArgs) -> Result<()> {
    let scenes: Vec<&Path> = args.scenes.iter().chain(&args.mesh).map(PathBuf::as_path).collect();
    if scenes.is_empty() {
        return Err(Error::usage("SCENE", "nothing to trace", "name a scene or give --mesh"));
    }
    let pool = job::thread_pool(threads::choose(&Solo::new(), args.threads)?)?;
    pool.install(|| {
        let file = match (&args.rays, args.kind) {
            (Some(path), Some(kind)) => Some(RaySet { name: "file", kind, rays: kernels::read_rays(path)? }),
            _ => None,
        };
        for scene in scenes {
            let mut subject = Subject::load(scene, args.build)?;
            match (&file, &args.write_rays) {
                (Some(set), _) => report(args, scene, &subject, set, &[Mode::chosen()])?,
                (None, Some(folder)) => write_classes(args, scene, &subject, folder)?,
                (None, None) => {
                    let levels = || {
                        Level::ALL
                            .into_iter()
                            .filter(|level| level.is_available() && *level <= Level::chosen())
                    };
                    let mut modes: Vec<_> = Traversal::ALL
                        .into_iter()
                        .flat_map(|traversal| levels().map(move |level| Mode::Tree(traversal, level)))
                        .collect();
                    if args.grid {
                        subject.build_grid(args.grid_density);
                        modes.extend([Mode::Grid, Mode::PlainGrid]);
                    }
                    for set in subject.classes(args.seed) {
                        report(args, scene, &subject, &set, &modes)?;
                    }
                }
            }
        }
        Ok(())
    })
}

fn report(args: &KernelsArgs, scene: &Path, subject: &Subject, set: &RaySet, modes: &[Mode]) -> Result<()> {
    let mut text = String::new();
    for &mode in modes {
        let (mut seconds, hits) = subject.time(mode, &set.rays, set.kind, args.rounds as usize);
        seconds.sort_by(f64::total_cmp);
        let rate = |seconds: f64| set.rays.len() as f64 / seconds / 1e6;
        let row = Row {
            scene: &stem(scene),
            primitives: subject.primitives(),
            build_s: subject.build.as_secs_f64(),
            class: set.name,
            mode: mode.name(),
            threads: rayon::current_num_threads(),
            rays: set.rays.len(),
            hits,
            mrays: rate(seconds[seconds.len() / 2]),
            slowest: rate(seconds[seconds.len() - 1]),
            fastest: rate(seconds[0]),
        };
        if args.json {
            let line =
                serde_json::to_string(&row).map_err(|error| Error::write("standard output", error.into()))?;
            text.push_str(&line);
            text.push('\n');
        } else {
            let _ = writeln!(
                text,
                "{:<16} {:>9} primitives, built in {:.2} s  {:<5} {:<20} {:>8.2} Mray/s  [{:.2}..{:.2}]  {:>8} of {} hit",
                row.scene,
                row.primitives,
                row.build_s,
                row.class,
                row.mode,
                row.mrays,
                row.slowest,
                row.fastest,
                row.hits,
                row.rays
            );
        }
    }
    print(&text)
}

fn write_classes(args: &KernelsArgs, scene: &Path, subject: &Subject, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
    for set in subject.classes(args.seed).iter().filter(|set| set.name != "ao") {
        let path = folder.join(format!("{}.{}.rays", stem(scene), set.name));
        file::write_whole(&path, |out| out.write_all(bytemuck::cast_slice::<FileRay, u8>(&set.rays)))?;
    }
    Ok(())
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}
