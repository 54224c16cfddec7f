//! Ranks working together: messages, start and end of a job, sharing of what rank 0 knows, dealing of work.
//!
//! Owns everything that depends on there being several processes. Must not know scenes, rays or images: units
//! of work are numbers, results are bytes.

pub mod comm;
pub mod deal;
mod end;
pub mod exchange;
mod launcher;
pub mod parcel;
pub mod share;
pub mod threads;

use crate::error::{Error, Result};

pub use crate::wire;
pub use comm::{Comm, Message, Solo, Tag};
pub use end::{fail, finish, internal_error_hook};

/// Joins the job that the launcher began, or stands alone where there is none.
///
/// MPI is initialised only under a launcher of more than one process: without one it costs half a second for
/// nothing. The hook that ends the job on a panic is in place when this returns.
///
/// Errors: a launcher that doesn't fit this build, so that each process would do the whole work alone.
/// Hand them to [`fail`], which lets one process speak for all.
pub fn start() -> Result<Box<dyn Comm>> {
    let launch = launcher::detect(|name| std::env::var(name).ok());
    end::speak_for_launch(launch.as_ref());
    internal_error_hook();
    let comm: Box<dyn Comm> = match launch {
        Some(launch) if launch.size != Some(1) => join(&launch)?,
        _ => Box::new(Solo::new()),
    };
    end::speak_as(comm.rank(), comm.size());
    Ok(comm)
}

/// Whether a launcher such as mpirun started this process, be it alone: then its standard streams are the launcher's,
/// and don't show where they end. OpenMPI's gives rank 0 a pseudo-terminal for standard output.
pub fn is_launched() -> bool {
    launcher::detect(|name| std::env::var(name).ok()).is_some()
}

#[cfg(feature = "mpi")]
fn join(launch: &launcher::Launch) -> Result<Box<dyn Comm>> {
    let comm = comm::mpi::MpiComm::start()?;
    launch.check_world_size(comm.size())?;
    Ok(Box::new(comm))
}

#[cfg(not(feature = "mpi"))]
fn join(launch: &launcher::Launch) -> Result<Box<dyn Comm>> {
    Err(launch.refused_without_mpi())
}

/// What a message that no rank of this build would send is.
fn stray(message: &Message) -> Error {
    Error::launch(
        format!(
            "rank {} sent a message of kind {} and {} bytes, which means nothing here",
            message.from,
            message.tag,
            message.bytes.len()
        ),
        "run the same build of heliostat on all nodes",
    )
}

/// The whole life of a process in a job: starts, does `job`, ends; the exit code tells how.
pub fn run(job: impl FnOnce(&dyn Comm) -> Result<()>) -> std::process::ExitCode {
    match start() {
        Ok(comm) => {
            let outcome = job(&*comm);
            finish(comm, outcome)
        }
        Err(error) => fail(&error),
    }
}
