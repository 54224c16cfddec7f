//! One process alone: nobody to talk to, nothing to wait for.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

use super::{Buffers, Comm, DEFAULT_CHUNK_BYTES, MAX_CHUNK_BYTES, Message, Tag};

/// The only rank of a job without MPI. Messages to itself arrive.
pub struct Solo {
    inbox: RefCell<VecDeque<Message>>,
    buffers: RefCell<Buffers>,
    chunk_bytes: Cell<usize>,
}

impl Solo {
    pub fn new() -> Self {
        Solo {
            inbox: RefCell::default(),
            buffers: RefCell::default(),
            chunk_bytes: Cell::new(DEFAULT_CHUNK_BYTES),
        }
    }
}

impl Default for Solo {
    fn default() -> Self {
        Solo::new()
    }
}

impl Comm for Solo {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn send(&self, to: usize, tag: Tag, bytes: Vec<u8>) {
        assert_eq!(to, 0, "there is one rank only");
        self.inbox.borrow_mut().push_back(Message { from: 0, tag, bytes });
    }

    fn try_receive(&self) -> Option<Message> {
        self.inbox.borrow_mut().pop_front()
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
        0
    }

    fn node_local(&self) -> (usize, usize) {
        (0, 1)
    }

    fn chunk_bytes(&self) -> usize {
        self.chunk_bytes.get()
    }

    fn set_chunk_bytes(&self, bytes: usize) {
        self.chunk_bytes.set(bytes.clamp(1, MAX_CHUNK_BYTES));
    }

    fn broadcast_chunk(&self, _chunk: &mut [u8], _expected: bool) {}

    fn hand_in_chunk(&self, _chunk: &[u8]) {}

    fn collect_chunk(&self, _from: usize, _chunk: &mut [u8]) {}

    fn barrier(&self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_rank_keeps_its_own() {
        let comm = Solo::new();
        let mut bytes = vec![1, 2, 3];
        comm.broadcast(&mut bytes);
        assert_eq!(comm.gather(&bytes), Some(vec![vec![1, 2, 3]]));
        comm.send(0, 7, vec![9]);
        assert_eq!(comm.try_receive(), Some(Message { from: 0, tag: 7, bytes: vec![9] }));
        assert_eq!(comm.try_receive(), None);
    }
}
