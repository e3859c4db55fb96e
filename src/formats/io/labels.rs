//! Label maps and the names of their labels: TotalSegmentator's NIfTI header extension, or a JSON file.

use super::Loaded;
use super::dicom::{self, BoneNames, StructureSet, labels_from_structures, organs_from_structures, read_structure_set};
use super::image::{WriteOptions, write};
use super::json::is_json;
use super::load::load;
use super::names::{Names, header_names, read_names};
use super::raster::{Odd, Raster};
use super::segments::{all_segments, bone_segments, organ_segments};
use super::values::{Contents, Meaning, Values};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::{LabelMap, LabelSpans, Volume};
use crate::warning::Warning;
use quick_xml::escape::escape;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// How far a scaled value may lie from an integer: scaling is stored as float32.
const SCALED_TOLERANCE: f64 = 1e-3;

/// Reads a label map with the names of its labels, from the JSON file `names` where given, else from the header.
///
/// The JSON file holds `{"labels": {"1": "skull", "2": "mandible"}}`. Names whose label never occurs are kept.
///
/// # Errors
/// [`Error::Input`] when a value is no integer from 0 to 65535, when no voxel is labelled, when a label that occurs has no
/// name or shares one (two bones would move as one), and when there are no names at all; [`Error::Read`] when a file cannot
/// be read.
pub fn read_labels(path: impl AsRef<Path>, names: Option<&Path>) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    let read = if names.is_none() && dicom::is_segmentation(path) {
        let read = all_segments(path)?;
        check(path, &read.value)?;
        read
    } else {
        named(path, names)?
    };
    one_name_each(path, &read.value)?;
    Ok(read)
}

/// Refuses labels as [`read_labels`] does, for those that come from elsewhere than a file; `what` is their name in messages.
///
/// # Errors
/// [`Error::Input`] when no voxel is labelled, or a label that occurs has no name or shares one.
pub fn check_labels(what: &str, map: &LabelMap) -> Result<()> {
    check(Path::new(what), map)?;
    one_name_each(Path::new(what), map)
}

/// Refuses two labels of one name.
fn one_name_each(path: &Path, map: &LabelMap) -> Result<()> {
    let twins = twins(map);
    let Some((label, owner)) = twins.first_key_value() else { return Ok(()) };
    let name = map.names.get(label).map_or("", String::as_str);
    let problem = format!("labels {owner} and {label} have the same name, {name}");
    Err(Error::input(path.display().to_string(), problem, "give each label its own name, or merge them"))
}

/// Names of labels of a JSON file, `{"labels": {"1": "skull"}}` or nnU-Net's `{"labels": {"skull": 1}}`.
///
/// # Errors
/// [`Error::Read`] when it is neither; [`Error::Input`] when a label has two names.
pub fn read_label_names(path: impl AsRef<Path>) -> Result<BTreeMap<u16, String>> {
    read_names(path.as_ref())
}

/// Reads bones on the planning CT's grid: a label map as [`read_labels`], or a DICOM structure set whose structures have names
/// of bones, drawn on `grid`, or a DICOM segmentation on its voxels; then `names` is a TOML file of further names
/// ([`BoneNames::read`]), of a segmentation also a JSON file as [`read_labels`] takes it.
///
/// # Errors
/// As [`read_labels`], or as [`read_structure_set`] and [`labels_from_structures`]; [`Error::Input`] when a segmentation has no
/// bone, or other voxels than `grid`.
pub fn read_bones(path: impl AsRef<Path>, names: Option<&Path>, grid: &Grid) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    if !dicom::is_place(path) {
        return read_labels(path, names);
    }
    if dicom::is_segmentation(path) {
        let read = match names.filter(|names| is_json(names)) {
            Some(names) => on_grid(read_labels(path, Some(names))?, grid)?,
            None => bone_segments(path, &names.map(BoneNames::read).transpose()?.unwrap_or_default(), grid)?,
        };
        check(path, &read.value)?;
        return Ok(read);
    }
    let names = names.map(BoneNames::read).transpose()?.unwrap_or_default();
    from_structures(path, grid, |set| {
        let drawn = labels_from_structures(set, grid, &names)?;
        Ok((drawn.map, drawn.warnings))
    })
}

