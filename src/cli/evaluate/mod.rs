//! `aventail evaluate`: how good a field is, ours or another tool's; several fields side by side.

mod args;

pub(super) use args::AFTER;
pub use args::EvaluateArgs;

use super::args::DirectionName;
use super::inputs::config_file;
use super::terminal::command_line;
use super::terminal::progress;
use super::{planned, run_folder};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::evaluate::verdict::Limits;
use crate::evaluate::{Direction, FieldPair, Subject, assess};
use crate::field::{Outside, WORTH, outside_field};
use crate::findings;
use crate::geometry::Grid;
use crate::io::{self, Loaded, Planned, dicom};
use crate::provenance::Provenance;
use crate::report::evaluation::{self, Assessed, Compared, Drawable, EvaluationPicture, EvaluationReport};
use crate::runtime::Runtime;
use crate::session::fields::{self, Known};
use crate::session::frames::{FieldRole, place};
use crate::skeleton;
use crate::volume::{LabelMap, Mask, Volume};
use crate::warning::Warning;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Tissue above this counts as the patient, HU.
const TISSUE_HU: f32 = -500.0;

/// Files of one field, of which one direction is enough.
struct FieldFiles {
    name: String,
    /// The option that names them, where it is not that of their direction.
    option: Option<InputRole>,
    /// Planning to fraction.
    push: Option<PathBuf>,
    /// Fraction to planning.
    pull: Option<PathBuf>,
}

/// Everything that the fields are measured with.
struct Inputs {
    /// The files of both CTs.
    files: [Option<PathBuf>; 2],
    planning: Option<Volume<f32>>,
    fraction: Option<Volume<f32>>,
    mask: Option<Mask>,
    bones: Option<LabelMap>,
    rigid: Vec<(u16, String)>,
    structures: Option<LabelMap>,
    structures_fraction: Option<LabelMap>,
    landmarks: Vec<Landmark>,
    triangle: Option<[Volume<[f32; 3]>; 2]>,
    /// What verdicts are given by.
    limits: Limits,
}

/// Measures what the arguments name and writes the report; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind; see [`Error`].
pub(super) fn run(args: &EvaluateArgs) -> Result<String> {
    let files = field_files(args)?;
    let mut folder = run_folder(&args.out, &planned_files(&files), &args.files())?;
    let runtime = Runtime::new(args.common.work.threads, progress(args.common.shown.quiet))?;
    let limits = args.config.as_deref().map(limits).transpose()?.unwrap_or_default();
    let mut provenance = Provenance::default();
    let inputs = runtime.stage("read", || read(args, limits, &mut provenance))?;
    let common = provenance.warnings.len();
    let mut first: Option<Compared> = None;
    let mut others = Vec::new();
    let mut pictures = Vec::new();
    for (n, file) in files.iter().enumerate() {
        let before = provenance.warnings.len();
        let (mut own, drawn) = one(n, file, &inputs, &mut provenance, &runtime)?;
        own.field.warned(&[&provenance.warnings[..common], &provenance.warnings[before..]].concat());
        pictures.extend(drawn);
        let Some(first) = &first else {
            first = Some(own);
            continue;
        };
        let planning = inputs.planning.as_ref();
        pictures.extend(runtime.stage("draw", || evaluation::draw_pair(n, first, &own, planning))?);
        others.push(own.field);
    }
    let assessed = first.map(|first| first.field).into_iter().chain(others).collect();
    let mut report = EvaluationReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        created: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()),
        command: command_line(),
        inputs: provenance.inputs,
        fields: assessed,
        warnings: provenance.warnings,
        stages: runtime.times(),
        threads: runtime.threads(),
        outputs: Vec::new(),
    };
    folder.begin()?;
    runtime.stage("write", || evaluation::write(&args.out, &mut report, &pictures))?;
    folder.finish();
    if args.common.told.json {
        report.stages = runtime.times();
        return report.json();
    }
    let page = args.out.join("evaluation.html");
    Ok(format!("{}\nThe report: {}", evaluation::terminal_table(&report), page.display()))
}

/// The limits of a file of settings.
fn limits(path: &Path) -> Result<Limits> {
    Ok(config_file(path)?.resolve(None)?.verdict)
}

/// What will be written, besides pictures.
fn planned_files(fields: &[FieldFiles]) -> Planned {
    let mut all = planned(&["evaluation.json", "evaluation.html"], &["evaluation.csv", "evaluation.md"]);
    match fields.len() {
        1 => all.names.push("landmarks.csv".into()),
        n => all.names.extend((1..=n).map(|n| format!("landmarks_{n}.csv"))),
    }
    all
}

