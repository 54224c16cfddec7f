//! Starting jobs by the launcher, each with its own folder, and looking at how they end.

use std::ffi::OsStr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use super::ranks;

/// Only to find hangs: a busy machine is slow at starting and ending processes.
pub const LONGEST: Duration = Duration::from_secs(10);

/// How a job ended.
pub struct End {
    pub case: String,
    pub code: Option<i32>,
    pub stdout: Vec<u8>,
    pub stderr: String,
    /// What was in the folder it ran in.
    pub files: Vec<PathBuf>,
}

impl End {
    /// Lines that the program wrote as errors; what the launcher adds is its own affair.
    pub fn complaints(&self) -> Vec<&str> {
        let is_complaint = |line: &&str| {
            let after_rank = line.strip_prefix("[rank ").and_then(|rest| rest.split_once("] "));
            let said = after_rank.map_or(*line, |(_, said)| said);
            said.starts_with("heliostat: ") && !said.starts_with("heliostat: warning: ")
        };
        self.stderr.lines().filter(is_complaint).collect()
    }

    /// One complaint that holds each of `hints`, this exit code, and nothing left behind.
    pub fn fails(&self, code: i32, hints: &[&str]) {
        let said = self.complaints();
        assert_eq!(said.len(), 1, "{}: {:?}, {}", self.case, self.code, self.stderr);
        for hint in hints {
            assert!(said[0].contains(hint), "{}: no {hint:?} in {}", self.case, said[0]);
        }
        self.fails_silently(Some(code));
    }

    pub fn fails_silently(&self, code: Option<i32>) {
        assert!(!self.stderr.contains("panicked"), "{}: {}", self.case, self.stderr);
        assert!(self.code != Some(0), "{}: it did not fail", self.case);
        if code.is_some() {
            assert_eq!(self.code, code, "{}: {}", self.case, self.stderr);
        }
        assert!(self.stdout.is_empty(), "{}: {}", self.case, String::from_utf8_lossy(&self.stdout));
        assert!(self.files.is_empty(), "{} left {:?}", self.case, self.files);
    }

    pub fn succeeds(self) -> Self {
        assert_eq!(self.code, Some(0), "{}: {}", self.case, self.stderr);
        assert!(self.complaints().is_empty(), "{}: {}", self.case, self.stderr);
        self
    }
}

/// Launches in a folder of their own.
pub struct Launch {
    folder: tempfile::TempDir,
    mark: tempfile::TempDir,
}

impl Launch {
    pub fn new() -> Self {
        Launch { folder: tempfile::tempdir().unwrap(), mark: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Where a rank says, by making this file, that it fails now.
    pub fn mark(&self) -> PathBuf {
        self.mark.path().join("failing")
    }

    pub fn files(&self) -> Vec<PathBuf> {
        std::fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.current_dir(self.folder.path()).stdin(Stdio::null());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        for (name, _) in std::env::vars_os() {
            // A backtrace would follow the one line of a panic.
            if name.to_string_lossy().starts_with("HELIOSTAT_") || name == "RUST_BACKTRACE" {
                command.env_remove(name);
            }
        }
        command
    }

    /// The launcher, up to `-n`.
    pub fn launcher(&self) -> Command {
        let words = launcher();
        let mut command = self.command(&words[0]);
        command.args(&words[1..]);
        command
    }

    /// `heliostat` on so many ranks.
    pub fn heliostat(&self, ranks: usize, arguments: &[&str]) -> Command {
        let mut command = self.launcher();
        command.args(["-n", &ranks.to_string(), env!("CARGO_BIN_EXE_heliostat")]).args(arguments);
        command
    }

    /// `heliostat` on two ranks, each with an environment variable of its own, or none (`""`).
    pub fn heliostat_each(&self, variables: [&str; 2], arguments: &[&str]) -> Command {
        let mut command = self.launcher();
        for (rank, variable) in variables.into_iter().enumerate() {
            command.args([":"].iter().take(rank)).args(["-n", "1", "env"]);
            command.args([variable].iter().filter(|variable| !variable.is_empty()));
            command.arg(env!("CARGO_BIN_EXE_heliostat")).args(arguments);
        }
        command
    }

    /// Ranks of this program, which fail by themselves; see `ranks`.
    pub fn failing(&self, ranks: usize, case: &str, arguments: &[&str]) -> Command {
        let mut command = self.launcher();
        command.args(["-n", &ranks.to_string()]).arg(std::env::current_exe().unwrap()).args(arguments);
        command.env(ranks::CASE, case).env(ranks::MARK, self.mark());
        command
    }

    pub fn end(&self, case: &str, mut command: Command) -> End {
        let begin = Instant::now();
        let output = command.output().expect("the launcher starts");
        let marked = std::fs::metadata(self.mark()).and_then(|mark| mark.modified());
        let (since, took) = match &marked {
            Ok(failed) => {
                ("the failure", SystemTime::now().duration_since(*failed).expect("time goes forward"))
            }
            Err(_) => ("the start", begin.elapsed()),
        };
        let _ = std::fs::remove_file(self.mark());
        println!("{case}: ended {:.2} s after {since}", took.as_secs_f64());
        assert!(took < LONGEST, "{case} hung");
        End {
            case: case.into(),
            code: output.status.code(),
            stdout: output.stdout,
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            files: self.files(),
        }
    }
}

pub fn launcher() -> Vec<String> {
    let launcher = std::env::var("HELIOSTAT_TEST_MPIRUN")
        .expect("HELIOSTAT_TEST_MPIRUN is not set; run launch/test, which sets it");
    launcher.split_whitespace().map(String::from).collect()
}
