//! When each thread of each rank did what, as Chrome trace events (opens in Perfetto). Knows no clock but
//! its own start: who records on several ranks starts them together.
//!
//! Format: Trace Event Format, JSON object form, complete ("X") and metadata ("M") events.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::file;
use crate::error::Result;

/// A stretch of work; travels to rank 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    pub name: String,
    pub rank: u32,
    /// 0 is the main thread, n the n-th worker.
    pub thread: u32,
    /// Microseconds since the recorders' common start.
    pub start_us: u64,
    pub duration_us: u64,
}

/// Writes the events of all ranks as one trace, whole or not at all. The order of `events` doesn't matter.
pub fn write(path: &Path, events: &[Event]) -> Result<()> {
    let mut sorted: Vec<&Event> = events.iter().collect();
    // Viewers nest what starts together by order: the longer is the outer one.
    sorted.sort_by_key(|e| (e.rank, e.thread, e.start_us, std::cmp::Reverse(e.duration_us), &e.name));
    let threads: BTreeSet<(u32, u32)> = events.iter().map(|e| (e.rank, e.thread)).collect();
    let ranks: BTreeSet<u32> = events.iter().map(|e| e.rank).collect();

    let mut records = Vec::new();
    for &rank in &ranks {
        records.push(Record::named("process_name", rank, None, format!("rank {rank}")));
    }
    for &(rank, thread) in &threads {
        let name = if thread == 0 { "main".into() } else { format!("worker {thread}") };
        records.push(Record::named("thread_name", rank, Some(thread), name));
    }
    records.extend(sorted.into_iter().map(Record::complete));
    let trace = Trace { records, unit: "ms" };
    file::write_whole(path, |writer| {
        // A record has few fields and a trace many records: no indentation.
        serde_json::to_writer(&mut *writer, &trace)?;
        std::io::Write::write_all(writer, b"\n")
    })
}

#[derive(Serialize)]
struct Trace<'a> {
    #[serde(rename = "traceEvents")]
    records: Vec<Record<'a>>,
    #[serde(rename = "displayTimeUnit")]
    unit: &'static str,
}

#[derive(Serialize)]
struct Record<'a> {
    name: &'a str,
    ph: &'static str,
    pid: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    tid: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ts: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    args: Option<Name>,
}

#[derive(Serialize)]
struct Name {
    name: String,
}

impl<'a> Record<'a> {
    fn complete(event: &'a Event) -> Self {
        Record {
            name: &event.name,
            ph: "X",
            pid: event.rank,
            tid: Some(event.thread),
            ts: Some(event.start_us),
            dur: Some(event.duration_us),
            args: None,
        }
    }

    fn named(what: &'static str, rank: u32, thread: Option<u32>, name: String) -> Self {
        Record { name: what, ph: "M", pid: rank, tid: thread, ts: None, dur: None, args: Some(Name { name }) }
    }
}

/// Records one rank's events from all its threads. Off, it costs a branch a call.
#[derive(Debug, Default)]
pub struct Timeline {
    recorder: Option<Recorder>,
}

#[derive(Debug)]
struct Recorder {
    rank: u32,
    start: Instant,
    events: Mutex<Vec<Event>>,
}

impl Timeline {
    /// A recorder that records nothing.
    pub fn off() -> Self {
        Timeline::default()
    }

    /// A recorder whose time 0 is `start`: the same moment on all ranks, such as the end of a barrier.
    pub fn starting_at(rank: u32, start: Instant) -> Self {
        Timeline { recorder: Some(Recorder { rank, start, events: Mutex::default() }) }
    }

    /// Whether anything is recorded.
    pub fn is_on(&self) -> bool {
        self.recorder.is_some()
    }

    /// Records from now until the span is dropped. Names that are made for the call (as by `format!`)
    /// cost their making even when off: ask `is_on` first where that counts.
    pub fn span<'a>(&'a self, thread: u32, name: impl Into<Cow<'a, str>>) -> Span<'a> {
        Span {
            open: self.recorder.as_ref().map(|recorder| Open {
                recorder,
                thread,
                name: name.into(),
                from: Instant::now(),
            }),
        }
    }

