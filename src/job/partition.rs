//! Splits where each rank has only a part of the scene: cutting it, giving every rank its part, and the render by rays that travel.

use std::ops::Range;
use std::sync::atomic::Ordering;
use std::time::Instant;

use super::{Crew, Work};
use crate::accel::Accel;
use crate::accel::morton::morton;
use crate::accel::partition::{along_curve, run_of};
use crate::accel::route::Route;
use crate::cluster::exchange::{self, Limits, Outbox, Station};
use crate::cluster::parcel;
use crate::cluster::share::{self, Share};
use crate::error::{Error, Result};
use crate::output::stats::{self, RankStats};
use crate::render::division;
use crate::render::film::Film;
use crate::render::relay::{Exit, Holding, Relay, Traveller};
use crate::render::rounds::{self, Activity, Round};
use crate::render::tile::{Tile, Tiling};
use crate::scene::load::Budget;
use crate::scene::{Scene, SceneHeader};
use crate::settings::{Deal, Integrator, Split};
use crate::wire;

/// Edge of the tiles, in pixels, whose camera rays are made at once.
const TILE: u32 = 32;

/// What a rank knows of the division beside its own part of the scene.
#[derive(Clone, Debug)]
pub struct Division {
    /// Of each primitive here its id in the whole, ascending.
    pub ids: Vec<u32>,
    pub route: Route,
    /// How many of them every rank has, and this one for no other reason.
    copies: u64,
    /// How many rays may be where.
    limits: Limits,
}

/// Collective: rank 0 cuts its scene and every rank gets its part of it, with a structure over that.
pub(super) fn scatter(crew: &Crew, work: &mut Work) -> Result<()> {
    let (comm, share) = (crew.comm, Share::new(crew.comm));
    let ranks = comm.size();
    share.value(&mut work.image)?;
    share.value(&mut work.run)?;
    let limits = Limits::new::<Traveller>(work.run.ray_memory, ranks, crew.pool.current_num_threads());
    let limits = share::agreed(comm, limits.ok_or_else(|| too_little_ray_memory(crew)))?;

    // Rank 0 has all, if only as a file that it has mapped: it tells whose is what.
    let mut whole = std::mem::take(&mut work.scene);
    let in_file = super::share::share_file(&mut whole, share)?;
    let mut route = Vec::new();
    if comm.rank() == 0 {
        route = wire::encode(&crew.wide.install(|| survey(&whole, work, ranks)))?;
    }
    comm.broadcast(&mut route);
    let route: Route = wire::decode(&route)?;

    // From a file each rank copies its own part. Else rank 0 sends it.
    let cuts = in_file || comm.rank() == 0;
    let pool = if in_file { crew.pool } else { crew.wide };
    let along =
        if cuts && route == Route::All { pool.install(|| along_curve(&whole.surfaces)) } else { Vec::new() };
    let part = |rank: usize| match &route {
        Route::Voxels(voxels) => voxels.part(&whole.surfaces, rank),
        Route::All => run_of(&along, ranks, rank),
    };
    let (mut scene, ids) = if cuts {
        if !in_file {
            for rank in 1..ranks {
                let packed = pool.install(|| {
                    let ids = part(rank);
                    super::pack::pack(&whole.subset(&ids), &ids)
                });
                parcel::send(comm, rank, &packed?);
            }
        }
        let rank = comm.rank();
        pool.install(|| {
            let ids = part(rank);
            (whole.subset(&ids), ids)
        })
    } else {
        super::pack::unpack(&parcel::receive(comm, 0))?
    };
    // Rank 0 may have fitted the camera to the image, and has looked for emitters.
    share.value(&mut whole.header)?;
    let parts = std::mem::take(&mut scene.header.parts);
    scene.header = SceneHeader { parts, ..std::mem::take(&mut whole.header) };
    drop(whole);
    if work.image.integrator == Integrator::Path {
        scene.prepare_lighting(Some(&ids));
    }
    share::agreed(comm, afford(&scene, work))?;
    let rank = comm.rank();
    let copies = match &route {
        Route::Voxels(voxels) => crew.pool.install(|| voxels.copies(&scene.surfaces, rank)),
        Route::All => 0,
    };
    work.accel = crew.pool.install(|| Accel::build(work.run.accel, work.run.build, &scene.surfaces));
    // Rays must not come to a rank that still waits for its part, and are traced once all can be.
    comm.barrier();
    work.scene = scene;
    work.division = Some(Division { ids, route, copies, limits });
    Ok(())
}

/// Whether this rank has the memory for a structure over its part.
fn afford(part: &Scene, work: &Work) -> Result<()> {
    let needed = Accel::memory_to_build(work.run.accel, work.run.build.preset, &part.surfaces);
    match Budget::of_machine().lacks(needed) {
        None => Ok(()),
        Some(shortage) => Err(Error::launch(
            format!("the accelerator over this rank's {} primitives needs {shortage}", part.surfaces.len()),
            match work.run.replicate_hot {
                None => "start more ranks, on more nodes",
                Some(_) => "start more ranks, on more nodes, or give less to --replicate-hot",
            },
        )),
    }
}

fn too_little_ray_memory(crew: &Crew) -> Error {
    let least = Limits::least::<Traveller>(crew.comm.size(), crew.pool.current_num_threads());
    Error::usage(
        "--ray-memory",
        format!("too little for the rays between {} ranks", crew.comm.size()),
        format!("give at least {least} bytes"),
    )
}

