//! What a folder of DICOM holds, for people and machines: series and objects, their geometry, what
//! refers to what.

use super::counts::lost_of;
use super::elements::text;
use super::find::{Catalogue, Group, Object, day, find};
use super::registration::{describe_deformable, read_rigid, registered_frames};
use super::scan::Scan;
use super::series::Patient;
use super::{ct, dose, segmentation, structures};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::warning::counted;
use dicom_dictionary_std::{tags, uids};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// One series of images, or one object of another kind.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// Its place in the list, from 1.
    pub entry: usize,
    /// The patient; empty where it is to be hidden.
    pub patient: Patient,
    /// Study date, `YYYYMMDD`.
    pub study_date: String,
    /// Study Instance UID.
    pub study: String,
    /// Series Number.
    pub number: Option<i32>,
    /// Series Instance UID.
    pub series: String,
    /// `CT`, `RTSTRUCT`, ...
    pub modality: String,
    /// Series Description, or label of a structure set.
    pub description: String,
    /// `YYYYMMDD`.
    pub date: String,
    /// Objects: slices of a series of single-slice images.
    pub objects: usize,
    /// What it holds, in words.
    pub content: String,
    /// The grid of a CT or MR series, or of a dose.
    pub grid: Option<Grid>,
    /// Frame of reference: entries of one letter can be compared; empty where none is told.
    pub frame: String,
    /// Frame of Reference UID.
    pub frame_of_reference: String,
    /// Entries that it refers to.
    pub refers_to: Vec<usize>,
    /// The file of a single object.
    #[serde(serialize_with = "path_or_none")]
    pub path: Option<PathBuf>,
    /// What is worth knowing, and no fault.
    pub notes: Vec<String>,
    /// Why it cannot be read, or what is odd about it.
    pub problems: Vec<String>,
}

fn path_or_none<S: serde::Serializer>(path: &Option<PathBuf>, serializer: S) -> Result<S::Ok, S::Error> {
    match path {
        Some(path) => serializer.serialize_some(&path.to_string_lossy()),
        None => serializer.serialize_none(),
    }
}

/// What a folder or file of DICOM holds. `Display` renders it for people.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The folder or file.
    #[serde(serialize_with = "super::super::path_as_text")]
    pub path: PathBuf,
    /// Its series and objects, by patient, study and modality.
    pub entries: Vec<Entry>,
    /// Files that are not DICOM.
    pub other_files: usize,
    /// DICOM files that cannot be parsed, and why.
    pub damaged: Vec<String>,
    /// Whether names of patients are hidden.
    pub anonymous: bool,
}

/// Describes a folder or file of DICOM; with `anonymous` the patient's name, number and date of
/// birth are left out.
///
/// # Errors
/// [`Error::Read`] when it cannot be read or holds no DICOM.
pub fn summary(path: impl AsRef<Path>, anonymous: bool) -> Result<Summary> {
    let path = path.as_ref();
    summary_without(path, anonymous, &BTreeSet::new())?
        .ok_or_else(|| Error::read(path, "it holds no DICOM", "name a folder with DICOM files"))
}

/// As [`summary`], without the files `own`; `None` where no other DICOM is there.
///
/// # Errors
/// [`Error::Read`] when it cannot be read.
pub fn summary_without(path: &Path, anonymous: bool, own: &BTreeSet<PathBuf>) -> Result<Option<Summary>> {
    let mut found = find(&[path])?;
    found.objects.retain(|o| !own.contains(&o.path));
    found.others.retain(|o| !own.contains(o));
    found.damaged.retain(|d| !own.contains(&d.path));
    if found.objects.is_empty() && found.damaged.is_empty() {
        return Ok(None);
    }
    let units = units(&found);
    let frames = letters(&units);
    let entries = units.iter().enumerate().map(|(n, unit)| entry(n, unit, &units, &frames, anonymous)).collect();
    let damaged = found.damaged.iter().map(|d| format!("{}: {}", d.path.display(), d.why)).collect();
    Ok(Some(Summary { path: path.into(), entries, other_files: found.others.len(), damaged, anonymous }))
}

