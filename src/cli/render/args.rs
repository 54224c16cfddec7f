//! The flags of `heliostat render`, and the image settings that follow from them and the scene file.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use crate::error::{Error, Result};
use crate::output::progress::ProgressKind;
use crate::scene::load::ImageDefaults;
use crate::settings::{
    AccelKind, BuildPreset, BuildSettings, Crop, Deal, Direct, Encoding, ErrorMetric, ErrorTarget, Filter,
    ImageSettings, Integrator, SamplerKind, Show, Split, Within,
};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene (.toml or .helio) or a model (.obj)
    pub(super) scene: PathBuf,
    /// Image file: .png, .exr or .pfm, or - for PNG on standard output; may be repeated [default: the scene's name, .png]
    #[arg(
        short,
        long,
        value_name = "FILE",
        env = "HELIOSTAT_OUTPUT",
        value_delimiter = ',',
        help_heading = "Image"
    )]
    pub(super) output: Vec<String>,
    /// Pixels across; alone it keeps the scene's aspect ratio [default: the scene's, else 512]
    #[arg(long, value_name = "N", env = "HELIOSTAT_WIDTH", value_parser = clap::value_parser!(u32).range(1..=65536), help_heading = "Image")]
    pub(super) width: Option<u32>,
    /// Pixels down; alone it keeps the scene's aspect ratio [default: the scene's, else 512]
    #[arg(long, value_name = "N", env = "HELIOSTAT_HEIGHT", value_parser = clap::value_parser!(u32).range(1..=65536), help_heading = "Image")]
    pub(super) height: Option<u32>,
    /// Samples per pixel; 1 goes through the pixel's centre [default: the scene's, else 1]
    #[arg(long, value_name = "N", env = "HELIOSTAT_SPP", value_parser = clap::value_parser!(u32).range(1..=65536), help_heading = "Image")]
    pub(super) spp: Option<u32>,
    /// Sample until the image's error is below this, most where that takes most of it away; --spp is the most samples then [default: 65536]
    #[arg(long, value_name = "E", env = "HELIOSTAT_ERROR_TARGET", value_parser = positive, help_heading = "Image")]
    pub(super) error_target: Option<f64>,
    /// What --error-target measures: root mean square error, relative mean square error, or root mean square error of sRGB display values
    #[arg(long, env = "HELIOSTAT_ERROR_METRIC", default_value = "rmse", help_heading = "Image")]
    pub(super) error_metric: ErrorMetric,
    /// Begin no more samples when the next ones would end later than this; the image is whole, its error is told, and the exit code is 75 if more was asked for
    #[arg(long, value_name = "SECONDS", env = "HELIOSTAT_TIME_LIMIT", value_parser = seconds, help_heading = "Image")]
    pub(super) time_limit: Option<f64>,
    /// What is written beside the image, as layers of an .exr file; may be repeated
    #[arg(long, value_name = "LAYER", env = "HELIOSTAT_AOV", value_delimiter = ',', help_heading = "Image")]
    pub(super) aov: Vec<Aov>,
    /// Seed of all random numbers [default: the scene's, else 0]
    #[arg(long, value_name = "N", env = "HELIOSTAT_SEED", help_heading = "Image")]
    pub(super) seed: Option<u64>,
    /// How light is carried [default: the scene's, else whitted]
    #[arg(long, env = "HELIOSTAT_INTEGRATOR", help_heading = "Image")]
    pub(super) integrator: Option<Integrator>,
    /// Bounces after the eye ray [default: the scene's, else 8, of paths 1000]
    #[arg(long, value_name = "N", env = "HELIOSTAT_MAX_DEPTH", help_heading = "Image")]
    pub(super) max_depth: Option<u32>,
    /// Bounces after which paths may end by chance, which changes no mean
    #[arg(long, value_name = "N", env = "HELIOSTAT_ROULETTE", default_value_t = ImageSettings::ROULETTE, help_heading = "Image")]
    pub(super) roulette: u32,
    /// How paths find lights that have an extent
    #[arg(long, env = "HELIOSTAT_DIRECT", default_value = "both", help_heading = "Image")]
    pub(super) direct: Direct,
    /// The random numbers that samples are made of [default: the scene's, else sobol]
    #[arg(long, env = "HELIOSTAT_SAMPLER", help_heading = "Image")]
    pub(super) sampler: Option<SamplerKind>,
    /// End branches whose weight is below this; 0 ends none; not for paths [default: the scene's, else 0]
    #[arg(long, value_name = "X", env = "HELIOSTAT_MIN_WEIGHT", value_parser = weight, help_heading = "Image")]
    pub(super) min_weight: Option<f64>,
    /// Pixel filter [default: the scene's, else box]
    #[arg(long, env = "HELIOSTAT_FILTER", help_heading = "Image")]
    pub(super) filter: Option<Filter>,
    /// Encoding of PNG files [default: the scene's, else srgb]
    #[arg(long, env = "HELIOSTAT_ENCODING", help_heading = "Image")]
    pub(super) encoding: Option<Encoding>,
    /// Render only pixels X0 <= x < X1, Y0 <= y < Y1; row 0 is on top
    #[arg(long, value_name = "X0,Y0,X1,Y1", env = "HELIOSTAT_CROP", value_parser = crop, help_heading = "Image")]
    pub(super) crop: Option<Crop>,
    /// What is seen: the scene, or the bounding spheres of its objects
    #[arg(long, env = "HELIOSTAT_SHOW", default_value = "scene", help_heading = "Image")]
    pub(super) show: Show,
    /// The structure that finds hits; never changes a byte of the image
    #[arg(long, env = "HELIOSTAT_ACCEL", default_value = "bvh", help_heading = "Run")]
    pub(super) accel: AccelKind,
    /// Time given to building the hierarchy, for less time of tracing; never changes a byte of the image
    #[arg(long, env = "HELIOSTAT_BUILD", default_value = "balanced", help_heading = "Run")]
    pub(super) build: BuildPreset,
    /// Cells of --accel grid for each primitive; never changes a byte of the image
    #[arg(long, value_name = "X", env = "HELIOSTAT_GRID_DENSITY", default_value_t = BuildSettings::GRID_DENSITY, value_parser = density, help_heading = "Run")]
    pub(super) grid_density: f64,
    /// How ranks divide the work; never changes a byte of the image
    #[arg(long, env = "HELIOSTAT_SPLIT", default_value = "tiles", help_heading = "Run")]
    pub(super) split: Split,
    /// How splits other than tiles deal the pixels to ranks
    #[arg(long, env = "HELIOSTAT_DEAL", default_value = "interleaved", help_heading = "Run")]
    pub(super) deal: Deal,
    /// Memory of each rank for rays that travel, with --split triangles or voxels; more rays wait in temporary files
    #[arg(long, value_name = "BYTES", env = "HELIOSTAT_RAY_MEMORY", default_value = "256M", value_parser = bytes, help_heading = "Run")]
    pub(super) ray_memory: u64,
    /// Memory of each rank, about, for copies of the blocks that most rays come to and all textures, beside its own part, with --split voxels; `none` copies nothing; --stats tells what was copied; never changes a byte of the image [default: 32M]
    #[arg(long, value_name = "BYTES", env = "HELIOSTAT_REPLICATE_HOT", value_parser = copies, help_heading = "Run")]
    pub(super) replicate_hot: Option<Copies>,
    /// How the threads of a rank divide its work; never changes a byte of the image
    #[arg(long, env = "HELIOSTAT_WITHIN", default_value = "rays", help_heading = "Run")]
    pub(super) within: Within,
    /// Threads of each rank [env: HELIOSTAT_THREADS, each rank's own] [default: the processors, divided among the ranks that share them]
    #[arg(long, value_name = "N", help_heading = "Run")]
    pub(super) threads: Option<NonZeroUsize>,
    /// Edge of a tile in pixels; never changes a byte of the image [default: 32, or 64 where a million pixels or more get one sample each]
    #[arg(long, value_name = "N", env = "HELIOSTAT_TILE_SIZE", value_parser = clap::value_parser!(u32).range(1..=4096), help_heading = "Run")]
    pub(super) tile_size: Option<u32>,
    /// Show progress on standard error
    #[arg(long, env = "HELIOSTAT_PROGRESS", default_value = "auto", help_heading = "Reports")]
    pub(super) progress: ProgressKind,
    /// Write statistics of every rank
    #[arg(long, value_name = "FILE.json", env = "HELIOSTAT_STATS", help_heading = "Reports")]
    pub(super) stats: Option<PathBuf>,
    /// Write what each thread did when, as a Chrome trace (opens in Perfetto)
    #[arg(long, value_name = "FILE.json", env = "HELIOSTAT_TIMELINE", help_heading = "Reports")]
    pub(super) timeline: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(short, long, env = "HELIOSTAT_QUIET", help_heading = "Reports")]
    pub(super) quiet: bool,
    /// Print the settings and every rank's part
    #[arg(short, long, env = "HELIOSTAT_VERBOSE", conflicts_with = "quiet", help_heading = "Reports")]
    pub(super) verbose: bool,
}

