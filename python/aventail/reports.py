"""Types of the dicts that reports and measures return.

Lengths are in mm, doses in Gy, positions in LPS mm; docs/metrics.md has the formulas.
"""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Summary(TypedDict):
    """Statistics of ``n`` values; ``std`` is the sample standard deviation (n - 1)."""

    n: int
    mean: float
    std: float
    median: float
    p95: float
    min: float
    max: float


class Warned(TypedDict):
    """A warning: its code (docs/refusals.md) and its text."""

    code: str
    message: str


class _InputFile(TypedDict):
    role: str
    path: str
    sha256: str


class InputFile(_InputFile, total=False):
    """An input file; ``about`` is present for DICOM series only."""

    about: dict[str, Any]


class OutputFile(TypedDict):
    """A file that was written."""

    name: str
    what: str
    sha256: str


class Grid(TypedDict):
    """A grid: number of voxels and spacing along x, y, z; the direction matrix row by row."""

    size: list[int]
    spacing: list[float]
    origin: list[float]
    direction: list[list[float]]


class Transform(TypedDict):
    """A rigid transform: quaternion (x, y, z, w) and translation (mm)."""

    rotation: list[float]
    translation: list[float]


class JointMotion(TypedDict):
    """A joint's rotation vector (radians) and shift (mm), along the joint's axes."""

    rotation: list[float]
    translation: list[float]


class Pose(TypedDict):
    """Motion of each joint, in the order of the bones."""

    joints: list[JointMotion]


class BeyondRange(TypedDict):
    """How far a joint moved beyond its soft range."""

    rotation_deg: float
    shift_mm: float


class BoneFit(TypedDict):
    """How a bone was fitted.

    ``visible`` is the share of its sample points inside the fraction image. ``similarity_before``
    is the similarity after the couch shift alone; both similarities have 1 as the best value.
    ``unsettled_mm`` is how far the next step would have moved the bone. ``position_sd_mm`` and
    ``rotation_sd_deg`` are standard deviations along the worst axis. ``motion_mm`` is the mean
    displacement of its points.
    """

    name: str
    transform: Transform
    visible: float
    similarity_before: float | None
    similarity_after: float | None
    stop: str
    unsettled_mm: float
    position_sd_mm: float
    rotation_sd_deg: float
    beyond_range: BeyondRange
    motion_mm: float
    determined_by: str


class BoneRigidity(TypedDict):
    """How rigidly the field moves a bone: distances from the closest rigid transform, ``best``."""

    name: str
    voxels: int
    best: Transform
    rms_mm: float
    max_mm: float


class JacobianStats(TypedDict):
    """Statistics of the Jacobian determinant (volume after / before) over some of the cells.

    Where ``cells`` is 0 the figures say nothing.
    """

    cells: int
    folded: int
    folded_percent: float
    above_2_percent: float
    below_half_percent: float
    mean: float
    min: float
    p1: float
    p99: float
    max: float


class _JacobianReport(TypedDict):
    all: JacobianStats
    body: JacobianStats
    soft_tissue: JacobianStats
    contact: JacobianStats
    interface: JacobianStats
    folded_outside: int
    across: int
    bones: list[list[Any]]
    digital_folded: int
    jumps_above_10: int


class JacobianReport(_JacobianReport, total=False):
    """Jacobian characteristics; ``bones`` are pairs of a name and :class:`JacobianStats`.

    ``folded_at`` is where most of the folded cells lie.
    """

    folded_at: list[float]


class BoneOverlap(TypedDict):
    """Two bones that overlap."""

    bones: list[str]
    depth_mm: float
    at: list[float]


class JointGap(TypedDict):
    """The gap of a joint before and after."""

    bones: list[str]
    planning_mm: float
    fraction_mm: float
    play_mm: float


class Contact(TypedDict):
    """Bones that overlap or come apart, and skin on skin."""

    overlaps: list[BoneOverlap]
    joints: list[JointGap]
    skin_voxels: int
    skin_ml: float


class VolumeReached(TypedDict):
    """An organ whose volume was asked to change."""

    organ: str
    factor: float
    reached: float | None


class SoftTissue(TypedDict):
    """Uncertainty over soft tissue, mm.

    ``median`` and ``p95`` are of all soft tissue, where what is unknown counts as more than all that
    is known: ``None`` is above 30 mm. The others are of what is known.
    """

    n: int
    mean: float
    std: float
    median: float | None
    p95: float | None
    min: float
    max: float