/// Series of images whole, objects of other kinds one by one.
fn units(found: &Catalogue) -> Vec<Group<'_>> {
    found.groups().into_iter().flat_map(split).collect()
}

fn split(group: Group<'_>) -> Vec<Group<'_>> {
    if matches!(group.series.modality.as_str(), "CT" | "MR" | "PT") {
        return vec![group];
    }
    group.objects.into_iter().map(|o| Group { series: &o.series, objects: vec![o] }).collect()
}

/// A letter for each frame of reference, in the order of the list.
fn letters(units: &[Group<'_>]) -> BTreeMap<String, String> {
    let mut letters = BTreeMap::new();
    let own = units.iter().map(|g| g.series.frame_of_reference.clone());
    // A registration may join frames of what is not here.
    let joined = units.iter().flat_map(|g| &g.objects).flat_map(|o| registered_frames(&o.header));
    for frame in own.chain(joined).filter(|f| !f.is_empty()) {
        let n = letters.len();
        letters.entry(frame).or_insert_with(|| {
            let letter = char::from(b'A' + (n % 26) as u8);
            if n < 26 { letter.to_string() } else { format!("{letter}{}", n / 26) }
        });
    }
    letters
}

fn entry(
    n: usize,
    unit: &Group<'_>,
    units: &[Group<'_>],
    letters: &BTreeMap<String, String>,
    anonymous: bool,
) -> Entry {
    let s = unit.series;
    let refers: BTreeSet<&String> = unit.objects.iter().flat_map(|o| &o.refers_to).collect();
    let meant = |g: &Group<'_>| refers.contains(&g.series.uid) || g.objects.iter().any(|o| refers.contains(&o.uid));
    let targets: Vec<usize> = (0..units.len()).filter(|&m| m != n && meant(&units[m])).collect();
    let (mut problems, mut notes) = (Vec::new(), Vec::new());
    let is_image = matches!(s.modality.as_str(), "CT" | "MR");
    // A registration joins two frames of reference.
    for m in targets.iter().filter(|_| s.modality != "REG") {
        let other = &units[*m].series.frame_of_reference;
        if !other.is_empty() && !s.frame_of_reference.is_empty() && *other != s.frame_of_reference {
            match is_image {
                // An image carried by a registration names what it was made of.
                true => notes.push(format!("made of entry {}, of another frame of reference", m + 1)),
                false => problems.push(format!("it refers to entry {} of another frame of reference", m + 1)),
            }
        }
    }
    if is_image {
        let others: Vec<&Object> = units.iter().flat_map(|u| u.objects.iter().copied()).collect();
        problems.extend(lost_of(&unit.objects, &others).into_iter().map(|w| w.message));
    }
    if targets.is_empty() && !refers.is_empty() {
        match s.modality.as_str() {
            "RTSTRUCT" => problems.push("the images that it was drawn on are not here".into()),
            // A dose is whole without its plan.
            "RTDOSE" => notes.push("its plan is not here".into()),
            _ => {}
        }
    }
    let told = content(unit, letters).unwrap_or_else(|error| Told { odd: vec![reason(&error)], ..Told::default() });
    problems.extend(told.odd);
    notes.extend(told.notes);
    let label = || unit.objects.first().map_or(String::new(), |o| text(&o.header, tags::STRUCTURE_SET_LABEL));
    let description = if s.description.is_empty() { label() } else { s.description.clone() };
    Entry {
        entry: n + 1,
        patient: if anonymous { Patient::default() } else { s.patient.clone() },
        study_date: s.study.date.clone(),
        study: s.study.uid.clone(),
        number: s.number,
        series: s.uid.clone(),
        modality: s.modality.clone(),
        description,
        date: s.date.clone(),
        objects: unit.objects.len(),
        content: told.words,
        grid: told.grid,
        frame: letters.get(&s.frame_of_reference).cloned().unwrap_or_default(),
        frame_of_reference: s.frame_of_reference.clone(),
        refers_to: targets.into_iter().map(|m| m + 1).collect(),
        path: if unit.objects.len() == 1 { unit.objects.first().map(|o| o.path.clone()) } else { None },
        notes,
        problems,
    }
}

/// What an entry holds.
#[derive(Default)]
struct Told {
    words: String,
    grid: Option<Grid>,
    notes: Vec<String>,
    /// What is odd about it.
    odd: Vec<String>,
}

impl Told {
    fn on(words: &str, grid: Grid) -> Self {
        Self { words: format!("{words}, {}", geometry(&grid)), grid: Some(grid), ..Self::default() }
    }

    fn plain(words: String) -> Self {
        Self { words, ..Self::default() }
    }
}

/// What an entry holds, its grid, and what is odd about it.
fn content(unit: &Group<'_>, letters: &BTreeMap<String, String>) -> Result<Told> {
    let Some(first) = unit.objects.first() else { return Ok(Told::default()) };
    let images = |one: &str, many: &str| counted(unit.objects.len(), one, many);
    match unit.series.modality.as_str() {
        "CT" | "MR" if Scan::of(unit.objects.iter().copied()).is_some() => {
            let objects: Vec<Object> = unit.objects.iter().copied().cloned().collect();
            let planned = ct::plan(Path::new("series"), objects, Vec::new())?;
            let grid = planned.stack.grid;
            let odd = planned.warnings.into_iter().map(|w| w.message).collect();
            Ok(Told { odd, ..Told::on(&format!("{} slices", grid.size()[2]), grid) })
        }
        "RTDOSE" => {
            let (words, grid) = dose::describe(first)?;
            Ok(Told::on(&words, grid))
        }
        "SEG" => {
            let (words, grid) = segmentation::describe(first)?;
            Ok(Told::on(&words, grid))
        }
        "RTSTRUCT" => Ok(Told::plain(counted(structures::count(&first.header), "structure", "structures"))),
        "REG" => registered(first, letters),
        "MR" | "PT" => Ok(Told::plain(images("slice", "slices"))),
        _ => Ok(Told::plain(images("object", "objects"))),
    }
}

/// What a registration joins, and its matrices where it is rigid.
fn registered(object: &Object, letters: &BTreeMap<String, String>) -> Result<Told> {
    let letter = |uid: &str| letters.get(uid).map_or("none", String::as_str).to_owned();
    let goes =
        |from: &str, to: &str| format!("points of frame {} ({from}) go to frame {} ({to})", letter(from), letter(to));
    if object.sop_class == uids::DEFORMABLE_SPATIAL_REGISTRATION_STORAGE {
        let (from, to, grid) = describe_deformable(object)?;
        let words = format!("deformable registration, frame {} to {}", letter(&from), letter(&to));
        return Ok(Told { notes: vec![goes(&from, &to)], ..Told::on(&words, grid) });
    }
    if object.sop_class != uids::SPATIAL_REGISTRATION_STORAGE {
        return Ok(Told::plain("1 object".into()));
    }
    let (mut words, mut notes) = (Vec::new(), Vec::new());
    for one in read_rigid(&object.path)? {
        words.push(format!("rigid registration, frame {} to {}", letter(&one.from), letter(&one.to)));
        notes.push(format!("{}, LPS mm, by", goes(&one.from, &one.to)));
        let matrix = one.rigid.to_homogeneous();
        let row = |r: usize| [0, 1, 2, 3].map(|c| format!("{:>12.6}", matrix[(r, c)])).concat();
        notes.extend((0..4).map(row));
    }
    Ok(Told { notes, ..Told::plain(words.join("; ")) })
}

/// A day of birth, which many files leave out.
fn born(date: &str) -> String {
    if date.is_empty() { "no date of birth".into() } else { format!("born {}", day(date)) }
}

fn geometry(grid: &Grid) -> String {
    let size = grid.size().map(|n| n.to_string()).join(" x ");
    let spacing = grid.spacing().map(|s| format!("{:.4}", s).trim_end_matches('0').trim_end_matches('.').to_owned());
    format!("{size}, {} mm", spacing.join(" x "))
}

/// The reason of a refusal on one line.
fn reason(error: &Error) -> String {
    match error {
        Error::Input { problem, finding: Some(finding), .. } => format!("{problem} [{}]", finding.code),
        Error::Input { problem, .. } | Error::Read { problem, .. } => problem.clone(),
        other => other.to_string(),
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.path.display())?;
        let (mut patient, mut study) = (None, None);
        for e in &self.entries {
            if patient != Some(&e.patient) {
                let p = &e.patient;
                let or = |text: &str| if text.is_empty() { "none".to_owned() } else { text.to_owned() };
                if self.anonymous {
                    writeln!(f, "  patient hidden")?;
                } else {
                    writeln!(f, "  patient {}, number {}, {}", or(&p.name), or(&p.id), born(&p.birth_date))?;
                }
                (patient, study) = (Some(&e.patient), None);
            }
            if study != Some(&e.study) {
                writeln!(f, "  study of {}", day(&e.study_date))?;
                writeln!(
                    f,
                    "  {:>5}  {:>6}  {:<8}  {:<10}  {:<5}  content",
                    "entry", "series", "modality", "date", "frame"
                )?;
                study = Some(&e.study);
            }
            let number = e.number.map_or("none".into(), |n| n.to_string());
            let frame = if e.frame.is_empty() { "none" } else { &e.frame };
            let (entry, modality, date) = (e.entry, &e.modality, day(&e.date));
            let file = e.path.as_deref().and_then(|p| p.strip_prefix(&self.path).ok());
            let file = file.filter(|p| !p.as_os_str().is_empty());
            let file = file.map_or(String::new(), |p| p.display().to_string());
            let told = [e.content.as_str(), e.description.as_str(), file.as_str()];
            let told = told.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join(", ");
            writeln!(f, "  {entry:>5}  {number:>6}  {modality:<8}  {date:<10}  {frame:<5}  {told}")?;
            if !e.refers_to.is_empty() {
                let to = e.refers_to.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
                writeln!(f, "  {:>5}  refers to entry {to}", "")?;
            }
            for note in &e.notes {
                writeln!(f, "  {:>5}  note: {note}", "")?;
            }
            for problem in &e.problems {
                writeln!(f, "  {:>5}  problem: {problem}", "")?;
            }
        }
        let frames: BTreeSet<&String> = self.entries.iter().map(|e| &e.frame).filter(|f| !f.is_empty()).collect();
        if frames.len() > 1 {
            writeln!(f, "  {} frames of reference: positions can be compared within one letter only", frames.len())?;
        }
        for modality in ["CT", "MR"] {
            let of = |e: &&Entry| e.modality == modality && e.number.is_some();
            let series: Vec<&Entry> = self.entries.iter().filter(of).collect();
            let [_, second, ..] = series.as_slice() else { continue };
            let path = self.path.display();
            // A number names a series as long as no other has it.
            match second.number {
                Some(number) if series.iter().filter(|e| e.number == second.number).count() == 1 => writeln!(
                    f,
                    "  several {modality} series: {path}#{number} means the one whose number in the column `series` is {number}"
                )?,
                _ => writeln!(
                    f,
                    "  several {modality} series of one number: {path}#{} means that of entry {}",
                    second.series, second.entry
                )?,
            }
        }
        if self.other_files > 0 {
            writeln!(f, "  {}", counted(self.other_files, "other file", "other files"))?;
        }
        for damaged in &self.damaged {
            writeln!(f, "  damaged: {damaged}")?;
        }
        Ok(())
    }
}
