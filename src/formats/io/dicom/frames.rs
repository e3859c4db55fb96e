//! The images of a CT or MR series with their geometry and scale, from single-slice objects (PS3.3
//! C.7.6.2, C.8.2.1, C.8.3.1) and from enhanced multi-frame ones (C.7.6.16, C.8.13, C.8.15).

use super::elements::{Item, first, items, number, some, text, texts, whole};
use super::find::Object;
use super::kinds;
use super::scan::Scan;
use crate::error::{Error, Result};
use crate::findings;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// How far direction cosines may be from unit length and from a right angle: what rounding leaves.
const UNIT: f64 = 1e-3;

/// One image.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    /// Which of the series' objects holds it.
    pub(super) object: usize,
    /// Its place in an object of several frames, from 0.
    pub(super) index: usize,
    /// Whether that object is of several frames.
    pub(super) multi: bool,
    /// SOP Instance UID of the object.
    pub(super) uid: String,
    /// Centre of the first pixel, LPS mm.
    pub(super) position: Point3<f64>,
    /// Directions in which the column index and the row index grow, orthonormal.
    pub(super) axes: [Vector3<f64>; 2],
    /// Distances between columns and between rows, mm.
    pub(super) spacing: [f64; 2],
    /// Columns and rows.
    pub(super) size: [usize; 2],
    /// Slope and intercept to HU, or to an MR's grey values.
    pub(super) scale: [f64; 2],
    /// What values are in after scaling; empty where the object does not say.
    pub(super) unit: String,
    /// What made it.
    pub(super) scan: Scan,
    /// Image Type, or Frame Type; of an MR with the part of a complex image.
    pub(super) kind: Vec<String>,
    /// Whether it is a localizer (PS3.3 C.8.2.1.1.1).
    pub(super) localizer: bool,
    /// What tells images at one place apart: acquisition, number and time.
    pub(super) told: String,
    /// What images of one acquisition and reconstruction have in common, by name.
    pub(super) origin: Vec<(&'static str, String)>,
    /// When it was acquired, s; of an MR unknown, whose slices are measured in turns.
    pub(super) time: Option<f64>,
}

/// The images of an object.
///
/// # Errors
/// [`Error::Input`] naming the element that is missing or cannot be used.
pub(super) fn frames(at: usize, object: &Object) -> Result<Vec<Frame>> {
    let set: &Item = &object.header;
    let own = items(set, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
    let shared = first(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    if own.is_empty() {
        let count = whole(set, tags::NUMBER_OF_FRAMES).unwrap_or(1);
        if count != 1 {
            let problem = format!("it has {count} frames, and no positions of them");
            return Err(refuse(&object.path, problem));
        }
        return Ok(vec![frame(object, Places { set, own: None, shared: None }, at, 0)?]);
    }
    let count = whole(set, tags::NUMBER_OF_FRAMES);
    if count != i64::try_from(own.len()).ok() {
        let count = count.map_or("no".into(), |n| n.to_string());
        return Err(refuse(&object.path, format!("it says {count} frames, and describes {}", own.len())));
    }
    let one = |(n, item)| frame(object, Places { set, own: Some(item), shared }, at, n);
    own.iter().enumerate().map(one).collect()
}

/// Where an element of a frame may stand: in its functional groups, in those shared by all, or in
/// the object itself.
#[derive(Clone, Copy)]
pub(super) struct Places<'a> {
    pub(super) set: &'a Item,
    pub(super) own: Option<&'a Item>,
    pub(super) shared: Option<&'a Item>,
}

impl<'a> Places<'a> {
    pub(super) fn group(self, sequence: Tag) -> &'a Item {
        let of = |places: Option<&'a Item>| places.and_then(|item| first(item, sequence));
        of(self.own).or_else(|| of(self.shared)).unwrap_or(self.set)
    }
}

/// Where an image lies.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    /// Centre of the first pixel, LPS mm.
    pub(super) position: Point3<f64>,
    /// Directions in which the column index and the row index grow, orthonormal.
    pub(super) axes: [Vector3<f64>; 2],
    /// Distances between columns and between rows, mm.
    pub(super) spacing: [f64; 2],
    /// Columns and rows.
    pub(super) size: [usize; 2],
}

