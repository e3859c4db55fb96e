//! `aventail phantom`: the phantom as files, with everything that is true about it.

use super::args::PhantomArgs;
use super::{record, run_folder};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::field::FieldFormat;
use crate::io::{self, Planned, Stored, WriteOptions};
use crate::phantom::{Phantom, PhantomOptions, Posture, TestObject};
use crate::report::write_bone_transforms;
use crate::runtime::Runtime;
use std::path::Path;

/// Tells what was written, with checksums.
const RECORD: &str = "phantom.json";

/// Writes the phantom into the folder; returns what was written and how to register it.
///
/// # Errors
/// When an option makes no image, the pose file cannot be read, or the folder cannot be written.
pub fn run(args: &PhantomArgs) -> Result<String> {
    let options = options(args)?;
    let planned = Planned { reports: vec![RECORD.into()], names: names(args) };
    let inputs: Vec<&Path> = args.pose.as_deref().into_iter().collect();
    let mut folder = run_folder(&args.out, &planned, &inputs)?;
    let runtime = Runtime::new(args.threads, super::register::progress(false))?;
    if let Some(formula) = args.field {
        folder.begin()?;
        let object = TestObject::new(formula.into(), args.spacing.unwrap_or([2.0, 2.0, 3.0]))?;
        runtime.stage("write", || write_object(&object, &args.out))?;
        record::write(&folder, &args.out, RECORD, Vec::new())?;
        folder.finish();
        return Ok(object_text(&object, &args.out));
    }
    let phantom = runtime.stage("make the phantom", || Phantom::new(&options)).map_err(|e| named(e, args))?;
    folder.begin()?;
    runtime.stage("write", || {
        write_planning(&phantom, &args.out)?;
        write_fraction(&phantom, &args.out)
    })?;
    if args.pose.is_none() {
        let second = PhantomOptions { posture: Posture::second(), seed: options.seed + 10, ..options };
        let second_folder = args.out.join("fraction_2");
        std::fs::create_dir_all(&second_folder)
            .map_err(|e| Error::write(&second_folder, e.to_string(), "choose a folder that you may write to"))?;
        let second = runtime.stage("make the second fraction", || Phantom::new(&second))?;
        runtime.stage("write", || write_fraction(&second, &second_folder))?;
    }
    let inputs = args.pose.iter().map(|path| record::input("pose", path)).collect::<Result<_>>()?;
    record::write(&folder, &args.out, RECORD, inputs)?;
    folder.finish();
    let out = args.out.display();
    Ok(format!(
        "{} bones, {} landmarks, planning {:?} voxels, fraction {:?} voxels\nRegister it with\n  aventail register --planning {out}/planning_ct.nii.gz --bones {out}/bones.nii.gz --fraction {out}/fraction_ct.nii.gz --landmarks {out}/landmarks.csv --out {out}/result",
        phantom.skeleton.bones.len(),
        phantom.landmarks.len(),
        phantom.planning.grid().size(),
        phantom.fraction.grid().size(),
    ))
}

/// Names of what will be written.
fn names(args: &PhantomArgs) -> Vec<String> {
    let object = ["planning_image.nii.gz", "planning_labels.nii.gz", "planning_to_fraction.nii.gz"];
    let deformed = ["fraction_image.nii.gz", "fraction_labels.nii.gz", "fraction_to_planning.nii.gz", "landmarks.csv"];
    let patient = ["planning_ct.nii.gz", "bones.nii.gz", "body.nii.gz", "contours.json", "dose.nii.gz"];
    let fraction =
        ["fraction_ct.nii.gz", "true_planning_to_fraction.nii.gz", "true_bone_transforms.json", "landmarks.csv"];
    let own = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    if args.field.is_some() {
        return [own(&object), own(&deformed)].concat();
    }
    let second = fraction.iter().map(|name| format!("fraction_2/{name}")).filter(|_| args.pose.is_none()).collect();
    [own(&patient), own(&fraction), second].concat()
}

/// A posture that the phantom refuses is a fault of the file it came from.
fn named(error: Error, args: &PhantomArgs) -> Error {
    match (error, &args.pose) {
        (Error::Input { code, what, problem, remedy }, Some(path)) if what == "posture" => {
            Error::Input { code, what: path.display().to_string(), problem, remedy }
        }
        (error, _) => error,
    }
}

/// Spacing keeps the default's field of view; the posture comes from a file when one is given.
fn options(args: &PhantomArgs) -> Result<PhantomOptions> {
    let mut options = PhantomOptions::default();
    if let Some(spacing) = args.spacing {
        options.size = std::array::from_fn(|a| {
            (options.size[a] as f64 * options.spacing_mm[a] / spacing[a]).round().max(4.0) as usize
        });
        options.edge_mm *= (spacing[0] / options.spacing_mm[0]).max(0.5);
        options.spacing_mm = spacing;
    }
    if let Some(path) = &args.pose {
        let text =
            std::fs::read_to_string(path).map_err(|e| Error::read(path, e.to_string(), "check the path of --pose"))?;
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

fn described(text: &str) -> WriteOptions {
    WriteOptions { description: text.into(), ..WriteOptions::default() }
}

/// Writes what belongs to the planning CT.
fn write_planning(phantom: &Phantom, out: &Path) -> Result<()> {
    let ct = described("aventail phantom, planning CT");
    io::write_image(out.join("planning_ct.nii.gz"), &phantom.planning, Stored::Int16, &ct)?;
    io::write_labels(out.join("bones.nii.gz"), &phantom.bones, &described("aventail phantom, bones"))?;
    io::write_mask(out.join("body.nii.gz"), &phantom.body, &described("aventail phantom, patient"))?;
    let plan = phantom.plan()?;
    io::write_contours(out.join("contours.json"), &plan.contours, "planning")?;
    let dose = described("aventail phantom, planned dose, Gy");
    io::write_image(out.join("dose.nii.gz"), &plan.dose, Stored::Float32, &dose)
}

/// Writes a fraction CT with its truth.
fn write_fraction(phantom: &Phantom, out: &Path) -> Result<()> {
    let ct = described("aventail phantom, fraction CT");
    io::write_image(out.join("fraction_ct.nii.gz"), &phantom.fraction, Stored::Int16, &ct)?;
    let (truth, level) = (phantom.truth()?, WriteOptions::default().gzip_level);
    io::write_push(out.join("true_planning_to_fraction.nii.gz"), &truth, FieldFormat::Nifti, level)?;
    let transforms = phantom.skeleton.bones.iter().zip(&phantom.transforms).map(|(b, t)| (b.name.as_str(), t));
    write_bone_transforms(&out.join("true_bone_transforms.json"), transforms)?;
    io::write_file(out.join("landmarks.csv"), |w| write_landmarks(w, &phantom.landmarks))
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

fn write_landmarks(out: &mut dyn std::io::Write, landmarks: &[Landmark]) -> std::io::Result<()> {
    let mut table = io::Sheet::default();
    table.write_record(["name", "planning_x", "planning_y", "planning_z", "fraction_x", "fraction_y", "fraction_z"])?;
    for l in landmarks {
        let numbers = l.planning.iter().chain(l.fraction.iter()).map(|c| format!("{c:.4}"));
        table.write_record(std::iter::once(l.name.clone()).chain(numbers))?;
    }
    out.write_all(&table.into_bytes()?)
}
