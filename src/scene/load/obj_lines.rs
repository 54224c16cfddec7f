//! Hands an OBJ file to `tobj` line by line: only the statements that make triangles, each checked and spelt as
//! `tobj` reads it right. So every error has its line, and what `tobj` would misread or panic on never gets there:
//! polylines (which it takes for faces), indices out of range, comments behind numbers, vertices partly with
//! colours, tabs behind `usemtl`, byte order marks, continued lines. Knows no mesh and no material.

use std::cell::RefCell;
use std::io::{self, BufRead, Read};
use std::path::Path;

use super::mtl::Library;
use super::words::{name, shown};
use crate::error::{Error, Result};

/// Beyond so many changes between faces with and without normals or texture coordinates the faces aren't kept
/// apart any more, so that a strange file can't become a million meshes.
const MAX_SPLITS: usize = 4096;

/// What the indices of a face's corner refer to, in their order.
const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];
const KEYWORDS: [&str; 3] = ["v", "vt", "vn"];

/// What was met on the way, for warnings.
#[derive(Debug, Default)]
pub(super) struct Notes {
    pub vertices_with_color: usize,
    pub vertices_without_color: usize,
    /// Normals and texture coordinates that weren't finite.
    pub zeroed: usize,
    pub polylines: usize,
    pub points: usize,
    pub faces: usize,
    /// Indices of texture coordinates or normals in a file that has none at all.
    pub dangling: usize,
}

/// An index that refers to what comes later in the file, if it comes.
#[derive(Debug)]
struct Forward {
    line: usize,
    kind: usize,
    index: usize,
}

/// The reader that `tobj` gets.
#[derive(Debug)]
pub(super) struct Lines<'a, R> {
    inner: R,
    path: &'a Path,
    library: &'a RefCell<Library>,
    /// Give white to vertices without a colour.
    pad_colors: bool,
    /// The line as it is in the file.
    raw: Vec<u8>,
    /// The line as it is handed out, and how much of it is read.
    out: Vec<u8>,
    read: usize,
    /// Number of the line in `raw`, and of those that were read.
    line: usize,
    lines_read: usize,
    /// Vertices, texture coordinates and normals so far.
    counts: [usize; 3],
    forward: Vec<Forward>,
    /// Which of the indices the last face had.
    signature: Option<u8>,
    splits: usize,
    problem: Option<Error>,
    pub notes: Notes,
}

impl<'a, R: BufRead> Lines<'a, R> {
    pub fn new(inner: R, path: &'a Path, library: &'a RefCell<Library>, pad_colors: bool) -> Self {
        Lines {
            inner,
            path,
            library,
            pad_colors,
            raw: Vec::new(),
            out: Vec::new(),
            read: 0,
            line: 0,
            lines_read: 0,
            counts: [0; 3],
            forward: Vec::new(),
            signature: None,
            splits: 0,
            problem: None,
            notes: Notes::default(),
        }
    }

    /// The error behind a failure of `tobj`: our own, or its own about the line that it was given last.
    pub fn explain(&mut self, error: tobj::LoadError) -> Error {
        if let Some(problem) = self.problem.take() {
            return problem;
        }
        // At the end of a group `tobj` looks up what its faces refer to.
        if let Err(problem) = self.check_forward() {
            return problem;
        }
        let out = String::from_utf8_lossy(&self.out);
        match out.split_whitespace().skip(1).find(|word| word.parse::<f32>().is_err()) {
            Some(word) if out.starts_with('v') => self.not_a_number(word),
            _ => self.error(error.to_string(), "correct the line"),
        }
    }

    fn refill(&mut self) -> Result<()> {
        self.read = 0;
        self.out.clear();
        while self.out.is_empty() && self.next_line()? {
            let line = std::mem::take(&mut self.raw);
            self.translate(&line)?;
            self.raw = line;
        }
        if self.out.is_empty() { self.check_forward() } else { Ok(()) }
    }

