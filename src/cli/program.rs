//! The whole program: parse, run, print. The `aventail` binary and the Python package's console script both call it.

use super::terminal::{called_with, harmless};
use super::verbs::Cli;
use crate::error::Error;
use clap::Parser;
use std::ffi::OsString;
use std::io::{ErrorKind, IsTerminal, Write};

/// Runs a command line, whose first entry is the program's name, and returns the process's exit code: 0, or that of
/// [`Error::exit_code`]. Results go to standard output, progress and errors to standard error.
pub fn main(arguments: Vec<OsString>) -> u8 {
    called_with(&arguments);
    let done = match Cli::try_parse_from(arguments) {
        Ok(cli) => super::run(&cli).and_then(|text| print(&format!("{}\n", harmless(text.trim_end())))),
        // Help and version.
        Err(shown) if !shown.use_stderr() => {
            let text = shown.render();
            print(&if std::io::stdout().is_terminal() { text.ansi().to_string() } else { text.to_string() })
        }
        Err(wrong) => {
            let _ = wrong.print();
            return wrong.exit_code().try_into().unwrap_or(2);
        }
    };
    match done {
        Ok(()) => 0,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "aventail: {}", harmless(&error.to_string()));
            error.exit_code()
        }
    }
}

/// Writes to standard output. A reader that has closed its end, such as `head`, is no failure.
fn print(text: &str) -> Result<(), Error> {
    match write(text.as_bytes()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Error::write("standard output", e.to_string(), "free some space, or send it elsewhere"))
        }
        _ => Ok(()),
    }
}

/// The standard library's own standard output takes it as written when it is not open for writing.
#[cfg(unix)]
fn write(bytes: &[u8]) -> std::io::Result<()> {
    use std::os::fd::AsFd;
    let out = std::io::stdout();
    let mut file = std::fs::File::from(out.as_fd().try_clone_to_owned()?);
    file.write_all(bytes)
}

#[cfg(not(unix))]
fn write(bytes: &[u8]) -> std::io::Result<()> {
    let mut out = std::io::stdout();
    out.write_all(bytes)?;
    out.flush()
}
