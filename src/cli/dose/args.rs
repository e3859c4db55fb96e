//! The command line of `aventail dose`.

use super::super::args::{CommonArgs, DirectionName, JsonArgs};
use crate::io::samples::SAMPLES;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// What `aventail dose` can do.
#[derive(Debug, Subcommand)]
pub enum DoseVerb {
    /// Map a dose through a field: the planned dose to the fraction, or the dose of the day back to
    /// planning
    #[command(after_help = MAP)]
    Map(MapArgs),
    /// Map the doses of several fractions back to planning and add them with weights
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
One of --planning-to-fraction and --fraction-to-planning is required; either serves for both
directions.

interpolate takes the dose at the mapped point. energy-mass maps energy and mass together, conserves
energy and prints the balance; it needs --ct. The .json beside OUT holds balance, inversion
residual, warnings and checksums; `aventail inspect` verifies them. The .html page beside OUT draws
isodoses before and after and marks steep dose gradients; --page-ct adds a CT, --structures adds
histograms.

Examples:
  aventail dose map --dose plan_dose.nii.gz --to fraction --planning-to-fraction dvf.nii.gz \\
                    --grid fraction_ct.nii.gz --out dose_on_fraction.nii.gz
  aventail dose map --dose day_dose.nii.gz --to planning --planning-to-fraction dvf.nii.gz \\
                    --grid plan_dose.nii.gz --method energy-mass --ct fraction_ct.nii.gz \\
                    --out dose_on_planning.nii.gz";

const ACCUMULATE: &str = "\
Writes beside OUT a .json file, as `dose map` does, and a page (.html): isodoses of the sum and of
each fraction's share, steep dose gradients, and with --structures dose-volume histograms.

Example:
  aventail dose accumulate --dose day1.nii.gz day2.nii.gz --fields dvf1.nii.gz dvf2.nii.gz \\
                           --weights 0.571 0.429 --grid plan_dose.nii.gz \\
                           --page-ct planning_ct.nii.gz --structures contours.json \\
                           --out sum.nii.gz";

const DVH: &str = "\
Writes dvh.html (the page), dvh.csv (curves), dvh_figures.csv, dvh.json and dvh.png to OUT, and
dvh_run.json with inputs and checksums. If a field is given, the structures are those of planning,
and the dose of the fraction is mapped back to them. With --samples the page shows bands, and
dvh_intervals.csv holds the 90 % intervals.

Examples:
  aventail dose dvh --dose planned.nii.gz accumulated.nii.gz --structures contours.json \\
                    --at 20 50 --out dvh
  aventail dose dvh --dose day_dose.nii.gz --structures planning.json \\
                    --planning-to-fraction out/planning_to_fraction.nii.gz \\
                    --samples out/samples --limit \"cord:D0.03cc<=45\" --out dvh";

const COMPARE: &str = "\
Writes dose_difference.nii.gz (dose minus reference, Gy), distance_to_dose_difference.nii.gz (mm:
from each voxel to the nearest one whose dose differs by the tolerance; a smaller registration error
changes no voxel's dose by that much), compare.html (pictures) and compare.json to OUT.

Example:
  aventail dose compare --dose accumulated.nii.gz --reference planned.nii.gz \\
                        --ct planning_ct.nii.gz --tolerance 2 --out compare";

/// How dose is carried.
#[derive(Debug, Args)]
pub struct MethodArgs {
    /// Method of mapping the dose
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
    /// CT in HU in the frame that the dose is mapped to: the page draws isodoses on it (default:
    /// --grid, if that is a CT)
    #[arg(long, value_name = "FILE")]
    pub page_ct: Option<PathBuf>,
    /// Structures in the frame that the dose is mapped to, for dose-volume histograms in the page:
    /// a label map, or contours (JSON, DICOM structure set)
    #[arg(long, value_name = "FILE")]
    pub structures: Option<PathBuf>,
    /// Names of the labels (JSON), {"labels": {"1": "cord", ...}}, if the header of --structures
    /// has none
    #[arg(long, value_name = "FILE", requires = "structures")]
    pub labels: Option<PathBuf>,
    /// Write no HTML page
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
    /// Folder of samples (`aventail samples`), for each dose one, to estimate the dose error:
    /// writes OUT_sd, OUT_p05 and OUT_p95 beside OUT, and adds bands and 90 % intervals to the page
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub samples: Vec<PathBuf>,
    /// Doses x, Gy, whose V_x the table of intervals lists. Needs --samples and --structures
    #[arg(long, value_name = "GY", num_args = 1.., requires = "samples", requires = "structures")]
    pub at: Vec<f64>,
    /// Dose limits to check, in quotes: "cord:D0.03cc<=45" "parotid:Dmean<=26". Each: kept, not kept,
    /// or undecided (the 90 % interval holds the limit). Needs --samples and --structures
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
    /// Map the planned dose to the fraction
    Fraction,
    /// Map the dose of the day back to planning
    Planning,
}

/// Options of `dose map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Dose in Gy: .nii.gz, .mha, .nrrd, or a DICOM RT Dose
    #[arg(long, value_name = "FILE")]
    pub dose: PathBuf,
    /// Frame to which the dose is mapped
    #[arg(long, value_enum)]
    pub to: Frame,
    /// Field on the planning grid: planning x goes to x + u(x). This or the other is required
    #[arg(long, value_name = "FILE", required_unless_present = "fraction_to_planning")]
    pub planning_to_fraction: Option<PathBuf>,
    /// Field on the fraction grid: fraction y shows planning y + v(y)
    #[arg(long, value_name = "FILE")]
    pub fraction_to_planning: Option<PathBuf>,
    /// Image, or folder of a DICOM series, that gives the result its grid, in the frame that the
    /// dose is mapped to
    #[arg(long, value_name = "FILE")]
    pub grid: PathBuf,
    /// CT in HU in the frame that the dose comes from: required for energy-mass; the page draws
    /// isodoses on it
    #[arg(long, value_name = "FILE")]
    pub ct: Option<PathBuf>,
    /// DICOM series of the scan in which the result lies: writes an RT Dose with its patient, study
    /// and frame of reference. Required if --out ends in .dcm
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// File of the result, Gy
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
    /// Dose of each fraction in Gy, in its own frame (also DICOM RT Dose)
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub dose: Vec<PathBuf>,
    /// Field of each fraction, in the order of the doses
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub fields: Vec<PathBuf>,
    /// Direction of the fields
    #[arg(long, value_enum, default_value = "planning-to-fraction")]
    pub direction: DirectionName,
    /// If each dose is that of one fraction: number of fractions delivered with it
    #[arg(long, value_name = "N", num_args = 1.., conflicts_with = "weights")]
    pub fractions: Vec<f64>,
    /// If each dose is that of the whole plan: its share, 0 to 1 (of a finished plan together 1).
    /// Without --weights and --fractions doses are just added
    #[arg(long, value_name = "SHARE", num_args = 1..)]
    pub weights: Vec<f64>,
    /// Image, or folder of a DICOM series, that gives the result its grid, in the planning frame
    #[arg(long, value_name = "FILE")]
    pub grid: PathBuf,
    /// CT of each fraction in HU, for energy-mass
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub ct: Vec<PathBuf>,
    /// DICOM series of the scan in which the result lies: writes an RT Dose with its patient, study
    /// and frame of reference. Required if --out ends in .dcm
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// File of the result, Gy
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
    /// Structures in the frame of the doses (if a field is given: in planning): a label map, or
    /// contours (JSON, DICOM structure set), which may overlap
    #[arg(long, value_name = "FILE")]
    pub structures: PathBuf,
    /// Names of the labels (JSON), {"labels": {"1": "cord", ...}}, if the header of --structures
    /// has none
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// If structures are in planning and doses in the fraction: field on the planning grid,
    /// planning x goes to x + u(x)
    #[arg(long, value_name = "FILE")]
    pub planning_to_fraction: Option<PathBuf>,
    /// The same, with a field on the fraction grid: fraction y shows planning y + v(y)
    #[arg(long, value_name = "FILE")]
    pub fraction_to_planning: Option<PathBuf>,
    /// Folder of samples of that registration (`aventail samples`): adds bands and 90 % intervals
    #[arg(long, value_name = "DIR")]
    pub samples: Option<PathBuf>,
    /// Dose limits to check, in quotes: "cord:D0.03cc<=45" "parotid:Dmean<=26". Each: kept, not kept,
    /// or undecided (the 90 % interval holds the limit). Needs --samples
    #[arg(long, value_name = "LIMIT", num_args = 1.., requires = "samples")]
    pub limit: Vec<String>,
    /// Doses x, Gy, for which V_x is computed
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
    /// Reference dose in the same frame, Gy
    #[arg(long, value_name = "FILE")]
    pub reference: PathBuf,
    /// CT in HU in the frame of the reference: the page draws isodoses on it
    #[arg(long, value_name = "FILE")]
    pub ct: Option<PathBuf>,
    /// CT in the same frame to draw the dose on instead of --ct, for example the fraction CT mapped
    /// to planning
    #[arg(long, value_name = "FILE", requires = "ct")]
    pub dose_ct: Option<PathBuf>,
    /// Dose difference that matters, Gy (default: 3 % of the reference's maximum)
    #[arg(long, value_name = "GY")]
    pub tolerance: Option<f64>,
    /// Largest distance that is searched, mm
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
