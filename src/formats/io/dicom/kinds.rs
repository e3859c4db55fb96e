//! What an MR image shows, by Image Type (PS3.3 C.7.6.1.1.2, C.8.3.1.1.1, C.8.13.3.1.1): images of the anatomy are read, maps and
//! parts of complex images refused.

use super::elements::{Item, text};
use super::find::{Group, Object};
use crate::error::Error;
use crate::findings;
use dicom_dictionary_std::tags;

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
