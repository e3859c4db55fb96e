//! What is given as a file or in memory, and how each kind of it is read.

use crate::config::InputRole;
use crate::error::Result;
use crate::evaluate::landmark::Landmark;
use crate::io;
use crate::io::dicom::{Role, check_frames, is_dicom_path};
use crate::provenance::Provenance;
use crate::volume::{LabelMap, Outline, Volume};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Something that is given as a file or in memory.
#[derive(Debug, Clone)]
pub enum Source<T> {
    /// A file, or the folder of a DICOM series.
    File(PathBuf),
    /// The value itself.
    Memory(T),
}

impl<T> Source<T> {
    /// The file's path, where it is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Memory(_) => None,
        }
    }

    /// The value in memory, or what `read` makes of the file, which is noted under its role.
    pub(super) fn value(
        self,
        role: InputRole,
        provenance: &mut Provenance,
        read: impl FnOnce(&Path) -> Result<T>,
    ) -> Result<T> {
        match self {
            Self::Memory(value) => Ok(value),
            Self::File(path) => {
                provenance.note(role, &path)?;
                read(&path)
            }
        }
    }
}

/// Names of labels.
pub type Names = BTreeMap<u16, String>;

/// An image's values.
///
/// # Errors
/// As [`io::read_scan`].
pub fn image(role: InputRole, source: Source<Volume<f32>>, provenance: &mut Provenance) -> Result<Volume<f32>> {
    match source {
        Source::File(path) => Ok(provenance.take_scan(role, io::read_scan(path)?)),
        Source::Memory(volume) => Ok(volume),
    }
}

/// Evaluation landmarks.
///
/// # Errors
/// As [`io::read_landmarks`].
pub fn landmarks(source: Source<Vec<Landmark>>, provenance: &mut Provenance) -> Result<Vec<Landmark>> {
    source.value(InputRole::Landmarks, provenance, |path| io::read_landmarks(path))
}

/// A label map of bones, no name twice; `argument` is what messages call one in memory. Names come from the header where it
/// names every label that occurs, else from `names`.
///
/// # Errors
/// As [`io::read_labels`].
pub fn bones(
    role: InputRole,
    argument: &str,
    labels: Source<Volume<u16>>,
    names: Option<Source<Names>>,
    provenance: &mut Provenance,
) -> Result<LabelMap> {
    match (labels, names) {
        (Source::File(path), Some(Source::Memory(names))) => {
            let volume = provenance.take_scan(role, io::read_label_map(&path, None)?).volume;
            named(&path.display().to_string(), volume, names)
        }
        (Source::File(path), names) => {
            Ok(provenance.take_scan(role, io::read_labels(&path, names.as_ref().and_then(Source::path))?))
        }
        (Source::Memory(volume), names) => named(argument, volume, table(names)?),
    }
}

/// A label map of structures, in which a name may have several numbers and still is one structure; as [`bones`] otherwise.
///
/// # Errors
/// As [`io::read_structures`].
pub fn structures(
    role: InputRole,
    argument: &str,
    labels: Source<Volume<u16>>,
    names: Option<Source<Names>>,
    provenance: &mut Provenance,
) -> Result<LabelMap> {
    let (what, volume, names) = match (labels, names) {
        (Source::File(path), Some(Source::Memory(names))) => {
            let volume = provenance.take(role, io::read_label_map(&path, None)?).volume;
            (path.display().to_string(), volume, names)
        }
        (Source::File(path), names) => {
            let file = names.as_ref().and_then(Source::path);
            return Ok(provenance.take(role, io::read_structures(path, file)?));
        }
        (Source::Memory(volume), names) => (argument.to_owned(), volume, table(names)?),
    };
    let mut map = LabelMap { volume, names };
    map.one_number_a_name();
    io::check_labels(&what, &map)?;
    Ok(map)
}

/// A label map, and the names of its labels where it has none.
pub type LabelSources = (Source<Volume<u16>>, Option<Source<Names>>);

/// What structures that guide are to a run, and what they are called in messages when they are in memory.
pub(super) type GuideRole = (InputRole, Option<InputRole>, &'static str);
/// Those of planning, whose file of names is noted.
pub(super) const OF_PLANNING: GuideRole = (InputRole::Guide, Some(InputRole::GuideLabels), "guide");
/// Those of a fraction.
pub(super) const OF_FRACTION: GuideRole = (InputRole::FractionGuide, None, "fraction_guide");

/// Structures one by one, of a label map, a segmentation, or a structure set that belongs to the scan `on`.
///
/// # Errors
/// As [`io::read_outlines`]; [`crate::error::Error::Input`] when a structure set lies in another frame of reference than its scan.
pub(super) fn outlines(
    (role, named, argument): GuideRole,
    (labels, names): LabelSources,
    on: Option<&Path>,
    provenance: &mut Provenance,
) -> Result<Vec<Outline>> {
    let note = |provenance: &mut Provenance, names: &Option<Source<Names>>| match (named, names) {
        (Some(named), Some(Source::File(names))) => provenance.note(named, names),
        _ => Ok(()),
    };
    match (labels, names) {
        (Source::File(path), names @ (None | Some(Source::File(_)))) => {
            if let Some(on) = on.filter(|_| is_dicom_path(&path)) {
                check_frames(Role::Structures.at(&path), Role::Image.at(on))?;
            }
            let file = names.as_ref().and_then(Source::path);
            let found = provenance.take(role, io::read_outlines(&path, file, on)?);
            note(provenance, &names)?;
            Ok(found)
        }
        (labels, names) => {
            note(provenance, &names)?;
            Ok(Outline::all(&structures(role, argument, labels, names, provenance)?))
        }
    }
}

/// Labels with names, none left out and none twice.
fn named(what: &str, volume: Volume<u16>, names: Names) -> Result<LabelMap> {
    let map = LabelMap { volume, names };
    io::check_labels(what, &map)?;
    Ok(map)
}

/// The table of names.
fn table(names: Option<Source<Names>>) -> Result<Names> {
    match names {
        None => Ok(Names::new()),
        Some(Source::Memory(names)) => Ok(names),
        Some(Source::File(path)) => io::read_label_names(path),
    }
}
