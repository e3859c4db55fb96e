//! Findings on doses, and on what they are mapped with.

findings! {
    DOSES:
    DOSE_CARRIED = warned(
        "dose-carried",
        "A registration carried this dose.",
        "Give the calculated dose.",
    );
    DOSE_COUNTED = warned(
        "dose-counted",
        "A whole plan's dose counts as one fraction's.",
        "Give --weights; --fractions suits single-fraction plans.",
    );
    DOSE_KIND = warned(
        "dose-kind",
        "The dose is not physical, perhaps effect-weighted.",
        "Do not add it to physical doses.",
    );
    DOSE_NEGATIVE = warned(
        "dose-negative",
        "Voxels rounded below 0 Gy count as 0.",
        "Check the count.",
    );
    DOSE_OUTSIDE = warned(
        "dose-outside",
        "One dose does not cover the other.",
        "Compute larger grids.",
    );
    DOSE_PART = warned(
        "dose-part",
        "This is a beam's, fraction's or partial sum's dose.",
        "Check that you mean it.",
    );
    DOSE_PLANES = refused(
        "dose-planes",
        "Dose planes are uneven or badly described.",
        "Export an even grid in one file.",
    );
    DOSE_SUM = refused(
        "dose-sum",
        "The doses are not one plan's beams on one grid.",
        "Give the one you mean.",
    );
    DOSE_UNITS = refused_or_warned(
        "dose-units",
        "Not Gy: refused below 0, above 500, or by header.",
        "Give Gy, not cGy, percent, CT or difference; check --weights.",
    );
    DOSES_APART = refused(
        "doses-apart",
        "The compared doses share no place.",
        "Give doses of one frame.",
    );
    ENERGY_OUTSIDE = warned(
        "energy-outside",
        "Over 1 % of the energy leaves the target grid.",
        "Enlarge --grid.",
    );
    SAMPLES_OF_ANOTHER_RUN = refused(
        "samples-of-another-run",
        "Samples and field are of different runs.",
        "Give samples of the field's run.",
    );
    FOLDS_IN_STEEP_DOSE = warned(
        "folds-in-steep-dose",
        "The field folds where the dose is steep.",
        "Do not trust the dose there.",
    );
    STEEP_DOSE_OUTSIDE = warned(
        "steep-dose-outside",
        "Steep dose leaves the images.",
        "Check their edges.",
    );
    STRUCTURE_OUTSIDE_DOSE = warned(
        "structure-outside-dose",
        "A structure leaves the dose's grid (0 Gy there).",
        "Compute a larger dose grid.",
    );
    UNCERTAIN_FIELD_IN_STEEP_DOSE = warned(
        "uncertain-field-in-steep-dose",
        "The inverse-consistency error changes dose by over 1 % of the maximum.",
        "Do not trust the dose there.",
    );
}
