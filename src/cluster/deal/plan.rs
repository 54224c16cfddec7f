//! What is to be done, and who has which part of it. Pure bookkeeping: no messages, no clock.

use std::collections::HashMap;

use super::Progress;
use crate::error::{Error, Result};

/// A chunk is this part of a rank's share of what is left. Larger: more messages, less harm done by a wrong
/// estimate or a slow rank.
const CHUNKS_PER_SHARE: f64 = 8.0;

/// The least cost of a unit, as a part of the mean: nothing is quite free.
const LEAST_COST: f64 = 1e-3;

/// Units in the order they are dealt, with estimated costs in any unit of measure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    units: Vec<u32>,
    costs: Vec<f64>,
    /// Cost of the units from each place on; one longer than `units`.
    cost_from: Vec<f64>,
}

impl Plan {
    /// A plan of distinct units with their estimated costs, dealt largest first; equals stay in order. A cost
    /// that is no positive number counts as almost nothing.
    pub fn new(units: impl IntoIterator<Item = (u32, f32)>) -> Self {
        let known = |cost: f32| if cost.is_finite() && cost > 0.0 { f64::from(cost) } else { 0.0 };
        let mut units: Vec<_> = units.into_iter().map(|(unit, cost)| (unit, known(cost))).collect();
        units.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        let sum: f64 = units.iter().map(|(_, cost)| cost).sum();
        let least = if sum > 0.0 { LEAST_COST * sum / units.len() as f64 } else { 1.0 };
        let (units, costs): (Vec<_>, Vec<_>) =
            units.into_iter().map(|(unit, cost)| (unit, cost.max(least))).unzip();
        let mut cost_from = vec![0.0; units.len() + 1];
        for place in (0..units.len()).rev() {
            cost_from[place] = cost_from[place + 1] + costs[place];
        }
        Plan { units, costs, cost_from }
    }

    pub fn len(&self) -> usize {
        self.units.len()
    }

    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }
}

/// Rank 0's view of a deal: what is left, and what is out with whom.
pub(super) struct Dealer<'a> {
    plan: &'a Plan,
    /// Place in the plan of the next unit to deal.
    next: usize,
    /// Threads of each rank; as many as rank 0's until it has said.
    threads: Vec<usize>,
    total_threads: usize,
    /// The rank that has a unit, and the unit's cost.
    out: HashMap<u32, (usize, f64)>,
    out_elsewhere: usize,
    done: usize,
    cost_done: f64,
}

impl<'a> Dealer<'a> {
    pub fn new(plan: &'a Plan, ranks: usize, threads: usize) -> Self {
        Dealer {
            plan,
            next: 0,
            threads: vec![threads; ranks],
            total_threads: ranks * threads,
            out: HashMap::new(),
            out_elsewhere: 0,
            done: 0,
            cost_done: 0.0,
        }
    }

