//! `heliostat compare`: how far two images lie apart.

use std::path::{Path, PathBuf};

use super::{note, print};
use crate::error::{Error, Result};
use crate::output::compare::Comparison;
use crate::output::statistics::Known;
use crate::output::write::{Format, Target, WriteOptions, write};
use crate::output::{compare, flip, heat_map, read, statistics};
use crate::settings::Encoding;

#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image that is right (.png, .exr or .pfm)
    reference: PathBuf,
    /// The image that is judged
    test: PathBuf,
    /// Fail if the root mean square error is above this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_rmse: Option<f64>,
    /// Fail if the relative mean square error is above this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_relmse: Option<f64>,
    /// Fail if the symmetric mean absolute percentage error (0 to 1) is above this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_smape: Option<f64>,
    /// Fail if any channel of any pixel differs by more than this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_difference: Option<f64>,
    /// Fail if the mean FLIP error is above this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_flip: Option<f64>,
    /// Fail if the mean HDR-FLIP error is above this (of EXR and PFM)
    #[arg(long, value_name = "X", value_parser = limit)]
    max_hdr_flip: Option<f64>,
    /// Fail if the peak signal-to-noise ratio is below this many decibels
    #[arg(long, value_name = "DB", value_parser = limit)]
    min_psnr: Option<f64>,
    /// Fail if the means of two images of one truth would differ as much with a probability below this (of EXR with
    /// a layer `variance`; an image without one is taken as exact)
    #[arg(long, value_name = "P", value_parser = probability)]
    min_p: Option<f64>,
    /// Draw where the images differ: from black (1e-4 or less) to light yellow (1 or more), a logarithmic scale
    #[arg(long, value_name = "FILE.png")]
    heat_map: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn limit(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 => Ok(value),
        _ => Err("give a number of 0 or more".into()),
    }
}

fn probability(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("give a number from 0 to 1".into()),
    }
}

pub fn run(args: &Args) -> Result<()> {
    let map_target = args.heat_map.as_deref().map(png).transpose()?;
    let (reference, test) = (read::read_layers(&args.reference)?, read::read_layers(&args.test)?);
    let found = measure(args, &reference, &test)?;
    if let Some(target) = &map_target {
        let map = heat_map::heat_map(&reference.image, &test.image);
        let metadata = vec![("heat map".to_owned(), heat_map::SCALE.to_owned())];
        write(&map, target, &WriteOptions { encoding: Encoding::Srgb, metadata })?;
    }
    if args.json {
        let json = serde_json::to_string_pretty(&found)
            .map_err(|error| Error::write("standard output", error.into()))?;
        print(&(json + "\n"))?;
    } else {
        print(&format!("{found}\n"))?;
    }
    if let Some(target) = &map_target {
        note(format_args!("wrote {target}: {}", heat_map::SCALE));
    }
    let above = |name: &str, value: f64, limit: Option<f64>| {
        limit.filter(|&limit| value > limit).map(|limit| format!("{name} {value:.3e} is above {limit:e}"))
    };
    let broken: Vec<String> = [
        above("RMSE", found.rmse, args.max_rmse),
        above("relMSE", found.rel_mse, args.max_relmse),
        above("SMAPE", found.smape, args.max_smape),
        above("the largest difference", found.maximum, args.max_difference),
        above("FLIP", found.flip, args.max_flip),
        above("HDR-FLIP", found.hdr_flip.unwrap_or(0.0), args.max_hdr_flip),
        args.min_p
            .zip(found.z_test)
            .filter(|&(limit, test)| test.global_p < limit)
            .map(|(limit, test)| format!("the means' p {:.3e} is below {limit:e}", test.global_p)),
        args.min_psnr
            .filter(|&limit| found.psnr < limit)
            .map(|limit| format!("PSNR {:.2} dB is below {limit}", found.psnr)),
    ]
    .into_iter()
    .flatten()
    .collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Error::Differs(format!("{} differs too much: {}", args.test.display(), broken.join(", "))))
    }
}

/// All numbers that these images have.
fn measure(args: &Args, reference: &read::ImageFile, test: &read::ImageFile) -> Result<Comparison> {
    let mut found = compare::compare(&reference.image, &test.image)?;
    if reference.is_hdr && test.is_hdr {
        found.hdr_flip = flip::hdr(&reference.image, &test.image);
    }
    if args.max_hdr_flip.is_some() && found.hdr_flip.is_none() {
        let what = "there is no HDR-FLIP of these images";
        let mend = "give two EXR or PFM images of finite values, and a reference that isn't black";
        return Err(Error::usage("--max-hdr-flip", what, mend));
    }
    let known = (known(reference), known(test));
    if known.0.is_some() || known.1.is_some() {
        let pixels = (&reference.image.pixels, &test.image.pixels);
        found.z_test = Some(statistics::z_test(pixels.0, pixels.1, known.0, known.1)?);
    } else if args.min_p.is_some() {
        let what = "neither image has a layer `variance` of three channels";
        return Err(Error::usage("--min-p", what, "give at least one EXR image that has it"));
    }
    Ok(found)
}

fn known(file: &read::ImageFile) -> Option<Known<'_>> {
    file.variance().map(|variance| Known { variance, freedom: file.freedom() })
}

/// The target of `--heat-map`, which can be written.
fn png(path: &Path) -> Result<Target> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        let what = format!("{} is no name of a PNG", path.display());
        return Err(Error::usage("--heat-map", what, "use a name that ends in .png"));
    }
    let target = Target::File { path: path.into(), format: Format::Png };
    target.check_writable()?;
    Ok(target)
}
