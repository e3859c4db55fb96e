//! `aventail study`: the thesis's figures made again by the program.

use super::args::StudyArgs;
use super::register::{open_folder, progress};
use crate::concepts;
use crate::error::{Error, Result};
use crate::report::write_concepts;
use crate::runtime::Runtime;

/// Makes the concept figures; returns what was written.
///
/// # Errors
/// When nothing is asked for, or the folder cannot be written.
pub fn run(args: &StudyArgs) -> Result<String> {
    if !args.concepts {
        return Err(Error::usage("nothing to make is named", "add --concepts for the concept figures"));
    }
    open_folder(&args.out)?;
    let runtime = Runtime::new(args.threads, progress(args.quiet))?;
    let figures = runtime.stage("concept figures", || concepts::figures(runtime.progress()))?;
    let names = runtime.stage("write", || write_concepts(&args.out, &figures))?;
    let lines = figures.iter().zip(&names).map(|(f, name)| format!("{name}: {}. {}", f.title, f.caption));
    Ok(lines.collect::<Vec<_>>().join("\n"))
}
