//! `aventail warp`: anything that has a position, from one frame to another.

mod args;
mod dicom;
mod report;
mod sampled;

pub(super) use args::HELP;
pub use args::WarpArgs;

use super::links::LinkArg;
use super::terminal::progress;
use crate::dose::{interpolate, judge};
use crate::error::{Error, Result};
use crate::field::{
    Chain, ChainReport, FieldFormat, Interpolation, InvertOptions, Link, WORTH, WORTH_OF_IMAGE, WORTH_OF_LABELS,
    outside_field, resample, resample_contours, resample_labels, scale_by_volume,
};
use crate::findings;
use crate::geometry::Grid;
use crate::io::dicom::like::Like;
use crate::io::dicom::{Role, is_structure_set};
use crate::io::{self, ContourFile, FieldFrames, Stored, WriteOptions, is_json, points};
use crate::runtime::Runtime;
use crate::session::frames::{FrameNames, role_of};
use crate::volume::contour::Structure;
use crate::volume::{LabelMap, Volume};
use crate::warning::{Warning, counted};
use args::{Files, InterpolationName, VolumeKind};
use nalgebra::Point3;
use report::WarpReport;
use std::path::{Path, PathBuf};

/// Carries the input to its new frame, or writes the chain as one field; returns what was done.
///
/// # Errors
/// Of every kind; see [`Error`].
pub fn run(args: &WarpArgs) -> Result<String> {
    check_paths(args)?;
    sampled::check(args)?;
    let runtime = Runtime::new(args.common.work.threads, progress(args.common.shown.quiet))?;
    let (links, silent, warnings) = runtime.stage("read the fields", || -> Result<_> {
        let mut warnings = Vec::new();
        let (mut links, mut silent) = (Vec::new(), Vec::new());
        let mut names = names(args)?;
        for arg in &args.field {
            let (link, told, odd) = arg.read(args.space.map(Into::into), &mut names)?;
            links.push(link);
            silent.push(!told);
            warnings.extend(odd);
        }
        Ok((links, silent, warnings))
    })?;
    let options = InvertOptions::default();
    let chain = |from: &str, to: &str| runtime.stage("compose", || Chain::between(&links, from, to, &options));
    let mut report = WarpReport {
        from: args.from.clone(),
        to: args.to.clone(),
        kind: "field",
        steps: Vec::new(),
        mapped: ChainReport::of(&[]),
        notes: Vec::new(),
        warnings,
        out: String::new(),
    };
    match (&args.input, &args.out, &args.out_field) {
        (None, None, Some(out)) => {
            let chain = chain(&args.from, &args.to)?;
            runtime.stage("write the field", || export(args, &chain, out, &mut report))?;
        }
        (Some(input), Some(out), None) => {
            let files = Files { input, out };
            if points::point_extension(input).is_some() {
                refuse_volume_options(args, input)?;
                let chain = chain(&args.from, &args.to)?;
                runtime.stage("map the points", || map_points(args, &chain, files, &mut report))?;
            } else if is_json(input) || is_structure_set(input) {
                let (forward, back) = (chain(&args.from, &args.to)?, chain(&args.to, &args.from)?);
                runtime.stage("map the contours", || map_contours(args, &forward, &back, files, &mut report))?;
            } else {
                let back = chain(&args.to, &args.from)?;
                let unsure = links.iter().zip(silent).filter(|(_, silent)| *silent).map(|(link, _)| link).collect();
                map_volume(args, &back, unsure, files, &runtime, &mut report)?;
            }
        }
        _ => {
            return Err(Error::usage(
                "nothing to do: neither an input with its output nor a field to write is named",
                "give --input FILE --out FILE, or --out-field FILE",
            ));
        }
    }
    if args.common.told.json {
        return io::json(&report);
    }
    Ok(report.text())
}