class Lung(TypedDict):
    """Uncertainty over lung and airways: volume in ml, figures in mm, and ml above 2 mm or unknown."""

    ml: float
    mm: SoftTissue
    above_2mm_ml: float


class Uncertainty(TypedDict):
    """Summary of the uncertainty map.

    ``without_images_percent`` is the share of soft tissue where the images show nothing,
    ``unknown_percent`` the share where the error is unknown. ``above_2mm_ml`` is the volume with
    more than 2 mm or unknown.
    """

    soft_tissue_mm: SoftTissue
    without_images_percent: float
    unknown_percent: float
    above_2mm_ml: float
    lung: Lung | None


class Pruning(TypedDict):
    """Waves of the chain mail that were pruned (``waves`` of ``of``), and the largest effect that this can have."""

    waves: int
    of: int
    each_percent: float
    together_percent: float
    most_mm: float


class Links(TypedDict):
    """Chain-mail links of the result; ``violated`` ones lie outside their valid range, by the excess."""

    links: int
    violated: int
    violated_percent: float
    mean_excess_mm: float
    p95_excess_mm: float
    max_excess_mm: float


class Inverse(TypedDict):
    """How well the pull field inverts the push field.

    ``unconverged`` counts voxels that missed the tolerance, ``unconverged_tissue`` those of them in
    the patient. ``multiple`` voxels have several pre-images; ``outside`` voxels have theirs outside
    the planning scan.
    """

    residual_mm: Summary
    unconverged: int
    unconverged_tissue: int
    strayed: int
    unconverged_max_mm: float
    multiple: int
    outside: int
    voxels: int


class Consistency(TypedDict):
    """Inverse consistency: planning to fraction and back through both stored fields."""

    there_and_back_mm: Summary
    beyond: int
    beyond_before: int
    moved_mm: float


class Landmark(TypedDict):
    """A point known in both images."""

    name: str
    planning: list[float]
    fraction: list[float]


class Residual(TypedDict):
    """Error of a landmark before and after, mm; ``mapped`` and ``after`` are ``None`` outside the planning grid."""

    landmark: Landmark
    mapped: list[float] | None
    before: float
    after: float | None


class _LandmarkReport(TypedDict):
    each: list[Residual]
    before: Summary
    after: Summary
    mean_of_ratios: float
    std_of_ratios: float
    ratio_of_means: float


class LandmarkReport(_LandmarkReport, total=False):
    """Landmark errors; ``shifted`` is the error after the couch shift alone."""

    shifted: Summary


class Verdict(TypedDict):
    """A judged value: its limits, the verdict, the reason, and what to do about it.

    ``value`` is ``None`` where it is unknown.
    """

    name: str
    value: float | None
    unit: str
    limit: str
    source: str
    verdict: Literal["pass", "review", "fail"]
    reason: str
    remedy: str


class Stage(TypedDict, total=False):
    """Run time of a stage; ``processor_seconds`` is present if the system reports it."""

    stage: str
    seconds: float
    processor_seconds: float


class CouchResidual(TypedDict):
    """Residual of a bone after the couch shift: root mean square over its points, mm."""

    bone: str
    matched: bool
    shift_mm: float
    rotation_mm: float


class CouchMatch(TypedDict):
    """Setup error of the patient, planning to fraction, matched on bones. The couch correction is the opposite.

    ``shift_mm`` is the translation alone, LPS mm. ``rotation_deg`` is a rotation vector about
    ``centre``, degrees.
    """

    on: list[str]
    chosen: str
    shift_mm: list[float]
    rotation_deg: list[float]
    centre: list[float]
    residuals: list[CouchResidual]


class TissueAgreement(TypedDict):
    """Mean local correlation of the images in one kind of tissue: as scanned, after the couch shift, after registration."""

    compared_ml: float
    before: float | None
    couch: float | None
    after: float
    worse_percent: float


class Agreement(TypedDict):
    """How well the images agree, at bones and in soft tissue."""

    bones: TissueAgreement | None
    soft_tissue: TissueAgreement | None
    alone: str


class OutlineAgreement(TypedDict):
    """Agreement of two outlines of a structure: Dice, mean and 95th percentile of the distance."""

    dice: float
    mean_mm: float
    p95_mm: float


class GuideReached(TypedDict):
    """A guide: agreement of its outlines without guides (``before``) and with them (``after``).

    ``images`` is the correlation of the images near its surface, without and with guides.
    ``folded`` counts folded cells near its surface.
    """

    name: str
    planning_ml: float
    fraction_ml: float
    before: OutlineAgreement | None
    after: OutlineAgreement | None
    images: list[float] | None
    folded: int


