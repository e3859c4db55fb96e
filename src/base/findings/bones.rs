//! Findings on bones, joints and the spine.

findings! {
    BONES:
    BONE_IN_PIECES = warned(
        "bone-in-pieces",
        "A bone's label lies in several pieces.",
        "Check the label map: a part of another bone, or a bone cut by the scan's edge.",
    );
    BONE_NOT_EXPLAINED = doubted(
        "bone-not-explained",
        "A bone should be in view of the fraction CT, but its contrast is not found there; it follows its joint.",
        "Look at it in the fusion images; its place is a guess.",
    );
    BONE_WITHOUT_PARENT = warned(
        "bone-without-parent",
        "None of the bones that carry a bone is labelled.",
        "Label them, or set the bone's parent in skeleton.toml.",
    );
    BONES_APART = doubted(
        "bones-apart",
        "A joint's gap has grown by more than its play.",
        "Check labels and fusion images at that joint.",
    );
    BONES_AUTO = doubted(
        "bones-auto",
        "The bone labels are TotalSegmentator's, made by `--bones auto`; nobody has looked at them.",
        "Look at the label map in a viewer; correct it under another name, and give that with --bones.",
    );
    BONES_AUTO_CHANGED = refused(
        "bones-auto-changed",
        "The labels made by `--bones auto` have changed since its record was written.",
        "Give the label map with --bones if it was corrected by hand; else remove both files, and they are made anew.",
    );
    BONES_AUTO_PARTIAL = warned(
        "bones-auto-partial",
        "A further task of TotalSegmentator failed: the mandible or the hyoid has no label and moves with the surrounding tissue.",
        "Read what TotalSegmentator says when that task is run by hand.",
    );
    BONES_BY_LABEL = doubted(
        "bones-by-label",
        "No label of --bones has a known bone's name; every label counts as one rigid bone.",
        "Give names with --labels.",
    );
    BONES_LOST = doubted(
        "bones-lost",
        "A share of the bones in view, by volume, is not found in the fraction CT.",
        "Look at the bones named in the fusion images before anything else.",
    );
    BONES_MEET = warned(
        "bones-meet",
        "Cells between touching bones are folded: rigid bones slide or collide there.",
        "Do not trust the field in the joint itself.",
    );
    BONES_NOT_FOUND = refused(
        "bones-not-found",
        "Less than half of the bones in view, by volume, are found in the fraction CT.",
        "Give two CTs of one patient and region, or place the bones with --start or --bone-landmarks.",
    );
    BONES_OUTSIDE = warned(
        "bones-outside",
        "A bone of a structure set has no voxel in the planning CT.",
        "Check that the structure set belongs to this CT; the bone is left out.",
    );
    BONES_OVERLAP = doubted(
        "bones-overlap",
        "After the registration, bones overlap.",
        "Check labels and fusion images of the two bones.",
    );
    BONES_UNNAMED = refused_or_warned(
        "bones-unnamed",
        "Some structures are not named as bones. Refused if none is, or if none lies in the image.",
        "Name them as TG-263 or TotalSegmentator do, or give a TOML file of names with --labels.",
    );
    FRACTION_LABEL_CONTRADICTS = doubted(
        "fraction-label-contradicts",
        "The image places a bone more than 3 mm from where its labels in both scans say.",
        "Look at both labels and the fusion images; correct the label that is wrong, or leave it out.",
    );
    FRACTION_LABEL_UNLIKE = doubted(
        "fraction-label-unlike",
        "A bone's labels in planning and fraction do not fit each other rigidly; they are not used.",
        "Check both labels in a viewer: one may be cut, of another bone, or torn.",
    );
    JOINT_LIMIT = doubted(
        "joint-limit",
        "A joint lies beyond its soft range.",
        "Check the label and the fusion images.",
    );
    LEVELS_SHIFTED = doubted(
        "levels-shifted",
        "Names of vertebrae contradict a landmark: the skull on C1, C1's ring and C2's dens, the ribs, the sacrum.",
        "Count the levels from the landmark that the message names.",
    );
    SMALL_BONE = warned(
        "small-bone",
        "A bone has very few voxels.",
        "Its pose mostly follows its joint.",
    );
    SPINE_ORDER = doubted(
        "spine-order",
        "A vertebra lies against the order of its number.",
        "Check whether two labels are swapped.",
    );
    VERTEBRA_MISSING = doubted(
        "vertebra-missing",
        "A vertebra is missing between others, or two lie too far apart.",
        "Check the numbering.",
    );
}