    /// Reads the next line into `raw`, without its end and joined with what continues it. False at the end of the file.
    fn next_line(&mut self) -> Result<bool> {
        self.raw.clear();
        self.line = self.lines_read + 1;
        loop {
            let count = self
                .inner
                .read_until(b'\n', &mut self.raw)
                .map_err(|source| Error::read(self.path, source))?;
            self.lines_read += 1;
            while let Some(b'\n' | b'\r') = self.raw.last() {
                self.raw.pop();
            }
            if count == 0 {
                return Ok(!self.raw.is_empty());
            }
            // Names may end in a backslash, and so may comments.
            let joins = self.raw.ends_with(b"\\")
                && matches!(self.raw.trim_ascii_start().first(), Some(b'v' | b'f' | b'l' | b'p' | b's'));
            if !joins {
                break;
            }
            self.raw.pop();
            self.raw.push(b' ');
        }
        if self.line == 1 {
            self.check_encoding()?;
        }
        Ok(true)
    }

    fn check_encoding(&mut self) -> Result<()> {
        if self.raw.starts_with(&[0xff, 0xfe]) || self.raw.starts_with(&[0xfe, 0xff]) {
            return Err(self.error("this is UTF-16 text", "save it as UTF-8"));
        }
        if self.raw.starts_with("\u{feff}".as_bytes()) {
            self.raw.drain(..3);
        }
        Ok(())
    }

    fn translate(&mut self, line: &[u8]) -> Result<()> {
        let line = line.trim_ascii();
        let end = line.iter().position(|byte| matches!(byte, b' ' | b'\t')).unwrap_or(line.len());
        let (keyword, rest) = line.split_at(end);
        match keyword {
            b"v" => self.vertex(rest),
            b"vt" => self.coordinates(1, rest),
            b"vn" => self.coordinates(2, rest),
            b"f" => self.face(rest),
            _ => {
                self.check_text(line)?;
                match keyword {
                    b"l" => self.notes.polylines += 1,
                    b"p" => self.notes.points += 1,
                    b"o" | b"g" => self.out.extend_from_slice(b"g\n"),
                    b"usemtl" => {
                        let name = name(rest);
                        self.library.borrow_mut().note_use(&name);
                        self.out.extend_from_slice(format!("usemtl {name}\n").as_bytes());
                    }
                    b"mtllib" => {
                        self.library.borrow_mut().load(&String::from_utf8_lossy(rest), self.line)?;
                        self.out.extend_from_slice(b"mtllib libraries\n");
                    }
                    _ => {}
                }
                Ok(())
            }
        }
    }

    fn vertex(&mut self, rest: &[u8]) -> Result<()> {
        self.counts[0] += 1;
        if plain_numbers(rest) == Some(3) && !self.pad_colors {
            self.notes.vertices_without_color += 1;
            self.hand_out("v", rest);
            return Ok(());
        }
        let mut values = [0.0f32; 8];
        let count = self.numbers(rest, &mut values)?;
        if let Some(bad) = values[..count.min(7)].iter().find(|value| !value.is_finite()) {
            return Err(self.error(
                format!("{bad} is not a number that a vertex can have"),
                "give finite numbers below 3.4e38",
            ));
        }
        let [mut x, mut y, mut z, w, ..] = values;
        match count {
            0..3 => return Err(self.error(format!("a vertex of {count} numbers"), "give it x, y and z")),
            4 => {
                (x, y, z) = (x / w, y / w, z / w);
                if !(x.is_finite() && y.is_finite() && z.is_finite()) {
                    return Err(
                        self.error(format!("the vertex's weight {w} is too small"), "leave the weight out")
                    );
                }
            }
            3 | 6 | 7 => {}
            _ => {
                return Err(self.error(
                    format!("a vertex of {count} numbers"),
                    "give it x y z, x y z w, or x y z and a colour r g b",
                ));
            }
        }
        let text = if count >= 6 {
            self.notes.vertices_with_color += 1;
            format!("v {x} {y} {z} {} {} {}\n", values[3], values[4], values[5])
        } else {
            self.notes.vertices_without_color += 1;
            let color = if self.pad_colors { " 1 1 1" } else { "" };
            format!("v {x} {y} {z}{color}\n")
        };
        self.out.extend_from_slice(text.as_bytes());
        Ok(())
    }

