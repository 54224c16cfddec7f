//! Reading PNG, EXR and PFM files to linear values, told apart by their first bytes. A broken file is
//! an error, never a panic or an allocation beyond what a file of that length can hold.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::format::{Broken, MAX_FILE_BYTES};
use super::{exr, pfm, png};
use crate::error::{self, Error};
use crate::image::{Image, Layer};

/// What an image file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageFile {
    pub image: Image,
    /// Of EXR alone, in alphabetical order: the channels with a dot in the name beside R, G and B.
    pub layers: Vec<Layer>,
    /// Whether its values are scene-linear and not cut off at 1: EXR and PFM.
    pub is_hdr: bool,
}

impl ImageFile {
    /// The variance of every pixel's mean, where the file has it.
    pub fn variance(&self) -> Option<&[[f32; 3]]> {
        self.layer(Layer::VARIANCE)?.triples()
    }

    /// The degrees of freedom of these variances, where the file has them.
    pub fn freedom(&self) -> Option<&[f32]> {
        self.layer(Layer::FREEDOM)?.singles()
    }

    fn layer(&self, name: &str) -> Option<&Layer> {
        self.layers.iter().find(|layer| layer.name == name)
    }
}

/// Reads an image file to linear RGB. Its first bytes say what it is, not its name.
pub fn read(path: &Path) -> error::Result<Image> {
    read_as(path, decode)
}

/// Reads an image file as [`read`] does, with its layers.
pub fn read_layers(path: &Path) -> error::Result<ImageFile> {
    read_as(path, |bytes| {
        if bytes.starts_with(EXR) {
            let (image, layers) = exr::decode_layers(bytes)?;
            return Ok(ImageFile { image, layers, is_hdr: true });
        }
        let is_hdr = bytes.starts_with(b"P");
        decode(bytes).map(|image| ImageFile { image, layers: Vec::new(), is_hdr })
    })
}

fn read_as<T>(path: &Path, decode: impl FnOnce(&[u8]) -> Result<T, Broken>) -> error::Result<T> {
    let mut bytes = Vec::new();
    // No fixed length is asked for: a pipe has none.
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let length =
        file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(|source| Error::read(path, source))?;
    let decoded = if length as u64 > MAX_FILE_BYTES {
        Err(Broken(format!("it is longer than {} GiB", MAX_FILE_BYTES >> 30)))
    } else {
        decode(&bytes)
    };
    decoded.map_err(|Broken(what)| Error::scene(path, None, what, "give a sound PNG, EXR or PFM file"))
}

/// An EXR file's first bytes.
const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];

/// Decodes a whole file.
pub(super) fn decode(bytes: &[u8]) -> Result<Image, Broken> {
    match bytes {
        [] => Err(Broken("it is empty".into())),
        [0x89, b'P', b'N', b'G', ..] => png::decode(bytes),
        _ if bytes.starts_with(EXR) => exr::decode(bytes),
        [b'P', b'F' | b'f', ..] => pfm::decode(bytes),
        _ => Err(Broken("it is no PNG, EXR or PFM file".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::super::format::{WriteOptions, check_size};
    use super::*;
    use crate::output::write::{Format, encode};
    use crate::settings::Encoding;

    /// A small picture with some structure, so that compressors do something.
    fn picture() -> Image {
        let mut image = Image::new(45, 38);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel =
                [(i % 45) as f32 / 45.0, ((i * i) % 97) as f32 / 97.0, if i % 7 == 0 { 1.0 } else { 0.25 }];
        }
        image
    }

    fn files() -> Vec<(Format, Vec<u8>)> {
        let options = WriteOptions {
            encoding: Encoding::Srgb,
            metadata: vec![("spp".into(), "4".into()), ("seed".into(), "1".into())],
        };
        [Format::Png, Format::Exr, Format::Pfm]
            .map(|format| (format, encode(&picture(), format, &options).unwrap()))
            .into()
    }

    #[test]
    fn truncated_files_are_refused() {
        for (format, bytes) in files() {
            decode(&bytes).unwrap();
            // A PNG's pixels may be whole before its last chunks are; its closing chunk is 12 bytes.
            let needed = if format == Format::Png { bytes.len() - 16 } else { bytes.len() };
            for length in (0..needed).step_by(1 + needed / 700).chain(needed.saturating_sub(300)..needed) {
                assert!(decode(&bytes[..length]).is_err(), "{format:?} of {length} bytes of {}", bytes.len());
            }
        }
    }

    #[test]
    fn damaged_files_never_panic() {
        // xorshift: the same damage in every run.
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let mut random = move |below: usize| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state % below as u64) as usize
        };
        for (_, bytes) in files() {
            for round in 0..1500 {
                let mut damaged = bytes.clone();
                // Headers are where damage does most.
                let reach = if round % 2 == 0 { bytes.len().min(500) } else { bytes.len() };
                for _ in 0..=random(4) {
                    damaged[random(reach)] = random(256) as u8;
                }
                if let Ok(image) = decode(&damaged) {
                    assert_eq!(image.pixels.len() as u64, u64::from(image.width) * u64::from(image.height));
                }
            }
        }
    }

    #[test]
    fn absurd_sizes_are_refused_before_memory_is_asked_for() {
        let (_, mut png) = files().swap_remove(0);
        png[16..24].copy_from_slice(&[0, 0, 0x40, 0, 0, 0, 0x40, 0]);
        let checksum = crc32fast::hash(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.to_be_bytes());
        let Broken(message) = decode(&png).unwrap_err();
        assert!(message.contains("16384 × 16384 pixels can't be in"), "{message}");
        assert!(check_size(u64::from(u32::MAX), u64::from(u32::MAX), usize::MAX, 9).is_err());
        assert!(check_size(0, 5, 1000, 1).is_err());
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let message = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            read(&path).unwrap_err().to_string()
        };
        assert!(message("a.png", b"").ends_with("a.png: it is empty; give a sound PNG, EXR or PFM file"));
        assert!(message("b.png", b"GIF89a").contains("b.png: it is no PNG, EXR or PFM file"));
        assert!(read(&folder.path().join("none")).unwrap_err().to_string().contains("check the path"));
        assert!(read(folder.path()).is_err());
    }
}
