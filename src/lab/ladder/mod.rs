//! The precision ladder: textbook ways to meet rays with triangles and spheres, from the integers of 1994 to the renderer's own f64
//! decision, all given the same rays. What more digits buy can be read from a table and seen in pictures.
//!
//! These kernels live here only: nothing in the renderer knows them. Every primitive is tried, but by [`textbook`], which answers for whole images.

mod aim;
mod fixed;
mod gallery;
mod sphere;
mod sphere_rungs;
pub mod textbook;
mod triangle;
mod triangle_rungs;

use std::fmt;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;

pub use sphere_rungs::SphereRow;
pub use triangle_rungs::TriangleRow;

use crate::error::{Error, Result};

/// What all rungs did.
#[derive(Clone, Debug, Serialize)]
pub struct LadderTable {
    /// Of the triangles' rungs together in all places, and of each rung of the spheres.
    pub rays: u64,
    pub seed: u64,
    pub triangles: Vec<TriangleRow>,
    pub spheres: Vec<SphereRow>,
    /// The sheet of all pictures, if they were asked for.
    pub sheet: Option<PathBuf>,
}

/// Climbs the ladder. `picture` is the folder for the pictures of the spheres, made if need be. On the current rayon pool; all but the
/// times depends on `rays` and `seed` alone.
///
/// # Errors
/// No rays, or pictures that can't be written.
pub fn run(rays: u64, seed: u64, picture: Option<&Path>) -> Result<LadderTable> {
    if rays == 0 {
        return Err(Error::usage("--rays", "0 rays measure nothing", "give at least 1"));
    }
    if let Some(folder) = picture {
        gallery::make_folder(folder)?;
    }
    let triangles = triangle_rungs::climb(rays, seed);
    let (spheres, sheet) = sphere_rungs::climb(rays, seed, picture)?;
    let sheet = picture.zip(sheet).map(|(folder, name)| folder.join(name));
    Ok(LadderTable { rays, seed, triangles, spheres, sheet })
}

/// Nanoseconds for each of the `tests` tests of a block: the median of several blocks, so that a busy machine hardly matters.
fn time_blocks(tests: usize, mut block: impl FnMut() -> f64) -> f64 {
    const BLOCKS: usize = 31;
    let mut times: Vec<Duration> = (0..BLOCKS)
        .map(|_| {
            let start = Instant::now();
            black_box(block());
            start.elapsed()
        })
        .collect();
    times.sort_unstable();
    times[BLOCKS / 2].as_nanos() as f64 / tests.max(1) as f64
}

impl fmt::Display for LadderTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Triangles: rays aimed at vertices, edges and faces of closed meshes, from inside and outside.\n\
             The last rung is what the others are measured against; without --ladder it is itself measured against exact arithmetic"
        )?;
        let place = self.triangles.iter().map(|row| row.place.len()).max().unwrap_or(0);
        writeln!(
            f,
            "  {:<30} {:<place$} {:>9} {:>8} {:>8} {:>8} {:>9} {:>9} {:>7}",
            "", "place", "rays", "leaks", "behind", "before", "t max", "t rms", "ns/test"
        )?;
        for row in &self.triangles {
            let TriangleRow { rung, place: at, rays, leaks, behind, before, t_max, t_rms, ns } = row;
            writeln!(
                f,
                "  {rung:<30} {at:<place$} {rays:>9} {leaks:>8} {behind:>8} {before:>8} {t_max:>9.1e} {t_rms:>9.1e} {ns:>7.1}"
            )?;
        }
        writeln!(
            f,
            "\nSpheres: mirrors seen in perspective; errors of t in sizes of the scene, of normals in degrees"
        )?;
        writeln!(
            f,
            "  {:<22} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>10} {:>9} {:>7}",
            "",
            "rays",
            "disagree",
            "t max",
            "t rms",
            "° max",
            "° rms",
            "mirrored",
            "disagree",
            "t rms",
            "ns/test"
        )?;
        for row in &self.spheres {
            writeln!(
                f,
                "  {:<22} {:>9} {:>9} {:>9.1e} {:>9.1e} {:>9.1e} {:>9.1e} {:>9} {:>10} {:>9.1e} {:>7.1}",
                row.rung,
                row.rays,
                row.disagree,
                row.t_max,
                row.t_rms,
                row.normal_max,
                row.normal_rms,
                row.mirrored,
                row.mirror_disagree,
                row.mirror_t_rms,
                row.ns
            )?;
        }
        if let Some(sheet) = &self.sheet {
            writeln!(
                f,
                "\n{}: from left to right the spheres as above, below each its difference from the last, 8 times enlarged",
                sheet.display()
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_every_rung() {
        let folder = tempfile::tempdir().unwrap();
        let table = run(600, 1, Some(folder.path())).unwrap();
        let text = table.to_string();
        let rungs =
            table.triangles.iter().map(|row| &row.rung).chain(table.spheres.iter().map(|row| &row.rung));
        for rung in rungs {
            assert!(text.contains(rung.as_str()), "{rung} in {text}");
        }
        assert!(text.contains("ladder-sheet.png"), "{text}");
        let json = serde_json::to_value(&table).unwrap();
        assert_eq!(json["spheres"].as_array().unwrap().len(), 10);
        assert!(run(0, 1, None).unwrap_err().to_string().starts_with("--rays: "));
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let message = run(1, 1, Some(file.path())).unwrap_err().to_string();
        assert!(message.contains("can't write"), "{message}");
    }
}
