//! Writing an image to where the user wants it: a file of the format that its extension names, or
//! standard output. Knows formats by name only.

use std::fmt;
use std::io::{self, Cursor, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::file;
use crate::error::{Error, Result};
pub use crate::image::format::WriteOptions;
use crate::image::{Image, Layer};
use crate::image::{exr, pfm, png};

/// The image formats that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Png,
    Exr,
    Pfm,
}

/// Where an image goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    File {
        path: PathBuf,
        format: Format,
    },
    /// Standard output, as PNG.
    Stdout,
}

impl Target {
    /// Reads the value of `--output`: a path that ends in .png, .exr or .pfm, or `-`.
    pub fn parse(text: &str) -> Result<Self> {
        if text == "-" {
            return Ok(Target::Stdout);
        }
        let path = PathBuf::from(text);
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let format = match extension.as_deref() {
            Some("png") => Format::Png,
            Some("exr") => Format::Exr,
            Some("pfm") => Format::Pfm,
            _ => {
                let what = match extension {
                    Some(extension) => format!("{text:?} has the unknown extension .{extension}"),
                    None => format!("{text:?} has no extension that names a format"),
                };
                let mend = "use .png, .exr or .pfm, or - for a PNG to standard output";
                return Err(Error::usage("--output", what, mend));
            }
        };
        Ok(Target::File { path, format })
    }

    /// Whether an image can be written there together with its layers: only as EXR.
    pub fn can_hold_layers(&self) -> bool {
        matches!(self, Target::File { format: Format::Exr, .. })
    }

    /// Fails now if [`write_with_layers`] would fail for having layers.
    pub fn check_layers(&self) -> Result<()> {
        if self.can_hold_layers() {
            return Ok(());
        }
        let what = match self {
            Target::File { path, .. } => format!("{} can't hold layers", path.display()),
            Target::Stdout => "the PNG to standard output can't hold layers".into(),
        };
        Err(Error::usage("--aov", what, "use an --output that ends in .exr"))
    }

    /// Fails now if writing would fail after the render.
    pub fn check_writable(&self) -> Result<()> {
        match self {
            Target::File { path, .. } => file::check_writable(path),
            Target::Stdout if io::stdout().is_terminal() => Err(Error::usage(
                "--output",
                "standard output is a terminal, which can't show a PNG",
                "redirect it to a file or a program, or name a file",
            )),
            Target::Stdout => Ok(()),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::File { path, .. } => path.display().fmt(f),
            Target::Stdout => f.write_str("standard output"),
        }
    }
}

/// Writes `image` to `target`, a file whole or not at all. The same image and options always give the
/// same bytes.
pub fn write(image: &Image, target: &Target, options: &WriteOptions) -> Result<()> {
    write_with_layers(image, &[], target, options)
}

/// Writes `image` and its `layers` as [`write()`] does.
///
/// # Errors
/// Layers where the format can't hold them: see [`Target::check_layers`].
pub fn write_with_layers(
    image: &Image,
    layers: &[Layer],
    target: &Target,
    options: &WriteOptions,
) -> Result<()> {
    if !layers.is_empty() {
        target.check_layers()?;
    }
    match target {
        Target::File { path, format } => {
            // Encoded before the file is made: what can't be encoded costs no write.
            let bytes = encode_with_layers(image, layers, *format, options)
                .map_err(|source| refused(path, source))?;
            file::write_whole(path, |writer| writer.write_all(&bytes))
        }
        Target::Stdout => {
            let name = Path::new("standard output");
            let bytes = encode(image, Format::Png, options).map_err(|source| refused(name, source))?;
            let mut stdout = io::stdout().lock();
            stdout.write_all(&bytes).and_then(|()| stdout.flush()).map_err(|source| Error::Write {
                path: name.into(),
                source,
                mend: "check the program that reads it".into(),
            })
        }
    }
}

fn refused(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.into(), source, mend: "change the image's size, layers or metadata".into() }
}

/// The bytes of a file.
pub fn encode(image: &Image, format: Format, options: &WriteOptions) -> io::Result<Vec<u8>> {
    encode_with_layers(image, &[], format, options)
}

