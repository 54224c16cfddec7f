//! `heliostat info`: what a scene holds and needs.

use std::path::PathBuf;

use rayon::prelude::*;

use super::{print, warn};
use crate::error::Result;
use crate::scene::load;
use crate::scene::mesh::has_area;
use crate::settings::{AccelKind, BuildPreset};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene (.toml or .helio) or a model (.obj)
    scene: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(serde::Serialize)]
struct Info {
    triangles: usize,
    spheres: usize,
    vertices: usize,
    /// Triangles without area, which no ray can hit.
    dropped: usize,
    parts: usize,
    materials: usize,
    textures: usize,
    lights: usize,
    /// Lower and upper corner, world space; null for an empty scene.
    bounds: Option<[[f64; 3]; 2]>,
    /// Subtracted from and multiplied with every coordinate, exactly.
    shift: [f64; 3],
    scale: f64,
    surface_bytes: usize,
    texture_bytes: usize,
    bvh_bytes: usize,
}

pub fn run(args: &Args) -> Result<()> {
    let loaded = load::load(&args.scene)?;
    warn(&loaded.warnings);
    let (surfaces, header) = (&loaded.scene.surfaces, &loaded.scene.header);
    let info = Info {
        triangles: surfaces.triangles.len(),
        spheres: surfaces.spheres.len(),
        vertices: surfaces.positions.len(),
        dropped: (0..surfaces.triangles.len() as u32)
            .into_par_iter()
            .filter(|&id| !has_area(&surfaces.triangle(id)))
            .count(),
        parts: header.parts.len(),
        materials: header.materials.len(),
        textures: loaded.scene.textures.len(),
        lights: header.lights.len(),
        bounds: surfaces.bounds().map(|(low, high)| [low, high].map(|p| header.frame.to_world(p).to_array())),
        shift: header.frame.shift.to_array(),
        scale: header.frame.scale,
        surface_bytes: surfaces.memory(),
        texture_bytes: loaded.scene.textures.iter().map(|texture| texture.texels.len() * 3).sum(),
        bvh_bytes: super::build_accel(AccelKind::Bvh, BuildPreset::Balanced, surfaces, &args.scene)?.memory(),
    };
    if args.json {
        let json = serde_json::to_string_pretty(&info).expect("plain numbers have a JSON form");
        return print(&(json + "\n"));
    }
    print(&table(&info))
}

fn table(info: &Info) -> String {
    let mib = |bytes: usize| format!("{:.2} MiB", bytes as f64 / f64::from(1 << 20));
    let bounds = match info.bounds {
        Some([low, high]) => format!("{low:?} to {high:?}"),
        None => "none".into(),
    };
    let rows = [
        ("triangles", info.triangles.to_string()),
        ("dropped, without area", info.dropped.to_string()),
        ("spheres", info.spheres.to_string()),
        ("vertices", info.vertices.to_string()),
        ("parts", info.parts.to_string()),
        ("materials", info.materials.to_string()),
        ("textures", info.textures.to_string()),
        ("lights", info.lights.to_string()),
        ("bounds", bounds),
        ("exact frame", format!("(x - {:?}) * {:e}", info.shift, info.scale)),
        ("memory, surfaces", mib(info.surface_bytes)),
        ("memory, textures", mib(info.texture_bytes)),
        ("memory, BVH", mib(info.bvh_bytes)),
    ];
    rows.iter().map(|(name, value)| format!("{name:22} {value}\n")).collect()
}
