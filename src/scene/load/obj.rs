//! OBJ files and their MTL files in, meshes and materials out. `tobj` reads the numbers and merges the vertices;
//! `obj_lines` stands before it. Knows no scene: where meshes are placed is the caller's.

use std::cell::RefCell;
use std::io::{BufRead, BufReader};
use std::path::Path;

use super::files;
use super::mtl::{self, Library};
use super::mtl_material::material;
use super::obj_lines::{Lines, Notes};
use super::texture::Textures;
use crate::error::{Error, Result};
use crate::scene::Material;
use crate::scene::mesh::Mesh;

const OPTIONS: tobj::LoadOptions =
    tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };

/// A material and its name.
pub type Named = (String, Material);

/// What an OBJ file holds.
#[derive(Debug, Default)]
pub struct ObjFile {
    /// Meshes, each with an index into `materials` or `None` for one without a material. Their triangles one
    /// after the other are those of the file in its order, polygons split into a fan from their first vertex.
    pub meshes: Vec<(Mesh, Option<u32>)>,
    /// All materials of the MTL files by name. Textures are loaded for those that a mesh uses.
    pub materials: Vec<Named>,
    /// One line each, with the file's name.
    pub warnings: Vec<String>,
}

/// Reads an OBJ file, its MTL files and their textures.
///
/// Missing MTL files, materials and textures are warnings. A mesh has normals only if all of its corners have;
/// they are of unit length, or (0, 0, 0) where the file's aren't usable. The same holds for texture coordinates.
///
/// # Errors
/// A file that can't be read or isn't text; the first malformed number or face, index out of range, or vertex
/// that isn't finite, with its line; no triangles; a malformed number in an MTL file.
pub fn read(path: &Path, textures: &mut Textures) -> Result<ObjFile> {
    read_from(|| Ok(BufReader::with_capacity(1 << 16, files::open(path)?)), path, textures)
}

/// Reads the text of an OBJ file. `path` stands in errors, and the files that it names are looked for beside it.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &[u8], path: &Path, textures: &mut Textures) -> Result<ObjFile> {
    read_from(|| Ok(text), path, textures)
}

/// Reads the text of an MTL file as [`read`] does: its materials by name, and warnings. `path` stands in these, and
/// textures are looked for beside it.
///
/// # Errors
/// A malformed number, with its line; a file that isn't text.
pub fn parse_materials(
    text: &[u8],
    path: &Path,
    textures: &mut Textures,
) -> Result<(Vec<Named>, Vec<String>)> {
    let mut warnings = Vec::new();
    let sources = mtl::parse(text, path, &mut warnings)?;
    let materials = sources
        .iter()
        .map(|source| (source.name.clone(), material(source, path, textures, &mut warnings)))
        .collect();
    Ok((materials, warnings))
}

/// `open` gives the text from its start.
fn read_from<R: BufRead>(
    open: impl Fn() -> Result<R>,
    path: &Path,
    textures: &mut Textures,
) -> Result<ObjFile> {
    let parsed = match pass(open()?, path, false)? {
        Some(parsed) => parsed,
        // Only some vertices have a colour, which shows only behind the first of them: the others get white.
        None => pass(open()?, path, true)?.ok_or_else(|| broken(path))?,
    };
    if parsed.notes.faces == 0 {
        return Err(Error::scene(path, None, "no triangles", "give an OBJ file with faces (`f` lines)"));
    }
    let mut file = ObjFile::default();
    let mut used = vec![false; parsed.materials.len()];
    let mut partial = Partial::default();
    for model in parsed.models.into_iter().filter(|model| !model.mesh.indices.is_empty()) {
        let material = model.mesh.material_id;
        if let Some(index) = material {
            used[index] = true;
        }
        file.meshes.push((partial.mesh(model.mesh), material.map(|index| index as u32)));
    }
    file.warnings = parsed.notes.warnings(path, &partial, file.meshes.len());
    for ((source, path), used) in parsed.materials.iter().zip(&parsed.library.sources).zip(used) {
        let mapped = if used {
            material(source, path, textures, &mut file.warnings)
        } else {
            let unused = tobj::Material { diffuse_texture: None, ..source.clone() };
            material(&unused, path, textures, &mut Vec::new())
        };
        file.materials.push((source.name.clone(), mapped));
    }
    file.warnings.extend(parsed.library.into_warnings());
    Ok(file)
}