/// What can be written beside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Aov {
    /// Of each pixel's mean: its standard error squared; with its degrees of freedom as the layer freedom.
    Variance,
    /// What the first surface reflects.
    Albedo,
    /// The shading normal of the first surface.
    Normal,
    /// Where the first surface is, in world space.
    Position,
    /// How far away the first surface is.
    Depth,
    /// The number of the first surface's primitive.
    Id,
}

/// Flags before the scene file, the scene file before the defaults.
pub(super) fn image_settings(args: &Args, scene: &ImageDefaults) -> Result<ImageSettings> {
    let default = ImageSettings::default();
    let (width, height) = size((args.width, args.height), scene, &default)?;
    let whole = Crop { x0: 0, y0: 0, x1: width, y1: height };
    let crop = args.crop.unwrap_or(whole);
    if crop.x1 > width || crop.y1 > height {
        return Err(Error::usage(
            "--crop",
            format!("{},{} lies outside the image of {width} x {height}", crop.x1, crop.y1),
            "give X1 and Y1 up to the image's width and height",
        ));
    }
    // A target or a limit says when it is enough; what the scene takes is for images without.
    let open_ended = args.error_target.is_some() || args.time_limit.is_some();
    let spp = match args.spp {
        Some(spp) => spp,
        None if open_ended => 65536,
        None => scene.spp.unwrap_or(default.spp),
    };
    if spp == 1 && args.aov.contains(&Aov::Variance) {
        return Err(Error::usage("--aov", "one sample per pixel has no variance", "give --spp 2 or more"));
    }
    let error_target = args.error_target.map(|value| ErrorTarget { metric: args.error_metric, value });
    let integrator = args.integrator.or(scene.integrator).unwrap_or(default.integrator);
    Ok(ImageSettings {
        width,
        height,
        crop,
        spp,
        seed: args.seed.or(scene.seed).unwrap_or(default.seed),
        integrator,
        max_depth: args.max_depth.or(scene.max_depth).unwrap_or(integrator.max_depth()),
        min_weight: args.min_weight.or(scene.min_weight).unwrap_or(default.min_weight),
        roulette: args.roulette,
        direct: args.direct,
        error_target,
        variance: args.aov.contains(&Aov::Variance),
        features: args.aov.iter().any(|&kind| kind != Aov::Variance),
        sampler: args.sampler.or(scene.sampler).unwrap_or(default.sampler),
        filter: args.filter.or(scene.filter).unwrap_or(default.filter),
        encoding: args.encoding.or(scene.encoding).unwrap_or(default.encoding),
        show: args.show,
    })
}

