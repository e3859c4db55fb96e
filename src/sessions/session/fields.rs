//! The one gate through which every verb takes a field: its direction must not contradict its role.
//!
//! aventail's own fields tell their direction in the header. Another tool's field does not; of it is known on which image's
//! grid it lies, and a field belongs on a grid of the frame that it starts from. A Deformable Spatial Registration names the
//! frames of reference that it joins, which scans in DICOM confirm or contradict.

use super::frames::{FieldRole, NamedFrame, Uids, confirmed, uid_of};
use super::source::Source;
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::evaluate::verdict::{Verdict, of_warnings};
use crate::evaluate::{Direction, FieldPair};
use crate::field::Chain;
use crate::findings;
use crate::geometry::Grid;
use crate::io::{self, FieldFile, FieldFrames, dicom};
use crate::provenance::Provenance;
use crate::report::{OutputFile, Report};
use crate::volume::Volume;
use crate::warning::Warning;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::path::Path;

/// Corners of equal grids agree within this, mm.
const SAME_MM: f64 = 0.05;
/// Boxes of a coarser field agree within this share of its largest voxel.
const SAME_BOX: f64 = 0.75;

/// The role of a field of one case: by the option of its direction, or by another option and `--direction`.
pub fn role(direction: Direction, option: Option<InputRole>) -> FieldRole<'static> {
    let (from, to, own, remedy) = match (direction, option) {
        (Direction::PlanningToFraction, None) => {
            ("planning", "fraction", InputRole::PlanningToFraction, "give it as --fraction-to-planning")
        }
        (Direction::FractionToPlanning, None) => {
            ("fraction", "planning", InputRole::FractionToPlanning, "give it as --planning-to-fraction")
        }
        (Direction::PlanningToFraction, Some(o)) => {
            ("planning", "fraction", o, "give --direction fraction-to-planning, or the field of the other direction")
        }
        (Direction::FractionToPlanning, Some(o)) => {
            ("fraction", "planning", o, "give --direction planning-to-fraction, or the field of the other direction")
        }
    };
    FieldRole { given: own, from, to, remedy }
}

/// A grid that is known in a frame.
pub struct Known<'a> {
    /// The frame.
    pub frame: &'a str,
    /// File or thing, for messages.
    pub name: String,
    /// Where it was read, which tells its frame of reference where it is DICOM.
    pub place: Option<dicom::Framed<'a>>,
    /// Its grid.
    pub grid: &'a Grid,
}

/// A field from its file, with the frames that its header tells, and the frames of reference of a registration.
pub fn open(path: &Path) -> Result<(FieldFile, Option<FieldFrames>, Option<Uids>)> {
    let (field, uids) = io::read_field_between(path)?;
    let own = io::frames_of(&field.header.description);
    Ok((field, own, uids))
}

/// Whether a header contradicts what is said of a field: names may differ, but none may stand at the other end.
pub fn contradicts(from: &str, to: &str, own: &FieldFrames) -> bool {
    from == own.to || to == own.from
}