/// Where an image lies, by what is said of it.
///
/// # Errors
/// [`Error::Input`] naming the element that is missing or cannot be used.
pub(super) fn plane(path: &Path, places: Places<'_>) -> Result<Plane> {
    let missing = |name: &str| refuse(path, format!("it has no usable {name}"));
    let position = some::<3>(places.group(tags::PLANE_POSITION_SEQUENCE), tags::IMAGE_POSITION_PATIENT)
        .ok_or_else(|| missing("Image Position (Patient)"))?;
    let orientation = some::<6>(places.group(tags::PLANE_ORIENTATION_SEQUENCE), tags::IMAGE_ORIENTATION_PATIENT)
        .ok_or_else(|| missing("Image Orientation (Patient)"))?;
    // The first value is the distance between rows, so between voxels along a column.
    let [rows_apart, columns_apart] = some::<2>(places.group(tags::PIXEL_MEASURES_SEQUENCE), tags::PIXEL_SPACING)
        .filter(|s| s.iter().all(|v| *v > 0.0))
        .ok_or_else(|| missing("Pixel Spacing"))?;
    let size = |tag| whole(places.set, tag).and_then(|n| usize::try_from(n).ok()).filter(|n| *n > 0);
    let size = match (size(tags::COLUMNS), size(tags::ROWS)) {
        (Some(columns), Some(rows)) => [columns, rows],
        _ => return Err(missing("Rows and Columns")),
    };
    Ok(Plane { position: position.into(), axes: axes(path, orientation)?, spacing: [columns_apart, rows_apart], size })
}

fn frame(object: &Object, places: Places<'_>, at: usize, index: usize) -> Result<Frame> {
    let path = &object.path;
    let scan = Scan::of_class(&object.sop_class).unwrap_or(Scan::Ct);
    let Plane { position, axes, spacing, size } = plane(path, places)?;
    let transformation = places.group(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE);
    if !items(places.set, tags::MODALITY_LUT_SEQUENCE).is_empty() {
        return Err(refuse(
            path,
            "its values are scaled by a table (Modality LUT Sequence), not by slope and intercept",
        ));
    }
    let scale = scale(path, transformation, scan)?;
    let frame_type = match scan {
        Scan::Ct => places.group(tags::CT_IMAGE_FRAME_TYPE_SEQUENCE),
        Scan::Mr => places.group(tags::MR_IMAGE_FRAME_TYPE_SEQUENCE),
    };
    let kind = match frame_type {
        group if group.get(tags::FRAME_TYPE).is_some() => texts(group, tags::FRAME_TYPE),
        _ => texts(places.set, tags::IMAGE_TYPE),
    };
    let kind = match scan {
        Scan::Ct => kind,
        Scan::Mr => kinds::kind(places.set, kind, &text(frame_type, tags::COMPLEX_IMAGE_COMPONENT)),
    };
    Ok(Frame {
        object: at,
        index,
        multi: places.own.is_some(),
        uid: object.uid.clone(),
        position,
        axes,
        spacing,
        size,
        scale: scale.unwrap_or([1.0, 0.0]),
        unit: text(transformation, tags::RESCALE_TYPE),
        scan,
        localizer: kind.iter().any(|k| k == "LOCALIZER"),
        told: told(places),
        origin: match scan {
            Scan::Ct => origin(places),
            Scan::Mr => contrast(places, &kind, scale.is_some()),
        },
        time: if scan == Scan::Ct { time(places) } else { None },
        kind,
    })
}

/// Slope and intercept of an image (PS3.3 C.11.1). Many MR have none, which the MR Image module does not ask for: their stored
/// values are grey values.
fn scale(path: &Path, set: &Item, scan: Scan) -> Result<Option<[f64; 2]>> {
    let both = [tags::RESCALE_SLOPE, tags::RESCALE_INTERCEPT];
    if scan == Scan::Mr && both.iter().all(|tag| text(set, *tag).is_empty()) {
        return Ok(None);
    }
    let slope = number(set, tags::RESCALE_SLOPE).filter(|s| *s != 0.0);
    let both = slope.zip(number(set, tags::RESCALE_INTERCEPT)).map(|(slope, intercept)| [slope, intercept]);
    both.map(Some).ok_or_else(|| refuse(path, "it has no usable Rescale Slope and Rescale Intercept"))
}

/// Directions of columns and rows, made exactly orthonormal.
pub(super) fn axes(path: &Path, o: [f64; 6]) -> Result<[Vector3<f64>; 2]> {
    let (row, column) = (Vector3::new(o[0], o[1], o[2]), Vector3::new(o[3], o[4], o[5]));
    let off = (row.norm() - 1.0).abs().max((column.norm() - 1.0).abs()).max(row.dot(&column).abs());
    if off.is_nan() || off > UNIT {
        let problem = format!("its Image Orientation (Patient) {o:?} is no pair of perpendicular unit vectors");
        return Err(refuse(path, problem));
    }
    let row = row.normalize();
    Ok([row, (column - row * row.dot(&column)).normalize()])
}

/// What tells images at one place apart, in words.
fn told(places: Places<'_>) -> String {
    let content = places.group(tags::FRAME_CONTENT_SEQUENCE);
    let named = [
        ("acquisition", text(places.set, tags::ACQUISITION_NUMBER)),
        ("instance", text(places.set, tags::INSTANCE_NUMBER)),
        ("stack", text(content, tags::STACK_ID)),
        ("time", text(places.set, tags::CONTENT_TIME)),
        ("phase", text(places.set, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE)),
    ];
    named.into_iter().filter(|n| !n.1.is_empty()).map(|(n, v)| format!("{n} {v}")).collect::<Vec<_>>().join(", ")
}

