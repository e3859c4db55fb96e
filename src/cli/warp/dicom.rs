//! What a `warp` writes as DICOM.

use super::super::links::LinkArg;
use super::args::{VolumeKind, WarpArgs};
use super::report::WarpReport;
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io::dicom::like::{self, Like};
use crate::io::dicom::{CarriedDose, Role, StructureSet, check_frames, is_dicom_path, read_structure_set};
use crate::io::{self, ContourFile};
use crate::volume::Volume;
use std::path::{Path, PathBuf};

/// What an input is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Input {
    Points,
    Contours,
    Volume,
}

/// Refuses an output that does not fit what is written, before anything is read.
pub(super) fn check(args: &WarpArgs, input: Input, out: &Path) -> Result<()> {
    let like = args.dicom_like.as_deref();
    if like.is_some() && input == Input::Points {
        return Err(Error::usage(
            "--dicom-like has no meaning for points and meshes: they are not written as DICOM",
            "leave it out, or give contours or labels",
        ));
    }
    if input == Input::Contours && like.is_some() && args.grid.is_some() {
        return Err(Error::usage(
            "--grid has no meaning with --dicom-like for contours: they are drawn on the slices of that series",
            "leave --grid out",
        ));
    }
    if let (Some(like), Some(grid)) = (like, &args.grid) {
        check_frames(Role::Image.at(grid), Role::Image.at(like))?;
    }
    like::check(out, like, input == Input::Volume && args.kind == Some(VolumeKind::Image))
}

/// Refuses a field as DICOM without both scans, and both scans for a field that is none, before anything is read.
pub(super) fn check_field(args: &WarpArgs, out: &Path) -> Result<()> {
    let dcm = like::is_dcm(out);
    if dcm && (args.dicom_like.is_none() || args.dicom_to.is_none()) {
        return Err(Error::usage(
            format!("{}: a field as DICOM names the scan that it lies in and the one that it leads to", out.display()),
            "add --dicom-like and --dicom-to, the folders of the DICOM series of --from and of --to",
        ));
    }
    if !dcm && args.dicom_like.is_some() {
        return Err(Error::usage(
            format!("{}: with --dicom-like the field is written as DICOM", out.display()),
            "name it *.dcm, or leave --dicom-like and --dicom-to out",
        ));
    }
    for series in [&args.dicom_like, &args.dicom_to].into_iter().flatten() {
        if !is_dicom_path(series) {
            return Err(Error::usage(
                format!("{}: it is no DICOM series", series.display()),
                "give the folders of the DICOM series of --from and of --to",
            ));
        }
    }
    Ok(())
}

/// The scans that a field as DICOM lies in and leads to; `None` where it is written as another format.
pub(super) fn ends(args: &WarpArgs) -> Result<Option<[Like; 2]>> {
    let (Some(from), Some(to)) = (&args.dicom_like, &args.dicom_to) else { return Ok(None) };
    Ok(Some([Like::read(from)?, Like::read(to)?]))
}

/// The scan that the result refers to.
pub(super) fn like(args: &WarpArgs) -> Result<Option<Like>> {
    args.dicom_like.as_deref().map(Like::read).transpose()
}

/// The grid of a result as DICOM where no other is named: the scan's, for a dose as coarse as the dose is.
pub(super) fn grid(args: &WarpArgs, like: Option<&Like>, input: &Path) -> Result<Option<Grid>> {
    let Some(like) = like.filter(|_| args.grid.is_none()) else { return Ok(None) };
    if args.kind != Some(VolumeKind::Dose) {
        return Ok(Some(like.grid.clone()));
    }
    let spacing = io::read_dose(input)?.value.grid().spacing();
    Ok(Some(like.grid.coarsened(spacing.into_iter().fold(f64::INFINITY, f64::min))))
}

/// Reads contours, and what a structure set says of them. For a result as DICOM those without a contour keep their place in
/// the set.
pub(super) fn read(input: &Path, like: Option<&Like>) -> Result<(ContourFile, Option<StructureSet>)> {
    let Some(like) = like.filter(|_| is_dicom_path(input)) else {
        return Ok((io::read_contour_file(input)?, None));
    };
    let set = read_structure_set(input)?;
    like.same_patient(input, &set.patient)?;
    let (contours, path, warnings) = (set.contours.clone(), set.path.clone(), set.warnings.clone());
    Ok((ContourFile { contours, frame: None, path, warnings }, Some(set)))
}

/// Writes an image or a dose as DICOM.
pub(super) fn write_volume(
    args: &WarpArgs,
    like: &Like,
    warped: &Volume<f32>,
    input: &Path,
    out: &Path,
    report: &mut WarpReport,
) -> Result<()> {
    if args.kind != Some(VolumeKind::Dose) {
        return like.image(out, warped, Some(input));
    }
    let fields: Vec<PathBuf> = args.field.iter().map(LinkArg::path).collect();
    let fields: Vec<&Path> = fields.iter().map(PathBuf::as_path).collect();
    report.warnings.extend(like.dose(out, warped, CarriedDose::Dose, [&[input], &fields])?);
    Ok(())
}
