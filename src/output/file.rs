//! Writing a file whole or not at all: filled under a temporary name in the same folder, then renamed.
//! Knows no format.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::error::{Error, Result};

/// Writes `path` by `fill`: until the last byte is on the disk, nothing appears under that name, and
/// after an error nothing is left behind. A symbolic link is followed, so that it stays one.
pub fn write_whole(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    replace(path, fill).map_err(|source| Error::write(path, source))
}

/// Fails now if `write_whole(path, …)` would fail later: the folder must exist and be writable, and
/// `path` must be absent or a regular file, or a link to one.
pub fn check_writable(path: &Path) -> Result<()> {
    let refuse = |kind: io::ErrorKind, what: &str, mend: &str| Error::Write {
        path: path.into(),
        source: io::Error::new(kind, what),
        mend: mend.into(),
    };
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            return Err(refuse(io::ErrorKind::IsADirectory, "it is a folder", "name a file in it"));
        }
        Ok(found) if !found.is_file() => {
            return Err(refuse(
                io::ErrorKind::InvalidInput,
                "it is not a regular file",
                "choose another name",
            ));
        }
        Err(source) if source.kind() == io::ErrorKind::InvalidFilename => {
            return Err(Error::write(path, source));
        }
        // What else can be wrong with the path is wrong with its folder, too.
        _ => {}
    }
    let folder = folder_of(&behind_links(path).map_err(|source| Error::write(path, source))?);
    match fs::metadata(&folder) {
        Ok(found) if found.is_dir() => {}
        Ok(_) => {
            let what = format!("{} is not a folder", folder.display());
            return Err(refuse(io::ErrorKind::NotADirectory, &what, "choose a folder that exists"));
        }
        Err(source) => return Err(Error::write(path, source)),
    }
    // Permission bits don't tell (root, read-only mounts, quotas): only trying does.
    Temporary::create_in(&folder).map(drop).map_err(|source| Error::write(path, source))
}

/// The folder that [`write_whole`] fills the file in.
///
/// # Errors
/// A link that leads nowhere.
pub fn folder(path: &Path) -> Result<PathBuf> {
    behind_links(path).map(|path| folder_of(&path)).map_err(|source| Error::write(path, source))
}

fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let path = behind_links(path)?;
    if path.file_name().is_none() || path.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder"));
    }
    let (temporary, file) = Temporary::create_in(&folder_of(&path))?;
    let mut writer = BufWriter::with_capacity(1 << 20, file);
    fill(&mut writer)?;
    let file = writer.into_inner().map_err(|e| e.into_error())?;
    // Network file systems and quotas may report a failed write only here.
    file.sync_all()?;
    drop(file);
    fs::rename(&temporary.path, &path)
    // The temporary name is gone now: dropping its guard finds nothing to remove.
}

/// The file itself, where `path` is a link to it; an error where that leads nowhere.
fn behind_links(path: &Path) -> io::Result<PathBuf> {
    if path.is_symlink() { fs::canonicalize(path) } else { Ok(path.into()) }
}

fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.into(),
        _ => ".".into(),
    }
}

/// A file under a name of its own, removed when dropped.
struct Temporary {
    path: PathBuf,
}

impl Temporary {
    fn create_in(folder: &Path) -> io::Result<(Self, File)> {
        static COUNTER: AtomicU32 = AtomicU32::new(0);
        loop {
            // Short, whatever the final name: that may be as long as the file system allows.
            let number = COUNTER.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".heliostat-{}-{number}.tmp", std::process::id()));
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((Temporary { path }, file)),
                // Left by a killed process of the same number, or another host's.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(error),
            }
        }
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

/// Writes `value` as indented JSON with a closing newline.
pub(super) fn json(writer: &mut impl Write, value: &impl serde::Serialize) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *writer, value)?;
    writer.write_all(b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn error_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_whole(&path, |w| w.write_all(b"old")).unwrap();
        let error = write_whole(&path, |w| {
            w.write_all(&vec![1; 3 << 20])?;
            Err(io::Error::other("disk on fire"))
        });
        assert!(error.unwrap_err().to_string().contains("a.bin: can't write: disk on fire"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn panic_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let fill = || write_whole(&path, |_| panic!("expected by this test"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(fill)).is_err());
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn check_leaves_nothing_and_refuses_early() {
        let folder = tempfile::tempdir().unwrap();
        check_writable(&folder.path().join("new.png")).unwrap();
        assert!(names(folder.path()).is_empty());

        let message = |path: &Path| check_writable(path).unwrap_err().to_string();
        assert!(message(folder.path()).contains("it is a folder; name a file in it"));
        assert!(message(&folder.path().join("no/such/a.png")).contains("create its folder first"));
        fs::write(folder.path().join("plain"), "").unwrap();
        assert!(message(&folder.path().join("plain/a.png")).contains("plain is not a folder"));
    }

    #[cfg(unix)]
    #[test]
    fn check_refuses_what_the_write_would() {
        let folder = tempfile::tempdir().unwrap();
        let dangling = folder.path().join("link");
        std::os::unix::fs::symlink("nowhere", &dangling).unwrap();
        for path in [dangling, folder.path().join("n".repeat(256))] {
            assert!(write_whole(&path, |_| Ok(())).is_err());
            assert!(check_writable(&path).is_err(), "{}", path.display());
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn unwritable_folder_is_found_by_trying() {
        // Not even root can create files in /proc.
        assert!(check_writable(Path::new("/proc/a.png")).is_err());
        assert!(write_whole(Path::new("/proc/a.png"), |_| Ok(())).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn link_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write_whole(&link, |w| w.write_all(b"new")).unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
    }

    #[test]
    fn name_as_long_as_allowed_can_be_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n".repeat(255));
        write_whole(&path, |w| w.write_all(b"x")).unwrap();
        assert_eq!(fs::read(path).unwrap(), b"x");
    }
}
