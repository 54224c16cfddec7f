//! A finished image in memory: linear RGB, row 0 on top, and the file formats that hold one (bytes in, bytes out). Knows no film and no scene.

pub mod exr;
mod exr_layers;
pub mod format;
pub mod pfm;
pub mod png;
pub mod read;
pub mod transfer;

/// A rectangle of linear RGB pixels, `pixels[y * width + x]`, row 0 on top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// A black image.
    pub fn new(width: u32, height: u32) -> Self {
        Image { width, height, pixels: vec![[0.0; 3]; width as usize * height as usize] }
    }
}

/// What else is known of every pixel of an image, under a name: `samples[pixel * channels.len() + channel]`,
/// pixels in the image's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    pub name: String,
    pub channels: Vec<String>,
    pub samples: LayerSamples,
}

/// The samples of a [`Layer`], channel after channel of pixel after pixel.
#[derive(Clone, Debug, PartialEq)]
pub enum LayerSamples {
    F32(Vec<f32>),
    U32(Vec<u32>),
}

impl LayerSamples {
    pub fn len(&self) -> usize {
        match self {
            LayerSamples::F32(samples) => samples.len(),
            LayerSamples::U32(samples) => samples.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Layer {
    /// Name of [`Layer::variance`].
    pub const VARIANCE: &str = "variance";

    pub fn new(name: &str, channels: &[&str], samples: LayerSamples) -> Self {
        Layer { name: name.into(), channels: channels.iter().map(|&c| c.into()).collect(), samples }
    }

    /// R, G, B: the variance of the pixel's mean, that is its standard error squared.
    pub fn variance(pixels: Vec<[f32; 3]>) -> Self {
        Self::rgb(Self::VARIANCE, pixels)
    }

    /// Name of [`Layer::freedom`].
    pub const FREEDOM: &str = "freedom";

    /// N: the degrees of freedom of the variance, of B batches of samples B - 1 (of a filter with negative lobes what Welch gives both its parts together); 0 where it isn't known.
    pub fn freedom(pixels: Vec<f32>) -> Self {
        Self::new(Self::FREEDOM, &["N"], LayerSamples::F32(pixels))
    }

    /// R, G, B: the share of light that the surface throws back.
    pub fn albedo(pixels: Vec<[f32; 3]>) -> Self {
        Self::rgb("albedo", pixels)
    }

    /// X, Y, Z: the unit normal in world space, 0 where nothing is hit.
    pub fn normal(pixels: Vec<[f32; 3]>) -> Self {
        Self::new("normal", &["X", "Y", "Z"], LayerSamples::F32(pixels.into_flattened()))
    }

    /// X, Y, Z: the point that is seen, in world space.
    pub fn position(pixels: Vec<[f32; 3]>) -> Self {
        Self::new("position", &["X", "Y", "Z"], LayerSamples::F32(pixels.into_flattened()))
    }

    /// Z: the distance from the camera.
    pub fn depth(pixels: Vec<f32>) -> Self {
        Self::new("depth", &["Z"], LayerSamples::F32(pixels))
    }

    /// I: the id of the primitive.
    pub fn id(pixels: Vec<u32>) -> Self {
        Self::new("id", &["I"], LayerSamples::U32(pixels))
    }

    fn rgb(name: &str, pixels: Vec<[f32; 3]>) -> Self {
        Self::new(name, &["R", "G", "B"], LayerSamples::F32(pixels.into_flattened()))
    }

    /// The pixels of a layer of one float channel.
    pub fn singles(&self) -> Option<&[f32]> {
        match &self.samples {
            LayerSamples::F32(samples) if self.channels.len() == 1 => Some(samples),
            _ => None,
        }
    }

    /// The pixels of a layer of three float channels.
    pub fn triples(&self) -> Option<&[[f32; 3]]> {
        match &self.samples {
            LayerSamples::F32(samples) if self.channels.len() == 3 => Some(samples.as_chunks().0),
            _ => None,
        }
    }
}
