//! What `heliostat bench error` found, as a table, CSV, JSON and plots. Knows nothing of how it was measured.

use std::fmt::{Debug, Write as _};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::error::Result;
use crate::lab::error_curve::{Curve, Effort, Measured, MeasuredCurve, Rung};
use crate::output::file;
use crate::output::plot::{Plot, Scale, Series};

/// Where it is written to.
#[derive(Debug, clap::Args)]
pub struct Files {
    /// Write all rungs, a line each
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write all that was found
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Draw error against time; of several scenes each gets a file of its own, FILE-SCENE.svg. Under mpirun time is in core-seconds
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
}

impl Files {
    /// Fails now if [`write`] would fail later for scenes of these names.
    pub fn check<'a>(&self, scenes: impl ExactSizeIterator<Item = &'a str>) -> Result<()> {
        for path in [&self.csv, &self.json].into_iter().flatten() {
            file::check_writable(path)?;
        }
        let Some(path) = &self.svg else { return Ok(()) };
        let several = scenes.len() > 1;
        scenes.into_iter().try_for_each(|name| file::check_writable(&plot_path(path, name, several)))
    }
}

/// Everything that `--json` writes.
#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    ranks: usize,
    scenes: &'a [Measured],
}

/// Writes the files that were asked for.
pub fn write(files: &Files, ranks: usize, all: &[Measured]) -> Result<()> {
    if let Some(path) = &files.csv {
        let text = csv(ranks, all);
        file::write_whole(path, |out| out.write_all(text.as_bytes()))?;
    }
    if let Some(path) = &files.json {
        let report = Report { version: env!("CARGO_PKG_VERSION"), ranks, scenes: all };
        file::write_whole(path, |out| {
            serde_json::to_writer_pretty(&mut *out, &report)?;
            out.write_all(b"\n")
        })?;
    }
    let Some(path) = &files.svg else { return Ok(()) };
    for measured in all {
        let svg = plot(ranks, measured).svg();
        let path = plot_path(path, &measured.scene, all.len() > 1);
        file::write_whole(&path, |out| out.write_all(svg.as_bytes()))?;
    }
    Ok(())
}

fn plot_path(path: &Path, scene: &str, several: bool) -> PathBuf {
    if !several {
        return path.into();
    }
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    path.with_file_name(format!("{stem}-{scene}.svg"))
}