/// The names that the command line has for the frames of reference of what is DICOM.
fn names(args: &WarpArgs) -> Result<FrameNames> {
    let input = |path: &PathBuf| role_of(path, args.kind == Some(VolumeKind::Dose));
    let here = args.input.as_ref().map(|p| (args.from.as_str(), input(p).at(p)));
    let lies_in = if args.out_field.is_some() { &args.from } else { &args.to };
    let there = [&args.grid, &args.dicom_like].into_iter().flatten();
    let there = there.map(|p| (lies_in.as_str(), Role::Image.at(p)));
    let led_to = args.dicom_to.as_ref().map(|p| (args.to.as_str(), Role::Image.at(p)));
    let things: Vec<_> = here.into_iter().chain(there).chain(led_to).collect();
    FrameNames::new(&things, (args.field.len() == 1).then(|| FieldFrames::new(&args.from, &args.to)))
}

/// Refuses results that would take the place of inputs or cannot be written, before anything is read.
fn check_paths(args: &WarpArgs) -> Result<()> {
    let fields: Vec<PathBuf> = args.field.iter().map(LinkArg::path).collect();
    let more = [&args.input, &args.grid, &args.dicom_like, &args.dicom_to, &args.labels];
    let samples = sampled::file(args);
    let inputs = fields.iter().chain(more.into_iter().flatten()).chain(&samples);
    let outputs: Vec<PathBuf> = [&args.out, &args.out_field].into_iter().flatten().cloned().collect();
    io::check_files(&inputs.map(PathBuf::as_path).collect::<Vec<_>>(), &outputs)?;
    if let Some(out) = &args.out_field {
        dicom::check_field(args, out)?;
    }
    if let (Some(input), Some(out)) = (&args.input, &args.out) {
        let kind = match input {
            i if points::point_extension(i).is_some() => dicom::Input::Points,
            i if is_json(i) || is_structure_set(i) => dicom::Input::Contours,
            _ => dicom::Input::Volume,
        };
        dicom::check(args, kind, out)?;
        if args.dicom_like.is_none() && kind == dicom::Input::Volume {
            FieldFormat::of(out)?;
        }
    }
    outputs.iter().try_for_each(|out| io::check_place(out))
}

/// Options that only volumes have.
fn refuse_volume_options(args: &WarpArgs, input: &Path) -> Result<()> {
    let given = [
        ("--kind", args.kind.is_some()),
        ("--grid", args.grid.is_some()),
        ("--interpolation", args.interpolation.is_some()),
        ("--outside", args.outside.is_some()),
        ("--labels", args.labels.is_some()),
        ("--samples", args.samples.is_some()),
        ("--scale-by-jacobian", args.scale_by_jacobian),
    ];
    match given.iter().find(|g| g.1) {
        Some((name, _)) => Err(Error::usage(
            format!("{name} has no meaning for {}, a file of points", input.display()),
            "leave it out",
        )),
        None => Ok(()),
    }
}

/// The chain as one field.
fn export(args: &WarpArgs, chain: &Chain<'_>, out: &Path, report: &mut WarpReport) -> Result<()> {
    let ends = dicom::ends(args)?;
    let grid = match ends.as_ref().filter(|_| args.grid.is_none()) {
        Some([from, _]) => from.grid.clone(),
        None => target(args, chain, &args.from, &mut report.warnings)?,
    };
    let (field, mapped) = chain.displacement_on(&grid)?;
    if let Some([from, to]) = &ends {
        from.field(out, &field, to)?;
    } else {
        let format = args.dvf_format.map_or_else(|| FieldFormat::of(out), |name| Ok(name.into()))?;
        let description = io::direction(&args.from, &args.to, format);
        io::write_field(out, &field, format, &WriteOptions { description, ..WriteOptions::default() })?;
    }
    report.notes.push(format!(
        "a field on {0}'s grid that takes {0} points to {1}; it resamples images of {1} onto {0}",
        args.from, args.to
    ));
    report.finish(chain, mapped, out);
    Ok(())
}