/// How rays will find their way.
fn survey(whole: &Scene, work: &Work, ranks: usize) -> Route {
    if work.run.split == Split::Triangles {
        return Route::All;
    }
    let run = &work.run;
    let copies = run.replicate_hot.map_or(0, |bytes| division::copies(whole, run.accel, bytes));
    Route::Voxels(division::divide(whole, &work.image, ranks, copies))
}

/// Collective: renders a round by rays that travel between the parts; rank 0 gets the film.
pub(super) fn render(
    crew: &Crew,
    work: &mut Work,
    (round, activity): (&Round, &Activity),
    stats: &mut RankStats,
) -> Result<Option<Film>> {
    let comm = crew.comm;
    let Division { ids, route, copies, limits } = work.division.take().expect("the scene was divided");
    let begin = Instant::now();
    let holding = Holding {
        scene: std::mem::take(&mut work.scene),
        accel: std::mem::replace(&mut work.accel, Accel::Brute),
        ids,
    };
    let part = stats.part.get_or_insert_default();
    part.primitives = holding.ids.len() as u64;
    part.scene_bytes = holding.scene.memory() as u64;
    part.accel_bytes = holding.accel.memory() as u64;
    part.replicated = copies;
    part.replicated_bytes = (part.scene_bytes + part.accel_bytes) * copies / part.primitives.max(1);

    // Every rank makes the camera rays of its own tiles.
    let tiling = Tiling::new(rounds::area(&work.image), TILE);
    let tiles = dealt_tiles(&tiling, work.run.deal, comm.rank(), comm.size());
    let units = tiles.len() as u64 * u64::from(round.count);
    let relay = Relay::new(holding, &route, comm.rank(), comm.size(), &work.image, *round);
    let mut source = Source { relay, tiling, tiles, width: work.image.width, round: *round, activity };
    let mut shown = 0;
    if comm.rank() == 0 {
        crew.progress.begin(units);
    }
    let mut tick = |begun: u64| {
        if comm.rank() == 0 {
            crew.progress.advance(begun - shown);
            shown = begun;
        }
    };
    let exchanged = {
        let _span = crew.timeline.span(0, "exchange");
        exchange::run(comm, crew.pool, &limits, units, &mut source, &mut tick)?
    };
    if comm.rank() == 0 {
        crew.progress.end();
    }
    stats.tiles += source.tiles.len() as u64;
    let traced = begin.elapsed().as_secs_f64();
    stats.seconds.trace += traced;

    // The films of all ranks add up to the image.
    let relay = source.relay;
    let [camera, reflection, refraction, shadow] = relay.tally.counts();
    stats.rays += stats::RayCounts { camera, reflection, refraction, shadow, prepass: 0 };
    if let Some(part) = &mut stats.part {
        part.asked += relay.asked.load(Ordering::Relaxed);
        part.exchange += exchanged;
    }
    let (holding, mut film) = relay.into_parts();
    let mut outcome = Ok(());
    let own = film.as_bytes().to_vec();
    comm.gather_each(&own, &mut |from, bytes| {
        if from > 0 && outcome.is_ok() {
            outcome = film.add(bytes);
        }
    });
    outcome?;
    stats.seconds.gather += begin.elapsed().as_secs_f64() - traced;
    work.division = Some(Division { ids: holding.ids, route, copies, limits });
    (work.scene, work.accel) = (holding.scene, holding.accel);
    Ok((comm.rank() == 0).then_some(film))
}

/// The tiles of one rank, in Morton order.
pub(super) fn dealt_tiles(tiling: &Tiling, deal: Deal, rank: usize, ranks: usize) -> Vec<u32> {
    let mut tiles: Vec<u32> = (0..tiling.len()).collect();
    tiles.sort_by_key(|&index| {
        let Tile { x0, y0, .. } = tiling.tile(index);
        morton([x0 / tiling.size(), y0 / tiling.size(), 0])
    });
    match deal {
        Deal::Interleaved => tiles.into_iter().skip(rank).step_by(ranks).collect(),
        Deal::Blocks => tiles[tiles.len() * rank / ranks..tiles.len() * (rank + 1) / ranks].to_vec(),
    }
}

/// The rays of one rank: those that it makes, and those that come to it.
struct Source<'a> {
    relay: Relay<'a>,
    tiling: Tiling,
    tiles: Vec<u32>,
    width: u32,
    round: Round,
    activity: &'a Activity,
}

impl Station<Traveller> for Source<'_> {
    fn prepare(&mut self, wave: &[Traveller]) {
        self.relay.prepare(wave);
    }

    fn begin(&self, unit: u64, out: &mut Outbox<Traveller>) {
        let count = u64::from(self.round.count);
        let (place, sample) = (unit / count, self.round.first + (unit % count) as u32);
        let tile = self.tiling.tile(self.tiles[place as usize]);
        let pixels = tile.pixels(self.width).filter(|&pixel| self.activity.holds(pixel));
        self.relay.begin(pixels, sample, out);
    }

    fn work(&self, wave: &[Traveller], range: Range<usize>, out: &mut Outbox<Traveller>) {
        self.relay.work(wave, range, out);
    }
}

impl Exit for Outbox<Traveller> {
    fn send(&mut self, rank: usize, traveller: Traveller) {
        self.push(rank, traveller);
    }

    fn room(&self) -> usize {
        Outbox::room(self)
    }
}
