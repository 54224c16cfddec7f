//! Image files in, [`Environment`] out.

use std::path::Path;

use super::files;
use crate::error::{Error, Result};
use crate::image::read;
use crate::scene::Environment;

/// Reads an image of all directions around (latitude and longitude): OpenEXR or PFM as linear radiance, PNG decoded to it.
///
/// # Errors
/// A file that can't be read or isn't one of these formats, or a texel that is negative or not finite.
pub fn read(path: &Path, scale: f64, rotation: f64) -> Result<Environment> {
    drop(files::open(path)?);
    let image = read::read(path)?;
    if image.pixels.as_flattened().iter().any(|&c| !(c.is_finite() && c >= 0.0)) {
        return Err(Error::scene(
            path,
            None,
            "a pixel is negative or not finite, and no light",
            "clamp the image to 0 and above",
        ));
    }
    Ok(Environment { width: image.width, height: image.height, texels: image.pixels, scale, rotation })
}
