//! From the images of a series to one grid: order by position, duplicates, gaps, tilt.

use super::acquisitions::alternating;
use super::frames::Frame;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::warning::Warning;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Positions closer than this are one place, mm: they are written with two decimals and more.
const SAME_PLACE_MM: f64 = 0.01;
/// Slices may lie this far from the line along the normal, mm.
const ASIDE_MM: f64 = 0.2;
/// Slices may lie so far from their place, mm, or this share of their median distance, whichever is more: rounding, and the
/// couch. The distance between two differs by twice as much.
const JITTER_MM: f64 = 0.05;
const JITTER: f64 = 0.01;
/// No slice may lie farther from its place in the grid than this share of the distance between
/// slices.
const OFF_PLACE: f64 = 0.05;
/// Direction cosines of the slices of a series agree within this.
const SAME_AXES: f64 = 5e-4;

/// The images of a series in the order of the grid's third axis.
pub(super) struct Stack {
    pub(super) grid: Grid,
    pub(super) frames: Vec<Frame>,
    pub(super) warnings: Vec<Warning>,
}

/// Which image a place in the messages is.
struct Named<'a> {
    what: &'a str,
    files: &'a [PathBuf],
    normal: Vector3<f64>,
}

impl Named<'_> {
    /// The image's file, and the frame in it.
    fn image(&self, f: &Frame) -> String {
        let file = self.files.get(f.object).map_or(String::new(), |p| p.display().to_string());
        if f.multi { format!("{file}, frame {}", f.index + 1) } else { file }
    }

    /// Where an image lies, in words.
    fn place(&self, f: &Frame) -> String {
        let along = f.position.coords.dot(&self.normal);
        if self.normal.z.abs() > 0.9999 {
            format!("z = {:.2} mm", f.position.z)
        } else {
            format!("{along:.2} mm along the normal")
        }
    }
}

/// Puts images in order. `same` tells whether two of them have the same values.
///
/// # Errors
/// [`Error::Input`] where they do not make one regular grid: with values, places and what to do.
pub(super) fn stack(
    what: &str,
    files: &[PathBuf],
    frames: Vec<Frame>,
    same: &dyn Fn(&Frame, &Frame) -> Result<bool>,
) -> Result<Stack> {
    let mut warnings = Vec::new();
    let (localizers, mut frames): (Vec<Frame>, Vec<Frame>) = frames.into_iter().partition(|f| f.localizer);
    let normal = frames.first().map_or(Vector3::z(), |f| f.axes[0].cross(&f.axes[1]));
    let named = Named { what, files, normal };
    if let Some(first) = localizers.first() {
        let message = format!("{what}: {} localizers are left out, the first {}", localizers.len(), named.image(first));
        warnings.push(Warning::new(findings::DICOM_LEFT_OUT, message));
    }
    agree(&named, &frames)?;
    let height = |f: &Frame| f.position.coords.dot(&normal);
    frames.sort_by(|a, b| height(a).total_cmp(&height(b)).then(a.object.cmp(&b.object)).then(a.index.cmp(&b.index)));
    let frames = without_twins(&named, frames, same, &mut warnings)?;
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        let remedy = "give the folder of the whole series, not of its localizer";
        return Err(Error::refused(findings::DICOM_INCOMPLETE, named.what, "it has no image but localizers", remedy));
    };
    if frames.len() < 2 {
        let problem = "it has one slice, which makes no volume".to_owned();
        return Err(Error::refused(
            findings::DICOM_INCOMPLETE,
            named.what,
            problem,
            "export all slices of the series into one folder",
        ));
    }
    one_origin(&named, &frames)?;
    upright(&named, &frames)?;
    even(&named, &frames)?;
    let step = (height(last) - height(first)) / (frames.len() - 1) as f64;
    let [row, column] = first.axes;
    let direction = Matrix3::from_columns(&[row, column, normal]);
    let size = [first.size[0], first.size[1], frames.len()];
    let grid = Grid::new(size, [first.spacing[0], first.spacing[1], step], first.position, direction)?;
    Ok(Stack { grid, frames, warnings })
}