/// Of an image: a single flag, width or height, keeps the aspect ratio.
pub(in crate::cli) fn size(
    flags: (Option<u32>, Option<u32>),
    scene: &ImageDefaults,
    default: &ImageSettings,
) -> Result<(u32, u32)> {
    let (w, h) = (scene.width.unwrap_or(default.width), scene.height.unwrap_or(default.height));
    let keep = |given: u32, from: u32, to: u32| {
        (f64::from(given) * f64::from(to) / f64::from(from)).round().clamp(1.0, 65536.0) as u32
    };
    let (width, height) = match flags {
        (Some(width), Some(height)) => (width, height),
        (Some(width), None) => (width, keep(width, w, h)),
        (None, Some(height)) => (keep(height, h, w), height),
        (None, None) => (w, h),
    };
    // Pixels are numbered by 32 bits.
    if u64::from(width) * u64::from(height) >= u64::from(u32::MAX) {
        return Err(Error::usage(
            "--width",
            format!("{width} x {height} is more than 2^32 pixels"),
            "choose a smaller image",
        ));
    }
    Ok((width, height))
}

fn weight(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err("give a finite number of 0 or more".into()),
    }
}

pub(in crate::cli) fn positive(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("give a finite number above 0".into()),
    }
}

pub(in crate::cli) fn seconds(text: &str) -> std::result::Result<f64, String> {
    positive(text)
        .ok()
        .filter(|&seconds| seconds <= 1e9)
        .ok_or_else(|| "give seconds, above 0 and up to 1e9".into())
}

/// A number of bytes, with K, M, G or T for powers of 1024.
pub(in crate::cli) fn bytes(text: &str) -> std::result::Result<u64, String> {
    let text = text.trim();
    let units = ["", "K", "M", "G", "T"];
    let parsed = units.iter().enumerate().rev().find_map(|(power, unit)| {
        let number = text.to_ascii_uppercase().strip_suffix(unit)?.trim().parse::<u64>().ok()?;
        number.checked_mul(1 << (10 * power))
    });
    parsed.filter(|&bytes| bytes > 0).ok_or_else(|| "give a number of bytes, such as 256M or 2G".into())
}

/// Memory for copies of hot blocks, if any.
#[derive(Clone, Copy, Debug)]
pub(in crate::cli) struct Copies(pub(super) Option<u64>);

pub(in crate::cli) fn copies(text: &str) -> std::result::Result<Copies, String> {
    if text.trim() == "none" {
        return Ok(Copies(None));
    }
    bytes(text).map(|bytes| Copies(Some(bytes))).map_err(|how| how + ", or none")
}

pub(in crate::cli) fn density(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (1e-6..=1000.0).contains(&value) => Ok(value),
        _ => Err("give a number of cells for each primitive, from 0.000001 to 1000".into()),
    }
}

fn crop(text: &str) -> std::result::Result<Crop, String> {
    let numbers: Vec<u32> = text
        .split(',')
        .map(|part| part.trim().parse())
        .collect::<std::result::Result<_, _>>()
        .unwrap_or_default();
    match numbers[..] {
        [x0, y0, x1, y1] if x0 < x1 && y0 < y1 => Ok(Crop { x0, y0, x1, y1 }),
        _ => Err("give four whole numbers X0,Y0,X1,Y1 with X0 < X1 and Y0 < Y1".into()),
    }
}