/// Reads a label map as [`read_label_map`]; a DICOM segmentation on the voxels of `grid`, bones by TotalSegmentator's names.
///
/// # Errors
/// As [`read_label_map`]; [`Error::Input`] when a segmentation has other voxels.
pub fn read_label_map_on(path: impl AsRef<Path>, grid: &Grid) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    if dicom::is_segmentation(path) { on_grid(all_segments(path)?, grid) } else { read_label_map(path, None) }
}

fn on_grid(read: Loaded<LabelMap>, grid: &Grid) -> Result<Loaded<LabelMap>> {
    let value = dicom::on_grid(&read.path, &read.value, grid)?;
    Ok(Loaded { value, ..read })
}

/// Labels that are drawn on `grid` from a DICOM structure set, with what reading it found.
fn from_structures(
    path: &Path,
    grid: &Grid,
    draw: impl Fn(&StructureSet) -> Result<(LabelMap, Vec<Warning>)>,
) -> Result<Loaded<LabelMap>> {
    let mut set = read_structure_set(path)?;
    // What is drawn twice would be empty.
    let tidied = set.contours.tidy();
    let (value, warnings) = draw(&set)?;
    let warnings = [set.warnings, tidied, warnings].concat();
    let header = dicom::structure_notes(grid, &set.label);
    Ok(Loaded { value, path: set.path, sha256: set.sha256, header, warnings })
}

/// Reads organs: a label map or a mask, or of a DICOM structure set or segmentation those of the names `wanted`, on `grid`.
///
/// # Errors
/// As [`read_label_map`] and [`organs_from_structures`]; [`Error::Input`] when a segmentation has none of them, or other voxels.
pub fn read_organs(path: impl AsRef<Path>, wanted: &[String], grid: &Grid) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    if !dicom::is_place(path) {
        return read_label_map(path, None);
    }
    if dicom::is_segmentation(path) {
        return organ_segments(path, wanted, grid);
    }
    from_structures(path, grid, |set| Ok((organs_from_structures(set, grid, wanted)?, Vec::new())))
}

/// Labels that occur and have the name of a lesser one, with that one.
fn twins(map: &LabelMap) -> BTreeMap<u16, u16> {
    let mut owners: BTreeMap<&str, u16> = BTreeMap::new();
    let mut twins = BTreeMap::new();
    for label in map.counts().into_keys() {
        let Some(name) = map.names.get(&label) else { continue };
        let owner = *owners.entry(name).or_insert(label);
        if owner != label {
            twins.insert(label, owner);
        }
    }
    twins
}

/// Reads a label map of which every label that occurs has a name.
fn named(path: &Path, names: Option<&Path>) -> Result<Loaded<LabelMap>> {
    let given = names.map(read_names).transpose()?;
    load(path, |raster| {
        raster.require_scalar(path, "label map")?;
        let volume = label_values(path, raster)?;
        let names = match given {
            Some(given) => given,
            None => header_names(path, raster)?.ok_or_else(|| no_names(path))?,
        };
        let map = LabelMap { volume, names };
        check(path, &map)?;
        Ok(map)
    })
}

/// Reads a label map whose labels need no names: from the JSON file `names` where given, else from the header, else none.
///
/// # Errors
/// As [`read_labels`], except for labels without a name.
pub fn read_label_map(path: impl AsRef<Path>, names: Option<&Path>) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    let given = names.map(read_names).transpose()?;
    load(path, |raster| {
        raster.require_scalar(path, "label map")?;
        let volume = label_values(path, raster)?;
        let names = match given {
            Some(given) => given,
            None => header_names(path, raster)?.unwrap_or_default(),
        };
        Ok(LabelMap { volume, names })
    })
}

