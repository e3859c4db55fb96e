//! Results as DICOM beside a scan: `--dicom-like SERIES`. The series tells patient, study and frame of reference.

use super::Dose;
use super::elements::Item;
use super::image::{describe_series, dose_at};
use super::place::{is_dicom_path, is_segmentation, segmentation};
use super::registration::{DerivedRegistration, reference_of, write_deformable};
use super::scan::Scan;
use super::series::{Patient, Series};
use super::structures::{Roi, StructureSet};
use super::write::{
    CAUTION, DerivedCt, DerivedDose, DerivedSegmentation, DerivedStructures, Origin, no_plan, write_ct, write_dose,
    write_segmentation, write_structures,
};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::io::contours::contour_json;
use crate::volume::contour::{Contours, Structure};
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Values of a volume that are hashed at once.
const PIECE: usize = 1 << 14;

/// What of a dose that was carried is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CarriedDose {
    /// The dose.
    Dose,
    /// Its standard deviation over samples of the registration: Dose Type `ERROR`, which no reader takes for a dose.
    Deviation,
    /// Its percentile over these samples.
    Percentile(u8),
}

impl CarriedDose {
    /// For UIDs, Series Description, Dose Comment (64 characters each), and Series Number.
    fn words(self) -> (String, String, String, i32) {
        let own = |role: &str, description: &str, comment: &str, number| {
            (role.to_owned(), description.to_owned(), comment.to_owned(), number)
        };
        match self {
            Self::Dose => own(
                "dose",
                "Dose carried by registration (aventail, research only)",
                "Carried by registration, not recalculated; research only",
                903,
            ),
            Self::Deviation => own(
                "deviation of dose",
                "Standard deviation of carried dose (aventail, research only)",
                "1 sd over samples of the registration's error; research only",
                910,
            ),
            Self::Percentile(p) => own(
                &format!("percentile {p} of dose"),
                &format!("Percentile {p} of carried dose (aventail, research only)"),
                &format!("Percentile {p} over samples of the registration; no plan's dose"),
                if p < 50 { 911 } else { 912 },
            ),
        }
    }
}

/// Whether a path is that of a DICOM file to be written.
pub fn is_dcm(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("dcm"))
}

/// Refuses an output in DICOM without a scan that it refers to, and the other way round, before anything is read.
///
/// # Errors
/// [`Error::Usage`].
pub fn check(out: &Path, like: Option<&Path>, folder: bool) -> Result<()> {
    let file = out.display();
    match like {
        None if is_dcm(out) => Err(Error::usage(
            format!("{file}: DICOM output needs patient, study and frame of reference, and none is given"),
            "add --dicom-like SERIES, the folder of the DICOM series of the scan that the result lies in",
        )),
        None => Ok(()),
        Some(like) if !is_dicom_path(like) => Err(Error::usage(
            format!("--dicom-like {}: it is no DICOM series", like.display()),
            "give the folder of the DICOM series of the scan that the result lies in",
        )),
        Some(_) if folder && (is_dcm(out) || out.extension().is_some() && !out.is_dir()) => Err(Error::usage(
            format!("{file}: an image is written as a DICOM series, a file for each slice"),
            "give a folder as --out, or leave --dicom-like out",
        )),
        Some(_) if folder && out.read_dir().is_ok_and(|mut files| files.next().is_some()) => Err(Error::usage(
            format!("{file}: it holds files already, and a series must be alone in its folder"),
            "give an empty or a new folder as --out",
        )),
        Some(_) if !folder && !is_dcm(out) => Err(Error::usage(
            format!("{file}: with --dicom-like the result is written as DICOM"),
            "name it *.dcm, or leave --dicom-like out",
        )),
        Some(_) => Ok(()),
    }
}

/// The scan that results refer to.
pub struct Like {
    path: PathBuf,
    series: Series,
    /// Its grid.
    pub grid: Grid,
}

impl Like {
    /// The series of a folder.
    ///
    /// # Errors
    /// [`Error::Input`] when it names no frame of reference; else as for reading a series.
    pub fn read(path: &Path) -> Result<Self> {
        let (series, grid) = describe_series(path)?;
        if series.frame_of_reference.is_empty() {
            let problem = "its images name no frame of reference, which DICOM results must refer to";
            return Err(Error::input(path.display().to_string(), problem, "export the series again with it"));
        }
        Ok(Self { path: path.to_owned(), series, grid })
    }

