//! Objects: from tables to shapes with their parameters, and from those to surfaces.

use std::collections::HashMap;
use std::path::PathBuf;

use ::toml::Spanned;
use glam::{DAffine3, DVec3};

use super::source::{Source, Span};
use super::tables::{self, ObjectType};
use super::transform::transform;
use super::value::{Finite, OneOrList};
use crate::error::Result;
use crate::scene::Shading;
use crate::scene::build::Ball;
use crate::scene::generate::terrain::{self, Terrain};
use crate::scene::generate::{icosphere, sphereflake, teapot};
use crate::scene::mesh::Sphere;

/// An object that is sound by itself but hasn't been made.
#[derive(Clone, Debug)]
pub struct Object {
    pub shape: Shape,
    pub transform: DAffine3,
    /// Index among the file's materials.
    pub material: Option<u32>,
    pub shading: Shading,
    /// Where its table begins.
    pub at: Span,
}

#[derive(Clone, Debug)]
pub enum Shape {
    Mesh { file: PathBuf, at: Span },
    Sphere(Ball),
    Sphereflake { depth: u32, radius: f64 },
    Terrain(Terrain),
    Teapot { level: u32 },
    Icosphere { level: u32, center: DVec3, radius: f64 },
    Box { low: DVec3, high: DVec3 },
    Plane { size: [f64; 2], repeat: [f64; 2] },
}

impl Shape {
    /// Number of primitives, as far as it is known before a file is read.
    pub fn count(&self) -> u64 {
        match *self {
            Shape::Mesh { .. } => 0,
            Shape::Sphere(_) => 1,
            Shape::Sphereflake { depth, .. } => sphereflake::count(depth),
            Shape::Terrain(ref terrain) => terrain.count(),
            Shape::Teapot { level } => teapot::count(level),
            Shape::Icosphere { level, .. } => icosphere::count(level),
            Shape::Box { .. } => 12,
            Shape::Plane { .. } => 2,
        }
    }

    /// Bytes that its surfaces will take, about: for a mesh those of its file, whose numbers are as short as text.
    pub fn bytes(&self) -> u64 {
        // A triangle's indices; half a vertex of position, normal and texture coordinates belongs to it.
        const TRIANGLE: u64 = 12 + 32 / 2;
        match self {
            Shape::Mesh { file, .. } => std::fs::metadata(file).map_or(0, |about| about.len()),
            Shape::Sphere(_) | Shape::Sphereflake { .. } => self.count() * size_of::<Sphere>() as u64,
            _ => self.count() * TRIANGLE,
        }
    }

    /// Bytes that it takes beside those of its surfaces while these are made, about.
    pub fn bytes_to_make(&self) -> u64 {
        match self {
            Shape::Sphere(_) | Shape::Sphereflake { .. } | Shape::Terrain(_) => 0,
            // It is made as a whole, then moved into place.
            _ => self.bytes(),
        }
    }

    /// Whether texture coordinates come with the shape (with a mesh: perhaps).
    pub fn has_uvs(&self) -> bool {
        !matches!(self, Shape::Sphere(_) | Shape::Sphereflake { .. } | Shape::Icosphere { .. })
    }
}

