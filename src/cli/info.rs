//! `heliostat info`: what a scene holds and needs.

use std::path::PathBuf;

use rayon::prelude::*;

use super::render::{Copies, copies, replicates};
use super::{print, warn};
use crate::error::Result;
use crate::lab::prediction::{self, RankMemory};
use crate::scene::load::{self, Loaded};
use crate::scene::mesh::has_area;
use crate::settings::{AccelKind, BuildPreset, ImageSettings, Split};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene (.toml or .helio) or a model (.obj)
    scene: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Foretell what each of --ranks will hold with this --split of render, instead
    #[arg(long, requires = "ranks")]
    split: Option<Split>,
    /// How many ranks --split is asked about
    #[arg(long, value_name = "N", requires = "split", value_parser = clap::value_parser!(u32).range(1..=65536))]
    ranks: Option<u32>,
    /// Memory of each rank for copies of hot blocks, as of render with the hierarchy [default: 32M]
    #[arg(long, value_name = "BYTES", requires = "split", value_parser = copies)]
    replicate_hot: Option<Copies>,
}

/// What ranks will hold of a divided scene.
#[derive(serde::Serialize)]
struct Foretold {
    primitives: usize,
    /// Primitives of all ranks over those of the scene, less 1: what is held more than once.
    overhead: f64,
    ranks: Vec<RankMemory>,
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
    if let (Some(split), Some(ranks)) = (args.split, args.ranks) {
        return foretell(args, &loaded, split, ranks);
    }
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

fn foretell(args: &Args, loaded: &Loaded, split: Split, ranks: u32) -> Result<()> {
    let replicate_hot = replicates(args.replicate_hot, split)?;
    let default = ImageSettings::default();
    let size = (loaded.image.width.unwrap_or(default.width), loaded.image.height.unwrap_or(default.height));
    let image = ImageSettings::sized(size.0, size.1);
    let primitives = loaded.scene.surfaces.len();
    let ranks = prediction::predict(&loaded.scene, &image, split, ranks as usize, replicate_hot);
    let held: u64 = ranks.iter().map(|rank| rank.primitives).sum();
    let overhead = held as f64 / primitives.max(1) as f64 - 1.0;
    if args.json {
        let told = Foretold { primitives, overhead, ranks };
        let json = serde_json::to_string_pretty(&told).expect("plain numbers have a JSON form");
        return print(&(json + "\n"));
    }
    let mut text = String::from("  rank   primitives  scene MiB    BVH MiB   peak MiB\n");
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let row = |name: String, memory: &RankMemory| {
        let RankMemory { primitives, scene_bytes, bvh_bytes, peak_bytes } = *memory;
        let [scene, bvh, peak] = [scene_bytes, bvh_bytes, peak_bytes].map(mib);
        format!("{name:>6} {primitives:12} {scene:10.2} {bvh:10.2} {peak:10.2}\n")
    };
    ranks.iter().enumerate().for_each(|(rank, memory)| text += &row(rank.to_string(), memory));
    if let Some(most) = ranks.iter().max_by_key(|rank| rank.primitives) {
        text += &row("most".into(), most);
    }
    text += &format!("{primitives} primitives; all ranks together hold {:.1} % more\n", 100.0 * overhead);
    print(&text)
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
