//! Records that travel between ranks until none is left: every rank works on those it has and sends on what belongs to others.
//!
//! Every rank computes in its rayon pool, wave by wave, while the thread that called [`run`] does all the talking, also during a wave. One rank alone runs the same
//! code with nobody to talk to. Must not know what a record is: it is bytes of one length.
//!
//! | message | from → to | says |
//! |---|---|---|
//! | `RECORDS` | any → any | these records are yours |
//! | `GRANT` | any → any | I have taken a batch of yours in; you may send another one |
//! | `PROBE` | 0 → worker | tell me once you have nothing left to do |
//! | `ANSWER` | worker → 0 | I have nothing to do; so many records I have sent and received in all |
//! | `DONE` | 0 → worker | no record is left anywhere |
//!
//! **No deadlock.** A rank always takes in what arrives: what exceeds its memory goes to a file. So every batch is granted in the end, and what isn't granted yet waits
//! with its sender without stopping anything.
//!
//! **Bounded memory.** At most [`WINDOW`] batches are under way from one rank to another; piles, waves and what tasks make have their share of [`Limits`].
//!
//! **Termination** by four counters (Mattern 1987, "Algorithms for distributed termination detection", section 4): rank 0 asks all ranks round by round for the records that they have
//! sent and received, which they answer when idle. Where the records received up to one round are as many as those sent up to the next, none was under way between them,
//! and nobody had any: that holds for any order of arrival. Each batch has one grant and each probe one answer, so nothing strays out of an exchange.

mod pile;

#[cfg(test)]
mod tests;

use std::any::Any;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::time::{Duration, Instant};

use bytemuck::Pod;
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

use super::comm::{Backoff, Comm, Message, Tag};
use super::stray;
use crate::error::Result;
use pile::Pile;

const RECORDS: Tag = 11;
const GRANT: Tag = 12;
const PROBE: Tag = 13;
const ANSWER: Tag = 14;
const DONE: Tag = 15;

/// Batches that may be under way from one rank to another.
pub const WINDOW: usize = 4;
/// Records of a task.
const TASK: usize = 1024;
/// Most records of a batch.
const LARGEST_BATCH: usize = 8192;
/// The pause between two looks at the network during a wave.
const POLL: Duration = Duration::from_micros(500);

/// One rank's own work.
pub trait Station<T>: Sync {
    /// Called alone before each wave.
    fn prepare(&mut self, wave: &[T]);

    /// Begins a unit of the rank's own: the source of all records. Called in the pool, by several threads at once.
    fn begin(&self, unit: u64, out: &mut Outbox<T>);

    /// Works on records `range` of the wave, in the pool.
    fn work(&self, wave: &[T], range: Range<usize>, out: &mut Outbox<T>);
}

/// Where a task puts records for later: for other ranks, or for this one.
pub struct Outbox<T> {
    to: Vec<Vec<T>>,
    len: usize,
    room: usize,
}

impl<T> Outbox<T> {
    fn new(ranks: usize, room: usize) -> Self {
        Outbox { to: (0..ranks).map(|_| Vec::new()).collect(), len: 0, room }
    }

    pub fn push(&mut self, rank: usize, record: T) {
        self.to[rank].push(record);
        self.len += 1;
    }

    /// How many more records a task may hold or put in here before it should come to an end, and leave here for its own rank what it hasn't done.
    pub fn room(&self) -> usize {
        self.room.saturating_sub(self.len)
    }
}

/// How many records may be where, on one rank.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Those that wait for this rank.
    waiting: usize,
    wave: usize,
    /// Those that each task may make.
    task: usize,
    /// Those that wait to be sent to one other rank.
    outgoing: usize,
    batch: usize,
}

impl Limits {
    /// Divides `bytes` among the records of a rank with so many threads, one of `ranks`. `None` if that is too little for even one record each.
    pub fn new<T>(bytes: u64, ranks: usize, threads: usize) -> Option<Limits> {
        let records = usize::try_from(bytes).unwrap_or(usize::MAX) / size_of::<T>();
        let others = ranks.saturating_sub(1).max(1);
        // Eighths: waiting 2, wave 1, tasks 1, outgoing 2, under way from here 1 and to here 1.
        let limits = Limits {
            waiting: records / 4,
            wave: (records / 8).min(16 * TASK * threads),
            task: records / 8 / (2 * threads),
            outgoing: records / 4 / others,
            batch: (records / 8 / others / WINDOW).min(LARGEST_BATCH),
        };
        let least = limits.batch.min(limits.outgoing / 2).min(limits.wave / 2).min(limits.task / 2);
        (least >= 1).then_some(limits)
    }

