//! Named layers in the one part of an EXR file that holds the image: the channel C of a layer L is called
//! L.C, as programs that show such files expect it. Knows neither the rest of the format nor a path.

use std::io;

use ::exr::block::lines::LineRefMut;
use ::exr::block::samples::Sample;
use ::exr::error::{Error, Result};
use ::exr::image::read::any_channels::ReadAnyChannels;
use ::exr::image::read::samples::ReadFlatSamples;
use ::exr::image::write::samples::{SamplesWriter, WritableSamples};
use ::exr::image::{AnyChannel, AnyChannels, FlatSamples};
use ::exr::math::RoundingMode;
use ::exr::meta::attribute::{LevelMode, SampleType};
use ::exr::meta::header::Header;
use ::exr::prelude::{ReadChannels, Text, Vec2};

use crate::image::{Image, Layer, LayerSamples};

/// Longest name of a channel that readers of long names take.
const MAX_NAME: usize = 255;

/// One channel of interleaved samples.
#[derive(Clone, Copy)]
pub(super) struct Channel<'a> {
    samples: Samples<'a>,
    first: usize,
    stride: usize,
    width: usize,
}

#[derive(Clone, Copy)]
enum Samples<'a> {
    F32(&'a [f32]),
    U32(&'a [u32]),
}

/// The channels of the image and all its layers, in the order that the format demands.
///
/// # Errors
/// A name that no file can hold or that is there twice, or a layer of another size than the image's.
pub(super) fn channels<'a>(image: &'a Image, layers: &'a [Layer]) -> io::Result<AnyChannels<Channel<'a>>> {
    let width = image.width as usize;
    let mut list: Vec<AnyChannel<Channel<'a>>> = Vec::new();
    let mut push = |name: &str, samples, first, stride| {
        list.push(AnyChannel {
            name: Text::from_slice_unchecked(name.as_bytes()),
            sample_data: Channel { samples, first, stride, width },
            // Of use to lossy compression alone.
            quantize_linearly: false,
            sampling: Vec2(1, 1),
        });
    };
    for (first, name) in ["R", "G", "B"].into_iter().enumerate() {
        push(name, Samples::F32(image.pixels.as_flattened()), first, 3);
    }
    for layer in layers {
        let stride = layer.channels.len();
        let wanted = image.pixels.len() * stride;
        if layer.samples.len() != wanted || stride == 0 {
            let found = layer.samples.len();
            return Err(refused(&layer.name, &format!("holds {found} samples, not {wanted}")));
        }
        for (first, channel) in layer.channels.iter().enumerate() {
            let name = format!("{}.{channel}", layer.name);
            let sound = |part: &str| !part.is_empty() && !part.contains('\0');
            if !sound(&layer.name) || !sound(channel) || channel.contains('.') || name.len() > MAX_NAME {
                return Err(refused(&layer.name, "has a name that doesn't fit into a channel's"));
            }
            let samples = match &layer.samples {
                LayerSamples::F32(samples) => Samples::F32(samples),
                LayerSamples::U32(samples) => Samples::U32(samples),
            };
            push(&name, samples, first, stride);
        }
    }
    list.sort_by(|a, b| a.name.as_slice().cmp(b.name.as_slice()));
    if let Some(twice) = list.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return Err(refused(&twice[0].name.to_string(), "is there twice"));
    }
    Ok(AnyChannels { list: list.into() })
}

fn refused(name: &str, what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, format!("the layer {name:?} {what}"))
}

impl<'a> WritableSamples<'_> for Channel<'a> {
    type Writer = Channel<'a>;

    fn sample_type(&self) -> SampleType {
        match self.samples {
            Samples::F32(_) => SampleType::F32,
            Samples::U32(_) => SampleType::U32,
        }
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&self, _: &Header) -> Self::Writer {
        *self
    }
}

impl SamplesWriter for Channel<'_> {
    fn extract_line(&self, line: LineRefMut<'_>) {
        let Vec2(x, y) = line.location.position;
        let at = |i: usize| (y * self.width + x + i) * self.stride + self.first;
        let written = match self.samples {
            Samples::F32(samples) => line.write_samples(|i| samples[at(i)]),
            Samples::U32(samples) => line.write_samples(|i| samples[at(i)]),
        };
        written.expect("a line has room for its samples");
    }
}

/// Reads every channel of the first part that `wanted` accepts, whatever other parts there are.
pub(super) struct AllChannelsOf<W> {
    pub wanted: W,
    pub channels: ReadAnyChannels<ReadFlatSamples>,
}

impl<'s, W: Fn(&Header) -> bool> ReadChannels<'s> for AllChannelsOf<W> {
    type Reader = <ReadAnyChannels<ReadFlatSamples> as ReadChannels<'s>>::Reader;

    fn create_channels_reader(&'s self, header: &Header) -> Result<Self::Reader> {
        if (self.wanted)(header) {
            self.channels.create_channels_reader(header)
        } else {
            Err(Error::Invalid("no image in this part".into()))
        }
    }
}

/// Puts channels whose names have a dot together: what stands before the last dot names the layer. Half
/// floats become floats, and so do all samples of a layer that has both floats and integers.
pub(super) fn grouped(channels: AnyChannels<FlatSamples>) -> Vec<Layer> {
    let mut groups: Vec<(String, Vec<(String, FlatSamples)>)> = Vec::new();
    for channel in channels.list {
        let name = channel.name.to_string();
        let Some((layer, channel_name)) = name.rsplit_once('.') else { continue };
        let member = (channel_name.to_owned(), channel.sample_data);
        match groups.iter_mut().find(|(name, _)| name == layer) {
            Some((_, members)) => members.push(member),
            None => groups.push((layer.to_owned(), vec![member])),
        }
    }
    groups.into_iter().map(|(name, members)| interleaved(name, members)).collect()
}

