//! Camera, render defaults, materials and lights: from tables to what the scene holds.

use std::collections::HashMap;
use std::path::PathBuf;

use ::toml::Spanned;
use glam::DVec3;

use super::physical;
use super::source::{Source, Span};
use super::tables::{self, CameraType, EmissionSide, LightType};
use super::transform::{sin_cos, unit};
use super::value::{Amount, Finite, Rgb};
use crate::error::Result;
use crate::scene::camera::Lens;
use crate::scene::light::LightShape;
use crate::scene::load::{ImageDefaults, environment, warn};
use crate::scene::{Camera, Color, Environment, Light, Material, SceneHeader};

/// The largest width, height and number of samples.
const LIMIT: u32 = 65536;

/// Fails unless `position` and `look_at` say where the camera looks and `up` isn't in the way.
pub fn camera(source: &Source, table: Spanned<tables::Camera>) -> Result<Camera> {
    let at = table.span();
    let table = table.into_inner();
    let kind = table.r#type.as_ref().map_or(CameraType::Perspective, |kind| *kind.get_ref());
    let common = ["type", "position", "look_at", "up"];
    let (what, own): (_, &[&str]) = match kind {
        CameraType::Perspective => ("a perspective camera", &["fov", "lens_radius", "focus"]),
        CameraType::Orthographic => ("an orthographic camera", &["height"]),
    };
    source.only(what, &table.keys(), &[&common, own])?;
    let position = source.required(table.position, &at, what, "position")?.into_inner().0;
    let look_at = source.required(table.look_at, &at, what, "look_at")?;
    let (target, target_at) = (look_at.get_ref().0, look_at.span());
    let up_at = table.up.as_ref().map(|up| up.span());
    let up = table.up.map_or(DVec3::Y, |up| up.into_inner().0);
    let camera = match kind {
        CameraType::Perspective => {
            let fov = source.number(
                table.fov,
                45.0,
                "fov",
                |degrees| degrees > 0.0 && degrees < 180.0,
                "of degrees between 0 and 180",
            )?;
            let distance = (target - position).length();
            let focus_at = table.focus.as_ref().map(|focus| focus.span());
            let focus = source.positive(table.focus, distance, "focus")?;
            let lens = match table.lens_radius {
                None if focus_at.is_some() => {
                    let what = "`focus` of a camera without a lens, to which all is sharp";
                    return Err(source.error(&focus_at.unwrap_or_default(), what, "give `lens_radius` too"));
                }
                None => None,
                Some(radius) => {
                    Some(Lens { radius: source.positive(Some(radius), 0.0, "lens_radius")?, focus })
                }
            };
            Camera::perspective(position, target, up, fov).map(|camera| Camera { lens, ..camera })
        }
        CameraType::Orthographic => {
            let height = source.required(table.height, &at, what, "height")?;
            Camera::orthographic(position, target, up, source.positive(Some(height), 0.0, "height")?)
        }
    };
    camera.ok_or_else(|| match (target - position).try_normalize() {
        None => source.error(
            &target_at,
            "`look_at` is where the camera stands, or endlessly far",
            "look at another point",
        ),
        Some(_) => source.error(
            &up_at.unwrap_or(target_at),
            "`up` is zero or along the view, or `fov` or `height` is beyond computing",
            "give another `up`, such as [0, 0, 1]",
        ),
    })
}

/// Fills in the colours of the scene's header and returns what is said about the image.
pub fn render(source: &Source, table: tables::Render, header: &mut SceneHeader) -> Result<ImageDefaults> {
    let color = |value: Option<Spanned<Rgb>>| value.map_or([0.0; 3], |value| value.into_inner().0);
    header.background = color(table.background);
    header.ambient = color(table.ambient);
    header.ambient_floor = share(source, table.ambient_floor, "ambient_floor")?;
    header.environment =
        environment(source, table.environment, table.environment_scale, table.environment_rotation)?;
    Ok(ImageDefaults {
        width: source.whole(table.width, "width", 1..=LIMIT)?,
        height: source.whole(table.height, "height", 1..=LIMIT)?,
        spp: source.whole(table.spp, "spp", 1..=LIMIT)?,
        seed: table.seed.map(Spanned::into_inner),
        max_depth: table.max_depth.map(Spanned::into_inner),
        min_weight: table.min_weight.map(|value| value.into_inner().0),
        integrator: table.integrator.map(Spanned::into_inner),
        filter: table.filter.map(Spanned::into_inner),
        sampler: table.sampler.map(Spanned::into_inner),
        encoding: table.encoding.map(Spanned::into_inner),
    })
}

