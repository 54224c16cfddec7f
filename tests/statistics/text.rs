//! Scene files put together: the tables that the scenes of these tests share, each with a few values.

use std::fmt::Display;

/// A scene file's text so far. What goes into a table beyond its first values is lines of TOML.
#[derive(Clone, Debug)]
pub struct Text(String);

impl Text {
    /// Seen in perspective: the vertical field of view in degrees.
    pub fn perspective(position: [f64; 3], look_at: [f64; 3], fov: f64) -> Self {
        Text(format!("[camera]\nposition = {position:?}\nlook_at = {look_at:?}\nfov = {fov}\n"))
    }

    /// Seen straight from above, from `y` on, with -z upwards: so much of the world from edge to edge.
    pub fn from_above(y: f64, height: f64) -> Self {
        let camera = format!("type = \"orthographic\"\nposition = [0, {y}, 0]\nlook_at = [0, 0, 0]");
        Text(format!("[camera]\n{camera}\nup = [0, 0, -1]\nheight = {height}\n"))
    }

    /// A square image.
    pub fn image(self, size: u32, spp: u32, more: &str) -> Self {
        self.table("[render]", &format!("width = {size}\nheight = {size}\nspp = {spp}\n{more}"))
    }

    pub fn material(self, name: &str, values: &str) -> Self {
        self.table("[[material]]", &format!("name = \"{name}\"\n{values}"))
    }

    pub fn point_light(self, position: [f64; 3], color: f64) -> Self {
        self.table("[[light]]", &format!("type = \"point\"\nposition = {position:?}\ncolor = {color}"))
    }

    pub fn sphere(self, center: [f64; 3], radius: f64, material: &str) -> Self {
        self.object("sphere", material, &format!("center = {center:?}\nradius = {radius}"))
    }

    /// Level, its normal up; a number or an array for its edges.
    pub fn plane(self, size: impl Display, material: &str, more: &str) -> Self {
        self.object("plane", material, &format!("size = {size}\n{more}"))
    }

    /// Of a file beside the scene.
    pub fn mesh(self, file: &str, material: &str, more: &str) -> Self {
        self.object("mesh", material, &format!("file = \"{file}\"\n{more}"))
    }

    pub fn object(self, kind: &str, material: &str, more: &str) -> Self {
        self.table("[[object]]", &format!("type = \"{kind}\"\nmaterial = \"{material}\"\n{more}"))
    }

    fn table(mut self, name: &str, lines: &str) -> Self {
        self.0 += &format!("{name}\n{lines}\n");
        self
    }
}

impl AsRef<str> for Text {
    fn as_ref(&self) -> &str {
        &self.0
    }
}
