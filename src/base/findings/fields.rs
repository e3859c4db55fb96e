//! Findings on displacement vector fields and what they carry.

findings! {
    FIELDS:
    FEW_FRACTIONS = warned(
        "few-fractions",
        "Modes of few fractions are hardly known.",
        "Fit more fractions; see docs/library.md.",
    );
    FIELD_DIRECTION = refused_or_doubted(
        "field-direction",
        "The field is used against the direction in its header, or lies on the wrong image's grid.",
        "Give it as the field of the other direction, or the field that belongs there.",
    );
    FOLDED = warned(
        "folded",
        "Tissue cells outside bone contact and sliding interfaces are folded.",
        "See the Jacobian map; do not map dose there.",
    );
    INVERSE = warned(
        "inverse",
        "Tissue voxels of the fraction CT have no exact pre-image.",
        "They show nothing of the planning scan; see the masks.",
    );
    LANDMARKS_OUTSIDE = doubted(
        "landmarks-outside",
        "Landmarks lie where no displacement was computed: in air, or outside the patient.",
        "Check their positions and their space (LPS or RAS); their residuals do not measure the tissue.",
    );
    LANDMARKS_WORSE = doubted(
        "landmarks-worse",
        "Landmarks are farther off after the registration than under the couch shift alone.",
        "Look at the fusion images there; check that both positions show the same point.",
    );
    NO_INVERSE = warned(
        "no-inverse",
        "Points or voxels have no exact pre-image in a field that had to be inverted.",
        "Give the field of the other direction.",
    );
    OUTSIDE_FIELD = doubted(
        "outside-field",
        "A part of the input (share of volume; of dose the share of the dose) lies outside a field and was not moved by it.",
        "Give a field that covers the input, or crop the input.",
    );
    POSTURES_IMPLAUSIBLE = refused(
        "postures-implausible",
        "Too many drawn postures are implausible.",
        "Lower the deviations, or raise the limits.",
    );
    SKIN_MEETS_SKIN = doubted(
        "skin-meets-skin",
        "In the moved patient, skin passes through skin.",
        "Do not trust dose or contours there.",
    );
    SLIDING = warned(
        "sliding",
        "Cells of declared sliding interfaces are folded.",
        "Motion may be discontinuous there.",
    );
    VOLUME_CHANGE = warned(
        "volume-change",
        "Organs did not change their volume as asked.",
        "See the table of volumes in the report.",
    );
}
