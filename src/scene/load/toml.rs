//! The scene format, TOML: see docs/scene-format.md. Reads and checks the text first, then makes what it describes.
//! Knows no command line.

mod check;
mod header;
mod object;
mod physical;
mod source;
mod tables;
mod transform;
mod value;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use self::header::NamedMaterial;
use self::object::{Object, Shape};
use self::source::{Source, Span};
use super::texture::Textures;
use super::{Budget, ImageDefaults, Loaded, files, framing, obj, warn};
use crate::error::{Error, Result};
use crate::scene::build::{SceneBuilder, Space};
use crate::scene::generate::cuboid::cuboid;
use crate::scene::generate::icosphere::icosphere;
use crate::scene::generate::plane::plane;
use crate::scene::generate::sphereflake::sphereflake;
use crate::scene::generate::teapot::teapot;
use crate::scene::light::LightShape;
use crate::scene::mesh::MeshMut;
use crate::scene::{Camera, Material, SceneHeader};
use crate::settings::Integrator;

/// Reads a scene file and all that it names.
///
/// # Errors
/// As [`super::load`].
pub(super) fn load(path: &Path, space: Space) -> Result<Loaded> {
    parse_in(&files::read(path)?, path, Budget::of_machine(), space)
}

/// Reads the text of a scene file. `path` stands in errors, and the files that it names are looked for beside it.
///
/// # Errors
/// As [`super::load`], and a scene that needs more memory than `budget`.
pub fn parse(text: &[u8], path: &Path, budget: Budget) -> Result<Loaded> {
    parse_in(text, path, budget, Space::Memory)
}

