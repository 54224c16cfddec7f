//! PNG: eight bits of RGB out; eight or sixteen bits of anything in. Knows no path.

use std::io::{self, Cursor, Write};

use ::png::{
    BitDepth, ColorType, Compression, Decoder, Encoder, ScaledFloat, SrgbRenderingIntent, Transformations,
};

use super::format::{Broken, WriteOptions, check_size, pixel_buffer};
use super::transfer::{linear_from_srgb, quantize};
use crate::image::Image;
use crate::settings::Encoding;

/// Writes 8-bit RGB. sRGB values carry an sRGB chunk, linear ones gAMA 1.0; metadata become tEXt
/// chunks, or iTXt where Latin-1 can't hold them.
pub fn encode(image: &Image, options: &WriteOptions, writer: &mut impl Write) -> io::Result<()> {
    let mut encoder = Encoder::new(writer, image.width, image.height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    // A quarter of the default's time for files of the same size: rank 0 writes while the others wait.
    encoder.set_compression(Compression::Fast);
    match options.encoding {
        Encoding::Srgb => encoder.set_source_srgb(SrgbRenderingIntent::Perceptual),
        Encoding::Linear => encoder.set_source_gamma(ScaledFloat::new(1.0)),
    }
    for (key, text) in &options.metadata {
        // tEXt allows printable Latin-1 and newlines.
        let latin1 = text.chars().all(|c| matches!(c, '\n' | ' '..='~' | '\u{a1}'..='\u{ff}'));
        if latin1 {
            encoder.add_text_chunk(key.clone(), text.clone())?;
        } else {
            encoder.add_itxt_chunk(key.clone(), text.clone())?;
        }
    }
    let bytes: Vec<u8> =
        image.pixels.as_flattened().iter().map(|&value| quantize(value, options.encoding)).collect();
    let mut png = encoder.write_header()?;
    png.write_image_data(&bytes)?;
    png.finish()?;
    Ok(())
}

/// Reads any PNG to linear values. Alpha is ignored; the values are taken as sRGB unless the file
/// says that they are linear (gAMA 1.0 without sRGB, or cICP with transfer 8).
pub(super) fn decode(bytes: &[u8]) -> Result<Image, Broken> {
    let mut decoder = Decoder::new(Cursor::new(bytes));
    // What text and profiles unpack to is bounded by nothing.
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(broken)?;
    let (width, height) = (u64::from(header.width), u64::from(header.height));
    // Deflate packs at most 1032:1, and a byte holds at most eight pixels.
    check_size(width, height, bytes.len(), 8 * 1032)?;

    let mut reader = decoder.read_info().map_err(broken)?;
    let linear = is_linear(reader.info());
    let (color, depth) = reader.output_color_type();
    let size = reader.output_buffer_size().ok_or_else(|| Broken("it is too large".into()))?;
    let mut samples = Vec::new();
    samples.try_reserve_exact(size).map_err(|_| Broken("it is too large for this machine".into()))?;
    samples.resize(size, 0);
    reader.next_frame(&mut samples).map_err(broken)?;

    let decode = |display: f64| if linear { display } else { linear_from_srgb(display) };
    let values: Vec<f32> = match depth {
        BitDepth::Sixteen => {
            let table: Vec<f32> = (0..=u16::MAX).map(|v| decode(f64::from(v) / 65535.0) as f32).collect();
            let pairs = samples.chunks_exact(2);
            pairs.map(|pair| table[usize::from(u16::from_be_bytes([pair[0], pair[1]]))]).collect()
        }
        _ => {
            let table: Vec<f32> = (0..=u8::MAX).map(|v| decode(f64::from(v) / 255.0) as f32).collect();
            samples.iter().map(|&v| table[usize::from(v)]).collect()
        }
    };
    let mut pixels = pixel_buffer(width, height)?;
    match color {
        ColorType::Grayscale => pixels.extend(values.iter().map(|&v| [v; 3])),
        ColorType::GrayscaleAlpha => pixels.extend(values.chunks_exact(2).map(|p| [p[0]; 3])),
        ColorType::Rgb => pixels.extend(values.chunks_exact(3).map(|p| [p[0], p[1], p[2]])),
        ColorType::Rgba => pixels.extend(values.chunks_exact(4).map(|p| [p[0], p[1], p[2]])),
        ColorType::Indexed => return Err(Broken("its palette can't be expanded".into())),
    }
    Ok(Image { width: width as u32, height: height as u32, pixels })
}

fn is_linear(info: &::png::Info) -> bool {
    if let Some(points) = &info.coding_independent_code_points {
        return points.transfer_function == 8;
    }
    let gamma = info.gama_chunk.map(ScaledFloat::into_value);
    info.srgb.is_none() && gamma.is_some_and(|gamma| (gamma - 1.0).abs() < 0.01)
}

fn broken(error: ::png::DecodingError) -> Broken {
    Broken(format!("not a sound PNG: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(image: &Image, encoding: Encoding, metadata: &[(&str, &str)]) -> Vec<u8> {
        let metadata = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
        let mut bytes = Vec::new();
        encode(image, &WriteOptions { encoding, metadata }, &mut bytes).unwrap();
        bytes
    }

    /// Offset of a chunk's type, or none.
    fn chunk(bytes: &[u8], name: &[u8; 4]) -> Option<usize> {
        bytes.windows(4).position(|window| window == name)
    }

    #[test]
    fn every_byte_survives_the_round_trip() {
        for encoding in [Encoding::Srgb, Encoding::Linear] {
            let mut image = Image::new(256, 3);
            for (i, pixel) in image.pixels.iter_mut().enumerate() {
                let display = (i % 256) as f64 / 255.0;
                let value =
                    if encoding == Encoding::Srgb { linear_from_srgb(display) } else { display } as f32;
                pixel[i / 256] = value;
            }
            assert_eq!(decode(&encoded(&image, encoding, &[])).unwrap(), image, "{encoding:?}");
        }
    }

    #[test]
    fn the_file_says_how_it_is_encoded() {
        let image = Image::new(2, 2);
        let srgb = encoded(&image, Encoding::Srgb, &[]);
        assert!(chunk(&srgb, b"sRGB").is_some());
        let linear = encoded(&image, Encoding::Linear, &[]);
        let gama = chunk(&linear, b"gAMA").unwrap();
        assert_eq!(linear[gama + 4..gama + 8], 100_000u32.to_be_bytes());
        assert!(chunk(&linear, b"sRGB").is_none());
    }

    #[test]
    fn metadata_are_in_the_file() {
        let image = Image::new(2, 2);
        let metadata = [("seed", "7"), ("title", "Größe"), ("note", "反射")];
        let bytes = encoded(&image, Encoding::Srgb, &metadata);
        let reader = Decoder::new(Cursor::new(&bytes)).read_info().unwrap();
        let info = reader.info();
        let texts: Vec<_> =
            info.uncompressed_latin1_text.iter().map(|t| (t.keyword.as_str(), t.text.as_str())).collect();
        assert_eq!(texts, metadata[..2]);
        assert_eq!(info.utf8_text[0].keyword, "note");
        assert_eq!(info.utf8_text[0].get_text().unwrap(), "反射");
    }

    #[test]
    fn unusable_key_is_an_error() {
        for key in ["", "反", &"k".repeat(80)] {
            let options =
                WriteOptions { metadata: vec![(key.to_string(), "v".into())], ..WriteOptions::default() };
            assert!(encode(&Image::new(1, 1), &options, &mut Vec::new()).is_err(), "{key:?}");
        }
    }

    #[test]
    fn other_kinds_are_read() {
        let write = |color, depth, palette: Option<&[u8]>, data: &[u8]| {
            let mut bytes = Vec::new();
            let mut encoder = Encoder::new(&mut bytes, 2, 1);
            encoder.set_color(color);
            encoder.set_depth(depth);
            if let Some(palette) = palette {
                encoder.set_palette(palette);
            }
            encoder.write_header().unwrap().write_image_data(data).unwrap();
            decode(&bytes).unwrap().pixels
        };
        let (half, one) = (linear_from_srgb(128.0 / 255.0) as f32, 1.0);
        assert_eq!(write(ColorType::Grayscale, BitDepth::Eight, None, &[128, 255]), [[half; 3], [one; 3]]);
        assert_eq!(write(ColorType::Grayscale, BitDepth::One, None, &[0b0100_0000]), [[0.0; 3], [one; 3]]);
        assert_eq!(
            write(ColorType::Rgba, BitDepth::Eight, None, &[255, 128, 0, 9, 0, 0, 255, 0]),
            [[one, half, 0.0], [0.0, 0.0, one]]
        );
        assert_eq!(
            write(ColorType::Indexed, BitDepth::One, Some(&[255, 0, 0, 0, 128, 0]), &[0b0100_0000]),
            [[one, 0.0, 0.0], [0.0, half, 0.0]]
        );
        let sixteen = write(ColorType::Grayscale, BitDepth::Sixteen, None, &[0x40, 0, 0xff, 0xff]);
        assert_eq!(sixteen, [[linear_from_srgb(16384.0 / 65535.0) as f32; 3], [one; 3]]);
    }
}
