//! The story of a render: share the scene, deal the tiles, gather the film. Every rank runs the same lines.

mod pack;
mod partition;
mod share;

use std::time::{Duration, Instant};

use rayon::ThreadPool;

use crate::accel::{Accel, Trace};
use crate::cluster::deal::{self, DealStats, Plan};
use crate::cluster::share::{Share, computed};
use crate::cluster::{Comm, Solo};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::output::progress::{Progress, ProgressKind};
use crate::output::stats::{self, RankStats};
use crate::output::timeline::{Event, Timeline};
use crate::render::allotment;
use crate::render::estimate::{Estimate, Spread};
use crate::render::features::Features;
use crate::render::film::Film;
use crate::render::filter::FilterTable;
use crate::render::metric::ErrorReached;
use crate::render::rounds::{self, Activity, Round};
use crate::render::tile::Tiling;
use crate::render::{RayTally, Renderer, cost};
use crate::scene::Scene;
use crate::settings::{ImageSettings, Integrator, RunSettings, SamplerKind, Split, Within};
use crate::wire;

pub use partition::Division;
pub use share::Work;

/// What a rank needs beside the work itself.
pub struct Crew<'a> {
    pub comm: &'a dyn Comm,
    pub pool: &'a ThreadPool,
    /// What rank 0 computes with while the others wait for it; see [`wide_pool`].
    pub wide: &'a ThreadPool,
    pub timeline: &'a Timeline,
    /// Shown by rank 0 only.
    pub progress: &'a dyn Progress,
}

/// Collective: gives every rank what the split wants it to have of rank 0's work: all, or its part of the scene and a structure over that.
pub fn distribute(crew: &Crew, work: &mut Work) -> Result<()> {
    let _span = crew.timeline.span(0, "distribute");
    if crew.comm.rank() == 0 && work.image.integrator == Integrator::Path {
        work.scene.find_emitters();
    }
    let split = computed(crew.comm, || Ok(work.run.split))?;
    if split.is_partitioned() { partition::scatter(crew, work) } else { work.share(Share::new(crew.comm)) }
}

/// What rank 0 has in the end.
#[derive(Clone, Debug)]
pub struct Rendered {
    pub image: Image,
    /// How well each pixel's mean is known, where that is known.
    pub spread: Option<Spread>,
    /// Where it was asked for.
    pub features: Option<Features>,
    pub error: Option<ErrorReached>,
    /// Whether all was done that was asked for: no clock ended it.
    pub complete: bool,
}

/// Collective: renders the work that was [`distribute`]d to all ranks, round by round; rank 0 gets the image. Adds what this rank did to `stats`.
pub fn render(crew: &Crew, work: &mut Work, stats: &mut RankStats) -> Result<Option<Rendered>> {
    render_by(crew, work, None, stats)
}

/// As [`render`]; where `tracer` is given it answers this rank's rays instead of the work's structure, in splits that leave the scene whole.
pub fn render_by(
    crew: &Crew,
    work: &mut Work,
    tracer: Option<&dyn Trace>,
    stats: &mut RankStats,
) -> Result<Option<Rendered>> {
    let begin = Instant::now();
    let ImageSettings { crop, variance, error_target, features, .. } = work.image;
    let limit = work.run.time_limit.map(Duration::from_secs_f64);
    let schedule = rounds::schedule(&work.image, limit.is_some());
    let filter = FilterTable::new(work.image.filter);
    let variances = variance || error_target.is_some() || limit.is_some();
    let mut estimate = (crew.comm.rank() == 0).then(|| {
        let mut estimate = Estimate::new(rounds::area(&work.image), filter.planes(), filter.negative_mass());
        if variances {
            estimate = estimate.with_variances();
        }
        if error_target.is_some() && work.image.sampler != SamplerKind::Independent {
            estimate = estimate.with_rate();
        }
        if features { estimate.with_features() } else { estimate }
    });
    let mut activity = Activity::all(&work.image);
    let mut worth = None;
    let mut complete = true;
    let divided = (work.run.within == Within::Triangles).then(|| divide(crew, work, stats));
    let mut costs = Vec::new();
    for (number, round) in schedule.iter().enumerate() {
        let film = match work.run.split {
            Split::Tiles | Split::Stream => {
                let own = divided.as_ref().unwrap_or(&work.accel);
                let accel = tracer.unwrap_or(own);
                deal_tiles(crew, work, accel, (round, &activity), &mut costs, stats)?
            }
            Split::Triangles | Split::Voxels => partition::render(crew, work, (round, &activity), stats)?,
        };
        if let (Some(estimate), Some(film)) = (&mut estimate, film) {
            crew.wide.install(|| estimate.absorb(film, round));
        }
        let Some(next) = schedule.get(number + 1) else { break };
        // Rank 0 alone has the whole film, and the clock that counts.
        let decision = computed(crew.comm, || {
            let Some(estimate) = &mut estimate else { return Ok((Activity::default(), false)) };
            let wanting =
                error_target.filter(|_| next.first >= rounds::first_look(&work.image)).map(|target| {
                    // The first look is at the whole image; then what is asked for goes on.
                    let (worth, before) = match worth {
                        Some(worth) => (worth, activity.clone()),
                        None => {
                            let found = crew.wide.install(|| {
                                estimate.find_rate(target.metric);
                                allotment::worth(estimate, target)
                            });
                            (*worth.insert(found), Activity::asked(&work.image))
                        }
                    };
                    let wanting = || allotment::wanting(estimate, &work.image, target.metric, worth, &before);
                    crew.wide.install(wanting)
                });
            // The next round takes about as long as all before, in proportion to its samples.
            let expected = begin.elapsed().mul_f64(1.0 + f64::from(next.count) / f64::from(next.first));
            Ok((wanting.unwrap_or_else(|| activity.clone()), limit.is_some_and(|limit| expected > limit)))
        })?;
        let late;
        (activity, late) = decision;
        if activity.is_over() {
            break;
        }
        if late {
            complete = false;
            break;
        }
    }
    let floor = work.scene.header.ambient_floor;
    Ok(estimate.map(|estimate| {
        let _span = crew.timeline.span(0, "resolve");
        let (image, spread) = crew.wide.install(|| estimate.resolve(crop, floor));
        let features = estimate.features(crop, &work.scene.header.frame);
        Rendered { image, spread, features, error: estimate.error(crop), complete }
    }))
}

