//! How a job ends: well, by an error that all ranks know, by an error or a panic of one rank.
//!
//! A rank that merely returns leaves the others waiting for it for ever. So whatever one rank alone knows of
//! ends the whole job from here.

use std::io::Write;
use std::panic::PanicHookInfo;
use std::process::ExitCode;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use super::comm::{self, Comm};
use super::launcher::Launch;
use crate::error::{Error, Result};

/// Exit code of a panic, as Rust itself has it.
const EXIT_PANIC: i32 = 101;

static RANK: AtomicUsize = AtomicUsize::new(0);
static SIZE: AtomicUsize = AtomicUsize::new(1);
/// Other processes of this launch exist, cannot be talked to, and one of them speaks for all.
static MUTE: AtomicBool = AtomicBool::new(false);
/// Someone is ending the job already; a second voice would only add noise.
static ENDING: AtomicBool = AtomicBool::new(false);

pub(super) fn speak_for_launch(launch: Option<&Launch>) {
    MUTE.store(launch.is_some_and(|launch| !launch.speaks()), Ordering::Relaxed);
}

pub(super) fn speak_as(rank: usize, size: usize) {
    RANK.store(rank, Ordering::Relaxed);
    SIZE.store(size, Ordering::Relaxed);
    MUTE.store(false, Ordering::Relaxed);
}

/// Puts the hook in place by which a panic on any thread is one readable line, and under MPI the end of the job.
///
/// Without MPI the panic unwinds on as usual. With `RUST_BACKTRACE` set, the default report follows the line.
pub fn internal_error_hook() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        let default_hook = std::panic::take_hook();
        let with_backtrace = std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0");
        std::panic::set_hook(Box::new(move |info| {
            if comm::is_running() {
                end_once();
            }
            say(&panic_line(info), prefix());
            if with_backtrace {
                default_hook(info);
            }
            comm::abort(EXIT_PANIC);
        }));
    });
}

fn panic_line(info: &PanicHookInfo) -> String {
    let payload = info.payload();
    let text =
        payload.downcast_ref::<&str>().copied().or(payload.downcast_ref::<String>().map(String::as_str));
    let what = text.unwrap_or("a panic without a text");
    let place = info.location().map_or(String::new(), |place| format!(" ({place})"));
    format!("internal error: {what}{place}; please report it with the command that led to it")
}

/// Ends the whole job because of what this rank alone knows: one line, then every rank goes, with the error's
/// exit code. Never returns, and never waits for anyone.
pub fn fail(error: &Error) -> ! {
    end_once();
    if MUTE.load(Ordering::Relaxed) {
        // Launchers kill the others when the first process ends, so the one that speaks must come before.
        std::thread::sleep(Duration::from_millis(300));
    } else {
        // What all ranks were told is no single rank's own.
        let shared = matches!(error, Error::Remote { .. });
        say(&error.to_string(), if shared { String::new() } else { prefix() });
    }
    comm::abort(error.exit_code());
    std::process::exit(error.exit_code())
}

/// Ends this rank's part of the job with what came of it.
///
/// After `Ok` all ranks wait for each other, asleep, and leave in good order. An error ends the job by [`fail`]: one that
/// every rank got from [`share`](super::share) on rank 0 alone, which says it once, any other on the rank that has it.
/// (Leaving in good order with an exit code makes OpenMPI's launcher wait for one or two seconds more.)
pub fn finish(comm: Box<dyn Comm>, outcome: Result<()>) -> ExitCode {
    match outcome {
        Err(error) if comm.rank() == 0 || !matches!(error, Error::Remote { .. }) => fail(&error),
        _ => {}
    }
    comm.flush();
    // Finalising waits too, but burns a core doing so, while rank 0 may be writing a large image or an error.
    comm.barrier();
    drop(comm);
    ExitCode::SUCCESS
}

/// Lets the first caller through; the others wait for the end that it brings.
fn end_once() {
    if ENDING.swap(true, Ordering::SeqCst) {
        loop {
            std::thread::sleep(Duration::from_secs(1));
        }
    }
}

fn prefix() -> String {
    match SIZE.load(Ordering::Relaxed) {
        1 => String::new(),
        _ => format!("[rank {}] ", RANK.load(Ordering::Relaxed)),
    }
}

/// One line to standard error in one write, so that the lines of several ranks don't mix.
fn say(message: &str, prefix: String) {
    let line = format!("{prefix}heliostat: {message}\n");
    // Nobody is left to be told when standard error is closed.
    let _ = std::io::stderr().write_all(line.as_bytes());
}
