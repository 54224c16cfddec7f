//! Rays that travel between ranks, each of which has a part of the scene: one rank's work on those that are with it.
//!
//! A ray asks the ranks on its route one after the other, each once, for a hit nearer than the best so far, and is shaded where the best hit lies. Everything about it travels with it:
//! its original origin and direction (never moved), and what it starts on, which may lie elsewhere. Ids in a [`Traveller`] are those of the whole scene; here, and only here, they
//! become those of the rank's part and back.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::{Pod, Zeroable};

use super::features;
use super::film::{Film, SharedFilm};
use super::filter::FilterTable;
use super::rounds::{self, Round};
use super::streams::Streams;
use super::{BATCH, RayCounts, RayTally, Renderer};
use crate::accel::Accel;
use crate::accel::route::{Guide, Progress, Route};
use crate::geometry::NONE;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::mesh::{FIRST_GUEST, Shape, Sphere};
use crate::scene::{Color, Scene};
use crate::settings::ImageSettings;
use crate::transport::Sink;

/// A ray on its way between ranks.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Traveller {
    record: RayRecord,
    /// The best hit so far.
    best: Answer,
    progress: Progress,
    /// The rank that found it.
    holder: u32,
    start: Start,
}

/// [`Progress::hops`] of a ray whose route is at its end, on its way to where it is shaded.
const TO_BE_SHADED: u32 = u32::MAX;

/// The numbers of what a ray starts on.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct Start {
    /// 0 for nothing, 1 for a triangle, 2 for a sphere: centre and radius.
    kind: u32,
    numbers: [f32; 9],
    _pad: u32,
}

impl Start {
    const NOTHING: Start = Start { kind: 0, numbers: [0.0; 9], _pad: 0 };

    fn shape(&self) -> Option<Shape> {
        let [a, b, c, d, e, f, g, h, i] = self.numbers;
        match self.kind {
            1 => Some(Shape::Triangle([[a, b, c], [d, e, f], [g, h, i]])),
            2 => Some(Shape::Sphere(Sphere { center: [a, b, c], radius: d })),
            _ => None,
        }
    }
}

impl From<Option<Shape>> for Start {
    fn from(shape: Option<Shape>) -> Self {
        match shape {
            None => Start::NOTHING,
            Some(Shape::Triangle(corners)) => {
                Start { kind: 1, numbers: bytemuck::cast(corners), ..Start::NOTHING }
            }
            Some(Shape::Sphere(Sphere { center: [x, y, z], radius })) => {
                Start { kind: 2, numbers: [x, y, z, radius, 0.0, 0.0, 0.0, 0.0, 0.0], ..Start::NOTHING }
            }
        }
    }
}

/// Where rays go that aren't done here.
pub trait Exit {
    /// Sends a ray to a rank, or leaves it for this one.
    fn send(&mut self, rank: usize, traveller: Traveller);

    /// How many rays may still be kept in work here or sent.
    fn room(&self) -> usize;
}

/// The part of a scene that one rank has.
#[derive(Debug)]
pub struct Holding {
    pub scene: Scene,
    pub accel: Accel,
    /// Of each primitive of the part its id in the whole, ascending.
    pub ids: Vec<u32>,
}

/// One rank of a relay.
pub struct Relay<'a> {
    holding: Holding,
    guide: Guide<'a>,
    rank: usize,
    settings: &'a ImageSettings,
    filter: FilterTable,
    round: Round,
    film: SharedFilm,
    pub tally: RayTally,
    /// How often a ray was put to this part.
    pub asked: AtomicU64,
    scratch: Mutex<Vec<Scratch>>,
}

impl<'a> Relay<'a> {
    pub fn new(
        holding: Holding,
        route: &'a Route,
        rank: usize,
        ranks: usize,
        settings: &'a ImageSettings,
        round: Round,
    ) -> Self {
        let filter = FilterTable::new(settings.filter);
        let planes = super::planes(settings, &filter, &round);
        let film = SharedFilm::new(rounds::area(settings), settings.width, planes);
        Relay {
            round,
            holding,
            guide: Guide::new(route, rank, ranks),
            rank,
            settings,
            filter,
            film,
            tally: RayTally::default(),
            asked: AtomicU64::new(0),
            scratch: Mutex::default(),
        }
    }

    /// The part, and what was deposited here.
    pub fn into_parts(self) -> (Holding, Film) {
        (self.holding, self.film.into_film())
    }

