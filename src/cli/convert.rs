//! `heliostat convert`: any scene into one file that is mapped.

use std::path::PathBuf;

use super::{note, warn};
use crate::error::{Error, Result};
use crate::output::file;
use crate::scene::build::Space;
use crate::scene::helio::HelioWriter;
use crate::scene::load::{self, helio};

#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene (.toml) or a model (.obj)
    scene: PathBuf,
    /// The file that is written; while that goes on its disk must hold the scene twice [default: the scene's name, .helio]
    #[arg(short, long, value_name = "FILE.helio")]
    output: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(short, long, env = "HELIOSTAT_QUIET")]
    quiet: bool,
}

pub fn run(args: &Args) -> Result<()> {
    let output = match &args.output {
        Some(output) => output.clone(),
        None => {
            let mut name = args.scene.file_stem().unwrap_or("scene".as_ref()).to_owned();
            name.push(".helio");
            name.into()
        }
    };
    if !output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("helio")) {
        let what = format!("{} would not be known for a converted scene", output.display());
        return Err(Error::usage("--output", what, "give it a name that ends in .helio"));
    }
    file::check_writable(&output)?;
    // What is made grows beside the file that it will be in, so that none of it must fit into memory.
    let folder = file::folder(&output)?;
    let loaded = load::load_in(&args.scene, Space::Disk(&folder))?;
    if !args.quiet {
        warn(&loaded.warnings);
    }
    file::write_whole(&output, |out| {
        let mut writer = HelioWriter::new(out)?;
        helio::write(&mut writer, &loaded)?;
        writer.finish()
    })?;
    if !args.quiet {
        let surfaces = &loaded.scene.surfaces;
        let (triangles, spheres) = (surfaces.triangles.len(), surfaces.spheres.len());
        note(format_args!("wrote {}: {triangles} triangles, {spheres} spheres", output.display()));
    }
    Ok(())
}
