//! A CT series as a volume in HU, or an MR series as one of grey values.

use super::super::Loaded;
use super::super::bytes::{read_bytes, sha256};
use super::super::raster::HeaderNotes;
use super::counts::fewer;
use super::elements::{Item, text, whole};
use super::find::Object;
use super::frames::{Frame, frames};
use super::mr;
use super::open;
use super::pixels::{Pixels, believable};
use super::place::{Chosen, choose};
use super::scan::Scan;
use super::series::{Series, Slice};
use super::stack::{Stack, stack};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// HU that a place without a measurement may have; other values are replaced by air.
const PADDING_HU: [f64; 2] = [-4096.0, 4000.0];
const AIR_HU: f64 = -1024.0;
/// What a place without a measurement has in an MR: no signal.
const NO_SIGNAL: f64 = 0.0;
/// Units of Rescale Type (PS3.3 C.11.1.1.2) that are no HU.
const NO_HU: [&str; 6] = ["OD", "MGML", "Z_EFF", "ED", "EDW", "PCT"];

/// A series whose images are in order, before its pixels are read.
pub(super) struct Planned {
    files: Vec<PathBuf>,
    pub(super) stack: Stack,
    pub(super) series: Series,
    pub(super) warnings: Vec<Warning>,
    header: Box<DefaultDicomObject>,
}

/// Reads a CT series in HU, or an MR series in its own grey values ([`Series::modality`] tells which), LPS mm, from its folder,
/// from the file of one of its slices, or from `FOLDER#SERIES_NUMBER` or `FOLDER#UID` where the folder holds several. The grid's
/// axes are columns, rows and slices, right-handed; slices are ordered by position. The SHA-256 is that of the sorted SHA-256 of
/// the files used, one a line.
///
/// # Errors
/// [`Error::Read`] when a file is missing or damaged. [`Error::Input`] when it is not clear which series is meant; when it is
/// neither CT nor MR, or an MR of maps; when slices are missing, differ at one place, are tilted or do not make one volume; when
/// pixels are compressed in a way that is not read; when values of a CT are no HU.
pub fn read_series(path: impl AsRef<Path>) -> Result<Loaded<(Volume<f32>, Series)>> {
    let path = path.as_ref();
    match choose(path)? {
        (Chosen::Scan(objects, beside), same) => read(&same, objects, beside),
        (Chosen::Dose(..) | Chosen::Labels(_), _) => Err(no_ct(path)),
    }
}

/// The refusal of a dose where a CT is asked for.
pub(super) fn no_ct(path: &Path) -> Error {
    let what = path.display().to_string();
    Error::refused(findings::DICOM_NO_CT, what, "it is no CT series", "give the folder of the CT series")
}