#[derive(Debug)]
struct Parsed {
    models: Vec<tobj::Model>,
    materials: Vec<tobj::Material>,
    library: Library,
    notes: Notes,
}

/// `None` if only some vertices have a colour, and `pad_colors` is off.
fn pass(text: impl BufRead, path: &Path, pad_colors: bool) -> Result<Option<Parsed>> {
    let library = RefCell::new(Library::new(path));
    let mut lines = Lines::new(text, path, &library, pad_colors);
    let loaded = tobj::load_obj_buf(&mut lines, &OPTIONS, |_| library.borrow_mut().take_pending());
    let mixed = lines.notes.vertices_with_color > 0 && lines.notes.vertices_without_color > 0;
    if mixed && !pad_colors {
        return Ok(None);
    }
    let (models, materials) = loaded.map_err(|error| lines.explain(error))?;
    let materials = materials.map_err(|_| broken(path))?;
    let notes = lines.notes;
    Ok(Some(Parsed { models, materials, library: library.into_inner(), notes }))
}

/// For what can't happen while the checks before `tobj` hold.
fn broken(path: &Path) -> Error {
    Error::scene(path, None, "the file can't be understood", "write it anew from a modelling program")
}

/// Counts meshes that had normals or texture coordinates at some corners only.
#[derive(Debug, Default)]
struct Partial {
    normals: usize,
    uvs: usize,
}

impl Partial {
    fn mesh(&mut self, source: tobj::Mesh) -> Mesh {
        let positions = source.positions.as_chunks::<3>().0.to_vec();
        let complete = |length: usize, width: usize, partial: &mut usize| {
            let complete = length == positions.len() * width;
            *partial += usize::from(!complete && length > 0);
            complete
        };
        let normals = if complete(source.normals.len(), 3, &mut self.normals) {
            source.normals.as_chunks::<3>().0.iter().map(|&normal| unit(normal)).collect()
        } else {
            Vec::new()
        };
        let uvs = if complete(source.texcoords.len(), 2, &mut self.uvs) {
            source.texcoords.as_chunks::<2>().0.to_vec()
        } else {
            Vec::new()
        };
        let colors = source.vertex_color.as_chunks::<3>().0.to_vec();
        let triangles = source.indices.as_chunks::<3>().0.to_vec();
        Mesh { positions, triangles, normals, uvs, colors }
    }
}

/// The normal of unit length, or (0, 0, 0) for one of no length.
fn unit(normal: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = normal.map(f64::from);
    let length = (x * x + y * y + z * z).sqrt();
    if length > 0.0 { [x, y, z].map(|c| (c / length) as f32) } else { [0.0; 3] }
}

impl Notes {
    fn warnings(&self, path: &Path, partial: &Partial, meshes: usize) -> Vec<String> {
        let mut warnings = Vec::new();
        let mut warn = |count: usize, what: String| {
            if count > 0 {
                warnings.push(format!("{}: {what}", path.display()));
            }
        };
        let (lines, points) = (self.polylines, self.points);
        warn(lines + points, format!("{lines} lines and {points} points are left out"));
        warn(
            self.zeroed,
            format!("{} normals or texture coordinates are not finite: taken as 0", self.zeroed),
        );
        let dangling = self.dangling;
        warn(
            dangling,
            format!("{dangling} indices of normals or texture coordinates are left out: the file has none"),
        );
        let total = self.vertices_with_color + self.vertices_without_color;
        let mixed = self.vertices_with_color.min(self.vertices_without_color);
        let colored = self.vertices_with_color;
        warn(mixed, format!("only {colored} of {total} vertices have a colour: the others are white"));
        let part = |what: &str, count: usize| {
            format!("{count} of {meshes} meshes have {what} at some corners of a face only: left out")
        };
        warn(partial.normals, part("normals", partial.normals));
        warn(partial.uvs, part("texture coordinates", partial.uvs));
        warnings
    }
}

#[cfg(test)]
#[path = "obj_tests.rs"]
mod tests;
