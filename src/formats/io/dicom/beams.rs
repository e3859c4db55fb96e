//! Doses of single beams of one plan as one dose: nothing is counted twice, and nothing is joined that does not belong
//! together.

use super::super::Loaded;
use super::ct::sum;
use super::series::Series;
use crate::error::{Error, Result};
use crate::findings;
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::Path;

/// Grids of doses that are summed agree within this, mm.
const SAME_GRID_MM: f64 = 0.01;

/// A dose with what it is the dose of.
#[derive(Debug, Clone)]
pub struct Dose {
    /// Gy; axes are columns, rows and planes, right-handed.
    pub volume: Volume<f32>,
    /// What the object says of itself; one slice for each plane.
    pub series: Series,
    /// SOP Instance UID of the object.
    pub uid: String,
    /// Dose Summation Type: `PLAN`, `BEAM`, `FRACTION`, `MULTI_PLAN`, ...
    pub summation: String,
    /// Dose Type: `PHYSICAL` or `EFFECTIVE`.
    pub kind: String,
    /// SOP Instance UIDs of the plans that it refers to.
    pub plans: BTreeSet<String>,
    /// Numbers of the beams that it refers to, behind those of their fraction groups.
    pub beams: BTreeSet<[i64; 2]>,
    /// What computed it: maker, model, versions, and whether tissue was taken into account.
    pub computed: String,
    /// Spatial Transform of Dose: `RIGID` or `NON_RIGID` where a registration has carried it.
    pub transform: String,
    /// Whether it is the sum of doses of beams, which may not be all of the plan's.
    pub of_beams: bool,
}

impl Dose {
    /// Whether it says that a registration has carried it.
    pub fn is_carried(&self) -> bool {
        matches!(self.transform.as_str(), "RIGID" | "NON_RIGID")
    }

    /// Whether it says that it is the dose of a whole plan, or of several; a sum of beams does not say it.
    pub fn is_of_whole_plan(&self) -> bool {
        matches!(self.summation.as_str(), "PLAN" | "MULTI_PLAN" | "PLAN_OVERVIEW") && !self.of_beams
    }
}

/// The sum of doses; one alone as it is.
///
/// # Errors
/// [`Error::Input`] when several are not the beams of one plan, computed at once, on one grid.
pub(super) fn summed(path: &Path, mut read: Vec<Loaded<Dose>>) -> Result<Loaded<Dose>> {
    let copies = without_copies(path, &mut read)?;
    if read.len() > 1
        && let Some(problem) = misfit(&read)
    {
        return Err(refusal(path, &read, &problem));
    }
    let count = read.len();
    let sums: Vec<String> = read.iter().map(|d| d.sha256.clone()).collect();
    let beams = read.iter().flat_map(|d| d.value.beams.iter().copied()).collect();
    let mut rest = read.into_iter();
    let Some(mut whole) = rest.next() else { return Err(Error::Internal("no dose".into())) };
    whole.warnings.extend(copies);
    if count == 1 {
        return Ok(whole);
    }
    for other in rest {
        let add = whole.value.volume.data_mut().par_iter_mut().zip(other.value.volume.data());
        add.for_each(|(sum, d)| *sum += *d);
    }
    let message = format!(
        "{}: the doses of {count} beams are summed; whether the plan has more beams cannot be told from them",
        path.display()
    );
    whole.warnings.retain(|w| !w.is(findings::DOSE_PART));
    whole.warnings.push(Warning::new(findings::DOSE_PART, message));
    whole.value.beams = beams;
    whole.value.summation = "PLAN".into();
    whole.value.of_beams = true;
    whole.path = path.into();
    whole.sha256 = sum(sums);
    Ok(whole)
}

