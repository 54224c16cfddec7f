//! What must hold in a converted scene, so that nothing that is traced or shaded leads out of an array or into numbers that aren't.
//! Everything here says what is wrong, not where.

use glam::DVec3;

use crate::scene::frame::power_of_two;
use crate::scene::light::LightShape;
use crate::scene::load::ImageDefaults;
use crate::scene::material::Physical;
use crate::scene::mesh::{NONE, Part, Sphere};
use crate::scene::{Environment, Frame, Light, Material, Scene, SceneHeader};

type Checked = std::result::Result<(), String>;

fn require(sound: bool, what: impl FnOnce() -> String) -> Checked {
    if sound { Ok(()) } else { Err(what()) }
}

/// That the arrays, the parts, the materials and the textures fit each other, as far as their lengths tell.
pub fn sizes(scene: &Scene) -> Checked {
    let (surfaces, header) = (&scene.surfaces, &scene.header);
    let limit = i32::MAX as usize;
    require(surfaces.len() <= limit && surfaces.positions.len() <= limit, || {
        "it has more than 2^31 primitives or vertices".into()
    })?;
    let parts = &header.parts;
    let firsts = || parts.iter().map(|part| part.first as usize);
    let triangles = surfaces.triangles.len();
    // Spheres begin with a part of their own.
    let begins = |first: usize| first == surfaces.len() || firsts().any(|other| other == first);
    require(
        parts.is_sorted_by(|a, b| a.first < b.first)
            && firsts().all(|first| first < surfaces.len())
            && begins(0)
            && begins(triangles),
        || "its parts aren't those of its surfaces".into(),
    )?;
    let starts = |start: u32, length: usize| start == NONE || start as usize <= length;
    for part in parts {
        require((part.material as usize) < header.materials.len(), || "a part has no material".into())?;
        let of_triangles = (part.first as usize) < triangles;
        require(
            !of_triangles
                || (part.vertices as usize) <= surfaces.positions.len()
                    && starts(part.normals, surfaces.normals.len())
                    && starts(part.uvs, surfaces.uvs.len())
                    && starts(part.colors, surfaces.colors.len()),
            || "a part begins beyond the vertices".into(),
        )?;
    }
    for texture in &scene.textures {
        let texels = u64::from(texture.width) * u64::from(texture.height);
        require(texels > 0 && texels == texture.texels.len() as u64, || "a texture has no size".into())?;
    }
    let known = |texture: Option<u32>| texture.is_none_or(|index| (index as usize) < scene.textures.len());
    require(header.materials.iter().all(|material| known(material.texture)), || {
        "a material's texture isn't there".into()
    })
}

/// That the numbers of the header are what a scene file could have said.
pub fn header(header: &SceneHeader) -> Checked {
    let camera = &header.camera;
    let vectors = [camera.position, camera.forward, camera.right, camera.up];
    require(vectors.iter().all(|v| v.is_finite()) && vectors[1..].iter().all(|v| *v != DVec3::ZERO), || {
        "its camera sees nothing".into()
    })?;
    let Frame { shift, scale } = header.frame;
    let exponent = (scale.to_bits() >> 52) as i32 - 1023;
    require(
        shift.is_finite() && scale > 0.0 && scale.is_finite() && scale == power_of_two(exponent),
        || "its frame isn't exact".into(),
    )?;
    require(
        amounts(&header.background) && amounts(&header.ambient) && amounts(&[header.ambient_floor]),
        || "its background or ambient light is no colour".into(),
    )?;
    require(camera.lens.is_none_or(|lens| amounts(&[lens.radius, lens.focus]) && lens.focus > 0.0), || {
        "its camera's lens has impossible numbers".into()
    })?;
    require(header.environment.as_ref().is_none_or(sound_environment), || {
        "its environment is no image".into()
    })?;
    require(header.emitters.is_empty(), || "it lists emitters, which are found anew".into())?;
    require(header.lights.iter().all(sound_light), || "a light has impossible numbers".into())?;
    require(header.materials.iter().all(sound_material), || "a material has impossible numbers".into())
}

/// That what is said of the image is what flags could say.
pub fn image(image: &ImageDefaults) -> Checked {
    let counts = [image.width, image.height, image.spp];
    require(
        counts.into_iter().flatten().all(|count| (1..=65536).contains(&count))
            && image.min_weight.is_none_or(|weight| amounts(&[weight])),
        || "its image has impossible numbers".into(),
    )
}

