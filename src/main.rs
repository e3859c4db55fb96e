//! The `aventail` program. Everything it does is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(aventail::cli::main(std::env::args_os().collect()))
}