    /// Refuses a thing of another patient.
    ///
    /// # Errors
    /// [`Error::Input`] with both.
    pub fn same_patient(&self, what: &Path, patient: &Patient) -> Result<()> {
        let [a, b] = [&patient.id, &self.series.patient.id];
        if a == b {
            return Ok(());
        }
        let problem = format!("it is of another patient ({a:?}) than {} ({b:?})", self.path.display());
        Err(Error::input(what.display().to_string(), problem, "give a series of the same patient as --dicom-like"))
    }

    /// UIDs follow from what the object holds: two that differ in anything never share one, and the same result has the same,
    /// however it was computed.
    fn origin(&self, held: String, refers_to: impl IntoIterator<Item = String>) -> Origin {
        let own = [self.series.uid.clone(), held];
        Origin::beside(&self.series, None, own.into_iter().chain(refers_to).collect())
    }

    /// Writes contours in the frame of the scan on its slices. `set` is the structure set that they come from: number and
    /// type of a structure of its name are kept.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when the set is of another patient.
    pub fn structures(&self, out: &Path, contours: &Contours, set: Option<&StructureSet>) -> Result<()> {
        if let Some(set) = set {
            self.same_patient(&set.path, &set.patient)?;
        }
        let rois = rois_of(contours, set);
        let about = DerivedStructures {
            role: "structures",
            description: "Contours carried by registration (aventail)",
            derivation: &format!("Contours carried to this scan by registration. {CAUTION}"),
            number: 902,
            drawn_on: &self.series,
        };
        let drawn = crate::io::checksum::sha256(&contour_json(contours, "")?);
        write_structures(out, contours, &rois, &about, &self.origin(drawn, rois.iter().map(|roi| format!("{roi:?}"))))
    }

    /// Writes an image in HU as a series into a folder. `of` is what it was made of, which is referred to where it is DICOM.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when it was made of a series of another patient, or of an MR, which has no HU.
    pub fn image(&self, out: &Path, ct: &Volume<f32>, of: Option<&Path>) -> Result<()> {
        let of = of.filter(|path| is_dicom_path(path));
        let source = of.map(|path| Ok::<_, Error>((path, describe_series(path)?.0))).transpose()?;
        if let Some((path, source)) = &source {
            self.same_patient(path, &source.patient)?;
            if Scan::of_class(&source.sop_class) == Some(Scan::Mr) {
                let problem = "it is an MR series, and an image is written as a CT series in HU";
                let remedy = "name a file as --out, for example *.nii.gz, and leave --dicom-like out";
                return Err(Error::refused(findings::DICOM_NO_CT, path.display().to_string(), problem, remedy));
            }
        }
        let refuse = |e: std::io::Error| Error::write(out, e.to_string(), "choose a folder that you may write to");
        std::fs::create_dir_all(out).map_err(refuse)?;
        let sources: Vec<&Series> = source.iter().map(|(_, series)| series).collect();
        let about = DerivedCt {
            role: "image",
            description: "CT carried by registration (aventail, research only)",
            derivation: &format!("CT deformed into the frame of this scan by registration. {CAUTION}"),
            number: 901,
            frame_of_reference: &self.series.frame_of_reference,
            patient_position: &self.series.patient_position,
            sources: &sources,
        };
        let refers_to = sources.iter().map(|series| series.uid.clone());
        write_ct(out, ct, &about, &self.origin(digest(ct, |v, bytes| bytes.extend(v.to_le_bytes())), refers_to))
            .map(|_| ())
    }

    /// Writes labels as a segmentation. `of` is the file that they come from: what it says of segments of the same names is kept
    /// where it is a segmentation.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when it is of another patient.
    pub fn labels(&self, out: &Path, map: &LabelMap, of: &Path) -> Result<()> {
        let source = if is_segmentation(of) { segmentation(of)? } else { None };
        if let Some((object, _)) = &source {
            self.same_patient(of, &object.series.patient)?;
        }
        let about = DerivedSegmentation {
            role: "labels",
            description: "Labels carried by registration (aventail, research only)",
            number: 908,
            on: &self.series,
        };
        let held = digest(&map.volume, |v, bytes| bytes.extend(v.to_le_bytes()));
        let from = source.as_ref().map_or(String::new(), |(object, _)| object.uid.clone());
        let header = source.as_ref().map(|(object, _)| object.header.as_ref());
        let header: Option<&Item> = header.map(|object| &**object);
        write_segmentation(out, map, &about, &self.origin(held, [format!("{:?}", map.names), from]), header)
    }

