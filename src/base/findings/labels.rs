//! Findings on labels.

use super::{Finding, refused, warned};

/// Those whose codes begin with `label`.
pub(super) const LABELS: &[Finding] = &[
    warned(
        "label-doubtful",
        "A bone's label hardly stands out from what is beside it, or holds air.",
        "Look at it in a viewer.",
    ),
    warned("label-on-wrong-side", "A few labels lie on the other side than their names say.", "Check these labels."),
    refused(
        "labels-doubled",
        "One name is given to two structures that are to be one label map.",
        "Name one of them otherwise with NAME=FILE, take one structure of a label map with NAME=FILE, or leave one out.",
    ),
    refused(
        "labels-elsewhere",
        "Masks or label maps that are to be one lie on different grids.",
        "Resample them onto one grid with nearest-neighbour interpolation.",
    ),
    warned(
        "labels-ignored",
        "Labels that are no bones of the skeleton were ignored.",
        "Rename them if they are bones.",
    ),
    warned(
        "labels-joined",
        "Several labels have one name; they are taken as one structure with the least of their numbers.",
        "Give each label its own name if they are different structures.",
    ),
    refused(
        "labels-mirrored",
        "Left and right, front and back, or head and foot of the labels are exchanged, by their names.",
        "Write labels and CT anew from the DICOM series, and check the side of a known structure.",
    ),
    refused(
        "labels-nameless",
        "A file is neither a mask of one structure nor a label map in which every label has a name.",
        "Give one mask per structure, or a label map with names in its header.",
    ),
    refused(
        "labels-off-bone",
        "The bone labels do not lie on the bones of the planning CT.",
        "Give the labels of this CT on its grid; the message says where they would lie on bone. Exchange planning and fraction where they were swapped.",
    ),
    warned(
        "labels-overlap",
        "Two structures that become one label map have voxels in common.",
        "The one named first keeps them; give the files in another order if the other should.",
    ),
];