/// What images of one acquisition and reconstruction have in common.
fn origin(places: Places<'_>) -> Vec<(&'static str, String)> {
    let either = |group: Tag, own: Tag, tag: Tag| {
        let framed = text(places.group(group), own);
        if framed.is_empty() { text(places.set, tag) } else { framed }
    };
    let own = |tag| texts(places.set, tag).join("/");
    let measures = places.group(tags::PIXEL_MEASURES_SEQUENCE);
    let kernel = texts(places.group(tags::CT_RECONSTRUCTION_SEQUENCE), tags::CONVOLUTION_KERNEL).join("/");
    let thickness = number(measures, tags::SLICE_THICKNESS).map(|t| format!("{t:.2} mm")).unwrap_or_default();
    let content = tags::FRAME_CONTENT_SEQUENCE;
    vec![
        ("acquisition", either(content, tags::FRAME_ACQUISITION_NUMBER, tags::ACQUISITION_NUMBER)),
        ("kernel", kernel),
        ("slice thickness", thickness),
        ("image type", texts(places.set, tags::IMAGE_TYPE).into_iter().take(3).collect::<Vec<_>>().join("/")),
        ("acquisition UID", own(tags::ACQUISITION_UID)),
        ("irradiation event", own(tags::IRRADIATION_EVENT_UID)),
        ("stack", text(places.group(content), tags::STACK_ID)),
        ("phase", own(tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE)),
        ("temporal position", own(tags::TEMPORAL_POSITION_IDENTIFIER)),
        ("filter", own(tags::FILTER_TYPE)),
        ("diameter", own(tags::RECONSTRUCTION_DIAMETER)),
        ("protocol", own(tags::PROTOCOL_NAME)),
        ("date", own(tags::ACQUISITION_DATE)),
        ("series time", own(tags::SERIES_TIME)),
        ("tube voltage", own(tags::KVP)),
        ("tilt", own(tags::GANTRY_DETECTOR_TILT)),
        ("device", own(tags::DEVICE_SERIAL_NUMBER)),
    ]
}

/// When an image was acquired, s of its day.
fn time(places: Places<'_>) -> Option<f64> {
    let framed = text(places.group(tags::FRAME_CONTENT_SEQUENCE), tags::FRAME_ACQUISITION_DATE_TIME);
    let whole = [framed, text(places.set, tags::ACQUISITION_DATE_TIME)].into_iter().find(|t| t.len() > 8);
    let clock = whole.and_then(|t| t.get(8..).map(str::to_owned));
    let clock = clock.or_else(|| {
        let all =
            [tags::ACQUISITION_TIME, tags::CONTENT_TIME, tags::INSTANCE_CREATION_TIME].map(|tag| text(places.set, tag));
        all.into_iter().find(|t| !t.is_empty())
    })?;
    let two = |at: usize| clock.get(at..at + 2).and_then(|t| t.parse::<f64>().ok());
    let seconds = clock.get(4..).and_then(|t| t.split(['+', '-']).next()).and_then(|t| t.parse::<f64>().ok());
    Some(3600.0 * two(0)? + 60.0 * two(2).unwrap_or_default() + seconds.unwrap_or_default())
}

/// The refusal of an object that lacks something.
pub(super) fn refuse(path: &Path, problem: impl Into<String>) -> Error {
    Error::refused(
        findings::DICOM_INCOMPLETE,
        path.display().to_string(),
        problem,
        "export the series again, or convert it with a tool that knows the vendor's files, for example dcm2niix",
    )
}

/// What all images of one volume have in common, by name: a difference in one of them is another contrast.
fn contrast(places: Places<'_>, kind: &[String], scaled: bool) -> Vec<(&'static str, String)> {
    let framed = |group: Tag, tag: Tag| number(places.group(group), tag);
    let echo_time = framed(tags::MR_ECHO_SEQUENCE, tags::EFFECTIVE_ECHO_TIME).or(number(places.set, tags::ECHO_TIME));
    let b = framed(tags::MR_DIFFUSION_SEQUENCE, tags::DIFFUSION_B_VALUE);
    let content = places.group(tags::FRAME_CONTENT_SEQUENCE);
    let moment = whole(content, tags::TEMPORAL_POSITION_INDEX);
    let moment = moment.or(whole(places.set, tags::TEMPORAL_POSITION_IDENTIFIER));
    vec![
        ("image type", kind.join("\\")),
        ("echo time", echo_time.map(|t| format!("{t:.2} ms")).unwrap_or_default()),
        ("echo", texts(places.set, tags::ECHO_NUMBERS).join("/")),
        ("temporal position", moment.map(|n| n.to_string()).unwrap_or_default()),
        ("b-value", b.map(|b| format!("{b:.0} s/mm2")).unwrap_or_default()),
        ("Rescale Slope", if scaled { "some" } else { "" }.into()),
    ]
}
