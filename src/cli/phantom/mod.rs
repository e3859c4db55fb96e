//! `aventail phantom`: phantoms as files, with everything that is true about them.

mod dicom;
mod told;

use super::args::{QuietArgs, ThreadArgs};
use super::{record, run_folder};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::field::{FieldFormat, PushField};
use crate::geometry::Rigid;
use crate::io::dicom::Series;
use crate::io::{self, Planned, RunFolder, Stored, WriteOptions};
use crate::phantom::{
    Breathing, BreathingOptions, CbctOptions, Formula, Phantom, PhantomOptions, Posture, TestObject, degrade,
};
use crate::provenance::InputFile;
use crate::report::write_bone_transforms;
use crate::runtime::Runtime;
use crate::volume::Volume;
use clap::{Args, ValueEnum};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use told::text;

/// Tells what was written, with checksums.
const RECORD: &str = "phantom.json";

pub(super) const HELP: &str = "\
OUT holds the head, neck and shoulders: planning_ct, bones, body, contours.json, dose.nii.gz (Gy),
and per fraction (the first in OUT, the second in OUT/fraction_2) fraction_ct, landmarks.csv,
true_planning_to_fraction, true_bone_transforms.json.
With --breathing it holds a chest: planning_ct, bones, organs (lungs, liver, stomach), body and
one fraction, in which the lungs and what lies below them have slid along the chest wall; points
of landmarks.csv face each other across the pleura.
With --cbct fraction images look like cone-beam CTs: less contrast, cupping, shading,
noise, streaks, a round and short field of view with a bright rim where the patient is cut, blank
end slices. The true motion is the same as without --cbct. Beside the image lie measured.nii.gz
(1 where something was measured) and cbct.toml with the settings; FILE may change any of them.
With --dicom the folder dicom holds the same as planning systems export it: planning (CT slices,
and for the head RS.dcm and RD.dcm), fraction, and in registration the true motion as Deformable
Spatial Registration, and that of one bone as Spatial Registration.
With --field OUT holds a textured body with balls and a single-voxel label: planning_image,
planning_labels, landmarks.csv and the exact planning_to_fraction; except for the fold also
fraction_image, fraction_labels and the exact fraction_to_planning.

Examples:
  aventail phantom --cbct --out shaded
  aventail phantom --breathing 15 --out chest
Check any tool's warp against the exact answer:
  aventail phantom --field swirl --out swirl
  aventail warp --field swirl/planning_to_fraction.nii.gz --from planning --to fraction --kind image \\
                --input swirl/planning_image.nii.gz --grid swirl/fraction_image.nii.gz --out warped.nii.gz";

