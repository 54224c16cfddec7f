//! What the user described, as flat arrays: surfaces, materials, lights, camera. Knows no accelerator,
//! thread or rank.
//!
//! Primitive ids: triangles first, in the order of the file (`0 .. triangles.len()`), then spheres.

pub mod bounds;
pub mod build;
pub mod camera;
pub mod emitter;
pub mod environment;
mod files;
pub mod frame;
pub mod generate;
pub mod helio;
pub mod light;
pub mod lighting;
pub mod load;
pub mod material;
pub mod mesh;
pub mod metal;
pub mod normals;
pub mod subset;
pub mod texture;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use camera::Camera;
pub use emitter::Emitter;
pub use environment::Environment;
pub use frame::Frame;
pub use helio::HelioFile;
pub use light::Light;
pub use lighting::Lighting;
pub use material::Material;
pub use mesh::{Part, Shading, Surfaces};
pub use texture::Texture;

/// Linear RGB.
pub type Color = [f64; 3];

/// What chances are made of: nothing that adds something has none.
pub(crate) fn mean([r, g, b]: Color) -> f64 {
    (r + g + b) / 3.0
}

/// A complete scene in stored space (see [`Frame`]), ready to be traced.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub surfaces: Surfaces,
    pub textures: Vec<Texture>,
    pub header: SceneHeader,
    /// For paths only; see [`Scene::prepare_lighting`].
    pub lighting: Lighting,
    /// The file whose parts the arrays are, if they weren't read but mapped.
    pub file: Option<Arc<HelioFile>>,
}

/// The small part of a scene: everything that isn't a large array.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SceneHeader {
    pub camera: Camera,
    pub lights: Vec<Light>,
    pub materials: Vec<Material>,
    /// Runs of primitives that share material and shading, ascending by `first`.
    pub parts: Vec<Part>,
    pub frame: Frame,
    /// Radiance of a ray that hits nothing, where there is no environment.
    pub background: Color,
    pub environment: Option<Environment>,
    /// For paths only; see [`Scene::find_emitters`].
    pub emitters: Vec<Emitter>,
    /// Of a sphere around the whole scene, in stored units; known where `emitters` are.
    pub radius: f64,
    /// Ambient light of the scene, to which each light's own ambient colour is added.
    pub ambient: Color,
    /// `a` of the Sh tracer's closing blend, (1 - a) * colour + a, in [0, 1].
    pub ambient_floor: f64,
}

impl SceneHeader {
    /// The first primitive of each object: see [`Surfaces::objects`].
    pub fn objects(&self) -> Vec<u32> {
        self.parts.iter().map(|part| part.first).collect()
    }
}

impl Scene {
    /// Bytes of the large arrays.
    pub fn memory(&self) -> usize {
        let texels: usize = self.textures.iter().map(|texture| size_of_val(&texture.texels[..])).sum();
        self.surfaces.memory() + texels
    }

    /// The part that owns a primitive id.
    #[inline]
    pub fn part(&self, primitive: u32) -> &Part {
        let parts = &self.header.parts;
        if let [only] = &parts[..] {
            return only;
        }
        &parts[parts.partition_point(|part| part.first <= primitive) - 1]
    }
}
