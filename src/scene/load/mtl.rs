//! The MTL files that an OBJ file names: finds them, checks them line by line and lets `tobj` read what is left.
//! Knows no mesh; what a material means is in [`mtl_material`](super::mtl_material).

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::files;
use super::locate::locate;
use super::warn;
use super::words::{name, shown};
use crate::error::{Error, Result};

/// So many names on one `mtllib` line are looked for, and so many are named in one warning.
const MAX_FILES: usize = 64;
const MAX_NAMED: usize = 5;

/// The materials that an OBJ file can use.
#[derive(Debug)]
pub(super) struct Library {
    obj: PathBuf,
    /// Names on `mtllib` lines and files that were dealt with: some exporters repeat them for each object.
    seen: HashSet<String>,
    loaded: HashSet<PathBuf>,
    /// For each material the file that it is from, in the order in which `tobj` will list them.
    pub sources: Vec<PathBuf>,
    defined: HashSet<String>,
    undefined: Vec<String>,
    undefined_seen: HashSet<String>,
    /// What the `mtllib` line that `tobj` reads next stands for.
    pending: Vec<tobj::Material>,
    pub warnings: Vec<String>,
}

impl Library {
    pub fn new(obj: &Path) -> Self {
        Library {
            obj: obj.to_owned(),
            seen: HashSet::new(),
            loaded: HashSet::new(),
            sources: Vec::new(),
            defined: HashSet::new(),
            undefined: Vec::new(),
            undefined_seen: HashSet::new(),
            pending: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Loads what a `mtllib` line names: one file whose name may hold blanks, or several files. One that is
    /// missing is a warning.
    pub fn load(&mut self, names: &str, line: usize) -> Result<()> {
        let names = names.trim();
        if !self.seen.insert(names.to_owned()) {
            return Ok(());
        }
        let folder = self.obj.parent().unwrap_or(Path::new("")).to_owned();
        let whole = locate(&folder, names);
        let candidates = if whole.is_some() { vec![names.to_owned()] } else { split_names(names) };
        let mut missing = Vec::new();
        for name in candidates.into_iter().take(MAX_FILES) {
            match locate(&folder, &name) {
                None => missing.push(name),
                Some(found) => {
                    if !found.exact {
                        self.warn(
                            line,
                            format!("took {} for `{}`", found.path.display(), shown(name.as_bytes())),
                        );
                    }
                    self.load_file(&found.path)?;
                }
            }
        }
        if !missing.is_empty() || names.is_empty() {
            let list = some_of(&missing);
            self.warn(line, format!("material file {list} not found: what it defines is grey"));
        }
        Ok(())
    }

    fn load_file(&mut self, path: &Path) -> Result<()> {
        if !self.loaded.insert(path.to_owned()) {
            return Ok(());
        }
        for material in parse(&files::read(path)?, path, &mut self.warnings)? {
            // Of a name that is defined twice the first definition counts, as the search in the files' order says.
            if self.defined.insert(material.name.clone()) {
                self.sources.push(path.to_owned());
                self.pending.push(material);
            }
        }
        Ok(())
    }

    /// What `tobj` asks for at a `mtllib` line.
    pub fn take_pending(&mut self) -> tobj::MTLLoadResult {
        let materials = std::mem::take(&mut self.pending);
        let names =
            materials.iter().enumerate().map(|(index, material)| (material.name.clone(), index)).collect();
        Ok((materials, names))
    }

    /// Remembers a `usemtl` name that isn't defined.
    pub fn note_use(&mut self, name: &str) {
        if !self.defined.contains(name) && self.undefined_seen.insert(name.to_owned()) {
            self.undefined.push(name.to_owned());
        }
    }

    /// All warnings, once the OBJ file is read.
    pub fn into_warnings(mut self) -> Vec<String> {
        if !self.undefined.is_empty() {
            let list = some_of(&self.undefined);
            self.warnings.push(format!(
                "{}: material {list} is used, but not defined before: grey is used instead",
                self.obj.display()
            ));
        }
        self.warnings
    }

    fn warn(&mut self, line: usize, what: String) {
        warn(&mut self.warnings, &self.obj, || format!("{}:{line}: {what}", self.obj.display()));
    }
}

/// The names on a `mtllib` line: parted by blanks, but for those in quotes or behind a backslash.
fn split_names(text: &str) -> Vec<String> {
    let (mut names, mut current, mut quoted) = (Vec::new(), String::new(), false);
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' => quoted = !quoted,
            '\\' if chars.peek() == Some(&' ') => {
                current.push(' ');
                chars.next();
            }
            c if c.is_whitespace() && !quoted => {
                if !current.is_empty() {
                    names.push(std::mem::take(&mut current));
                }
            }
            c => current.push(c),
        }
    }
    if !current.is_empty() {
        names.push(current);
    }
    names
}

/// `a`, `b` and 7 more.
fn some_of(names: &[String]) -> String {
    let mut list: Vec<String> =
        names.iter().take(MAX_NAMED).map(|name| format!("`{}`", shown(name.as_bytes()))).collect();
    if names.len() > MAX_NAMED {
        list.push(format!("and {} more", names.len() - MAX_NAMED));
    }
    if list.is_empty() { "``".to_owned() } else { list.join(", ") }
}

