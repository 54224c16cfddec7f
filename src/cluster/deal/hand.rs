//! The units that one rank holds: a few in its pool, the rest in line. Knows no messages.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration, Instant};

use rayon::ScopeFifo;

use super::Render;
use crate::cluster::Comm;

/// Set when the deal has failed, so that units waiting in the pool are not begun any more.
pub(super) type Cancelled = AtomicBool;

/// Units asked for ahead are at most this many times the threads, however slow the answers are.
const MOST_AHEAD: usize = 16;

const SHORTEST_PAUSE: Duration = Duration::from_micros(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(2);

struct Finished {
    unit: u32,
    bytes: Vec<u8>,
    busy: Duration,
    panic: Option<Box<dyn Any + Send>>,
}

/// One rank's units, and its pool.
pub(super) struct Hand<'a, 'scope> {
    comm: &'a dyn Comm,
    scope: &'a ScopeFifo<'scope>,
    threads: usize,
    render: &'scope Render<'scope>,
    cancelled: &'scope Cancelled,
    /// Not yet given to the pool: what waits there can't be counted on to start in order of cost.
    line: VecDeque<u32>,
    in_pool: usize,
    finished: Receiver<Finished>,
    finish: Sender<Finished>,
    /// Taken from the channel while waiting.
    next_finished: Option<Finished>,
    units: usize,
    busy: Duration,
}

impl<'a, 'scope> Hand<'a, 'scope> {
    pub fn new(
        comm: &'a dyn Comm,
        scope: &'a ScopeFifo<'scope>,
        threads: usize,
        render: &'scope Render<'scope>,
        cancelled: &'scope Cancelled,
    ) -> Self {
        let (finish, finished) = mpsc::channel();
        Hand {
            comm,
            scope,
            threads,
            render,
            cancelled,
            line: VecDeque::new(),
            in_pool: 0,
            finished,
            finish,
            next_finished: None,
            units: 0,
            busy: Duration::ZERO,
        }
    }

    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Units finished here.
    pub fn units(&self) -> usize {
        self.units
    }

    /// Time spent rendering, summed over threads.
    pub fn busy(&self) -> Duration {
        self.busy
    }

    /// Whether no unit is left here, in line or in the pool.
    pub fn is_empty(&self) -> bool {
        self.line.is_empty() && self.in_pool == 0
    }

    /// How many units must come for each thread to have one and another one waiting, and for the pool to stay
    /// busy over a `round_trip` of asking for more. 0 as long as enough are waiting.
    pub fn lack(&self, round_trip: Duration) -> usize {
        let here = self.line.len() + self.in_pool;
        let mean = self.mean_time().as_secs_f64();
        let meanwhile = if mean > 0.0 { round_trip.as_secs_f64() / mean * self.threads as f64 } else { 0.0 };
        let ahead = (self.threads + meanwhile.ceil() as usize).min(self.threads * MOST_AHEAD);
        (self.threads + ahead).saturating_sub(here)
    }

    /// The pause between two looks at the network: well below the time of a unit, which is what everyone has in
    /// reserve, and no shorter, for each look is a thread woken on a processor that is computing.
    pub fn poll_pause(&self) -> Duration {
        (self.mean_time() / 4).clamp(SHORTEST_PAUSE, LONGEST_PAUSE)
    }

    fn mean_time(&self) -> Duration {
        self.busy / self.units.max(1) as u32
    }

    /// Takes units in, and starts what the pool has room for.
    pub fn add(&mut self, units: impl AsRef<[u32]>) {
        self.line.extend(units.as_ref());
        self.feed();
    }

    /// Gives the pool one unit per thread, and one more each, so that no thread waits for this one to wake up.
    fn feed(&mut self) {
        while self.in_pool < 2 * self.threads
            && let Some(unit) = self.line.pop_front()
        {
            self.in_pool += 1;
            let mut bytes = self.comm.take_buffer();
            let (render, cancelled, finish) = (self.render, self.cancelled, self.finish.clone());
            self.scope.spawn_fifo(move |_| {
                if cancelled.load(Ordering::Relaxed) {
                    return;
                }
                let start = Instant::now();
                let panic = catch_unwind(AssertUnwindSafe(|| render(unit, &mut bytes))).err();
                cancelled.fetch_or(panic.is_some(), Ordering::Relaxed);
                // The receiver is gone only where the deal has failed.
                let _ = finish.send(Finished { unit, bytes, busy: start.elapsed(), panic });
            });
        }
    }

    /// The next finished unit and its bytes, if any; the pool gets another one for it.
    ///
    /// # Panics
    /// With the panic of the unit's `render`.
    pub fn try_finished(&mut self) -> Option<(u32, Vec<u8>)> {
        let finished = self.next_finished.take().or_else(|| self.finished.try_recv().ok())?;
        if let Some(panic) = finished.panic {
            resume_unwind(panic);
        }
        self.in_pool -= 1;
        self.units += 1;
        self.busy += finished.busy;
        self.feed();
        Some((finished.unit, finished.bytes))
    }

    /// Sleeps until a unit is finished, or for `pause`.
    pub fn wait(&mut self, pause: Duration) {
        if self.next_finished.is_none() {
            self.next_finished = self.finished.recv_timeout(pause).ok();
        }
    }
}

impl Drop for Hand<'_, '_> {
    fn drop(&mut self) {
        // Nothing is in the pool any more, unless the deal has failed.
        self.cancelled.store(true, Ordering::Relaxed);
    }
}