    /// Writes a dose (or `what` of it) that was made of the doses of files `sources` by `fields`, registrations among which are
    /// referred to; returns what is to be known.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when a source is of another patient, or physical and effective doses are mixed.
    pub fn dose(
        &self,
        out: &Path,
        dose: &Volume<f32>,
        what: CarriedDose,
        [sources, fields]: [&[&Path]; 2],
    ) -> Result<Vec<Warning>> {
        let mut read: Vec<Dose> = Vec::new();
        let mut warnings = Vec::new();
        for path in sources {
            let name = path.display().to_string();
            let one = if is_dicom_path(path) { Some(dose_at(path)?.value) } else { None };
            warnings.extend(no_plan(&name, one.as_ref().map_or(&BTreeSet::new(), |one| &one.plans)));
            let Some(one) = one else { continue };
            self.same_patient(path, &one.series.patient)?;
            if let Some(other) = read.iter().find(|other| other.kind != one.kind) {
                let problem = format!("its dose is {}, that of another is {}", one.kind, other.kind);
                return Err(Error::input(name, problem, "add up doses of one type"));
            }
            read.push(one);
        }
        let plans: BTreeSet<String> = read.iter().flat_map(|one| one.plans.iter().cloned()).collect();
        let summations: BTreeSet<&str> = read.iter().map(|one| one.summation.as_str()).collect();
        let summation = match (plans.len(), summations.len(), summations.first()) {
            (2.., ..) => "MULTI_PLAN",
            (_, 1, Some(own)) if !own.is_empty() => own,
            _ => "PLAN",
        };
        let registrations: Vec<[String; 2]> = fields.iter().filter_map(|path| reference_of(path)).collect();
        let registrations: Vec<[&str; 2]> = registrations.iter().map(|[a, b]| [a.as_str(), b.as_str()]).collect();
        let (role, description, comment, number) = what.words();
        let of_source = read.first().map_or("PHYSICAL", |one| one.kind.as_str());
        let about = DerivedDose {
            role: &role,
            description: &description,
            comment: &comment,
            number,
            frame_of_reference: &self.series.frame_of_reference,
            kind: if what == CarriedDose::Deviation { "ERROR" } else { of_source },
            summation,
            plans: &plans,
            carried_by: Some(&registrations),
        };
        let said = format!("{} {} {plans:?} {registrations:?}", about.kind, about.summation);
        let held = digest(dose, |v, bytes| bytes.extend(v.to_le_bytes()));
        write_dose(out, dose, &about, &self.origin(held, [said]))?;
        Ok(warnings)
    }
}

impl Like {
    /// Writes a field that lies in this scan and leads to another, as a Deformable Spatial Registration.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when the other scan is of another patient.
    pub fn field(&self, out: &Path, field: &Volume<[f32; 3]>, to: &Self) -> Result<()> {
        self.same_patient(&to.path, &to.series.patient)?;
        let about = DerivedRegistration {
            role: "field",
            description: "Displacement field (aventail, research only)",
            number: 913,
            from: &self.series,
            to: &to.series,
        };
        let held = digest(field, |v, bytes| bytes.extend(v.iter().flat_map(|c| c.to_le_bytes())));
        write_deformable(out, field, &about, &self.origin(held, [to.series.uid.clone()])).map(|_| ())
    }
}

/// SHA-256 of a volume with its place.
fn digest<T>(volume: &Volume<T>, bytes_of: impl Fn(&T, &mut Vec<u8>)) -> String {
    let grid = volume.grid();
    let mut hash = Sha256::new();
    hash.update(format!("{:?} {:?} {:?} {:?}", grid.size(), grid.spacing(), grid.origin(), grid.direction()));
    let mut bytes = Vec::new();
    for piece in volume.data().chunks(PIECE) {
        bytes.clear();
        piece.iter().for_each(|value| bytes_of(value, &mut bytes));
        hash.update(&bytes);
    }
    crate::io::checksum::sha256(&hash.finalize())
}

/// What is said of each structure: by the set that they come from where it has one of the name, else by the contours alone.
fn rois_of(contours: &Contours, set: Option<&StructureSet>) -> Vec<Roi> {
    let known = set.map_or(&[][..], |set| &set.rois);
    let mut next = known.iter().map(|roi| roi.number).max().unwrap_or(0);
    let roi = |s: &Structure| {
        known.iter().find(|roi| roi.name == s.name).cloned().unwrap_or_else(|| {
            next += 1;
            Roi {
                number: next,
                name: s.name.clone(),
                interpreted_type: String::new(),
                colour: s.colour,
                generation_algorithm: String::new(),
                empty: s.polygons.is_empty(),
            }
        })
    };
    contours.structures.iter().map(roi).collect()
}
