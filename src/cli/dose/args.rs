//! The command line of `aventail dose`.

use super::super::args::{CommonArgs, DirectionName, JsonArgs};
use crate::io::samples::SAMPLES;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// What `aventail dose` can do.
#[derive(Debug, Subcommand)]
pub enum DoseVerb {
    /// Carry a dose through a field: the planned dose onto the fraction, or the dose of the day back onto planning
    #[command(after_help = MAP)]
    Map(MapArgs),
    /// Carry the doses of several fractions back onto planning and add them up with weights
    #[command(after_help = ACCUMULATE)]
    Accumulate(AccumulateArgs),
    /// Dose-volume histograms of structures, with D95, Dmean, Dmax, D0.03cc and V_x
    #[command(after_help = DVH)]
    Dvh(DvhArgs),
    /// Difference of two doses, and the distance to dose difference
    #[command(after_help = COMPARE)]
    Compare(CompareArgs),
}

const MAP: &str = "\
interpolate takes the dose at the mapped point. energy-mass carries energy and mass together,
conserves energy, and prints the balance; it needs --ct. OUT's .json holds balance, inversion
residual, warnings and checksums; `aventail inspect` verifies them. The page beside OUT (.html)
draws isodoses before and after, and marks where the dose is steep; --page-ct and --structures add
to it.

Examples:
  aventail dose map --dose plan_dose.nii.gz --to fraction --planning-to-fraction dvf.nii.gz --grid fraction_ct.nii.gz --out dose_on_fraction.nii.gz
  aventail dose map --dose day_dose.nii.gz --to planning --planning-to-fraction dvf.nii.gz --grid plan_dose.nii.gz --method energy-mass --ct fraction_ct.nii.gz --out dose_on_planning.nii.gz";

const ACCUMULATE: &str = "\
Writes beside OUT a .json file, as `dose map` does, and a page (.html): isodoses of the sum and of
each fraction's share, where the dose is steep, and with --structures dose-volume histograms.

Example:
  aventail dose accumulate --dose day1.nii.gz day2.nii.gz --fields dvf1.nii.gz dvf2.nii.gz --weights 0.571 0.429 --grid plan_dose.nii.gz --page-ct planning_ct.nii.gz --structures contours.json --out sum.nii.gz";

const DVH: &str = "\
Writes dvh.html (the page), dvh.csv (curves), dvh_figures.csv, dvh.json and dvh.png to OUT, and
dvh_run.json with inputs and checksums. With a field the structures are planning's: the dose of
the fraction is carried back to them. With --samples the page shows bands, and dvh_intervals.csv
holds the 90 % intervals.

Examples:
  aventail dose dvh --dose planned.nii.gz accumulated.nii.gz --structures contours.json --at 20 50 --out dvh
  aventail dose dvh --dose day_dose.nii.gz --structures planning.json --planning-to-fraction out/planning_to_fraction.nii.gz --samples out/samples --limit \"cord:D0.03cc<=45\" --out dvh";

const COMPARE: &str = "\
Writes dose_difference.nii.gz (dose minus reference, Gy), distance_to_dose_difference.nii.gz (mm:
how exactly the field must be known so that no voxel's dose changes by the tolerance),
compare.html (isodoses and differences as pictures) and compare.json to OUT.

Example:
  aventail dose compare --dose accumulated.nii.gz --reference planned.nii.gz --ct planning_ct.nii.gz --tolerance 2 --out compare";

/// How dose is carried.
#[derive(Debug, Args)]
pub struct MethodArgs {
    /// How dose is carried
    #[arg(long, value_enum, default_value = "interpolate")]
    pub method: MethodName,
    /// Mass density by CT number: CSV with HU and g/cm^3, instead of Schneider 2000
    #[arg(long, value_name = "FILE")]
    pub density: Option<PathBuf>,
    /// energy-mass divides each voxel into this many parts along each axis
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub parts: usize,
    /// Threads, progress, and how the result is told.
    #[command(flatten)]
    pub common: CommonArgs,
}

impl MethodArgs {
    /// Whether progress is hidden: beside JSON too.
    pub(super) fn quiet(&self) -> bool {
        self.common.shown.quiet || self.common.told.json
    }
}

