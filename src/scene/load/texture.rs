//! Image files in, [`Texture`] out; each file once per scene. Knows no material and no scene format.

use std::collections::HashMap;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};

use super::{Budget, files};
use crate::error::{Error, Result};
use crate::scene::Texture;

/// The textures of a scene that is being read, in the order in which they were first asked for.
#[derive(Debug, Default)]
pub struct Textures {
    textures: Vec<Texture>,
    index: HashMap<PathBuf, u32>,
}

impl Textures {
    /// Index of the texture in the file at `path`, which is read when it is asked for the first time.
    ///
    /// # Errors
    /// As [`load`].
    pub fn load(&mut self, path: &Path) -> Result<u32> {
        let key = path.canonicalize().map_err(|source| Error::read(path, source))?;
        if let Some(&index) = self.index.get(&key) {
            return Ok(index);
        }
        let index = self.textures.len() as u32;
        self.textures.push(load(path)?);
        self.index.insert(key, index);
        Ok(index)
    }

    /// All textures, by index.
    pub fn into_vec(self) -> Vec<Texture> {
        self.textures
    }
}

/// Reads a BMP, JPEG, PNG or TGA file as 8-bit sRGB; opacity is left out, deeper channels are rounded to 8 bits.
/// Its content says which format it is; only TGA is known by its extension.
///
/// # Errors
/// A file that can't be read, isn't one of these formats, is broken, holds no pixels or doesn't fit into memory.
pub fn load(path: &Path) -> Result<Texture> {
    load_within(path, Budget::of_machine())
}

fn load_within(path: &Path, budget: Budget) -> Result<Texture> {
    let file = files::open(path)?;
    let mut reader = ImageReader::new(BufReader::new(file));
    if let Ok(format) = image::ImageFormat::from_path(path) {
        reader.set_format(format);
    }
    let reader = reader.with_guessed_format().map_err(|source| Error::read(path, source))?;
    let mut decoder = reader.into_decoder().map_err(|error| broken(path, error))?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(Error::scene(path, None, "the image has no pixels", "give an image of at least 1x1"));
    }
    // A few bytes can claim any size, so the size is asked for before anything of it is reserved.
    let texels = u64::from(width) * u64::from(height);
    let needed = decoder.total_bytes().saturating_add(6 * texels);
    if let Some(shortage) = budget.lacks(needed) {
        let what = format!("an image of {width}x{height} pixels needs {shortage}");
        return Err(Error::scene(path, None, what, "make the image smaller"));
    }
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(needed);
    decoder.set_limits(limits).map_err(|error| broken(path, error))?;
    let image = DynamicImage::from_decoder(decoder).map_err(|error| broken(path, error))?.into_rgb8();
    let texels: Vec<_> = image.pixels().map(|pixel| pixel.0).collect();
    Ok(Texture { width, height, texels: texels.into() })
}

fn broken(path: &Path, error: ImageError) -> Error {
    match error {
        ImageError::IoError(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::read(path, source)
        }
        ImageError::Unsupported(_) => Error::scene(
            path,
            None,
            "not an image that can be read as a texture",
            "convert it to PNG, JPEG, BMP or TGA",
        ),
        error => {
            let reason = error.to_string().replace('\n', " ");
            Error::scene(path, None, format!("broken image: {reason}"), "write the image anew")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    #[test]
    fn every_format_gives_its_texels() {
        let folder = tempfile::tempdir().unwrap();
        let mut image = RgbImage::new(3, 2);
        image.put_pixel(0, 0, Rgb([255, 0, 0]));
        image.put_pixel(2, 1, Rgb([1, 2, 3]));
        for extension in ["png", "bmp", "tga"] {
            let path = folder.path().join(format!("image.{extension}"));
            image.save(&path).unwrap();
            let texture = load(&path).unwrap();
            assert_eq!((texture.width, texture.height), (3, 2));
            assert_eq!(texture.texels, [[255, 0, 0], [0; 3], [0; 3], [0; 3], [0; 3], [1, 2, 3]]);
        }
        let path = folder.path().join("image.jpg");
        RgbImage::from_pixel(8, 8, Rgb([200, 200, 200])).save(&path).unwrap();
        assert!(load(&path).unwrap().texels.iter().all(|texel| texel.iter().all(|c| c.abs_diff(200) < 3)));
    }

    #[test]
    fn each_file_is_read_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        RgbImage::new(1, 1).save(&path).unwrap();
        RgbImage::new(2, 1).save(folder.path().join("b.png")).unwrap();
        let mut textures = Textures::default();
        assert_eq!(textures.load(&path).unwrap(), 0);
        assert_eq!(textures.load(&folder.path().join("b.png")).unwrap(), 1);
        std::fs::write(&path, "gone").unwrap();
        assert_eq!(textures.load(&folder.path().join("./a.png")).unwrap(), 0);
        assert_eq!(textures.into_vec().iter().map(|texture| texture.width).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str, content: Option<&[u8]>| {
            let path = folder.path().join(name);
            if let Some(content) = content {
                std::fs::write(&path, content).unwrap();
            }
            let text = Textures::default().load(&path).unwrap_err().to_string();
            assert!(text.contains(name) && !text.contains('\n'), "{text}");
            text
        };
        assert!(error("missing.png", None).contains("can't read"));
        assert!(error("text.png", Some(b"hello")).contains("broken image"));
        assert!(error("text.txt", Some(b"hello")).contains("convert it to PNG"));
        assert!(error("empty.png", Some(b"")).contains("broken image"));
        let whole = folder.path().join("whole.png");
        RgbImage::new(64, 64).save(&whole).unwrap();
        let bytes = std::fs::read(&whole).unwrap();
        assert!(error("half.png", Some(&bytes[..bytes.len() / 2])).contains("broken image"));
    }

    /// A TGA file that is nothing but a header which claims 65535 x 65535 texels.
    const BOMB: [u8; 18] = [0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 24, 0];

    #[test]
    fn a_size_beyond_memory_is_refused_before_it_is_reserved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bomb.tga");
        std::fs::write(&path, BOMB).unwrap();
        let error = load_within(&path, Budget::of_bytes(1 << 30)).unwrap_err().to_string();
        let expected = "bomb.tga: an image of 65535x65535 pixels needs about 36.0 GiB of memory, but 1.0 GiB are available; \
             make the image smaller";
        assert!(error.ends_with(expected), "{error}");
        // Within the budget it is only a file that ends too early.
        let mut small = BOMB;
        small[13] = 1;
        small[15] = 1;
        std::fs::write(&path, small).unwrap();
        let error = load_within(&path, Budget::of_bytes(1 << 30)).unwrap_err().to_string();
        assert!(error.contains("broken image"), "{error}");
    }
}