/// The grid to compute on: the file that `--grid` names, else that of the field that the chain begins with.
fn target(args: &WarpArgs, chain: &Chain<'_>, frame: &str, warnings: &mut Vec<Warning>) -> Result<Grid> {
    if let Some(path) = &args.grid {
        let (grid, odd) = io::read_grid(path)?;
        warnings.extend(odd);
        return Ok(grid);
    }
    chain.grid().cloned().ok_or_else(|| {
        Error::usage(
            format!("no field lies on a grid of {frame}, so the grid of the result is unknown"),
            format!("give --grid with any image of {frame}, for example its CT"),
        )
    })
}

fn map_points(
    args: &WarpArgs,
    chain: &Chain<'_>,
    Files { input, out }: Files<'_>,
    report: &mut WarpReport,
) -> Result<()> {
    let space = args.space.map(Into::into);
    let file = if args.field.iter().any(LinkArg::needs_space) {
        // --space speaks of the matrices; the points' own word on themselves contradicts nothing.
        match points::read_points(input, &args.from, None) {
            Err(e) if e.is(findings::SPACE_UNKNOWN) => points::read_points(input, &args.from, space),
            read => read,
        }?
    } else {
        points::read_points(input, &args.from, space)?
    };
    let mapped: Vec<_> = file.points.iter().map(|p| chain.map(p)).collect();
    let moved: Vec<Point3<f64>> = mapped.iter().map(|m| m.point).collect();
    file.write(out, &moved)?;
    report.kind = "points";
    let name = |n: usize| file.names.get(n).cloned().unwrap_or_else(|| (n + 1).to_string());
    let listed = |which: &dyn Fn(usize) -> bool| {
        let names: Vec<String> = (0..mapped.len()).filter(|&n| which(n)).take(20).map(name).collect();
        (!names.is_empty()).then(|| names.join(", "))
    };
    if let Some(names) = listed(&|n| !mapped[n].covered) {
        report
            .warnings
            .push(Warning::new(findings::OUTSIDE_FIELD, format!("points outside a field, not moved by it: {names}")));
    }
    if let Some(names) = listed(&|n| !mapped[n].solved) {
        report.warnings.push(Warning::new(findings::NO_INVERSE, format!("points without an exact pre-image: {names}")));
    }
    report.finish(chain, ChainReport::of(&mapped), out);
    Ok(())
}

/// Contours, on the slices of the new frame.
fn map_contours(
    args: &WarpArgs,
    forward: &Chain<'_>,
    back: &Chain<'_>,
    Files { input, out }: Files<'_>,
    report: &mut WarpReport,
) -> Result<()> {
    let refuse = |problem: String, remedy: &str| Err(Error::usage(problem, remedy));
    let like = dicom::like(args)?;
    if like.is_none() && !is_json(out) {
        let remedy = "name the output *.json, or *.dcm with --dicom-like";
        return refuse(format!("{}: contours are written as JSON, or as DICOM", out.display()), remedy);
    }
    let given = args.kind.is_some() || args.interpolation.is_some() || args.outside.is_some() || args.labels.is_some();
    if given || args.scale_by_jacobian {
        return refuse(
            "--kind, --interpolation, --outside, --labels and --scale-by-jacobian have no meaning for contours".into(),
            "leave them out",
        );
    }
    let (ContourFile { mut contours, frame, warnings, .. }, set) = dicom::read(input, like.as_ref())?;
    report.warnings.extend(warnings);
    report.warnings.extend(contours.tidy());
    if let Some(frame) = frame.filter(|f| *f != args.from) {
        return refuse(format!("{} lies in frame {frame:?}, not in {}", input.display(), args.from), "correct --from");
    }
    let grid = match dicom::grid(args, like.as_ref(), input)? {
        Some(grid) => grid,
        None => target(args, back, &args.to, &mut report.warnings)?,
    };
    let (mut moved, mapped) = resample_contours(&contours, forward, back, &grid);
    let slice = grid.spacing()[2];
    for (old, new) in contours.structures.iter().zip(&moved.structures) {
        let volume = |s: &Structure, gap: f64| s.volume(gap) / 1000.0;
        report.notes.push(format!(
            "{}: {} slices, {:.2} cm3 -> {} slices, {:.2} cm3",
            old.name,
            old.heights().len(),
            volume(old, contours.spacing_of(old, slice)),
            new.heights().len(),
            volume(new, slice)
        ));
    }
    if let Some(samples) = sampled::of(args)? {
        sampled::contours(&contours, &mut moved, back, &grid, &samples, report)?;
    }
    match &like {
        Some(like) => like.structures(out, &moved, set.as_ref())?,
        None => io::write_contours(out, &moved, &args.to)?,
    }
    report.kind = "contours";
    let share = 100.0 * mapped.outside as f64 / mapped.points.max(1) as f64;
    report.warnings.extend(outside_field("the contours", "a field", share, WORTH_OF_LABELS));
    report.finish(back, mapped, out);
    Ok(())
}