/// Refuses images that differ in what a series has in common.
fn agree(named: &Named<'_>, frames: &[Frame]) -> Result<()> {
    let Some(first) = frames.first() else { return Ok(()) };
    for f in frames {
        let turned = (0..2).map(|a| (f.axes[a] - first.axes[a]).amax()).fold(0.0, f64::max);
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-4 * b;
        let differs = if turned > SAME_AXES {
            format!("orientations differ ({} and {})", cosines(first), cosines(f))
        } else if f.size != first.size {
            format!("sizes differ ({:?} and {:?} voxels)", first.size, f.size)
        } else if !near(f.spacing[0], first.spacing[0]) || !near(f.spacing[1], first.spacing[1]) {
            format!("pixel spacings differ ({:?} and {:?} mm)", first.spacing, f.spacing)
        } else if f.unit != first.unit {
            format!("units differ ({:?} and {:?})", first.unit, f.unit)
        } else {
            continue;
        };
        let problem = format!(
            "its images do not belong to one volume: {differs} of {} and {}",
            named.image(first),
            named.image(f)
        );
        let remedy = "move the images that are no slices of the volume elsewhere, or export the series again";
        return Err(Error::refused(findings::DICOM_IMAGES_DIFFER, named.what, problem, remedy));
    }
    Ok(())
}

fn cosines(f: &Frame) -> String {
    let six = f.axes.iter().flat_map(|a| a.iter().map(|c| format!("{c:.4}")));
    six.collect::<Vec<_>>().join("\\")
}

