//! Ranks over MPI. The only file that names it, by its C interface: what is sent must live until MPI is done
//! with it, which the crate's scoped requests can't say for buffers that outlive a call.
//!
//! MPI is initialised FUNNELED and called from the thread that started it (`MpiComm` holds raw handles, so it
//! can't leave that thread). The one exception is [`abort`]. MPI's errors are fatal by its default: the library
//! ends the job itself, so return codes are not looked at.

use std::cell::{Cell, RefCell};
use std::os::raw::c_int;

use mpi::environment::{Threading, Universe};
use mpi::ffi;

use super::{Backoff, Buffers, Comm, DEFAULT_CHUNK_BYTES, MAX_CHUNK_BYTES, Message, Tag};
use crate::error::{Error, Result};

/// Tag of the steps of `gather`, on their own communicator.
const STEP: c_int = 0;

/// This process as a rank of an MPI job.
pub struct MpiComm {
    rank: usize,
    size: usize,
    /// Messages.
    messages: ffi::MPI_Comm,
    /// Collective calls, which must not meet messages of any tag.
    collective: ffi::MPI_Comm,
    sends: RefCell<Vec<Sending>>,
    buffers: RefCell<Buffers>,
    bytes_sent: Cell<u64>,
    chunk_bytes: Cell<usize>,
    /// Finalises MPI when dropped, after everything above.
    _universe: Universe,
}

/// A send under way, and the bytes that MPI still reads.
struct Sending {
    request: ffi::MPI_Request,
    bytes: Vec<u8>,
}

impl MpiComm {
    /// Initialises MPI and joins all processes of the launch.
    pub fn start() -> Result<Self> {
        let (universe, threading) = mpi::initialize_with_threading(Threading::Funneled).ok_or_else(|| {
            Error::launch("MPI is initialised already in this process", "start the cluster only once")
        })?;
        if threading < Threading::Funneled {
            return Err(Error::launch(
                "this MPI allows no threads beside the one that calls it",
                "use an MPI built with MPI_THREAD_FUNNELED or better",
            ));
        }
        let (mut rank, mut size) = (0, 0);
        // SAFETY: MPI is initialised, and both pointers are to live integers.
        unsafe {
            ffi::MPI_Comm_rank(ffi::RSMPI_COMM_WORLD, &mut rank);
            ffi::MPI_Comm_size(ffi::RSMPI_COMM_WORLD, &mut size);
        }
        Ok(MpiComm {
            rank: rank as usize,
            size: size as usize,
            messages: duplicate_of_world(),
            collective: duplicate_of_world(),
            sends: RefCell::default(),
            buffers: RefCell::default(),
            bytes_sent: Cell::new(0),
            chunk_bytes: Cell::new(DEFAULT_CHUNK_BYTES),
            _universe: universe,
        })
    }

    /// Begins a send that reads `bytes` until its request is done.
    fn begin_send(&self, comm: ffi::MPI_Comm, to: usize, tag: c_int, bytes: &[u8]) -> ffi::MPI_Request {
        assert!(bytes.len() <= MAX_CHUNK_BYTES, "a message of {} bytes must be cut", bytes.len());
        self.bytes_sent.set(self.bytes_sent.get() + bytes.len() as u64);
        // SAFETY: every caller keeps `bytes` alive, unmoved and unchanged until the request is done.
        unsafe {
            let mut request = ffi::RSMPI_REQUEST_NULL;
            let (data, count) = (bytes.as_ptr().cast(), bytes.len() as c_int);
            ffi::MPI_Isend(data, count, ffi::RSMPI_UINT8_T, to as c_int, tag, comm, &mut request);
            request
        }
    }
}

impl Comm for MpiComm {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn send(&self, to: usize, tag: Tag, bytes: Vec<u8>) {
        // The vector moves into `sends`, its heap block stays where MPI reads it.
        let request = self.begin_send(self.messages, to, c_int::from(tag), &bytes);
        self.sends.borrow_mut().push(Sending { request, bytes });
    }

    fn try_receive(&self) -> Option<Message> {
        let (mut found, mut count) = (0, 0);
        // SAFETY: all pointers are to live values of this frame; the status is read only where it was written.
        let (mut message, status) = unsafe {
            let mut message = ffi::RSMPI_MESSAGE_NULL;
            let mut status = std::mem::zeroed::<ffi::MPI_Status>();
            let (any_rank, any_tag) = (ffi::RSMPI_ANY_SOURCE, ffi::RSMPI_ANY_TAG);
            ffi::MPI_Improbe(any_rank, any_tag, self.messages, &mut found, &mut message, &mut status);
            if found == 0 {
                return None;
            }
            ffi::MPI_Get_count(&status, ffi::RSMPI_UINT8_T, &mut count);
            (message, status)
        };
        let mut bytes = self.take_buffer();
        bytes.resize(count as usize, 0);
        // SAFETY: the matched message has exactly `count` bytes, and the buffer as many.
        unsafe {
            let (data, ignored) = (bytes.as_mut_ptr().cast(), ffi::RSMPI_STATUS_IGNORE);
            ffi::MPI_Mrecv(data, count, ffi::RSMPI_UINT8_T, &mut message, ignored);
        }
        Some(Message { from: status.MPI_SOURCE as usize, tag: status.MPI_TAG as Tag, bytes })
    }

