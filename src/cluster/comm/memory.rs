//! Ranks as threads of one process, for tests of protocols: every kind of delay, on demand and repeatable.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use super::{Backoff, Buffers, Comm, DEFAULT_CHUNK_BYTES, MAX_CHUNK_BYTES, Message, Tag};

/// What all ranks of a group share.
struct Fabric {
    /// Per receiver: messages in the order they were sent, each with the polls it still hides from.
    inboxes: Vec<Mutex<Vec<(u32, Message)>>>,
    /// Per receiver and sender: steps of collective calls.
    steps: Vec<Vec<Mutex<VecDeque<Vec<u8>>>>>,
    /// A rank panicked; whoever waits for it would wait for ever.
    broken: AtomicBool,
}

/// One rank of a group; give each to its own thread.
pub struct MemoryComm {
    rank: usize,
    fabric: Arc<Fabric>,
    /// Random delays and reordering between senders and tags, when seeded.
    random: Option<Cell<u64>>,
    buffers: RefCell<Buffers>,
    bytes_sent: Cell<u64>,
    chunk_bytes: Cell<usize>,
}

/// A group of `size` ranks that deliver at once and in order.
pub fn group(size: usize) -> Vec<MemoryComm> {
    build(size, None)
}

/// A group that delays messages at random by up to some polls of the receiver, and lets those of different
/// senders and tags overtake each other.
pub fn delayed_group(size: usize, seed: u64) -> Vec<MemoryComm> {
    build(size, Some(seed))
}

fn build(size: usize, seed: Option<u64>) -> Vec<MemoryComm> {
    let fabric = Arc::new(Fabric {
        inboxes: (0..size).map(|_| Mutex::default()).collect(),
        steps: (0..size).map(|_| (0..size).map(|_| Mutex::default()).collect()).collect(),
        broken: AtomicBool::new(false),
    });
    (0..size)
        .map(|rank| MemoryComm {
            rank,
            fabric: fabric.clone(),
            random: seed.map(|seed| Cell::new(seed ^ (rank as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))),
            buffers: RefCell::default(),
            bytes_sent: Cell::new(0),
            chunk_bytes: Cell::new(DEFAULT_CHUNK_BYTES),
        })
        .collect()
}

impl MemoryComm {
    /// A random number below `bound` (SplitMix64), 0 without a seed.
    fn random_below(&self, bound: u32) -> u32 {
        let Some(state) = &self.random else { return 0 };
        state.set(state.get().wrapping_add(0x9e37_79b9_7f4a_7c15));
        let mut z = state.get();
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 33) as u32 % bound
    }

    fn check_unbroken(&self) {
        assert!(!self.fabric.broken.load(Ordering::SeqCst), "another rank of this group panicked");
    }

    fn put_step(&self, to: usize, step: &[u8]) {
        self.bytes_sent.set(self.bytes_sent.get() + step.len() as u64);
        lock(&self.fabric.steps[to][self.rank]).push_back(step.to_vec());
    }

    fn take_step(&self, from: usize) -> Vec<u8> {
        let mut backoff = Backoff::default();
        loop {
            if let Some(step) = lock(&self.fabric.steps[self.rank][from]).pop_front() {
                return step;
            }
            self.check_unbroken();
            backoff.wait();
        }
    }
}

/// A rank that panicked while holding a lock has set `broken`; what the lock guards is whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Drop for MemoryComm {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.fabric.broken.store(true, Ordering::SeqCst);
        }
    }
}

