//! Findings on labels and structures.

findings! {
    LABELS:
    CONTOURS_CANCEL = warned(
        "contours-cancel",
        "Contours cancel: what two enclose is outside.",
        "Nest contours for holes only.",
    );
    CONTOURS_CROSS = warned(
        "contours-cross",
        "Contours cross: what two enclose is outside.",
        "Draw parts apart, or as one.",
    );
    CONTOURS_REPEATED = warned(
        "contours-repeated",
        "A contour is drawn twice; one counts.",
        "Export the structure again.",
    );
    GUIDE_CONTRADICTS = doubted(
        "guide-contradicts",
        "The images match worse near a guide.",
        "Check outlines and names in both scans.",
    );
    GUIDE_CUT = warned(
        "guide-cut",
        "The edge of a scan cuts a guide.",
        "Do not trust the result there.",
    );
    GUIDE_FOLDS = doubted(
        "guide-folds",
        "The field folds near a guide.",
        "View the place; correct the outline.",
    );
    GUIDE_LEFT_OUT = refused_or_warned(
        "guide-left-out",
        "A structure cannot guide: it is a bone, or not in both scans.",
        "Outline it in both, under one name.",
    );
    GUIDE_MISSED = doubted(
        "guide-missed",
        "A deformed guide misses the fraction's outline.",
        "View bones and tissue near it.",
    );
    LABEL_DOUBTFUL = doubted(
        "label-doubtful",
        "A label contains air or resembles its surroundings.",
        "View it.",
    );
    LABEL_ON_WRONG_SIDE = doubted(
        "label-on-wrong-side",
        "Labels lie on the side opposite their names.",
        "Check them.",
    );
    LABELS_DOUBLED = refused(
        "labels-doubled",
        "Two structures have one name.",
        "Rename or choose one with NAME=FILE.",
    );
    LABELS_ELSEWHERE = refused(
        "labels-elsewhere",
        "Masks lie on different grids.",
        "Resample them by nearest neighbour.",
    );
    LABELS_IGNORED = warned(
        "labels-ignored",
        "Labels of no known bone are ignored.",
        "Rename any that are bones.",
    );
    LABELS_JOINED = warned(
        "labels-joined",
        "Labels of one name become one structure.",
        "Rename different structures.",
    );
    LABELS_MIRRORED = refused(
        "labels-mirrored",
        "By their names, labels are reversed along an axis.",
        "Write CT and labels again; check sides.",
    );
    LABELS_NAMELESS = refused(
        "labels-nameless",
        "The file is neither mask nor named label map.",
        "Give masks, or add names.",
    );
    LABELS_OFF_BONE = refused(
        "labels-off-bone",
        "Labels miss the bones of the planning CT.",
        "Give this CT's labels; check for swapped scans.",
    );
    LABELS_OVERLAP = warned(
        "labels-overlap",
        "Structures overlap; the first keeps the voxels.",
        "Reorder the files if needed.",
    );
    SEGMENTS_LEFT_OUT = warned(
        "segments-left-out",
        "Segments of no known bone are left out.",
        "Name bones with --labels (TOML).",
    );
    SEGMENTS_ODD = refused(
        "segments-odd",
        "A segmentation is contradictory or unsupported.",
        "Export it with a number per segment.",
    );
    SEGMENTS_OVERLAP = refused(
        "segments-overlap",
        "Segments overlap; a label map cannot.",
        "Export separate segmentations, or contours.",
    );
    SEGMENTS_TERMS = doubted(
        "segments-terms",
        "A segment's label and term differ; the label counts.",
        "Correct one.",
    );
    STRUCTURE_EMPTY = warned(
        "structure-empty",
        "A structure has no volume.",
        "Check its contours or label number.",
    );
    STRUCTURE_VOLUME = warned(
        "structure-volume",
        "Sampled volume differs from that of the contours.",
        "Draw more planes.",
    );
    STRUCTURES_EMPTY = refused_or_warned(
        "structures-empty",
        "Structures have no closed contour; refused if none has.",
        "Check that they should be empty.",
    );
    STRUCTURES_FRAME = doubted(
        "structures-frame",
        "Structures of another frame of reference are left out.",
        "Export a set per image.",
    );
    STRUCTURES_LEFT_OUT = warned(
        "structures-left-out",
        "Points and open or short contours are left out.",
        "Draw structures as closed contours.",
    );
    STRUCTURES_NAMES = warned(
        "structures-names",
        "A name is repeated; the later gets its number.",
        "Rename one.",
    );
    STRUCTURES_NUMBERS = refused_or_warned(
        "structures-numbers",
        "ROI Numbers or types repeat; refused if ambiguous.",
        "Export with a number per structure.",
    );
    STRUCTURES_ODD = doubted(
        "structures-odd",
        "A structure with contradictory contours is left out.",
        "Draw or export it again.",
    );
    STRUCTURES_PLANES = refused_or_doubted(
        "structures-planes",
        "A structure off the others' planes is left out.",
        "Draw it on those planes.",
    );
    STRUCTURES_SEVERAL = refused(
        "structures-several",
        "The folder holds several structure sets, or none.",
        "Give the file you mean.",
    );
}
