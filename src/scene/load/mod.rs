//! Scene files in, [`Scene`] out: one file per format.

mod budget;
pub mod environment;
mod framing;
pub mod helio;
#[cfg(test)]
mod hostile_tests;
mod locate;
mod mtl;
mod mtl_material;
pub mod obj;
mod obj_lines;
pub mod texture;
pub mod toml;
mod words;

use std::path::Path;

use glam::DAffine3;
use serde::{Deserialize, Serialize};

pub use self::budget::Budget;
use self::obj::ObjFile;
use self::texture::Textures;
use super::build::{SceneBuilder, Space};
use super::files;
use super::{Material, Scene, SceneHeader, Shading};
use crate::error::{Error, Result};
use crate::settings::{Encoding, Filter, Integrator, SamplerKind};

/// A scene file that was read.
#[derive(Debug)]
pub struct Loaded {
    pub scene: Scene,
    pub image: ImageDefaults,
    /// One line each, naming file and line where there is one.
    pub warnings: Vec<String>,
    /// Whether the file named no camera, so that one was placed to see everything.
    pub framed: bool,
}

impl Loaded {
    /// Adapts a camera that was placed to see everything to an image narrower than high. A camera that the file
    /// names stays as it is.
    pub fn fit(&mut self, width: u32, height: u32) {
        if self.framed && width < height {
            let factor = f64::from(height) / f64::from(width);
            let camera = &mut self.scene.header.camera;
            camera.right *= factor;
            camera.up *= factor;
        }
    }
}

/// What the scene file says about the image. Flags go before, [`ImageSettings`](crate::settings::ImageSettings)'s
/// defaults after.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageDefaults {
    /// 1 ..= 65536.
    pub width: Option<u32>,
    /// 1 ..= 65536.
    pub height: Option<u32>,
    /// 1 ..= 65536.
    pub spp: Option<u32>,
    pub seed: Option<u64>,
    pub max_depth: Option<u32>,
    /// Finite, >= 0.
    pub min_weight: Option<f64>,
    pub integrator: Option<Integrator>,
    pub filter: Option<Filter>,
    pub sampler: Option<SamplerKind>,
    pub encoding: Option<Encoding>,
}

/// The most warnings about one file or scene: a broken exporter can earn one with every line.
const MAX_WARNINGS: usize = 100;

/// Adds a warning if it isn't one of too many. `file` is where the others are.
fn warn(warnings: &mut Vec<String>, file: &Path, warning: impl FnOnce() -> String) {
    match warnings.len() {
        0..MAX_WARNINGS => warnings.push(warning()),
        MAX_WARNINGS => warnings.push(format!("{}: more warnings are left out", file.display())),
        _ => {}
    }
}

/// Reads a scene (`.toml`), a bare model (`.obj`) or a converted scene (`.helio`).
///
/// # Errors
/// Another extension, a file that can't be read, or anything in it that can't be rendered.
pub fn load(path: &Path) -> Result<Loaded> {
    load_in(path, Space::Memory)
}

/// Reads a scene as [`load`] does, and keeps its surfaces in `space`; those of a converted scene stay where they are.
///
/// # Errors
/// As [`load`], and a disk that can't be written to.
pub fn load_in(path: &Path, space: Space) -> Result<Loaded> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("");
    match extension.to_ascii_lowercase().as_str() {
        "toml" => toml::load(path, space),
        "obj" => model(path, space),
        "helio" => helio::load(path),
        _ => Err(Error::scene(
            path,
            None,
            format!("scene files of type `{extension}` can't be read"),
            "give a .toml scene, an .obj model or a .helio file",
        )),
    }
}

/// Reads a bare model and puts it in a good light: a camera that sees all of it, key light, fill light, some ambient
/// light and a light background.
///
/// # Errors
/// As [`load`].
fn model(path: &Path, space: Space) -> Result<Loaded> {
    let mut textures = Textures::default();
    let file = obj::read(path, &mut textures)?;
    let mut builder = SceneBuilder::new_in(path, space)?;
    let mut warnings = Vec::new();
    place(&mut builder, file, &DAffine3::IDENTITY, None, Shading::Phong, &mut warnings)?;
    for texture in textures.into_vec() {
        builder.texture(texture);
    }
    if builder.bounds().is_none() {
        warnings.push(format!("{}: no surfaces: the image will show the background", path.display()));
    }
    let camera = framing::camera(builder.bounds());
    let lights = framing::lights(&camera);
    let header = SceneHeader {
        camera,
        lights,
        background: [0.62, 0.72, 0.84],
        ambient: [0.15; 3],
        ..SceneHeader::default()
    };
    Ok(Loaded { scene: builder.finish(header), image: ImageDefaults::default(), warnings, framed: true })
}

/// Places the meshes of an OBJ file, with their own materials or all with the one given.
fn place(
    builder: &mut SceneBuilder,
    file: ObjFile,
    transform: &DAffine3,
    material: Option<u32>,
    shading: Shading,
    warnings: &mut Vec<String>,
) -> Result<()> {
    for warning in file.warnings {
        warn(warnings, builder.file(), || warning);
    }
    let own: Vec<u32> = match material {
        Some(_) => Vec::new(),
        None => file.materials.into_iter().map(|(_, material)| builder.material(material)).collect(),
    };
    let mut grey = None;
    for (mesh, index) in file.meshes {
        let material = match (material, index) {
            (Some(material), _) => material,
            (None, Some(index)) => own[index as usize],
            (None, None) => *grey.get_or_insert_with(|| builder.material(Material::default())),
        };
        builder.mesh(mesh, transform, material, shading)?;
    }
    Ok(())
}