    /// Makes known what the rays of the next calls of [`Relay::work`] start on.
    pub fn prepare(&mut self, wave: &[Traveller]) {
        let guests = &mut self.holding.scene.surfaces.guests;
        guests.clear();
        guests.extend(wave.iter().map(|traveller| traveller.start.shape()));
    }

    /// Sends one sample of each of these pixels on its way.
    pub fn begin(&self, pixels: impl Iterator<Item = u32>, sample: u32, exit: &mut dyn Exit) {
        let mut leg = Leg::new(self, &[], exit);
        for pixel in pixels {
            let record = leg.renderer.sample_of(&self.round, pixel, sample);
            self.film.count(&record);
            leg.push(record);
        }
        leg.run();
    }

    /// Goes on with rays `range` of the wave that was prepared for.
    pub fn work(&self, wave: &[Traveller], range: std::ops::Range<usize>, exit: &mut dyn Exit) {
        let mut leg = Leg::new(self, wave, exit);
        for index in range {
            leg.enter(index);
        }
        leg.run();
    }

    /// The place here of a primitive of the whole scene, if it is here.
    fn local(&self, id: u32) -> Option<u32> {
        self.holding.ids.binary_search(&id).ok().map(|place| place as u32)
    }
}

/// A ray in work.
#[derive(Clone, Copy, Debug)]
struct Pending {
    traveller: Traveller,
    /// What it starts on, as this rank names it.
    start: u32,
    /// [`RayRecord::first_id`] in this rank's ids.
    first_id: u32,
    /// The best hit's primitive, if that was found here and now.
    primitive: u32,
}

impl Pending {
    /// The ray as this rank traces and shades it.
    fn record(&self) -> RayRecord {
        RayRecord { start: self.start, first_id: self.first_id, ..self.traveller.record }
    }
}

/// One task's rays.
struct Leg<'r> {
    relay: &'r Relay<'r>,
    renderer: Renderer<'r>,
    wave: &'r [Traveller],
    exit: &'r mut dyn Exit,
    /// Rays that are to be traced here.
    streams: Streams<Pending>,
    scratch: Scratch,
    /// Rays made here.
    counts: RayCounts,
}

/// Empty buffers of a task, kept for the next.
#[derive(Debug, Default)]
struct Scratch {
    wave: Vec<Pending>,
    records: Vec<RayRecord>,
    answers: Vec<Answer>,
    streams: Streams<Pending>,
}

