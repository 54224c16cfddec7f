//! The protocol under every kind of delay: ranks as threads, thousands of seeds, a time limit.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::*;
use crate::cluster::comm::Solo;
use crate::cluster::comm::memory::{self, MemoryComm};

fn pool(threads: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

/// A small repeatable random number.
pub fn mix(seed: u64, salt: u64) -> u64 {
    let mut z = (seed << 20).wrapping_add(salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    z ^ (z >> 32)
}

/// What unit `unit` must give: a length and contents of its own.
fn result_of(unit: u32) -> Vec<u8> {
    (0..mix(u64::from(unit), 3) % 50).map(|i| (mix(u64::from(unit), i) >> 9) as u8).collect()
}

/// Deals `units` over a group; checks deposits and totals; the stats in rank order.
fn deal(
    group: Vec<MemoryComm>,
    pools: &[ThreadPool],
    plan: &Plan,
    deals: usize,
    pause: &(dyn Fn(usize, u32) -> Duration + Sync),
) -> Vec<DealStats> {
    let rendered: Vec<AtomicU32> = (0..plan.len()).map(|_| AtomicU32::new(0)).collect();
    let rendered = &rendered;
    let stats: Vec<DealStats> = std::thread::scope(|scope| {
        let ranks: Vec<_> = group
            .into_iter()
            .zip(pools)
            .map(|(comm, pool)| {
                scope.spawn(move || {
                    let rank = comm.rank();
                    let render = |unit: u32, bytes: &mut Vec<u8>| {
                        assert!(bytes.is_empty(), "a used buffer must come empty");
                        rendered[unit as usize].fetch_add(1, Ordering::Relaxed);
                        match pause(rank, unit) {
                            Duration::ZERO => {}
                            pause => std::thread::sleep(pause),
                        }
                        bytes.extend_from_slice(&result_of(unit));
                    };
                    let mut last = DealStats::default();
                    for _ in 0..deals {
                        let mut deposited = vec![false; plan.len()];
                        let mut deposit = |unit: u32, bytes: &[u8]| {
                            assert_eq!(bytes, result_of(unit));
                            assert!(
                                !std::mem::replace(&mut deposited[unit as usize], true),
                                "{unit} came twice"
                            );
                            Ok(())
                        };
                        let mut progress = None;
                        let mut tick = |now| progress = Some(now);
                        let plan = (rank == 0).then_some(plan);
                        last = run(&comm, pool, plan, &render, &mut deposit, &mut tick).unwrap();
                        if rank == 0 {
                            assert!(deposited.iter().all(|&it| it), "a unit is missing");
                            let progress = progress.unwrap();
                            assert_eq!((progress.done, progress.cost_done), (deposited.len(), 1.0));
                        } else {
                            assert!(!deposited.contains(&true) && progress.is_none());
                        }
                    }
                    assert_eq!(comm.try_receive(), None, "a message strayed out of its deal");
                    last
                })
            })
            .collect();
        ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
    });
    assert!(rendered.iter().all(|count| count.load(Ordering::Relaxed) == deals as u32));
    assert_eq!(stats.iter().map(|stats| stats.units).sum::<usize>(), plan.len());
    stats
}

/// Fails if `body` takes longer than `limit`, as a deadlock would.
pub fn within(limit: Duration, body: impl FnOnce() + Send + 'static) {
    let (done, wait) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        body();
        let _ = done.send(());
    });
    match wait.recv_timeout(limit) {
        Err(mpsc::RecvTimeoutError::Timeout) => panic!("not done within {limit:?}"),
        _ => thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
    }
}

#[test]
fn each_unit_comes_home_once_whatever_the_delays() {
    within(Duration::from_secs(120), || {
        let pools: Vec<_> = [1, 2, 1, 3, 1].into_iter().map(pool).collect();
        for seed in 0..2000 {
            let ranks = 1 + mix(seed, 0) as usize % 5;
            let units = mix(seed, 1) as u32 % 60;
            let plan = Plan::new((0..units).map(|unit| (unit, (mix(seed, u64::from(unit)) % 100) as f32)));
            let slow_rank = mix(seed, 2) as usize % 8;
            let pause = |rank: usize, unit: u32| {
                let slow = rank == slow_rank && mix(seed, u64::from(unit)).is_multiple_of(4);
                Duration::from_micros(if slow { 100 } else { 0 })
            };
            deal(memory::delayed_group(ranks, seed), &pools, &plan, 1 + seed as usize % 2, &pause);
        }
    });
}

