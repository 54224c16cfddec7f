//! Wavefront OBJ models.

use std::path::Path;

use super::texture::Textures;
use crate::error::{Error, Result};
use crate::scene::Material;
use crate::scene::mesh::Mesh;

/// What an OBJ file holds: meshes, each with the index of its material in `materials`.
#[derive(Debug, Default)]
pub struct ObjFile {
    pub meshes: Vec<(Mesh, Option<u32>)>,
    pub materials: Vec<(String, Material)>,
    pub warnings: Vec<String>,
}

/// # Errors
/// Always: this branch can't read OBJ files.
pub fn read(path: &Path, _textures: &mut Textures) -> Result<ObjFile> {
    std::fs::File::open(path).map_err(|source| Error::read(path, source))?;
    Err(Error::scene(path, None, "OBJ files can't be read", "use a generated object"))
}