fn sound_light(light: &Light) -> bool {
    let (position, direction) = match light.shape {
        LightShape::Point { position } => (position, DVec3::X),
        LightShape::Directional { direction } => (DVec3::ZERO, direction),
        LightShape::Spot { position, direction, cos_inner, cos_outer } => {
            if !(-1.0 <= cos_outer && cos_outer <= cos_inner && cos_inner <= 1.0) {
                return false;
            }
            (position, direction)
        }
    };
    position.is_finite()
        && direction.is_normalized()
        && amounts(&light.diffuse)
        && amounts(&light.specular)
        && amounts(&light.ambient)
        && light.falloff.is_none_or(|falloff| amounts(&falloff))
}

fn sound_environment(environment: &Environment) -> bool {
    let Environment { width, height, ref texels, scale, rotation } = *environment;
    let count = u64::from(width) * u64::from(height);
    count > 0
        && count == texels.len() as u64
        && texels.as_flattened().iter().all(|&c| c.is_finite() && c >= 0.0)
        && amounts(&[scale])
        && rotation.is_finite()
}

fn sound_material(material: &Material) -> bool {
    let Material { ka, kd, ks, kr, kt, emission, shininess, ior, reflectivity, physical, .. } = material;
    amounts(&[*ka, *kd, *ks, *kr, *kt, *emission].concat())
        && amounts(&[*shininess, *ior])
        && *ior > 0.0
        && (0.0..=1.0).contains(reflectivity)
        && match physical {
            None => true,
            Some(Physical::Conductor { eta, k, roughness }) => {
                amounts(&[*eta, *k].concat()) && (0.0..=1.0).contains(roughness)
            }
            Some(Physical::Dielectric { roughness }) => (0.0..=1.0).contains(roughness),
        }
}

fn amounts(numbers: &[f64]) -> bool {
    numbers.iter().all(|&number| number.is_finite() && number >= 0.0)
}

/// Vertices lie in stored space. `first` is the index of the first of `run`, here and below.
pub fn positions(first: usize, run: &[[f32; 3]]) -> Checked {
    every(run, first, "vertex", |position| position.iter().all(|c| c.abs() <= 1.0))
}

/// Spheres lie in stored space.
pub fn spheres(first: usize, run: &[Sphere]) -> Checked {
    every(run, first, "sphere", |sphere| {
        sphere.center.iter().all(|c| c.abs() <= 1.0) && (0.0..=1.0).contains(&sphere.radius)
    })
}

pub fn finite<const N: usize>(what: &str, first: usize, run: &[[f32; N]]) -> Checked {
    every(run, first, what, |numbers| numbers.iter().all(|c| c.is_finite()))
}

/// Triangles lead to vertices of their part, and to those of its normals, texture coordinates and colours that are there.
pub fn triangles(scene: &Scene, first: usize, run: &[[u32; 3]]) -> Checked {
    let parts = &scene.header.parts;
    let mut at = first;
    while at < first + run.len() {
        // Each part at once.
        let next = parts.partition_point(|part| part.first as usize <= at);
        let end = parts.get(next).map_or(usize::MAX, |part| part.first as usize).min(first + run.len());
        let part = &parts[next - 1];
        let limit = vertex_limit(scene, part);
        every(&run[at - first..end - first], at, "triangle", |corners| {
            corners.iter().all(|&corner| part.vertices <= corner && u64::from(corner) < limit)
        })?;
        at = end;
    }
    Ok(())
}

/// The first index that leads out of an array which a part of triangles uses.
fn vertex_limit(scene: &Scene, part: &Part) -> u64 {
    let surfaces = &scene.surfaces;
    let behind = |start: u32, length: usize| match start {
        NONE => u64::MAX,
        start => u64::from(part.vertices) + length as u64 - u64::from(start),
    };
    (surfaces.positions.len() as u64)
        .min(behind(part.normals, surfaces.normals.len()))
        .min(behind(part.uvs, surfaces.uvs.len()))
        .min(behind(part.colors, surfaces.colors.len()))
}

fn every<T>(run: &[T], first: usize, what: &str, sound: impl Fn(&T) -> bool) -> Checked {
    match run.iter().position(|element| !sound(element)) {
        None => Ok(()),
        Some(index) => Err(format!("its {what} {} is impossible", first + index)),
    }
}