/// Structures over parts of the primitives, one for each of this rank's threads.
fn divide(crew: &Crew, work: &Work, stats: &mut RankStats) -> Accel {
    let _span = crew.timeline.span(0, "build");
    let begin = Instant::now();
    let (run, surfaces) = (&work.run, &work.scene.surfaces);
    let parts = crew.pool.current_num_threads();
    let accel = crew.pool.install(|| Accel::divide(run.accel, run.build, surfaces, parts));
    stats.seconds.build += begin.elapsed().as_secs_f64();
    accel
}

/// Does `work` in a pool while this thread of another one waits. By itself rayon would let it take up other work meanwhile, the next tile.
fn waiting_for<T: Send>(pool: &ThreadPool, work: impl FnOnce() -> T + Send) -> T {
    let done = std::thread::scope(|scope| scope.spawn(|| pool.install(work)).join());
    done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Splits `tiles` and `stream`: the ranks render a round of screen tiles, and rank 0 gathers their films. It deals them on demand, the costliest first, or all at once.
/// `accel` is the work's, or, within ranks over triangles, the rank's own. `costs` are kept from the first round on.
fn deal_tiles(
    crew: &Crew,
    work: &Work,
    accel: &dyn Trace,
    (round, activity): (&Round, &Activity),
    costs: &mut Vec<f32>,
    stats: &mut RankStats,
) -> Result<Option<Film>> {
    let renderer = &Renderer::new(&work.scene, accel, &work.image);
    let area = rounds::area(&work.image);
    let tiling = &Tiling::new(area, work.run.tile_size);
    let leads = crew.comm.rank() == 0;
    let begin = Instant::now();
    let mut film = leads.then(|| Film::new(area, renderer.planes(round)));
    let active = |tile: u32| tiling.tile(tile).pixels(work.image.width).any(|pixel| activity.holds(pixel));

    // A coarse look at the image tells which tiles are hot.
    let on_demand = work.run.split == Split::Tiles;
    let plan = (leads && on_demand).then(|| {
        if costs.is_empty() {
            let _span = crew.timeline.span(0, "prepass");
            let rays;
            (*costs, rays) = crew.wide.install(|| cost::estimate(renderer, area, tiling));
            stats.rays.prepass = rays.iter().sum();
        }
        Plan::new((0..).zip(costs.iter().copied()).filter(|&(tile, _)| active(tile)))
    });

    // Where the threads share each batch of rays, tiles come one at a time.
    let one = match work.run.within {
        Within::Rays => None,
        Within::Triangles => Some(thread_pool(1)?),
    };

    // All ranks render; tiles come home as they are done.
    let tally = RayTally::default();
    let render = |index: u32, bytes: &mut Vec<u8>| {
        let _span = crew.timeline.span(1 + rayon::current_thread_index().unwrap_or(0) as u32, "tile");
        let tile = tiling.tile(index);
        let (tile_film, rays) = match one {
            None => renderer.tile(tile, round, activity),
            Some(_) => waiting_for(crew.pool, || renderer.tile(tile, round, activity)),
        };
        bytes.extend_from_slice(tile_film.as_bytes());
        tally.add(&rays);
    };
    let mut deposit = |index: u32, bytes: &[u8]| match &mut film {
        Some(film) => film.merge(tiling.tile(index), bytes),
        None => Ok(()),
    };
    let mut shown = 0;
    if leads {
        crew.progress.begin((0..tiling.len()).filter(|&tile| active(tile)).count() as u64);
    }
    let mut tick = |now: deal::Progress| {
        crew.progress.advance((now.done - shown) as u64);
        shown = now.done;
    };
    let pool = one.as_ref().unwrap_or(crew.pool);
    let dealt = if on_demand {
        deal::run(crew.comm, pool, plan.as_ref(), &render, &mut deposit, &mut tick)?
    } else {
        let mut own = partition::dealt_tiles(tiling, work.run.deal, crew.comm.rank(), crew.comm.size());
        own.retain(|&tile| active(tile));
        deal::run_fixed(crew.comm, pool, &own, &render, &mut deposit, &mut tick)?
    };
    if leads {
        crew.progress.end();
    }
    account(stats, &dealt, &tally, begin);
    Ok(film)
}

fn account(stats: &mut RankStats, dealt: &DealStats, tally: &RayTally, begin: Instant) {
    let [camera, reflection, refraction, shadow] = tally.counts();
    stats.rays += stats::RayCounts { camera, reflection, refraction, shadow, prepass: 0 };
    stats.tiles += dealt.units as u64;
    let traced = dealt.elapsed.as_secs_f64();
    stats.seconds.trace += traced;
    stats.seconds.gather += begin.elapsed().as_secs_f64() - traced;
}

/// Collective: rank 0 gets the statistics of all ranks, in rank order.
pub fn gather_stats(comm: &dyn Comm, own: &RankStats) -> Result<Option<Vec<RankStats>>> {
    decode_all(comm.gather(&wire::encode(own)?))
}

/// Collective: rank 0 gets the timeline events of all ranks.
pub fn gather_events(comm: &dyn Comm, timeline: &Timeline) -> Result<Option<Vec<Event>>> {
    let all: Option<Vec<Vec<Event>>> = decode_all(comm.gather(&wire::encode(&timeline.take())?))?;
    Ok(all.map(|ranks| ranks.concat()))
}

fn decode_all<T: serde::de::DeserializeOwned>(gathered: Option<Vec<Vec<u8>>>) -> Result<Option<Vec<T>>> {
    gathered.map(|ranks| ranks.iter().map(|bytes| wire::decode(bytes)).collect()).transpose()
}

/// A pool of `threads` workers.
///
/// # Errors
/// The system gives no more threads.
pub fn thread_pool(threads: usize) -> Result<ThreadPool> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|source| {
        Error::launch(format!("can't start {threads} threads: {source}"), "give a smaller --threads")
    })
}

