//! Materials known by their physics: the keys that `type` brings with it.

use ::toml::Spanned;

use super::header::share;
use super::source::{Source, Span};
use super::tables::{self, MaterialType};
use super::value::Rgb;
use crate::error::Result;
use crate::scene::Color;
use crate::scene::material::Physical;

/// The largest index of refraction, real or imaginary.
const LARGEST_INDEX: f64 = 1000.0;

/// What the table's `type` makes of the surface, or `None` for one of coefficients alone. Refuses keys of other types.
pub fn surface(source: &Source, table: &mut tables::Material, at: &Span) -> Result<Option<Physical>> {
    let kind = table.r#type.as_ref().map_or(MaterialType::Phong, |kind| *kind.get_ref());
    let common = ["type", "ka", "kd", "ks", "shininess", "kr", "emission", "emission_side"];
    let (what, own): (_, &[&str]) = match kind {
        MaterialType::Phong => {
            ("a material of coefficients", &["kt", "ior", "reflectivity", "fresnel", "texture"])
        }
        MaterialType::Conductor => ("a conductor", &["metal", "eta", "k", "roughness"]),
        MaterialType::Dielectric => ("a dielectric", &["ior", "roughness", "kt", "fresnel"]),
    };
    source.only(what, &table.keys(), &[&common, own])?;
    Ok(match kind {
        MaterialType::Phong => None,
        MaterialType::Conductor => {
            let (eta, k) = index(source, table, at)?;
            Some(Physical::Conductor {
                eta,
                k,
                roughness: share(source, table.roughness.take(), "roughness")?,
            })
        }
        MaterialType::Dielectric => {
            Some(Physical::Dielectric { roughness: share(source, table.roughness.take(), "roughness")? })
        }
    })
}

/// The complex index of a conductor: that of a metal, or as given.
fn index(source: &Source, table: &mut tables::Material, at: &Span) -> Result<(Color, Color)> {
    let (eta, k) = (table.eta.take(), table.k.take());
    if let Some(metal) = &table.metal {
        return match eta.map(|eta| ("eta", eta.span())).or(k.map(|k| ("k", k.span()))) {
            None => Ok(metal.get_ref().index()),
            Some((key, at)) => {
                Err(source.error(&at, format_args!("`{key}` beside `metal`"), "leave one of them out"))
            }
        };
    }
    if eta.is_none() && k.is_none() {
        let mend = "add `metal = \"gold\"`, \"silver\", \"copper\" or \"aluminium\", or `eta` and `k`";
        return Err(source.error(at, "a conductor without `metal`", mend));
    }
    let part = |value: Option<Spanned<Rgb>>, key| {
        let value = source.required(value, at, "a conductor", key)?;
        let Rgb(channels) = *value.get_ref();
        match channels.into_iter().find(|&channel| channel > LARGEST_INDEX) {
            None => Ok(channels),
            Some(channel) => {
                Err(source.outside(&value.span(), key, channel, &format!("from 0 to {LARGEST_INDEX}")))
            }
        }
    };
    Ok((part(eta, "eta")?, part(k, "k")?))
}
