//! Error against time: renders of growing effort beside a reference, a curve for each way of sampling. Measures the whole render phase, as users meet it.
//!
//! Errors are those against the truth: what the reference itself is off by is subtracted from each mean square, as the two are independent of each other.

mod fit;
pub mod reference;
pub mod stage;
#[cfg(test)]
mod tests;

use std::path::PathBuf;

use serde::Serialize;

use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::job::{Crew, Work};
use crate::lab::ladder::textbook::Precision;
use crate::output::compare::{Comparison, compare};
use crate::output::plot::pareto_front;
use crate::scene::Scene;
use crate::settings::{
    AccelKind, Direct, ErrorMetric, ErrorTarget, Filter, ImageSettings, Integrator, RunSettings, SamplerKind,
};
use reference::{Cache, Quality, Reference};
use stage::{Shot, Stage, perform};

/// Samples where only an error ends them.
const UNLIMITED: u32 = 65536;

/// A way to render, whose effort grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Curve {
    pub sampler: SamplerKind,
    pub filter: Filter,
    pub direct: Direct,
    pub accel: AccelKind,
    /// In what arithmetic rays are answered. Those that aren't the renderer's have a hierarchy of their own.
    pub precision: Precision,
    /// Whether errors are asked for, not numbers of samples.
    pub adaptive: bool,
}

/// How much is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Effort {
    /// Samples per pixel.
    Spp(u32),
    /// An RMSE.
    Target(f64),
}

impl Effort {
    /// How many times as long this is expected to take as another one: the square of the error falls with the samples, or faster.
    fn over(self, other: Effort) -> f64 {
        match (self, other) {
            (Effort::Spp(own), Effort::Spp(other)) => f64::from(own) / f64::from(other),
            (Effort::Target(own), Effort::Target(other)) => other / own * (other / own),
            _ => 1.0,
        }
    }
}

/// What is measured of every scene.
#[derive(Clone, Debug)]
pub struct Plan {
    pub curves: Vec<Curve>,
    /// For curves that aren't adaptive, ascending; each 1 ..= 65536.
    pub spp: Vec<u32>,
    /// For curves that are, descending; each > 0.
    pub targets: Vec<f64>,
    /// Renders of each rung whose median time is told, >= 1.
    pub rounds: u32,
    /// Seeds over which errors are averaged, >= 1. With more rounds than seeds these come again.
    pub seeds: u32,
    /// A rung is left out, and what comes after it, if all its renders are foretold to take more seconds.
    pub limit: f64,
    pub reference: Quality,
}

/// A scene to be measured.
#[derive(Debug)]
pub struct Subject {
    pub name: String,
    pub scene: Scene,
    /// A structure for each kind that a curve names.
    pub accels: Vec<Accel>,
    /// What the curves have in common; errors are measured over the whole image.
    pub image: ImageSettings,
    pub cache: Option<Cache>,
}

/// What was found of one scene.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    pub scene: String,
    pub width: u32,
    pub height: u32,
    pub integrator: Integrator,
    /// Of all ranks.
    pub threads: u32,
    pub rounds: u32,
    pub seeds: u32,
    pub references: Vec<ReferenceReport>,
    pub curves: Vec<MeasuredCurve>,
}

/// Of a filter's own truth: filters don't converge to the same image.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceReport {
    pub filter: Filter,
    pub spp: u32,
    /// Its standard error: the RMSE that it is expected to have.
    pub rmse: f64,
    pub rel_mse: f64,
    /// What it took; `None` where it was kept.
    pub seconds: Option<f64>,
    /// Where it is kept.
    pub file: Option<PathBuf>,
}

#[derive(Clone, Debug, Serialize)]
pub struct MeasuredCurve {
    #[serde(flatten)]
    pub curve: Curve,
    /// Of log RMSE against log samples, fitted by least squares to what is neither of a single sample nor near the reference's own error; `None` of fewer than two rungs.
    pub slope: Option<f64>,
    pub rungs: Vec<Rung>,
    /// What would have taken too long.
    pub left_out: Vec<Effort>,
}

/// One effort of one curve.
#[derive(Clone, Debug, Serialize)]
pub struct Rung {
    #[serde(flatten)]
    pub effort: Effort,
    /// Samples that a pixel got in the mean.
    pub mean_spp: f64,
    /// Median wall seconds of the render phase: cost prepass, tracing, gathering, decisions.
    pub seconds: f64,
    /// `seconds` times the threads of all ranks.
    pub core_seconds: f64,
    /// Median of the longest trace of any rank.
    pub trace_seconds: f64,
    /// Of one render, in the mean.
    pub rays: f64,
    /// Against the truth: √ of the mean square error over all seeds less the reference's. Where the reference isn't clearly better, `measured_rmse`.
    pub rmse: f64,
    /// Against the reference.
    pub measured_rmse: f64,
    /// Less the reference's, as `rmse`.
    pub rel_mse: f64,
    /// Against the reference.
    pub flip: f64,
    /// 1 / (`rmse`² `seconds`).
    pub efficiency: f64,
    /// The RMSE that the program itself told, and what it said that the RMSE is below of with 95 % confidence.
    pub told_rmse: Option<f64>,
    pub told_rmse_at_most: Option<f64>,
    /// Whether the reference's error is more than half of what was measured, so that `rmse` says too much.
    pub near_reference: bool,
    /// Whether no other rung of the scene is both faster and better.
    pub on_front: bool,
}

