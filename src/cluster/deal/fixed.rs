//! The other way of dealing: every rank knows its units from the start, and says nothing until it has done them all.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayon::ThreadPool;
use rayon::prelude::*;

use super::{DealStats, Deposit, Progress, Render};
use crate::cluster::Comm;
use crate::error::{Error, Result};

/// Collective: computes this rank's `units`, each in an order of the pool's own, then deposits all ranks' on rank 0.
///
/// `tick` is called on rank 0 only, before and after its own units. All ranks return together.
///
/// # Errors
/// Those of `deposit`, and results that no rank of this build would send. End the job by either.
pub fn run_fixed(
    comm: &dyn Comm,
    pool: &ThreadPool,
    units: &[u32],
    render: &Render,
    deposit: &mut Deposit,
    tick: &mut dyn FnMut(Progress),
) -> Result<DealStats> {
    let start = Instant::now();
    let (busy, done) = (AtomicU64::new(0), AtomicUsize::new(0));
    let results: Vec<Vec<u8>> = pool.install(|| {
        units
            .par_iter()
            .with_max_len(1)
            .map(|&unit| {
                let (begin, mut bytes) = (Instant::now(), Vec::new());
                render(unit, &mut bytes);
                busy.fetch_add(begin.elapsed().as_nanos() as u64, Ordering::Relaxed);
                done.fetch_add(1, Ordering::Relaxed);
                bytes
            })
            .collect()
    });
    let elapsed = start.elapsed();

    let mut parcel = Vec::new();
    for (unit, bytes) in units.iter().zip(results) {
        parcel.extend_from_slice(&unit.to_le_bytes());
        parcel.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        parcel.extend_from_slice(&bytes);
    }
    let mut outcome = Ok(());
    comm.gather_each(&parcel, &mut |from, parcel| {
        if outcome.is_ok() {
            outcome = unpack(from, parcel, deposit);
        }
    });
    outcome?;
    if comm.rank() == 0 {
        let all = done.into_inner();
        tick(Progress { done: all, units: all, cost_done: 1.0 });
    }
    let busy = Duration::from_nanos(busy.into_inner());
    Ok(DealStats { threads: pool.current_num_threads(), units: units.len(), chunks: 0, busy, elapsed })
}

/// Deposits the results of one rank.
fn unpack(from: usize, mut parcel: &[u8], deposit: &mut Deposit) -> Result<()> {
    while !parcel.is_empty() {
        let broken = || {
            Error::launch(
                format!("rank {from} sent results that break off"),
                "run the same build of heliostat on all nodes",
            )
        };
        let (unit, rest) = parcel.split_first_chunk().ok_or_else(broken)?;
        let (length, rest) = rest.split_first_chunk().ok_or_else(broken)?;
        let (bytes, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(broken)?;
        deposit(u32::from_le_bytes(*unit), bytes)?;
        parcel = rest;
    }
    Ok(())
}
