//! Showing how far a render is, on standard error. Knows units of work, not what they are.

use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// What `--progress` takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressKind {
    /// A bar on a terminal, elsewhere a line twice a minute.
    #[default]
    Auto,
    /// A bar that redraws itself.
    Bar,
    /// A line each 10 %, and at least every five seconds.
    Plain,
    /// A JSON object a line, for programs.
    Json,
    /// Nothing.
    None,
}

impl ProgressKind {
    /// The progress display of this kind, on standard error.
    pub fn start(self) -> Box<dyn Progress> {
        match self {
            ProgressKind::Auto if io::stderr().is_terminal() => Box::new(Bar::default()),
            ProgressKind::Auto => Box::new(Lines::new(io::stderr(), Style::Sparse)),
            ProgressKind::Bar => Box::new(Bar::default()),
            ProgressKind::Plain => Box::new(Lines::new(io::stderr(), Style::Plain)),
            ProgressKind::Json => Box::new(Lines::new(io::stderr(), Style::Json)),
            ProgressKind::None => Box::new(Silent),
        }
    }
}

/// A display of work under way. Any thread may call it; a display that can't write stays silent.
pub trait Progress: Send + Sync {
    /// Work of `total` units starts.
    fn begin(&self, total: u64);
    /// `units` more are done.
    fn advance(&self, units: u64);
    /// Shows a line that a bar must not tear, such as the name of a phase.
    fn message(&self, text: &str);
    /// The work ended, whole or not.
    fn end(&self);
}

struct Silent;

impl Progress for Silent {
    fn begin(&self, _: u64) {}
    fn advance(&self, _: u64) {}
    fn message(&self, _: &str) {}
    fn end(&self) {}
}

#[derive(Default)]
struct Bar {
    bar: Mutex<Option<ProgressBar>>,
}

impl Progress for Bar {
    fn begin(&self, total: u64) {
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template("[{bar:40}] {percent:>3} %  {elapsed}, {eta} left") {
            bar.set_style(style.progress_chars("=> "));
        }
        *lock(&self.bar) = Some(bar);
    }

    fn advance(&self, units: u64) {
        if let Some(bar) = lock(&self.bar).as_ref() {
            bar.inc(units);
        }
    }