/// Leaves out copies of an object; refuses objects of one UID that differ.
fn without_copies(path: &Path, read: &mut Vec<Loaded<Dose>>) -> Result<Option<Warning>> {
    let mut kept: Vec<Loaded<Dose>> = Vec::with_capacity(read.len());
    let mut copies = Vec::new();
    for dose in read.drain(..) {
        let own = |k: &&Loaded<Dose>| !k.value.uid.is_empty() && k.value.uid == dose.value.uid;
        match kept.iter().find(own) {
            Some(first) if first.value.volume == dose.value.volume => copies.push(dose.path.clone()),
            Some(first) => {
                let problem = format!(
                    "{} and {} have one SOP Instance UID ({}) and differ",
                    first.path.display(),
                    dose.path.display(),
                    dose.value.uid
                );
                let remedy = "export the doses again, or give the file of the one that is meant";
                return Err(Error::refused(findings::DOSE_SUM, path.display().to_string(), problem, remedy));
            }
            None => kept.push(dose),
        }
    }
    *read = kept;
    Ok(copies.first().map(|first| {
        let message = format!(
            "{}: {} doses are there twice, the first {}; each is counted once",
            path.display(),
            copies.len(),
            first.display()
        );
        Warning::new(findings::DICOM_DUPLICATES, message)
    }))
}

/// Why doses are not the beams of one plan.
fn misfit(read: &[Loaded<Dose>]) -> Option<String> {
    let first = &read.first()?.value;
    let any = |odd: &dyn Fn(&Dose) -> bool| read.iter().any(|d| odd(&d.value));
    if any(&|d| d.summation != "BEAM") {
        return Some(format!("it holds {} doses that are not all doses of single beams", read.len()));
    }
    if any(&|d| d.plans.len() != 1 || d.plans != first.plans) {
        return Some("its doses of single beams do not refer to one plan".into());
    }
    if any(&|d| d.kind != first.kind) {
        return Some("its doses of single beams are not all of one type".into());
    }
    if any(&|d| d.series.patient.id != first.series.patient.id || d.series.patient.name != first.series.patient.name) {
        return Some("its doses of single beams are of several patients".into());
    }
    if any(&|d| d.series.frame_of_reference != first.series.frame_of_reference) {
        return Some("its doses of single beams lie in several frames of reference".into());
    }
    if any(&|d| d.computed != first.computed) {
        return Some("its doses of single beams were not computed by one program in one way".into());
    }
    if any(&|d| d.beams.is_empty()) {
        return Some(
            "doses of single beams do not say of which beam they are, so that one may be counted twice".into(),
        );
    }
    let mut beams = BTreeSet::new();
    if read.iter().flat_map(|d| &d.value.beams).any(|b| !beams.insert(b[1])) {
        return Some("a beam has several doses".into());
    }
    let groups: BTreeSet<i64> = read.iter().flat_map(|d| &d.value.beams).map(|b| b[0]).collect();
    if groups.len() > 1 {
        return Some("its doses of single beams are of several fraction groups".into());
    }
    if any(&|d| !d.volume.grid().matches(first.volume.grid(), SAME_GRID_MM)) {
        return Some("its doses of single beams lie on several grids".into());
    }
    let twin =
        |(n, d): (usize, &Loaded<Dose>)| read[..n].iter().any(|o| o.value.volume.data() == d.value.volume.data());
    let same = read.iter().enumerate().any(twin);
    same.then(|| "two beams have the same dose in every voxel, as of one that was computed twice".into())
}

fn refusal(path: &Path, read: &[Loaded<Dose>], problem: &str) -> Error {
    let one = |d: &Loaded<Dose>| {
        let plan = d.value.plans.first().map_or("no plan named".into(), |plan| format!("plan {plan}"));
        let beams = d.value.beams.iter().map(|b| b[1].to_string()).collect::<Vec<_>>().join(", ");
        let beams = if beams.is_empty() { "no beam named".to_owned() } else { format!("beam {beams}") };
        format!("\n    {}: {}, {plan}, {beams}", d.path.display(), d.value.summation)
    };
    let list: String = read.iter().map(one).collect();
    let remedy = "give the file of the one dose that is meant; doses of single beams are summed if all are of one plan, each of another beam";
    Error::refused(findings::DOSE_SUM, path.display().to_string(), format!("{problem}:{list}"), remedy)
}
