//! What an MTL material means here: the table in `docs/materials.md`. Reads no file but textures, through their
//! cache.

use std::path::Path;

use super::locate::locate;
use super::texture::Textures;
use super::words::shown;
use crate::scene::{Color, Material};

/// The material that `source`, from the MTL file at `path`, stands for. Warnings name file and material.
pub(super) fn material(
    source: &tobj::Material,
    path: &Path,
    textures: &mut Textures,
    warnings: &mut Vec<String>,
) -> Material {
    let mut warn = |what: String| {
        super::warn(warnings, path, || {
            format!("{}: material `{}`: {what}", path.display(), shown(source.name.as_bytes()))
        });
    };
    let texture = source.diffuse_texture.as_deref().and_then(|map| texture(map, path, textures, &mut warn));
    let mut color = |keyword: &str, value: Option<[f32; 3]>| -> Option<Color> {
        let value = value?;
        if value.iter().any(|&c| c < 0.0) {
            warn(format!("{keyword} has a negative number, taken as 0"));
        }
        Some(value.map(|c| f64::from(c.max(0.0))))
    };
    let (ka, kd) = (color("Ka", source.ambient), color("Kd", source.diffuse));
    let ks = color("Ks", source.specular).unwrap_or_default();
    let ke = color("Ke", source.emissive).unwrap_or_default();
    let filter = color("Tf", triple(source, "Tf")).unwrap_or([1.0; 3]);

    let kd = match kd {
        // A texture that multiplies black was not meant to be black.
        Some(kd) if texture.is_some() && kd == [0.0; 3] => [1.0; 3],
        Some(kd) => kd,
        None if texture.is_some() => [1.0; 3],
        None => Material::default().kd,
    };
    let ka = ka.unwrap_or(kd);
    let model = source.illumination_model.unwrap_or(if ks == [0.0; 3] { 1 } else { 2 });
    let opacity = opacity(source, model, &mut warn);
    let mut result = Material { ka, kd, emission: ke, texture, ior: 1.0, ..Material::default() };
    // An exponent of 0 would spread the highlight over everything: exporters write it for "none".
    let shininess = source.shininess.map_or(result.shininess, f64::from);
    if model >= 2 && shininess > 0.0 {
        (result.ks, result.shininess) = (ks, shininess);
    }
    match model {
        0 if texture.is_some() => {
            warn("illum 0 (unlit) can't be used with a texture: lit instead".to_owned())
        }
        0 => {
            result.emission = [0, 1, 2].map(|k| ke[k] + kd[k]);
            (result.ka, result.kd) = ([0.0; 3], [0.0; 3]);
        }
        3 | 4 | 5 | 8 | 9 => result.kr = ks,
        _ => {}
    }
    if let 6 | 7 = model {
        glass(&mut result, source, model, opacity, ks, filter);
    } else if opacity < 1.0 {
        let through = 1.0 - opacity;
        for local in [&mut result.ka, &mut result.kd, &mut result.ks, &mut result.kr, &mut result.emission] {
            *local = local.map(|c| c * opacity);
        }
        result.kt = filter.map(|c| c * through);
    }
    result
}

/// Refraction, illum 6 and 7. Files often give no `d` for it, or 1.
fn glass(result: &mut Material, source: &tobj::Material, model: u8, opacity: f64, ks: Color, filter: Color) {
    let through = if opacity < 1.0 { 1.0 - opacity } else { 1.0 };
    result.ior = match source.optical_density {
        Some(density) if density > 0.0 => f64::from(density),
        _ => Material::default().ior,
    };
    if opacity < 1.0 {
        (result.ka, result.kd) = (result.ka.map(|c| c * opacity), result.kd.map(|c| c * opacity));
    }
    result.kt = filter.map(|c| c * through);
    if model == 7 {
        result.fresnel = true;
    } else {
        result.kr = ks;
        result.kt = [0, 1, 2].map(|k| result.kt[k] * (1.0 - ks[k]).max(0.0));
    }
}

