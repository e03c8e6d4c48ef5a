//! The `mapshift` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    mapshift::cli::run()
}