/// Reads structures: a label map in which a name may have several numbers and still is one structure. Names come from the
/// header where it names every label that occurs, else from the JSON file `names`.
///
/// # Errors
/// As [`read_labels`], except for labels that share a name.
pub fn read_structures(path: impl AsRef<Path>, names: Option<&Path>) -> Result<Loaded<LabelMap>> {
    let path = path.as_ref();
    let given = names.map(read_names).transpose()?;
    load(path, |raster| {
        raster.require_scalar(path, "label map")?;
        let mut map = LabelMap { volume: label_values(path, raster)?, names: Names::new() };
        let counts = map.counts();
        let complete = |names: &Names| counts.keys().all(|l| names.contains_key(l));
        map.names = match (header_names(path, raster)?, given) {
            (Some(own), given) if given.is_none() || complete(&own) => own,
            (_, Some(given)) => given,
            _ => return Err(no_names(path)),
        };
        let merged = map.one_number_a_name();
        check(path, &map)?;
        if !merged.is_empty() {
            let message =
                format!("{}: several labels are one structure by their name: {}", path.display(), merged.join(", "));
            raster.warnings.push(Warning::new(findings::LABELS_JOINED, message));
        }
        Ok(map)
    })
}

/// A JSON file with names of labels beside a label map, where there is one: of several the one of the same name, else the first.
pub fn names_beside(path: &Path) -> Option<String> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = |file: &Path| {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.split('.').next().unwrap_or_default().to_owned()
    };
    let small = |file: &Path| file.metadata().is_ok_and(|about| about.is_file() && about.len() < MOST_OF_NAMES);
    let named = |file: &Path| is_json(file) && small(file) && read_names(file).is_ok_and(|names| !names.is_empty());
    let files = std::fs::read_dir(folder).ok()?.flatten().map(|entry| path.with_file_name(entry.file_name()));
    let found = files.filter(|file| named(file)).min_by_key(|file| (stem(file) != stem(path), file.clone()))?;
    Some(found.display().to_string())
}

/// No file of names of labels is as long as this, bytes.
const MOST_OF_NAMES: u64 = 1 << 20;

fn no_names(path: &Path) -> Error {
    let remedy = match names_beside(path) {
        Some(names) => format!("{names} lies beside it: give --labels {names}"),
        None => "give a JSON file with --labels: {\"labels\": {\"1\": \"skull\", \"2\": \"vertebrae_C1\"}}, with TotalSegmentator's \
                 names; or use a label map that TotalSegmentator wrote with --ml, which has them in its header"
            .to_owned(),
    };
    Error::input(path.display().to_string(), "its header holds no names of its labels", remedy)
}

/// The values as labels.
fn label_values(path: &Path, raster: &Raster<'_>) -> Result<Volume<u16>> {
    let voxels = raster.voxels(path)?;
    let odd = Odd::default();
    let near = if raster.notes.scaling.is_some() { SCALED_TOLERANCE } else { 0.0 };
    let whole = |v: f64| if (v - v.round()).abs() <= near { v.round() } else { v };
    let labels = voxels.decode(|v| {
        let v = whole(v);
        odd.note(!is_label(v));
        v as u16
    });
    if odd.count() == 0 {
        return Volume::new(raster.grid.clone(), labels);
    }
    let all = voxels.decode(whole);
    let first = all.iter().position(|v| !is_label(*v)).unwrap_or_default();
    let problem = format!(
        "{} voxels hold no label: value {} at voxel {:?} is no integer from 0 to 65535",
        odd.count(),
        all[first],
        raster.grid.voxel(first)
    );
    let remedy = if all.iter().any(|v| *v < LIKE_AIR) {
        "this looks like a CT: give the label map here, and check whether two files are swapped"
    } else {
        "give a label map, resampled with nearest neighbour if at all"
    };
    Err(Error::input(path.display().to_string(), problem, remedy))
}