/// Reads the field of a role and judges it by its header, or by the grids that are known.
///
/// # Errors
/// [`Error::Input`] when its header tells the other direction, or it is a registration of other frames of reference; else as
/// [`io::read_field`].
pub fn take(
    path: &Path,
    role: &FieldRole<'_>,
    known: &[Known<'_>],
    provenance: &mut Provenance,
) -> Result<Volume<[f32; 3]>> {
    let (field, own, uids) = open(path)?;
    let file = path.display().to_string();
    let FieldRole { given, from, to, .. } = role;
    let sure = match &uids {
        Some(uids) => confirmed(&file, uids, role, with_uids(known)?)?,
        None => false,
    };
    // A field onward from the fraction comes of a run of its own, in which the fraction was one of the two images.
    let onward = *given == InputRole::Then && own.as_ref().is_some_and(|own| of_a_run(&own.from) && of_a_run(&own.to));
    match &own {
        Some(own) if !onward && contradicts(from, to, own) => {
            let problem = format!(
                "its header says that it takes {} points to {}, but --{given} takes {from} points to {to}",
                own.from, own.to
            );
            return Err(Error::refused(findings::FIELD_DIRECTION, file, problem, role.remedy));
        }
        Some(own) if !onward && own.from != *from && own.to != *to => {
            let message = format!(
                "{file}: its header says that it takes {} points to {}; it is used as a field from {from} to {to}",
                own.from, own.to
            );
            provenance.warnings.push(Warning::new(findings::FIELD_DIRECTION, message));
        }
        Some(_) if !onward => {}
        _ if sure => {}
        _ => provenance.warnings.extend(doubt(&file, from, to, field.value.grid(), known)),
    }
    Ok(provenance.take(*given, field))
}

/// The frames of reference of what is DICOM.
fn with_uids(known: &[Known<'_>]) -> Result<Vec<NamedFrame>> {
    let mut all = Vec::new();
    for k in known {
        all.extend(uid_of(k.place)?.map(|uid| NamedFrame { name: k.frame.to_owned(), uid, what: k.name.clone() }));
    }
    Ok(all)
}

/// Whether a name is that of an image in one of aventail's runs.
fn of_a_run(name: &str) -> bool {
    name == "planning" || name == "fraction"
}

/// How a field's grid fits an image's.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Fit {
    /// Voxel by voxel.
    Same,
    /// The same box, other voxels.
    Box,
    /// Neither.
    Apart,
}

fn fit(field: &Grid, image: &Grid) -> Fit {
    if field.matches(image, SAME_MM) {
        return Fit::Same;
    }
    let hull = |g: &Grid| {
        let half = |c: usize| {
            let size = g.size();
            Vector3::from_fn(|a, _| if c >> a & 1 == 1 { size[a] as f64 - 0.5 } else { -0.5 })
        };
        let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
        (0..8).map(|c| g.world(&half(c)).coords).fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)])
    };
    let ([a, b], [c, d]) = (hull(field), hull(image));
    let off = (a - c).amax().max((b - d).amax());
    if off <= SAME_BOX * field.spacing().into_iter().fold(0.0, f64::max) { Fit::Box } else { Fit::Apart }
}