class _Report(TypedDict):
    version: str
    created: int
    command: str
    folder: str
    inputs: list[InputFile]
    settings: dict[str, Any]
    verdicts: list[Verdict]
    planning_grid: Grid
    fraction_grid: Grid
    common_shift: list[float]
    couch: CouchMatch
    bones: list[BoneFit]
    own_motion_mm: list[float]
    pose: Pose
    rigidity: list[BoneRigidity]
    jacobian: JacobianReport
    contact: Contact
    volume_changes: list[VolumeReached]
    guides: list[GuideReached]
    uncertainty: Uncertainty | None
    pruning: Pruning | None
    links: Links
    inverse: Inverse
    consistency: Consistency
    landmarks: LandmarkReport | None
    warnings: list[Warned]
    stages: list[Stage]
    threads: int
    peak_memory: int | None
    outputs: list[OutputFile]


class SearchedPlace(TypedDict):
    """A position of all bones that the search proposed; it runs if the start is unclear."""

    proposed_by: list[str]
    evidence_percent: float
    apart_mm: float
    shift_mm: list[float]


class FittedPlace(TypedDict):
    """A position where all bones were fitted. The first of several is the result."""

    level: list[str] | None
    apart_mm: float
    evidence_percent: float
    probability_percent: float


class Report(_Report, total=False):
    """The numbers of a run.

    ``verdict`` is the worst of ``verdicts``. ``own_motion_mm`` is the motion of each bone's
    centroid without the couch shift. ``fraction_kind`` is present if images moved soft tissue.
    """

    agreement: Agreement
    search: list[SearchedPlace]
    places: list[FittedPlace]
    verdict: Literal["pass", "review", "fail"]
    fraction_kind: dict[str, Any]


class Distances(TypedDict):
    """Distances between two surfaces."""

    centre_of_mass_mm: float
    mean_mm: float
    hausdorff_95_mm: float
    hausdorff_mm: float


class ContourMetrics(TypedDict):
    """A mapped structure compared with that of the fraction."""

    name: str
    mapped_ml: float
    reference_ml: float
    dice: float
    distances: Distances | None


class ThereAndBack(TypedDict):
    """Distance after mapping there and back; ``outside`` counts voxels that leave the fields' grids."""

    distance_mm: Summary
    outside: int


class SimilarityFigures(TypedDict):
    """Similarity measures of two CTs."""

    voxels: int
    ncc: float
    mse: float
    rms_hu: float
    mae_hu: float
    nmi: float


class Similarity(TypedDict):
    """Similarity of the CTs before and after registration."""

    before: SimilarityFigures
    after: SimilarityFigures


class MeanShift(TypedDict):
    """One shift of the whole scan, LPS mm; ``of`` says what it is, ``alone`` is ``couch`` or ``mean``."""

    mm: list[float]
    of: str
    alone: str


class Assessment(TypedDict):
    """The measures of a field; those whose inputs were not given are ``None`` or empty.

    ``regularity`` has pairs of a direction and its measures. ``inverse_consistency`` has two
    entries: starting in planning, and starting in the fraction. ``domain`` says where: ``tissue``,
    ``mask`` or ``grid`` (the whole grid, air included).
    """

    regularity: list[list[Any]]
    shift: MeanShift | None
    landmarks: LandmarkReport | None
    contours: list[ContourMetrics]
    rigidity: list[BoneRigidity]
    inverse_consistency: list[ThereAndBack]
    inversion: Inverse | None
    transitivity: ThereAndBack | None
    similarity: Similarity | None
    agreement: Agreement | None
    verdicts: list[Verdict]
    measured_in: str
    domain: Literal["tissue", "mask", "grid"]
    bones_known: bool


class Outside(TypedDict):
    """The part that lies outside a grid; ``amount_percent`` is its share of the sum (of a dose: of the integral dose)."""

    volume_ml: float
    volume_percent: float
    amount_percent: float


class Balance(TypedDict):
    """Energy (J) and mass (g) before and after mapping."""

    source_j: float
    mapped_j: float
    outside_j: float
    relative_error: float
    source_g: float
    mapped_g: float


class Caution(TypedDict):
    """Where a mapped dose is doubtful.

    ``folded_or_outside`` counts voxels with a steep dose where the field folds or leaves the image,
    ``folded`` those of them where it folds. ``uncertain`` counts those where the field's residual
    times the dose gradient exceeds 1 % of the maximum dose. ``ml`` is the volume of both;
    ``greatest_gy`` is the largest residual times gradient.
    """

    folded_or_outside: int
    folded: int
    uncertain: int
    ml: float
    greatest_gy: float


