//! Findings on displacement vector fields and what they carry.

findings! {
    FIELDS:
    FEW_FRACTIONS = warned(
        "few-fractions",
        "Few fractions hardly determine modes.",
        "Fit more fractions.",
    );
    FIELD_DIRECTION = refused_or_doubted(
        "field-direction",
        "The field's direction or grid is wrong.",
        "Give the field of the other direction.",
    );
    FOLDED = warned(
        "folded",
        "Tissue outside contact and sliding interfaces is folded.",
        "Map no dose there; see the Jacobian map.",
    );
    INVERSE = warned(
        "inverse",
        "Fraction tissue without pre-image shows nothing of planning.",
        "See the masks.",
    );
    LANDMARKS_OUTSIDE = doubted(
        "landmarks-outside",
        "Landmarks outside tissue measure nothing.",
        "Check positions and space (LPS, RAS).",
    );
    LANDMARKS_WORSE = doubted(
        "landmarks-worse",
        "Landmarks are worse than with the couch shift.",
        "Check fusion images and landmarks.",
    );
    NO_INVERSE = warned(
        "no-inverse",
        "Places have no pre-image in an inverted field.",
        "Give the other direction's field.",
    );
    OUTSIDE_FIELD = doubted(
        "outside-field",
        "Input outside the field was not moved.",
        "Enlarge the field, or crop the input.",
    );
    POSTURES_IMPLAUSIBLE = refused(
        "postures-implausible",
        "Too many drawn postures are implausible.",
        "Lower deviations, or raise limits.",
    );
    SKIN_MEETS_SKIN = doubted(
        "skin-meets-skin",
        "Skin passes through skin.",
        "Do not trust dose and contours there.",
    );
    SLIDING = warned(
        "sliding",
        "Cells of sliding interfaces are folded.",
        "Expect discontinuous motion.",
    );
    VOLUME_CHANGE = warned(
        "volume-change",
        "Organs did not change volume as asked.",
        "See the report's volumes.",
    );
}