/// An object whose material is known by name.
pub fn object(
    source: &Source,
    table: Spanned<tables::Object>,
    materials: &HashMap<String, u32>,
) -> Result<Object> {
    let at = table.span();
    let mut table = table.into_inner();
    let keys = table.keys();
    let kind = source.required(table.r#type.take(), &at, "an object", "type")?.into_inner();
    let common = ["type", "material", "translate", "rotate", "scale", "matrix"];
    let (what, own) = keys_of(kind);
    let shading: &[&str] = match kind {
        ObjectType::Sphere | ObjectType::Sphereflake => &[],
        _ => &["shading"],
    };
    source.only(what, &keys, &[own, &common, shading])?;
    let transform = transform(source, &table)?;
    let material = match table.material.take() {
        None => None,
        Some(name) => match materials.get(name.get_ref()) {
            Some(&index) => Some(index),
            None => {
                let what = format!("no material is named `{}`", name.get_ref());
                return Err(source.error(&name.span(), what, known(materials)));
            }
        },
    };
    let shading = table.shading.take().map_or(Shading::Phong, Spanned::into_inner);
    Ok(Object { shape: shape(source, kind, table, &at, what)?, transform, material, shading, at })
}

/// What a type is called, and the keys of its own.
fn keys_of(kind: ObjectType) -> (&'static str, &'static [&'static str]) {
    match kind {
        ObjectType::Mesh => ("a mesh", &["file"]),
        ObjectType::Sphere => ("a sphere", &["center", "radius"]),
        ObjectType::Sphereflake => ("a sphereflake", &["depth", "radius"]),
        ObjectType::Terrain => ("a terrain", &["cells", "extent", "height", "octaves", "roughness", "seed"]),
        ObjectType::Teapot => ("a teapot", &["level"]),
        ObjectType::Icosphere => ("an icosphere", &["level", "center", "radius"]),
        ObjectType::Box => ("a box", &["size", "min", "max"]),
        ObjectType::Plane => ("a plane", &["size", "repeat"]),
    }
}

fn known(materials: &HashMap<String, u32>) -> String {
    let mut names: Vec<_> = materials.iter().collect();
    names.sort_by_key(|(_, index)| **index);
    let names: Vec<_> = names.iter().take(8).map(|(name, _)| format!("`{name}`")).collect();
    match names.as_slice() {
        [] => "add a [[material]] with this name".into(),
        names => format!("add a [[material]] with this name, or use {}", names.join(", ")),
    }
}

fn shape(source: &Source, kind: ObjectType, table: tables::Object, at: &Span, what: &str) -> Result<Shape> {
    let center = table.center.as_ref().map_or(DVec3::ZERO, |center| center.get_ref().0);
    Ok(match kind {
        ObjectType::Mesh => {
            let file = source.required(table.file, at, what, "file")?;
            Shape::Mesh { file: source.beside(file.get_ref()), at: file.span() }
        }
        ObjectType::Sphere => {
            Shape::Sphere(Ball { center, radius: source.positive(table.radius, 1.0, "radius")? })
        }
        ObjectType::Sphereflake => Shape::Sphereflake {
            depth: source.whole(table.depth, "depth", 0..=sphereflake::MAX_DEPTH)?.unwrap_or(4),
            radius: source.positive(table.radius, 0.5, "radius")?,
        },
        ObjectType::Terrain => {
            let defaults = Terrain::default();
            let roughness = table.roughness.map(|value| (value.get_ref().0, value.span()));
            if let Some((number, at)) = roughness.as_ref().filter(|(number, _)| *number > 1.0) {
                return Err(source.outside(at, "roughness", number, "from 0 to 1"));
            }
            Shape::Terrain(Terrain {
                cells: source.whole(table.cells, "cells", 1..=terrain::MAX_CELLS)?.unwrap_or(defaults.cells),
                // What f32 takes for 0 or infinite would have slopes that f64 can't hold.
                extent: source.number(
                    table.extent,
                    defaults.extent,
                    "extent",
                    |extent| extent as f32 > 0.0 && (extent as f32).is_finite(),
                    "above 1e-45 and below 3.4e38",
                )?,
                height: source.number(
                    table.height,
                    defaults.height,
                    "height",
                    |height| height >= 0.0 && (height as f32).is_finite(),
                    "of at least 0 and below 3.4e38",
                )?,
                octaves: source
                    .whole(table.octaves, "octaves", 1..=terrain::MAX_OCTAVES)?
                    .unwrap_or(defaults.octaves),
                roughness: roughness.map_or(defaults.roughness, |(number, _)| number),
                seed: table.seed.map_or(defaults.seed, Spanned::into_inner),
            })
        }
        ObjectType::Teapot => {
            Shape::Teapot { level: source.whole(table.level, "level", 1..=teapot::MAX_LEVEL)?.unwrap_or(12) }
        }
        ObjectType::Icosphere => Shape::Icosphere {
            level: source.whole(table.level, "level", 0..=icosphere::MAX_LEVEL)?.unwrap_or(3),
            center,
            radius: source.positive(table.radius, 1.0, "radius")?,
        },
        ObjectType::Box => cuboid(source, table, at)?,
        ObjectType::Plane => Shape::Plane {
            size: lengths(source, table.size, 1.0, "size", "[x, z]")?,
            repeat: lengths(source, table.repeat, 1.0, "repeat", "[u, v]")?,
        },
    })
}

fn cuboid(source: &Source, table: tables::Object, at: &Span) -> Result<Shape> {
    match (table.size, table.min, table.max) {
        (size, None, None) => {
            let size = DVec3::from(lengths(source, size, 1.0, "size", "[x, y, z]")?);
            Ok(Shape::Box { low: size * -0.5, high: size * 0.5 })
        }
        (None, Some(min), Some(max)) => {
            let (low, high) = (min.get_ref().0, max.get_ref().0);
            if low.cmplt(high).all() {
                Ok(Shape::Box { low, high })
            } else {
                let what = "`max` isn't above `min` on every axis";
                Err(source.error(&max.span(), what, "exchange what is the wrong way round"))
            }
        }
        (Some(size), ..) => {
            Err(source.error(&size.span(), "`size` beside `min` or `max`", "give `size`, or `min` and `max`"))
        }
        (None, ..) => Err(source.error(at, "a box with one of `min` and `max`", "give both, or `size`")),
    }
}

/// `N` lengths above 0; one number stands for all.
fn lengths<const N: usize>(
    source: &Source,
    value: Option<Spanned<OneOrList<Finite>>>,
    default: f64,
    key: &str,
    form: &str,
) -> Result<[f64; N]> {
    let Some(value) = value else { return Ok([default; N]) };
    let numbers = value.get_ref().spread::<N>().map(|numbers| numbers.map(|Finite(number)| number));
    match numbers {
        Some(numbers) if numbers.iter().all(|&number| number > 0.0 && (number as f32).is_finite()) => {
            Ok(numbers)
        }
        _ => Err(source.error(
            &value.span(),
            format_args!("`{key}` isn't a length above 0 and below 3.4e38, or {N} of them"),
            format!("give a number or {form}"),
        )),
    }
}