    /// The events so far, in the order they ended; they are kept no longer.
    pub fn take(&self) -> Vec<Event> {
        self.recorder.as_ref().map_or(Vec::new(), |recorder| {
            std::mem::take(&mut *recorder.events.lock().unwrap_or_else(PoisonError::into_inner))
        })
    }
}

/// A stretch that is under way.
#[must_use = "a span ends when it is dropped"]
pub struct Span<'a> {
    open: Option<Open<'a>>,
}

struct Open<'a> {
    recorder: &'a Recorder,
    thread: u32,
    name: Cow<'a, str>,
    from: Instant,
}

impl Drop for Span<'_> {
    fn drop(&mut self) {
        let Some(open) = self.open.take() else { return };
        // Both ends are rounded down on one scale, so that a span never outlasts the one around it.
        let since_start = |at: Instant| at.saturating_duration_since(open.recorder.start).as_micros() as u64;
        let start_us = since_start(open.from);
        let event = Event {
            name: open.name.into_owned(),
            rank: open.recorder.rank,
            thread: open.thread,
            start_us,
            duration_us: since_start(Instant::now()) - start_us,
        };
        open.recorder.events.lock().unwrap_or_else(PoisonError::into_inner).push(event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn event(name: &str, rank: u32, thread: u32, start_us: u64, duration_us: u64) -> Event {
        Event { name: name.into(), rank, thread, start_us, duration_us }
    }

    #[test]
    fn trace_has_events_and_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        let mut events =
            [event("tile \"3\"", 1, 2, 10, 5), event("trace", 0, 0, 7, 90), event("load", 0, 0, 0, 7)];
        write(&path, &events).unwrap();
        let first = std::fs::read(&path).unwrap();
        events.reverse();
        write(&path, &events).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), first);

        let json: serde_json::Value = serde_json::from_slice(&first).unwrap();
        let records = json["traceEvents"].as_array().unwrap();
        let named = |what: &str, pid: u64, name: &str| {
            records.iter().any(|r| r["name"] == what && r["pid"] == pid && r["args"]["name"] == name)
        };
        assert!(named("process_name", 0, "rank 0") && named("process_name", 1, "rank 1"));
        assert!(named("thread_name", 0, "main") && named("thread_name", 1, "worker 2"));
        let spans: Vec<_> = records.iter().filter(|r| r["ph"] == "X").collect();
        assert_eq!(spans.len(), 3);
        assert_eq!(
            *spans[2],
            serde_json::json!({ "name": "tile \"3\"", "ph": "X", "pid": 1, "tid": 2, "ts": 10, "dur": 5 })
        );
    }

    #[test]
    fn spans_of_many_threads_are_kept() {
        let start = Instant::now();
        let timeline = Timeline::starting_at(4, start);
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let timeline = &timeline;
                scope.spawn(move || {
                    for i in 0..50 {
                        let _span = timeline.span(thread, format!("tile {i}"));
                    }
                });
            }
        });
        {
            let _outer = timeline.span(0, "outer");
            let _inner = timeline.span(0, "inner");
            std::thread::sleep(Duration::from_millis(3));
        }
        let events = timeline.take();
        assert_eq!(events.len(), 202);
        assert!(events.iter().all(|e| e.rank == 4));
        let [inner, outer] = [&events[200], &events[201]];
        assert_eq!((inner.name.as_str(), outer.name.as_str()), ("inner", "outer"));
        assert!(inner.duration_us >= 3000);
        assert!(outer.start_us <= inner.start_us);
        assert!(outer.start_us + outer.duration_us >= inner.start_us + inner.duration_us);
        assert!(timeline.take().is_empty());
    }

    #[test]
    fn off_records_nothing() {
        let timeline = Timeline::off();
        drop(timeline.span(0, "trace"));
        assert!(!timeline.is_on() && timeline.take().is_empty());
    }

    #[test]
    fn event_travels_as_bytes() {
        let sent = vec![event("tile 3", 1, 2, 3, 4)];
        let bytes = bincode::serde::encode_to_vec(&sent, bincode::config::legacy()).unwrap();
        let (got, _): (Vec<Event>, usize) =
            bincode::serde::decode_from_slice(&bytes, bincode::config::legacy()).unwrap();
        assert_eq!(got, sent);
    }
}
