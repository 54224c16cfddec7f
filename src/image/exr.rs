//! OpenEXR: f32 RGB and named layers out, lossless; any part with R, G, B or Y in. Knows no path.

use std::io::{self, Cursor, Seek, SeekFrom, Write};

use ::exr::block::reader::Reader;
use ::exr::image::{self, Blocks};
use ::exr::meta::attribute::{AttributeValue, LineOrder, Text};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::prelude::{Compression, ReadChannels, ReadLayers, ReadSpecificChannel, Vec2, WritableImage, read};

use super::exr_layers::{self, AllChannelsOf};
use super::format::{Broken, MAX_FILE_BYTES, WriteOptions, check_size, pixel_buffer};
use crate::image::{Image, Layer};

/// Stands before every metadata key, so that none meets one of OpenEXR's own attributes.
pub const KEY_PREFIX: &str = "heliostat:";

/// Most pixels that a byte of a file can stand for: a chunk has up to 256 lines and a head of its own.
const MAX_PIXELS_PER_BYTE: u64 = 1 << 16;

/// Writes the exact values, row 0 on top, ZIP compressed in blocks of 16 lines. Metadata become UTF-8
/// string attributes named `heliostat:KEY`. The layers are channels of the same part.
pub fn encode(
    image: &Image,
    layers: &[Layer],
    options: &WriteOptions,
    writer: &mut (impl Write + Seek),
) -> io::Result<()> {
    let (width, height) = (image.width as usize, image.height as usize);
    let mut attributes = LayerAttributes::default();
    for (key, text) in &options.metadata {
        if key.is_empty() || key.contains('\0') || key.len() + KEY_PREFIX.len() > 255 {
            let what = format!("the metadata key {key:?} doesn't fit into an EXR attribute");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        let name = utf8(&format!("{KEY_PREFIX}{key}"));
        attributes.other.insert(name, AttributeValue::Text(utf8(text)));
    }
    let encoding = image::Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channels = exr_layers::channels(image, layers)?;
    let mut bytes = Vec::new();
    image::Image::from_layer(image::Layer::new((width, height), attributes, encoding, channels))
        .write()
        .non_parallel()
        .to_buffered(Cursor::new(&mut bytes))
        .map_err(|error| match error {
            ::exr::error::Error::Io(error) => error,
            other => io::Error::other(other.to_string()),
        })?;
    sort_attributes(&mut bytes);
    writer.seek(SeekFrom::Start(0))?;
    writer.write_all(&bytes)
}

/// Puts the attributes of the header into the order of their names. The crate keeps them in a hash
/// map, whose order differs between two runs; their total length, and with it every offset, stays.
fn sort_attributes(bytes: &mut [u8]) {
    // Magic number and version, then NAME \0 TYPE \0 SIZE VALUE …, then \0.
    const START: usize = 8;
    let mut attributes = Vec::new();
    let mut at = START;
    while bytes[at] != 0 {
        let text_end = |from: usize| from + bytes[from..].iter().position(|&b| b == 0).unwrap_or(0);
        let name_end = text_end(at);
        let size_at = text_end(name_end + 1) + 1;
        let size = u32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[size_at + i]));
        let end = size_at + 4 + size as usize;
        attributes.push(bytes[at..end].to_vec());
        at = end;
    }
    // A name ends with \0, so that the bytes sort as the names do.
    attributes.sort();
    bytes[START..at].copy_from_slice(&attributes.concat());
}

fn utf8(text: &str) -> Text {
    Text::from_slice_unchecked(text.as_bytes())
}

