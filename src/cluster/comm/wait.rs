//! Waiting without burning a core. A blocking probe spins; a poll and a sleep in turn cost a few percent.

use std::time::Duration;

/// Pauses between polls: a few turns of yielding, then sleeps that grow from 50 µs to a ceiling.
#[derive(Clone, Debug)]
pub struct Backoff {
    idle_polls: u32,
    ceiling: Duration,
}

impl Backoff {
    const YIELDS: u32 = 16;
    const FIRST_SLEEP: Duration = Duration::from_micros(50);

    /// Sleeps that grow to `ceiling` at most.
    pub fn up_to(ceiling: Duration) -> Self {
        Backoff { idle_polls: 0, ceiling }
    }

    /// Something has come: the next may be close behind.
    pub fn reset(&mut self) {
        self.idle_polls = 0;
    }

    /// Raises or lowers the ceiling.
    pub fn set_ceiling(&mut self, ceiling: Duration) {
        self.ceiling = ceiling;
    }

    /// The length of the next sleep, for those who wait on something better than a clock.
    pub fn next_sleep(&mut self) -> Duration {
        let doublings = self.idle_polls.min(10);
        self.idle_polls = self.idle_polls.saturating_add(1);
        (Self::FIRST_SLEEP * (1 << doublings)).min(self.ceiling)
    }

    /// Yields a few times, then sleeps.
    pub fn wait(&mut self) {
        if self.idle_polls < Self::YIELDS {
            self.idle_polls += 1;
            std::thread::yield_now();
        } else {
            let doublings = (self.idle_polls - Self::YIELDS).min(10);
            self.idle_polls = self.idle_polls.saturating_add(1);
            std::thread::sleep((Self::FIRST_SLEEP * (1 << doublings)).min(self.ceiling));
        }
    }
}

impl Default for Backoff {
    fn default() -> Self {
        Backoff::up_to(Duration::from_micros(500))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_grow_to_the_ceiling_and_start_over() {
        let mut backoff = Backoff::up_to(Duration::from_micros(300));
        let sleeps: Vec<_> = (0..5).map(|_| backoff.next_sleep().as_micros()).collect();
        assert_eq!(sleeps, [50, 100, 200, 300, 300]);
        backoff.reset();
        assert_eq!(backoff.next_sleep().as_micros(), 50);
    }
}
