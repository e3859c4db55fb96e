//! The `aventail` program: parse, run, print, exit. Everything it does is in the library.

use clap::Parser;
use std::io::Write;
use std::process::ExitCode;

/// Arrays of a hundred megabytes come and go: kept from stage to stage and in huge pages, their memory is not fetched page by page
/// each time (docs/decisions/0025-pages.md).
#[cfg(target_os = "linux")]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    let cli = aventail::cli::args::Cli::parse();
    match aventail::cli::run(&cli) {
        Ok(text) => {
            // A reader that has closed its end, such as `head`, is no failure.
            let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
            ExitCode::SUCCESS
        }
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "aventail: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
