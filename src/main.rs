//! The `aventail` program: parse, run, print, exit. Everything it does is in the library.

use aventail::cli::terminal::harmless;
use clap::Parser;
use std::io::Write;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = aventail::cli::args::Cli::parse();
    match aventail::cli::run(&cli) {
        Ok(text) => {
            // A reader that has closed its end, such as `head`, is no failure.
            let _ = writeln!(std::io::stdout(), "{}", harmless(text.trim_end()));
            ExitCode::SUCCESS
        }
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "aventail: {}", harmless(&error.to_string()));
            ExitCode::from(error.exit_code())
        }
    }
}
