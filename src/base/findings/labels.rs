//! Findings on labels and structures.

findings! {
    LABELS:
    CONTOURS_CANCEL = warned(
        "contours-cancel",
        "Contours of a structure cancel each other on a plane: what is enclosed twice counts as outside.",
        "Draw each part once; keep an inner contour only where it is a hole.",
    );
    CONTOURS_CROSS = warned(
        "contours-cross",
        "A contour crosses itself or another contour of its structure; what is enclosed twice counts as outside.",
        "Look at the planes named; draw the parts apart or as one.",
    );
    CONTOURS_REPEATED = warned(
        "contours-repeated",
        "A contour of a structure is drawn twice on one plane; one of each is kept.",
        "Export the structure again.",
    );
    LABEL_DOUBTFUL = doubted(
        "label-doubtful",
        "A bone's label hardly differs from its surroundings in HU, or contains air.",
        "Look at it in a viewer.",
    );
    LABEL_ON_WRONG_SIDE = doubted(
        "label-on-wrong-side",
        "A few labels lie on the other side than their names say.",
        "Check these labels.",
    );
    LABELS_DOUBLED = refused(
        "labels-doubled",
        "One name is given to two structures that are to be one label map.",
        "Name one of them otherwise with NAME=FILE, take one structure of a label map with NAME=FILE, or leave one out.",
    );
    LABELS_ELSEWHERE = refused(
        "labels-elsewhere",
        "Masks or label maps that are to be one lie on different grids.",
        "Resample them onto one grid with nearest-neighbour interpolation.",
    );
    LABELS_IGNORED = warned(
        "labels-ignored",
        "Labels that are no bones of the skeleton were ignored.",
        "Rename them if they are bones.",
    );
    LABELS_JOINED = warned(
        "labels-joined",
        "Several labels have one name; they are taken as one structure with the least of their numbers.",
        "Give each label its own name if they are different structures.",
    );
    LABELS_MIRRORED = refused(
        "labels-mirrored",
        "Left and right, front and back, or head and foot of the labels are exchanged, by their names.",
        "Write labels and CT anew from the DICOM series, and check the side of a known structure.",
    );
    LABELS_NAMELESS = refused(
        "labels-nameless",
        "A file is neither a mask of one structure nor a label map in which every label has a name.",
        "Give one mask per structure, or a label map with names in its header.",
    );
    LABELS_OFF_BONE = refused(
        "labels-off-bone",
        "The bone labels do not lie on the bones of the planning CT.",
        "Give the labels of this CT on its grid; the message says where they would lie on bone. Exchange planning and fraction where they were swapped.",
    );
    LABELS_OVERLAP = warned(
        "labels-overlap",
        "Two structures that become one label map have voxels in common.",
        "The one named first keeps them; give the files in another order if the other should.",
    );
    SEGMENTS_LEFT_OUT = warned(
        "segments-left-out",
        "Segments of a segmentation that are no bone by label or coded term are left out.",
        "Nothing, where they are no bones; else name them in a TOML file with --labels.",
    );
    SEGMENTS_ODD = refused(
        "segments-odd",
        "A segmentation contradicts itself: a number twice or undefined, no segment, no frame; or it is of a kind that is not read.",
        "Export it again, each segment with a number of its own.",
    );
    SEGMENTS_OVERLAP = refused(
        "segments-overlap",
        "Segments of a segmentation overlap, and a label map has one label for each voxel.",
        "Export segments that overlap as segmentations of their own, or as contours.",
    );
    SEGMENTS_TERMS = doubted(
        "segments-terms",
        "A segment is one bone by its label and another by its coded term; the label is taken.",
        "Correct the label or the term.",
    );
    STRUCTURE_EMPTY = warned(
        "structure-empty",
        "A structure of a dose-volume histogram has no volume.",
        "Check its contours, or the number of its label.",
    );
    STRUCTURE_VOLUME = warned(
        "structure-volume",
        "The volume sampled for a dose-volume histogram is not that of the contours.",
        "Contours far apart for their size leave the shape between them open: draw more planes.",
    );
    STRUCTURES_EMPTY = refused_or_warned(
        "structures-empty",
        "Structures of a structure set have no closed contour: refused where none has.",
        "Nothing, where they are meant to be empty.",
    );
    STRUCTURES_FRAME = doubted(
        "structures-frame",
        "A structure lies in another frame of reference than the CT or most of the set, and is left out.",
        "Export the structures of each image as a set of their own.",
    );
    STRUCTURES_LEFT_OUT = warned(
        "structures-left-out",
        "Points, open contours and contours of fewer than three points are left out.",
        "Nothing, where they mark points; else draw them as closed contours.",
    );
    STRUCTURES_NAMES = warned(
        "structures-names",
        "A structure set uses a name twice; later structures have their number behind the name.",
        "Rename one of them in the planning system.",
    );
    STRUCTURES_NUMBERS = refused_or_warned(
        "structures-numbers",
        "Several structures of a set have one ROI Number, or one has several types: refused where contours cannot be told apart.",
        "Export the structure set again, each structure with a number of its own.",
    );
    STRUCTURES_ODD = doubted(
        "structures-odd",
        "A structure has a contour that contradicts itself; the structure is left out.",
        "Draw or export that structure again.",
    );
    STRUCTURES_PLANES = refused_or_doubted(
        "structures-planes",
        "A structure does not lie on the planes of the others and is left out; refused where none is left.",
        "Draw the structure on the planes of the others.",
    );
    STRUCTURES_SEVERAL = refused(
        "structures-several",
        "A folder holds several structure sets, or none.",
        "Give the file of the one that is meant.",
    );
}
