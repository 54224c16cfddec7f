//! What must hold for any bytes that a reader gets: the fuzz targets in `fuzz/` and the test `corpus` share it.

use std::path::Path;

use heliostat::accel::Accel;
use heliostat::cluster::wire;
use heliostat::error::Error;
use heliostat::output::stats::RankStats;
use heliostat::output::timeline::Event;
use heliostat::scene::light::LightShape;
use heliostat::scene::load::obj::{self, ObjFile};
use heliostat::scene::load::texture::Textures;
use heliostat::scene::load::{self, Budget, Loaded};
use heliostat::scene::material::Physical;
use heliostat::scene::{Material, SceneHeader};
use heliostat::settings::{AccelKind, BuildPreset, ImageSettings, RunSettings};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Enough for every kind of object, and little enough for thousands of scenes each second.
const BUDGET: Budget = Budget::of_bytes(1 << 20);

pub fn obj(bytes: &[u8]) {
    match obj::parse(bytes, Path::new("no/folder/a.obj"), &mut Textures::default()) {
        Ok(file) => sound_file(&file, bytes.len()),
        Err(error) => clear(&error, "a.obj"),
    }
}

pub fn mtl(bytes: &[u8]) {
    match obj::parse_materials(bytes, Path::new("no/folder/a.mtl"), &mut Textures::default()) {
        Ok((materials, warnings)) => {
            materials.iter().for_each(|(_, material)| sound_material(material));
            sound_warnings(&warnings);
        }
        Err(error) => clear(&error, "a.mtl"),
    }
}

pub fn toml(bytes: &[u8]) {
    match load::toml::parse(bytes, Path::new("no/folder/scene.toml"), BUDGET) {
        Ok(loaded) => {
            sound_scene(&loaded);
            if loaded.scene.surfaces.len() < 2000 {
                Accel::build(AccelKind::Bvh, BuildPreset::Balanced, &loaded.scene.surfaces);
            }
        }
        Err(error) => clear(&error, "scene.toml"),
    }
}

/// The first byte says what the others are taken for: a payload, as damaged envelopes all end at the checksum.
pub fn wire(bytes: &[u8]) {
    let _ = wire::decode::<SceneHeader>(bytes);
    let Some((kind, payload)) = bytes.split_first() else { return };
    let mut message = wire::encode(&()).expect("nothing has a message")[..8].to_vec();
    message.extend((payload.len() as u64).to_le_bytes());
    message.extend(crc32fast::hash(payload).to_le_bytes());
    message.extend(payload);
    match kind % 7 {
        0 => comes_back::<SceneHeader>(&message),
        1 => comes_back::<ImageSettings>(&message),
        2 => comes_back::<RunSettings>(&message),
        3 => comes_back::<RankStats>(&message),
        4 => comes_back::<Vec<Event>>(&message),
        5 => comes_back::<Result<(), (String, i32)>>(&message),
        _ => comes_back::<Vec<(u32, u32)>>(&message),
    }
}

/// A value has one form: what can be read is what would have been written.
fn comes_back<T: Serialize + DeserializeOwned>(message: &[u8]) {
    if let Ok(value) = wire::decode::<T>(message) {
        assert_eq!(wire::encode(&value).expect("it was a message"), message);
    }
}

/// One line that names the file.
fn clear(error: &Error, file: &str) {
    let text = error.to_string();
    assert!(text.contains(file) && !text.contains(['\n', '\r', '\0']), "{text:?}");
}

fn sound_file(file: &ObjFile, bytes: usize) {
    let mut held = 0;
    for (mesh, material) in &file.meshes {
        let vertices = mesh.positions.len();
        assert!(!mesh.triangles.is_empty());
        assert!(mesh.triangles.iter().flatten().all(|&index| (index as usize) < vertices));
        for length in [mesh.normals.len(), mesh.uvs.len(), mesh.colors.len()] {
            assert!(length == 0 || length == vertices);
        }
        assert!([&mesh.positions, &mesh.normals, &mesh.colors].iter().all(|array| finite(array)));
        assert!(finite(&mesh.uvs));
        assert!(material.is_none_or(|index| (index as usize) < file.materials.len()));
        held += vertices * 44 + mesh.triangles.len() * 12;
    }
    assert!(held <= bytes * 100, "{held} bytes of surfaces from {bytes} bytes of text");
    file.materials.iter().for_each(|(_, material)| sound_material(material));
    sound_warnings(&file.warnings);
}