/// Puts the images of a series in order; `warnings` are those of the files beside them.
pub(super) fn plan(path: &Path, mut objects: Vec<Object>, mut warnings: Vec<Warning>) -> Result<Planned> {
    let what = path.display().to_string();
    let all = objects.len();
    let scan = Scan::of(&objects).unwrap_or(Scan::Ct);
    objects.retain(|o| Scan::of_class(&o.sop_class) == Some(scan));
    if objects.len() < all {
        let (left_out, name) = (all - objects.len(), scan.name());
        let message = format!("{what}: {left_out} objects that are no {name} images are left out");
        warnings.push(Warning::new(findings::DICOM_LEFT_OUT, message));
    }
    let localizer = |o: &Object| o.image_type().iter().any(|k| k == "LOCALIZER");
    let Some(first) = objects.iter().find(|o| !localizer(o)).or(objects.first()).cloned() else {
        return Err(Error::refused(
            findings::DICOM_NO_CT,
            what,
            "it holds no CT image",
            "give the folder of a CT series",
        ));
    };
    // Localizers often lie in the same series and have a frame of reference, but no position that
    // could be used.
    let all = objects.len();
    objects.retain(|o| !localizer(o) || all == 1);
    if objects.len() < all {
        let message = format!("{what}: {} localizers are left out", all - objects.len());
        warnings.push(Warning::new(findings::DICOM_LEFT_OUT, message));
    }
    let one_frame = |o: &Object| o.series.frame_of_reference == first.series.frame_of_reference;
    if let Some(other) = objects.iter().find(|o| !one_frame(o)) {
        let problem = format!(
            "its slices lie in several frames of reference ({} and {})",
            first.path.display(),
            other.path.display()
        );
        let remedy = "export one series at a time: positions in two frames cannot be compared";
        return Err(Error::refused(findings::DICOM_FRAME, what, problem, remedy));
    }
    warnings.extend(fewer(&what, &objects)?);
    let files: Vec<PathBuf> = objects.iter().map(|o| o.path.clone()).collect();
    let each = objects.par_iter().enumerate().map(|(n, o)| frames(n, o)).collect::<Result<Vec<_>>>()?;
    let frames: Vec<Frame> = each.into_iter().flatten().collect();
    if scan == Scan::Mr {
        mr::one_image(&what, &files, &frames)?;
    }
    let same = |a: &Frame, b: &Frame| same_values(&files, a, b);
    let mut stack = stack(&what, &files, frames, &same)?;
    warnings.append(&mut stack.warnings);
    let lossy = |o: &&Object| text(&o.header, tags::LOSSY_IMAGE_COMPRESSION) == "01";
    if let Some(object) = objects.iter().find(lossy) {
        let ratio = text(&object.header, tags::LOSSY_IMAGE_COMPRESSION_RATIO);
        let ratio = if ratio.is_empty() { String::new() } else { format!(", {ratio} times smaller") };
        let message =
            format!("{what}: its images were compressed with loss{ratio}: edges and values are not as measured");
        warnings.push(Warning::new(findings::DICOM_LOSSY, message));
    }
    if scan == Scan::Ct {
        warnings.extend(unit(&what, &stack.frames)?);
    }
    let mut series = first.series.clone();
    if series.frame_of_reference.is_empty() {
        let message = format!(
            "{what}: it has no Frame of Reference UID: whether structures and doses belong to it cannot be checked"
        );
        warnings.push(Warning::new(findings::DICOM_FRAME, message));
    }
    let slice =
        |f: &Frame| Slice { uid: f.uid.clone(), frame: f.multi.then(|| f.index as u32 + 1), position: f.position };
    series.slices = stack.frames.iter().map(slice).collect();
    Ok(Planned { files, stack, series, warnings, header: first.header })
}

/// Refuses values that are no HU.
fn unit(what: &str, frames: &[Frame]) -> Result<Option<Warning>> {
    let unit = frames.first().map_or("", |f| f.unit.as_str());
    if NO_HU.contains(&unit) {
        let problem = format!("its values are no HU (Rescale Type {unit:?})");
        let remedy = "give the series in HU of the same scan";
        return Err(Error::refused(findings::DICOM_UNIT, what, problem, remedy));
    }
    let odd = !matches!(unit, "" | "HU" | "HU_MOD");
    let message = format!("{what}: its values are taken for HU, though it says Rescale Type {unit:?}");
    Ok(odd.then(|| Warning::new(findings::DICOM_UNIT, message)))
}

/// Whether two images are the same object, or have the same values.
fn same_values(files: &[PathBuf], a: &Frame, b: &Frame) -> Result<bool> {
    let values = |f: &Frame| -> Result<Vec<f32>> {
        let path = files.get(f.object).ok_or_else(|| Error::Internal("an image without its file".into()))?;
        let object = open::whole(path, &read_bytes(path)?)?;
        let mut out = vec![0.0; f.size[0] * f.size[1]];
        fill(&Pixels::of(path, &object)?, f, None, &mut out);
        Ok(out)
    };
    Ok(values(a)? == values(b)?)
}

/// Values that stand for nothing measured (PS3.3 C.7.5.1.1.2), as stored.
struct Padding {
    from: i64,
    to: i64,
}

impl Padding {
    fn of(set: &Item) -> Option<Self> {
        let signed = whole(set, tags::PIXEL_REPRESENTATION) == Some(1);
        // Its type may be that of the other sign.
        let stored = |v: i64| if signed { i64::from(v as u16 as i16) } else { i64::from(v as u16) };
        let value = stored(whole(set, tags::PIXEL_PADDING_VALUE)?);
        let limit = whole(set, tags::PIXEL_PADDING_RANGE_LIMIT).map_or(value, stored);
        Some(Self { from: value.min(limit), to: value.max(limit) })
    }
}

/// A frame's values in HU, or an MR's; returns how many that were not measured are air now, since no CT has
/// such values, or show no signal.
fn fill(pixels: &Pixels, frame: &Frame, padding: Option<&Padding>, out: &mut [f32]) -> usize {
    let [slope, intercept] = frame.scale;
    let mut replaced = 0;
    pixels.each(frame.index, |n, stored| {
        let mut value = slope * stored as f64 + intercept;
        if padding.is_some_and(|p| (p.from..=p.to).contains(&stored)) {
            let (odd, nothing) = match frame.scan {
                Scan::Ct => (!(PADDING_HU[0]..=PADDING_HU[1]).contains(&value), AIR_HU),
                Scan::Mr => (value != NO_SIGNAL, NO_SIGNAL),
            };
            if odd {
                value = nothing;
                replaced += 1;
            }
        }
        if let Some(out) = out.get_mut(n) {
            *out = value as f32;
        }
    });
    replaced
}

