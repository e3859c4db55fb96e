//! Findings on doses.

use super::{Finding, refused, refused_or_warned, warned};

/// Those whose codes begin with `dose`.
pub(super) const DOSE: &[Finding] = &[
    warned(
        "dose-kind",
        "A dose is no physical dose, for example weighted by biological effect.",
        "Do not sum it with physical doses.",
    ),
    warned(
        "dose-negative",
        "Voxels of a dose are below 0 by rounding; they count as 0 Gy.",
        "None, if the count is plausible: values below 0 come of scaled integers and of resampling.",
    ),
    warned(
        "dose-outside",
        "One of two doses that are compared does not cover the other; what is missing is left out of the figures.",
        "Compute both doses on grids that hold what is to be compared.",
    ),
    warned(
        "dose-part",
        "A dose is not that of a whole plan: of a beam, of a fraction, or a sum of beams.",
        "Check that it is the dose that is meant.",
    ),
    refused(
        "dose-planes",
        "The planes of a DICOM dose are not evenly spaced, or are described in a way that is not legal.",
        "Export the dose again on an even grid, in one file.",
    ),
    refused(
        "dose-sum",
        "Several doses are given that are not those of the beams of one plan on one grid.",
        "Give the file of the one dose that is meant.",
    ),
    refused_or_warned(
        "dose-units",
        "A dose, or what was computed of it, is no dose in Gy: refused above 500 Gy and below 0, and where DICOM says so; questioned above what treatments give.",
        "Give the dose in Gy: not cGy, no percent, no CT, no difference of doses; check --weights.",
    ),
    refused("doses-apart", "Two doses that are compared have no place in common.", "Give doses of one frame."),
];