/// Collective: measures rank 0's subject by its plan; rank 0 gets what was found, `tell` hears what goes on meanwhile.
///
/// # Errors
/// A render's, or a reference that can't be kept.
pub fn measure(
    crew: &Crew,
    subject: Option<(Subject, &Plan)>,
    tell: &dyn Fn(&str),
) -> Result<Option<Measured>> {
    let Some((subject, plan)) = subject else { return perform(crew, Vec::new(), |_| nothing()) };
    let Subject { name, scene, accels, image, cache } = subject;
    let kinds: Vec<AccelKind> = accels.iter().map(Accel::kind).collect();
    let work = |accel: Accel| Work {
        scene: scene.clone(),
        run: RunSettings { accel: accel.kind(), ..RunSettings::default() },
        accel,
        image: image.clone(),
        division: None,
    };
    let works = accels.into_iter().map(work).collect();
    let lead = |stage: &mut Stage| -> Result<Measured> {
        let mut references: Vec<(Filter, Reference)> = Vec::new();
        for curve in &plan.curves {
            if references.iter().all(|(filter, _)| *filter != curve.filter) {
                let own = ImageSettings { filter: curve.filter, ..image.clone() };
                let found = Reference::obtain(stage, &own, plan.reference, cache.as_ref(), tell)?;
                references.push((curve.filter, found));
            }
        }
        let trails = climb(stage, plan, &image, &kinds, &references)?;
        let threads = trails.iter().flat_map(|trail| &trail.rungs).map(|rung| rung.threads).max();
        let mut curves: Vec<MeasuredCurve> = trails.into_iter().map(Trail::finish).collect();
        mark_front(&mut curves);
        let report = |(filter, found): (Filter, Reference)| ReferenceReport {
            filter,
            spp: found.spp,
            rmse: found.mse.sqrt(),
            rel_mse: found.rel_mse,
            seconds: found.seconds,
            file: found.file,
        };
        Ok(Measured {
            scene: name,
            width: image.width,
            height: image.height,
            integrator: image.integrator,
            threads: threads.unwrap_or(0),
            rounds: plan.rounds,
            seeds: plan.seeds,
            references: references.into_iter().map(report).collect(),
            curves,
        })
    };
    perform(crew, works, lead)
}

/// Rank 0 alone leads, and has a subject.
fn nothing() -> Result<Measured> {
    Err(Error::usage("bench error", "rank 0 has no scene", "name one"))
}

/// One curve while it is measured.
struct Trail<'a> {
    curve: Curve,
    reference: &'a Reference,
    /// By number of the work.
    work: usize,
    efforts: Vec<Effort>,
    rungs: Vec<Tries>,
    left_out: Vec<Effort>,
}

/// The renders of one rung: times of all, sums over seeds of the rest.
#[derive(Default)]
struct Tries {
    seconds: Vec<f64>,
    trace_seconds: Vec<f64>,
    threads: u32,
    count: f64,
    mean_spp: f64,
    rays: f64,
    mse: f64,
    rel_mse: f64,
    flip: f64,
    told_mse: Option<f64>,
    told_mse_at_most: Option<f64>,
}

/// All rungs of all curves, in rounds, and in each round by turns: so whatever else the machine does meets them alike.
fn climb<'a>(
    stage: &mut Stage,
    plan: &Plan,
    image: &ImageSettings,
    kinds: &[AccelKind],
    references: &'a [(Filter, Reference)],
) -> Result<Vec<Trail<'a>>> {
    let mut trails: Vec<Trail> = Vec::new();
    for &curve in &plan.curves {
        let found = references.iter().find(|(filter, _)| *filter == curve.filter);
        // Where the structure isn't asked any will do.
        let work = kinds.iter().position(|&kind| kind == curve.accel || curve.precision != Precision::Exact);
        let efforts = if curve.adaptive {
            plan.targets.iter().map(|&target| Effort::Target(target)).collect()
        } else {
            plan.spp.iter().map(|&spp| Effort::Spp(spp)).collect()
        };
        let (Some((_, reference)), Some(work)) = (found, work) else { continue };
        trails.push(Trail { curve, reference, work, efforts, rungs: Vec::new(), left_out: Vec::new() });
    }
    let rounds = plan.rounds.max(plan.seeds);
    let most = trails.iter().map(|trail| trail.efforts.len()).max().unwrap_or(0);
    for round in 0..rounds {
        for step in 0..most {
            for trail in &mut trails {
                if round == 0 {
                    trail.go_on(step, plan.limit / f64::from(rounds));
                }
                let Some(&effort) = trail.efforts.get(step) else { continue };
                let settings = trail.settings(effort, image, u64::from(round % plan.seeds));
                let shot = stage.shoot(trail.work, trail.curve.precision, &settings)?;
                let tries = &mut trail.rungs[step];
                tries.time(&shot);
                if round < plan.seeds {
                    tries.add(&shot, &compare(&trail.reference.image, &shot.rendered.image)?, &settings);
                }
            }
        }
    }
    Ok(trails)
}