/// Reads the data window of the first part that has the channels R, G and B, or Y alone.
pub(super) fn decode(bytes: &[u8]) -> Result<Image, Broken> {
    let (reader, which) = open(bytes)?;
    let header = &reader.headers()[which];

    // The crate fills what `create` returns; that can't fail, so the memory is asked for here.
    let (width, height) = (header.layer_size.x(), header.layer_size.y());
    drop(pixel_buffer(width as u64, height as u64)?);
    let create = |size: Vec2<usize>| Image::new(size.x() as u32, size.y() as u32);
    let index = |image: &Image, at: Vec2<usize>| at.y() * image.width as usize + at.x();
    let builder = read().no_deep_data().largest_resolution_level().specific_channels();
    if has_rgb(header) {
        builder
            .required("R")
            .required("G")
            .required("B")
            .collect_pixels(
                move |size, _| create(size),
                move |image: &mut Image, at, (r, g, b): (f32, f32, f32)| {
                    let index = index(image, at);
                    image.pixels[index] = [r, g, b];
                },
            )
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_chunks(reader)
            .map(|image| image.layer_data.channel_data.pixels)
    } else {
        builder
            .required("Y")
            .collect_pixels(
                move |size, _| create(size),
                move |image: &mut Image, at, (y,): (f32,)| {
                    let index = index(image, at);
                    image.pixels[index] = [y; 3];
                },
            )
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_chunks(reader)
            .map(|image| image.layer_data.channel_data.pixels)
    }
    .map_err(broken)
}

/// Reads the same image, and its part's channels whose names have a dot as layers.
pub(super) fn decode_layers(bytes: &[u8]) -> Result<(Image, Vec<Layer>), Broken> {
    let image = decode(bytes)?;
    let (reader, which) = open(bytes)?;
    let header = &reader.headers()[which];
    // As much twice: as the file has it, and as layers. The crate doesn't ask whether there is any.
    let unpacked = image.pixels.len() * header.channels.bytes_per_pixel;
    if Vec::<u8>::new().try_reserve_exact(2 * unpacked).is_err() {
        return Err(Broken(format!("its layers of {unpacked} bytes don't fit into memory")));
    }
    let wanted = if has_rgb(header) { has_rgb } else { has_y };
    let all = read().no_deep_data().largest_resolution_level().all_channels();
    AllChannelsOf { wanted, channels: all }
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_chunks(reader)
        .map(|part| (image, exr_layers::grouped(part.layer_data.channel_data)))
        .map_err(broken)
}

type Opened<'a> = Reader<Cursor<&'a [u8]>>;

/// Reads the headers, and finds the one whose part holds the image.
fn open(bytes: &[u8]) -> Result<(Opened<'_>, usize), Broken> {
    let reader = Reader::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    for header in reader.headers() {
        check_header(header, bytes.len())?;
    }
    let find = |wanted: fn(&Header) -> bool| reader.headers().iter().position(wanted);
    let Some(which) = find(has_rgb).or_else(|| find(has_y)) else {
        return Err(Broken("it has neither channels R, G, B nor Y".into()));
    };
    Ok((reader, which))
}

fn has_rgb(header: &Header) -> bool {
    ["R", "G", "B"].iter().all(|name| has(header, name))
}

fn has_y(header: &Header) -> bool {
    has(header, "Y")
}

fn has(header: &Header, name: &str) -> bool {
    header.channels.list.iter().any(|channel| channel.name.eq(name))
}

/// Refuses what the crate would take on trust: sizes that the file can't fill, channels of other sizes
/// than the image's, and the compressions whose decoders panic or allocate without bound on damaged
/// data (all of them lossy).
fn check_header(header: &Header, file_bytes: usize) -> Result<(), Broken> {
    let (width, height) = (header.layer_size.x() as u64, header.layer_size.y() as u64);
    check_size(width, height, file_bytes, MAX_PIXELS_PER_BYTE)?;
    let unpacked = (width * height).saturating_mul(header.channels.bytes_per_pixel as u64);
    if unpacked > MAX_FILE_BYTES {
        return Err(Broken(format!("it unpacks to {unpacked} bytes, more than {MAX_FILE_BYTES}")));
    }
    if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(Broken("its channels are subsampled, which isn't supported".into()));
    }
    match header.compression {
        Compression::Uncompressed
        | Compression::RLE
        | Compression::ZIP1
        | Compression::ZIP16
        | Compression::PIZ
        | Compression::PXR24 => Ok(()),
        other => Err(Broken(format!("{other} isn't supported, save it with ZIP or PIZ"))),
    }
}