class DoseReport(TypedDict):
    """Checks of a mapped dose.

    ``by_given`` tells whether the dose went through a field that was given; an ``inversion`` then
    serves checks alone.
    """

    direction: str
    method: Any
    balance: Balance | None
    inversion: Inverse | None
    by_given: bool
    outside: Outside
    caution: Caution
    warnings: list[Warned]


class Share(TypedDict):
    """Percentage of the volume that receives at least ``gy``."""

    gy: float
    percent: float


class Dvh(TypedDict):
    """A structure's dose-volume histogram.

    The share ``cumulative[n]`` of the volume, 0 to 1, receives at least ``n * bin`` Gy.
    ``volume_ml`` is the sampled volume, ``own_ml`` the structure's own. ``outside_ml`` lies outside
    the dose grid and counts with 0 Gy, unless all of the structure does.
    """

    name: str
    volume_ml: float
    own_ml: float
    outside_ml: float
    mean: float
    min: float
    max: float
    d98: float
    d95: float
    d50: float
    d2: float
    d003cc: float
    v: list[Share]
    cumulative: list[float]
    bin: float


class DoseDifference(TypedDict):
    """Statistics of a dose difference, Gy: with sign, and as magnitude."""

    signed: Summary
    magnitude: Summary
    reference_outside: Outside
    dose_outside: Outside


class Joint(TypedDict):
    """A joint: centre, axes (a quaternion), and soft ranges about and along them."""

    name: str
    centre: list[float]
    axes: list[float]
    rotation_range_deg: list[list[float]]
    translation_range_mm: list[Any]
    source: str


class Bone(TypedDict):
    """A bone of the skeleton; ``parent`` is the index of its parent bone in the list."""

    name: str
    label: int
    parent: int | None
    joint: Joint
    centroid: list[float]
    volume_mm3: float


class Skeleton(TypedDict):
    """The joint tree of bone labels; each bone comes after its parent.

    ``text`` is the tree as printed.
    """

    bones: list[Bone]
    voxels: list[int]
    ignored: list[str]
    warnings: list[Warned]
    text: str


class CohortRun(TypedDict):
    """One run of a cohort. ``figures`` are numbers with the unit in their names, ``None`` if the run has no such number.

    ``stand_apart`` names the figures that are outliers.
    """

    patient: str
    fraction: str
    date: str
    folder: str
    planning_sha256: str
    version: str
    figures: dict[str, float | None]
    verdict: Literal["pass", "review", "fail"] | None
    reasons: list[str]
    stand_apart: list[str]
    warnings: list[str]


class WrittenFile(TypedDict):
    """A written file and its checksum."""

    name: str
    sha256: str


class CohortSummary(TypedDict):
    """Runs, sorted by patient and date; ``medians`` has the median of each figure over the runs that have it."""

    version: str
    created: int
    command: str
    medians: dict[str, float | None]
    runs: list[CohortRun]
    unfinished: list[str]
    warnings: list[Warned]
    inputs: list[InputFile]
    outputs: list[WrittenFile]


class RejectedDraw(TypedDict):
    """A posture that was drawn and rejected."""

    draw: int
    why: list[str]


class Library(TypedDict):
    """A library of postures, as in ``library.json``: a MONAI datalist, with the inputs and settings that made it.

    Entries of ``training`` and ``implausible`` name the files of a posture, relative to the
    library's folder, and its joints.
    """

    name: str
    description: str
    modality: dict[str, str]
    labels: dict[str, str]
    numTraining: int
    training: list[dict[str, Any]]
    implausible: list[dict[str, Any]]
    version: str
    command: str
    inputs: list[InputFile]
    settings: dict[str, Any]
    degraded: dict[str, Any] | None
    plan: str
    sampled: int
    seed: int
    dimensions: int
    rejected: list[RejectedDraw]
    warnings: list[Warned]
    outputs: list[OutputFile]


class PostureMode(TypedDict):
    """A principal mode, and its share of the variance, 0 to 1."""

    name: str
    share: float


class PostureModes(TypedDict):
    """Modes of a patient's fractions.

    ``weights`` has a list for each fraction: the weight of each mode, in standard deviations.
    """

    version: str
    command: str
    inputs: list[InputFile]
    fractions: int
    variance: float
    modes: list[PostureMode]
    weights: list[list[float]]
    warnings: list[Warned]
    outputs: list[WrittenFile]
