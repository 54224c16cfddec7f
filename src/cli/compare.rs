//! `heliostat compare`: how far two images lie apart.

use std::path::PathBuf;

use super::print;
use crate::error::{Error, Result};
use crate::output::{compare, read};

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
    /// Fail if any channel of any pixel differs by more than this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_difference: Option<f64>,
    /// Fail if the mean FLIP error is above this
    #[arg(long, value_name = "X", value_parser = limit)]
    max_flip: Option<f64>,
    /// Fail if the peak signal-to-noise ratio is below this many decibels
    #[arg(long, value_name = "DB", value_parser = limit)]
    min_psnr: Option<f64>,
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

pub fn run(args: &Args) -> Result<()> {
    let (reference, test) = (read::read(&args.reference)?, read::read(&args.test)?);
    let found = compare::compare(&reference, &test)?;
    if args.json {
        let json = serde_json::to_string_pretty(&found)
            .map_err(|error| Error::write("standard output", error.into()))?;
        print(&(json + "\n"))?;
    } else {
        print(&format!("{found}\n"))?;
    }
    let above = |name: &str, value: f64, limit: Option<f64>| {
        limit.filter(|&limit| value > limit).map(|limit| format!("{name} {value:.3e} is above {limit:e}"))
    };
    let broken: Vec<String> = [
        above("RMSE", found.rmse, args.max_rmse),
        above("relMSE", found.rel_mse, args.max_relmse),
        above("the largest difference", found.maximum, args.max_difference),
        above("FLIP", found.flip, args.max_flip),
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