    /// The least memory in bytes that [`Limits::new`] takes.
    pub fn least<T>(ranks: usize, threads: usize) -> u64 {
        let others = ranks.saturating_sub(1).max(1);
        (size_of::<T>() * 8 * (others * WINDOW).max(4 * threads) + 64 * size_of::<T>()) as u64
    }
}

/// What one rank did in an exchange.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ExchangeStats {
    pub units: u64,
    pub waves: u64,
    /// Records and bytes sent to other ranks.
    pub sent: u64,
    pub sent_bytes: u64,
    pub batches: u64,
    /// Records that were in a file for a while.
    pub spilled: u64,
    /// The most bytes that records took at once, beside those that tasks have not yet given back.
    pub peak_bytes: u64,
    /// Time spent in tasks, summed over threads.
    pub busy: Duration,
    /// Time without anything to do.
    pub idle: Duration,
    /// From the call to the last wave's end.
    pub elapsed: Duration,
}

impl std::ops::AddAssign for ExchangeStats {
    fn add_assign(&mut self, other: Self) {
        self.units += other.units;
        self.waves += other.waves;
        self.sent += other.sent;
        self.sent_bytes += other.sent_bytes;
        self.batches += other.batches;
        self.spilled += other.spilled;
        self.peak_bytes = self.peak_bytes.max(other.peak_bytes);
        self.busy += other.busy;
        self.idle += other.idle;
        self.elapsed += other.elapsed;
    }
}

/// Collective: begins this rank's `units` and works on records until no rank has any.
///
/// `tick` gets the units begun, on every rank, now and then.
///
/// # Errors
/// A temporary file that can't be used, or messages that no rank of this build would send. End the job by either.
///
/// # Panics
/// With the panic of a task; and when called from a thread of `pool`.
pub fn run<T: Pod + Send + Sync>(
    comm: &dyn Comm,
    pool: &ThreadPool,
    limits: &Limits,
    units: u64,
    station: &mut impl Station<T>,
    tick: &mut dyn FnMut(u64),
) -> Result<ExchangeStats> {
    assert!(pool.current_thread_index().is_none(), "an exchange must be called from outside its pool");
    let start = Instant::now();
    let mut post = Post::new(comm, limits);
    let mut stats = ExchangeStats::default();
    let (mut backoff, mut pause) = (Backoff::default(), None::<Instant>);
    let mut wave = Vec::new();
    loop {
        let mut news = post.receive()?;
        wave.clear();
        post.waiting.take(limits.wave, &mut wave)?;
        let lacking =
            (2 * TASK * pool.current_num_threads()).saturating_sub(wave.len()).div_ceil(TASK) as u64;
        // Nothing new is begun while much waits to be sent.
        let may_begin = if post.is_crowded() { 0 } else { lacking.min(units - stats.units) };
        let begun = stats.units..stats.units + may_begin;
        if !(wave.is_empty() && begun.is_empty()) {
            stats.idle += pause.take().map_or(Duration::ZERO, |since| since.elapsed());
            stats.waves += 1;
            stats.units = begun.end;
            station.prepare(&wave);
            stats.busy += run_wave(&mut post, pool, &*station, &wave, begun, limits)?;
            stats.elapsed = start.elapsed();
            tick(stats.units);
            news = true;
        }
        news |= post.send()?;
        comm.progress();
        if stats.units == units && post.is_idle() && post.is_over() {
            break;
        }
        if news {
            backoff = Backoff::default();
        } else {
            pause.get_or_insert_with(Instant::now);
            backoff.wait();
        }
    }
    stats.idle += pause.map_or(Duration::ZERO, |since| since.elapsed());
    (stats.sent, stats.sent_bytes) = (post.sent, post.sent * size_of::<T>() as u64);
    stats.batches = post.batches;
    stats.spilled = post.piles().map(Pile::spilled).sum();
    stats.peak_bytes = (post.peak * size_of::<T>()) as u64;
    comm.flush();
    comm.barrier();
    Ok(stats)
}

/// What a task does.
enum Job {
    Records(Range<usize>),
    Unit(u64),
}

