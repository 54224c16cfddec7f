//! What the image formats share: the options of writing, the limits of reading, and what a broken file is.

use crate::settings::Encoding;

/// What a written file depends on besides the pixels.
#[derive(Clone, Debug, Default)]
pub struct WriteOptions {
    /// Of PNG; EXR and PFM always hold linear values.
    pub encoding: Encoding,
    /// Keys and texts that go into PNG and EXR files, in this order. Keys: 1 to 79 Latin-1 characters.
    pub metadata: Vec<(String, String)>,
}

/// Most pixels that are read: 16384 × 16384.
pub const MAX_PIXELS: u64 = 1 << 28;
/// Longest file that is read, packed and unpacked: `MAX_PIXELS` of f32 RGBA, and some more.
pub(super) const MAX_FILE_BYTES: u64 = 5 << 30;

/// What is wrong with a file's bytes.
#[derive(Debug)]
pub(super) struct Broken(pub String);

/// Refuses sizes that are zero, above `MAX_PIXELS`, or beyond what `file_bytes` can stand for.
pub(super) fn check_size(
    width: u64,
    height: u64,
    file_bytes: usize,
    pixels_per_byte: u64,
) -> Result<(), Broken> {
    let pixels = width.saturating_mul(height);
    if pixels == 0 {
        return Err(Broken(format!("{width} × {height} is 0 pixels")));
    }
    if pixels > MAX_PIXELS {
        return Err(Broken(format!("{width} × {height} is more than {MAX_PIXELS} pixels")));
    }
    if pixels > (file_bytes as u64).saturating_mul(pixels_per_byte) {
        return Err(Broken(format!("{width} × {height} pixels can't be in {file_bytes} bytes")));
    }
    Ok(())
}

/// An empty buffer with room for all pixels, or an error where memory is short.
pub(super) fn pixel_buffer(width: u64, height: u64) -> Result<Vec<[f32; 3]>, Broken> {
    let mut pixels = Vec::new();
    match pixels.try_reserve_exact((width * height) as usize) {
        Ok(()) => Ok(pixels),
        Err(_) => Err(Broken(format!("{width} × {height} pixels don't fit into memory"))),
    }
}