/// The fields that the arguments name.
fn field_files(args: &EvaluateArgs) -> Result<Vec<FieldFiles>> {
    if args.compare.is_empty() {
        let Some(first) = args.planning_to_fraction.as_ref().or(args.fraction_to_planning.as_ref()) else {
            return Err(Error::usage(
                "no field is given",
                "add --planning-to-fraction FILE, --fraction-to-planning FILE (or both), or --compare FILE FILE",
            ));
        };
        let (push, pull) = (args.planning_to_fraction.clone(), args.fraction_to_planning.clone());
        return Ok(vec![FieldFiles { name: name(first), option: None, push, pull }]);
    }
    let mut names: Vec<String> = args.compare.iter().map(|p| name(p)).collect();
    if names.iter().enumerate().any(|(n, a)| names[..n].contains(a)) {
        // Files of one name are told apart by their folders.
        names = args.compare.iter().map(|p| p.display().to_string()).collect();
    }
    let option = Some(InputRole::Compare);
    let of = |(name, path): (String, &PathBuf)| match args.direction {
        DirectionName::PlanningToFraction => FieldFiles { name, option, push: Some(path.clone()), pull: None },
        DirectionName::FractionToPlanning => FieldFiles { name, option, push: None, pull: Some(path.clone()) },
    };
    Ok(names.into_iter().zip(&args.compare).map(of).collect())
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads labels of bones: names from the header where it has them, else from the JSON file, which is that of the structures.
fn read_bones(path: &Path, names: Option<&Path>) -> Result<Loaded<LabelMap>> {
    match (io::read_labels(path, None), names) {
        (Err(Error::Input { .. }), Some(names)) => io::read_labels(path, Some(names)),
        (read, _) => read,
    }
}

/// Reads everything but the fields.
fn read(args: &EvaluateArgs, limits: Limits, provenance: &mut Provenance) -> Result<Inputs> {
    let mut image = |role: InputRole, path: &Option<PathBuf>| -> Result<Option<Volume<f32>>> {
        let read = if role == InputRole::Fraction { io::read_scan } else { io::read_image };
        path.as_ref().map(|p| Ok(provenance.take_scan(role, read(p)?))).transpose()
    };
    let planning = image(InputRole::Planning, &args.planning)?;
    let fraction = image(InputRole::Fraction, &args.fraction)?;
    let mask = image(InputRole::Mask, &args.mask)?.map(|m| m.map(|v| *v != 0.0));
    if let (Some(mask), Some(path)) = (&mask, &args.mask)
        && mask.count() == 0
    {
        let remedy = "give a mask with voxels that are not zero, or leave it out";
        return Err(Error::input(path.display().to_string(), "no voxel of the mask is set", remedy));
    }
    let names = args.labels.as_deref();
    let bones = args.bones.as_deref().map(|p| read_bones(p, names)).transpose()?;
    let bones = bones.map(|bones| provenance.take(InputRole::Bones, bones));
    let mut labels = |role: InputRole, path: &Option<PathBuf>| -> Result<Option<LabelMap>> {
        path.as_ref().map(|p| Ok(provenance.take(role, io::read_structures(p, names)?))).transpose()
    };
    let structures = labels(InputRole::LabelsPlanning, &args.labels_planning)?;
    let structures_fraction = labels(InputRole::LabelsFraction, &args.labels_fraction)?;
    let landmarks = args.landmarks.as_ref().map(io::read_landmarks).transpose()?.unwrap_or_default();
    if let Some(path) = &args.landmarks {
        provenance.note(InputRole::Landmarks, path)?;
    }
    let rigid = bones.as_ref().map(|b| rigid(b, provenance)).unwrap_or_default();
    let triangle = None;
    let files = [args.planning.clone(), args.fraction.clone()];
    let mut inputs = Inputs {
        files,
        planning,
        fraction,
        mask,
        bones,
        rigid,
        structures,
        structures_fraction,
        landmarks,
        triangle,
        limits,
    };
    if let (Some(then), Some(direct)) = (&args.then, &args.direct) {
        let remedy = "give the field of the other direction";
        let known = inputs.known();
        let onward = FieldRole { given: InputRole::Then, from: "fraction", to: "third", remedy };
        let straight = FieldRole { given: InputRole::Direct, from: "planning", to: "third", remedy };
        let triangle =
            [fields::take(then, &onward, &known, provenance)?, fields::take(direct, &straight, &known, provenance)?];
        inputs.triangle = Some(triangle);
    }
    Ok(inputs)
}

impl Inputs {
    /// The grids of both frames.
    fn known(&self) -> Vec<Known<'_>> {
        let all = [
            ("planning", "the planning CT", self.planning.as_ref().map(Volume::grid)),
            ("planning", "the bones", self.bones.as_ref().map(|b| b.volume.grid())),
            ("planning", "the planning structures", self.structures.as_ref().map(|b| b.volume.grid())),
            ("planning", "the mask", self.mask.as_ref().map(Volume::grid)),
            ("fraction", "the fraction CT", self.fraction.as_ref().map(Volume::grid)),
            ("fraction", "the fraction's structures", self.structures_fraction.as_ref().map(|b| b.volume.grid())),
        ];
        let [planning, fraction] = &self.files;
        let place = |name: &str| match name {
            "the planning CT" => place(planning, dicom::Role::Image),
            "the fraction CT" => place(fraction, dicom::Role::Image),
            _ => None,
        };
        let known = all.into_iter().filter_map(|(frame, name, grid)| {
            Some(Known { frame, name: name.to_owned(), place: place(name), grid: grid? })
        });
        known.collect()
    }

    /// What of the patient, as far as inputs tell where he is, lies outside a field on the grid of `direction`'s start.
    fn outside(&self, direction: Direction, field: &Grid) -> Option<(&'static str, Outside)> {
        let labelled = |map: &LabelMap| {
            Outside::weighted(map.volume.grid(), field, |l| f64::from(u8::from(map.volume.data()[l] > 0)))
        };
        let tissue =
            |ct: &Volume<f32>| Outside::weighted(ct.grid(), field, |l| f64::from(u8::from(ct.data()[l] > TISSUE_HU)));
        let (mask, structures, ct) = match direction {
            Direction::PlanningToFraction => (self.mask.as_ref(), self.structures.as_ref(), self.planning.as_ref()),
            Direction::FractionToPlanning => (None, self.structures_fraction.as_ref(), self.fraction.as_ref()),
        };
        let masked = |mask: &Mask| Outside::weighted(mask.grid(), field, |l| f64::from(u8::from(mask.data()[l])));
        mask.map(|m| ("the mask", masked(m)))
            .or_else(|| structures.map(|s| ("the structures' volume", labelled(s))))
            .or_else(|| ct.map(|ct| ("the tissue in the CT", tissue(ct))))
    }
}