/// Options of `phantom`.
#[derive(Debug, Args)]
pub struct PhantomArgs {
    /// Folder for the files; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Voxel spacing in mm, for example 1.5x1.5x3
    #[arg(long, value_name = "XxYxZ", value_parser = parse_spacing)]
    pub spacing: Option<[f64; 3]>,
    /// Posture of the fraction as a pose file, instead of the two built-in ones
    #[arg(long, value_name = "FILE")]
    pub pose: Option<PathBuf>,
    /// A breathing chest instead of head and neck; its diaphragm moves down by MM [default: 20], or
    /// up if MM is negative
    #[arg(long, value_name = "MM", num_args = 0..=1, allow_negative_numbers = true, conflicts_with = "pose")]
    pub breathing: Option<Option<f64>>,
    /// Make the fractions simulated cone-beam CTs; FILE (TOML, like the cbct.toml that is written)
    /// changes the settings
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub cbct: Option<Option<PathBuf>>,
    /// A test object with an exact answer instead of the anatomy
    #[arg(long, value_enum, conflicts_with_all = ["pose", "breathing", "cbct"])]
    pub field: Option<FormulaName>,
    /// Also write the folder `dicom`: CT series, structure set, dose and the true registrations
    #[arg(long, conflicts_with = "field")]
    pub dicom: bool,
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Names of the formulas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FormulaName {
    /// The same shift everywhere
    Shift,
    /// A rigid rotation
    Rotation,
    /// Scaling along three axes
    Scaling,
    /// A turn that fades with the distance from an axis; keeps volume
    Swirl,
    /// A field that folds; it has no inverse
    Fold,
}

impl From<FormulaName> for Formula {
    fn from(name: FormulaName) -> Self {
        match name {
            FormulaName::Shift => Self::Shift,
            FormulaName::Rotation => Self::Rotation,
            FormulaName::Scaling => Self::Scaling,
            FormulaName::Swirl => Self::Swirl,
            FormulaName::Fold => Self::Fold,
        }
    }
}

/// Writes the phantom into the folder; returns what was written and how to register it.
///
/// # Errors
/// When an option makes no image, a file of options cannot be read, or the folder cannot be
/// written.
pub fn run(args: &PhantomArgs) -> Result<String> {
    let cbct = args.cbct.as_ref().map(|file| cbct_options(file.as_deref())).transpose()?;
    let options = options(args, cbct.is_some())?;
    let planned = Planned { reports: vec![RECORD.into()], names: names(args) };
    let cbct_file = args.cbct.as_ref().and_then(Option::as_deref);
    let inputs: Vec<&Path> = args.pose.as_deref().into_iter().chain(cbct_file).collect();
    let mut folder = run_folder(&args.out, &planned, &inputs)?;
    let runtime = Runtime::new(args.work.threads, super::terminal::progress(args.shown.quiet))?;
    let text = if let Some(formula) = args.field {
        folder.begin()?;
        let object = TestObject::new(formula.into(), args.spacing.unwrap_or([2.0, 2.0, 3.0]))?;
        runtime.stage("write", || write_object(&object, &args.out))?;
        object_text(&object, &args.out)
    } else if let Some(amplitude) = args.breathing {
        let options = breathing_options(args, amplitude, cbct.is_some());
        chest(args, &options, cbct.as_ref(), &mut folder, &runtime)?
    } else {
        patient(args, options, cbct.as_ref(), &mut folder, &runtime)?
    };
    let read = [(InputRole::Pose, args.pose.as_deref()), (InputRole::Cbct, cbct_file)];
    let read = read.into_iter().filter_map(|(role, path)| Some(InputFile::read(role, path?)));
    record::write(&folder, &args.out, RECORD, read.collect::<Result<_>>()?)?;
    folder.finish();
    Ok(text)
}

/// Makes the breathing chest and writes it.
fn chest(
    args: &PhantomArgs,
    options: &BreathingOptions,
    cbct: Option<&CbctOptions>,
    folder: &mut RunFolder,
    runtime: &Runtime,
) -> Result<String> {
    let chest = runtime.stage("make the phantom", || Breathing::new(options))?;
    let fraction = seen(&chest.fraction, cbct, options.seed)?;
    folder.begin()?;
    runtime.stage("write", || {
        let truth = write_chest(&chest, &fraction, &args.out)?;
        if args.dicom {
            let planning = dicom::write_planning(&chest.planning, None, &args.out)?;
            let fraction =
                dicom::Fraction { name: "fraction", day: 1, image: &fraction.image, truth: &truth, bone: None };
            dicom::write_fraction(&fraction, &planning, &args.out)?;
        }
        Ok::<_, Error>(())
    })?;
    Ok(text(&args.out, &chest.bones, chest.landmarks.len(), [&chest.planning, &fraction.image], true))
}

/// Makes head, neck and shoulders with their fractions and writes them.
fn patient(
    args: &PhantomArgs,
    options: PhantomOptions,
    cbct: Option<&CbctOptions>,
    folder: &mut RunFolder,
    runtime: &Runtime,
) -> Result<String> {
    let phantom = runtime.stage("make the phantom", || Phantom::new(&options)).map_err(|e| named(e, args))?;
    let fraction = seen(&phantom.fraction, cbct, options.seed)?;
    folder.begin()?;
    let set = runtime.stage("write", || {
        let planning = write_planning(&phantom, args, &args.out)?;
        let set = planning.map(|planning| DicomSet { planning, out: &args.out });
        write_fraction(&phantom, &fraction, ("fraction", 1), set.as_ref(), &args.out)?;
        Ok::<_, Error>(set)
    })?;
    if args.pose.is_none() {
        let second = PhantomOptions { posture: Posture::second(), seed: options.seed + 10, ..options };
        let second_folder = args.out.join("fraction_2");
        std::fs::create_dir_all(&second_folder)
            .map_err(|e| Error::write(&second_folder, e.to_string(), "choose a folder that you may write to"))?;
        let made = runtime.stage("make the second fraction", || Phantom::new(&second))?;
        let fraction = seen(&made.fraction, cbct, second.seed)?;
        let write = || write_fraction(&made, &fraction, ("fraction_2", 2), set.as_ref(), &second_folder);
        runtime.stage("write", write)?;
    }
    Ok(text(&args.out, &phantom.bones, phantom.landmarks.len(), [&phantom.planning, &fraction.image], false))
}

/// Names of what will be written.
fn names(args: &PhantomArgs) -> Vec<String> {
    let object = ["planning_image.nii.gz", "planning_labels.nii.gz", "planning_to_fraction.nii.gz"];
    let deformed = ["fraction_image.nii.gz", "fraction_labels.nii.gz", "fraction_to_planning.nii.gz", "landmarks.csv"];
    let patient = ["planning_ct.nii.gz", "bones.nii.gz", "body.nii.gz", "contours.json", "dose.nii.gz"];
    let chest = ["planning_ct.nii.gz", "bones.nii.gz", "body.nii.gz", "organs.nii.gz"];
    let mut fraction =
        vec!["fraction_ct.nii.gz", "true_planning_to_fraction.nii.gz", "true_bone_transforms.json", "landmarks.csv"];
    if args.cbct.is_some() {
        fraction.extend(["measured.nii.gz", "cbct.toml"]);
    }
    let own = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    if args.field.is_some() {
        return [own(&object), own(&deformed)].concat();
    }
    let of_dicom = if args.dicom { dicom::names(args.breathing.is_none()) } else { Vec::new() };
    if args.breathing.is_some() {
        return [own(&chest), own(&fraction), of_dicom].concat();
    }
    let second = fraction.iter().map(|name| format!("fraction_2/{name}")).filter(|_| args.pose.is_none()).collect();
    [own(&patient), own(&fraction), second, of_dicom].concat()
}

/// A posture that the phantom refuses is a fault of the file it came from.
fn named(error: Error, args: &PhantomArgs) -> Error {
    match (error, &args.pose) {
        (Error::Input { finding, what, problem, remedy }, Some(path)) if what == "posture" => {
            Error::Input { finding, what: path.display().to_string(), problem, remedy }
        }
        (error, _) => error,
    }
}

/// Spacing keeps the default's field of view; the posture comes from a file when one is given. A
/// cone-beam CT brings its own noise and grey values.
fn options(args: &PhantomArgs, cbct: bool) -> Result<PhantomOptions> {
    let mut options = PhantomOptions::default();
    if let Some(spacing) = args.spacing {
        options = options.with_spacing(spacing);
    }
    if cbct {
        (options.fraction_noise_hu, options.fraction_gain, options.fraction_offset_hu) = (0.0, 1.0, 0.0);
    }
    if let Some(path) = &args.pose {
        let text = std::fs::read_to_string(path)
            .map_err(|e| Error::read(path, e.to_string(), "check the path of --pose, a text file"))?;
        options.posture = Posture::parse(&text).map_err(|e| {
            Error::read(
                path,
                format!("it is no posture: {e}"),
                "write lines such as `skull = { rotation_deg = [1, 0, 0] }`; data/demo_posture.toml is an example",
            )
        })?;
    }
    Ok(options)
}

/// The same for the chest.
fn breathing_options(args: &PhantomArgs, amplitude: Option<f64>, cbct: bool) -> BreathingOptions {
    let mut options = BreathingOptions::default();
    if let Some(spacing) = args.spacing {
        options.edge_mm *= (spacing[0] / options.spacing_mm[0]).max(0.5);
        options.spacing_mm = spacing;
    }
    if cbct {
        options.fraction_noise_hu = 0.0;
    }
    options.amplitude_mm = amplitude.unwrap_or(options.amplitude_mm);
    options
}

/// The settings of a file, or those as they come.
pub(super) fn cbct_options(file: Option<&Path>) -> Result<CbctOptions> {
    let Some(path) = file else { return Ok(CbctOptions::default()) };
    let text = std::fs::read_to_string(path)
        .map_err(|e| Error::read(path, e.to_string(), "check the path of --cbct, a text file"))?;
    CbctOptions::parse(&text).map_err(|e| {
        let remedy =
            "write lines such as `noise_hu = 40.0`; `aventail phantom --cbct` writes a cbct.toml with all of them";
        Error::read(path, format!("it holds no settings of a cone-beam CT: {e}"), remedy)
    })
}

/// A fraction's image as its scanner shows it.
struct Seen<'a> {
    image: Cow<'a, Volume<f32>>,
    cbct: Option<&'a CbctOptions>,
}