impl Comm for MemoryComm {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.fabric.inboxes.len()
    }

    fn send(&self, to: usize, tag: Tag, bytes: Vec<u8>) {
        self.bytes_sent.set(self.bytes_sent.get() + bytes.len() as u64);
        let hidden_polls = self.random_below(6).saturating_sub(2);
        lock(&self.fabric.inboxes[to]).push((hidden_polls, Message { from: self.rank, tag, bytes }));
    }

    fn try_receive(&self) -> Option<Message> {
        self.check_unbroken();
        let mut inbox = lock(&self.fabric.inboxes[self.rank]);
        let mut lines = BTreeSet::new();
        let mut ready = Vec::new();
        for (place, (hidden_polls, message)) in inbox.iter_mut().enumerate() {
            let heads_its_line = lines.insert((message.from, message.tag));
            if *hidden_polls > 0 {
                *hidden_polls -= 1;
            } else if heads_its_line {
                ready.push(place);
            }
        }
        if ready.is_empty() {
            return None;
        }
        let place = ready[self.random_below(ready.len() as u32) as usize];
        Some(inbox.remove(place).1)
    }

    fn progress(&self) -> usize {
        0
    }

    fn take_buffer(&self) -> Vec<u8> {
        self.buffers.borrow_mut().take()
    }

    fn recycle(&self, buffer: Vec<u8>) {
        self.buffers.borrow_mut().recycle(buffer);
    }

    fn bytes_sent(&self) -> u64 {
        self.bytes_sent.get()
    }

    fn node_local(&self) -> (usize, usize) {
        (self.rank, self.size())
    }

    fn chunk_bytes(&self) -> usize {
        self.chunk_bytes.get()
    }

    fn set_chunk_bytes(&self, bytes: usize) {
        self.chunk_bytes.set(bytes.clamp(1, MAX_CHUNK_BYTES));
    }

    fn broadcast_chunk(&self, chunk: &mut [u8], _expected: bool) {
        assert!(chunk.len() <= self.chunk_bytes().max(8), "a step longer than the limit");
        if self.rank == 0 {
            (1..self.size()).for_each(|to| self.put_step(to, chunk));
        } else {
            chunk.copy_from_slice(&self.take_step(0));
        }
    }

    fn hand_in_chunk(&self, chunk: &[u8]) {
        self.put_step(0, chunk);
    }

    fn collect_chunk(&self, from: usize, chunk: &mut [u8]) {
        chunk.copy_from_slice(&self.take_step(from));
    }

    fn barrier(&self) {
        self.gather(&[]);
        self.broadcast_chunk(&mut [], false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs `body` on every rank of a group, each in its thread; what they return, in rank order.
    fn on_all<T: Send>(group: Vec<MemoryComm>, body: impl Fn(&MemoryComm) -> T + Sync) -> Vec<T> {
        let body = &body;
        std::thread::scope(|scope| {
            let ranks: Vec<_> = group.into_iter().map(|comm| scope.spawn(move || body(&comm))).collect();
            ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
        })
    }

    #[test]
    fn broadcast_and_gather_cross_many_chunks() {
        for (size, length, chunk) in [(1, 100, 7), (2, 1000, 1), (3, 1000, 64), (5, 0, 3), (4, 64, 64)] {
            let data: Vec<u8> = (0..length).map(|i| (i * 7) as u8).collect();
            let gathered = on_all(group(size), |comm| {
                comm.set_chunk_bytes(chunk);
                let mut bytes = if comm.rank() == 0 { data.clone() } else { vec![9; 3] };
                comm.broadcast(&mut bytes);
                assert_eq!(bytes, data);
                comm.barrier();
                comm.gather(&bytes[..length * comm.rank() / size])
            });
            for (rank, part) in gathered[0].as_ref().unwrap().iter().enumerate() {
                assert_eq!(part, &data[..length * rank / size]);
            }
            assert!(gathered[1..].iter().all(Option::is_none));
        }
    }

    #[test]
    fn delays_keep_the_order_of_one_sender_and_tag() {
        let mut groups_in_order = 0;
        for seed in 0..50 {
            let mut received = on_all(delayed_group(3, seed), |comm| {
                let mut received = Vec::new();
                if comm.rank() > 0 {
                    for i in 0..20 {
                        comm.send(0, (i % 2) as Tag, vec![i]);
                    }
                }
                comm.barrier();
                while comm.rank() == 0 && received.len() < 40 {
                    received.extend(comm.try_receive().map(|m| (m.from, m.tag, m.bytes[0])));
                }
                received
            })
            .swap_remove(0);
            groups_in_order += received.is_sorted_by_key(|&(from, _, i)| (from, i)) as u32;
            received.sort_by_key(|&(from, tag, _)| (from, tag));
            assert!(received.is_sorted(), "seed {seed}: {received:?}");
        }
        assert!(groups_in_order < 50, "no message ever overtook another");
    }

    #[test]
    fn a_lost_rank_wakes_the_others() {
        let mut ranks = group(2);
        let lost = ranks.remove(0);
        assert!(std::thread::spawn(move || panic!("rank {} is lost", { lost }.rank())).join().is_err());
        let waiting = ranks.remove(0);
        assert!(std::thread::spawn(move || waiting.barrier()).join().is_err());
    }
}
