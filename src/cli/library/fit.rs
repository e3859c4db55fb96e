//! Principal modes of a patient's own fractions, as a plan to draw from.

use super::super::terminal::command_line;
use super::super::{planned, record};
use super::args::{LibraryArgs, MANIFEST, PLAN};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::postures::write_postures;
use crate::io::{self, RunFolder, relative_to, write_json};
use crate::postures::{Mode, PosturePlan, Principal, Six, principal, sixes};
use crate::provenance::InputFile;
use crate::report::Report;
use crate::skeleton::{Bone, Joint, Skeleton};
use crate::warning::Warning;
use nalgebra::{Matrix3, Point3};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Fewer fractions than this are warned of.
const FEW: usize = 6;
/// Residual couch shift after correction: what reports have of it holds differences of scanner origins too.
const COUCH_SD_MM: [f64; 3] = [1.9; 3];

/// The modes that were found, as `library.json` holds them.
#[derive(Debug, Serialize)]
pub struct Fitted {
    version: &'static str,
    command: String,
    inputs: Vec<InputFile>,
    fractions: usize,
    /// Degrees squared and mm squared added up.
    variance: f64,
    modes: Vec<Explained>,
    /// Standard deviations of each mode: one list for each fraction.
    weights: Vec<Vec<f64>>,
    warnings: Vec<Warning>,
    outputs: Vec<record::Output>,
    #[serde(skip)]
    table: String,
}

#[derive(Debug, Serialize)]
struct Explained {
    name: String,
    share: f64,
}

/// Finds the modes and writes the plan; returns the table (or JSON) for the terminal.
pub(super) fn run(args: &LibraryArgs) -> Result<String> {
    let fitted = fit(&args.fit, &args.out, &command_line())?;
    if args.run.told.json {
        return io::json(&fitted);
    }
    let told: String = fitted.warnings.iter().map(|w| format!("  warning ({}): {}\n", w.code, w.message)).collect();
    Ok(format!("{}{told}The plan: {}", fitted.table, args.out.join(PLAN).display()))
}

/// Finds the principal modes of finished registrations, whose folders are named, and writes them into `out` as a plan;
/// `command` is what asked for it.
///
/// # Errors
/// [`Error::Usage`] for fewer than two; [`Error::Input`] when they are not of one planning CT with the same labels, or
/// nothing varies; [`Error::Read`]; [`Error::Write`].
pub fn fit(runs: &[PathBuf], out: &Path, command: &str) -> Result<Fitted> {
    let files: Vec<PathBuf> = runs.iter().map(|folder| folder.join("report.json")).collect();
    let paths: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
    if files.len() < 2 {
        return Err(Error::usage(
            "modes of one fraction: a single posture does not vary",
            "give the --out folders of two or more `aventail register` runs",
        ));
    }
    let remedy = "give the --out folder of a finished `aventail register`";
    let reports: Vec<Report> = files.iter().map(|path| Report::read(path, remedy)).collect::<Result<_>>()?;
    same_planning(&files, &reports)?;
    let names: Vec<&str> = reports[0].bones.iter().map(|b| b.name.as_str()).collect();
    let postures: Vec<Vec<Six>> = reports.iter().map(posture).collect();
    let found = principal(&postures).ok_or_else(|| Error::Internal("two postures have a mode".into()))?;
    if found.modes.is_empty() {
        let problem = "all fractions have the same posture: nothing varies";
        return Err(Error::input("--fit", problem, "give different fractions"));
    }
    let mut folder = RunFolder::open(out, &planned(&[MANIFEST], &[PLAN]), &paths, command)?;
    folder.begin()?;
    let warnings: Vec<Warning> = few(postures.len()).into_iter().collect();
    let skeleton = named_bones(&names);
    let head = [
        format!("Principal modes of {} fractions, found by aventail {}.", postures.len(), env!("CARGO_PKG_VERSION")),
        "The couch's shift is not the fractions': theirs holds differences of scanner origins.".into(),
    ];
    write_postures(out.join(PLAN), &skeleton, &plan(&skeleton, &found), &head)?;
    let inputs = files.iter().map(|path| InputFile::read(InputRole::Fit, path));
    let inputs = inputs.map(|i| i.map(|i| InputFile { path: relative_to(out, &i.path), ..i }));
    let explained = |(mode, share): (&Mode, &f64)| Explained { name: mode.name.clone(), share: *share };
    let fitted = Fitted {
        version: env!("CARGO_PKG_VERSION"),
        command: command.to_owned(),
        inputs: inputs.collect::<Result<_>>()?,
        fractions: postures.len(),
        variance: found.variance,
        modes: found.modes.iter().zip(&found.explained).map(explained).collect(),
        table: table(&names, &found),
        weights: found.weights,
        warnings,
        outputs: record::outputs(out, &[PathBuf::from(PLAN)])?,
    };
    write_json(out.join(MANIFEST), &fitted)?;
    folder.finish();
    Ok(fitted)
}

