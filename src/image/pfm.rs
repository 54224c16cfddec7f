//! Portable float map: colour or grey f32, bottom row first. Knows no path.
//!
//! Format: <https://www.pauldebevec.com/Research/HDR/PFM/>. It has no place for metadata.

use std::io::{self, Write};

use super::format::{Broken, check_size, pixel_buffer};
use crate::image::Image;

/// Writes a colour PFM, little endian.
pub fn encode(image: &Image, writer: &mut impl Write) -> io::Result<()> {
    // The sign of the scale gives the byte order, negative meaning little endian.
    write!(writer, "PF\n{} {}\n-1.0\n", image.width, image.height)?;
    for row in image.pixels.chunks_exact(image.width as usize).rev() {
        for value in row.as_flattened() {
            writer.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Reads a colour or grey PFM of either byte order. The size of its scale is ignored, as all readers do.
pub(super) fn decode(bytes: &[u8]) -> Result<Image, Broken> {
    let mut rest = bytes;
    let channels = match word(&mut rest)? {
        "PF" => 3,
        "Pf" => 1,
        other => return Err(Broken(format!("{other:?} is not a PFM type"))),
    };
    let [width, height] = [integer(word(&mut rest)?)?, integer(word(&mut rest)?)?];
    let scale = word(&mut rest)?;
    let little = match scale.parse::<f32>() {
        Ok(scale) if scale.is_finite() && scale != 0.0 => scale < 0.0,
        _ => return Err(Broken(format!("the PFM scale {scale:?} is not a number other than 0"))),
    };
    // One float a channel: a byte never holds more than a pixel.
    check_size(width, height, rest.len(), 1)?;
    let wanted = width * height * channels * 4;
    if rest.len() as u64 != wanted {
        return Err(Broken(format!("it holds {} bytes of pixels, not {wanted}", rest.len())));
    }

    let value = |four: &[u8]| {
        let four = [four[0], four[1], four[2], four[3]];
        if little { f32::from_le_bytes(four) } else { f32::from_be_bytes(four) }
    };
    let mut pixels = pixel_buffer(width, height)?;
    for row in rest.chunks_exact((width * channels * 4) as usize).rev() {
        if channels == 3 {
            pixels.extend(row.chunks_exact(12).map(|p| [value(p), value(&p[4..]), value(&p[8..])]));
        } else {
            pixels.extend(row.chunks_exact(4).map(|p| [value(p); 3]));
        }
    }
    Ok(Image { width: width as u32, height: height as u32, pixels })
}

/// The next word of the header. Exactly one byte of white space follows it: after the last word of
/// the header, the next byte is already a pixel's.
fn word<'a>(rest: &mut &'a [u8]) -> Result<&'a str, Broken> {
    let cut = || Broken("the PFM header is incomplete".into());
    let start = rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(cut)?;
    let from = &rest[start..];
    let end = from.iter().position(u8::is_ascii_whitespace).ok_or_else(cut)?;
    *rest = &from[end + 1..];
    // Numbers in headers are short; what is long is shown to nobody.
    std::str::from_utf8(&from[..end])
        .ok()
        .filter(|word| word.len() <= 40)
        .ok_or_else(|| Broken("the PFM header is not text".into()))
}

fn integer(word: &str) -> Result<u64, Broken> {
    word.parse::<u32>()
        .map(u64::from)
        .map_err(|_| Broken(format!("the PFM size {word:?} is not a whole number")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_the_format() {
        let image = Image { width: 1, height: 2, pixels: vec![[1.0, 0.0, -2.0], [0.5, 0.25, 8.0]] };
        let mut bytes = Vec::new();
        encode(&image, &mut bytes).unwrap();
        let mut wanted = b"PF\n1 2\n-1.0\n".to_vec();
        // Bottom row first.
        for value in [0.5f32, 0.25, 8.0, 1.0, 0.0, -2.0] {
            wanted.extend(value.to_le_bytes());
        }
        assert_eq!(bytes, wanted);
        assert_eq!(decode(&bytes).unwrap(), image);
    }

    #[test]
    fn big_endian_and_grey_are_read() {
        let mut bytes = b"Pf\n2 1\n1.0\n".to_vec();
        bytes.extend(3.0f32.to_be_bytes());
        // A first byte of white space must not be taken for the header's.
        bytes.extend([0x20, 0, 0, 0]);
        let image = decode(&bytes).unwrap();
        assert_eq!(image.pixels, [[3.0; 3], [f32::from_bits(0x2000_0000); 3]]);
    }

    #[test]
    fn wrong_headers_are_refused() {
        for (header, what) in [
            ("PF\n0 2\n-1.0\n", "0 pixels"),
            ("PF\n-1 2\n-1.0\n", "whole number"),
            ("PF\n4294967295 4294967295\n-1.0\n", "4294967295 × 4294967295"),
            ("PF\n2 2\nx\n", "scale"),
            ("PF\n2 2\n0\n", "scale"),
            ("PF\n2 2\nnan\n", "scale"),
            ("PF\n1 1\n-1.0\n0123456789", "10 bytes of pixels, not 12"),
            ("PF\n1 1", "incomplete"),
        ] {
            let Broken(message) = decode(header.as_bytes()).unwrap_err();
            assert!(message.contains(what), "{header:?}: {message}");
        }
    }
}