/// The image of what is infinitely far, read.
fn environment(
    source: &Source,
    file: Option<Spanned<String>>,
    scale: Option<Spanned<Amount>>,
    rotation: Option<Spanned<Finite>>,
) -> Result<Option<Environment>> {
    let Some(file) = file else {
        let alone = [
            scale.map(|value| ("environment_scale", value.span())),
            rotation.map(|value| ("environment_rotation", value.span())),
        ];
        return match alone.into_iter().flatten().next() {
            None => Ok(None),
            Some((key, at)) => {
                let what = format!("`{key}` without an environment");
                Err(source.error(&at, what, "name its image: environment = \"FILE.exr\""))
            }
        };
    };
    let path = source.beside(file.get_ref());
    let scale = scale.map_or(1.0, |value| value.get_ref().0);
    let rotation = rotation.map_or(0.0, |value| value.get_ref().0.to_radians());
    match environment::read(&path, scale, rotation) {
        Ok(environment) => Ok(Some(environment)),
        Err(error) => Err(source.blame(&file.span(), error)),
    }
}

/// A number in [0, 1], or 0.
pub fn share(source: &Source, value: Option<Spanned<Amount>>, key: &str) -> Result<f64> {
    let Some(value) = value else { return Ok(0.0) };
    let Amount(number) = *value.get_ref();
    if number <= 1.0 { Ok(number) } else { Err(source.outside(&value.span(), key, number, "from 0 to 1")) }
}

/// A material whose texture hasn't been read.
#[derive(Clone, Debug)]
pub struct NamedMaterial {
    pub material: Material,
    /// Image file and where it is named.
    pub texture: Option<(PathBuf, Span)>,
}

/// The materials in their order, and their indices by name.
pub fn materials(
    source: &Source,
    tables: Vec<Spanned<tables::Material>>,
    warnings: &mut Vec<String>,
) -> Result<(Vec<NamedMaterial>, HashMap<String, u32>)> {
    let (mut materials, mut names) = (Vec::new(), HashMap::new());
    for table in tables {
        let at = table.span();
        let mut table = table.into_inner();
        let name = source.required(table.name.take(), &at, "a material", "name")?;
        let name_at = name.span();
        if names.contains_key(name.get_ref()) {
            let what = format!("a second material named `{}`", name.get_ref());
            return Err(source.error(&name_at, what, "give it another name"));
        }
        names.insert(name.into_inner(), materials.len() as u32);
        materials.push(material(source, table, &name_at, warnings)?);
    }
    Ok((materials, names))
}

fn material(
    source: &Source,
    mut table: tables::Material,
    name_at: &Span,
    warnings: &mut Vec<String>,
) -> Result<NamedMaterial> {
    if let Some(reflectivity) = &table.reflectivity
        && let Some(key) =
            [("kr", table.kr.is_some()), ("kt", table.kt.is_some())].iter().find(|(_, given)| *given)
    {
        return Err(source.error(
            &reflectivity.span(),
            format_args!("`reflectivity` together with `{}`", key.0),
            "use `reflectivity` for (1 - r) * local + r * reflected, or `kr` and `kt` for local + kr * reflected + kt * refracted",
        ));
    }
    let physical = physical::surface(source, &mut table, name_at)?;
    let defaults = physical.map_or_else(Material::default, Material::from);
    let color =
        |value: Option<Spanned<Rgb>>, default: Color| value.map_or(default, |value| value.into_inner().0);
    let kd = color(table.kd, defaults.kd);
    let material = Material {
        ka: color(table.ka, kd),
        kd,
        ks: color(table.ks, defaults.ks),
        shininess: table.shininess.map_or(defaults.shininess, |value| value.into_inner().0),
        kr: color(table.kr, defaults.kr),
        kt: color(table.kt, defaults.kt),
        ior: source.positive(table.ior, defaults.ior, "ior")?,
        reflectivity: share(source, table.reflectivity, "reflectivity")?,
        emission: color(table.emission, defaults.emission),
        one_sided: table.emission_side.is_some_and(|side| *side.get_ref() == EmissionSide::Front),
        fresnel: table.fresnel.map_or(defaults.fresnel, Spanned::into_inner),
        texture: None,
        physical,
    };
    if material.fresnel && !material.is_transparent() {
        warn(warnings, source.file, || {
            source.warning(name_at, "`fresnel` has no effect on a material without `kt`")
        });
    }
    let texture = table.texture.map(|file| {
        let at = file.span();
        (source.beside(file.get_ref()), at)
    });
    Ok(NamedMaterial { material, texture })
}