/// The table of one scene.
pub fn table(measured: &Measured) -> String {
    let Measured { scene, width, height, threads, rounds, seeds, .. } = measured;
    let mut text = format!(
        "{scene}: {width} × {height}, {}, {threads} threads; medians of {rounds} rounds, errors over {seeds} seeds\n",
        name(&measured.integrator)
    );
    for reference in &measured.references {
        let made = match (reference.seconds, &reference.file) {
            (Some(seconds), Some(file)) => format!("made in {seconds:.1} s, kept as {}", file.display()),
            (Some(seconds), None) => format!("made in {seconds:.1} s"),
            (None, file) => {
                format!("kept as {}", file.as_ref().map_or("".into(), |file| file.display().to_string()))
            }
        };
        let _ = writeln!(
            text,
            "reference, filter {}: {} samples per pixel, standard error {:.2e} (RMSE), {:.2e} (relMSE), {made}",
            name(&reference.filter),
            reference.spp,
            reference.rmse,
            reference.rel_mse
        );
    }
    let labels: Vec<String> = measured.curves.iter().map(|curve| label(&curve.curve, measured)).collect();
    let column = labels.iter().map(String::len).max().unwrap_or(0);
    let _ = writeln!(
        text,
        "{:<column$} {:>8} {:>8} {:>9} {:>9} {:>9} {:>8}  {:>8} {:>9} {:>8} {:>10} {:>8}",
        "",
        "asked",
        "spp",
        "seconds",
        "core-s",
        "trace s",
        "Mrays",
        "RMSE",
        "relMSE",
        "FLIP",
        "1/(MSE s)",
        "told"
    );
    for (curve, label) in measured.curves.iter().zip(&labels) {
        curve.rungs.iter().for_each(|rung| line(&mut text, &format!("{label:<column$}"), rung));
        let slope = curve.slope.map_or("none".into(), |slope| format!("{slope:.3}"));
        let _ = write!(text, "{label:<column$} slope {slope}");
        if !curve.left_out.is_empty() {
            let efforts: Vec<String> = curve.left_out.iter().map(asked).collect();
            let _ = write!(text, "; left out, too slow: {}", efforts.join(", "));
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "* on the Pareto front of seconds and RMSE. RMSE and relMSE are less the reference's own error, FLIP is not; ≤ where that is more than half of what was measured.\n\
         slope: of log RMSE over log spp, without single samples and what is marked ≤.\n"
    );
    text
}

fn line(text: &mut String, label: &str, rung: &Rung) {
    let told = rung.told_rmse.map_or("-".into(), |told| format!("{told:.2e}"));
    let _ = writeln!(
        text,
        "{label} {:>8} {:>8.1} {:>9.4} {:>9.4} {:>9.4} {:>8.2} {}{}{:.2e} {:>9.2e} {:>8.5} {:>10.3e} {told:>8}",
        asked(&rung.effort),
        rung.mean_spp,
        rung.seconds,
        rung.core_seconds,
        rung.trace_seconds,
        rung.rays / 1e6,
        if rung.on_front { '*' } else { ' ' },
        if rung.near_reference { '≤' } else { ' ' },
        rung.rmse,
        rung.rel_mse,
        rung.flip,
        rung.efficiency,
    );
}

fn asked(effort: &Effort) -> String {
    match effort {
        Effort::Spp(spp) => spp.to_string(),
        Effort::Target(target) => format!("{target}"),
    }
}

/// What tells a curve from the others of its scene.
fn label(curve: &Curve, measured: &Measured) -> String {
    let differs = |of: fn(&Curve) -> String| measured.curves.iter().any(|c| of(&c.curve) != of(curve));
    let parts: [fn(&Curve) -> String; 5] = [
        |c| name(&c.sampler),
        |c| name(&c.filter),
        |c| name(&c.direct),
        |c| name(&c.accel),
        |c| name(&c.precision),
    ];
    // The sampler is always told.
    let mut words: Vec<String> = Vec::new();
    for (number, part) in parts.into_iter().enumerate() {
        if number == 0 || differs(part) {
            words.push(part(curve));
        }
    }
    if curve.adaptive {
        words.push("adaptive".into());
    }
    words.join(" ")
}

fn name(value: &impl Debug) -> String {
    format!("{value:?}").to_lowercase()
}

fn csv(ranks: usize, all: &[Measured]) -> String {
    let mut text = String::from(
        "scene,width,height,integrator,ranks,threads,sampler,filter,direct,accel,precision,adaptive,asked,mean_spp,seconds,core_seconds,trace_seconds,rays,\
         rmse,measured_rmse,rel_mse,flip,efficiency,told_rmse,told_rmse_at_most,near_reference,on_front,slope,reference_spp,reference_rmse\n",
    );
    for measured in all {
        let Measured { scene, width, height, threads, .. } = measured;
        // The one cell that may hold anything.
        let scene = if scene.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", scene.replace('"', "\"\""))
        } else {
            scene.clone()
        };
        for MeasuredCurve { curve, slope, rungs, .. } in &measured.curves {
            let reference = measured.references.iter().find(|reference| reference.filter == curve.filter);
            let maybe = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:e}"));
            for rung in rungs {
                let _ = writeln!(
                    text,
                    "{scene},{width},{height},{},{ranks},{threads},{},{},{},{},{},{},{},{},{},{},{},{},{:e},{:e},{:e},{:e},{:e},{},{},{},{},{},{},{}",
                    name(&measured.integrator),
                    name(&curve.sampler),
                    name(&curve.filter),
                    name(&curve.direct),
                    name(&curve.accel),
                    name(&curve.precision),
                    curve.adaptive,
                    asked(&rung.effort),
                    rung.mean_spp,
                    rung.seconds,
                    rung.core_seconds,
                    rung.trace_seconds,
                    rung.rays,
                    rung.rmse,
                    rung.measured_rmse,
                    rung.rel_mse,
                    rung.flip,
                    rung.efficiency,
                    maybe(rung.told_rmse),
                    maybe(rung.told_rmse_at_most),
                    rung.near_reference,
                    rung.on_front,
                    maybe(*slope),
                    reference.map_or(String::new(), |reference| reference.spp.to_string()),
                    maybe(reference.map(|reference| reference.rmse)),
                );
            }
        }
    }
    text
}

fn plot(ranks: usize, measured: &Measured) -> Plot {
    let Measured { scene, width, height, threads, .. } = measured;
    let curves = measured.curves.iter().enumerate().map(|(number, curve)| {
        let time = |rung: &Rung| if ranks > 1 { rung.core_seconds } else { rung.seconds };
        let points = curve.rungs.iter().map(|rung| (time(rung), rung.rmse)).collect();
        let slope = curve.slope.map_or(String::new(), |slope| format!(" ({slope:.2})"));
        Series::new(number, label(&curve.curve, measured) + &slope, points)
    });
    let title = format!(
        "{scene}, {width} × {height}, {} (slopes of log RMSE over log samples)",
        name(&measured.integrator)
    );
    // All with the same threads: in wall seconds the curves are the same but for the numbers below.
    let x = if ranks > 1 {
        format!("core-seconds of rendering: seconds times {threads} threads of {ranks} ranks")
    } else {
        format!("seconds of rendering, {threads} threads")
    };
    let mut plot = Plot::new(&title, (&x, Scale::Log), ("RMSE", Scale::Log), curves.collect());
    plot.mark_front();
    plot
}
