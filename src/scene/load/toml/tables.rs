//! The tables of a scene file as they are written: every key that exists, none of them checked against the
//! others.

use ::toml::Spanned;
use serde::Deserialize;

use super::source::Span;
use super::value::{Amount, Finite, OneOrList, Rgb, Rotation, Vector};
use crate::scene::Shading;
use crate::scene::metal::Metal;
use crate::settings::{Encoding, Filter, Integrator, SamplerKind};

/// A whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub camera: Option<Spanned<Camera>>,
    #[serde(default)]
    pub render: Render,
    #[serde(default)]
    pub material: Vec<Spanned<Material>>,
    #[serde(default)]
    pub light: Vec<Spanned<Light>>,
    #[serde(default)]
    pub object: Vec<Spanned<Object>>,
}

/// A table whose `type` decides which of its keys mean something.
macro_rules! table {
    ($(#[$about:meta])* $name:ident { $($key:ident: $value:ty,)* }) => {
        $(#[$about])*
        #[derive(Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $(pub $key: Option<Spanned<$value>>,)*
        }

        impl $name {
            /// The keys that are there, and where their values are.
            pub fn keys(&self) -> Vec<(&'static str, Span)> {
                let mut keys = Vec::new();
                $(if let Some(value) = &self.$key {
                    keys.push((stringify!($key).trim_start_matches("r#"), value.span()));
                })*
                keys
            }
        }
    };
}

table! {
    /// `[camera]`
    Camera {
        r#type: CameraType,
        position: Vector,
        look_at: Vector,
        up: Vector,
        fov: Finite,
        height: Finite,
        lens_radius: Finite,
        focus: Finite,
    }
}

/// `[render]`
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Render {
    pub width: Option<Spanned<u32>>,
    pub height: Option<Spanned<u32>>,
    pub spp: Option<Spanned<u32>>,
    pub seed: Option<Spanned<u64>>,
    pub max_depth: Option<Spanned<u32>>,
    pub min_weight: Option<Spanned<Amount>>,
    pub integrator: Option<Spanned<Integrator>>,
    pub filter: Option<Spanned<Filter>>,
    pub sampler: Option<Spanned<SamplerKind>>,
    pub encoding: Option<Spanned<Encoding>>,
    pub background: Option<Spanned<Rgb>>,
    pub environment: Option<Spanned<String>>,
    pub environment_scale: Option<Spanned<Amount>>,
    pub environment_rotation: Option<Spanned<Finite>>,
    pub ambient: Option<Spanned<Rgb>>,
    pub ambient_floor: Option<Spanned<Amount>>,
}

table! {
    /// `[[material]]`
    Material {
        name: String,
        r#type: MaterialType,
        ka: Rgb,
        kd: Rgb,
        ks: Rgb,
        shininess: Amount,
        kr: Rgb,
        kt: Rgb,
        ior: Finite,
        reflectivity: Amount,
        emission: Rgb,
        emission_side: EmissionSide,
        fresnel: bool,
        texture: String,
        metal: Metal,
        eta: Rgb,
        k: Rgb,
        roughness: Amount,
    }
}

table! {
    /// `[[light]]`
    Light {
        r#type: LightType,
        position: Vector,
        direction: Vector,
        look_at: Vector,
        angle: Finite,
        inner_angle: Finite,
        color: Rgb,
        diffuse: Rgb,
        specular: Rgb,
        ambient: Rgb,
        falloff: [Amount; 3],
    }
}

table! {
    /// `[[object]]`
    Object {
        r#type: ObjectType,
        material: String,
        shading: Shading,
        translate: Vector,
        rotate: Rotation,
        scale: OneOrList<Finite>,
        matrix: [[Finite; 4]; 4],
        file: String,
        center: Vector,
        radius: Finite,
        depth: u32,
        level: u32,
        cells: u32,
        extent: Finite,
        height: Finite,
        octaves: u32,
        roughness: Amount,
        seed: u64,
        size: OneOrList<Finite>,
        min: Vector,
        max: Vector,
        repeat: OneOrList<Finite>,
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraType {
    Perspective,
    Orthographic,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EmissionSide {
    Both,
    Front,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaterialType {
    Phong,
    Conductor,
    Dielectric,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightType {
    Point,
    Directional,
    Spot,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ObjectType {
    Mesh,
    Sphere,
    Sphereflake,
    Terrain,
    Teapot,
    Icosphere,
    Box,
    Plane,
}
