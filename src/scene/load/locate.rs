//! Finds the file that a name in an OBJ or MTL file means, however its author's system spelt it. Knows nothing
//! of what the file holds.

use std::path::{Path, PathBuf};

/// A file that was found, and how.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Found {
    pub path: PathBuf,
    /// Under the very name that was asked for, but for the kind of slash.
    pub exact: bool,
}

/// The regular file that `name` means in `folder`: as it is written; else with other capitals; else, as many files
/// keep their author's own folders, the last part of the name in `folder` itself.
pub(super) fn locate(folder: &Path, name: &str) -> Option<Found> {
    let name = name.trim().trim_matches('"').replace('\\', "/");
    let last = name.rsplit('/').next().filter(|last| !last.is_empty())?;
    let written = folder.join(&name);
    if written.is_file() {
        return Some(Found { path: written, exact: true });
    }
    let path = any_case(folder, &name).or_else(|| any_case(folder, last))?;
    Some(Found { path, exact: false })
}

/// Follows the parts of `name` from `folder`, taking another spelling in capitals where there is no exact one.
fn any_case(folder: &Path, name: &str) -> Option<PathBuf> {
    let mut path = folder.to_owned();
    for part in name.split('/').filter(|part| !part.is_empty()) {
        let exact = path.join(part);
        path = if exact.exists() { exact } else { other_case(&path, part)? };
    }
    path.is_file().then_some(path)
}

fn other_case(folder: &Path, part: &str) -> Option<PathBuf> {
    let wanted = part.to_lowercase();
    // An empty path is the current folder, which `read_dir` wants to be named.
    let listed = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let names = std::fs::read_dir(listed).ok()?.filter_map(|entry| Some(entry.ok()?.file_name()));
    // The least, as the order of a folder's entries differs between machines.
    let name = names.filter(|name| name.to_string_lossy().to_lowercase() == wanted).min()?;
    Some(folder.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_finds_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        std::fs::create_dir(folder.join("Maps")).unwrap();
        for file in ["Maps/Wood Dark.PNG", "a.png", "A.png"] {
            std::fs::write(folder.join(file), "").unwrap();
        }
        let find = |name: &str| {
            locate(folder, name).map(|found| {
                let relative = found.path.strip_prefix(folder).unwrap();
                (relative.to_string_lossy().replace("./", ""), found.exact)
            })
        };
        let wood = |exact| Some(("Maps/Wood Dark.PNG".to_owned(), exact));
        assert_eq!(find("Maps/Wood Dark.PNG"), wood(true));
        assert_eq!(find(r".\Maps\Wood Dark.PNG"), wood(true));
        assert_eq!(find("\"Maps/Wood Dark.PNG\""), wood(true));
        assert_eq!(find(r"maps\wood dark.png"), wood(false));
        assert_eq!(find("a.png"), Some(("a.png".to_owned(), true)));
        assert_eq!(find("a.PNG"), Some(("A.png".to_owned(), false)));
        assert_eq!(find(r"C:\Users\me\a.png"), Some(("a.png".to_owned(), false)));
        for missing in ["wood.png", "Maps", "Maps/", "", "..", "a.png/b"] {
            assert_eq!(find(missing), None, "{missing}");
        }
    }
}
