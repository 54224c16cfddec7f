//! `heliostat render`: flags and scene file to settings, and the render from first to last.

mod args;

use std::path::PathBuf;
use std::time::Instant;

pub use self::args::Args;
use self::args::{Aov, image_settings};
pub(super) use self::args::{Copies, copies, density, positive, seconds, size};
use super::{note, warn};
use crate::accel::{Accel, divided};
use crate::cluster::share;
use crate::cluster::{self, Comm, threads};
use crate::error::{Error, Result};
use crate::image::Layer;
use crate::job::{self, Crew, Rendered, Work};
use crate::output::progress::ProgressKind;
use crate::output::stats::{RankStats, Stats};
use crate::output::timeline::{self, Timeline};
use crate::output::write::{self, Target, WriteOptions};
use crate::output::{file, metadata};
use crate::render::estimate::Spread;
use crate::render::features::Features;
use crate::scene::load;
use crate::settings::{BuildSettings, RunSettings, Show, Split, Within};

/// What rank 0 alone keeps: where to write and what to say.
struct Errand {
    targets: Vec<Target>,
    aov: Vec<Aov>,
    stats: Option<PathBuf>,
    timeline: Option<PathBuf>,
    quiet: bool,
    verbose: bool,
}

/// Collective: `args` are rank 0's.
pub fn run(comm: &dyn Comm, args: Option<Args>) -> Result<()> {
    comm.barrier();
    let start = Instant::now();
    let mut stats = RankStats { rank: comm.rank() as u32, ..RankStats::default() };

    // What each rank must know before there is a scene.
    let flag = share::computed(comm, || Ok(args.as_ref().and_then(|args| args.threads)))?;
    let traced = share::computed(comm, || Ok(args.as_ref().is_some_and(|args| args.timeline.is_some())))?;
    let pool = share::agreed(comm, job::thread_pool(threads::choose(comm, flag)?))?;
    stats.threads = pool.current_num_threads() as u32;
    let wide_pool = job::wide_pool(comm, &pool)?;
    let wide = wide_pool.as_ref().unwrap_or(&pool);
    let timeline = if traced { Timeline::starting_at(stats.rank, start) } else { Timeline::off() };
    let progress = args.as_ref().map_or(ProgressKind::None, |args| args.progress).start();

    // Rank 0 reads, checks and builds; then everybody has it.
    let made = share::outcome(comm, || match args {
        Some(args) => wide.install(|| prepare(args, &timeline, &mut stats)).map(Some),
        None => Ok(None),
    })?;
    let (mut work, errand) = made.map_or((Work::default(), None), |(work, errand)| (work, Some(errand)));
    let begin = Instant::now();
    let crew = Crew { comm, pool: &pool, wide, timeline: &timeline, progress: &*progress };
    job::distribute(&crew, &mut work)?;
    stats.seconds.broadcast = begin.elapsed().as_secs_f64();
    let rendered = job::render(&crew, &mut work, &mut stats)?;

    // Rank 0 writes; a full disk is everybody's error.
    let begin = Instant::now();
    share::outcome(comm, || match (&rendered, &errand) {
        (Some(rendered), Some(errand)) => {
            let _span = timeline.span(0, "write");
            write_image(rendered, &work, errand)
        }
        _ => Ok(()),
    })?;
    stats.seconds.write = begin.elapsed().as_secs_f64();
    stats.bytes_sent = comm.bytes_sent();
    let ranks = job::gather_stats(comm, &stats)?;
    let events = job::gather_events(comm, &timeline)?;
    share::outcome(comm, || match (errand, ranks, events, rendered) {
        (Some(errand), Some(ranks), Some(events), Some(rendered)) => {
            if let Some(path) = &errand.timeline {
                timeline::write(path, &events)?;
            }
            let image = &work.image;
            let seconds = start.elapsed().as_secs_f64();
            let stats = Stats::new(image.width, image.height, image.spp, seconds, ranks);
            report(&errand, &Stats { error: rendered.error, ..stats })?;
            if rendered.complete { Ok(()) } else { Err(stopped(&rendered)) }
        }
        _ => Ok(()),
    })
}