/// A light in world space.
pub fn light(source: &Source, table: Spanned<tables::Light>) -> Result<Light> {
    let at = table.span();
    let table = table.into_inner();
    let keys = table.keys();
    let kind = source.required(table.r#type, &at, "a light", "type")?.into_inner();
    let common = ["type", "color", "diffuse", "specular", "ambient"];
    let (what, own): (_, &[&str]) = match kind {
        LightType::Point => ("a point light", &["position", "falloff"]),
        LightType::Directional => ("a directional light", &["direction"]),
        LightType::Spot => {
            ("a spot light", &["position", "direction", "look_at", "angle", "inner_angle", "falloff"])
        }
    };
    source.only(what, &keys, &[&common, own])?;
    let shape = match kind {
        LightType::Point => LightShape::Point {
            position: source.required(table.position, &at, what, "position")?.into_inner().0,
        },
        LightType::Directional => {
            let direction = source.required(table.direction, &at, what, "direction")?;
            LightShape::Directional {
                direction: unit(source, &direction.span(), direction.get_ref().0, "direction")?,
            }
        }
        LightType::Spot => {
            let position = source.required(table.position, &at, what, "position")?.into_inner().0;
            let direction = match (table.direction, table.look_at) {
                (Some(direction), None) => {
                    unit(source, &direction.span(), direction.get_ref().0, "direction")?
                }
                (None, Some(target)) => {
                    unit(source, &target.span(), target.get_ref().0 - position, "look_at")?
                }
                (None, None) => {
                    let what = "a spot light without `direction` or `look_at`";
                    return Err(source.error(&at, what, "add one of them"));
                }
                (Some(_), Some(target)) => {
                    let what = "`look_at` beside `direction`";
                    return Err(source.error(&target.span(), what, "leave one of them out"));
                }
            };
            let (cos_inner, cos_outer) = cone(source, &at, table.angle, table.inner_angle)?;
            LightShape::Spot { position, direction, cos_inner, cos_outer }
        }
    };
    let falloff = match table.falloff {
        None => None,
        Some(falloff) => {
            let coefficients = falloff.get_ref().map(|Amount(number)| number);
            if coefficients == [0.0; 3] {
                let what = "`falloff` divides by 0";
                return Err(source.error(
                    &falloff.span(),
                    what,
                    "give [c, l, q] of c + l * distance + q * distance^2",
                ));
            }
            Some(coefficients)
        }
    };
    let color =
        |value: Option<Spanned<Rgb>>, default: Color| value.map_or(default, |value| value.into_inner().0);
    let white = color(table.color, [1.0; 3]);
    Ok(Light {
        shape,
        diffuse: color(table.diffuse, white),
        specular: color(table.specular, white),
        ambient: color(table.ambient, [0.0; 3]),
        falloff,
    })
}

/// Cosines of the angles within which a spot is whole and at which it ends.
fn cone(
    source: &Source,
    at: &Span,
    angle: Option<Spanned<Finite>>,
    inner: Option<Spanned<Finite>>,
) -> Result<(f64, f64)> {
    let angle = source.required(angle, at, "a spot light", "angle")?;
    let outer = source.number(
        Some(angle),
        0.0,
        "angle",
        |degrees| degrees > 0.0 && degrees <= 90.0,
        "of degrees above 0, up to 90",
    )?;
    let inner = source.number(
        inner,
        outer,
        "inner_angle",
        |degrees| degrees >= 0.0 && degrees <= outer,
        "from 0 to `angle`",
    )?;
    Ok((sin_cos(inner).1, sin_cos(outer).1))
}
