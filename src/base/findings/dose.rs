//! Findings on doses, and on what they are mapped with.

findings! {
    DOSES:
    DOSE_COUNTED = warned(
        "dose-counted",
        "The dose of a whole plan, by its DICOM header, counts as that of one of several fractions.",
        "Give shares of the plan as --weights; keep --fractions where the plan has a single fraction.",
    );
    DOSE_KIND = warned(
        "dose-kind",
        "This is not a physical dose; it is, for example, weighted by biological effect.",
        "Do not sum it with physical doses.",
    );
    DOSE_NEGATIVE = warned(
        "dose-negative",
        "Voxels of a dose are below 0 by rounding; they count as 0 Gy.",
        "None, if the count is plausible: values below 0 come of scaled integers and of resampling.",
    );
    DOSE_OUTSIDE = warned(
        "dose-outside",
        "One of two doses that are compared does not cover the other; what is missing is left out of the figures.",
        "Compute both doses on grids that hold what is to be compared.",
    );
    DOSE_PART = warned(
        "dose-part",
        "A dose is not that of a whole plan: of a beam, of a fraction, or a sum of beams.",
        "Check that it is the dose that is meant.",
    );
    DOSE_PLANES = refused(
        "dose-planes",
        "The planes of a DICOM dose are not evenly spaced, or are described in a way that is not legal.",
        "Export the dose again on an even grid, in one file.",
    );
    DOSE_SUM = refused(
        "dose-sum",
        "Several doses are given that are not those of the beams of one plan on one grid.",
        "Give the file of the one dose that is meant.",
    );
    DOSE_UNITS = refused_or_warned(
        "dose-units",
        "A dose, or what was computed of it, is no dose in Gy: refused above 500 Gy and below 0, and where DICOM says so; questioned above what treatments give.",
        "Give the dose in Gy: not cGy, no percent, no CT, no difference of doses; check --weights.",
    );
    DOSES_APART = refused(
        "doses-apart",
        "Two doses that are compared have no place in common.",
        "Give doses of one frame.",
    );
    ENERGY_OUTSIDE = warned(
        "energy-outside",
        "More than 1 % of the dose's energy falls outside the target grid.",
        "Give a larger --grid.",
    );
    SAMPLES_OF_ANOTHER_RUN = refused(
        "samples-of-another-run",
        "The samples belong to another registration than the field that carries the dose.",
        "Give the samples of the run that the field is of.",
    );
    FOLDS_IN_STEEP_DOSE = warned(
        "folds-in-steep-dose",
        "The field folds where the dose is steep.",
        "Do not trust the mapped dose there.",
    );
    STRUCTURE_OUTSIDE_DOSE = warned(
        "structure-outside-dose",
        "A structure lies partly or wholly outside the dose's grid.",
        "Compute the dose on a grid that holds it; what lies outside counts with 0 Gy, or is not known if it is all.",
    );
    UNCERTAIN_FIELD_IN_STEEP_DOSE = warned(
        "uncertain-field-in-steep-dose",
        "The field's own residual changes the dose by more than 1 % of its maximum.",
        "Do not trust the mapped dose there.",
    );
}
