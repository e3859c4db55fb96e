"""What the dicts of numbers hold. Lengths in mm, doses in Gy, positions LPS mm; docs/metrics.md has the formulas."""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Summary(TypedDict):
    """A sample's figures; ``std`` is that of n - 1."""

    n: int
    mean: float
    std: float
    median: float
    p95: float
    min: float
    max: float


class Warned(TypedDict):
    """A warning."""

    code: str
    message: str


class _InputFile(TypedDict):
    role: str
    path: str
    sha256: str


class InputFile(_InputFile, total=False):
    """An input that came from a file; ``about`` of a clinic's series only."""

    about: dict[str, Any]


class OutputFile(TypedDict):
    """A file that was written."""

    name: str
    what: str
    sha256: str


class Grid(TypedDict):
    """A grid: voxels and spacing along x, y, z; the direction as rows."""

    size: list[int]
    spacing: list[float]
    origin: list[float]
    direction: list[list[float]]


class Transform(TypedDict):
    """A rigid transform: quaternion (x, y, z, w) and translation."""

    rotation: list[float]
    translation: list[float]


class JointMotion(TypedDict):
    """A joint's rotation vector (radians) and shift, in its axes."""

    rotation: list[float]
    translation: list[float]


class Pose(TypedDict):
    """Motion of each joint, in the order of the bones."""

    joints: list[JointMotion]


class BeyondRange(TypedDict):
    """How far a joint is beyond its soft range."""

    rotation_deg: float
    shift_mm: float


class BoneFit(TypedDict):
    """How a bone was fitted."""

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
    """How rigidly the field moves a bone."""

    name: str
    voxels: int
    best: Transform
    rms_mm: float
    max_mm: float


class JacobianStats(TypedDict):
    """Volume after over before, of some of the cells."""

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
    bones: list[list[Any]]
    digital_folded: int
    jumps_above_10: int


class JacobianReport(_JacobianReport, total=False):
    """Jacobian characteristics; ``bones`` are pairs of a name and :class:`JacobianStats`.

    ``folded_at`` is where most of the folded cells lie.
    """

    folded_at: list[float]


class BoneOverlap(TypedDict):
    """Two bones that lie in each other."""

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


class Uncertainty(TypedDict):
    """How far the result may be trusted."""

    soft_tissue_mm: Summary
    without_images_percent: float
    unknown_percent: float
    above_2mm_ml: float


class Pruning(TypedDict):
    """Waves that were pruned, and the most that this can change."""

    waves: int
    of: int
    each_percent: float
    together_percent: float
    most_mm: float


class Links(TypedDict):
    """Chain-mail links of the result."""

    links: int
    violated: int
    violated_percent: float
    mean_excess_mm: float
    p95_excess_mm: float
    max_excess_mm: float


class Inverse(TypedDict):
    """Quality of the inverse."""

    residual_mm: Summary
    unconverged: int
    unconverged_tissue: int
    strayed: int
    unconverged_max_mm: float
    multiple: int
    outside: int
    voxels: int


class Consistency(TypedDict):
    """Planning to fraction and back through both fields."""

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
    """A landmark's distance before and after; ``None`` outside the planning grid."""

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
    """Residuals of landmarks; ``shifted`` under the couch shift alone."""

    shifted: Summary


class Verdict(TypedDict):
    """A figure beside its limits, with what it means."""

    name: str
    value: float
    unit: str
    limit: str
    source: str
    verdict: Literal["pass", "review", "fail"]
    reason: str
    remedy: str


class Stage(TypedDict, total=False):
    """Time of a stage; ``processor_seconds`` where the system tells."""

    stage: str
    seconds: float
    processor_seconds: float


class CouchResidual(TypedDict):
    """What the couch shift leaves of a bone, root mean square over its points, mm."""

    bone: str
    matched: bool
    shift_mm: float
    rotation_mm: float


class CouchMatch(TypedDict):
    """Where the patient lies, planning to fraction, matched on bones: the couch corrects it the other way.

    Translation LPS mm; rotation vector in degrees about ``centre``.
    """

    on: list[str]
    chosen: str
    shift_mm: list[float]
    rotation_deg: list[float]
    centre: list[float]
    residuals: list[CouchResidual]


class TissueAgreement(TypedDict):
    """Mean local correlation of the images in one kind of tissue, as scanned, with the couch shift and after."""

    compared_ml: float
    before: float | None
    couch: float | None
    after: float
    worse_percent: float