fn parse_in(text: &[u8], path: &Path, budget: Budget, space: Space) -> Result<Loaded> {
    let text = match std::str::from_utf8(text) {
        Ok(text) => text,
        Err(error) => {
            let line = text[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count() + 1;
            return Err(Error::scene(path, Some(line), "the text isn't UTF-8", "save the file as UTF-8"));
        }
    };
    let source = Source { file: path, text };
    let description = describe(&source)?;
    afford(&source, &description.objects, budget, space)?;
    build(&source, description, space)
}

/// What a scene file says, checked as far as that goes without opening another file.
struct Description {
    /// Without materials; its camera is meant only if `camera` says where that stands.
    header: SceneHeader,
    camera: Option<Span>,
    /// Where the tables of the lights begin.
    lights: Vec<Span>,
    image: ImageDefaults,
    materials: Vec<NamedMaterial>,
    objects: Vec<Object>,
    warnings: Vec<String>,
}

fn describe(source: &Source) -> Result<Description> {
    let file: tables::File = ::toml::from_str(source.text).map_err(|error| syntax(source, &error))?;
    let mut header = SceneHeader::default();
    let mut warnings = Vec::new();
    let image = header::render(source, file.render, &mut header)?;
    let camera = file.camera.as_ref().map(|table| table.span());
    if let Some(table) = file.camera {
        header.camera = header::camera(source, table)?;
    }
    let (materials, names) = header::materials(source, file.material, &mut warnings)?;
    let lights = file.light.iter().map(|light| light.span()).collect();
    for light in file.light {
        header.lights.push(header::light(source, light)?);
    }
    let mut objects = Vec::new();
    let mut primitives = 0;
    for table in file.object {
        let object = object::object(source, table, &names)?;
        primitives += object.shape.count();
        if primitives > i32::MAX as u64 {
            let what = "with this object there are more than 2^31 primitives";
            return Err(source.error(&object.at, what, "use fewer cells or levels"));
        }
        let textured = object.material.is_some_and(|index| materials[index as usize].texture.is_some());
        if textured && !object.shape.has_uvs() {
            let what = "its material's texture isn't seen: this shape has no texture coordinates";
            warn(&mut warnings, source.file, || source.warning(&object.at, what));
        }
        objects.push(object);
    }
    let shines = |entry: &NamedMaterial| entry.material.emission != [0.0; 3];
    // Paths find light wherever it comes from.
    let sky = header.environment.is_some()
        || (image.integrator == Some(Integrator::Path) && header.background != [0.0; 3]);
    let lit = sky || !header.lights.is_empty() || header.ambient != [0.0; 3] || materials.iter().any(shines);
    if objects.is_empty() {
        warnings.push(format!("{}: no objects: the image shows the background", source.file.display()));
    } else if !lit {
        warnings.push(format!("{}: no light: all surfaces are black", source.file.display()));
    }
    Ok(Description { header, camera, lights, image, materials, objects, warnings })
}

/// One line for an error of the format itself, or of a value of the wrong kind.
fn syntax(source: &Source, error: &::toml::de::Error) -> Error {
    let what = error
        .message()
        .replace('\n', ", ")
        .replace("expected f64", "expected a number")
        .replace("expected u32", "expected a whole number from 0 to 4294967295")
        .replace("expected u64", "expected a whole number from 0");
    let mend = if what.starts_with("unknown field") {
        "correct its spelling or remove it"
    } else if what.contains("map, expected a sequence") {
        "write [[material]], [[light]] and [[object]] in double brackets"
    } else if what.starts_with("unknown variant") {
        "use one of these"
    } else {
        "correct the value or the TOML around it"
    };
    source.error(&error.span().unwrap_or(0..0), what, mend)
}

/// Refuses the first object whose surfaces, with those before it, don't fit into memory.
fn afford(source: &Source, objects: &[Object], budget: Budget, space: Space) -> Result<()> {
    let mut kept = 0;
    for object in objects {
        if let Space::Memory = space {
            kept += object.shape.bytes();
        }
        if let Some(shortage) = budget.lacks(kept + object.shape.bytes_to_make()) {
            let what = format!("with this object the scene needs {shortage}");
            let mend = match object.shape {
                Shape::Mesh { .. } => "use fewer or coarser meshes",
                _ => "use fewer cells or levels",
            };
            return Err(source.error(&object.at, what, mend));
        }
    }
    Ok(())
}

fn build(source: &Source, description: Description, space: Space) -> Result<Loaded> {
    let Description { mut header, camera, lights, image, materials, objects, mut warnings } = description;
    let mut builder = SceneBuilder::new_in(source.file, space)?;
    let mut textures = Textures::default();
    for NamedMaterial { mut material, texture } in materials {
        if let Some((file, at)) = texture {
            material.texture = Some(textures.load(&file).map_err(|error| source.blame(&at, error))?);
        }
        builder.material(material);
    }
    let mut grey = None;
    for object in objects {
        let at = object.at.clone();
        make(source, object, &mut builder, &mut textures, &mut grey, &mut warnings)
            .map_err(|error| source.blame(&at, error))?;
    }
    for texture in textures.into_vec() {
        builder.texture(texture);
    }
    if camera.is_none() {
        header.camera = framing::camera(builder.bounds());
    }
    let scene = builder.finish(header);
    in_reach(source, &scene.header, camera.as_ref(), &lights)?;
    Ok(Loaded { scene, image, warnings, framed: camera.is_none() })
}

/// Refuses what left f64's range when the scene was scaled to its size: a camera or light endlessly far away, or an endless film.
fn in_reach(source: &Source, header: &SceneHeader, camera: Option<&Span>, lights: &[Span]) -> Result<()> {
    let far = |at: &Span, what: &str| {
        Err(source.error(
            at,
            format_args!("{what} is endlessly far or wide for the size of the objects"),
            "give smaller numbers",
        ))
    };
    let Camera { position, right, up, .. } = &header.camera;
    if let Some(at) = camera.filter(|_| !(position.is_finite() && right.is_finite() && up.is_finite())) {
        return far(at, "the camera");
    }
    for (light, at) in header.lights.iter().zip(lights) {
        match light.shape {
            LightShape::Point { position } | LightShape::Spot { position, .. } if !position.is_finite() => {
                return far(at, "the light");
            }
            _ => {}
        }
    }
    Ok(())
}

/// Makes one object. `grey` is the material of objects without, once there is one.
fn make(
    source: &Source,
    object: Object,
    builder: &mut SceneBuilder,
    textures: &mut Textures,
    grey: &mut Option<u32>,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let Object { shape, transform, material: given, shading, at: _ } = object;
    let mut material =
        || given.unwrap_or_else(|| *grey.get_or_insert_with(|| builder.material(Material::default())));
    let mesh = match shape {
        Shape::Mesh { file, at } => {
            let mesh = obj::read(&file, textures).map_err(|error| source.blame(&at, error))?;
            return super::place(builder, mesh, &transform, given, shading, warnings);
        }
        Shape::Sphere(ball) => {
            let material = material();
            return builder.spheres([ball], &transform, material);
        }
        Shape::Sphereflake { depth, radius } => {
            let material = material();
            return builder.spheres(sphereflake(depth, radius), &transform, material);
        }
        Shape::Terrain(terrain) => {
            let material = material();
            let fill = |mesh: MeshMut| terrain.fill(mesh);
            return builder.mesh_in_place(terrain.size(), fill, &transform, material, shading);
        }
        Shape::Teapot { level } => teapot(level),
        Shape::Icosphere { level, center, radius } => icosphere(level, center, radius),
        Shape::Box { low, high } => cuboid(low, high),
        Shape::Plane { size, repeat } => plane(size, repeat),
    };
    let material = material();
    builder.mesh(mesh, &transform, material, shading)
}

impl Source<'_> {
    /// A path that is meant from the scene file's folder.
    fn beside(&self, path: &str) -> PathBuf {
        self.file.parent().unwrap_or(Path::new("")).join(path)
    }
}