fn interleaved(name: String, mut members: Vec<(String, FlatSamples)>) -> Layer {
    // A file has them by the alphabet: blue before red.
    let rank = |name: &str| ["R", "G", "B", "A", "X", "Y", "Z"].iter().position(|&n| n == name);
    members.sort_by(|(a, _), (b, _)| (rank(a).is_none(), rank(a), a).cmp(&(rank(b).is_none(), rank(b), b)));
    let count = members.first().map_or(0, |(_, samples)| samples.len());
    let pixels = (0..count).flat_map(|i| members.iter().map(move |(_, samples)| (samples, i)));
    let samples = if members.iter().all(|(_, samples)| matches!(samples, FlatSamples::U32(_))) {
        LayerSamples::U32(pixels.map(|(samples, i)| samples.value_by_flat_index(i).to_u32()).collect())
    } else {
        let float = |sample: Sample| sample.to_f32();
        LayerSamples::F32(pixels.map(|(samples, i)| float(samples.value_by_flat_index(i))).collect())
    };
    Layer { name, channels: members.into_iter().map(|(name, _)| name).collect(), samples }
}

#[cfg(test)]
mod tests {
    use super::super::format::WriteOptions;
    use super::super::{exr, read};
    use super::*;
    use crate::output::write::{Format, encode_with_layers};

    fn picture() -> (Image, Vec<Layer>) {
        let mut image = Image::new(5, 18);
        for (i, value) in image.pixels.as_flattened_mut().iter_mut().enumerate() {
            *value = i as f32 * 0.25;
        }
        let triples = |scale: f32| (0..90).map(|i| [i as f32 * scale, -scale, 0.5]).collect();
        let layers = vec![
            Layer::variance(triples(1e-30)),
            Layer::freedom((0..90).map(|i| i as f32 / 3.0).collect()),
            Layer::albedo(triples(0.01)),
            Layer::normal(triples(-1.0)),
            Layer::position(triples(1e9)),
            Layer::depth((0..90).map(|i| i as f32).collect()),
            Layer::id((0..90).map(|i| u32::MAX - i).collect()),
        ];
        (image, layers)
    }

    fn encoded(image: &Image, layers: &[Layer]) -> io::Result<Vec<u8>> {
        encode_with_layers(image, layers, Format::Exr, &WriteOptions::default())
    }

    #[test]
    fn every_layer_survives_the_round_trip() {
        let (image, layers) = picture();
        let bytes = encoded(&image, &layers).unwrap();
        let (read_image, mut read_layers) = exr::decode_layers(&bytes).unwrap();
        assert_eq!(read_image, image);
        assert_eq!(read::decode(&bytes).unwrap(), image);
        // In the file they stand by the alphabet.
        let names: Vec<&str> = read_layers.iter().map(|layer| layer.name.as_str()).collect();
        assert_eq!(names, ["albedo", "depth", "freedom", "id", "normal", "position", "variance"]);
        read_layers.sort_by_key(|layer| layers.iter().position(|l| l.name == layer.name));
        assert_eq!(read_layers, layers);
        assert_eq!(layers[6].samples, LayerSamples::U32((0..90).map(|i| u32::MAX - i).collect()));
    }

    #[test]
    fn one_part_of_sorted_channels_and_the_same_bytes_each_time() {
        let (image, mut layers) = picture();
        let bytes = encoded(&image, &layers).unwrap();
        layers.reverse();
        assert_eq!(encoded(&image, &layers).unwrap(), bytes);
        let meta = ::exr::meta::MetaData::read_from_buffered(io::Cursor::new(&bytes), true).unwrap();
        assert_eq!(meta.headers.len(), 1);
        let names: Vec<String> = meta.headers[0].channels.list.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(
            names.join(" "),
            "B G R albedo.B albedo.G albedo.R depth.Z freedom.N id.I normal.X normal.Y normal.Z position.X position.Y \
             position.Z variance.B variance.G variance.R"
        );
        assert_eq!(meta.headers[0].channels.list[8].sample_type, SampleType::U32);
    }

    #[test]
    fn layers_that_no_file_can_hold_are_refused() {
        let image = Image::new(2, 1);
        let depth = || Layer::depth(vec![1.0, 2.0]);
        let message = |layers: &[Layer]| encoded(&image, layers).unwrap_err().to_string();
        encoded(&image, &[depth()]).unwrap();
        assert!(message(&[depth(), depth()]).contains("\"depth.Z\" is there twice"));
        assert!(message(&[Layer::depth(vec![1.0])]).contains("holds 1 samples, not 2"));
        assert!(message(&[Layer { name: String::new(), ..depth() }]).contains("a name that"));
        assert!(message(&[Layer { name: "x".repeat(254), ..depth() }]).contains("a name that"));
        assert!(message(&[Layer { channels: vec!["a.b".into()], ..depth() }]).contains("a name that"));
        for format in [Format::Png, Format::Pfm] {
            assert!(encode_with_layers(&image, &[depth()], format, &WriteOptions::default()).is_err());
        }
    }

    #[test]
    fn damaged_files_never_panic() {
        let (image, layers) = picture();
        let bytes = encoded(&image, &layers).unwrap();
        for at in 0..bytes.len().min(1200) {
            for flip in [1, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                let Ok((image, layers)) = exr::decode_layers(&damaged) else { continue };
                for layer in layers {
                    assert_eq!(layer.samples.len(), image.pixels.len() * layer.channels.len());
                }
            }
        }
    }
}
