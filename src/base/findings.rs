//! Everything that aventail warns of or refuses for a reason of its own: code, reason and remedy, in one table.
//!
//! A finding is raised by [`crate::warning::Warning::new`], [`crate::Error::refused`] or [`crate::Error::failed`] with its
//! code; `tests/findings.rs` proves that every code raised is in this table and that the table holds no others, and makes
//! `docs/refusals.md` from it.

mod dicom;
mod dose;
mod labels;

use dicom::DICOM;
use dose::DOSE;
use labels::LABELS;

/// How a finding is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Told {
    /// The run goes on and says so.
    Warned,
    /// Nothing is written.
    Refused,
    /// Refused where it is certain, warned of where it is doubtful.
    RefusedOrWarned,
}

/// One kind of finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finding {
    /// Stable kebab-case name.
    pub code: &'static str,
    /// How it is told.
    pub told: Told,
    /// What was found.
    pub reason: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

const fn warned(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::Warned, reason, remedy }
}

const fn refused(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::Refused, reason, remedy }
}

const fn refused_or_warned(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::RefusedOrWarned, reason, remedy }
}

/// All findings, by code.
pub const FINDINGS: &[Finding] = &joined::<ALL>([BEFORE, DICOM, DOSE, BETWEEN, LABELS, BEHIND]);

const ALL: usize = BEFORE.len() + DICOM.len() + DOSE.len() + BETWEEN.len() + LABELS.len() + BEHIND.len();

/// The parts of the table as one.
const fn joined<const N: usize>(parts: [&[Finding]; 6]) -> [Finding; N] {
    let mut all = [DICOM[0]; N];
    let (mut n, mut part) = (0, 0);
    while part < parts.len() {
        let mut at = 0;
        while at < parts[part].len() {
            all[n] = parts[part][at];
            (n, at) = (n + 1, at + 1);
        }
        part += 1;
    }
    all
}

/// Before those of DICOM.
const BEFORE: &[Finding] = &[
    warned(
        "bone-in-pieces",
        "A bone's label lies in several pieces.",
        "Check the label map: a part of another bone, or a bone cut by the scan's edge.",
    ),
    warned(
        "bone-not-explained",
        "A bone should be in view of the fraction CT, but its contrast is not found there; it follows its joint.",
        "Look at it in the fusion images; its place is a guess.",
    ),
    warned(
        "bone-without-parent",
        "None of the bones that carry a bone is labelled.",
        "Label them, or set the bone's parent in skeleton.toml.",
    ),
    warned(
        "bones-apart",
        "A joint's gap has grown by more than its play.",
        "Check labels and fusion images at that joint.",
    ),
    warned(
        "bones-auto",
        "The bone labels are TotalSegmentator's, made by `--bones auto`; nobody has looked at them.",
        "Look at the label map in a viewer; correct it under another name, and give that with --bones.",
    ),
    refused(
        "bones-auto-changed",
        "Labels that `--bones auto` made are no longer what its record beside them says.",
        "Give the label map with --bones if it was corrected by hand; else remove both files, and they are made anew.",
    ),
    warned(
        "bones-auto-partial",
        "A further task of TotalSegmentator failed: the mandible or the hyoid has no label and moves with what is about it.",
        "Read what TotalSegmentator says when that task is run by hand.",
    ),
    warned(
        "bones-by-label",
        "No label of --bones has a known bone's name; every label counts as one rigid bone.",
        "Give names with --labels.",
    ),
    warned(
        "bones-lost",
        "A share of the bones in view, by volume, is not found in the fraction CT.",
        "Look at the bones named in the fusion images before anything else.",
    ),
    warned(
        "bones-meet",
        "Cells between touching bones are folded: rigid bones slide or collide there.",
        "Do not trust the field in the joint itself.",
    ),
    refused(
        "bones-not-found",
        "Less than half of the bones in view, by volume, are found in the fraction CT.",
        "Give two CTs of one patient and region, or place the bones with --bone-landmarks.",
    ),
    warned(
        "bones-outside",
        "A bone of a structure set has no voxel in the planning CT.",
        "Check that the structure set belongs to this CT; the bone is left out.",
    ),
    warned("bones-overlap", "Moved bones lie in each other.", "Check labels and fusion images of the two bones."),
    refused_or_warned(
        "bones-unnamed",
        "Structures of a structure set have names that are no bone's: refused where none is a bone or none lies in the image.",
        "Name them as TG-263 or TotalSegmentator do, or give a TOML file of names with --labels.",
    ),
    warned(
        "contours-cancel",
        "Contours of a structure cancel each other on a plane: what is enclosed twice counts as outside.",
        "Draw each part once; keep an inner contour only where it is a hole.",
    ),
    warned(
        "contours-cross",
        "A contour crosses itself or another contour of its structure; what is enclosed twice counts as outside.",
        "Look at the planes named; draw the parts apart or as one.",
    ),
    warned(
        "contours-repeated",
        "A contour of a structure is drawn twice on one plane; one of each is kept.",
        "Export the structure again.",
    ),
    warned(
        "cut-fraction",
        "A part of the fraction's grid was not measured: it lies beyond a reconstruction's circle, or is blank.",
        "Out of view bones follow their joints; see the map of uncertainty before contours there are used.",
    ),
];

