//! What building the structures costs: time and memory on generated terrain of growing size.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::accel::Accel;
use crate::scene::Surfaces;
use crate::scene::frame::Frame;
use crate::scene::generate::terrain::{MAX_CELLS, Terrain};
use crate::scene::mesh::{MeshMut, MeshSize};
use crate::settings::{AccelKind, BuildPreset, BuildSettings};

/// Most triangles of a terrain.
pub const MOST: u64 = 2 * MAX_CELLS as u64 * MAX_CELLS as u64;

/// A structure to be built: the hierarchy by a preset, or the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Structure {
    Fast,
    Balanced,
    Best,
    Grid,
}

/// One structure, built some times over.
#[derive(Clone, Debug)]
pub struct Built {
    /// Of each round.
    pub seconds: Vec<f64>,
    /// Of the structure itself.
    pub bytes: usize,
    /// By how much the process grew at most while it was built; `None` where the system doesn't tell. What was freed before may be used again unseen: true of a fresh process.
    pub peak: Option<u64>,
}

/// A terrain of about so many triangles, 2 at least and [`MOST`] at most.
pub fn terrain(triangles: u64) -> Surfaces {
    let cells = (triangles.clamp(2, MOST) as f64 / 2.0).sqrt().round();
    let terrain = Terrain { cells: cells as u32, ..Terrain::default() };
    let MeshSize { vertices, triangles } = terrain.size();
    let (mut positions, mut triangles) = (vec![[0.0; 3]; vertices], vec![[0; 3]; triangles]);
    let uvs = &mut vec![[0.0; 2]; vertices];
    terrain.fill(MeshMut { positions: &mut positions, triangles: &mut triangles, normals: &mut [], uvs });
    let mut surfaces =
        Surfaces { positions: positions.into(), triangles: triangles.into(), ..Surfaces::default() };
    Frame::apply(&mut surfaces);
    surfaces
}

impl Structure {
    fn settings(self) -> (AccelKind, BuildSettings) {
        match self {
            Structure::Fast => (AccelKind::Bvh, BuildPreset::Fast.into()),
            Structure::Balanced => (AccelKind::Bvh, BuildPreset::Balanced.into()),
            Structure::Best => (AccelKind::Bvh, BuildPreset::Best.into()),
            Structure::Grid => (AccelKind::Grid, BuildSettings::default()),
        }
    }

    /// Bytes that it takes to build it, about.
    pub fn memory_to_build(self, surfaces: &Surfaces) -> u64 {
        let (kind, settings) = self.settings();
        Accel::memory_to_build(kind, settings.preset, surfaces)
    }

    /// Builds it on the current rayon pool, in each of some rounds.
    pub fn build(self, surfaces: &Surfaces, rounds: usize) -> Built {
        let (kind, settings) = self.settings();
        let mut built = Built { seconds: Vec::new(), bytes: 0, peak: None };
        for _ in 0..rounds {
            let before = resident::forget_peak();
            let start = Instant::now();
            let accel = Accel::build(kind, settings, surfaces);
            built.seconds.push(start.elapsed().as_secs_f64());
            let grown = before.and_then(|before| Some(resident::peak()?.saturating_sub(before)));
            built.peak = built.peak.max(grown);
            built.bytes = accel.memory();
        }
        built
    }
}

/// Memory of this process as Linux counts it.
mod resident {
    /// Bytes that are resident now; from here on the peak is counted anew. `None` where that isn't possible.
    pub fn forget_peak() -> Option<u64> {
        std::fs::write("/proc/self/clear_refs", "5").ok()?;
        status("VmRSS:")
    }

    /// The most bytes that were resident.
    pub fn peak() -> Option<u64> {
        status("VmHWM:")
    }

    fn status(name: &str) -> Option<u64> {
        let text = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

    #[test]
    fn every_structure_is_built_as_often_as_asked() {
        let surfaces = terrain(1000);
        assert!((900..1100).contains(&surfaces.triangles.len()), "{}", surfaces.triangles.len());
        for &structure in Structure::value_variants() {
            let built = structure.build(&surfaces, 2);
            assert_eq!(built.seconds.len(), 2);
            assert!(built.bytes > 1000, "{structure:?} takes {} bytes", built.bytes);
            assert!(structure.memory_to_build(&surfaces) > 1000);
        }
    }
}
