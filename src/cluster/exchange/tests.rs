//! The protocol under every kind of delay and with hardly any memory: ranks as threads, thousands of seeds, a time limit.

use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::{Pod, Zeroable};
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::*;
use crate::cluster::comm::memory::{self, MemoryComm};
use crate::cluster::comm::{Comm, Solo};
use crate::cluster::deal::tests::{mix, within};

/// A record that goes from rank to rank and breaks into others, all by its name alone.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct Wanderer {
    name: u64,
    /// Ranks that it still visits.
    left: u32,
    /// Generations that still come of it.
    generations: u32,
    at: u32,
    _pad: u32,
}

impl Wanderer {
    fn new(name: u64, generations: u32, seed: u64, ranks: usize) -> Self {
        let left = 1 + (mix(seed, name) % 5) as u32;
        Wanderer { name, left, generations, at: (mix(seed, name ^ 77) % ranks as u64) as u32, _pad: 0 }
    }

    fn children(&self, seed: u64, ranks: usize) -> Vec<Wanderer> {
        let count = if self.generations == 0 { 0 } else { mix(seed, self.name ^ 5) % 4 };
        (0..count).map(|k| Wanderer::new(mix(self.name, k), self.generations - 1, seed, ranks)).collect()
    }
}

struct Walk<'a> {
    rank: usize,
    ranks: usize,
    seed: u64,
    /// Sums over all visits of all ranks: their number, and of a hash of each.
    visits: &'a [AtomicU64; 2],
}

impl Walk<'_> {
    fn first(&self, unit: u64, owner: usize) -> Vec<Wanderer> {
        let count = mix(self.seed, unit ^ (owner as u64) << 32) % 6;
        (0..count)
            .map(|k| Wanderer::new(mix(unit, k ^ (owner as u64) << 20), 3, self.seed, self.ranks))
            .collect()
    }

    fn visit(&self, record: &Wanderer) -> Vec<Wanderer> {
        let hash = mix(record.name, u64::from(record.left)) >> 24;
        self.visits[0].fetch_add(1, Ordering::Relaxed);
        self.visits[1].fetch_add(hash, Ordering::Relaxed);
        match record.left {
            1 => record.children(self.seed, self.ranks),
            left => {
                let at = (mix(self.seed ^ record.name, u64::from(left)) % self.ranks as u64) as u32;
                vec![Wanderer { left: left - 1, at, ..*record }]
            }
        }
    }
}

impl Station<Wanderer> for Walk<'_> {
    fn prepare(&mut self, wave: &[Wanderer]) {
        assert!(wave.iter().all(|record| record.at as usize == self.rank), "a record at another's");
    }

    fn begin(&self, unit: u64, out: &mut Outbox<Wanderer>) {
        self.first(unit, self.rank).into_iter().for_each(|record| out.push(record.at as usize, record));
    }

    fn work(&self, wave: &[Wanderer], range: Range<usize>, out: &mut Outbox<Wanderer>) {
        for record in &wave[range] {
            for next in self.visit(record) {
                out.push(next.at as usize, next);
            }
        }
    }
}

fn pools(threads: &[usize]) -> Vec<ThreadPool> {
    threads.iter().map(|&threads| ThreadPoolBuilder::new().num_threads(threads).build().unwrap()).collect()
}

/// Exchanges over a group; the sums of visits and every rank's statistics.
fn exchange(
    group: Vec<MemoryComm>,
    pools: &[ThreadPool],
    seed: u64,
    units: &[u64],
    limits: &Limits,
) -> ([u64; 2], Vec<ExchangeStats>) {
    let visits = [AtomicU64::new(0), AtomicU64::new(0)];
    let (visits_ref, ranks) = (&visits, group.len());
    let stats = std::thread::scope(|scope| {
        let ranks: Vec<_> = group
            .into_iter()
            .zip(pools.iter().zip(units))
            .map(|(comm, (pool, &units))| {
                scope.spawn(move || {
                    let mut walk = Walk { rank: comm.rank(), ranks, seed, visits: visits_ref };
                    // Twice, so that what strays out of the first spoils the second.
                    run(&comm, pool, limits, units, &mut walk, &mut |_| {}).unwrap();
                    let stats = run(&comm, pool, limits, units, &mut walk, &mut |_| {}).unwrap();
                    assert_eq!(comm.try_receive(), None, "a message strayed out of its exchange");
                    stats
                })
            })
            .collect();
        ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
    });
    (visits.map(|sum| sum.into_inner() / 2), stats)
}

/// What all visits must sum to, found without any exchange.
fn expected(seed: u64, units: &[u64]) -> [u64; 2] {
    let visits = [AtomicU64::new(0), AtomicU64::new(0)];
    let walk = Walk { rank: 0, ranks: units.len(), seed, visits: &visits };
    let mut left: Vec<Wanderer> = Vec::new();
    for (rank, &units) in units.iter().enumerate() {
        (0..units).for_each(|unit| left.extend(walk.first(unit, rank)));
    }
    while let Some(record) = left.pop() {
        left.extend(walk.visit(&record));
    }
    visits.map(AtomicU64::into_inner)
}