/// Labels that move rigidly: the skeleton's bones; all labels when none has a known bone's name.
fn rigid(bones: &LabelMap, provenance: &mut Provenance) -> Vec<(u16, String)> {
    match skeleton::build(bones) {
        Ok(built) => built.skeleton.labels_and_names(),
        Err(_) => {
            let message = "no label of --bones has the name of a known bone: every label is taken as one rigid bone";
            provenance.warnings.push(Warning::new(findings::BONES_BY_LABEL, message));
            bones.names.iter().map(|(label, name)| (*label, name.clone())).collect()
        }
    }
}

/// Measures and draws one field.
fn one(
    which: usize,
    files: &FieldFiles,
    inputs: &Inputs,
    provenance: &mut Provenance,
    runtime: &Runtime,
) -> Result<(Compared, Vec<EvaluationPicture>)> {
    let FieldFiles { name, push, pull, .. } = files;
    let pair = runtime.stage(&format!("read {name}"), || read_pair(files, inputs, provenance))?;
    for direction in &pair.given {
        let grid = match direction {
            Direction::PlanningToFraction => pair.push.displacement.grid(),
            Direction::FractionToPlanning => pair.pull.displacement.grid(),
        };
        let share = inputs.outside(*direction, grid);
        provenance
            .warnings
            .extend(share.and_then(|(what, share)| outside_field(what, name, share.amount_percent, WORTH)));
    }
    let sliding = skeleton::SlidingOptions::default().pairs(&inputs.rigid);
    let spine = skeleton::labels_of_spine(&inputs.rigid);
    let subject = Subject {
        pair: &pair,
        planning: inputs.planning.as_ref(),
        fraction: inputs.fraction.as_ref(),
        mask: inputs.mask.as_ref(),
        bones: inputs.bones.as_ref(),
        rigid: &inputs.rigid,
        spine: &spine,
        sliding: &sliding,
        structures: inputs.structures.as_ref(),
        structures_fraction: inputs.structures_fraction.as_ref(),
        landmarks: &inputs.landmarks,
        triangle: inputs.triangle.as_ref().map(|[a, b]| [a, b]),
    };
    let (mut assessment, maps) = assess(&subject, &inputs.limits, runtime)?;
    let written = push.iter().chain(pull).next();
    assessment.verdicts.extend(written.map(|field| fields::doubts_of_its_run(field, provenance)).unwrap_or_default());
    let field = Assessed::new(name.clone(), assessment);
    let drawable = Drawable { subject, maps };
    let pictures = runtime.stage("draw", || evaluation::draw(which, &field, &drawable))?;
    let measured = drawable.maps.measured;
    Ok((Compared { field, pair, measured }, pictures))
}

/// Reads the given direction or directions of a field and makes the missing one.
fn read_pair(files: &FieldFiles, inputs: &Inputs, provenance: &mut Provenance) -> Result<FieldPair> {
    let planning = inputs.planning.as_ref().map(Volume::grid);
    let planning = planning.or(inputs.bones.as_ref().map(|b| b.volume.grid()));
    let planning = planning.or(inputs.structures.as_ref().map(|b| b.volume.grid()));
    let fraction = inputs.fraction.as_ref().map(Volume::grid);
    let fraction = fraction.or(inputs.structures_fraction.as_ref().map(|b| b.volume.grid()));
    fields::pair(
        [&files.push, &files.pull].map(|f| fields::file(f.as_deref())),
        files.option,
        [planning, fraction],
        &inputs.known(),
        provenance,
    )
}
