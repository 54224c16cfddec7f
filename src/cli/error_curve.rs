//! `heliostat bench error`: flags to a plan, and what was measured as a table, CSV, JSON and a plot of each scene.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use super::error_report::{self, Files};
use super::{note, print, render, warn};
use crate::cluster::{Comm, share, threads};
use crate::error::{Error, Result};
use crate::job::{self, Crew};
use crate::lab::error_curve::reference::{Cache, PARTS, Quality, fingerprint};
use crate::lab::error_curve::{self, Curve, Plan, Subject};
use crate::lab::ladder::textbook::Precision;
use crate::output::progress::ProgressKind;
use crate::output::timeline::Timeline;
use crate::scene::load;
use crate::settings::{AccelKind, BuildPreset, Crop, Direct, Filter, ImageSettings, Integrator, SamplerKind};

/// Measured where nobody names a scene.
const SCENES: [&str; 2] = ["scenes/cornell-path.toml", "scenes/sphereflake.toml"];

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes (.toml or .helio) or models (.obj) [default: scenes/cornell-path.toml and scenes/sphereflake.toml]
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Pixels across; alone it keeps the scene's aspect ratio [default: the scene's, else 512]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    width: Option<u32>,
    /// Pixels down; alone it keeps the scene's aspect ratio [default: the scene's, else 512]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    height: Option<u32>,
    /// How light is carried [default: the scene's, else whitted]
    #[arg(long)]
    integrator: Option<Integrator>,
    /// Curves of these samplers
    #[arg(
        long,
        value_name = "SAMPLER,…",
        value_delimiter = ',',
        default_value = "independent,stratified,sobol,blue"
    )]
    samplers: Vec<SamplerKind>,
    /// Curves of these pixel filters, each against a reference of its own [default: the scene's, else box]
    #[arg(long, value_name = "FILTER,…", value_delimiter = ',')]
    filters: Vec<Filter>,
    /// Curves of these ways in which paths find lights; of other integrators there is one
    #[arg(long, value_name = "WAY,…", value_delimiter = ',', default_value = "both")]
    direct: Vec<Direct>,
    /// Curves of these structures, which differ in time alone
    #[arg(long, value_name = "ACCEL,…", value_delimiter = ',', default_value = "bvh")]
    accels: Vec<AccelKind>,
    /// Curves of these arithmetics that find hits: the renderer's own, or a textbook tracer's (Möller-Trumbore, the quadratic formula, boxes that aren't padded, an ε) in f32 or
    /// f64. Those show what rounding costs; their times are those of plain code
    #[arg(long, value_name = "PRECISION,…", value_delimiter = ',', default_value = "exact")]
    precisions: Vec<Precision>,
    /// Curves of adaptive sampling besides, to the RMSEs of --targets
    #[arg(long)]
    adaptive: bool,
    /// Samples per pixel [default: 4, 16, 64, 256 and so on up to --max-spp, without paths also 1]
    #[arg(long, value_name = "N,…", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=65536))]
    spp: Vec<u32>,
    /// Where the default of --spp ends
    #[arg(long, value_name = "N", default_value_t = 1024, conflicts_with = "spp", value_parser = clap::value_parser!(u32).range(1..=65536))]
    max_spp: u32,
    /// The RMSEs that --adaptive asks for
    #[arg(long, value_name = "E,…", value_delimiter = ',', default_value = "0.1,0.05,0.02,0.01,0.005,0.002", requires = "adaptive", value_parser = render::positive)]
    targets: Vec<f64>,
    /// Seeds over which errors are averaged
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,
    /// Renders of each rung, whose median time is told; no fewer than the seeds
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Leave out what would take all its rounds longer than this
    #[arg(long, value_name = "SECONDS", default_value_t = 8.0, value_parser = render::seconds)]
    limit: f64,
    /// Samples per pixel of the reference [default: as many as --reference-limit allows, 64 to 4096]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(i64::from(2 * PARTS)..=65536))]
    reference_spp: Option<u32>,
    /// About how long the reference may take
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, conflicts_with = "reference_spp", value_parser = render::seconds)]
    reference_limit: f64,
    /// Keep references in this folder, and use those that are there
    #[arg(long, value_name = "FOLDER")]
    cache: Option<PathBuf>,
    /// First seed of the samples [default: the scene's, else 0]
    #[arg(long, value_name = "N", env = "HELIOSTAT_SEED")]
    seed: Option<u64>,
    #[command(flatten)]
    files: Files,
    /// Threads of each rank [env: HELIOSTAT_THREADS, each rank's own] [default: the processors, divided among the ranks that share them]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// Collective: `args` are rank 0's.
pub fn run(comm: &dyn Comm, args: Option<Args>) -> Result<()> {
    let flag = share::computed(comm, || Ok(args.as_ref().and_then(|args| args.threads)))?;
    let pool = share::agreed(comm, job::thread_pool(threads::choose(comm, flag)?))?;
    let wide_pool = job::wide_pool(comm, &pool)?;
    let wide = wide_pool.as_ref().unwrap_or(&pool);
    let (timeline, progress) = (&Timeline::off(), ProgressKind::None.start());
    let crew = Crew { comm, pool: &pool, wide, timeline, progress: &*progress };

    let scenes = share::computed(comm, || args.as_ref().map_or(Ok(Vec::new()), check))?;
    let mut all = Vec::new();
    for number in 0..scenes.len() {
        // Rank 0 reads and builds; then all render.
        let prepared = share::outcome(comm, || {
            args.as_ref().map(|args| wide.install(|| prepare(args, &scenes, number))).transpose()
        })?;
        let tell = |what: &str| note(format_args!("{}: {what}", scenes[number].1));
        let given = prepared.as_ref().map(|(_, plan)| plan.clone());
        let subject = prepared.map(|(subject, _)| subject).zip(given.as_ref());
        let measured = error_curve::measure(&crew, subject, &tell)?;
        share::outcome(comm, || match &measured {
            Some(measured) => print(&error_report::table(measured)),
            None => Ok(()),
        })?;
        all.extend(measured);
    }
    share::outcome(comm, || args.map_or(Ok(()), |args| error_report::write(&args.files, comm.size(), &all)))
}