fn sound_scene(loaded: &Loaded) {
    let (surfaces, header) = (&loaded.scene.surfaces, &loaded.scene.header);
    let vertices = surfaces.positions.len();
    assert!(surfaces.triangles.iter().flatten().all(|&index| (index as usize) < vertices));
    assert!(surfaces.positions.iter().flatten().all(|c| c.abs() <= 1.0), "outside of the frame");
    assert!(finite(&surfaces.normals) && finite(&surfaces.uvs) && finite(&surfaces.colors));
    let sphere_numbers = surfaces.spheres.iter().flat_map(|s| s.center.into_iter().chain([s.radius]));
    assert!(sphere_numbers.into_iter().all(|c| c.abs() <= 1.0), "outside of the frame");
    assert!(header.parts.is_sorted_by(|a, b| a.first < b.first));
    assert!(header.parts.iter().all(|part| (part.material as usize) < header.materials.len()));
    for material in &header.materials {
        sound_material(material);
        assert!(material.texture.is_none_or(|index| (index as usize) < loaded.scene.textures.len()));
    }
    let camera = &header.camera;
    let vectors = [camera.position, camera.forward, camera.right, camera.up];
    assert!(vectors.iter().all(|vector| vector.is_finite()), "{camera:?}");
    assert!([camera.right, camera.up].iter().all(|edge| edge.abs().max_element() > 0.0), "{camera:?}");
    for light in &header.lights {
        let (position, direction) = match light.shape {
            LightShape::Point { position } => (Some(position), None),
            LightShape::Directional { direction } => (None, Some(direction)),
            LightShape::Spot { position, direction, cos_inner, cos_outer } => {
                assert!(0.0 <= cos_outer && cos_outer <= cos_inner && cos_inner <= 1.0);
                (Some(position), Some(direction))
            }
        };
        assert!(position.is_none_or(|position| position.is_finite()), "{light:?}");
        assert!(direction.is_none_or(|direction| (direction.length() - 1.0).abs() < 1e-9), "{light:?}");
        assert!(amounts(&[light.diffuse, light.specular, light.ambient].concat()), "{light:?}");
    }
    assert!(amounts(&[header.background, header.ambient].concat()));
    sound_warnings(&loaded.warnings);
}

fn sound_material(material: &Material) {
    let Material { ka, kd, ks, kr, kt, emission, .. } = *material;
    assert!(amounts(&[ka, kd, ks, kr, kt, emission].concat()), "{material:?}");
    assert!(amounts(&[material.shininess, material.ior, material.reflectivity]), "{material:?}");
    assert!(material.ior > 0.0 && material.reflectivity <= 1.0, "{material:?}");
    let roughness = match material.physical {
        None => 0.0,
        Some(Physical::Conductor { eta, k, roughness }) => {
            assert!(amounts(&[eta, k].concat()), "{material:?}");
            roughness
        }
        Some(Physical::Dielectric { roughness }) => roughness,
    };
    assert!((0.0..=1.0).contains(&roughness), "{material:?}");
}

fn sound_warnings(warnings: &[String]) {
    assert!(warnings.len() <= 1000, "{} warnings", warnings.len());
    for warning in warnings {
        assert!(warning.contains("no/folder/") && !warning.contains(['\n', '\r', '\0']), "{warning:?}");
        assert!(warning.len() < 1000, "{} bytes in a warning", warning.len());
    }
}

fn finite<const N: usize>(array: &[[f32; N]]) -> bool {
    array.iter().flatten().all(|number| number.is_finite())
}

fn amounts(numbers: &[f64]) -> bool {
    numbers.iter().all(|&number| number.is_finite() && number >= 0.0)
}
