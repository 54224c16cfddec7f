//! Bytes of any length from one rank to another, in steps. Must not know what they are.

use super::comm::{Backoff, Comm, Tag};

const PARCEL: Tag = 21;

/// Sends `bytes` to a rank, which must [`receive`] them; returns when they are on their way and `bytes` is no longer needed.
pub fn send(comm: &dyn Comm, to: usize, bytes: &[u8]) {
    comm.send(to, PARCEL, (bytes.len() as u64).to_le_bytes().to_vec());
    for chunk in bytes.chunks(comm.chunk_bytes()) {
        let mut step = comm.take_buffer();
        step.extend_from_slice(chunk);
        comm.send(to, PARCEL, step);
        // One step at a time: what is sent is held twice.
        comm.flush();
    }
    comm.flush();
}

/// Waits, asleep, for what a rank sends. No other messages may be under way to this rank.
///
/// # Panics
/// Another message comes.
pub fn receive(comm: &dyn Comm, from: usize) -> Vec<u8> {
    let next = || {
        let mut backoff = Backoff::default();
        loop {
            if let Some(message) = comm.try_receive() {
                assert!((message.from, message.tag) == (from, PARCEL), "a message strayed into a parcel");
                return message.bytes;
            }
            comm.progress();
            backoff.wait();
        }
    };
    let length = next();
    let length = u64::from_le_bytes(length[..].try_into().expect("the length comes first")) as usize;
    let mut bytes = Vec::with_capacity(length);
    while bytes.len() < length {
        let step = next();
        bytes.extend_from_slice(&step);
        comm.recycle(step);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::comm::memory;

    #[test]
    fn arrives_whole_in_any_steps() {
        for (length, chunk) in [(0, 10), (10, 10), (1001, 10), (5, 1 << 20)] {
            let bytes: Vec<u8> = (0..length).map(|i| (i % 251) as u8).collect();
            let bytes = &bytes;
            let group = memory::delayed_group(3, length as u64);
            std::thread::scope(|scope| {
                for comm in group {
                    scope.spawn(move || {
                        comm.set_chunk_bytes(chunk);
                        match comm.rank() {
                            0 => (1..3).for_each(|to| send(&comm, to, bytes)),
                            _ => assert_eq!(&receive(&comm, 0), bytes),
                        }
                    });
                }
            });
        }
    }
}