/// A value of a CT's air, HU, which no label map holds.
const LIKE_AIR: f64 = -500.0;

/// Whether a value is an integer that a label can be.
pub(super) fn is_label(value: f64) -> bool {
    (0.0..=f64::from(u16::MAX)).contains(&value) && value.fract() == 0.0
}

/// Refuses maps without labels and labels without a name.
fn check(path: &Path, map: &LabelMap) -> Result<()> {
    let what = path.display().to_string();
    let counts = map.counts();
    if counts.is_empty() {
        return Err(Error::input(
            what,
            "no voxel is labelled: all are 0",
            "give the label map of the planning CT's bones",
        ));
    }
    let nameless: Vec<u16> = counts.keys().copied().filter(|l| !map.names.contains_key(l)).collect();
    if !nameless.is_empty() {
        let problem = format!("labels without a name: {}", list(&nameless));
        return Err(Error::input(
            what,
            problem,
            "name every label that occurs, in the header's table or the JSON file",
        ));
    }
    Ok(())
}

/// The first of many numbers as text.
fn list(labels: &[u16]) -> String {
    let shown = labels.iter().take(20).map(u16::to_string).collect::<Vec<_>>().join(", ");
    if labels.len() > 20 { format!("{shown} and {} more", labels.len() - 20) } else { shown }
}

/// Writes a label map as uint8, or uint16 where a label needs it; NIfTI files carry the names in TotalSegmentator's
/// header extension. The extension of `path` chooses the format.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, [`Error::Usage`] when its extension is unknown.
pub fn write_labels(path: impl AsRef<Path>, map: &LabelMap, options: &WriteOptions) -> Result<()> {
    let labels = map.volume.data();
    let values = if small(labels) { Values::Bytes(labels) } else { Values::Words(labels) };
    written(path.as_ref(), map.volume.grid(), values, &map.names, options)
}

/// As [`write_labels`], of labels that are held in spans.
///
/// # Errors
/// As [`write_labels`].
pub fn write_label_spans(path: impl AsRef<Path>, map: &LabelSpans, options: &WriteOptions) -> Result<()> {
    let labels = &map.volume;
    let values = if small(labels.held()) { Values::ByteSpans(labels) } else { Values::WordSpans(labels) };
    written(path.as_ref(), labels.grid(), values, &map.names, options)
}

/// Whether a byte holds each label.
fn small(labels: &[u16]) -> bool {
    labels.iter().all(|&l| l <= u16::from(u8::MAX))
}

fn written(
    path: &Path,
    grid: &Grid,
    values: Values<'_>,
    names: &BTreeMap<u16, String>,
    options: &WriteOptions,
) -> Result<()> {
    let extension = (!names.is_empty()).then(|| table(names));
    let description = &options.description;
    write(path, &Contents { grid, values, meaning: Meaning::Labels, description, extension }, options.gzip_level)
}

/// A CaretExtension with the label table, as TotalSegmentator writes it.
fn table(names: &BTreeMap<u16, String>) -> String {
    let mut xml = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?> <CaretExtension> <VolumeInformation Index=\"0\"> <LabelTable>\n",
    );
    for (label, name) in names {
        // Successive golden angles of hue keep neighbours apart.
        let hue = (f64::from(*label) * 0.618_033_988_75).fract() * 6.0;
        let channel = |shift: f64| (((hue + shift) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        let [red, green, blue] = [channel(0.0), channel(4.0), channel(2.0)];
        writeln!(
            xml,
            "<Label Key=\"{label}\" Red=\"{red:.3}\" Green=\"{green:.3}\" Blue=\"{blue:.3}\" Alpha=\"1\">{}</Label>",
            escape(name.as_str())
        )
        .expect("writing to a String cannot fail");
    }
    xml.push_str("</LabelTable> <StudyMetaDataLinkSet> </StudyMetaDataLinkSet> <VolumeType>Label</VolumeType> </VolumeInformation></CaretExtension>");
    xml
}
