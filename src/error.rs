//! The one error type. Every variant names a file, line or flag and says how to mend it.

use std::path::PathBuf;

/// Exit code of a scene or render error.
pub const EXIT_FAILURE: i32 = 1;
/// Exit code of a usage error: a wrong flag or value.
pub const EXIT_USAGE: i32 = 2;
/// Exit code of a render that a clock ended: what was written is sound, but not all that was asked for.
pub const EXIT_STOPPED: i32 = 75;

pub type Result<T> = std::result::Result<T, Error>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A flag, its value or its environment twin is wrong.
    #[error("{flag}: {what}; {mend}")]
    Usage { flag: String, what: String, mend: String },

    /// Flags that can't be understood, explained in full by their parser.
    #[error("{0}")]
    Flags(String),

    /// A scene, mesh, material or image file says something that can't be rendered.
    #[error("{}{}: {what}; {mend}", file.display(), line.map_or(String::new(), |l| format!(":{l}")))]
    Scene { file: PathBuf, line: Option<usize>, what: String, mend: String },

    /// A file can't be opened or read.
    #[error("{}: can't read: {source}; {mend}", path.display())]
    Read { path: PathBuf, source: std::io::Error, mend: String },

    /// A file can't be created or written.
    #[error("{}: can't write: {source}; {mend}", path.display())]
    Write { path: PathBuf, source: std::io::Error, mend: String },

    /// Two images differ by more than the caller allowed.
    #[error("{0}")]
    Differs(String),

    /// The tracer was found to be wrong.
    #[error("{0}")]
    Inexact(String),

    /// The launcher, the MPI library and this build don't fit together, or a message broke.
    #[error("{what}; {mend}")]
    Launch { what: String, mend: String },

    /// A clock ended what can be gone on with.
    #[error("{0}")]
    Stopped(String),

    /// An error that another rank reported; its text is already complete.
    #[error("{message}")]
    Remote { message: String, code: i32 },
}

impl Error {
    pub fn usage(flag: impl Into<String>, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Error::Usage { flag: flag.into(), what: what.into(), mend: mend.into() }
    }

    pub fn scene(
        file: impl Into<PathBuf>,
        line: Option<usize>,
        what: impl Into<String>,
        mend: impl Into<String>,
    ) -> Self {
        Error::Scene { file: file.into(), line, what: what.into(), mend: mend.into() }
    }

    pub fn read(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        let mend = match source.kind() {
            std::io::ErrorKind::NotFound => "check the path",
            std::io::ErrorKind::PermissionDenied => "check its permissions",
            _ => "check that it is a readable file",
        };
        Error::Read { path: path.into(), source, mend: mend.into() }
    }

    pub fn write(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        let mend = match source.kind() {
            std::io::ErrorKind::NotFound => "create its folder first",
            std::io::ErrorKind::PermissionDenied => "choose a folder you may write to",
            std::io::ErrorKind::InvalidFilename => "choose a shorter name",
            _ => "check the path and the free space",
        };
        Error::Write { path: path.into(), source, mend: mend.into() }
    }

    pub fn launch(what: impl Into<String>, mend: impl Into<String>) -> Self {
        Error::Launch { what: what.into(), mend: mend.into() }
    }

    /// The exit code that this error ends the program with.
    pub fn exit_code(&self) -> i32 {
        match self {
            Error::Usage { .. } | Error::Flags(_) => EXIT_USAGE,
            Error::Stopped(_) => EXIT_STOPPED,
            Error::Remote { code, .. } => *code,
            _ => EXIT_FAILURE,
        }
    }
}