#[test]
fn no_units_and_fewer_units_than_ranks() {
    within(Duration::from_secs(20), || {
        let pools: Vec<_> = (0..5).map(|_| pool(1)).collect();
        for units in 0..5 {
            let plan = Plan::new((0..units).map(|unit| (unit, 1.0)));
            deal(memory::group(5), &pools, &plan, 3, &|_, _| Duration::ZERO);
        }
    });
}

#[test]
fn a_slow_rank_gets_less() {
    within(Duration::from_secs(20), || {
        let pools: Vec<_> = (0..3).map(|_| pool(1)).collect();
        let plan = Plan::new((0..300).map(|unit| (unit, 1.0)));
        let pause = |rank: usize, _| Duration::from_micros(if rank == 1 { 8000 } else { 1000 });
        let stats = deal(memory::group(3), &pools, &plan, 1, &pause);
        assert!(stats[1].units * 3 < stats[0].units, "{stats:?}");
        assert!(stats[1].units * 3 < stats[2].units, "{stats:?}");
        let ends: Vec<_> = stats.iter().map(|stats| stats.elapsed.as_millis()).collect();
        assert!(ends.iter().max().unwrap() - ends.iter().min().unwrap() < 60, "{stats:?}");
    });
}

#[test]
fn one_process_keeps_its_threads_busy() {
    let plan = Plan::new((0..200).map(|unit| (unit, 1.0)));
    let mut deposits = 0;
    let start = Instant::now();
    let stats = run(
        &Solo::new(),
        &pool(2),
        Some(&plan),
        &|_, _| std::thread::sleep(Duration::from_millis(1)),
        &mut |_, _| {
            deposits += 1;
            Ok(())
        },
        &mut |_| {},
    )
    .unwrap();
    assert_eq!((deposits, stats.units, stats.threads), (200, 200, 2));
    assert!(stats.busy.as_secs_f64() > 1.5 * start.elapsed().as_secs_f64(), "{stats:?}");
}

#[test]
fn a_panic_in_a_unit_comes_out() {
    let plan = Plan::new((0..100).map(|unit| (unit, 1.0)));
    let outcome = std::panic::catch_unwind(|| {
        let render = |unit: u32, _: &mut Vec<u8>| assert!(unit != 50, "unit fifty");
        run(&Solo::new(), &pool(2), Some(&plan), &render, &mut |_, _| Ok(()), &mut |_| {})
    });
    let payload = outcome.unwrap_err();
    assert_eq!(payload.downcast_ref::<&str>(), Some(&"unit fifty"));
}

#[test]
fn an_error_of_a_deposit_ends_the_deal_at_once() {
    let plan = Plan::new((0..1000).map(|unit| (unit, 1.0)));
    let mut deposits = 0;
    let rendered = AtomicU32::new(0);
    let outcome = run(
        &Solo::new(),
        &pool(2),
        Some(&plan),
        &|_, _| {
            rendered.fetch_add(1, Ordering::Relaxed);
        },
        &mut |_, _| {
            deposits += 1;
            if deposits < 10 { Ok(()) } else { Err(Error::launch("the disk is full", "make room")) }
        },
        &mut |_| {},
    );
    assert!(outcome.unwrap_err().to_string().contains("disk is full"));
    assert_eq!(deposits, 10);
    assert!(rendered.into_inner() < 50);
}

#[test]
fn messages_that_mean_nothing_are_errors() {
    for (tag, bytes) in
        [(RESULT, vec![1, 2]), (RESULT, vec![0; 4]), (REQUEST, vec![0; 5]), (CHUNK, vec![]), (77, vec![])]
    {
        let mut group = memory::group(2);
        group[1].send(0, tag, bytes);
        let outcome = run(&group.remove(0), &pool(1), None, &|_, _| {}, &mut |_, _| Ok(()), &mut |_| {});
        assert!(outcome.is_err(), "tag {tag}");
    }
}
