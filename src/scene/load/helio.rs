//! Converted scenes: what the sections of a `.helio` file mean. Owns their names; knows nothing of their layout.
//!
//! A scene is stored as it is traced, in stored space: nothing is computed when it is loaded, and its arrays stay in the file.

mod check;

use std::borrow::Cow;
use std::io::{self, Seek, Write};
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{ImageDefaults, Loaded};
use crate::error::Result;
use crate::memory::Store;
use crate::scene::helio::{HelioFile, HelioWriter};
use crate::scene::{Scene, SceneHeader, Surfaces, Texture};
use crate::wire;

const HEADER: &str = "header";

/// What isn't a large array.
#[derive(Serialize, Deserialize)]
struct Contents<'a> {
    scene: Cow<'a, SceneHeader>,
    image: Cow<'a, ImageDefaults>,
    framed: bool,
    /// Width and height of each texture.
    textures: Vec<(u32, u32)>,
}

/// Writes the sections of a scene; others may come before and after them.
///
/// # Errors
/// A failed write.
pub fn write<W: Write + Seek>(writer: &mut HelioWriter<W>, loaded: &Loaded) -> io::Result<()> {
    let Scene { surfaces, textures, header, file: _, lighting: _ } = &loaded.scene;
    let contents = Contents {
        scene: Cow::Borrowed(header),
        image: Cow::Borrowed(&loaded.image),
        framed: loaded.framed,
        textures: textures.iter().map(|texture| (texture.width, texture.height)).collect(),
    };
    let contents = wire::pack(&contents).map_err(|error| io::Error::other(error.to_string()))?;
    writer.section(HEADER, &contents)?;
    writer.section("positions", &surfaces.positions)?;
    writer.section("triangles", &surfaces.triangles)?;
    writer.section("spheres", &surfaces.spheres)?;
    writer.section("normals", &surfaces.normals)?;
    writer.section("uvs", &surfaces.uvs)?;
    writer.section("colors", &surfaces.colors)?;
    for (index, texture) in textures.iter().enumerate() {
        writer.section(&texels(index), &texture.texels)?;
    }
    Ok(())
}

/// Opens a converted scene and reads it once, to see that it is sound.
///
/// # Errors
/// A file that can't be read, or that wasn't written as it is.
pub fn load(path: &Path) -> Result<Loaded> {
    let loaded = open(path)?;
    validate(&loaded.scene)?;
    Ok(loaded)
}

/// Opens a converted scene without touching its arrays: for what reads a part of them. What they hold is
/// [`validate`]'s matter; indices in them may lead nowhere.
///
/// # Errors
/// A file that can't be read, or whose header or sizes are unsound.
pub fn open(path: &Path) -> Result<Loaded> {
    let file = HelioFile::open(path)?;
    let header: Store<u8> = file.section(HEADER)?;
    file.verify::<u8>(HEADER, |_, _| Ok(()))?;
    let contents: Contents = wire::unpack(&header).map_err(|_| file.broken("its header can't be read"))?;
    let surfaces = Surfaces {
        positions: file.section("positions")?,
        triangles: file.section("triangles")?,
        spheres: file.section("spheres")?,
        normals: file.section("normals")?,
        uvs: file.section("uvs")?,
        colors: file.section("colors")?,
        guests: Vec::new(),
        objects: contents.scene.objects(),
    };
    let textures = contents
        .textures
        .iter()
        .enumerate()
        .map(|(index, &(width, height))| Ok(Texture { width, height, texels: file.section(&texels(index))? }))
        .collect::<Result<_>>()?;
    let (header, image) = (contents.scene.into_owned(), contents.image.into_owned());
    let scene = Scene { surfaces, textures, header, ..Scene::default() };
    check::sizes(&scene)
        .and_then(|()| check::header(&scene.header))
        .and_then(|()| check::image(&image))
        .map_err(|what| file.broken(what))?;
    let scene = Scene { file: Some(Arc::new(file)), ..scene };
    Ok(Loaded { scene, image, warnings: Vec::new(), framed: contents.framed })
}

/// Reads all arrays of an opened scene and checks that they hold what was written, and nothing that can't be traced.
///
/// # Errors
/// They don't.
pub fn validate(scene: &Scene) -> Result<()> {
    let Some(file) = &scene.file else { return Ok(()) };
    file.verify("positions", |first, run: &[[f32; 3]]| check::positions(first, run))?;
    file.verify("triangles", |first, run: &[[u32; 3]]| check::triangles(scene, first, run))?;
    file.verify("spheres", check::spheres)?;
    file.verify("normals", |first, run: &[[f32; 3]]| check::finite("normal", first, run))?;
    file.verify("uvs", |first, run: &[[f32; 2]]| check::finite("texture coordinate", first, run))?;
    file.verify("colors", |first, run: &[[f32; 3]]| check::finite("vertex colour", first, run))?;
    (0..scene.textures.len()).try_for_each(|index| file.verify::<[u8; 3]>(&texels(index), |_, _| Ok(())))
}

/// The section of a texture.
fn texels(texture: usize) -> String {
    format!("texels.{texture}")
}

#[cfg(test)]
mod tests;