    /// A texture coordinate (`kind` 1) or a normal (`kind` 2).
    fn coordinates(&mut self, kind: usize, rest: &[u8]) -> Result<()> {
        self.counts[kind] += 1;
        let keyword = KEYWORDS[kind];
        let wanted = kind + 1;
        if plain_numbers(rest).is_some_and(|count| count >= wanted) {
            self.hand_out(keyword, rest);
            return Ok(());
        }
        let mut values = [0.0f32; 3];
        let count = self.numbers(rest, &mut values)?;
        // The second texture coordinate may be left out: it is 0.
        if count < wanted && !(kind == 1 && count == 1) {
            return Err(self.error(
                format!("a {} of {count} numbers", KINDS[kind]),
                format!("give it {wanted} numbers"),
            ));
        }
        if !values.iter().all(|value| value.is_finite()) {
            self.notes.zeroed += 1;
            values = [0.0; 3];
        }
        let [x, y, z] = values;
        let text = if kind == 1 { format!("vt {x} {y}\n") } else { format!("vn {x} {y} {z}\n") };
        self.out.extend_from_slice(text.as_bytes());
        Ok(())
    }

    fn face(&mut self, rest: &[u8]) -> Result<()> {
        let mut rest = rest;
        let (mut corners, mut any, mut all) = (0, 0, 0b111);
        let mut at = 0;
        while at < rest.len() {
            if matches!(rest[at], b' ' | b'\t') {
                at += 1;
                continue;
            }
            if rest[at] == b'#' {
                rest = &rest[..at];
                break;
            }
            let (end, present) = self.corner(rest, at)?;
            corners += 1;
            any |= present;
            all &= present;
            at = end;
        }
        if corners < 3 {
            return Err(
                self.error(format!("a face of {corners} corners"), "give it three or more, or remove it")
            );
        }
        let signature = any << 3 | all;
        if self.signature.replace(signature).is_some_and(|last| last != signature) && self.splits < MAX_SPLITS
        {
            self.splits += 1;
            self.out.extend_from_slice(b"g\n");
        }
        self.notes.faces += 1;
        self.hand_out("f", rest);
        Ok(())
    }

    /// Checks the corner of a face that begins at `start`; gives where it ends, and a bit for each index it has.
    fn corner(&mut self, rest: &[u8], start: usize) -> Result<(usize, u8)> {
        let (mut at, mut kind, mut present) = (start, 0, 0);
        loop {
            let sign = rest.get(at).copied().filter(|byte| matches!(byte, b'-' | b'+'));
            at += usize::from(sign.is_some());
            let first = at;
            let mut index = 0usize;
            while let Some(digit) = rest.get(at).filter(|byte| byte.is_ascii_digit()) {
                index = index.saturating_mul(10).saturating_add(usize::from(digit - b'0'));
                at += 1;
            }
            if at > first {
                self.check_index(kind, index, sign == Some(b'-'))?;
                present |= 1 << kind;
            } else if sign.is_some() || kind == 0 {
                return Err(self.bad_corner(rest, start));
            }
            match rest.get(at) {
                None | Some(b' ' | b'\t') => return Ok((at, present)),
                Some(b'/') if kind < 2 => (at, kind) = (at + 1, kind + 1),
                Some(_) => return Err(self.bad_corner(rest, start)),
            }
        }
    }

    fn check_index(&mut self, kind: usize, index: usize, relative: bool) -> Result<()> {
        let count = self.counts[kind];
        if index > u32::MAX as usize {
            // `tobj` computes with it unchecked.
            Err(self.error(format!("index {index} of a {}", KINDS[kind]), "correct the index"))
        } else if index == 0 {
            Err(self.error(
                format!("index 0 of a {}", KINDS[kind]),
                "count from 1, or from -1 for the last one before the face",
            ))
        } else if relative && index > count {
            Err(self.error(
                format!("relative index -{index} of a {}, but there are {count} before it", KINDS[kind]),
                "correct the index",
            ))
        } else {
            if !relative && index > count {
                self.forward.push(Forward { line: self.line, kind, index });
            }
            Ok(())
        }
    }

