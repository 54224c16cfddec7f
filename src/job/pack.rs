//! A part of a scene as bytes for the rank that it is for, and back.

use bytemuck::Pod;

use crate::error::{Error, Result};
use crate::scene::{Scene, Texture};
use crate::wire;

/// The part and the ids of its primitives in the whole.
pub fn pack(scene: &Scene, ids: &[u32]) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(scene.memory() + size_of_val(ids));
    let sizes: Vec<(u32, u32)> =
        scene.textures.iter().map(|texture| (texture.width, texture.height)).collect();
    put(&mut bytes, &wire::encode(&(&scene.header, sizes))?);
    let surfaces = &scene.surfaces;
    put(&mut bytes, &surfaces.positions);
    put(&mut bytes, &surfaces.triangles);
    put(&mut bytes, &surfaces.spheres);
    put(&mut bytes, &surfaces.normals);
    put(&mut bytes, &surfaces.uvs);
    put(&mut bytes, &surfaces.colors);
    scene.textures.iter().for_each(|texture| put(&mut bytes, &texture.texels));
    put(&mut bytes, ids);
    Ok(bytes)
}

/// What [`pack`] was given.
///
/// # Errors
/// Other bytes than those.
pub fn unpack(bytes: &[u8]) -> Result<(Scene, Vec<u32>)> {
    let mut rest = bytes;
    let mut scene = Scene::default();
    let (header, sizes): (_, Vec<(u32, u32)>) = wire::decode(&take::<u8>(&mut rest)?)?;
    scene.header = header;
    let surfaces = &mut scene.surfaces;
    surfaces.objects = scene.header.objects();
    surfaces.positions = take(&mut rest)?.into();
    surfaces.triangles = take(&mut rest)?.into();
    surfaces.spheres = take(&mut rest)?.into();
    surfaces.normals = take(&mut rest)?.into();
    surfaces.uvs = take(&mut rest)?.into();
    surfaces.colors = take(&mut rest)?.into();
    for (width, height) in sizes {
        scene.textures.push(Texture { width, height, texels: take(&mut rest)?.into() });
    }
    let ids = take(&mut rest)?;
    if rest.is_empty() { Ok((scene, ids)) } else { Err(broken()) }
}

fn put<T: Pod>(bytes: &mut Vec<u8>, array: &[T]) {
    let array: &[u8] = bytemuck::cast_slice(array);
    bytes.extend_from_slice(&(array.len() as u64).to_le_bytes());
    bytes.extend_from_slice(array);
}

fn take<T: Pod>(rest: &mut &[u8]) -> Result<Vec<T>> {
    let (length, after) = rest.split_first_chunk().ok_or_else(broken)?;
    let (array, after) = after.split_at_checked(u64::from_le_bytes(*length) as usize).ok_or_else(broken)?;
    if !array.len().is_multiple_of(size_of::<T>()) {
        return Err(broken());
    }
    *rest = after;
    let mut elements = vec![T::zeroed(); array.len() / size_of::<T>()];
    bytemuck::cast_slice_mut::<T, u8>(&mut elements).copy_from_slice(array);
    Ok(elements)
}

fn broken() -> Error {
    Error::launch("a part of the scene came damaged", "run the same build of heliostat on all nodes")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::scene::load;

    #[test]
    fn a_scene_arrives_whole_and_a_cut_one_is_an_error() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/textured.toml");
        let scene = load::load(&path).unwrap().scene;
        let bytes = pack(&scene, &[1, 2, 7]).unwrap();
        let (found, ids) = unpack(&bytes).unwrap();
        assert_eq!(ids, [1, 2, 7]);
        assert_eq!(found.textures, scene.textures);
        assert_eq!(found.surfaces.positions[..], scene.surfaces.positions[..]);
        assert_eq!(found.surfaces.uvs[..], scene.surfaces.uvs[..]);
        assert_eq!(pack(&found, &ids).unwrap(), bytes);
        for length in (0..bytes.len()).step_by(997) {
            assert!(unpack(&bytes[..length]).is_err());
        }
        assert!(unpack(&[&bytes[..], &[0]].concat()).is_err());
    }
}
