//! Findings on files, their headers and folders of results.

findings! {
    FILES:
    EXTENSION_DAMAGED = warned(
        "extension-damaged",
        "A damaged NIfTI extension may hold label names.",
        "Write the file again.",
    );
    FOLDER_OF_ANOTHER_RUN = refused(
        "folder-of-another-run",
        "A result would replace another command's.",
        "Give another --out.",
    );
    HEADER_FIELD = refused(
        "header-field",
        "A header field is unsupported or contradictory.",
        "Correct it, or convert the file.",
    );
    INPUT_CHANGED = doubted(
        "input-changed",
        "A file differs from the recorded one.",
        "Use the recorded file, or expect another result.",
    );
    INPUT_OVERWRITTEN = refused(
        "input-overwritten",
        "A result would replace an input.",
        "Give another --out.",
    );
    NO_ORIENTATION = doubted(
        "no-orientation",
        "The header names no left, back and head.",
        "View it; write a full header.",
    );
    NO_RUN = refused(
        "no-run",
        "The folder holds no finished run.",
        "Give a finished --out folder, or files.",
    );
    NO_SPACING = doubted(
        "no-spacing",
        "The header has no spacing; 1 mm is assumed.",
        "Write the spacing.",
    );
    NOT_SCALED = warned(
        "not-scaled",
        "Volume change did not scale the values.",
        "Add --scale-by-jacobian for amounts per voxel.",
    );
    ORIENTATION_CONTRADICTS = warned(
        "orientation-contradicts",
        "AnatomicalOrientation contradicts the matrix, which counts.",
        "View it; write the file again.",
    );
    OTHER_FILE = refused(
        "other-file",
        "A result would replace a page that no run wrote.",
        "Give another --out, or move it.",
    );
    OTHER_PLANNING = refused(
        "other-planning",
        "Runs differ in planning CT or labels.",
        "Give runs of one planning CT.",
    );
    PIXDIM_SFORM_DISAGREE = refused_or_warned(
        "pixdim-sform-disagree",
        "NIfTI pixdim and sform give different spacings.",
        "Write it with the right one.",
    );
    PLANNING_DIFFERS = warned(
        "planning-differs",
        "One patient's runs have different planning CTs.",
        "Give each patient a folder, a new plan another.",
    );
    QFORM_INVALID = warned(
        "qform-invalid",
        "The NIfTI qform is invalid; the sform counts.",
        "Write the file again.",
    );
    ROW_LENGTH = refused(
        "row-length",
        "A CSV row's length differs from the first.",
        "Quote texts with commas; use decimal points.",
    );
    RUN_CHANGED = refused(
        "run-changed",
        "Files are missing, changed, or of another run.",
        "Run again into a new folder.",
    );
    SFORM_QFORM_DISAGREE = warned(
        "sform-qform-disagree",
        "NIfTI sform and qform place the image differently.",
        "Write it with the right one.",
    );
    SPACE_UNKNOWN = refused(
        "space-unknown",
        "LPS or RAS is unknown.",
        "Give --space (matrices: FILE#ras, FILE#lps); convert FSL's matrices.",
    );
}