fn map_volume(
    args: &WarpArgs,
    back: &Chain<'_>,
    unsure: Vec<&Link>,
    Files { input, out }: Files<'_>,
    runtime: &Runtime,
    report: &mut WarpReport,
) -> Result<()> {
    let Some(kind) = args.kind else {
        return Err(Error::usage(
            format!("{}: an image, labels and a dose need different interpolation", input.display()),
            "say which it is: --kind image, --kind labels or --kind dose",
        ));
    };
    refuse_for_kind(args, kind)?;
    let like: Option<Like> = dicom::like(args)?;
    let grid = match dicom::grid(args, like.as_ref(), input)? {
        Some(grid) => grid,
        None => target(args, back, &args.to, &mut report.warnings)?,
    };
    let description = format!("aventail warp {} to {}", args.from, args.to);
    let options = WriteOptions { description, ..WriteOptions::default() };
    let mapped = if kind == VolumeKind::Labels {
        let labels = runtime.stage("read the input", || io::read_label_map(input, args.labels.as_deref()))?;
        report.warnings.extend(labels.warnings);
        report.doubt(args, &unsure, labels.value.volume.grid(), &grid);
        let (warped, mapped) = runtime.stage("resample", || {
            let (v, mapped) = back.displacement_on(&grid)?;
            Ok::<_, Error>((resample_labels(&v, &labels.value)?, mapped))
        })?;
        report.notes.extend(label_notes(&labels.value, &warped));
        report.kind = "labels";
        let weight = |l: usize| f64::from(u8::from(warped.volume.data()[l] > 0));
        report.missed("the labels' volume", WORTH_OF_LABELS, back, &mapped, &grid, weight);
        runtime.stage("write", || match &like {
            Some(like) => like.labels(out, &warped, input),
            None => io::write_labels(out, &warped, &options),
        })?;
        if let Some(samples) = sampled::of(args)? {
            let of = || sampled::labels(&labels.value, &warped, back, &samples, out, report);
            runtime.stage("carry labels through samples", of)?;
        }
        mapped
    } else {
        let read = if kind == VolumeKind::Dose { io::read_dose } else { io::read_scan };
        let mut image = runtime.stage("read the input", || read(input))?;
        report.warnings.append(&mut image.warnings);
        let mut greatest = None;
        if kind == VolumeKind::Dose {
            report.warnings.extend(judge(&input.display().to_string(), &mut image.value)?);
            greatest = Some(image.value.extremes()[1]);
        }
        report.doubt(args, &unsure, image.value.grid(), &grid);
        let (warped, mapped) = runtime.stage("resample", || {
            let (v, mapped) = back.displacement_on(&grid)?;
            Ok::<_, Error>((scalar(args, &v, &image.value, greatest, report)?, mapped))
        })?;
        if kind == VolumeKind::Dose {
            report.missed("the dose", WORTH, back, &mapped, &grid, |l| f64::from(warped.data()[l]));
        } else {
            // Air around the patient is no loss: what differs from it counts.
            let air = args.outside.unwrap_or(-1000.0);
            let weight = |l: usize| f64::from((warped.data()[l] - air).abs());
            report.missed("the image (by contrast to air)", WORTH_OF_IMAGE, back, &mapped, &grid, weight);
        }
        // NIfTI's intent of labels.
        if kind == VolumeKind::Image && image.header.intent_code == Some(1002) {
            let note = "its header calls it labels, and an image mixes their numbers: give --kind labels";
            report.notes.push(note.into());
        }
        // Whole numbers stay whole numbers, as scanners store them.
        let whole = kind == VolumeKind::Image && image.header.datatype == "int16" && image.header.scaling.is_none();
        let stored = if whole { Stored::Int16 } else { Stored::Float32 };
        runtime.stage("write", || match &like {
            Some(like) => dicom::write_volume(args, like, &warped, input, out, report),
            None => io::write_image(out, &warped, stored, &options),
        })?;
        mapped
    };
    report.finish(back, mapped, out);
    Ok(())
}