/// The bytes of a file that holds layers, too.
pub fn encode_with_layers(
    image: &Image,
    layers: &[Layer],
    format: Format,
    options: &WriteOptions,
) -> io::Result<Vec<u8>> {
    let pixels = u64::from(image.width) * u64::from(image.height);
    if pixels == 0 || image.pixels.len() as u64 != pixels {
        let what =
            format!("{} pixels are no image of {} × {}", image.pixels.len(), image.width, image.height);
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    }
    if !layers.is_empty() && format != Format::Exr {
        let what = format!("{format:?} holds no layers");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    }
    let mut bytes = Cursor::new(Vec::new());
    match format {
        Format::Png => png::encode(image, options, &mut bytes)?,
        Format::Exr => exr::encode(image, layers, options, &mut bytes)?,
        Format::Pfm => pfm::encode(image, &mut bytes)?,
    }
    Ok(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::read::{read, read_layers};
    use crate::settings::Encoding;

    fn picture() -> Image {
        let mut image = Image::new(19, 11);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32 / 209.0, 0.0, 1.0];
        }
        image
    }

    #[test]
    fn extension_names_the_format() {
        let format = |text| match Target::parse(text).unwrap() {
            Target::File { format, .. } => format,
            Target::Stdout => panic!("{text} is a file"),
        };
        assert_eq!(format("a.png"), Format::Png);
        assert_eq!(format("dir.d/B.EXR"), Format::Exr);
        assert_eq!(format("x.tar.Pfm"), Format::Pfm);
        assert_eq!(Target::parse("-").unwrap(), Target::Stdout);
        for text in ["a.jpg", "a", "", "png", ".png", "a.png/", "a."] {
            match Target::parse(text) {
                // A closing slash is dropped from a path; the folder test finds it.
                Ok(_) => assert_eq!(text, "a.png/"),
                Err(error) => {
                    let message = error.to_string();
                    assert!(message.starts_with("--output: "), "{message}");
                    assert!(message.contains("use .png, .exr or .pfm"), "{message}");
                    assert_eq!(error.exit_code(), crate::error::EXIT_USAGE);
                }
            }
        }
    }

    #[test]
    fn files_come_back_and_are_the_same_each_time() {
        let folder = tempfile::tempdir().unwrap();
        let options = WriteOptions {
            encoding: Encoding::Srgb,
            metadata: (0..9).map(|i| (format!("key{i}"), i.to_string())).collect(),
        };
        for name in ["a.png", "a.exr", "a.pfm"] {
            let path = folder.path().join(name);
            let target = Target::parse(path.to_str().unwrap()).unwrap();
            target.check_writable().unwrap();
            write(&picture(), &target, &options).unwrap();
            let first = std::fs::read(&path).unwrap();
            write(&picture(), &target, &options).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), first, "{name}");
            let back = read(&path).unwrap();
            if name == "a.png" {
                // Eight bits: half a step of the display value, at most.
                for (a, b) in back.pixels.as_flattened().iter().zip(picture().pixels.as_flattened()) {
                    assert!((a - b).abs() < 0.5 / 255.0 * 2.4, "{a} {b}");
                }
            } else {
                assert_eq!(back, picture());
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn layers_go_into_exr_alone() {
        let folder = tempfile::tempdir().unwrap();
        let layers = [Layer::depth(vec![2.5; 209])];
        for name in ["a.png", "a.exr", "a.pfm", "-"] {
            let path = folder.path().join(name);
            let target = Target::parse(if name == "-" { name } else { path.to_str().unwrap() }).unwrap();
            let written = write_with_layers(&picture(), &layers, &target, &WriteOptions::default());
            assert_eq!(target.can_hold_layers(), name == "a.exr");
            assert_eq!(path.exists(), name == "a.exr");
            if name == "a.exr" {
                written.unwrap();
                let found = read_layers(&path).unwrap();
                assert_eq!((found.image, found.layers, found.is_hdr), (picture(), layers.to_vec(), true));
            } else {
                let error = written.unwrap_err();
                let message = error.to_string();
                assert!(message.starts_with("--aov: ") && message.contains("ends in .exr"), "{message}");
                assert_eq!(error.exit_code(), crate::error::EXIT_USAGE);
            }
        }
    }

    #[test]
    fn impossible_images_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.exr", "a.pfm"] {
            let path = folder.path().join(name);
            let target = Target::parse(path.to_str().unwrap()).unwrap();
            for image in
                [Image::new(0, 0), Image::new(0, 4), Image { width: 2, height: 2, pixels: vec![[0.0; 3]] }]
            {
                let message = write(&image, &target, &WriteOptions::default()).unwrap_err().to_string();
                assert!(message.contains("are no image of"), "{message}");
            }
            assert!(!path.exists());
        }
    }
}
