//! Dealing units of work to ranks that differ in speed, largest first, and bringing the results home.
//!
//! Rank 0 hands out numbers on request and computes too; every rank computes in its rayon pool, while the thread
//! that called [`run`] does all the talking. One rank alone runs the same code with nobody to talk to.
//! Must not know what a unit is: it is a number, and its result is bytes.
//!
//! Chunk sizes are guided (Polychronopoulos & Kuck 1987), by cost and by threads: a share of what is left, so
//! few messages at first and single units at the end. The protocol:
//!
//! | message | from → to | says |
//! |---|---|---|
//! | `REQUEST` | worker → 0 | my threads, and how many units I lack; one under way at a time |
//! | `CHUNK` | 0 → worker | these units; none: there are no more, don't ask again |
//! | `RESULT` | worker → 0 | the bytes of a unit, then its number |
//!
//! Each request has one answer and all ranks leave together, so nothing of one deal strays into the next.

mod fixed;
mod hand;
mod plan;

#[cfg(test)]
pub(super) mod tests;

use std::time::{Duration, Instant};

use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

use super::comm::{Comm, Message, Tag};
use super::stray;
use crate::error::{Error, Result};
pub use fixed::run_fixed;
use hand::Hand;
use plan::Dealer;
pub use plan::Plan;

const REQUEST: Tag = 1;
const CHUNK: Tag = 2;
const RESULT: Tag = 3;

/// Longest pause of a thread that only its own pool can wake.
const LONG_PAUSE: Duration = Duration::from_millis(20);

/// Renders one unit into an empty buffer. Called in the pool, by several threads at once.
pub type Render<'a> = dyn Fn(u32, &mut Vec<u8>) + Sync + 'a;

/// Takes the result of one unit, on rank 0 and the thread that called [`run`]. An error ends the deal.
pub type Deposit<'a> = dyn FnMut(u32, &[u8]) -> Result<()> + 'a;

/// How far the whole job is, as rank 0 sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Units deposited, of all `units`.
    pub done: usize,
    pub units: usize,
    /// The same by estimated cost, `0..=1`: the better guess at the time left.
    pub cost_done: f64,
}

/// What one rank did in a deal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DealStats {
    pub threads: usize,
    /// Units computed here.
    pub units: usize,
    /// Chunks that were asked for; rank 0 serves itself without.
    pub chunks: usize,
    /// Time spent in `render`, summed over threads.
    pub busy: Duration,
    /// From the call to the last own result, of which every thread could have been busy all along.
    pub elapsed: Duration,
}

/// Collective: computes every unit of rank 0's plan exactly once, on all ranks, and deposits each on rank 0.
///
/// `plan` is rank 0's; other ranks give `None`. `deposit` and `tick` are called on rank 0 only, by the calling thread;
/// `tick` at least every 20 ms or so, and after each batch of deposits. All ranks return together.
///
/// Errors: those of `deposit`, and messages that no rank of this build would send. End the job by either.
///
/// # Panics
/// With the panic of a `render`; and when called from a thread of `pool`, which would wait for itself.
pub fn run(
    comm: &dyn Comm,
    pool: &ThreadPool,
    plan: Option<&Plan>,
    render: &Render,
    deposit: &mut Deposit,
    tick: &mut dyn FnMut(Progress),
) -> Result<DealStats> {
    assert!(pool.current_thread_index().is_none(), "a deal must be called from outside its pool");
    let start = Instant::now();
    let threads = pool.current_num_threads();
    let cancelled = hand::Cancelled::default();
    let stats = pool.in_place_scope_fifo(|scope| {
        let mut hand = Hand::new(comm, scope, threads, render, &cancelled);
        let chunks = match comm.rank() {
            0 => lead(comm, &mut hand, plan.unwrap_or(&Plan::default()), deposit, tick).map(|()| 0),
            _ => follow(comm, &mut hand),
        }?;
        let elapsed = start.elapsed();
        Ok::<_, Error>(DealStats { threads, units: hand.units(), chunks, busy: hand.busy(), elapsed })
    })?;
    comm.flush();
    comm.barrier();
    Ok(stats)
}

