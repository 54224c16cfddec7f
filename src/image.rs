//! A finished image in memory: linear RGB, row 0 on top. Knows nothing of files or films.

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