/// What the page of a carried dose shows beside it.
#[derive(Debug, Args)]
pub struct PageArgs {
    /// CT in HU in the frame that the dose goes to: the page draws isodoses on it (default: --grid, if that is a CT)
    #[arg(long, value_name = "FILE")]
    pub page_ct: Option<PathBuf>,
    /// Structures in the frame that the dose goes to, for dose-volume histograms in the page: a label map, or contours (JSON,
    /// DICOM structure set)
    #[arg(long, value_name = "FILE")]
    pub structures: Option<PathBuf>,
    /// Names of the labels, {"labels": {"1": "cord", ...}}, when the header of --structures has none
    #[arg(long, value_name = "FILE", requires = "structures")]
    pub labels: Option<PathBuf>,
    /// Write no page
    #[arg(long, conflicts_with_all = ["page_ct", "structures"])]
    pub no_page: bool,
}

impl PageArgs {
    /// The files that are read for it.
    pub(super) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.page_ct.iter().chain(&self.structures).chain(&self.labels)
    }
}

/// How far a carried dose may be off.
#[derive(Debug, Args)]
pub struct SampledArgs {
    /// Folder of samples of the registration (`aventail samples`; one for each dose, in their order): shows how far the dose may
    /// be off. Writes OUT_sd, OUT_p05 and OUT_p95 beside OUT, and bands and 90 % intervals into the page
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub samples: Vec<PathBuf>,
    /// Doses of V_x in the table of intervals, Gy
    #[arg(long, value_name = "GY", num_args = 1.., requires = "samples", requires = "structures")]
    pub at: Vec<f64>,
    /// Limits to judge (kept, not kept or undecided), in quotes: "cord:D0.03cc<=45" "target:D95>=57"
    #[arg(long, value_name = "LIMIT", num_args = 1.., requires = "samples", requires = "structures")]
    pub limit: Vec<String>,
}

/// Names of the methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// Trilinear interpolation at mapped positions
    Interpolate,
    /// Energy/mass-congruent: conserves energy
    EnergyMass,
}

/// Images that a dose can be carried to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Frame {
    /// The planned dose goes onto the fraction
    Fraction,
    /// The dose of the day goes back onto planning
    Planning,
}

/// Options of `dose map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Dose in Gy: .nii.gz, .mha, .nrrd, or a DICOM RT Dose
    #[arg(long, value_name = "FILE")]
    pub dose: PathBuf,
    /// Where the dose goes
    #[arg(long, value_enum)]
    pub to: Frame,
    /// Field on the planning grid: planning x goes to x + u(x)
    #[arg(long, value_name = "FILE", required_unless_present = "fraction_to_planning")]
    pub planning_to_fraction: Option<PathBuf>,
    /// Field on the fraction grid: fraction y shows planning y + v(y)
    #[arg(long, value_name = "FILE")]
    pub fraction_to_planning: Option<PathBuf>,
    /// Image whose grid the result gets, in the frame that the dose goes to; the folder of a DICOM series too
    #[arg(long, value_name = "FILE")]
    pub grid: PathBuf,
    /// CT in HU in the frame that the dose comes from: energy-mass needs it, the page draws isodoses on it
    #[arg(long, value_name = "FILE")]
    pub ct: Option<PathBuf>,
    /// DICOM series of the scan that the result lies in: the result is an RT Dose of its patient, study and frame of reference;
    /// needed where --out ends in .dcm
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// Result, Gy
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// How far it may be off.
    #[command(flatten)]
    pub sampled: SampledArgs,
    /// The page.
    #[command(flatten)]
    pub page: PageArgs,
    /// How dose is carried.
    #[command(flatten)]
    pub how: MethodArgs,
}

/// Options of `dose accumulate`.
#[derive(Debug, Args)]
pub struct AccumulateArgs {
    /// Dose of each fraction in Gy, in its own frame; DICOM RT Doses too
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub dose: Vec<PathBuf>,
    /// Field of each fraction, in the order of the doses
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub fields: Vec<PathBuf>,
    /// Direction of the fields
    #[arg(long, value_enum, default_value = "planning-to-fraction")]
    pub direction: DirectionName,
    /// For doses of one fraction each: number of fractions that each dose stands for
    #[arg(long, value_name = "N", num_args = 1.., conflicts_with = "weights")]
    pub fractions: Vec<f64>,
    /// For doses of the whole plan each: share of the plan that each dose stands for, from 0 to 1 (default: 1 each)
    #[arg(long, value_name = "SHARE", num_args = 1..)]
    pub weights: Vec<f64>,
    /// Image whose grid the result gets, in the planning frame; the folder of a DICOM series too
    #[arg(long, value_name = "FILE")]
    pub grid: PathBuf,
    /// CT of each fraction in HU, for energy-mass
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub ct: Vec<PathBuf>,
    /// DICOM series of the scan that the result lies in: the result is an RT Dose of its patient, study and frame of reference;
    /// needed where --out ends in .dcm
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// Result, Gy
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// How far it may be off.
    #[command(flatten)]
    pub sampled: SampledArgs,
    /// The page.
    #[command(flatten)]
    pub page: PageArgs,
    /// How dose is carried.
    #[command(flatten)]
    pub how: MethodArgs,
}

