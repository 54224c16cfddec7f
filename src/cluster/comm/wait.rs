//! Waiting without burning a core. A blocking probe spins; a poll and a sleep in turn cost a few percent.

use std::time::Duration;

/// Pauses between polls: a few turns of yielding, then sleeps from 50 µs that grow with the time waited, about a
/// tenth of it, up to 2 ms. So a short wait ends at once, and a long one costs next to nothing.
#[derive(Clone, Debug, Default)]
pub struct Backoff {
    polls: u32,
    sleep: Option<Duration>,
}

impl Backoff {
    const YIELDS: u32 = 16;
    const SHORTEST: Duration = Duration::from_micros(50);
    const LONGEST: Duration = Duration::from_millis(2);

    /// Waits a little longer than the last time.
    pub fn wait(&mut self) {
        match self.next_sleep() {
            Some(sleep) => std::thread::sleep(sleep),
            None => std::thread::yield_now(),
        }
    }

    fn next_sleep(&mut self) -> Option<Duration> {
        if self.polls < Self::YIELDS {
            self.polls += 1;
        } else {
            self.sleep =
                Some(self.sleep.map_or(Self::SHORTEST, |sleep| (sleep + sleep / 8).min(Self::LONGEST)));
        }
        self.sleep
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_grow_with_the_time_waited_up_to_a_limit() {
        let mut backoff = Backoff::default();
        let mut waited = Duration::ZERO;
        for poll in 0..100 {
            let sleep = backoff.next_sleep();
            assert_eq!(sleep.is_none(), poll < Backoff::YIELDS);
            let sleep = sleep.unwrap_or_default();
            assert!(sleep <= Backoff::SHORTEST + waited / 8 && sleep <= Backoff::LONGEST);
            waited += sleep;
        }
        assert_eq!(backoff.next_sleep(), Some(Backoff::LONGEST));
    }
}