/// A word about a field without a direction that lies on the grid of another frame than the one that it should start from.
pub fn doubt(file: &str, from: &str, to: &str, field: &Grid, known: &[Known<'_>]) -> Option<Warning> {
    let best = |own: bool| {
        let all = known.iter().filter(|k| (k.frame == from) == own);
        all.map(|k| (fit(field, k.grid), k)).min_by_key(|(fit, _)| *fit)
    };
    let ((own, own_image), (other, image)) = (best(true)?, best(false)?);
    (other < own).then(|| {
        let message = format!(
            "{file}: it does not tell its direction; a field from {from} to {to} lies on a grid of {from}, but it lies on that of \
             {} ({}) and not on that of {} ({from}): check that it does not point the other way",
            image.name, image.frame, own_image.name
        );
        Warning::new(findings::FIELD_DIRECTION, message)
    })
}

/// A displacement field that is given, or none.
pub type Given = Option<Source<Volume<[f32; 3]>>>;

/// A field that is given by its file.
pub fn file(path: Option<&Path>) -> Given {
    path.map(|path| Source::File(path.to_owned()))
}

/// What the run that wrote a field has warned of, as verdicts: the report beside the file, where it lists this very file.
/// So that a field which its own run asks a person to look at does not pass when it is measured again.
pub fn doubts_of_its_run(field: &Path, provenance: &Provenance) -> Vec<Verdict> {
    let own = provenance.inputs.iter().find(|input| input.path == field);
    let (Some(own), Some(folder), Some(name)) = (own, field.parent(), field.file_name()) else { return Vec::new() };
    let Ok(report) = Report::read(&folder.join("report.json"), "") else { return Vec::new() };
    let listed = |output: &OutputFile| *output.name == *name && output.sha256 == own.sha256;
    if !report.outputs.iter().any(listed) {
        return Vec::new();
    }
    let told =
        |verdict: Verdict| Verdict { reason: format!("told by the run that wrote it: {}", verdict.reason), ..verdict };
    of_warnings(&report.warnings).into_iter().map(told).collect()
}

/// The given direction or directions of a case's field, and the missing one, made on the grid of its frame. `option`: the
/// option that names a single field, else that of its direction.
///
/// # Errors
/// As [`take`]; [`Error::Usage`] when neither direction is given.
pub fn pair(
    [push, pull]: [Given; 2],
    option: Option<InputRole>,
    [planning, fraction]: [Option<&Grid>; 2],
    known: &[Known<'_>],
    provenance: &mut Provenance,
) -> Result<FieldPair> {
    let mut field = |direction, given: Given| match given {
        None => Ok(None),
        Some(Source::Memory(field)) => Ok(Some(field)),
        Some(Source::File(path)) => take(&path, &role(direction, option), known, provenance).map(Some),
    };
    let (push, pull) = (field(Direction::PlanningToFraction, push)?, field(Direction::FractionToPlanning, pull)?);
    FieldPair::new(push, pull, planning, fraction)?
        .ok_or_else(|| Error::usage("no field is given", "give planning_to_fraction or fraction_to_planning, or both"))
}

/// Share of what the voxels of a grid weigh that a chain from there does not cover with all its fields, percent.
pub fn missed(chain: &Chain<'_>, grid: &Grid, weight: impl Fn(usize) -> f64 + Sync) -> f64 {
    let slice = grid.strides()[2];
    let planes: Vec<[f64; 2]> = (0..grid.size()[2])
        .into_par_iter()
        .map(|k| {
            let mut sums = [0.0; 2];
            for (l, w) in (k * slice..(k + 1) * slice).map(|l| (l, weight(l))).filter(|(_, w)| *w > 0.0) {
                let covered = chain.map(&grid.centre(grid.voxel(l))).covered;
                sums = [sums[0] + w, sums[1] + if covered { 0.0 } else { w }];
            }
            sums
        })
        .collect();
    let [all, lost] = planes.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    if all > 0.0 { 100.0 * lost / all } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known<'a>(planning: &'a Grid, fraction: &'a Grid) -> [Known<'a>; 2] {
        [("planning", planning), ("fraction", fraction)].map(|(frame, grid)| Known {
            frame,
            name: format!("{frame}.nii"),
            place: None,
            grid,
        })
    }

    #[test]
    fn a_field_on_the_other_images_grid_is_doubted() {
        let grid = |n: usize, spacing: f64, x: f64| Grid::axis_aligned([n; 3], [spacing; 3], [x, 0.0, 0.0]).unwrap();
        let (planning, fraction, near) = (grid(40, 2.0, 0.0), grid(40, 2.0, 30.0), grid(40, 2.0, 1.0));
        let asked = |field: &Grid, planning: &Grid, fraction: &Grid| {
            doubt("f.mha", "planning", "fraction", field, &known(planning, fraction)).is_some()
        };
        assert!(asked(&fraction, &planning, &fraction) && !asked(&planning, &planning, &fraction));
        // A coarser field over the fraction; one image grid for both; a grid next to it; a field on neither.
        assert!(asked(&grid(20, 4.0, 31.0), &planning, &fraction) && !asked(&grid(20, 4.0, 1.0), &planning, &fraction));
        assert!(!asked(&planning, &planning, &planning) && asked(&near, &planning, &near));
        assert!(!asked(&grid(7, 5.0, 9.0), &planning, &fraction));
        assert!(doubt("f.mha", "planning", "fraction", &fraction, &known(&planning, &fraction)[1..]).is_none());
    }
}
