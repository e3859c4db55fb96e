//! What Slicer runs: a registration between its temporary files.

use super::super::args::{SpeedName, ThreadArgs};
use super::super::register::{self, RegisterArgs};
use super::describe::xml;
use super::progress::ForSlicer;
use crate::error::{Error, Result};
use crate::io::{check_files, check_place, write_file};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, Parser, ValueEnum};
use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};

/// The parameters of the module as Slicer gives them; what was left empty is missing or an empty text.
#[derive(Debug, Args)]
#[command(rename_all = "camelCase")]
pub struct ModuleArgs {
    /// Describe the module
    #[arg(long)]
    xml: bool,
    #[arg(long, value_name = "FILE", value_parser = path(), required_unless_present = "xml")]
    planning: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path(), required_unless_present = "xml")]
    bones: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path(), required_unless_present = "xml")]
    fraction: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    labels: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    transform: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    inverse: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    warped: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    warped_bones: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    jacobian: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    uncertainty: Option<PathBuf>,
    #[arg(long, value_name = "DIR", value_parser = path())]
    report: Option<PathBuf>,
    #[arg(long, value_enum, default_value = "balanced")]
    speed: SpeedName,
    #[arg(long, value_name = "FILE", value_parser = path())]
    landmarks: Option<PathBuf>,
    #[arg(long, value_name = "FILE", value_parser = path())]
    config: Option<PathBuf>,
    #[command(flatten)]
    work: ThreadArgs,
    /// Where Slicer would read numbers that a module returns; there are none
    #[arg(long, value_name = "FILE", value_parser = path())]
    returnparameterfile: Option<PathBuf>,
}

/// A path that may be empty.
fn path() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

/// `register` by itself.
#[derive(Debug, Parser)]
struct Own {
    #[command(flatten)]
    register: RegisterArgs,
}

/// A result that was asked for: where Slicer reads it, and what `register` calls it.
type SlicerWanted<'a> = (&'a Path, &'static str);

impl ModuleArgs {
    /// What Slicer has no node for, it leaves out or gives as an empty text.
    fn given(path: &Option<PathBuf>) -> Option<&Path> {
        path.as_deref().filter(|p| !p.as_os_str().is_empty())
    }

    fn wanted(&self) -> Vec<SlicerWanted<'_>> {
        let all = [
            (&self.transform, "fraction_to_planning.nrrd"),
            (&self.inverse, "planning_to_fraction.nrrd"),
            (&self.warped, "planning_on_fraction.nii.gz"),
            (&self.warped_bones, "bones_on_fraction.nii.gz"),
            (&self.jacobian, "jacobian.nii.gz"),
            (&self.uncertainty, "uncertainty.nii.gz"),
        ];
        all.into_iter().filter_map(|(path, name)| Some((Self::given(path)?, name))).collect()
    }

    /// The command line of `register` that does the same.
    fn command(&self, out: &Path) -> Result<Vec<OsString>> {
        let mut words: Vec<OsString> = ["register", "--dvf-format", "nrrd"].map(OsString::from).into();
        let files = [
            ("--planning", &self.planning),
            ("--bones", &self.bones),
            ("--fraction", &self.fraction),
            ("--labels", &self.labels),
            ("--landmarks", &self.landmarks),
            ("--config", &self.config),
        ];
        for (flag, path) in files {
            let needed = ["--planning", "--bones", "--fraction"].contains(&flag);
            match Self::given(path) {
                Some(path) => words.extend([flag.into(), path.as_os_str().to_owned()]),
                None if needed => {
                    return Err(Error::usage(
                        format!("no input is chosen for {flag}"),
                        "choose one in the panel Scans",
                    ));
                }
                None => {}
            }
        }
        // Settings of a file are not those of a speed.
        if Self::given(&self.config).is_none() {
            let speed = self.speed.to_possible_value();
            words.extend(["--speed".into(), speed.map_or("balanced".into(), |s| s.get_name().into())]);
        }
        words.extend([
            "--threads".into(),
            self.work.threads.to_string().into(),
            "--out".into(),
            out.as_os_str().to_owned(),
        ]);
        Ok(words)
    }
}

/// Describes the module, or registers and puts what was asked for where Slicer reads it.
///
/// # Errors
/// As `register`; [`Error::Usage`] where nothing is asked for, or a result has a name that Slicer would not give it.
pub(super) fn run(args: &ModuleArgs) -> Result<String> {
    if args.xml {
        return Ok(xml());
    }
    let wanted = args.wanted();
    if wanted.is_empty() && ModuleArgs::given(&args.report).is_none() {
        return Err(Error::usage(
            "no result is chosen",
            "choose at least one transform, volume or folder in the panel Results",
        ));
    }
    for (path, name) in &wanted {
        let end = name.split_once('.').map_or("", |(_, end)| end);
        if !path.to_string_lossy().ends_with(&format!(".{end}")) {
            let problem = format!("{}: this result can only be written as .{end}", path.display());
            return Err(Error::usage(problem, format!("give a name that ends in .{end}")));
        }
        check_place(path)?;
    }
    let inputs = [&args.planning, &args.bones, &args.fraction, &args.labels, &args.landmarks, &args.config];
    let inputs: Vec<&Path> = inputs.into_iter().filter_map(ModuleArgs::given).collect();
    let outputs: Vec<PathBuf> = wanted.iter().map(|(path, _)| path.to_path_buf()).collect();
    check_files(&inputs, &outputs)?;

    let hidden;
    let out = match ModuleArgs::given(&args.report) {
        Some(folder) => folder,
        None => {
            let refuse = |e: std::io::Error| Error::write(std::env::temp_dir(), e.to_string(), "free some space there");
            hidden = tempfile::tempdir().map_err(refuse)?;
            hidden.path()
        }
    };
    let own = Own::try_parse_from(args.command(out)?).map_err(|e| Error::Internal(e.to_string()))?;
    let text = register::run_shown(&own.register, |_| Box::new(ForSlicer::default()))?;
    for (path, name) in wanted {
        let from = out.join(name);
        let mut file = File::open(&from)
            .map_err(|e| Error::read(&from, e.to_string(), "switch this output on in the settings file"))?;
        write_file(path, |to| std::io::copy(&mut file, to).map(drop))?;
    }
    Ok(format!(
        "{text}\n<filter-progress>1</filter-progress>\n<filter-end><filter-name>aventail</filter-name></filter-end>"
    ))
}
