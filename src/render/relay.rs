//! Rays that travel between ranks, each of which has a part of the scene: one rank's work on those that are with it.
//!
//! A ray asks the ranks on its route one after the other, each once, for a hit nearer than the best so far, and is shaded where the best hit lies. Everything about it travels with it:
//! its original origin and direction (never moved), and what it starts on, which may lie elsewhere. Ids in a [`Traveller`] are those of the whole scene; here, and only here, they
//! become those of the rank's part and back.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::{Pod, Zeroable};

use super::features;
use super::film::Film;
use super::filter::FilterTable;
use super::rounds::{self, Round};
use super::shared_film::{Deposits, SharedFilm};
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
use crate::transport::sampler::{Cameras, LANES};

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
        let (mut cameras, mut samples) = (Cameras::default(), pixels.map(|pixel| (pixel, sample)));
        let mut records = Vec::with_capacity(LANES);
        loop {
            let count = cameras.take(&mut samples, LANES);
            if count == 0 {
                break;
            }
            leg.renderer.begin(&self.round, &mut cameras, count, |record| records.push(record));
            for record in records.drain(..) {
                leg.scratch.deposits.count(&self.film, &record);
                leg.push(record);
            }
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

/// A ray that came from another rank, or came back.
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
    scratch: Scratch,
    /// Rays made here.
    counts: RayCounts,
}

/// What a task works with, kept for the next; no rays are left in it.
#[derive(Debug, Default)]
struct Scratch {
    /// Rays made here that ask this rank first, in its own ids: most never leave.
    own: Streams<RayRecord>,
    /// Rays from elsewhere that ask this rank.
    visiting: Streams<Pending>,
    deposits: Deposits,
    wave: Vec<Pending>,
    records: Vec<RayRecord>,
    answers: Vec<Answer>,
}

/// A panic elsewhere leaves the list of buffers whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'r> Leg<'r> {
    fn new(relay: &'r Relay, wave: &'r [Traveller], exit: &'r mut dyn Exit) -> Self {
        let Holding { scene, accel, .. } = &relay.holding;
        let renderer = Renderer::with_filter(scene, accel, relay.settings, relay.filter.clone());
        let scratch = lock(&relay.scratch).pop().unwrap_or_default();
        Leg { relay, renderer, wave, exit, scratch, counts: RayCounts::default() }
    }

    /// Traces what is to be traced here until nothing is left, or until there is no room for more.
    fn run(mut self) {
        let mut wave = std::mem::take(&mut self.scratch.wave);
        let mut records = std::mem::take(&mut self.scratch.records);
        let mut answers = std::mem::take(&mut self.scratch.answers);
        loop {
            wave.clear();
            records.clear();
            self.scratch.visiting.take(&mut wave, BATCH);
            records.extend(wave.iter().map(|pending| {
                let record = pending.record();
                RayRecord { t_max: record.t_max.min(pending.traveller.best.t), ..record }
            }));
            self.scratch.own.take(&mut records, BATCH);
            if records.is_empty() {
                break;
            }
            let Holding { scene, accel, .. } = &self.relay.holding;
            accel.trace(&scene.surfaces, &records, &mut answers);
            self.relay.asked.fetch_add(records.len() as u64, Ordering::Relaxed);
            for (pending, answer) in wave.iter_mut().zip(&answers) {
                self.visitor_answered(pending, answer);
            }
            for (record, answer) in records.iter().zip(&answers).skip(wave.len()) {
                self.own_answered(record, answer);
            }
            if self.scratch.visiting.len() + self.scratch.own.len() > self.exit.room() {
                self.leave();
            }
        }
        self.scratch.deposits.go_to(&self.relay.film);
        self.relay.tally.add(&self.counts);
        lock(&self.relay.scratch).push(Scratch { wave, records, answers, ..self.scratch });
    }

    /// Puts what hasn't been traced aside for later.
    fn leave(&mut self) {
        let home = self.relay.rank;
        let visiting: Vec<Pending> = self.scratch.visiting.drain().collect();
        visiting.iter().for_each(|pending| self.send(home, pending));
        let own: Vec<RayRecord> = self.scratch.own.drain().collect();
        own.iter().for_each(|record| self.exit.send(home, self.departing(record)));
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
            _ => self.scratch.visiting.push(traveller.record.stream, pending),
        }
    }

    /// Weighs what this rank's part answered to a ray that has asked no other yet.
    fn own_answered(&mut self, record: &RayRecord, answer: &Answer) {
        if answer.is_hit() && record.query() == Query::Occluded {
            return;
        }
        let mut progress = Progress::new(self.relay.rank);
        progress.ask(self.relay.rank);
        let Some(rank) = self.relay.guide.next(&record.ray(), answer.t, &progress) else {
            self.shade(record, answer);
            return;
        };
        let mut traveller = Traveller { progress, ..self.departing(record) };
        if answer.is_hit() {
            let primitive = self.relay.holding.ids[answer.primitive as usize];
            traveller.best = Answer { primitive, ..*answer };
            traveller.holder = self.relay.rank as u32;
        }
        self.exit.send(rank, traveller);
    }

    /// The same of a ray from elsewhere.
    fn visitor_answered(&mut self, pending: &mut Pending, answer: &Answer) {
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
        match self.relay.guide.next(&record.ray(), best.t, progress) {
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

    /// Shades the hit of a ray from elsewhere, which lies here, or what it shows if there is none.
    fn conclude(&mut self, pending: &Pending) {
        let best = &pending.traveller.best;
        let primitive = match best.primitive {
            NONE => NONE,
            _ if pending.primitive != NONE => pending.primitive,
            id => self.relay.local(id).expect("a ray is shaded where its hit was found"),
        };
        self.shade(&pending.record(), &Answer { primitive, ..*best });
    }

    /// Shades what a ray has found here in the end, all in this rank's ids.
    fn shade(&mut self, record: &RayRecord, found: &Answer) {
        let Holding { scene, ids, .. } = &self.relay.holding;
        if self.relay.settings.features {
            let id = if found.is_hit() { ids[found.primitive as usize] } else { NONE };
            if let Some(features) = features::of_hit(scene, record, found, id) {
                self.scratch.deposits.add_features(&self.relay.film, record, &features);
            }
        }
        let transport = self.renderer.transport;
        transport.advance(record, found, self);
    }

    fn send(&mut self, rank: usize, pending: &Pending) {
        let mut traveller = pending.traveller;
        if pending.start < FIRST_GUEST {
            traveller.start = self.relay.holding.scene.surfaces.start(pending.start).into();
        }
        self.exit.send(rank, traveller);
    }

    /// A ray in this rank's ids that was made here and hasn't asked anybody, as others know it.
    fn departing(&self, record: &RayRecord) -> Traveller {
        let Holding { scene, ids, .. } = &self.relay.holding;
        let mut traveller = Traveller {
            record: *record,
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
            own => {
                traveller.record.start = ids[own as usize];
                traveller.start = scene.surfaces.start(own).into();
            }
        }
        if record.first_id > 0 {
            traveller.record.first_id = ids[record.first_id as usize - 1] + 1;
        }
        traveller
    }
}

impl Sink for Leg<'_> {
    /// Takes in a ray that was made here, in this rank's ids.
    fn push(&mut self, record: RayRecord) {
        self.counts[record.made_by() as usize] += 1;
        // Where it was made it asks first.
        self.scratch.own.push(record.stream, record);
    }

    fn deposit(&mut self, record: &RayRecord, radiance: Color) {
        self.scratch.deposits.add(&self.relay.film, record, radiance);
    }
}