    fn progress(&self) -> usize {
        let mut sends = self.sends.borrow_mut();
        let mut buffers = self.buffers.borrow_mut();
        for place in (0..sends.len()).rev() {
            if is_done(&mut sends[place].request) {
                buffers.recycle(sends.swap_remove(place).bytes);
            }
        }
        sends.len()
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
        let (mut rank, mut size) = (0, 0);
        // SAFETY: a collective call on a live communicator; the new one is freed here again.
        unsafe {
            let mut node = ffi::RSMPI_COMM_NULL;
            let (kind, order, info) = (ffi::RSMPI_COMM_TYPE_SHARED, self.rank as c_int, ffi::RSMPI_INFO_NULL);
            ffi::MPI_Comm_split_type(self.collective, kind, order, info, &mut node);
            ffi::MPI_Comm_rank(node, &mut rank);
            ffi::MPI_Comm_size(node, &mut size);
            ffi::MPI_Comm_free(&mut node);
        }
        (rank as usize, size as usize)
    }

    fn chunk_bytes(&self) -> usize {
        self.chunk_bytes.get()
    }

    fn set_chunk_bytes(&self, bytes: usize) {
        self.chunk_bytes.set(bytes.clamp(1, MAX_CHUNK_BYTES));
    }

    fn broadcast_chunk(&self, chunk: &mut [u8], expected: bool) {
        assert!(chunk.len() <= MAX_CHUNK_BYTES, "a step of {} bytes must be cut", chunk.len());
        if self.rank == 0 {
            self.bytes_sent.set(self.bytes_sent.get() + (chunk.len() * (self.size - 1)) as u64);
        }
        let (data, count) = (chunk.as_mut_ptr().cast(), chunk.len() as c_int);
        if expected {
            // SAFETY: `chunk` is borrowed for the whole of this blocking call.
            unsafe { ffi::MPI_Bcast(data, count, ffi::RSMPI_UINT8_T, 0, self.collective) };
            return;
        }
        // The blocking form spins; the others may have long to wait for rank 0.
        // SAFETY: `chunk` is borrowed until `sleep_until_done` returns.
        let request = unsafe {
            let mut request = ffi::RSMPI_REQUEST_NULL;
            ffi::MPI_Ibcast(data, count, ffi::RSMPI_UINT8_T, 0, self.collective, &mut request);
            request
        };
        sleep_until_done(request);
    }

    fn hand_in_chunk(&self, chunk: &[u8]) {
        // `chunk` is borrowed until its request is done.
        sleep_until_done(self.begin_send(self.collective, 0, STEP, chunk));
    }

    fn collect_chunk(&self, from: usize, chunk: &mut [u8]) {
        assert!(chunk.len() <= MAX_CHUNK_BYTES, "a step of {} bytes must be cut", chunk.len());
        // SAFETY: `chunk` is borrowed until `sleep_until_done` returns.
        let request = unsafe {
            let mut request = ffi::RSMPI_REQUEST_NULL;
            let (data, count) = (chunk.as_mut_ptr().cast(), chunk.len() as c_int);
            let kind = ffi::RSMPI_UINT8_T;
            ffi::MPI_Irecv(data, count, kind, from as c_int, STEP, self.collective, &mut request);
            request
        };
        sleep_until_done(request);
    }

    fn barrier(&self) {
        // SAFETY: a collective call on a live communicator.
        let request = unsafe {
            let mut request = ffi::RSMPI_REQUEST_NULL;
            ffi::MPI_Ibarrier(self.collective, &mut request);
            request
        };
        sleep_until_done(request);
    }
}

impl Drop for MpiComm {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // The hook is ending the job; nobody would answer.
            return;
        }
        self.flush();
        // SAFETY: both communicators are live, no request on them is under way, and all ranks come here.
        unsafe {
            ffi::MPI_Comm_free(&mut self.messages);
            ffi::MPI_Comm_free(&mut self.collective);
        }
    }
}

fn duplicate_of_world() -> ffi::MPI_Comm {
    // SAFETY: called by all ranks, in the same order, right after initialisation.
    unsafe {
        let mut comm = ffi::RSMPI_COMM_NULL;
        ffi::MPI_Comm_dup(ffi::RSMPI_COMM_WORLD, &mut comm);
        comm
    }
}

fn is_done(request: &mut ffi::MPI_Request) -> bool {
    let mut done = 0;
    // SAFETY: the request is live, or null once done, which MPI accepts.
    unsafe { ffi::MPI_Test(request, &mut done, ffi::RSMPI_STATUS_IGNORE) };
    done != 0
}

fn sleep_until_done(mut request: ffi::MPI_Request) {
    let mut backoff = Backoff::default();
    while !is_done(&mut request) {
        backoff.wait();
    }
}

/// Whether MPI is initialised and not yet finalised.
pub fn is_running() -> bool {
    mpi::environment::is_initialized() && !mpi::environment::is_finalized()
}

/// Ends all processes of the job, from any thread. Returns only where MPI is not running.
pub fn abort(code: i32) {
    if is_running() {
        // SAFETY: FUNNELED asks for calls from the main thread; both OpenMPI and MPICH end the process and tell
        // the launcher without touching what that thread is doing, and there is nothing left to keep whole.
        unsafe { ffi::MPI_Abort(ffi::RSMPI_COMM_WORLD, code) };
    }
}