fn seen<'a>(image: &'a Volume<f32>, cbct: Option<&'a CbctOptions>, seed: u64) -> Result<Seen<'a>> {
    let image = match cbct {
        Some(options) => Cow::Owned(degrade(image, options, seed.wrapping_add(2))?),
        None => Cow::Borrowed(image),
    };
    Ok(Seen { image, cbct })
}

fn described(text: &str) -> WriteOptions {
    WriteOptions { description: text.into(), ..WriteOptions::default() }
}

/// Writes what belongs to the planning CT.
fn write_planning(phantom: &Phantom, args: &PhantomArgs, out: &Path) -> Result<Option<Series>> {
    let ct = described("aventail phantom, planning CT");
    io::write_image(out.join("planning_ct.nii.gz"), &phantom.planning, Stored::Int16, &ct)?;
    io::write_labels(out.join("bones.nii.gz"), &phantom.bones, &described("aventail phantom, bones"))?;
    io::write_mask(out.join("body.nii.gz"), &phantom.body, &described("aventail phantom, patient"))?;
    let plan = phantom.plan()?;
    io::write_contours(out.join("contours.json"), &plan.contours, "planning")?;
    let dose = described("aventail phantom, planned dose, Gy");
    io::write_image(out.join("dose.nii.gz"), &plan.dose, Stored::Float32, &dose)?;
    args.dicom.then(|| dicom::write_planning(&phantom.planning, Some(&plan), out)).transpose()
}