/// Leaves out images that are there twice; refuses two that differ at one place.
fn without_twins(
    named: &Named<'_>,
    frames: Vec<Frame>,
    same: &dyn Fn(&Frame, &Frame) -> Result<bool>,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<Frame>> {
    let mut kept: Vec<Frame> = Vec::with_capacity(frames.len());
    let (mut dropped, mut clash) = (Vec::new(), None);
    let mut clashing = 0;
    for f in frames {
        let twin = kept.last().filter(|k| (f.position - k.position).dot(&named.normal).abs() <= SAME_PLACE_MM);
        let Some(twin) = twin else {
            kept.push(f);
            continue;
        };
        let aside = (f.position - twin.position).norm() > SAME_PLACE_MM;
        if !aside && same(&f, twin)? {
            dropped.push(f);
        } else {
            clashing += 1;
            clash.get_or_insert_with(|| (twin.clone(), f));
        }
    }
    if let Some((a, b)) = clash {
        let told =
            |f: &Frame| if f.told.is_empty() { named.image(f) } else { format!("{} ({})", named.image(f), f.told) };
        let problem = format!(
            "{clashing} places hold several images that differ, the first at {}: {} and {}",
            named.place(&a),
            told(&a),
            told(&b)
        );
        let remedy = "it holds several phases, acquisitions or reconstructions: move all but one elsewhere, or export them \
            as series of their own";
        return Err(Error::refused(findings::DICOM_DUPLICATES, named.what, problem, remedy));
    }
    if let Some(first) = dropped.first() {
        let message = format!(
            "{}: {} images are there twice, the first {}; one of each is used",
            named.what,
            dropped.len(),
            named.image(first)
        );
        warnings.push(Warning::new(findings::DICOM_DUPLICATES, message));
    }
    Ok(kept)
}

/// Refuses images of several acquisitions, and several images of one UID.
fn one_origin(named: &Named<'_>, frames: &[Frame]) -> Result<()> {
    if let Some(list) = alternating(named.files, frames) {
        let problem = format!("images of several acquisitions or reconstructions alternate in it:{list}");
        let remedy = "export each as a series of its own, or move all but one elsewhere";
        return Err(Error::refused(findings::DICOM_ACQUISITIONS, named.what, problem, remedy));
    }
    let mut seen: BTreeMap<&str, &Frame> = BTreeMap::new();
    for f in frames.iter().filter(|f| !f.multi && !f.uid.is_empty()) {
        if let Some(other) = seen.insert(&f.uid, f) {
            let problem = format!(
                "two images at different places have one SOP Instance UID ({}): {} and {}",
                f.uid,
                named.image(other),
                named.image(f)
            );
            let remedy = "export the series again: what refers to an image by its UID may mean either";
            return Err(Error::refused(findings::DICOM_DUPLICATES, named.what, problem, remedy));
        }
    }
    Ok(())
}

/// Refuses slices that do not follow each other along their normal.
fn upright(named: &Named<'_>, frames: &[Frame]) -> Result<()> {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Ok(()) };
    let aside = |f: &Frame| {
        let d = f.position - first.position;
        d - named.normal * d.dot(&named.normal)
    };
    let Some(far) = frames.iter().max_by(|a, b| aside(a).norm().total_cmp(&aside(b).norm())) else { return Ok(()) };
    let (most, whole) = (aside(far).norm(), (last.position - first.position).dot(&named.normal));
    if most <= ASIDE_MM {
        return Ok(());
    }
    let angle = (aside(last).norm() / whole).atan().to_degrees();
    let problem = if aside(last).norm() > 0.5 * most {
        format!(
            "its slices are sheared by {angle:.2} degrees (gantry tilt): the last lies {:.1} mm aside of the first",
            aside(last).norm()
        )
    } else {
        format!(
            "its slices are displaced against each other: the one at {} lies {most:.1} mm aside of the first",
            named.place(far)
        )
    };
    let remedy = "resample it to an upright grid first, for example with `dcm2niix` (which corrects gantry tilt), and give \
        that image";
    Err(Error::refused(findings::DICOM_TILT, named.what, problem, remedy))
}

/// Refuses slices that are missing, and distances that vary.
fn even(named: &Named<'_>, frames: &[Frame]) -> Result<()> {
    let heights: Vec<f64> = frames.iter().map(|f| f.position.coords.dot(&named.normal)).collect();
    let gaps: Vec<f64> = heights.windows(2).map(|w| w[1] - w[0]).collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let Some(&usual) = sorted.get(sorted.len() / 2) else { return Ok(()) };
    let uneven = 2.0 * (JITTER * usual).max(JITTER_MM) + 1e-6;
    let odd: Vec<usize> = (0..gaps.len()).filter(|&n| (gaps[n] - usual).abs() > uneven).collect();
    if let Some(&n) = odd.first() {
        let between = format!("between {} and {}", named.place(&frames[n]), named.place(&frames[n + 1]));
        let times = gaps[n] / usual;
        let whole = times.round();
        let missing = whole > 1.5 && (times - whole).abs() <= 0.02 * whole;
        let more = if odd.len() > 1 { format!("; {} gaps are odd in all", odd.len()) } else { String::new() };
        let (problem, remedy) = if missing && whole < 2.5 {
            (
                format!("a slice is missing {between} (slices are {usual:.2} mm apart){more}"),
                "export the whole series again",
            )
        } else if missing {
            let count = whole - 1.0;
            (
                format!("{count:.0} slices are missing {between} (slices are {usual:.2} mm apart){more}"),
                "export the whole series again",
            )
        } else {
            (
                format!("its slices are {usual:.2} mm apart, but {:.2} mm {between}{more}", gaps[n]),
                "export the series again; if it was scanned so, resample it to equal distances and give that image",
            )
        };
        return Err(Error::refused(findings::DICOM_GAP, named.what, problem, remedy));
    }
    let step = (heights[heights.len() - 1] - heights[0]) / gaps.len() as f64;
    let off = |n: usize| (heights[n] - heights[0] - step * n as f64).abs();
    if let Some(n) = (0..heights.len()).find(|&n| off(n) > (OFF_PLACE * step).max(2.0 * JITTER_MM)) {
        let problem = format!(
            "distances between its slices drift: the one at {} lies {:.2} mm from its place at {step:.3} mm each",
            named.place(&frames[n]),
            off(n)
        );
        let remedy =
            "export the series again; if it was scanned so, resample it to equal distances and give that image";
        return Err(Error::refused(findings::DICOM_GAP, named.what, problem, remedy));
    }
    Ok(())
}
