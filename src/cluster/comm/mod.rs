//! Messages between the ranks of a job, and the waiting for them.
//!
//! Owns the one interface that all ranks talk through, and its three forms: MPI (`mpi.rs`, the only file that
//! names it), one process alone (`local.rs`), and ranks as threads of one process for tests (`memory.rs`).
//! Must not know what the bytes mean.

mod local;
pub mod memory;
#[cfg(feature = "mpi")]
pub(super) mod mpi;
mod wait;

pub use local::Solo;
pub use wait::Backoff;

/// What a message is about. Each protocol has its own tags.
pub type Tag = u16;

/// Largest single message and collective step, in bytes: MPI counts in `i32`.
pub const MAX_CHUNK_BYTES: usize = 1 << 30;

/// Step of long transfers unless set otherwise, in bytes.
pub const DEFAULT_CHUNK_BYTES: usize = 1 << 28;

/// A message that has arrived whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    pub from: usize,
    pub tag: Tag,
    pub bytes: Vec<u8>,
}

/// The ranks of a job as one of them sees them. Used from one thread, the one that started it.
///
/// Two kinds of traffic that never meet: messages ([`send`](Comm::send), [`try_receive`](Comm::try_receive)), and
/// collective calls (`broadcast…`, `gather`, `barrier`), which all ranks make in the same order. Whoever waits
/// for a slower rank sleeps. Failures of the network end the job; there is nothing to handle.
pub trait Comm {
    /// This rank, `0..size`.
    fn rank(&self) -> usize;

    /// Number of ranks, at least 1.
    fn size(&self) -> usize;

    /// Sends without waiting; the buffer stays here until the network is done with it, then is used again.
    /// Messages of one tag from one rank to another arrive in order. At most [`MAX_CHUNK_BYTES`].
    fn send(&self, to: usize, tag: Tag, bytes: Vec<u8>);

    /// The next message that has arrived, if any; never waits for one.
    fn try_receive(&self) -> Option<Message>;

    /// Moves own sends along and releases those that are done; the number still under way.
    fn progress(&self) -> usize;

    /// An empty buffer, used before where possible.
    fn take_buffer(&self) -> Vec<u8>;

    /// Gives a buffer back for later use.
    fn recycle(&self, buffer: Vec<u8>);

    /// Payload bytes that this rank has sent; a broadcast counts once per receiving rank.
    fn bytes_sent(&self) -> u64;

    /// This rank's place among the ranks of its node, and their number.
    fn node_local(&self) -> (usize, usize);

    /// Step of long transfers, in bytes.
    fn chunk_bytes(&self) -> usize;

    /// Sets the step of long transfers: `1..=MAX_CHUNK_BYTES`, the same on all ranks.
    fn set_chunk_bytes(&self, bytes: usize);

    /// Collective: fills `chunk` with rank 0's. The same length on all ranks, at most one step.
    /// `expected` says that all ranks are here already or about to be, so that waiting needs no sleep.
    fn broadcast_chunk(&self, chunk: &mut [u8], expected: bool);

    /// Half of a collective: gives rank 0 one step, which it must [`collect_chunk`](Comm::collect_chunk).
    fn hand_in_chunk(&self, chunk: &[u8]);

    /// The other half, on rank 0: takes the next step from rank `from`, of exactly this length.
    fn collect_chunk(&self, from: usize, chunk: &mut [u8]);

    /// Collective: waits, asleep, until all ranks are here.
    fn barrier(&self);

    /// Waits, asleep, until all own sends are done.
    fn flush(&self) {
        let mut backoff = Backoff::default();
        while self.progress() > 0 {
            backoff.wait();
        }
    }

    /// Collective: fills `bytes` with rank 0's, in steps. The same length on all ranks.
    fn broadcast_slice(&self, bytes: &mut [u8]) {
        for chunk in bytes.chunks_mut(self.chunk_bytes()) {
            self.broadcast_chunk(chunk, true);
        }
    }

    /// Collective: replaces `bytes` by rank 0's, of any length.
    fn broadcast(&self, bytes: &mut Vec<u8>) {
        let mut length = (bytes.len() as u64).to_le_bytes();
        // Here the others may wait for seconds, while rank 0 reads files.
        self.broadcast_chunk(&mut length, false);
        bytes.resize(u64::from_le_bytes(length) as usize, 0);
        self.broadcast_slice(bytes);
    }

    /// Collective: rank 0 gets every rank's bytes, of any lengths, in rank order; the others `None`.
    fn gather(&self, bytes: &[u8]) -> Option<Vec<Vec<u8>>> {
        let mut all = Vec::new();
        self.gather_each(bytes, &mut |_, bytes| all.push(bytes.to_vec()));
        (self.rank() == 0).then_some(all)
    }

    /// Collective: on rank 0 `take` gets every rank's bytes, of any lengths, one after the other in rank order.
    fn gather_each(&self, bytes: &[u8], take: &mut dyn FnMut(usize, &[u8])) {
        if self.rank() > 0 {
            self.hand_in_chunk(&(bytes.len() as u64).to_le_bytes());
            bytes.chunks(self.chunk_bytes()).for_each(|chunk| self.hand_in_chunk(chunk));
            return;
        }
        take(0, bytes);
        let mut theirs = Vec::new();
        for from in 1..self.size() {
            let mut length = [0; 8];
            self.collect_chunk(from, &mut length);
            theirs.clear();
            theirs.resize(u64::from_le_bytes(length) as usize, 0);
            theirs.chunks_mut(self.chunk_bytes()).for_each(|chunk| self.collect_chunk(from, chunk));
            take(from, &theirs);
        }
    }
}

/// Whether this process is part of a running MPI job, which a panic must end as a whole.
pub(super) fn is_running() -> bool {
    #[cfg(feature = "mpi")]
    return mpi::is_running();
    #[cfg(not(feature = "mpi"))]
    false
}

/// Ends all processes of a running MPI job with this exit code. Returns where there is none.
pub(super) fn abort(code: i32) {
    #[cfg(feature = "mpi")]
    mpi::abort(code);
    #[cfg(not(feature = "mpi"))]
    let _ = code;
}

/// Buffers waiting to be used again. Few are kept, so that a burst of large messages isn't held for ever.
#[derive(Default)]
struct Buffers(Vec<Vec<u8>>);

impl Buffers {
    const KEPT: usize = 64;

    fn take(&mut self) -> Vec<u8> {
        self.0.pop().unwrap_or_default()
    }

    fn recycle(&mut self, mut buffer: Vec<u8>) {
        if self.0.len() < Self::KEPT && buffer.capacity() > 0 {
            buffer.clear();
            self.0.push(buffer);
        }
    }
}