/// Options that this kind of volume does not have.
fn refuse_for_kind(args: &WarpArgs, kind: VolumeKind) -> Result<()> {
    let refuse = |problem: &str, remedy: &str| Err(Error::usage(problem, remedy));
    if args.scale_by_jacobian && kind != VolumeKind::Image {
        return refuse(
            "--scale-by-jacobian scales HU, and labels and doses have none",
            "leave it out, or give --kind image; for a dose see `aventail dose map --method energy-mass`",
        );
    }
    match kind {
        VolumeKind::Labels if args.interpolation.is_some() => {
            refuse("--interpolation has no meaning for labels", "leave it out")
        }
        VolumeKind::Labels if args.outside.is_some() => refuse("--outside has no meaning for labels", "leave it out"),
        VolumeKind::Dose if args.outside.is_some() => {
            refuse("--outside has no meaning for a dose: it is 0 there", "leave it out")
        }
        _ => Ok(()),
    }
}

/// Resamples an image, or a dose with its greatest value.
fn scalar(
    args: &WarpArgs,
    v: &Volume<[f32; 3]>,
    image: &Volume<f32>,
    greatest_dose: Option<f32>,
    report: &mut WarpReport,
) -> Result<Volume<f32>> {
    let interpolation = match args.interpolation {
        Some(InterpolationName::Cubic) => Interpolation::Cubic,
        _ => Interpolation::Linear,
    };
    let Some(greatest) = greatest_dose else {
        report.kind = "image";
        let mut warped = resample(v, image, interpolation, args.outside.unwrap_or(-1000.0))?;
        if args.scale_by_jacobian {
            let done = scale_by_volume(&mut warped, v);
            report
                .notes
                .push("HU + 1000 scaled by the tissue's volume before over after: no mass is made or lost".into());
            if done.folded > 0 {
                let message = format!("not scaled where the field folds: {}", counted(done.folded, "voxel", "voxels"));
                report.warnings.push(Warning::new(findings::NOT_SCALED, message));
            }
        }
        return Ok(warped);
    };
    report.kind = "dose";
    let mut warped = match interpolation {
        // As `dose map` does, to the outer faces of the outermost voxels.
        Interpolation::Linear => interpolate(image, v, v.grid())?,
        Interpolation::Cubic => resample(v, image, interpolation, 0.0)?,
    };
    let [below, peak] = warped.extremes();
    if below < 0.0 {
        warped.data_mut().iter_mut().for_each(|d| *d = d.max(0.0));
    }
    report.notes.push(format!("greatest dose {greatest:.3}, after mapping {peak:.3}"));
    Ok(warped)
}

/// Labels that changed their volume much, or are gone.
fn label_notes(before: &LabelMap, after: &LabelMap) -> Vec<String> {
    let (old, new) = (before.counts(), after.counts());
    let gone: Vec<String> = old
        .keys()
        .filter(|l| !new.contains_key(l))
        .map(|l| before.names.get(l).cloned().unwrap_or_else(|| l.to_string()))
        .collect();
    let kept = format!("{} of {} labels lie on the new grid", new.len(), old.len());
    let outside = (!gone.is_empty()).then(|| format!("outside it: {}", gone.join(", ")));
    std::iter::once(kept).chain(outside).collect()
}