/// A panic elsewhere leaves the list of buffers whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'r> Leg<'r> {
    fn new(relay: &'r Relay, wave: &'r [Traveller], exit: &'r mut dyn Exit) -> Self {
        let Holding { scene, accel, .. } = &relay.holding;
        let renderer = Renderer::with_filter(scene, accel, relay.settings, relay.filter.clone());
        let mut scratch = lock(&relay.scratch).pop().unwrap_or_default();
        let streams = std::mem::take(&mut scratch.streams);
        Leg { relay, renderer, wave, exit, streams, scratch, counts: RayCounts::default() }
    }

    /// Traces what is to be traced here until nothing is left, or until there is no room for more.
    fn run(&mut self) {
        let Scratch { mut wave, mut records, mut answers, .. } = std::mem::take(&mut self.scratch);
        loop {
            wave.clear();
            self.streams.take(&mut wave, BATCH);
            if wave.is_empty() {
                break;
            }
            records.clear();
            records.extend(wave.iter().map(|pending| {
                let record = pending.record();
                RayRecord { t_max: record.t_max.min(pending.traveller.best.t), ..record }
            }));
            let Holding { scene, accel, .. } = &self.relay.holding;
            accel.trace(&scene.surfaces, &records, &mut answers);
            self.relay.asked.fetch_add(records.len() as u64, Ordering::Relaxed);
            for (pending, answer) in wave.iter_mut().zip(&answers) {
                self.answered(pending, answer);
            }
            if self.streams.len() > self.exit.room() {
                let left: Vec<Pending> = self.streams.drain().collect();
                left.iter().for_each(|pending| self.send(self.relay.rank, pending));
                break;
            }
        }
        self.relay.tally.add(&self.counts);
        let streams = std::mem::take(&mut self.streams);
        lock(&self.relay.scratch).push(Scratch { wave, records, answers, streams });
    }

    /// Takes in a ray of the wave.
    fn enter(&mut self, index: usize) {
        let traveller = self.wave[index];
        let RayRecord { start, first_id, .. } = traveller.record;
        let guest = || FIRST_GUEST + index as u32;
        let pending = Pending {
            traveller,
            start: if start == NONE { NONE } else { self.relay.local(start).unwrap_or_else(guest) },
            first_id: if first_id == 0 {
                0
            } else {
                self.relay.holding.ids.partition_point(|&id| id < first_id) as u32
            },
            primitive: NONE,
        };
        match traveller.progress.hops {
            TO_BE_SHADED => self.conclude(&pending),
            _ => self.streams.push(traveller.record.stream, pending),
        }
    }

    /// Weighs what this rank's part answered to a ray.
    fn answered(&mut self, pending: &mut Pending, answer: &Answer) {
        let Traveller { record, best, progress, holder, .. } = &mut pending.traveller;
        if answer.is_hit() {
            if record.query() == Query::Occluded {
                return;
            }
            let primitive = self.relay.holding.ids[answer.primitive as usize];
            if answer.t < best.t || (answer.t == best.t && primitive < best.primitive) {
                *best = Answer { primitive, ..*answer };
                *holder = self.relay.rank as u32;
                pending.primitive = answer.primitive;
            }
        }
        progress.ask(self.relay.rank);
        self.go_on(pending);
    }

    /// Sends a ray to the next rank on its route, or comes to its end.
    fn go_on(&mut self, pending: &mut Pending) {
        let Traveller { record, best, progress, holder, .. } = &mut pending.traveller;
        match self.relay.guide.next(&record.ray(), best.t, progress) {
            Some(rank) if rank == self.relay.rank => self.streams.push(record.stream, *pending),
            Some(rank) => self.send(rank, pending),
            None if !best.is_hit() || *holder as usize == self.relay.rank => self.conclude(pending),
            None => match self.relay.local(best.primitive) {
                // What several ranks have is shaded by any of them.
                Some(primitive) => {
                    pending.primitive = primitive;
                    self.conclude(pending);
                }
                None => {
                    let holder = *holder as usize;
                    progress.hops = TO_BE_SHADED;
                    self.send(holder, pending);
                }
            },
        }
    }

    /// Shades the ray's hit, which lies here, or what it shows if there is none.
    fn conclude(&mut self, pending: &Pending) {
        let best = &pending.traveller.best;
        let primitive = match best.primitive {
            NONE => NONE,
            _ if pending.primitive != NONE => pending.primitive,
            id => self.relay.local(id).expect("a ray is shaded where its hit was found"),
        };
        let (scene, film) = (&self.relay.holding.scene, &self.relay.film);
        let found = Answer { primitive, ..*best };
        if self.relay.settings.features
            && let Some(features) = features::of_hit(scene, &pending.record(), &found, best.primitive)
        {
            film.add_features(&pending.record(), &features);
        }
        let transport = self.renderer.transport;
        transport.advance(&pending.record(), &found, self);
    }

    fn send(&mut self, rank: usize, pending: &Pending) {
        let mut traveller = pending.traveller;
        if pending.start < FIRST_GUEST {
            traveller.start = self.relay.holding.scene.surfaces.start(pending.start).into();
        }
        self.exit.send(rank, traveller);
    }
}

impl Sink for Leg<'_> {
    /// Takes in a ray that was made here, in this rank's ids.
    fn push(&mut self, record: RayRecord) {
        self.counts[record.made_by() as usize] += 1;
        let ids = &self.relay.holding.ids;
        let mut traveller = Traveller {
            record,
            best: Answer::MISS,
            progress: Progress::new(self.relay.rank),
            holder: NONE,
            start: Start::NOTHING,
        };
        match record.start {
            NONE => {}
            guest @ FIRST_GUEST.. => {
                let host = &self.wave[(guest - FIRST_GUEST) as usize];
                (traveller.record.start, traveller.start) = (host.record.start, host.start);
            }
            own => traveller.record.start = ids[own as usize],
        }
        if record.first_id > 0 {
            traveller.record.first_id = ids[record.first_id as usize - 1] + 1;
        }
        let (start, first_id) = (record.start, record.first_id);
        self.go_on(&mut Pending { traveller, start, first_id, primitive: NONE });
    }

    fn deposit(&mut self, record: &RayRecord, radiance: Color) {
        self.relay.film.deposit(record, radiance);
    }
}
