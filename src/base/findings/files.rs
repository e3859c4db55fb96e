//! Findings on files, their headers and folders of results.

findings! {
    FILES:
    EXTENSION_DAMAGED = warned(
        "extension-damaged",
        "A NIfTI header extension is cut off or has an impossible size.",
        "Write the file anew; label names may be missing.",
    );
    FOLDER_OF_ANOTHER_RUN = refused(
        "folder-of-another-run",
        "A result would take the place of a file that another command's run has written into the same folder.",
        "Give another --out: a folder holds one run.",
    );
    HEADER_FIELD = refused(
        "header-field",
        "A field of an image's header changes values or geometry in a way that is not supported, or contradicts another field.",
        "Correct the field that the message names, or write the file again with another tool.",
    );
    INPUT_CHANGED = doubted(
        "input-changed",
        "A file is not the one that the recorded run has read.",
        "Run it on the recorded file, or take the result as a new one.",
    );
    INPUT_OVERWRITTEN = refused(
        "input-overwritten",
        "A result would take the place of an input, by its own path, through a link or under another name.",
        "Give another --out, or copy the input elsewhere.",
    );
    NO_ORIENTATION = doubted(
        "no-orientation",
        "A header does not tell where the patient's left, back and head are.",
        "Check orientation in a viewer, and write the file with a full header.",
    );
    NO_RUN = refused(
        "no-run",
        "A folder to inspect holds no report: no run, or one that was not finished.",
        "Give the --out folder of a finished run, or files.",
    );
    NO_SPACING = doubted(
        "no-spacing",
        "The header has no voxel spacing; 1 mm is assumed.",
        "Write the file with its spacing.",
    );
    NOT_SCALED = warned(
        "not-scaled",
        "A voxel-wise quantity was carried without scaling it by the change of volume.",
        "Add --scale-by-jacobian if it is an amount per voxel.",
    );
    ORIENTATION_CONTRADICTS = warned(
        "orientation-contradicts",
        "A MetaImage's AnatomicalOrientation is not what its matrix says; the matrix is used.",
        "Check left, right, front and back in a viewer, and write the file anew.",
    );
    OTHER_FILE = refused(
        "other-file",
        "A result would take the place of a page that no run has written.",
        "Give another --out, or move the file away.",
    );
    OTHER_PLANNING = refused(
        "other-planning",
        "Runs to be fitted differ in planning CT or labels.",
        "Give runs of one planning CT.",
    );
    PIXDIM_SFORM_DISAGREE = refused_or_warned(
        "pixdim-sform-disagree",
        "The voxel spacing (pixdim) and the sform of a NIfTI file differ: readers of the one and the other see another size.",
        "Find out which one is right, and write the file anew.",
    );
    PLANNING_DIFFERS = warned(
        "planning-differs",
        "Runs of one patient's name in a summary were made of different planning CTs.",
        "Give each patient a folder of the patient's own name; where a patient was planned anew, summarise the plans apart.",
    );
    QFORM_INVALID = warned(
        "qform-invalid",
        "A NIfTI qform is set but is no valid geometry; the sform is used.",
        "Write the file anew.",
    );
    ROW_LENGTH = refused(
        "row-length",
        "A row of a CSV table has another number of cells than its first row.",
        "Give every row as many cells; put texts with commas into quotation marks, write decimals with a point.",
    );
    RUN_CHANGED = refused(
        "run-changed",
        "Files of the run are missing, changed, or belong to another run than its report.",
        "Run it again into a new folder.",
    );
    SFORM_QFORM_DISAGREE = warned(
        "sform-qform-disagree",
        "The sform and the qform of a NIfTI file place the image differently.",
        "Find out which one is right, and write the file anew.",
    );
    SPACE_UNKNOWN = refused(
        "space-unknown",
        "A bare 4x4 matrix, a mesh or an .fcsv does not tell whether its coordinates are LPS or RAS.",
        "Say it with --space, or of one matrix as FILE#ras or FILE#lps; convert FSL's matrices first.",
    );
}