impl Trail<'_> {
    /// Begins a rung, unless a render of it is foretold to take more seconds than `limit`.
    fn go_on(&mut self, step: usize, limit: f64) {
        if step >= self.efforts.len() {
            return;
        }
        if let Some(before) = self.rungs.last() {
            let foretold = before.seconds[0] * self.efforts[step].over(self.efforts[step - 1]);
            if foretold > limit {
                self.left_out = self.efforts.split_off(step);
                return;
            }
        }
        self.rungs.push(Tries::default());
    }

    fn settings(&self, effort: Effort, image: &ImageSettings, seed: u64) -> ImageSettings {
        let (spp, error_target) = match effort {
            Effort::Spp(spp) => (spp, None),
            Effort::Target(value) => (UNLIMITED, Some(ErrorTarget { metric: ErrorMetric::Rmse, value })),
        };
        let Curve { sampler, filter, direct, .. } = self.curve;
        let seed = image.seed.wrapping_add(seed);
        ImageSettings { spp, error_target, sampler, filter, direct, seed, variance: false, ..image.clone() }
    }

    fn finish(self) -> MeasuredCurve {
        let Trail { curve, reference, efforts, rungs, left_out, .. } = self;
        let rungs: Vec<Rung> =
            efforts.iter().zip(rungs).map(|(&effort, tries)| tries.finish(effort, reference)).collect();
        let points: Vec<(f64, f64)> = rungs
            .iter()
            // One sample goes through the middle of its pixel, whatever the sampler.
            .filter(|rung| rung.mean_spp > 1.0 && !rung.near_reference)
            .map(|rung| (rung.mean_spp, rung.rmse))
            .collect();
        MeasuredCurve { curve, slope: fit::log_slope(&points), rungs, left_out }
    }
}

impl Tries {
    fn time(&mut self, shot: &Shot) {
        self.seconds.push(shot.seconds);
        self.trace_seconds.push(shot.trace_seconds);
        self.threads = shot.threads;
    }

    /// Adds a seed.
    fn add(&mut self, shot: &Shot, found: &Comparison, settings: &ImageSettings) {
        self.count += 1.0;
        self.rays += shot.rays as f64;
        self.mse += found.rmse * found.rmse;
        self.rel_mse += found.rel_mse;
        self.flip += found.flip;
        match &shot.rendered.error {
            Some(told) => {
                self.mean_spp += told.spp;
                *self.told_mse.get_or_insert(0.0) += told.rmse * told.rmse;
                *self.told_mse_at_most.get_or_insert(0.0) += told.rmse_at_most * told.rmse_at_most;
            }
            None => self.mean_spp += f64::from(settings.spp),
        }
    }

    fn finish(self, effort: Effort, reference: &Reference) -> Rung {
        let mean = |sum: f64| sum / self.count;
        let seconds = fit::median(self.seconds);
        let measured = mean(self.mse);
        // Of two numbers that are nearly the same, the difference would be chance.
        let near_reference = measured <= 2.0 * reference.mse;
        let mse = if near_reference { measured } else { measured - reference.mse };
        let rel_mse = mean(self.rel_mse);
        let rel_near = rel_mse <= 2.0 * reference.rel_mse;
        Rung {
            effort,
            mean_spp: mean(self.mean_spp),
            seconds,
            core_seconds: seconds * f64::from(self.threads),
            trace_seconds: fit::median(self.trace_seconds),
            rays: mean(self.rays),
            rmse: mse.sqrt(),
            measured_rmse: measured.sqrt(),
            rel_mse: if rel_near { rel_mse } else { rel_mse - reference.rel_mse },
            flip: mean(self.flip),
            efficiency: 1.0 / (mse * seconds),
            told_rmse: self.told_mse.map(|sum| mean(sum).sqrt()),
            told_rmse_at_most: self.told_mse_at_most.map(|sum| mean(sum).sqrt()),
            near_reference,
            on_front: false,
        }
    }
}

fn mark_front(curves: &mut [MeasuredCurve]) {
    let mut rungs: Vec<&mut Rung> = curves.iter_mut().flat_map(|curve| &mut curve.rungs).collect();
    let points: Vec<(f64, f64)> = rungs.iter().map(|rung| (rung.seconds, rung.rmse)).collect();
    for (rung, on_front) in rungs.iter_mut().zip(pareto_front(&points)) {
        rung.on_front = on_front;
    }
}
