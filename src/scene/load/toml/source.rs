//! The text of a scene file, and errors that point into it.

use std::fmt::Display;
use std::ops::Range;
use std::path::Path;

use crate::error::Error;

/// Bytes of the text.
pub type Span = Range<usize>;

#[derive(Clone, Copy)]
pub struct Source<'a> {
    pub file: &'a Path,
    pub text: &'a str,
}

impl Source<'_> {
    /// An error at the beginning of a span.
    pub fn error(&self, at: &Span, what: impl Display, mend: impl Into<String>) -> Error {
        let (line, column) = self.position(at.start);
        let what = one_line(&format!("column {column}: {what}"));
        Error::scene(self.file, Some(line), what, one_line(&mend.into()))
    }

    /// A warning at the beginning of a span.
    pub fn warning(&self, at: &Span, what: impl Display) -> String {
        format!("{}:{}: {what}", self.file.display(), self.position(at.start).0)
    }

    /// Gives an error that knows no line of its own the place that caused it.
    pub fn blame(&self, at: &Span, error: Error) -> Error {
        match error {
            Error::Read { path, source, mend } => {
                self.error(at, format_args!("{}: can't read: {source}", path.display()), mend)
            }
            Error::Scene { file, line: None, what, mend } if file == self.file => self.error(at, what, mend),
            error => error,
        }
    }

    /// Line and column, both from 1, the column in characters.
    fn position(&self, offset: usize) -> (usize, usize) {
        let before = &self.text.as_bytes()[..offset.min(self.text.len())];
        let line_start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        let is_first_byte = |byte: &&u8| **byte & 0xc0 != 0x80;
        (line, before[line_start..].iter().filter(is_first_byte).count() + 1)
    }
}

/// The text without what would break a line, and cut where it is long: names in a scene file can be anything.
fn one_line(text: &str) -> String {
    const LONGEST: usize = 400;
    let plain = |c: char| if c.is_control() { '\u{fffd}' } else { c };
    let mut line: String = text.chars().take(LONGEST).map(plain).collect();
    if text.chars().nth(LONGEST).is_some() {
        line.push_str("...");
    }
    line
}
