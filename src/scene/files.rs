//! Opens what a user or another file names. Knows no format.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::error::{Error, Result};

/// Opens a regular file: a pipe would hang, a device may never end.
///
/// # Errors
/// A path that isn't a readable regular file.
pub(super) fn open(path: &Path) -> Result<File> {
    // Asked first, as opening a pipe waits for its other end.
    let kind = std::fs::metadata(path).map_err(|source| Error::read(path, source))?.file_type();
    if kind.is_dir() {
        return Err(Error::read(path, io::Error::new(io::ErrorKind::IsADirectory, "it is a folder")));
    }
    if !kind.is_file() {
        return Err(Error::read(path, io::Error::other("it is a device, pipe or socket")));
    }
    File::open(path).map_err(|source| Error::read(path, source))
}

/// All of a regular file.
///
/// # Errors
/// As [`open`], or a failure on the way.
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes).map_err(|source| Error::read(path, source))?;
    Ok(bytes)
}

#[cfg(all(test, unix))]
mod tests {
    use crate::scene::load::load;
    use crate::scene::load::obj::read;
    use crate::scene::load::texture::Textures;

    /// Each of them would be read for ever, or waited for.
    #[test]
    fn what_is_no_regular_file_is_refused_by_every_reader() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, at(name)).unwrap();
        for name in ["zero.obj", "zero.toml", "zero.png", "zero.mtl"] {
            link("/dev/zero", name);
        }
        for name in ["pipe.obj", "pipe.toml", "pipe.png", "pipe.mtl"] {
            assert!(std::process::Command::new("mkfifo").arg(at(name)).status().unwrap().success());
        }
        for name in ["folder.obj", "folder.toml", "folder.png", "folder.mtl"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        link("self.obj", "self.obj");
        let scene = |text: String| {
            std::fs::write(at("scene.toml"), text).unwrap();
            load(&at("scene.toml")).unwrap_err().to_string().replace(&folder.path().display().to_string(), "")
        };
        for (kind, reason) in [
            ("zero", "it is a device, pipe or socket"),
            ("pipe", "it is a device, pipe or socket"),
            ("folder", "it is a folder"),
        ] {
            for name in [format!("{kind}.obj"), format!("{kind}.toml")] {
                let error = load(&at(&name)).unwrap_err().to_string();
                assert!(
                    error.ends_with(&format!(
                        "{name}: can't read: {reason}; check that it is a readable file"
                    )),
                    "{error}"
                );
            }
            let error = scene(format!("[[object]]\ntype = 'mesh'\nfile = '{kind}.obj'"));
            assert!(error.starts_with("/scene.toml:3: column 8: /"), "{error}");
            let error = scene(format!("[[material]]\nname = 'm'\ntexture = '{kind}.png'"));
            assert!(error.starts_with("/scene.toml:3: column 11: /"), "{error}");
            // What an OBJ or MTL file names in vain is a warning.
            std::fs::write(at("m.mtl"), format!("newmtl m\nmap_Kd {kind}.png\n")).unwrap();
            let obj =
                format!("mtllib {kind}.mtl\nmtllib m.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
            std::fs::write(at("a.obj"), obj).unwrap();
            let file = read(&at("a.obj"), &mut Textures::default()).unwrap();
            assert_eq!(file.warnings.len(), 2, "{:?}", file.warnings);
        }
        assert!(load(&at("self.obj")).unwrap_err().to_string().contains("can't read"));
    }

    #[test]
    fn files_that_name_themselves_are_read_once() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let obj = "mtllib a.obj\nmtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
        std::fs::write(at("a.obj"), obj).unwrap();
        std::fs::write(at("b.mtl"), "mtllib b.mtl\nnewmtl m\nKd 1 0 0\nmap_Kd b.mtl\n").unwrap();
        let file = read(&at("a.obj"), &mut Textures::default()).unwrap();
        assert_eq!((file.materials.len(), file.meshes[0].1), (1, Some(0)));
        assert!(file.warnings.len() == 1 && file.warnings[0].contains("not an image"), "{:?}", file.warnings);
        std::fs::write(at("a.toml"), "[[object]]\ntype = 'mesh'\nfile = 'a.toml'").unwrap();
        assert!(load(&at("a.toml")).unwrap_err().to_string().contains(": no triangles"));
    }
}