/// All runs are of one planning CT with one set of labels, and so of one skeleton.
fn same_planning(files: &[PathBuf], reports: &[Report]) -> Result<()> {
    let of = |report: &Report, role: InputRole| report.inputs.iter().find(|i| i.role == role).map(|i| i.sha256.clone());
    let bones = |report: &Report| report.bones.iter().map(|b| b.name.clone()).collect::<Vec<_>>();
    for (file, report) in files.iter().zip(reports).skip(1) {
        let other = [InputRole::Planning, InputRole::Bones, InputRole::Skeleton]
            .into_iter()
            .find(|&role| of(report, role) != of(&reports[0], role));
        let other = other.or_else(|| (bones(report) != bones(&reports[0])).then_some(InputRole::Bones));
        if let Some(role) = other {
            let problem = format!("its {role} file is not that of {}", files[0].display());
            let remedy = "give runs of one planning CT with the same labels: modes are of one skeleton";
            return Err(Error::refused(findings::OTHER_PLANNING, file.display().to_string(), problem, remedy));
        }
    }
    Ok(())
}

/// The posture of a run without its couch shift.
fn posture(report: &Report) -> Vec<Six> {
    let mut values = sixes(&report.pose);
    if let Some(root) = values.first_mut() {
        root[3..].fill(0.0);
    }
    values
}

/// Bones by name alone; the first is the root.
fn named_bones(names: &[&str]) -> Skeleton {
    let joint = Joint {
        name: String::new(),
        centre: Point3::origin(),
        axes: Matrix3::identity(),
        rotation_range_deg: [[0.0; 2]; 3],
        translation_range_mm: [0.0; 3],
        source: String::new(),
    };
    let bone = |(n, name): (usize, &&str)| Bone {
        name: (*name).to_owned(),
        label: 0,
        parent: (n > 0).then_some(0),
        joint: joint.clone(),
        centroid: Point3::origin(),
        volume_mm3: 0.0,
    };
    Skeleton { bones: names.iter().enumerate().map(bone).collect() }
}

/// The plan that draws from the modes.
fn plan(skeleton: &Skeleton, found: &Principal) -> PosturePlan {
    let mut plan = PosturePlan::still(skeleton);
    plan.mean.clone_from(&found.mean);
    plan.modes.clone_from(&found.modes);
    if let Some(root) = plan.joints.first_mut() {
        root.sd[3..].copy_from_slice(&COUCH_SD_MM);
    }
    plan
}

fn few(fractions: usize) -> Option<Warning> {
    let message = format!(
        "{fractions} fractions have at most {} modes, and their deviations are hardly known: what these fractions did not show \
         does not vary in postures drawn from them",
        fractions - 1
    );
    (fractions < FEW).then(|| Warning::new(findings::FEW_FRACTIONS, message))
}

/// Modes with what they explain and what they move most.
fn table(names: &[&str], found: &Principal) -> String {
    const PARTS: [&str; 6] = ["flexion", "lateral", "axial", "left", "back", "up"];
    let mut out = String::from("mode      explains  together  moves most, at one standard deviation\n");
    let mut together = 0.0;
    for (mode, share) in found.modes.iter().zip(&found.explained) {
        together += share;
        let mut all: Vec<(f64, usize, usize)> = mode
            .values
            .iter()
            .enumerate()
            .flat_map(|(b, six)| six.iter().enumerate().map(move |(a, v)| (*v, b, a)))
            .collect();
        all.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
        let part = |(v, b, a): &(f64, usize, usize)| {
            let (name, unit) = (if *b == 0 { "couch" } else { names[*b] }, if *a < 3 { "deg" } else { "mm" });
            format!("{name} {} {v:.1} {unit}", PARTS[*a])
        };
        let most = all.iter().take(3).map(part).collect::<Vec<_>>().join(", ");
        writeln!(out, "{:9} {:7.1} % {:7.1} %  {most}", mode.name, 100.0 * share, 100.0 * together)
            .expect("a String takes text");
    }
    out
}