/// Between those of doses and of labels.
const BETWEEN: &[Finding] = &[
    warned(
        "energy-outside",
        "More than 1 % of the dose's energy falls outside the target grid.",
        "Give a larger --grid.",
    ),
    warned(
        "extension-damaged",
        "A NIfTI header extension is cut off or has an impossible size.",
        "Write the file anew; label names may be missing.",
    ),
    warned("few-fractions", "Modes of few fractions are hardly known.", "Fit more fractions; see docs/library.md."),
    refused_or_warned(
        "field-direction",
        "A field is used the other way round than its header tells, or lies on the grid of the wrong image for its role.",
        "Give it as the field of the other direction, or the field that belongs there.",
    ),
    warned(
        "fit-iterations",
        "The fit stopped at its iteration limit while it still moved bones.",
        "Look at the bones named; raise fit.max_iterations if they are off.",
    ),
    warned(
        "folded",
        "Tissue cells outside bone contact and sliding interfaces are folded.",
        "See the Jacobian map; do not map dose there.",
    ),
    refused(
        "folder-of-another-run",
        "A result would take the place of a file that another command's run has written into the same folder.",
        "Give another --out: a folder holds one run.",
    ),
    warned("folds-in-steep-dose", "The field folds where the dose is steep.", "Do not trust the mapped dose there."),
    refused(
        "fraction-mirrored",
        "The fraction CT shows the mirror image of the planning CT: mirrored left to right, the bones explain it better.",
        "Correct the x axis of the wrong header, after a look at the heart, the liver or a marked side.",
    ),
    refused_or_warned(
        "fraction-scaled",
        "The fraction CT shows the planning CT's bones at another scale along an axis.",
        "Compare voxel spacing and slice thickness of both files with their DICOM series.",
    ),
    refused(
        "fraction-turned",
        "No bones are found; turned or mirrored otherwise they would be.",
        "Correct the direction in the wrong header, or give scans of one position of the patient.",
    ),
    refused(
        "header-field",
        "A field of an image's header changes values or geometry in a way that is not supported, or contradicts another field.",
        "Correct the field that the message names, or write the file again with another tool.",
    ),
    warned(
        "hu-doubtful",
        "Air does not lie near -1000 HU: the HU look scaled.",
        "Compare RescaleSlope and RescaleIntercept with the DICOM series.",
    ),
    warned(
        "images-mislead",
        "Images draw soft tissue and agree no better for it, as with streaks of metal, noise or another machine's grey values.",
        "Bones alone carry that tissue; look at the fusion there, and at the map of uncertainty.",
    ),
    warned(
        "input-changed",
        "A file is not the one that the recorded run has read.",
        "Run it on the recorded file, or take the result as a new one.",
    ),
    refused(
        "input-overwritten",
        "A result would take the place of an input, by its own path, through a link or under another name.",
        "Give another --out, or copy the input elsewhere.",
    ),
    warned(
        "inverse",
        "Tissue voxels of the fraction CT have no exact pre-image.",
        "They show nothing of the planning scan; see the masks.",
    ),
    warned("joint-limit", "A joint lies beyond its soft range.", "Check the label and the fusion images."),
];