/// A DICOM set of the phantom: its planning series, and the phantom's folder, where it lies.
struct DicomSet<'a> {
    planning: Series,
    out: &'a Path,
}

/// Writes a fraction CT with its truth; where there is a DICOM set, also into that, by name and number.
fn write_fraction(
    phantom: &Phantom,
    fraction: &Seen<'_>,
    (name, number): (&str, u32),
    set: Option<&DicomSet<'_>>,
    out: &Path,
) -> Result<()> {
    write_seen(fraction, out)?;
    let transforms = || phantom.skeleton.bones.iter().zip(&phantom.transforms).map(|(b, t)| (b.name.as_str(), t));
    let truth = phantom.truth()?;
    write_truth(&truth, transforms(), &phantom.landmarks, out)?;
    let Some(set) = set else { return Ok(()) };
    let bone = transforms().find(|(name, _)| *name == "skull");
    let fraction = dicom::Fraction { name, day: number, image: &fraction.image, truth: &truth, bone };
    dicom::write_fraction(&fraction, &set.planning, set.out)
}

/// Writes the breathing chest.
fn write_chest(chest: &Breathing, fraction: &Seen<'_>, out: &Path) -> Result<PushField> {
    let ct = described("aventail breathing phantom, planning CT");
    io::write_image(out.join("planning_ct.nii.gz"), &chest.planning, Stored::Int16, &ct)?;
    io::write_labels(out.join("bones.nii.gz"), &chest.bones, &described("aventail breathing phantom, bones"))?;
    io::write_labels(out.join("organs.nii.gz"), &chest.organs, &described("aventail breathing phantom, organs"))?;
    io::write_mask(out.join("body.nii.gz"), &chest.body, &described("aventail breathing phantom, patient"))?;
    write_seen(fraction, out)?;
    let truth = chest.truth()?;
    write_truth(&truth, chest.transforms(), &chest.landmarks, out)?;
    Ok(truth)
}