/// Reads the pixels of a series.
pub(super) fn read(path: &Path, objects: Vec<Object>, beside: Vec<Warning>) -> Result<Loaded<(Volume<f32>, Series)>> {
    let Planned { files, stack, series, mut warnings, header } = plan(path, objects, beside)?;
    let Stack { grid, frames, .. } = stack;
    let slice = grid.strides()[2];
    for (n, file) in files.iter().enumerate() {
        let own = frames.iter().filter(|f| f.object == n).map(|f| (f.size[0] * f.size[1]) as u64).sum::<u64>();
        believable(file, own.saturating_mul(2), std::fs::metadata(file).map_or(0, |about| about.len()))?;
    }
    let mut data = vec![0.0f32; grid.len()];
    let mut parts: Vec<Vec<(&Frame, &mut [f32])>> = files.iter().map(|_| Vec::new()).collect();
    for (frame, part) in frames.iter().zip(data.chunks_mut(slice)) {
        if let Some(own) = parts.get_mut(frame.object) {
            own.push((frame, part));
        }
    }
    let replaced = AtomicUsize::new(0);
    let one = |(file, parts): (&PathBuf, Vec<(&Frame, &mut [f32])>)| -> Result<String> {
        let bytes = read_bytes(file)?;
        let object = open::whole(file, &bytes)?;
        let pixels = Pixels::of(file, &object)?;
        let padding = Padding::of(&object);
        let air = parts.into_par_iter().map(|(frame, out)| fill(&pixels, frame, padding.as_ref(), out)).sum();
        replaced.fetch_add(air, Ordering::Relaxed);
        Ok(sha256(&bytes))
    };
    let used = files.par_iter().zip(parts).with_max_len(1).filter(|(_, parts)| !parts.is_empty());
    let sums = used.map(one).collect::<Result<Vec<_>>>()?;
    let replaced = replaced.into_inner();
    let scan = frames.first().map_or(Scan::Ct, |f| f.scan);
    if replaced > 0 {
        let now = match scan {
            Scan::Ct => format!("had values that no CT has; they are {AIR_HU} HU"),
            Scan::Mr => format!("had values that no signal has; they are {NO_SIGNAL}"),
        };
        let message =
            format!("{}: {replaced} voxels that were not measured (Pixel Padding Value) {now}", path.display());
        warnings.push(Warning::new(findings::DICOM_PADDING, message));
    }
    let format = format!("DICOM {}", scan.name());
    let notes = notes(&format, &header, &grid, frames.first().map(|f| f.scale), &series.description);
    let volume = Volume::new(grid, data)?;
    Ok(Loaded { value: (volume, series), path: path.into(), sha256: sum(sums), header: notes, warnings })
}

/// SHA-256 of the sorted sums, one a line.
pub(super) fn sum(mut sums: Vec<String>) -> String {
    sums.sort();
    sha256(sums.iter().flat_map(|s| [s.as_str(), "\n"]).collect::<String>().as_bytes())
}

/// The files that a series is read from.
pub(super) fn used(planned: &Planned) -> Vec<&PathBuf> {
    let used: BTreeSet<usize> = planned.stack.frames.iter().map(|f| f.object).collect();
    used.into_iter().filter_map(|n| planned.files.get(n)).collect()
}

/// What an object's header says, apart from the grid.
pub(super) fn notes(
    format: &str,
    header: &DefaultDicomObject,
    grid: &Grid,
    scaling: Option<[f64; 2]>,
    description: &str,
) -> HeaderNotes {
    let sign = if whole(header, tags::PIXEL_REPRESENTATION) == Some(1) { "int" } else { "uint" };
    let bits = whole(header, tags::BITS_ALLOCATED).unwrap_or_default();
    let syntax = header.meta().transfer_syntax().trim_end_matches('\0');
    HeaderNotes {
        big_endian: syntax == "1.2.840.10008.1.2.2",
        compressed: syntax.starts_with("1.2.840.10008.1.2.4") || syntax == "1.2.840.10008.1.2.5",
        scaling,
        ..HeaderNotes::plain(format, grid, &format!("{sign}{bits}"), description)
    }
}