/// Behind those of labels.
const BEHIND: &[Finding] = &[
    warned(
        "landmarks-outside",
        "Landmarks lie where no displacement was computed: in air, or outside the patient.",
        "Check their positions and their space (LPS or RAS); their residuals tell nothing of the tissue.",
    ),
    warned(
        "landmarks-worse",
        "Landmarks are farther off after the registration than under the couch shift alone.",
        "Look at the fusion images there; check that both positions show the same point.",
    ),
    warned(
        "level-unsure",
        "The fraction CT shows a short piece of the spine that would fit another level nearly as well.",
        "Check the levels in the fusion images; place a vertebra with --bone-landmarks.",
    ),
    warned(
        "levels-shifted",
        "Names of vertebrae contradict a landmark: the skull on C1, C1's ring and C2's dens, the ribs, the sacrum.",
        "Count the levels from the landmark that the message names.",
    ),
    warned(
        "no-inverse",
        "Points or voxels have no exact pre-image in a field that had to be inverted.",
        "Give the field of the other direction.",
    ),
    warned(
        "no-orientation",
        "A header does not tell where the patient's left, back and head are.",
        "Check orientation in a viewer, and write the file with a full header.",
    ),
    refused(
        "no-run",
        "A folder to inspect holds no report: no run, or one that was not finished.",
        "Give the --out folder of a finished run, or files.",
    ),
    warned(
        "no-spacing",
        "A header does not tell how far voxels lie apart; 1 mm is taken.",
        "Write the file with its spacing.",
    ),
    warned(
        "no-tissue",
        "The planning CT shows no tissue above the least HU inside the patient.",
        "Check that it is a CT in HU.",
    ),
    refused(
        "not-in-hu",
        "An image that must be a CT in HU has no air or no soft tissue where HU have them.",
        "Set slope and offset as the DICOM series has them, or give the CT: the message names what would mend it.",
    ),
    warned(
        "not-scaled",
        "A voxel-wise quantity was carried without scaling it by the change of volume.",
        "Add --scale-by-jacobian if it is an amount per voxel.",
    ),
    warned(
        "orientation-contradicts",
        "A MetaImage's AnatomicalOrientation is not what its matrix says; the matrix is used.",
        "Check left, right, front and back in a viewer, and write the file anew.",
    ),
    refused("other-planning", "Runs to be fitted differ in planning CT or labels.", "Give runs of one planning CT."),
    warned(
        "outside-field",
        "A part of the input (share of volume; of dose the share of the dose) lies outside a field and was not moved by it.",
        "Give a field that covers the input, or crop the input.",
    ),
    refused_or_warned(
        "pixdim-sform-disagree",
        "The voxel spacing (pixdim) and the sform of a NIfTI file differ: readers of the one and the other see another size.",
        "Find out which one is right, and write the file anew.",
    ),
    refused("postures-implausible", "Draw after draw is implausible.", "Lower the deviations, or raise the limits."),
    warned(
        "qform-invalid",
        "A NIfTI qform is set but is no valid geometry; the sform is used.",
        "Write the file anew.",
    ),
    refused(
        "row-length",
        "A row of a CSV table has another number of cells than its first row.",
        "Give every row as many cells; put texts with commas into quotation marks, write decimals with a point.",
    ),
    refused(
        "run-changed",
        "Files of a run are missing, changed, or of another run than its report tells of.",
        "Run it again into a new folder.",
    ),
    warned(
        "sform-qform-disagree",
        "The sform and the qform of a NIfTI file place the image differently.",
        "Find out which one is right, and write the file anew.",
    ),
    warned(
        "shaded-fraction",
        "The fraction's grey values are a cone-beam CT's: shaded, or of another scale.",
        "Shading was taken out by planning's grey values; look at the fusion images in soft tissue.",
    ),
    warned(
        "side-unsure",
        "The bones are too nearly symmetric to tell a mirrored fraction CT from a true one.",
        "Check left and right in the fusion images.",
    ),
    warned(
        "skin-meets-skin",
        "The moved patient lies on himself: skin passes through skin.",
        "Do not trust dose or contours there.",
    ),
    warned("sliding", "Cells of declared sliding interfaces are folded.", "Motion may be discontinuous there."),
    warned("small-bone", "A bone has very few voxels.", "Its pose mostly follows its joint."),
    refused(
        "space-unknown",
        "A bare 4x4 matrix, a mesh or an .fcsv does not tell whether its coordinates are LPS or RAS.",
        "Say it with --space, or of one matrix as FILE#ras or FILE#lps; convert FSL's matrices first.",
    ),
    warned("spine-order", "A vertebra lies against the order of its number.", "Check whether two labels are swapped."),
    warned(
        "start-left",
        "The bones were found far from the start that --start gives, or another place explains more of them.",
        "Check that it takes planning to this fraction, and the fusion images.",
    ),
    warned(
        "structure-empty",
        "A structure of a dose-volume histogram has no volume.",
        "Check its contours, or the number of its label.",
    ),
    warned(
        "structure-outside-dose",
        "A structure lies partly or wholly outside the dose's grid.",
        "Compute the dose on a grid that holds it; what lies outside counts with 0 Gy, or is not known if it is all.",
    ),
    warned(
        "structure-volume",
        "The volume sampled for a dose-volume histogram is not that of the contours.",
        "Contours far apart for their size leave the shape between them open: draw more planes.",
    ),
    refused_or_warned(
        "structures-empty",
        "Structures of a structure set have no closed contour: refused where none has.",
        "Nothing, where they are meant to be empty.",
    ),
    warned(
        "structures-left-out",
        "Points, open contours and contours of fewer than three points are left out.",
        "Nothing, where they mark points; else draw them as closed contours.",
    ),
    warned(
        "structures-names",
        "A structure set uses a name twice; later structures have their number behind the name.",
        "Rename one of them in the planning system.",
    ),
    refused(
        "structures-planes",
        "Contours of a structure set do not lie on parallel planes.",
        "Leave out the structure, or draw it on the planes of the others.",
    ),
    refused(
        "structures-several",
        "A folder holds several structure sets, or none.",
        "Give the file of the one that is meant.",
    ),
    warned(
        "uncertain-field-in-steep-dose",
        "The field's own residual changes the dose by more than 1 % of its maximum.",
        "Do not trust the mapped dose there.",
    ),
    warned(
        "vertebra-missing",
        "A vertebra is missing between others, or two lie too far apart.",
        "Check the numbering.",
    ),
    warned("volume-change", "Organs did not change their volume as asked.", "See the table of volumes in the report."),
    warned("weak-start", "The couch shift explains little of the bones' contrast.", "Look at the fusion images first."),
];