/// The scenes and a name for each. What can be known to fail at the end is found out now.
fn check(args: &Args) -> Result<Vec<(PathBuf, String)>> {
    let mut scenes = args.scenes.clone();
    if scenes.is_empty() {
        scenes = SCENES.map(PathBuf::from).into();
        if let Some(missing) = scenes.iter().find(|scene| !scene.is_file()) {
            let what = format!("none is named, and there is no {} here", missing.display());
            return Err(Error::usage(
                "SCENE",
                what,
                "name a scene, or run it in the folder that holds scenes/",
            ));
        }
    }
    let mut named: Vec<(PathBuf, String)> = Vec::new();
    for (number, scene) in scenes.into_iter().enumerate() {
        let stem = scene.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let is_taken = named.iter().any(|(_, name)| *name == stem);
        named.push((scene, if is_taken { format!("{stem}-{}", number + 1) } else { stem }));
    }
    args.files.check(named.iter().map(|(_, name)| name.as_str()))?;
    if let Some(folder) = &args.cache {
        std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
    }
    Ok(named)
}

/// Rank 0: reads a scene and settles what is measured of it.
fn prepare(args: &Args, scenes: &[(PathBuf, String)], number: usize) -> Result<(Subject, Plan)> {
    let (path, name) = &scenes[number];
    let mut loaded = load::load(path)?;
    warn(&loaded.warnings);
    let scene = &loaded.image;
    let default = ImageSettings::default();
    let (width, height) = render::size((args.width, args.height), scene, &default)?;
    let integrator = args.integrator.or(scene.integrator).unwrap_or(default.integrator);
    let image = ImageSettings {
        seed: args.seed.or(scene.seed).unwrap_or(default.seed),
        integrator,
        max_depth: scene.max_depth.unwrap_or(integrator.max_depth()),
        min_weight: scene.min_weight.unwrap_or(default.min_weight),
        filter: scene.filter.unwrap_or(default.filter),
        crop: Crop { x0: 0, y0: 0, x1: width, y1: height },
        ..ImageSettings::sized(width, height)
    };
    loaded.fit(width, height);
    let accels = distinct(&args.accels);
    let built = accels.iter().map(|&kind| build(kind, &loaded.scene, path)).collect::<Result<_>>()?;
    let cache = match &args.cache {
        None => None,
        Some(folder) => {
            Some(Cache { folder: folder.clone(), name: name.clone(), scene: fingerprint(&loaded.scene)? })
        }
    };
    let plan = plan(args, &image, &accels);
    Ok((Subject { name: name.clone(), scene: loaded.scene, accels: built, image, cache }, plan))
}

fn build(kind: AccelKind, scene: &crate::scene::Scene, path: &Path) -> Result<crate::accel::Accel> {
    super::build_accel(kind, BuildPreset::default(), &scene.surfaces, path)
}

fn plan(args: &Args, image: &ImageSettings, accels: &[AccelKind]) -> Plan {
    let filters = if args.filters.is_empty() { vec![image.filter] } else { distinct(&args.filters) };
    let is_path = image.integrator == Integrator::Path;
    let directs = if is_path { distinct(&args.direct) } else { vec![Direct::default()] };
    // Textbook tracers have a hierarchy of their own.
    let of_precision = |precision| match precision {
        Precision::Exact => accels.iter().map(|&accel| (accel, precision)).collect(),
        Precision::F32 | Precision::F64 => vec![(AccelKind::Bvh, precision)],
    };
    let ways: Vec<(AccelKind, Precision)> =
        distinct(&args.precisions).into_iter().flat_map(of_precision).collect();
    let mut curves = Vec::new();
    for adaptive in [false, true].into_iter().filter(|&adaptive| args.adaptive || !adaptive) {
        for &filter in &filters {
            for &direct in &directs {
                for &(accel, precision) in &ways {
                    let of_sampler = |sampler| Curve { sampler, filter, direct, accel, precision, adaptive };
                    curves.extend(distinct(&args.samplers).into_iter().map(of_sampler));
                }
            }
        }
    }
    let mut spp = args.spp.clone();
    if spp.is_empty() {
        let ladder = (0..=8).map(|step| 1 << (2 * step));
        spp =
            ladder.filter(|&spp| spp <= args.max_spp && (spp > 1 || !is_path || args.max_spp < 4)).collect();
    }
    spp.sort_unstable();
    spp.dedup();
    let mut targets = args.targets.clone();
    targets.sort_by(|a, b| b.total_cmp(a));
    targets.dedup();
    Plan {
        curves,
        spp,
        targets,
        rounds: args.rounds,
        seeds: args.seeds,
        limit: args.limit,
        reference: args.reference_spp.map_or(Quality::Seconds(args.reference_limit), Quality::Samples),
    }
}

/// Each once, in the order of their first appearance.
fn distinct<T: Copy + PartialEq>(values: &[T]) -> Vec<T> {
    let mut found: Vec<T> = Vec::new();
    for &value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}
