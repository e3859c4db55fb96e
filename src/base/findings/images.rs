//! Findings on the images and on how they are matched.

findings! {
    IMAGES:
    CUT_FRACTION = warned(
        "cut-fraction",
        "A part of the fraction's grid was not measured: it lies beyond a reconstruction's circle, or is blank.",
        "Out of view bones follow their joints; see the map of uncertainty before contours there are used.",
    );
    FIT_ITERATIONS = doubted(
        "fit-iterations",
        "The fit stopped at its iteration limit while it still moved bones.",
        "Look at the bones named; raise fit.max_iterations if they are off.",
    );
    FRACTION_MIRRORED = refused(
        "fraction-mirrored",
        "The fraction CT shows the mirror image of the planning CT: mirrored left to right, the bones explain it better.",
        "Correct the x axis of the wrong header, after a look at the heart, the liver or a marked side.",
    );
    FRACTION_SCALED = refused_or_doubted(
        "fraction-scaled",
        "The fraction CT shows the planning CT's bones at another scale along an axis.",
        "Compare voxel spacing and slice thickness of both files with their DICOM series.",
    );
    FRACTION_TURNED = refused(
        "fraction-turned",
        "No bones are found as the headers stand; with another orientation they would be.",
        "Correct the direction in the wrong header, or give scans of one position of the patient.",
    );
    HU_DOUBTFUL = doubted(
        "hu-doubtful",
        "Air does not lie near -1000 HU: the HU look scaled.",
        "Compare RescaleSlope and RescaleIntercept with the DICOM series.",
    );
    IMAGES_MISLEAD = doubted(
        "images-mislead",
        "The images move soft tissue without agreeing better: metal streaks, noise or grey values of another machine.",
        "Bones alone carry that tissue; look at the fusion there, and at the map of uncertainty.",
    );
    LEVEL_UNSURE = doubted(
        "level-unsure",
        "The fraction CT shows a short piece of the spine that would fit another level nearly as well.",
        "Check the levels in the fusion images; place a vertebra with --bone-landmarks.",
    );
    MR_FRACTION = doubted(
        "mr-fraction",
        "The fraction is an MR: grey values that are no HU, and a geometry that the scanner distorts.",
        "Look at bones and skin in the fusion images, far from the scanner's middle above all; take no dose from its values.",
    );
    MR_PLANNING = doubted(
        "mr-planning",
        "The planning scan is an MR: planning_on_fraction and the pictures show it freed of the coil's bias, and not in HU.",
        "Look at bones and skin in the fusion images; carry the MR's own values with `aventail warp`.",
    );
    NOT_AN_MR = refused(
        "not-an-mr",
        "An image that must be an MR holds negative values, as a CT in HU does.",
        "Leave --modality out for a CT; give the magnitude image.",
    );
    NO_TISSUE = doubted(
        "no-tissue",
        "The planning CT shows no tissue above the least HU inside the patient.",
        "Check that it is a CT in HU.",
    );
    NOT_IN_HU = refused(
        "not-in-hu",
        "An image that must be a CT in HU has no air or no soft tissue where HU have them.",
        "Set slope and offset as the DICOM series has them, or give the CT: the message names what would mend it.",
    );
    SHADED_FRACTION = warned(
        "shaded-fraction",
        "The fraction's grey values are a cone-beam CT's: shaded, or of another scale.",
        "Shading was taken out by planning's grey values; look at the fusion images in soft tissue.",
    );
    SIDE_UNSURE = doubted(
        "side-unsure",
        "The bones are too nearly symmetric to tell a mirrored fraction CT from a true one.",
        "Check left and right in the fusion images.",
    );
    START_LEFT = doubted(
        "start-left",
        "The bones were found far from the start that --start gives, or another place explains more of them.",
        "Check that it takes planning to this fraction, and the fusion images.",
    );
    START_SEARCHED = warned(
        "start-searched",
        "One motion of all bones did not locate the patient; single bones proposed starts, and the joints chose one.",
        "Look at the bones named in the fusion images; where it is wrong, give --start or --bone-landmarks.",
    );
    WEAK_START = doubted(
        "weak-start",
        "The start is weak: one motion of all bones explains little of their contrast, or few bones of a short view are found.",
        "Look at the fusion images first.",
    );
}