    /// The next units for a rank that asks over the network: at least one while any are left, about the `lack` it
    /// names, more where a share of the cost that is left allows it.
    pub fn deal(&mut self, rank: usize, threads: usize, lack: usize) -> Result<&'a [u32]> {
        self.total_threads = self.total_threads - self.threads[rank] + threads;
        self.threads[rank] = threads;
        let count = self.fair(threads, lack).max(self.guided(threads));
        self.hand_out(rank, count)
    }

    /// The next units for rank 0 itself, which asks whenever it likes and so needs no chunks.
    pub fn deal_own(&mut self, threads: usize, lack: usize) -> Result<&'a [u32]> {
        self.hand_out(0, self.fair(threads, lack))
    }

    /// No more than lacks, and no more than this rank's part of the units that are left.
    fn fair(&self, threads: usize, lack: usize) -> usize {
        let left = self.plan.len() - self.next;
        let part = (left * threads).div_ceil(self.total_threads);
        lack.min(part).max(1).min(left)
    }

    /// As many units as make up a part of this rank's share of the cost that is left.
    fn guided(&self, threads: usize) -> usize {
        let cost_from = &self.plan.cost_from[self.next..];
        let share = threads as f64 / self.total_threads as f64;
        let cost_after = cost_from[0] * (1.0 - share / CHUNKS_PER_SHARE);
        cost_from.partition_point(|&cost| cost >= cost_after).saturating_sub(1)
    }

    fn hand_out(&mut self, rank: usize, count: usize) -> Result<&'a [u32]> {
        let places = self.next..self.next + count;
        self.next = places.end;
        for place in places.clone() {
            let unit = self.plan.units[place];
            if self.out.insert(unit, (rank, self.plan.costs[place])).is_some() {
                return Err(Error::launch(format!("unit {unit} is planned twice"), "plan each unit once"));
            }
        }
        self.out_elsewhere += if rank == 0 { 0 } else { count };
        Ok(&self.plan.units[places])
    }

    /// Notes that `rank` has returned `unit`.
    ///
    /// Errors: a unit which that rank didn't have.
    pub fn take_back(&mut self, unit: u32, rank: usize) -> Result<()> {
        match self.out.remove(&unit) {
            Some((holder, cost)) if holder == rank => {
                self.done += 1;
                self.cost_done += cost;
                self.out_elsewhere -= usize::from(rank > 0);
                Ok(())
            }
            _ => Err(Error::launch(
                format!("rank {rank} returned unit {unit}, which it didn't have"),
                "run the same build of heliostat on all nodes",
            )),
        }
    }

    /// Whether every unit was dealt and has come back.
    pub fn all_back(&self) -> bool {
        self.done == self.plan.len()
    }

    /// Whether no other rank has a unit.
    pub fn only_own_out(&self) -> bool {
        self.out_elsewhere == 0
    }

    pub fn progress(&self) -> Progress {
        let cost = self.plan.cost_from.first().copied().unwrap_or(0.0);
        let cost_done = if self.all_back() { 1.0 } else { (self.cost_done / cost).min(1.0) };
        Progress { done: self.done, units: self.plan.len(), cost_done }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn largest_first_and_equals_in_order() {
        let plan = Plan::new([(7, 1.0), (3, 4.0), (9, f32::NAN), (1, 4.0), (8, f32::INFINITY), (2, -1.0)]);
        assert_eq!(plan.units, [3, 1, 7, 9, 8, 2]);
        assert!(plan.costs.iter().all(|&cost| cost > 0.0));
    }

    #[test]
    fn chunks_shrink_and_follow_the_threads() {
        let plan = Plan::new((0..1000).map(|unit| (unit, 1.0)));
        let mut dealer = Dealer::new(&plan, 2, 2);
        let first = dealer.deal(1, 2, 1).unwrap().len();
        assert_eq!(first, 62, "an eighth of half of 1000");
        let second = dealer.deal(1, 6, 1).unwrap().len();
        assert_eq!(second, 87, "an eighth of three quarters of 938");
        let mut last = second;
        while !dealer.deal_own(2, 1).unwrap().is_empty() {
            let chunk = dealer.deal(1, 6, 1).unwrap().len();
            assert!(chunk <= last);
            last = chunk;
        }
        assert!(last <= 1);
    }

    #[test]
    fn one_hot_unit_is_dealt_alone() {
        let plan = Plan::new([(0, 1000.0)].into_iter().chain((1..100).map(|unit| (unit, 1.0))));
        assert_eq!(Dealer::new(&plan, 2, 1).deal(1, 1, 1).unwrap(), [0]);
    }

    #[test]
    fn units_without_cost_are_shared_too() {
        let plan = Plan::new((0..100).map(|unit| (unit, if unit < 10 { 1.0 } else { 0.0 })));
        let mut dealer = Dealer::new(&plan, 4, 1);
        (0..10).for_each(|_| assert_eq!(dealer.deal_own(1, 1).unwrap().len(), 1));
        assert!(dealer.deal(1, 1, 1).unwrap().len() <= 3);
    }

    #[test]
    fn the_last_units_are_not_hoarded() {
        let plan = Plan::new((0..8).map(|unit| (unit, 1.0)));
        let mut dealer = Dealer::new(&plan, 4, 4);
        assert_eq!(dealer.deal(1, 4, 8).unwrap().len(), 2);
    }

    #[test]
    fn strange_returns_are_errors() {
        let plan = Plan::new([(5, 1.0), (6, 1.0)]);
        let mut dealer = Dealer::new(&plan, 2, 1);
        assert_eq!(dealer.deal(1, 1, 1).unwrap(), [5]);
        assert!(dealer.take_back(6, 1).is_err(), "not dealt yet");
        assert!(dealer.take_back(5, 1).is_ok());
        assert!(dealer.take_back(5, 1).is_err(), "twice");
        assert!(Dealer::new(&Plan::new([(5, 1.0), (5, 1.0)]), 1, 1).deal_own(1, 2).is_err());
    }

    proptest! {
        #[test]
        fn every_unit_is_dealt_once_whoever_asks(
            costs in proptest::collection::vec(any::<f32>(), 0..300),
            asks in proptest::collection::vec((0usize..5, 1usize..9, 0usize..40), 1..50),
        ) {
            let plan = Plan::new(costs.iter().enumerate().map(|(unit, &cost)| (unit as u32, cost)));
            let mut dealer = Dealer::new(&plan, 5, 2);
            let mut dealt = Vec::new();
            for &(rank, threads, lack) in asks.iter().cycle() {
                let left = dealt.len() < plan.len();
                let units =
                    if rank == 0 { dealer.deal_own(2, lack) } else { dealer.deal(rank, threads, lack) }.unwrap();
                prop_assert_eq!(!units.is_empty(), left);
                for &unit in units {
                    dealer.take_back(unit, rank).unwrap();
                    dealt.push(unit);
                }
                if !left {
                    break;
                }
            }
            prop_assert!(dealer.all_back() && dealer.only_own_out());
            prop_assert_eq!(dealer.progress().cost_done, 1.0);
            dealt.sort();
            prop_assert!(dealt.iter().copied().eq(0..costs.len() as u32));
        }
    }
}