/// What came of a task.
struct Finished<T> {
    out: Outbox<T>,
    busy: Duration,
    panic: Option<Box<dyn Any + Send>>,
}

/// Runs the tasks of a wave in the pool, and talks meanwhile; the time they took together.
fn run_wave<T: Pod + Send + Sync>(
    post: &mut Post<T>,
    pool: &ThreadPool,
    station: &impl Station<T>,
    wave: &[T],
    begun: Range<u64>,
    limits: &Limits,
) -> Result<Duration> {
    let failed = &AtomicBool::new(false);
    let ranks = post.comm.size();
    let run = |job: Job, finish: Sender<Finished<T>>| {
        if failed.load(Ordering::Relaxed) {
            return;
        }
        let (start, mut out) = (Instant::now(), Outbox::new(ranks, limits.task));
        let panic = catch_unwind(AssertUnwindSafe(|| match job {
            Job::Records(range) => station.work(wave, range, &mut out),
            Job::Unit(unit) => station.begin(unit, &mut out),
        }))
        .err();
        failed.fetch_or(panic.is_some(), Ordering::Relaxed);
        // The receiver is gone only where the wave has failed.
        let _ = finish.send(Finished { out, busy: start.elapsed(), panic });
    };
    let run = &run;
    pool.in_place_scope_fifo(|scope| {
        let (finish, finished) = mpsc::channel::<Finished<T>>();
        // Small waves are divided, too: each thread should have something.
        let length =
            wave.len().div_ceil(2 * pool.current_num_threads()).clamp(1, TASK.min(limits.task.max(1)));
        let records =
            (0..wave.len()).step_by(length).map(|from| Job::Records(from..(from + length).min(wave.len())));
        let mut jobs = records.chain(begun.map(Job::Unit));
        let mut running = 0;
        let mut busy = Duration::ZERO;
        loop {
            // Two tasks a thread: what they make is bounded by that.
            while running < 2 * pool.current_num_threads()
                && let Some(job) = jobs.next()
            {
                running += 1;
                let finish = finish.clone();
                scope.spawn_fifo(move |_| run(job, finish));
            }
            if running == 0 {
                return Ok(busy);
            }
            if let Ok(done) = finished.recv_timeout(POLL) {
                if let Some(panic) = done.panic {
                    resume_unwind(panic);
                }
                running -= 1;
                busy += done.busy;
                post.take_in(done.out, wave.len()).inspect_err(|_| failed.store(true, Ordering::Relaxed))?;
            }
            let talk = post.receive().and_then(|_| post.send());
            talk.inspect_err(|_| failed.store(true, Ordering::Relaxed))?;
            post.comm.progress();
        }
    })
}

/// A rank's records that aren't in its pool, and its part of the protocol.
struct Post<'a, T> {
    comm: &'a dyn Comm,
    limits: &'a Limits,
    waiting: Pile<T>,
    /// By rank; this rank's own is empty.
    outgoing: Vec<Pile<T>>,
    /// Batches that may be sent to each rank.
    granted: Vec<usize>,
    sent: u64,
    received: u64,
    batches: u64,
    peak: usize,
    /// A worker: rank 0 waits for an answer.
    is_probed: bool,
    is_done: bool,
    /// Rank 0: the round of probes under way.
    round: Option<Round>,
    /// Rank 0: the records received up to the round before.
    received_before: Option<u64>,
}

struct Round {
    answers: usize,
    sent: u64,
    received: u64,
}

impl<'a, T: Pod> Post<'a, T> {
    fn new(comm: &'a dyn Comm, limits: &'a Limits) -> Self {
        Post {
            comm,
            limits,
            waiting: Pile::new(limits.waiting),
            outgoing: (0..comm.size()).map(|_| Pile::new(limits.outgoing)).collect(),
            granted: vec![WINDOW; comm.size()],
            sent: 0,
            received: 0,
            batches: 0,
            peak: 0,
            is_probed: false,
            is_done: false,
            round: None,
            received_before: None,
        }
    }

    fn piles(&self) -> impl Iterator<Item = &Pile<T>> {
        self.outgoing.iter().chain(std::iter::once(&self.waiting))
    }

    /// Whether half of the room for outgoing records to some rank is taken, or of that for waiting ones.
    fn is_crowded(&self) -> bool {
        self.waiting.len() > self.limits.waiting / 2
            || self.outgoing.iter().any(|pile| pile.len() > self.limits.outgoing / 2)
    }