fn broken(error: ::exr::error::Error) -> Broken {
    Broken(format!("not a sound EXR: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::exr::image::SpecificChannels;
    use ::exr::meta::MetaData;

    fn encoded(image: &Image, metadata: &[(&str, &str)]) -> Vec<u8> {
        let metadata = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
        let mut bytes = Cursor::new(Vec::new());
        encode(image, &[], &WriteOptions { metadata, ..WriteOptions::default() }, &mut bytes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn every_value_survives_the_round_trip() {
        let mut image = Image::new(37, 41);
        for (i, value) in image.pixels.as_flattened_mut().iter_mut().enumerate() {
            *value = libm::sinf(i as f32) * 1e3;
        }
        image.pixels[0] = [f32::INFINITY, -0.0, 1e-42];
        assert_eq!(decode(&encoded(&image, &[])).unwrap(), image);
    }

    #[test]
    fn metadata_are_attributes_in_one_order() {
        let image = Image::new(3, 2);
        let metadata =
            [("spp", "16"), ("version", "1"), ("a", "Größe 反射"), ("seed", "7"), ("long", &"x".repeat(999))];
        let bytes = encoded(&image, &metadata);
        // The crate's hash maps are seeded anew each time: were their order kept, some of these would differ.
        for _ in 0..20 {
            assert_eq!(encoded(&image, &metadata), bytes);
        }
        let meta = MetaData::read_from_buffered(Cursor::new(&bytes), true).unwrap();
        for (key, text) in metadata {
            let found = &meta.headers[0].own_attributes.other[&utf8(&format!("heliostat:{key}"))];
            assert_eq!(found, &AttributeValue::Text(utf8(text)));
        }
        assert_eq!(decode(&bytes).unwrap(), image);
    }

    #[test]
    fn unusable_key_is_an_error() {
        for key in ["", "a\0b", &"k".repeat(250)] {
            let options =
                WriteOptions { metadata: vec![(key.to_string(), "v".into())], ..WriteOptions::default() };
            assert!(
                encode(&Image::new(1, 1), &[], &options, &mut Cursor::new(Vec::new())).is_err(),
                "{key:?}"
            );
        }
    }

    #[test]
    fn what_cannot_be_read_safely_is_refused() {
        let image = |at: Vec2<usize>| (at.x() as f32, 0.0f32, 1.0f32);
        for (compression, readable) in [(Compression::PIZ, true), (Compression::B44, false)] {
            let encoding = image::Encoding { compression, ..image::Encoding::SMALL_LOSSLESS };
            let layer =
                image::Layer::new((9, 5), LayerAttributes::default(), encoding, SpecificChannels::rgb(image));
            let mut bytes = Cursor::new(Vec::new());
            image::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
            match decode(&bytes.into_inner()) {
                Ok(image) => assert!(readable && image.pixels[44] == [8.0, 0.0, 1.0]),
                Err(Broken(message)) => {
                    assert!(!readable && message.starts_with("b44 compression"), "{message}")
                }
            }
        }
    }

    #[test]
    fn luminance_alone_is_read_as_grey() {
        let channels = SpecificChannels::build()
            .with_channel::<f32>("Y")
            .with_pixel_fn(|at: Vec2<usize>| (at.x() as f32 + 10.0 * at.y() as f32,));
        let mut bytes = Cursor::new(Vec::new());
        image::Image::from_channels((2, 2), channels).write().non_parallel().to_buffered(&mut bytes).unwrap();
        let image = decode(&bytes.into_inner()).unwrap();
        assert_eq!(image.pixels, [[0.0; 3], [1.0; 3], [10.0; 3], [11.0; 3]]);
    }
}