/// Rank 0: answers requests, takes results in, keeps its own pool busy, until all is deposited and all are told.
fn lead(
    comm: &dyn Comm,
    hand: &mut Hand,
    plan: &Plan,
    deposit: &mut Deposit,
    tick: &mut dyn FnMut(Progress),
) -> Result<()> {
    let mut dealer = Dealer::new(plan, comm.size(), hand.threads());
    let mut to_tell = comm.size() - 1;
    loop {
        let lack = hand.lack(Duration::ZERO);
        if lack > 0 {
            hand.add(dealer.deal_own(hand.threads(), lack)?);
        }
        let mut idle = true;
        while let Some(message) = comm.try_receive() {
            idle = false;
            match message.tag {
                REQUEST => {
                    let units = answer(comm, &mut dealer, &message)?;
                    to_tell -= usize::from(units == 0);
                }
                RESULT => {
                    let (unit, bytes) = split_result(&message)?;
                    dealer.take_back(unit, message.from)?;
                    deposit(unit, bytes)?;
                }
                _ => return Err(stray(&message)),
            }
            comm.recycle(message.bytes);
        }
        while let Some((unit, bytes)) = hand.try_finished() {
            idle = false;
            dealer.take_back(unit, 0)?;
            deposit(unit, &bytes)?;
            comm.recycle(bytes);
        }
        comm.progress();
        tick(dealer.progress());
        if to_tell == 0 && dealer.all_back() {
            return Ok(());
        }
        if idle {
            let quiet = to_tell == 0 && dealer.only_own_out();
            hand.wait(if quiet { LONG_PAUSE } else { hand.poll_pause() });
        }
    }
}

/// A worker rank: asks ahead, keeps its pool busy, sends results home, until there is no more; the chunks it got.
fn follow(comm: &dyn Comm, hand: &mut Hand) -> Result<usize> {
    let mut asked = None::<Instant>;
    let mut round_trip = Duration::ZERO;
    let mut more = true;
    let mut chunks = 0;
    loop {
        let lack = hand.lack(round_trip);
        if more && asked.is_none() && lack > 0 {
            ask(comm, hand.threads(), lack);
            asked = Some(Instant::now());
        }
        let mut idle = true;
        while let Some(message) = comm.try_receive() {
            idle = false;
            let (CHUNK, Some(when)) = (message.tag, asked.take()) else { return Err(stray(&message)) };
            // A slow answer counts at once, fast ones only in the long run.
            round_trip = when.elapsed().max((round_trip * 7 + when.elapsed()) / 8);
            more = !message.bytes.is_empty();
            chunks += usize::from(more);
            hand.add(read_units(&message)?);
            comm.recycle(message.bytes);
        }
        while let Some((unit, mut bytes)) = hand.try_finished() {
            idle = false;
            bytes.extend_from_slice(&unit.to_le_bytes());
            comm.send(0, RESULT, bytes);
        }
        let sending = comm.progress();
        if !more && hand.is_empty() {
            return Ok(chunks);
        }
        if idle {
            // With nothing on the wire only the pool can bring news.
            let quiet = asked.is_none() && sending == 0;
            hand.wait(if quiet { LONG_PAUSE } else { hand.poll_pause() });
        }
    }
}

fn ask(comm: &dyn Comm, threads: usize, lack: usize) {
    let mut bytes = comm.take_buffer();
    bytes.extend_from_slice(&(threads as u32).to_le_bytes());
    bytes.extend_from_slice(&(lack as u32).to_le_bytes());
    comm.send(0, REQUEST, bytes);
}

/// Answers a request; the number of units dealt.
fn answer(comm: &dyn Comm, dealer: &mut Dealer, request: &Message) -> Result<usize> {
    let [threads, lack] = read_units(request)?[..] else { return Err(stray(request)) };
    let units = dealer.deal(request.from, threads.max(1) as usize, lack as usize)?;
    let mut bytes = comm.take_buffer();
    units.iter().for_each(|unit| bytes.extend_from_slice(&unit.to_le_bytes()));
    comm.send(request.from, CHUNK, bytes);
    Ok(units.len())
}

fn read_units(message: &Message) -> Result<Vec<u32>> {
    let (units, rest) = message.bytes.as_chunks();
    if rest.is_empty() {
        Ok(units.iter().map(|&unit| u32::from_le_bytes(unit)).collect())
    } else {
        Err(stray(message))
    }
}

fn split_result(message: &Message) -> Result<(u32, &[u8])> {
    let (bytes, unit) = message.bytes.split_last_chunk().ok_or_else(|| stray(message))?;
    Ok((u32::from_le_bytes(*unit), bytes))
}
