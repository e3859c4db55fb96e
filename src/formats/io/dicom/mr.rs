//! What an MR series shows, by Image Type (PS3.3 C.7.6.1.1.2, C.8.3.1.1.1, C.8.13.3.1.1): images of the anatomy are read, maps and
//! parts of complex images refused. One contrast at a time: images that differ in echo, time or kind make no volume together.

use super::acquisitions::listed;
use super::elements::{Item, number, text, texts, whole};
use super::find::{Group, Object};
use super::frames::{Frame, Places};
use crate::error::{Error, Result};
use crate::findings;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::path::PathBuf;

/// Values of Image Type that name no magnitude image of the anatomy, by what they name; written with spaces, in capitals.
const NO_ANATOMY: [(&str, &[&str]); 11] = [
    (
        "a diffusion map",
        &["ADC", "EADC", "EXP ADC", "FA", "COLFA", "RA", "TRACE", "TRACEW", "TENSOR", "TENSOR B0", "CALC BVALUE"],
    ),
    ("a phase image", &["P", "PHASE", "VELOCITY"]),
    ("the real part of a complex image", &["R", "REAL"]),
    ("the imaginary part of a complex image", &["I", "IMAGINARY"]),
    ("a complex image", &["COMPLEX"]),
    ("a map of relaxation", &["R1", "R2", "R2*", "R2 STAR"]),
    (
        "a perfusion map",
        &["PERFUSION", "CBF", "CBV", "MTT", "TTP", "TMAX", "PBP", "GBP", "RELCBF", "RELCBV", "RELMTT", "KTRANS"],
    ),
    ("a subtraction", &["SUB", "SUBTRACTION"]),
    ("a projection", &["MIP", "MAX IP", "MIN IP", "MINIP", "MNIP", "PROJECTION IMAGE"]),
    ("a mosaic of slices", &["MOSAIC"]),
    ("a map of fat or water fraction", &["FAT FRACTION", "WATER FRACTION", "FF", "PDFF"]),
];
/// Elements of GE that tell the part of a complex image, which Image Type leaves open: group, creator, element.
const GE_PART: (u16, &str, u8) = (0x0043, "GEMS_PARM_01", 0x2f);
/// Its values.
const GE_PARTS: [&str; 4] = ["MAGNITUDE", "PHASE", "REAL", "IMAGINARY"];

/// What Image Type says, with the part of a complex image where other elements tell it.
pub(super) fn kind(set: &Item, mut image_type: Vec<String>, component: &str) -> Vec<String> {
    let (group, creator, element) = GE_PART;
    let ge = || {
        let value = set.private_element(group, creator, element).ok()?.to_int::<i64>().ok()?;
        GE_PARTS.get(usize::try_from(value).ok()?).map(|part| (*part).to_owned())
    };
    let part = if component.is_empty() { ge() } else { Some(component.to_owned()) };
    // A magnitude is what an image is taken for.
    image_type.extend(part.filter(|part| part != "MAGNITUDE" && part != "MIXED"));
    image_type
}

/// What a kind of image is, where it is no magnitude image of the anatomy.
pub(super) fn no_anatomy(kind: &[String]) -> Option<&'static str> {
    kind.iter().find_map(|value| {
        let plain = value.trim().to_uppercase().replace(['_', '-'], " ");
        let known = NO_ANATOMY.iter().find(|(_, names)| names.contains(&plain.as_str())).map(|known| known.0);
        known.or_else(|| plain.ends_with("PHASE MAP").then_some("a phase image")).or_else(|| {
            let map = plain == "MAP" || plain.ends_with(" MAP");
            map.then_some("a map of a quantity")
        })
    })
}

/// What an object says of itself as a whole.
fn kind_of(object: &Object) -> Vec<String> {
    kind(&object.header, object.image_type(), &text(&object.header, tags::COMPLEX_IMAGE_COMPONENT))
}

/// What all images of a series are, where none of them is a magnitude image of the anatomy, with the Image Type of the first.
pub(super) fn only_maps(objects: &[&Object]) -> Option<(&'static str, String)> {
    let kinds: Vec<Vec<String>> = objects.iter().map(|o| kind_of(o)).collect();
    let first = kinds.first()?;
    kinds.iter().all(|kind| no_anatomy(kind).is_some()).then(|| no_anatomy(first))?.map(|map| (map, first.join("\\")))
}

/// The refusal of such a series; `others` are the MR series beside it.
pub(super) fn refuse_map(what: &str, (map, kind): &(&str, String), others: &[Group<'_>]) -> Error {
    let left: Vec<&Group<'_>> = others.iter().filter(|g| only_maps(&g.objects).is_none()).collect();
    let list: String = left.iter().map(|g| format!("\n    {}; UID {}", g.words(), g.series.uid)).collect();
    let remains = if left.is_empty() { String::new() } else { format!("; what remains beside it:{list}") };
    let problem = format!("it is {map}, no magnitude image of the anatomy (Image Type {kind}){remains}");
    let remedy = "give the series of the magnitude images of the same scan";
    Error::refused(findings::MR_DERIVED_MAP, what, problem, remedy)
}

/// Refuses images of several kinds, echoes or times in one series, with what there is of each; and a series of maps alone.
///
/// # Errors
/// [`Error::Input`] then.
pub(super) fn one_image(what: &str, files: &[PathBuf], frames: &[Frame]) -> Result<()> {
    let frames: Vec<&Frame> = frames.iter().filter(|f| !f.localizer).collect();
    let Some(first) = frames.first() else { return Ok(()) };
    if frames.iter().all(|f| no_anatomy(&f.kind).is_some())
        && let Some(map) = no_anatomy(&first.kind)
    {
        return Err(refuse_map(what, &(map, first.kind.join("\\")), &[]));
    }
    for (n, (name, of_first)) in first.origin.iter().enumerate() {
        let value = |f: &Frame| f.origin.get(n).map_or(String::new(), |o| o.1.clone());
        if frames.iter().all(|f| value(f) == *of_first) {
            continue;
        }
        let values: Vec<String> = frames.iter().map(|f| value(f)).collect();
        let values: Vec<&str> = values.iter().map(String::as_str).collect();
        let list = listed(files, frames.iter().copied(), name, &values);
        let problem = format!("its images differ in {name}, so that they are several volumes:{list}");
        return Err(Error::refused(findings::DICOM_ACQUISITIONS, what, problem, keep(&frames)));
    }
    Ok(())
}

/// What to do about images of several kinds: which of them remain.
fn keep(frames: &[&Frame]) -> String {
    let mut kinds: Vec<String> = frames.iter().map(|f| f.kind.join("\\")).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let split = |kind: &str| kind.split('\\').map(str::to_owned).collect::<Vec<_>>();
    let anatomy: Vec<&String> = kinds.iter().filter(|kind| no_anatomy(&split(kind)).is_none()).collect();
    match anatomy.as_slice() {
        [one] if kinds.len() > 1 => format!("keep the images of image type {one}, and move the others elsewhere"),
        _ => "export each as a series of its own, or move all but one elsewhere".into(),
    }
}

/// What all images of one volume have in common, by name: a difference in one of them is another contrast.
pub(super) fn origin(places: Places<'_>, kind: &[String], scaled: bool) -> Vec<(&'static str, String)> {
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