class Agreement(TypedDict):
    """How far the images agree, at bones and in soft tissue."""

    bones: TissueAgreement | None
    soft_tissue: TissueAgreement | None


class OutlineAgreement(TypedDict):
    """How near two outlines of a structure come."""

    dice: float
    mean_mm: float
    p95_mm: float


class GuideReached(TypedDict):
    """A structure that guided, without guides and with them."""

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
    """A place of all bones that the search of an unclear start has proposed."""

    proposed_by: list[str]
    evidence_percent: float
    apart_mm: float
    shift_mm: list[float]


class Report(_Report, total=False):
    """The numbers of a run; ``fraction_kind`` where images took part in soft tissue.

    ``verdict`` is the worst of ``verdicts``; ``own_motion_mm`` is the
    motion of each bone's centroid apart from the couch shift.
    """

    agreement: Agreement
    search: list[SearchedPlace]
    verdict: Literal["pass", "review", "fail"]
    fraction_kind: dict[str, Any]


class Distances(TypedDict):
    """Distances of two surfaces."""

    centre_of_mass_mm: float
    mean_mm: float
    hausdorff_95_mm: float
    hausdorff_mm: float


class ContourMetrics(TypedDict):
    """A mapped structure against that of the fraction."""

    name: str
    mapped_ml: float
    reference_ml: float
    dice: float
    distances: Distances | None


class ThereAndBack(TypedDict):
    """There and back, where both fields are known."""

    distance_mm: Summary
    outside: int


class SimilarityFigures(TypedDict):
    """How alike two CTs are."""

    voxels: int
    ncc: float
    mse: float
    rms_hu: float
    mae_hu: float
    nmi: float


class Similarity(TypedDict):
    """Similarity of the CTs."""

    before: SimilarityFigures
    after: SimilarityFigures


class MeanShift(TypedDict):
    """The one shift that is nearest to a field, LPS mm, and what it is the mean of."""

    mm: list[float]
    of: str


class Assessment(TypedDict):
    """What was measured of a field; parts that need inputs that were not given are ``None`` or empty.

    ``regularity`` are pairs of a direction and its figures; ``inverse_consistency`` begins in planning, then in the fraction.
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


class Outside(TypedDict):
    """What lies outside a field."""

    volume_ml: float
    volume_percent: float
    amount_percent: float


class Balance(TypedDict):
    """Energy and mass before and after."""

    source_j: float
    mapped_j: float
    outside_j: float
    relative_error: float
    source_g: float
    mapped_g: float


class Caution(TypedDict):
    """Where a mapped dose deserves doubt."""

    folded_or_outside: int
    uncertain: int
    ml: float
    greatest_gy: float


class DoseReport(TypedDict):
    """What is to be said about a mapped dose."""

    direction: str
    method: Any
    balance: Balance | None
    inversion: Inverse | None
    outside: Outside
    caution: Caution
    warnings: list[Warned]


class Share(TypedDict):
    """Volume with at least a dose."""

    gy: float
    percent: float


class Dvh(TypedDict):
    """A structure's dose-volume histogram: the share ``cumulative[n]`` of it, 0 to 1, has at least ``n * bin`` Gy."""

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
    """Figures of a difference of doses."""

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
    """A bone of the skeleton; ``parent`` is its place in the list."""

    name: str
    label: int
    parent: int | None
    joint: Joint
    centroid: list[float]
    volume_mm3: float


class Skeleton(TypedDict):
    """The joint tree of bone labels, bones after their parents, and the tree as text."""

    bones: list[Bone]
    voxels: list[int]
    ignored: list[str]
    warnings: list[Warned]
    text: str


class CohortRun(TypedDict):
    """One run of a cohort; ``figures`` have the unit in their name and are ``None`` where the run has none."""

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
    """A file beside a record."""

    name: str
    sha256: str


class CohortSummary(TypedDict):
    """Runs side by side, by patient and date; ``medians`` of each figure over the runs that have it."""

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
    """A posture that was drawn and not kept."""

    draw: int
    why: list[str]


class Library(TypedDict):
    """A library of postures, as ``library.json`` has it: MONAI's datalist, with what it was made from.

    Entries of ``training`` and ``implausible`` name the files of a posture, seen from the library's folder, and its joints.
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
    """Modes of a patient's fractions; ``weights`` are standard deviations of each mode, a list for each fraction."""

    version: str
    command: str
    inputs: list[InputFile]
    fractions: int
    variance: float
    modes: list[PostureMode]
    weights: list[list[float]]
    warnings: list[Warned]
    outputs: list[WrittenFile]