    fn message(&self, text: &str) {
        let print = || _ = writeln!(io::stderr(), "{text}");
        match lock(&self.bar).as_ref() {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }

    fn end(&self) {
        if let Some(bar) = lock(&self.bar).take() {
            bar.finish_and_clear();
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Style {
    Sparse,
    Plain,
    Json,
}

/// The displays that write lines.
struct Lines<W> {
    style: Style,
    state: Mutex<State<W>>,
}

struct State<W> {
    writer: W,
    work: Option<Work>,
}

/// One begin-to-end stretch.
struct Work {
    total: u64,
    done: u64,
    began: Instant,
    /// When and at which count the last line was written.
    shown: (Duration, u64),
}

impl<W: Write + Send> Lines<W> {
    fn new(writer: W, style: Style) -> Self {
        Lines { style, state: Mutex::new(State { writer, work: None }) }
    }
}

impl Style {
    /// Whether a line is due, `waited` after the last one and `moved` of `total` units further.
    fn is_due(self, waited: Duration, moved: u64, total: u64) -> bool {
        let tenth = moved.saturating_mul(10) >= total;
        match self {
            Style::Sparse => waited >= Duration::from_secs(30),
            Style::Plain => waited >= Duration::from_secs(if tenth { 1 } else { 5 }),
            Style::Json => waited >= Duration::from_millis(200),
        }
    }
}

impl<W: Write + Send> Progress for Lines<W> {
    fn begin(&self, total: u64) {
        let mut state = lock(&self.state);
        state.work = Some(Work { total, done: 0, began: Instant::now(), shown: (Duration::ZERO, 0) });
        if self.style == Style::Json {
            state.json(serde_json::json!({ "event": "begin", "total": total }));
        }
    }

    fn advance(&self, units: u64) {
        let mut state = lock(&self.state);
        let Some(work) = &mut state.work else { return };
        work.done = work.done.saturating_add(units);
        let elapsed = work.began.elapsed();
        let (at, count) = work.shown;
        if !self.style.is_due(elapsed.saturating_sub(at), work.done - count, work.total) {
            return;
        }
        work.shown = (elapsed, work.done);
        state.show(self.style, "progress", elapsed);
    }

    fn message(&self, text: &str) {
        let mut state = lock(&self.state);
        match self.style {
            Style::Json => state.json(serde_json::json!({ "event": "message", "text": text })),
            Style::Plain => _ = writeln!(state.writer, "{text}"),
            Style::Sparse => {}
        }
    }

    fn end(&self) {
        let mut state = lock(&self.state);
        if let Some(elapsed) = state.work.as_ref().map(|work| work.began.elapsed()) {
            if self.style != Style::Sparse {
                state.show(self.style, "end", elapsed);
            }
            state.work = None;
        }
    }
}

impl<W: Write> State<W> {
    fn show(&mut self, style: Style, event: &str, elapsed: Duration) {
        let Some(Work { total, done, .. }) = self.work else { return };
        let seconds = elapsed.as_secs_f64();
        if style == Style::Json {
            self.json(serde_json::json!({
                "event": event, "done": done, "total": total, "seconds": seconds,
            }));
        } else {
            // No work at all is done work.
            let percent = if total == 0 { 100.0 } else { 100.0 * done as f64 / total as f64 };
            // Standard error may be closed, which is no reason to stop a render.
            let _ = writeln!(self.writer, "{percent:5.1} %  {done} of {total} units, {seconds:.1} s");
        }
    }

    fn json(&mut self, object: serde_json::Value) {
        let _ = writeln!(self.writer, "{object}");
    }
}

/// A panic of another thread is no reason for a second one here.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(style: Style, run: impl FnOnce(&dyn Progress)) -> String {
        let lines = Lines::new(Vec::new(), style);
        run(&lines);
        String::from_utf8(lines.state.into_inner().unwrap().writer).unwrap()
    }

    /// Makes the last line look older than it is.
    fn age<W>(lines: &Lines<W>, by: Duration) {
        let mut state = lines.state.lock().unwrap();
        let work = state.work.as_mut().unwrap();
        work.began = work.began.checked_sub(by).expect("the machine is up for some seconds");
    }

    #[test]
    fn json_is_an_object_a_line() {
        let text = written(Style::Json, |progress| {
            progress.message("two\nlines");
            progress.begin(8);
            progress.advance(3);
            progress.advance(5);
            progress.end();
            progress.end();
        });
        let events: Vec<serde_json::Value> =
            text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(events[0]["text"], "two\nlines");
        assert_eq!(events[1], serde_json::json!({ "event": "begin", "total": 8 }));
        let last = events.last().unwrap();
        assert_eq!((&last["event"], &last["done"], &last["total"]), (&"end".into(), &8.into(), &8.into()));
        // The steps took no time, so that no line was due for them.
        assert_eq!(events.len(), 3);
    }

    #[test]
    fn lines_come_at_their_pace() {
        let seconds = Duration::from_secs_f64;
        assert!(!Style::Plain.is_due(seconds(0.5), 90, 100));
        assert!(Style::Plain.is_due(seconds(1.0), 10, 100));
        assert!(!Style::Plain.is_due(seconds(4.9), 9, 100));
        assert!(Style::Plain.is_due(seconds(5.0), 1, 100));
        assert!(!Style::Sparse.is_due(seconds(29.0), 90, 100));
        assert!(Style::Sparse.is_due(seconds(30.0), 1, 100));
        assert!(!Style::Json.is_due(seconds(0.1), 90, 100));
    }

    #[test]
    fn plain_counts_what_was_done() {
        let lines = Lines::new(Vec::new(), Style::Plain);
        lines.begin(200);
        lines.advance(1);
        age(&lines, Duration::from_secs(2));
        lines.advance(49);
        lines.advance(100);
        lines.end();
        let text = String::from_utf8(lines.state.into_inner().unwrap().writer).unwrap();
        let starts: Vec<&str> = text.lines().map(|line| line.split(',').next().unwrap()).collect();
        assert_eq!(starts, [" 25.0 %  50 of 200 units", " 75.0 %  150 of 200 units"]);
    }

    #[test]
    fn short_renders_are_quiet_where_nobody_asked() {
        let run = |progress: &dyn Progress| {
            progress.message("loading");
            progress.begin(10);
            progress.advance(10);
            progress.end();
        };
        assert_eq!(written(Style::Sparse, run), "");
    }

    #[test]
    fn no_order_of_calls_panics() {
        for kind in [ProgressKind::Bar, ProgressKind::None] {
            let progress = kind.start();
            progress.advance(1);
            progress.end();
            progress.begin(0);
            progress.advance(u64::MAX);
            progress.advance(u64::MAX);
            progress.end();
        }
        let text = written(Style::Plain, |progress| {
            progress.advance(1);
            progress.begin(0);
            progress.end();
        });
        assert!(text.starts_with("100.0 %"), "{text}");
    }
}