/// Writes a fraction's image, and for a cone-beam CT its settings and where it was measured.
fn write_seen(fraction: &Seen<'_>, out: &Path) -> Result<()> {
    let ct = described("aventail phantom, fraction CT");
    io::write_image(out.join("fraction_ct.nii.gz"), &fraction.image, Stored::Int16, &ct)?;
    let Some(options) = fraction.cbct else { return Ok(()) };
    let measured = options.measured(fraction.image.grid());
    io::write_mask(
        out.join("measured.nii.gz"),
        &measured,
        &described("aventail phantom, where the fraction was measured"),
    )?;
    let text = options.to_toml()?;
    io::write_file(out.join("cbct.toml"), |w| w.write_all(text.as_bytes()))
}

/// Writes what is true about a fraction.
fn write_truth<'a>(
    truth: &PushField,
    transforms: impl IntoIterator<Item = (&'a str, &'a Rigid)>,
    landmarks: &[Landmark],
    out: &Path,
) -> Result<()> {
    let level = WriteOptions::default().gzip_level;
    io::write_push(out.join("true_planning_to_fraction.nii.gz"), truth, FieldFormat::Nifti, level)?;
    write_bone_transforms(&out.join("true_bone_transforms.json"), transforms)?;
    io::write_file(out.join("landmarks.csv"), |w| write_landmarks(w, landmarks))
}

/// Writes a test object.
fn write_object(object: &TestObject, out: &Path) -> Result<()> {
    let options = described("aventail test object");
    let level = options.gzip_level;
    io::write_image(out.join("planning_image.nii.gz"), &object.planning, Stored::Float32, &options)?;
    io::write_labels(out.join("planning_labels.nii.gz"), &object.labels, &options)?;
    io::write_push(out.join("planning_to_fraction.nii.gz"), &object.push, FieldFormat::Nifti, level)?;
    if let Some(deformed) = &object.deformed {
        io::write_image(out.join("fraction_image.nii.gz"), &deformed.image, Stored::Float32, &options)?;
        io::write_labels(out.join("fraction_labels.nii.gz"), &deformed.labels, &options)?;
        io::write_pull(out.join("fraction_to_planning.nii.gz"), &deformed.pull, FieldFormat::Nifti, level)?;
    }
    io::write_file(out.join("landmarks.csv"), |w| write_landmarks(w, &object.landmarks))
}

fn object_text(object: &TestObject, out: &Path) -> String {
    let inverse = match &object.deformed {
        Some(d) => format!("fraction {:?} voxels, exact in both directions", d.image.grid().size()),
        None => "no inverse exists, so there is no fraction image".into(),
    };
    format!(
        "{:?}: planning {:?} voxels, {inverse}; in {}",
        object.formula,
        object.planning.grid().size(),
        out.display()
    )
}

/// Writes points known in both scans as a table that `register` reads.
pub(super) fn write_landmarks(out: &mut dyn std::io::Write, landmarks: &[Landmark]) -> std::io::Result<()> {
    let mut table = io::Sheet::default();
    table.write_record(["name", "planning_x", "planning_y", "planning_z", "fraction_x", "fraction_y", "fraction_z"])?;
    for l in landmarks {
        let numbers = l.planning.iter().chain(l.fraction.iter()).map(|c| format!("{c:.4}"));
        table.write_record(std::iter::once(l.name.clone()).chain(numbers))?;
    }
    out.write_all(&table.into_bytes()?)
}

/// Three positive numbers joined by `x`.
fn parse_spacing(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> =
        text.split('x').map(|t| t.parse().map_err(|_| format!("`{t}` is no number"))).collect::<Result<_, _>>()?;
    let spacing: [f64; 3] =
        numbers.try_into().map_err(|_| "three numbers joined by x are needed, for example 1.5x1.5x3".to_owned())?;
    let sensible = spacing.iter().all(|s| (0.2..=20.0).contains(s));
    if sensible { Ok(spacing) } else { Err("each spacing must lie between 0.2 and 20 mm".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_needs_three_positive_numbers() {
        assert_eq!(parse_spacing("1.5x1.5x3"), Ok([1.5, 1.5, 3.0]));
        for bad in ["1.5", "1x2x-3", "axbxc", "1x2x3x4", "0x1x1", "NaNx1x1"] {
            assert!(parse_spacing(bad).is_err(), "{bad}");
        }
    }
}
