//! Findings on bones, joints and the spine.

findings! {
    BONES:
    BONE_BY_SKIN = doubted(
        "bone-by-skin",
        "A bone is not found in the image; the skin around it places it.",
        "Check the fusion images.",
    );
    BONE_IN_PIECES = warned(
        "bone-in-pieces",
        "A bone's label lies in several pieces.",
        "Check it, unless the scan's edge cuts it.",
    );
    BONE_NOT_EXPLAINED = doubted(
        "bone-not-explained",
        "Too little of a bone's contrast is found to place it; it follows its joint.",
        "Check the fusion images.",
    );
    BONE_UNLIKE = doubted(
        "bone-unlike",
        "The image explains a bone worse than the others.",
        "Check its label and the fusion images.",
    );
    BONE_WITHOUT_PARENT = warned(
        "bone-without-parent",
        "No bone that carries this one is labelled.",
        "Label one, or set `parent` in skeleton.toml.",
    );
    BONES_APART = doubted(
        "bones-apart",
        "A joint's gap grew by more than its play.",
        "Check labels and fusion images.",
    );
    BONES_AUTO = doubted(
        "bones-auto",
        "Nobody has checked the labels of `--bones auto`.",
        "View them; give a corrected copy with --bones.",
    );
    BONES_AUTO_CHANGED = refused(
        "bones-auto-changed",
        "The labels of `--bones auto` have changed.",
        "Give corrected ones with --bones, or remove both files.",
    );
    BONES_AUTO_PARTIAL = warned(
        "bones-auto-partial",
        "TotalSegmentator failed on a bone, which moves as tissue.",
        "Run that task by hand.",
    );
    BONES_BY_LABEL = doubted(
        "bones-by-label",
        "No label has a bone's name; each counts as one rigid bone.",
        "Give names with --labels.",
    );
    BONES_LOST = doubted(
        "bones-lost",
        "Bones in view are not placed by the image.",
        "Check the fusion images first.",
    );
    BONES_MEET = warned(
        "bones-meet",
        "Cells between touching bones are folded.",
        "Do not trust the field inside the joint.",
    );
    BONES_NOT_FOUND = refused(
        "bones-not-found",
        "Most bones in view are not found.",
        "Check the scans; give --start or --bone-landmarks.",
    );
    BONES_OUTSIDE = warned(
        "bones-outside",
        "A bone outside the planning CT is left out.",
        "Check the structure set.",
    );
    BONES_OVERLAP = doubted(
        "bones-overlap",
        "Moved bones overlap.",
        "Check labels and fusion images.",
    );
    BONES_UNNAMED = refused_or_warned(
        "bones-unnamed",
        "Structures are not named as bones; refused without any bone.",
        "Use TG-263's names, or --labels (TOML).",
    );
    FRACTION_LABEL_CONTRADICTS = doubted(
        "fraction-label-contradicts",
        "Image and labels place a bone over 3 mm apart.",
        "Correct or omit the wrong one.",
    );
    FRACTION_LABEL_UNLIKE = doubted(
        "fraction-label-unlike",
        "A bone's two labels do not match; unused.",
        "Check both for cuts or another bone.",
    );
    JOINT_LIMIT = doubted(
        "joint-limit",
        "A joint lies beyond its soft range.",
        "Check labels and fusion images.",
    );
    LEVELS_SHIFTED = doubted(
        "levels-shifted",
        "Vertebra names contradict skull, C1, C2, ribs or sacrum.",
        "Count from the landmark named.",
    );
    SMALL_BONE = warned(
        "small-bone",
        "A bone has very few voxels.",
        "Expect it to follow its joint.",
    );
    SPINE_ORDER = doubted(
        "spine-order",
        "A vertebra lies against its number's order.",
        "Check for swapped labels.",
    );
    VERTEBRA_MISSING = doubted(
        "vertebra-missing",
        "A vertebra is missing, or two are too distant.",
        "Check the numbering.",
    );
}