    /// Nothing to work on or to send, and all that was sent has arrived.
    fn is_idle(&self) -> bool {
        self.waiting.is_empty()
            && self.outgoing.iter().all(Pile::is_empty)
            && self.granted.iter().all(|&granted| granted == WINDOW)
    }

    /// Sorts what a task made to where it belongs.
    fn take_in(&mut self, out: Outbox<T>, wave: usize) -> Result<()> {
        let own = self.comm.rank();
        for (rank, records) in out.to.into_iter().enumerate() {
            let pile = if rank == own { &mut self.waiting } else { &mut self.outgoing[rank] };
            pile.push(&records)?;
        }
        let under_way: usize =
            self.granted.iter().map(|granted| (WINDOW - granted) * self.limits.batch).sum();
        let held: usize = self.piles().map(Pile::held).sum();
        self.peak = self.peak.max(held + under_way + wave);
        Ok(())
    }

    /// Takes in all messages that have arrived; whether there were any.
    fn receive(&mut self) -> Result<bool> {
        let mut any = false;
        while let Some(message) = self.comm.try_receive() {
            any = true;
            let is_worker = self.comm.rank() > 0;
            match message.tag {
                RECORDS if message.bytes.len().is_multiple_of(size_of::<T>()) => {
                    let mut records = vec![T::zeroed(); message.bytes.len() / size_of::<T>()];
                    bytemuck::cast_slice_mut::<T, u8>(&mut records).copy_from_slice(&message.bytes);
                    self.waiting.push(&records)?;
                    self.received += records.len() as u64;
                    self.comm.send(message.from, GRANT, self.comm.take_buffer());
                }
                GRANT if self.granted[message.from] < WINDOW => self.granted[message.from] += 1,
                PROBE if is_worker && !self.is_probed => self.is_probed = true,
                DONE if is_worker => self.is_done = true,
                ANSWER => self.hear(&message)?,
                _ => return Err(stray(&message)),
            }
            self.comm.recycle(message.bytes);
        }
        Ok(any)
    }

    fn hear(&mut self, message: &Message) -> Result<()> {
        let (Some(round), Ok(counts)) = (&mut self.round, <[u8; 16]>::try_from(&message.bytes[..])) else {
            return Err(stray(message));
        };
        let [sent, received]: [u64; 2] = bytemuck::cast(counts);
        round.sent += u64::from_le(sent);
        round.received += u64::from_le(received);
        round.answers += 1;
        Ok(())
    }

    /// Sends what is granted; whether that was anything.
    fn send(&mut self) -> Result<bool> {
        let mut any = false;
        for to in 0..self.outgoing.len() {
            while self.granted[to] > 0 && !self.outgoing[to].is_empty() {
                let mut batch = Vec::new();
                self.outgoing[to].take(self.limits.batch, &mut batch)?;
                let mut bytes = self.comm.take_buffer();
                bytes.extend_from_slice(bytemuck::cast_slice(&batch));
                self.comm.send(to, RECORDS, bytes);
                self.granted[to] -= 1;
                self.sent += batch.len() as u64;
                self.batches += 1;
                any = true;
            }
        }
        Ok(any)
    }

    /// An idle rank's part in finding out whether all are; true at the end of the exchange.
    fn is_over(&mut self) -> bool {
        if self.comm.rank() > 0 {
            if std::mem::take(&mut self.is_probed) {
                let mut bytes = self.comm.take_buffer();
                bytes.extend_from_slice(&self.sent.to_le_bytes());
                bytes.extend_from_slice(&self.received.to_le_bytes());
                self.comm.send(0, ANSWER, bytes);
            }
            return self.is_done;
        }
        let workers = 1..self.comm.size();
        match &self.round {
            Some(round) if round.answers < workers.len() => return false,
            Some(round) => {
                if self.received_before == Some(round.sent) {
                    workers.for_each(|to| self.comm.send(to, DONE, self.comm.take_buffer()));
                    return true;
                }
                self.received_before = Some(round.received);
            }
            None => {}
        }
        self.round = Some(Round { answers: 0, sent: self.sent, received: self.received });
        workers.for_each(|to| self.comm.send(to, PROBE, self.comm.take_buffer()));
        false
    }
}
