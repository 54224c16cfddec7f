//! The program `heliostat`.

use std::process::ExitCode;

fn main() -> ExitCode {
    heliostat::cli::main()
}
