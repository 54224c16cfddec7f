//! The tables of a scene file as they are written: every key that exists, none of them checked against the
//! others.

use ::toml::Spanned;
use serde::Deserialize;

use super::source::Span;
use super::value::{Amount, Finite, OneOrList, Rgb, Rotation, Vector};
use crate::scene::Shading;
use crate::settings::{Encoding, Filter, Integrator};

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

/// A table all of whose keys are optional and know their place.
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
    }
}

table! {
    /// `[render]`
    Render {
        width: u32,
        height: u32,
        spp: u32,
        seed: u64,
        max_depth: u32,
        min_weight: Amount,
        integrator: Integrator,
        filter: Filter,
        encoding: Encoding,
        background: Rgb,
        ambient: Rgb,
        ambient_floor: Amount,
    }
}

table! {
    /// `[[material]]`
    Material {
        name: String,
        ka: Rgb,
        kd: Rgb,
        ks: Rgb,
        shininess: Amount,
        kr: Rgb,
        kt: Rgb,
        ior: Finite,
        reflectivity: Amount,
        emission: Rgb,
        fresnel: bool,
        texture: String,
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