    /// At the end of the file: whether all that faces refer to has come.
    fn check_forward(&mut self) -> Result<()> {
        // Where there are no normals or no texture coordinates at all the mesh is whole without them.
        let dangles = |forward: &&Forward| forward.kind > 0 && self.counts[forward.kind] == 0;
        self.notes.dangling = self.forward.iter().filter(dangles).count();
        let missing = |forward: &&Forward| forward.index > self.counts[forward.kind] && !dangles(forward);
        match self.forward.iter().find(missing) {
            None => Ok(()),
            Some(&Forward { line, kind, index }) => {
                self.line = line;
                let there = match self.counts[kind] {
                    0 => "there are none".to_owned(),
                    count => format!("the last one is {count}"),
                };
                Err(self.error(
                    format!("index {index} of a {}, but {there}", KINDS[kind]),
                    format!("correct the index, or add the missing `{}` lines", KEYWORDS[kind]),
                ))
            }
        }
    }

    /// Reads numbers up to the end of the line or a comment; those that `values` can't hold are only counted.
    fn numbers(&mut self, rest: &[u8], values: &mut [f32]) -> Result<usize> {
        self.check_text(rest)?;
        let text = String::from_utf8_lossy(rest);
        let text = text.split('#').next().unwrap_or_default();
        let mut count = 0;
        for word in text.split_whitespace() {
            let value = word.parse::<f32>().map_err(|_| self.not_a_number(word))?;
            if let Some(place) = values.get_mut(count) {
                *place = value;
            }
            count += 1;
        }
        Ok(count)
    }

    /// Refuses what is no text, or whose lines can't be told apart.
    fn check_text(&self, line: &[u8]) -> Result<()> {
        if line.contains(&0) {
            Err(self.error("this is not a text file", "give an OBJ file, in UTF-8 if it was UTF-16"))
        } else if line.contains(&b'\r') {
            Err(self.error("lines end in a lone carriage return", "convert the file's line ends (mac2unix)"))
        } else {
            Ok(())
        }
    }

    fn hand_out(&mut self, keyword: &str, rest: &[u8]) {
        self.out.extend_from_slice(keyword.as_bytes());
        self.out.extend_from_slice(rest);
        self.out.push(b'\n');
    }

    fn bad_corner(&self, rest: &[u8], start: usize) -> Error {
        if let Err(error) = self.check_text(rest) {
            return error;
        }
        let corner = rest[start..].split(|byte| matches!(byte, b' ' | b'\t')).next().unwrap_or_default();
        self.error(
            format!("`{}` is not a corner of a face", shown(corner)),
            "write it as v, v/vt, v//vn or v/vt/vn",
        )
    }

    fn not_a_number(&self, word: &str) -> Error {
        self.error(format!("`{}` is not a number", shown(word.as_bytes())), "write it like -1.5 or 2e-3")
    }

    fn error(&self, what: impl Into<String>, mend: impl Into<String>) -> Error {
        Error::scene(self.path, Some(self.line), what, mend)
    }
}

impl<R: BufRead> BufRead for Lines<'_, R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.read == self.out.len()
            && let Err(problem) = self.refill()
        {
            self.problem = Some(problem);
            return Err(io::Error::other("the line can't be used"));
        }
        Ok(&self.out[self.read..])
    }

    fn consume(&mut self, amount: usize) {
        self.read += amount;
    }
}

impl<R: BufRead> Read for Lines<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

/// How many numbers there are, if they are all written plainly and short enough to be finite in f32.
#[inline]
fn plain_numbers(rest: &[u8]) -> Option<usize> {
    let (mut count, mut length) = (0, 0);
    for byte in rest {
        match byte {
            b'0'..=b'9' | b'.' | b'-' | b'+' => {
                count += usize::from(length == 0);
                length += 1;
                if length > 38 {
                    return None;
                }
            }
            b' ' | b'\t' => length = 0,
            _ => return None,
        }
    }
    Some(count)
}
