//! `aventail man`: the help of every verb as manual pages.

use crate::error::{Error, Result};
use clap::{Args, Command};
use std::path::PathBuf;

/// Options of `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for aventail.1, aventail-register.1 and so on; made if missing
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Writes the pages of the program's verbs.
///
/// # Errors
/// [`Error::Write`] when the folder or a file cannot be written.
pub fn run(args: &ManArgs, program: Command) -> Result<String> {
    let refuse = |e: std::io::Error| Error::write(&args.folder, e.to_string(), "choose a folder that you may write to");
    std::fs::create_dir_all(&args.folder).map_err(refuse)?;
    clap_mangen::generate_to(program, &args.folder).map_err(refuse)?;
    Ok(format!("man -l {}", args.folder.join("aventail.1").display()))
}
