//! `heliostat validate`: reads scenes and says what is wrong with them.

use std::path::PathBuf;

use super::{print, warn};
use crate::error::Result;
use crate::scene::load;

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes (.toml or .helio) or models (.obj)
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
}

pub fn run(args: &Args) -> Result<()> {
    for path in &args.scenes {
        let loaded = load::load(path)?;
        warn(&loaded.warnings);
        print(&format!("{}: good\n", path.display()))?;
    }
    Ok(())
}