/// On rank 0 of several: a pool over the threads of all ranks of its node, for what is done while those wait. `None` where
/// the rank's own pool is as good.
///
/// # Errors
/// The system gives no more threads.
pub fn wide_pool(comm: &dyn Comm, own: &ThreadPool) -> Result<Option<ThreadPool>> {
    let (_, neighbours) = comm.node_local();
    let threads = own.current_num_threads();
    let processors = std::thread::available_parallelism().map_or(threads, |n| n.get());
    let wide = (threads * neighbours).min(processors);
    if comm.rank() == 0 && wide > threads { thread_pool(wide).map(Some) } else { Ok(None) }
}

/// Renders a scene in this process alone, on all its processors: the simplest way to embed heliostat.
///
/// # Errors
/// The system gives no threads.
pub fn render_alone(scene: Scene, image: ImageSettings, run: RunSettings) -> Result<Image> {
    let pool = thread_pool(std::thread::available_parallelism().map_or(1, |n| n.get()))?;
    let accel = match run.within {
        Within::Rays => pool.install(|| Accel::build(run.accel, run.build, &scene.surfaces)),
        Within::Triangles => Accel::empty(run.accel),
    };
    let mut work = Work { scene, accel, image, run, division: None };
    let progress = ProgressKind::None.start();
    let timeline = &Timeline::off();
    let crew = Crew { comm: &Solo::new(), pool: &pool, wide: &pool, timeline, progress: &*progress };
    distribute(&crew, &mut work)?;
    let rendered = render(&crew, &mut work, &mut RankStats::default())?;
    Ok(rendered.expect("a single process is rank 0").image)
}