/// Rank 0: reads the scene, settles the settings, builds the accelerator.
fn prepare(args: Args, timeline: &Timeline, stats: &mut RankStats) -> Result<(Work, Errand)> {
    let errand = errand(&args)?;
    let begin = Instant::now();
    let span = timeline.span(0, "load");
    let mut loaded = load::load(&args.scene)?;
    drop(span);
    stats.seconds.load = begin.elapsed().as_secs_f64();
    let image = image_settings(&args, &loaded.image)?;
    loaded.fit(image.width, image.height);
    if image.show == Show::Bounds {
        let (spheres, left_out) = loaded.scene.bounding_spheres();
        loaded.scene = spheres;
        if left_out > 0 {
            let what = format!(
                "{}: the camera is inside bounding spheres, which are left out: {left_out}",
                args.scene.display()
            );
            loaded.warnings.push(what);
        }
    }
    let run = RunSettings {
        accel: args.accel,
        build: BuildSettings { preset: args.build, grid_density: args.grid_density },
        split: args.split,
        within: args.within,
        tile_size: args.tile_size.unwrap_or_else(|| RunSettings::tile_size_for(&image)),
        deal: args.deal,
        ray_memory: args.ray_memory,
        replicate_hot: replicates(args.replicate_hot, args.split)?,
        time_limit: args.time_limit,
    };
    if run.split.is_partitioned() && run.within == Within::Triangles {
        return Err(Error::usage(
            "--within",
            "triangles divides the whole scene, of which ranks have only a part with this --split",
            "leave it out, or give --split tiles or stream",
        ));
    }
    if !errand.quiet {
        warn(&loaded.warnings);
    }
    if errand.verbose {
        metadata::describe(&image).iter().for_each(|(key, value)| note(format_args!("{key}: {value}")));
    }
    let begin = Instant::now();
    let _span = timeline.span(0, "build");
    let surfaces = &loaded.scene.surfaces;
    let accel = match run.within {
        // A part of the scene gets its structure where it is.
        Within::Rays if run.split.is_partitioned() => Accel::empty(run.accel),
        Within::Rays => crate::cli::build_accel(run.accel, run.build, surfaces, &args.scene)?,
        // Each rank builds for its own threads.
        Within::Triangles => {
            let needed = Accel::memory_to_build(run.accel, run.build.preset, surfaces)
                + divided::BYTES_TO_DIVIDE * surfaces.len() as u64;
            crate::cli::afford(needed, surfaces, &args.scene)?;
            Accel::empty(run.accel)
        }
    };
    stats.seconds.build = begin.elapsed().as_secs_f64();
    Ok((Work { scene: loaded.scene, accel, image, run, division: None }, errand))
}

/// The memory for copies of hot blocks, where there are blocks.
pub(super) fn replicates(asked: Option<Copies>, split: Split) -> Result<Option<u64>> {
    match asked {
        Some(Copies(Some(_))) if split != Split::Voxels => Err(Error::usage(
            "--replicate-hot",
            "only blocks of voxels are replicated, which this --split has none of",
            "leave it (HELIOSTAT_REPLICATE_HOT, too) out, or give --split voxels",
        )),
        Some(Copies(bytes)) => Ok(bytes),
        None => Ok((split == Split::Voxels).then_some(RunSettings::REPLICATE_HOT)),
    }
}

/// Whatever can be known to fail at the end is found out at the beginning.
fn errand(args: &Args) -> Result<Errand> {
    let mut outputs = args.output.clone();
    if outputs.is_empty() {
        let stem = args.scene.file_stem().map_or("image".into(), |stem| stem.to_string_lossy());
        outputs.push(format!("{stem}.png"));
    }
    let targets = outputs.iter().map(|output| Target::parse(output)).collect::<Result<Vec<_>>>()?;
    // Under a launcher nobody knows whether standard output is a terminal in the end.
    let unknown = |target: &&Target| **target == Target::Stdout && cluster::is_launched();
    targets.iter().filter(|target| !unknown(target)).try_for_each(Target::check_writable)?;
    if !args.aov.is_empty() {
        targets.iter().try_for_each(Target::check_layers)?;
    }
    for path in [&args.stats, &args.timeline].into_iter().flatten() {
        file::check_writable(path)?;
    }
    Ok(Errand {
        targets,
        aov: args.aov.clone(),
        stats: args.stats.clone(),
        timeline: args.timeline.clone(),
        quiet: args.quiet,
        verbose: args.verbose,
    })
}

fn write_image(rendered: &Rendered, work: &Work, errand: &Errand) -> Result<()> {
    let mut metadata = metadata::describe(&work.image);
    metadata.extend(rendered.error.iter().flat_map(metadata::describe_error));
    let options = WriteOptions { encoding: work.image.encoding, metadata };
    let layers = layers(rendered, &errand.aov);
    // One folder that is gone must not cost the images that another would take.
    let written: Vec<Result<()>> = errand
        .targets
        .iter()
        .map(|target| write::write_with_layers(&rendered.image, &layers, target, &options))
        .collect();
    written.into_iter().collect()
}

fn layers(rendered: &Rendered, aov: &[Aov]) -> Vec<Layer> {
    let Spread { variance, freedom } = rendered.spread.clone().unwrap_or_default();
    let Features { albedo, normal, position, depth, id } = rendered.features.clone().unwrap_or_default();
    [
        (Aov::Variance, Layer::variance(variance)),
        (Aov::Variance, Layer::freedom(freedom)),
        (Aov::Albedo, Layer::albedo(albedo)),
        (Aov::Normal, Layer::normal(normal)),
        (Aov::Position, Layer::position(position)),
        (Aov::Depth, Layer::depth(depth)),
        (Aov::Id, Layer::id(id)),
    ]
    .into_iter()
    .filter_map(|(kind, layer)| aov.contains(&kind).then_some(layer))
    .collect()
}

fn stopped(rendered: &Rendered) -> Error {
    let error = match &rendered.error {
        Some(error) => format!("after {:.1} samples per pixel, RMSE {:.2e}", error.spp, error.rmse),
        None => "with too few samples per pixel to tell an error".into(),
    };
    Error::Stopped(format!(
        "--time-limit ended the render {error}; the image is whole, give more time for a better one"
    ))
}

fn report(errand: &Errand, stats: &Stats) -> Result<()> {
    if let Some(path) = &errand.stats {
        stats.write(path)?;
    }
    if errand.verbose {
        for rank in &stats.ranks {
            note(rank);
        }
    }
    if !errand.quiet {
        note(stats);
        for target in &errand.targets {
            note(format_args!("wrote {target}"));
        }
    }
    Ok(())
}