/// How much of the surface covers what is behind it, in [0, 1].
fn opacity(source: &tobj::Material, model: u8, warn: &mut impl FnMut(String)) -> f64 {
    let transparency = triple(source, "Tr").map(|[value, ..]| f64::from(value));
    let opacity = match (source.dissolve.map(f64::from), transparency) {
        (Some(dissolve), Some(transparency)) => {
            if (dissolve + transparency - 1.0).abs() > 1e-3 {
                warn(format!("d {dissolve} and Tr {transparency} contradict each other: d is used"));
            }
            dissolve
        }
        (Some(dissolve), None) => dissolve,
        (None, Some(transparency)) => 1.0 - transparency,
        (None, None) => 1.0,
    };
    let clamped = opacity.clamp(0.0, 1.0);
    if clamped != opacity {
        warn(format!("an opacity of {opacity} is taken as {clamped}"));
    }
    // Exporters disagree on which of 0 and 1 is opaque; nobody models a surface that can't be seen.
    if clamped == 0.0 && !matches!(model, 4 | 6 | 7 | 9) {
        warn(
            "d 0 or Tr 1 would make it invisible: taken as opaque (for glass write illum 6 or 7)".to_owned(),
        );
        return 1.0;
    }
    clamped
}

/// Numbers that `tobj` keeps as text; what is missing is the same as the first.
fn triple(source: &tobj::Material, keyword: &str) -> Option<[f32; 3]> {
    let mut values = source.unknown_param.get(keyword)?.split_whitespace().map(|word| word.parse().ok());
    let first = values.next()??;
    Some([first, values.next().flatten().unwrap_or(first), values.next().flatten().unwrap_or(first)])
}

fn texture(map: &str, path: &Path, textures: &mut Textures, warn: &mut impl FnMut(String)) -> Option<u32> {
    let (name, changed) = file_of(map);
    if changed {
        warn(format!("the options of map_Kd {} are left out", shown(map.as_bytes())));
    }
    let Some(found) = locate(path.parent().unwrap_or(Path::new("")), name) else {
        warn(format!("texture `{}` not found: Kd is used alone", shown(name.as_bytes())));
        return None;
    };
    if !found.exact {
        warn(format!("took {} for texture `{}`", found.path.display(), shown(name.as_bytes())));
    }
    match textures.load(&found.path) {
        Ok(index) => Some(index),
        Err(error) => {
            warn(format!("Kd is used alone, as its texture can't be: {error}"));
            None
        }
    }
}

/// The file name in the arguments of a map, without the options before and behind it; and whether one of them
/// would change the picture.
fn file_of(map: &str) -> (&str, bool) {
    let mut rest = map.trim();
    let mut changed = false;
    while let Some((behind, changes)) = after_option(rest) {
        rest = behind;
        changed |= changes;
    }
    // Some files have options behind the name.
    for (at, _) in rest.match_indices(" -") {
        if let Some((behind, changes)) = after_option(&rest[at + 1..])
            && (behind.is_empty() || behind.starts_with('-'))
        {
            return (rest[..at].trim_end(), changed | changes);
        }
    }
    (rest, changed)
}

/// What follows the option at the start of `text`, and whether that option would change the picture; `None` if
/// there is no option.
fn after_option(text: &str) -> Option<(&str, bool)> {
    let (option, mut rest) = first_word(text);
    let (least, most) = match option {
        "-blendu" | "-blendv" | "-cc" | "-clamp" | "-bm" | "-boost" | "-imfchan" | "-texres" | "-type"
        | "-colorspace" => (1, 1),
        "-mm" => (2, 2),
        "-o" | "-s" | "-t" => (1, 3),
        _ => return None,
    };
    let neutral = match option {
        "-o" | "-t" => Some(0.0),
        "-s" => Some(1.0),
        _ => None,
    };
    let mut changes = option == "-mm";
    for count in 0..most {
        let (word, behind) = first_word(rest);
        let number = word.parse::<f32>().ok();
        if count >= least && number.is_none() {
            break;
        }
        changes |= neutral.is_some() && number != neutral || option == "-clamp" && word == "on";
        rest = behind;
    }
    Some((rest, changes))
}

fn first_word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_at(text.find(char::is_whitespace).unwrap_or(text.len()));
    (word, rest.trim_start())
}

#[cfg(test)]
#[path = "mtl_tests.rs"]
mod tests;
