//! Findings on the images and on how they are matched.

findings! {
    IMAGES:
    CUT_FRACTION = warned(
        "cut-fraction",
        "Part of the fraction was not measured.",
        "Check the uncertainty there.",
    );
    FIT_ITERATIONS = doubted(
        "fit-iterations",
        "Bones still moved at the last iteration.",
        "Check them, or raise fit.max_iterations.",
    );
    FRACTION_MIRRORED = refused(
        "fraction-mirrored",
        "The fraction fits better mirrored left to right.",
        "Check the heart; correct the wrong header's x axis.",
    );
    FRACTION_SCALED = refused_or_doubted(
        "fraction-scaled",
        "The bones have another scale in the fraction.",
        "Check spacing and slice thickness.",
    );
    FRACTION_TURNED = refused(
        "fraction-turned",
        "The bones are found only in another orientation.",
        "Correct the wrong header; give scans of one position.",
    );
    HU_DOUBTFUL = doubted(
        "hu-doubtful",
        "Air is not near -1000 HU.",
        "Compare RescaleSlope and RescaleIntercept with the DICOM series.",
    );
    IMAGES_MISLEAD = doubted(
        "images-mislead",
        "Moving tissue by images did not improve their agreement; bones alone move it.",
        "Check fusion and uncertainty.",
    );
    LEVEL_UNSURE = doubted(
        "level-unsure",
        "A short spine fits at another level, too.",
        "Check levels; place one with --bone-landmarks.",
    );
    MR_FRACTION = doubted(
        "mr-fraction",
        "An MR has no HU and is distorted.",
        "Check bones and skin, especially off-centre; take no dose from it.",
    );
    MR_PLANNING = doubted(
        "mr-planning",
        "The planning scan is an MR: planning_on_fraction and the pictures show it corrected for coil bias, not in HU.",
        "Look at bones and skin in the fusion images; carry the MR's own values with `aventail warp`.",
    );
    NOT_AN_MR = refused(
        "not-an-mr",
        "The MR has negative values.",
        "Omit --modality for CT; give magnitudes.",
    );
    NO_TISSUE = doubted(
        "no-tissue",
        "The planning CT shows no tissue.",
        "Check that it is in HU.",
    );
    NOT_IN_HU = refused(
        "not-in-hu",
        "Air or soft tissue has wrong HU.",
        "Correct slope and offset as the message says.",
    );
    SAME_SCAN = doubted(
        "same-scan",
        "Planning is given as the fraction.",
        "Give the day's scan.",
    );
    SHADED_FRACTION = warned(
        "shaded-fraction",
        "Cone-beam grey values were corrected for shading.",
        "Check soft tissue in the fusion images.",
    );
    SIDE_UNSURE = doubted(
        "side-unsure",
        "Bones are too symmetric to exclude mirroring.",
        "Check left and right.",
    );
    START_LEFT = doubted(
        "start-left",
        "Bones lie far from --start, or fit better elsewhere.",
        "Check --start and fusion images.",
    );
    START_SEARCHED = warned(
        "start-searched",
        "Single bones, not all together, gave the start.",
        "Check them; else give --start or --bone-landmarks.",
    );
    WEAK_START = doubted(
        "weak-start",
        "The start explains little, or finds few bones.",
        "Check the fusion images first.",
    );
}