/// The materials of the text of an MTL file.
pub(super) fn parse(bytes: &[u8], path: &Path, warnings: &mut Vec<String>) -> Result<Vec<tobj::Material>> {
    let text = checked(bytes, path, warnings)?;
    let (materials, _) = tobj::load_mtl_buf(&mut text.as_bytes())
        .map_err(|error| Error::scene(path, None, error.to_string(), "write the material file anew"))?;
    Ok(materials)
}

/// The statements of an MTL file that matter, each complete and well-formed, so that `tobj` reads them right (it
/// panics on a colour of one number).
///
/// # Errors
/// The first line with a malformed number, or a file that isn't text.
fn checked(bytes: &[u8], path: &Path, warnings: &mut Vec<String>) -> Result<String> {
    let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes);
    if bytes.contains(&0) {
        return Err(Error::scene(
            path,
            None,
            "this is not a text file",
            "give an MTL file, in UTF-8 if it was UTF-16",
        ));
    }
    let text = String::from_utf8_lossy(bytes).replace("\r\n", "\n").replace('\r', "\n");
    let mut out = String::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let (keyword, rest) = line.split_at(line.find(char::is_whitespace).unwrap_or(line.len()));
        let statement = Statement { path, line: index + 1, keyword, rest };
        match keyword.to_ascii_lowercase().as_str() {
            "newmtl" => out.push_str(&format!("newmtl {}\n", name(rest.as_bytes()))),
            "ka" => statement.color("Ka", &mut out, warnings)?,
            "kd" => statement.color("Kd", &mut out, warnings)?,
            "ks" => statement.color("Ks", &mut out, warnings)?,
            "ke" => statement.color("Ke", &mut out, warnings)?,
            // Some exporters write the transmission filter as Kt.
            "tf" | "kt" => statement.color("Tf", &mut out, warnings)?,
            "ns" => statement.number("Ns", &mut out)?,
            "ni" => statement.number("Ni", &mut out)?,
            "d" => statement.number("d", &mut out)?,
            "tr" => statement.number("Tr", &mut out)?,
            "illum" => statement.model(&mut out, warnings)?,
            "map_kd" if rest.trim().is_empty() => statement.warn("names no file: left out", warnings),
            "map_kd" => out.push_str(&format!("map_Kd {}\n", rest.trim())),
            _ => {}
        }
    }
    Ok(out)
}

/// A line of an MTL file.
struct Statement<'a> {
    path: &'a Path,
    line: usize,
    keyword: &'a str,
    rest: &'a str,
}

impl Statement<'_> {
    /// Three numbers, or one for all three.
    fn color(&self, keyword: &str, out: &mut String, warnings: &mut Vec<String>) -> Result<()> {
        let mut words = self.words();
        if let Some("spectral" | "xyz") = words.clone().next() {
            self.warn("only colours as `r g b` can be used: left out", warnings);
            return Ok(());
        }
        let first = self.value(words.next())?;
        let [second, third] = match words.next() {
            None => [first; 2],
            second => [self.value(second)?, self.value(words.next())?],
        };
        out.push_str(&format!("{keyword} {first} {second} {third}\n"));
        Ok(())
    }

    /// One number, which `d` may have behind `-halo`.
    fn number(&self, keyword: &str, out: &mut String) -> Result<()> {
        let value = self.value(self.words().find(|&word| word != "-halo"))?;
        out.push_str(&format!("{keyword} {value}\n"));
        Ok(())
    }

    /// The number of an illumination model.
    fn model(&self, out: &mut String, warnings: &mut Vec<String>) -> Result<()> {
        let value = self.value(self.words().next())?;
        if (0.0..=10.0).contains(&value) && value.fract() == 0.0 {
            out.push_str(&format!("illum {value}\n"));
        } else {
            self.warn("illumination models are 0 to 10: left out", warnings);
        }
        Ok(())
    }

    fn words(&self) -> impl Iterator<Item = &str> + Clone {
        self.rest.split('#').next().unwrap_or_default().split_whitespace()
    }

    fn value(&self, word: Option<&str>) -> Result<f32> {
        let mend = "write it like 0.5";
        let Some(word) = word else {
            return Err(self.error("a number is missing".to_owned(), mend));
        };
        match word.parse::<f32>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(self.error(format!("`{}` is not finite", shown(word.as_bytes())), mend)),
            Err(_) => Err(self.error(format!("`{}` is not a number", shown(word.as_bytes())), mend)),
        }
    }

    fn error(&self, what: String, mend: &str) -> Error {
        Error::scene(self.path, Some(self.line), format!("{}: {what}", shown(self.keyword.as_bytes())), mend)
    }

    fn warn(&self, what: &str, warnings: &mut Vec<String>) {
        warn(warnings, self.path, || {
            format!("{}:{}: {}: {what}", self.path.display(), self.line, self.keyword)
        });
    }
}
