//! Shell completions and manual pages, made from the flags' own definitions.

use std::path::PathBuf;

use clap::Command;

use super::print;
use crate::error::{Error, Result};
use crate::output::file;

#[derive(Debug, clap::Args)]
pub struct CompletionArgs {
    shell: clap_complete::Shell,
}

#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Write a page for the program and one for each subcommand into this folder
    #[arg(long, value_name = "FOLDER")]
    dir: Option<PathBuf>,
}

pub fn completions(args: &CompletionArgs, mut command: Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "heliostat", &mut script);
    print(&String::from_utf8_lossy(&script))
}

pub fn man(args: &ManArgs, mut command: Command) -> Result<()> {
    command.build();
    let Some(dir) = &args.dir else { return print(&String::from_utf8_lossy(&page(command)?)) };
    for subcommand in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        let name = format!("heliostat-{}", subcommand.get_name());
        let bytes = page(subcommand.clone())?;
        file::write_whole(&dir.join(format!("{name}.1")), |out| std::io::Write::write_all(out, &bytes))?;
    }
    let bytes = page(command)?;
    file::write_whole(&dir.join("heliostat.1"), |out| std::io::Write::write_all(out, &bytes))
}

fn page(command: Command) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    clap_mangen::Man::new(command).render(&mut bytes).map_err(|error| Error::write("manual page", error))?;
    Ok(bytes)
}