fn tiny() -> Limits {
    Limits { waiting: 4, wave: 3, task: 2, outgoing: 2, batch: 1 }
}

#[test]
fn every_record_makes_its_way_whatever_the_delays() {
    within(Duration::from_secs(200), || {
        let pools = pools(&[1, 2, 1, 3, 1]);
        let mut spilled = 0;
        for seed in 0..2000 {
            let ranks = 1 + mix(seed, 0) as usize % 5;
            let units: Vec<u64> = (0..ranks as u64).map(|rank| mix(seed, rank + 10) % 4).collect();
            let limits = match seed % 3 {
                0 => tiny(),
                1 => Limits { waiting: 9, wave: 5, task: 4, outgoing: 3, batch: 2 },
                _ => Limits::new::<Wanderer>(1 << 20, ranks, 2).unwrap(),
            };
            let group = memory::delayed_group(ranks, seed);
            let (found, stats) = exchange(group, &pools, seed, &units, &limits);
            assert_eq!(found, expected(seed, &units), "seed {seed}, {ranks} ranks");
            assert_eq!(stats.iter().map(|stats| stats.units).collect::<Vec<_>>(), units);
            spilled += stats.iter().map(|stats| stats.spilled).sum::<u64>();
        }
        assert!(spilled > 0, "the files were never needed");
    });
}

#[test]
fn memory_stays_within_its_bound() {
    within(Duration::from_secs(60), || {
        let pools = pools(&[1, 1, 2]);
        let bytes = 64 << 10;
        let limits = Limits::new::<Wanderer>(bytes, 3, 2).unwrap();
        let (found, stats) = exchange(memory::delayed_group(3, 3), &pools, 9, &[2000, 1, 0], &limits);
        assert_eq!(found, expected(9, &[2000, 1, 0]));
        for stats in stats {
            assert!(stats.peak_bytes <= bytes && stats.peak_bytes > 1000, "{stats:?}");
        }
    });
}

#[test]
fn too_little_memory_is_refused_and_the_least_is_enough() {
    for (ranks, threads) in [(1, 1), (2, 1), (3, 8), (100, 2), (4096, 64)] {
        let least = Limits::least::<Wanderer>(ranks, threads);
        assert!(Limits::new::<Wanderer>(least, ranks, threads).is_some(), "{ranks} ranks, {threads} threads");
        assert!(Limits::new::<Wanderer>(least / 4, ranks, threads).is_none());
    }
}

#[test]
fn one_rank_alone_needs_nobody() {
    let visits = [AtomicU64::new(0), AtomicU64::new(0)];
    let mut walk = Walk { rank: 0, ranks: 1, seed: 4, visits: &visits };
    let limits = Limits::new::<Wanderer>(1 << 20, 1, 2).unwrap();
    let mut told = Vec::new();
    let stats =
        run(&Solo::new(), &pools(&[2])[0], &limits, 50, &mut walk, &mut |begun| told.push(begun)).unwrap();
    assert_eq!((stats.units, stats.sent, told.last()), (50, 0, Some(&50)));
    assert_eq!(visits.map(AtomicU64::into_inner), expected(4, &[50]));
}

#[test]
fn a_panic_in_a_task_comes_out() {
    struct Broken;
    impl Station<u64> for Broken {
        fn prepare(&mut self, _: &[u64]) {}
        fn begin(&self, unit: u64, _: &mut Outbox<u64>) {
            assert!(unit != 30, "unit thirty");
        }
        fn work(&self, _: &[u64], _: Range<usize>, _: &mut Outbox<u64>) {}
    }
    let limits = Limits::new::<u64>(1 << 20, 1, 2).unwrap();
    let outcome = catch_unwind(|| run(&Solo::new(), &pools(&[2])[0], &limits, 100, &mut Broken, &mut |_| {}));
    assert_eq!(outcome.unwrap_err().downcast_ref::<&str>(), Some(&"unit thirty"));
}

#[test]
fn messages_that_mean_nothing_are_errors() {
    for (tag, length) in [(RECORDS, 25), (GRANT, 0), (PROBE, 0), (ANSWER, 16), (DONE, 0), (77, 0)] {
        let mut group = memory::group(2);
        group[1].send(0, tag, vec![0; length]);
        let visits = [AtomicU64::new(0), AtomicU64::new(0)];
        let mut walk = Walk { rank: 0, ranks: 2, seed: 0, visits: &visits };
        let outcome = run(&group.remove(0), &pools(&[1])[0], &tiny(), 0, &mut walk, &mut |_| {});
        assert!(outcome.is_err(), "tag {tag}");
    }
}
