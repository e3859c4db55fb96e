//! The `aventail` program: parse, run, print, exit. Everything it does is in the library.

use aventail::cli::terminal::harmless;
use aventail::{Error, cli};
use clap::Parser;
use std::io::{ErrorKind, IsTerminal, Write};
use std::process::ExitCode;

fn main() -> ExitCode {
    let done = match cli::args::Cli::try_parse() {
        Ok(cli) => cli::run(&cli).and_then(|text| print(&format!("{}\n", harmless(text.trim_end())))),
        // Help and version.
        Err(shown) if !shown.use_stderr() => {
            let text = shown.render();
            print(&if std::io::stdout().is_terminal() { text.ansi().to_string() } else { text.to_string() })
        }
        Err(wrong) => wrong.exit(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "aventail: {}", harmless(&error.to_string()));
            ExitCode::from(error.exit_code())
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

/// The library's own standard output takes it as written when it is not open for writing.
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