/// Options of `dose dvh`.
#[derive(Debug, Args)]
pub struct DvhArgs {
    /// Doses in Gy
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub dose: Vec<PathBuf>,
    /// Structures in the doses' frame, or in planning with a field: a label map, or contours (JSON, DICOM structure set), which
    /// may overlap
    #[arg(long, value_name = "FILE")]
    pub structures: PathBuf,
    /// Names of the labels, {"labels": {"1": "cord", ...}}, when the header has none
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// For structures in planning and doses in the fraction, field on the planning grid: planning x goes to x + u(x)
    #[arg(long, value_name = "FILE")]
    pub planning_to_fraction: Option<PathBuf>,
    /// Likewise, field on the fraction grid: fraction y shows planning y + v(y)
    #[arg(long, value_name = "FILE")]
    pub fraction_to_planning: Option<PathBuf>,
    /// Folder of samples of that registration (`aventail samples`): bands, and figures with 90 % intervals
    #[arg(long, value_name = "DIR")]
    pub samples: Option<PathBuf>,
    /// Limits to judge (kept, not kept or undecided), in quotes: "cord:D0.03cc<=45" "target:D95>=57"
    #[arg(long, value_name = "LIMIT", num_args = 1.., requires = "samples")]
    pub limit: Vec<String>,
    /// Doses of V_x, Gy
    #[arg(long, value_name = "GY", num_args = 1..)]
    pub at: Vec<f64>,
    /// Width of a bin of the curves, Gy
    #[arg(long, value_name = "GY", default_value_t = 0.1)]
    pub bin: f64,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Threads, progress, and how the result is told.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Options of `dose compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Dose in Gy
    #[arg(long, value_name = "FILE")]
    pub dose: PathBuf,
    /// Dose that it is compared with, same frame
    #[arg(long, value_name = "FILE")]
    pub reference: PathBuf,
    /// CT of the reference, in HU and its frame: the page draws isodoses on it
    #[arg(long, value_name = "FILE")]
    pub ct: Option<PathBuf>,
    /// CT to draw the dose on instead of --ct, same frame: for example the fraction CT mapped to planning
    #[arg(long, value_name = "FILE", requires = "ct")]
    pub dose_ct: Option<PathBuf>,
    /// Dose difference that matters, Gy (default: 3 % of the reference's maximum)
    #[arg(long, value_name = "GY")]
    pub tolerance: Option<f64>,
    /// Greatest distance that is searched, mm
    #[arg(long, value_name = "MM", default_value_t = 20.0)]
    pub limit: f64,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
}

/// Words in the names of the maps beside a dose: deviation and percentiles.
pub(super) const MAPS: [&str; 3] = ["sd", "p05", "p95"];

impl SampledArgs {
    /// The files that tell of the samples.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        self.samples.iter().map(|folder| folder.join(SAMPLES)).collect()
    }

    /// Words in the names of the maps that will be written.
    pub(super) fn maps(&self) -> &'static [&'static str] {
        if self.samples.is_empty() { &[] } else { &MAPS }
    }
}

impl DvhArgs {
    /// Fields from planning to the fraction and back, where they are given.
    pub(super) fn fields(&self) -> [Option<&PathBuf>; 2] {
        [self.planning_to_fraction.as_ref(), self.fraction_to_planning.as_ref()]
    }

    /// Samples of the registration and what is asked of them.
    pub(super) fn sampled(&self) -> SampledArgs {
        let samples = self.samples.iter().cloned().collect();
        SampledArgs { samples, at: self.at.clone(), limit: self.limit.clone() }
    }
}
