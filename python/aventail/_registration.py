"""Registering, posing, and what comes of it."""

from __future__ import annotations

import json
import warnings as python_warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _aventail as _compiled
from . import _case, _errors, _given
from ._case import BoneLandmarks, Landmarks, Settings, landmark_source, settings_source
from ._contours import Contours
from ._field import Field
from ._image import Image, ImageLike, Kind, Names, Path, _of_raster, grid_source, label_source, source
from ._kept import Kept, Results
from ._native import check, native as _aventail
from ._progress import Progress, told

if TYPE_CHECKING:
    from .reports import Report

Frame: TypeAlias = Literal["planning", "fraction"]
"""One of the two scans' worlds."""

_FRAMES = ("planning", "fraction")
_KINDS = ("image", "labels", "dose", "points", "contours")


class RunWarning(NamedTuple):
    """Something legal but unusual that a run found."""

    code: str
    """Stable name of its kind."""
    message: str
    """What was found, with values, and what to do about it."""


class Registration:
    """What a registration (or a pose) found, in memory. Arrays are made at the first look, with one copy.

    It can be pickled, with all its arrays. What comes of the pickle has every result, but neither carries nor saves.
    """

    def __init__(self, found: Results) -> None:
        if not isinstance(found, (_compiled.Registration, Kept)):
            raise TypeError("a Registration is what aventail.register and aventail.pose return")
        self._found = found

    @property
    def _native(self) -> Results:
        if not isinstance(self._found, Kept):
            check()
        return self._found

    def __reduce__(self) -> tuple[type[Registration], tuple[Kept]]:
        return Registration, (Kept.of(self._native),)

    def __copy__(self) -> Registration:
        return Registration(self._found)

    def __deepcopy__(self, memo: object) -> Registration:
        # What was found is never changed; arrays are made anew at the first look.
        return Registration(self._found)

    def __repr__(self) -> str:
        told = f"{self.report['verdict']}, {len(self.warnings)} warnings"
        return f"<aventail.Registration of {len(self.bones)} bones: {told}>"

    @cached_property
    def planning_to_fraction(self) -> Field:
        """Push field on the planning grid: planning point x goes to x + u(x) in the fraction."""
        return Field(lambda: _of_raster(self._native.field(True)), "planning", "fraction")

    @cached_property
    def fraction_to_planning(self) -> Field:
        """Pull field on the fraction grid: fraction point y shows planning y + v(y). It resamples images."""
        return Field(lambda: _of_raster(self._native.field(False)), "fraction", "planning")

    @cached_property
    def planning_on_fraction(self) -> Image:
        """The planning CT on the fraction grid, HU; -1000 where nothing maps."""
        return self._image("planning_on_fraction")

    @cached_property
    def bones_on_fraction(self) -> Image:
        """The bone labels on the fraction grid, with names."""
        return self._labels("bones_on_fraction")

    @cached_property
    def jacobian(self) -> Image:
        """Volume after over before on the planning grid; -1 where the field folds, 1 outside tissue."""
        return self._image("jacobian")

    @cached_property
    def uncertainty(self) -> Image | None:
        """How far the result may be trusted on the planning grid, mm, one standard deviation; -1 where nothing is known.

        ``None`` where the settings ask for no map.
        """
        raster = self._native.image("uncertainty")
        return None if raster is None else _of_raster(raster, "image")

    @cached_property
    def regions(self) -> Image | None:
        """The bone that each planning voxel follows, where the settings ask for it (``output.regions``)."""
        labels = self._native.labels("regions")
        return None if labels is None else _of_raster(labels[0], "labels", labels[1])

    @cached_property
    def body(self) -> Image:
        """The patient in the planning CT, cavities filled."""
        return self._mask("body")

    @cached_property
    def computed(self) -> Image:
        """Planning voxels whose motion was computed; elsewhere the field is a smooth extension."""
        return self._mask("computed")

    @cached_property
    def inside_planning(self) -> Image:
        """Fraction voxels whose pre-image lies inside the planning scan."""
        return self._mask("inside_planning")

    @cached_property
    def bones(self) -> dict[str, NDArray[np.float64]]:
        """4x4 of each bone by name, planning to fraction, LPS mm."""
        return {name: np.asarray(rows) for name, rows in self._native.bones()}

    @property
    def warnings(self) -> list[RunWarning]:
        """What you should know."""
        return [RunWarning(code, _errors.in_python(message)) for code, message in self._native.warnings()]

    @property
    def report(self) -> Report:
        """Every number of the run, as ``report.json`` has them (docs/formats.md)."""
        report: Report = json.loads(self._native.report())
        return report

    def save(self, folder: Path, *, view: bool = True, progress: Progress = None) -> None:
        """Writes what ``aventail register --out`` writes: fields, images, masks, ``report.html``, ``report.json``.

        Of a registration with ``dicom=True`` also what ``--dicom`` writes, into ``dicom`` in the folder. ``view=False``
        leaves the volumes out of the page.
        """
        with told(progress) as function:
            self._native.save(_given.path("folder", folder), _given.flag("view", view), function)

    def samples(self, number: int = 50, *, seed: int = 0, scale: float | None = None) -> Iterator[Field]:
        """Fields that may be as right as ``planning_to_fraction``: what an error of the registration may look like.

        They differ as far as ``uncertainty`` says: bones are drawn from what the fit leaves open, neighbours together, and
        soft tissue varies by itself, alike over some millimetres. The same seed gives the same fields; ``scale`` is the
        deviation of each component of soft tissue over ``uncertainty``. Each field is made when it is reached.
        """
        count = _given.whole("number", number, 2, 1000)
        factor = None if scale is None else _given.within("scale", scale, 1e-6, 100.0)
        drawn = self._native.samples(count, _given.whole("seed", seed), factor)
        return (_sampled(drawn, sample) for sample in range(count))

    @overload
    def warp(self, thing: Contours, to: Frame, *, grid: ImageLike | None = None) -> Contours: ...
    @overload
    def warp(self, thing: ArrayLike, to: Frame, *, kind: Literal["points"]) -> NDArray[np.float64]: ...
    @overload
    def warp(
        self,
        thing: ImageLike,
        to: Frame,
        *,
        kind: Kind | None = None,
        labels: Names | None = None,
        interpolation: Literal["linear", "cubic"] = "linear",
        outside: float = -1000.0,
        grid: ImageLike | None = None,
    ) -> Any: ...

    def warp(
        self,
        thing: Any,
        to: Frame,
        *,
        kind: Kind | Literal["points", "contours"] | None = None,
        labels: Names | None = None,
        interpolation: Literal["linear", "cubic"] = "linear",
        outside: float = -1000.0,
        grid: ImageLike | None = None,
    ) -> Any:
        """Carries an image, labels, a dose, points or contours into the frame ``to``.

        ``kind`` says what a volume is, where it does not itself (those of a :class:`Phantom` do): ``"image"``,
        ``"labels"`` or ``"dose"``. Points are an array of shape (n, 3), LPS mm; contours are :class:`Contours`, or a
        file of them with ``kind="contours"``. A volume comes back as an :class:`Image` on the grid of the scan that it
        is carried to, or of ``grid``; ``outside`` is an image's value where nothing maps, and ``interpolation`` is an
        image's. Points outside the field stay where they are, with a warning.
        """
        forward = _given.choice("to", to, _FRAMES) == "fraction"
        if kind is None:
            kind = _kind(thing)
        else:
            _given.choice("kind", kind, _KINDS)
        if kind is None:
            remedy = 'give kind="image", "labels" or "dose"; points are an array, contours aventail.Contours'
            raise _errors.usage(f"kind is not given: nothing tells what {_given.shown(thing)} is", remedy)
        cubic = _given.choice("interpolation", interpolation, ("linear", "cubic")) == "cubic"
        # NaN is a value that says that there is none.
        fill = float(outside) if isinstance(outside, (float, np.floating)) else _given.number("outside", outside)
        idle = {
            "labels": labels is not None and kind != "labels",
            "interpolation": cubic and kind != "image",
            "outside": fill != -1000.0 and kind != "image",
            "grid": grid is not None and kind == "points",
        }
        if any(idle.values()):
            without = " and ".join(name for name, given in idle.items() if given)
            raise _errors.usage(f"{without} has no meaning for {kind}", f"leave {without} out")
        target = grid_source("grid", grid)
        if kind == "points":
            return self._warp_points(thing, forward, to)
        if kind == "contours":
            with _given.about("thing"):
                contours = Contours.of(thing)
            text = self._native.warp_contours(contours._json(), forward, target)
            return Contours._parse(text)
        if kind == "labels":
            given, names = label_source(thing, labels, "thing")
            if isinstance(names, str):
                raise _errors.usage(f"labels is the file {names}", "give the names as a dict")
            raster, own = self._native.warp_labels(given, names, forward, target)
            return _of_raster(raster, "labels", own)
        how = {"cubic": cubic, "outside": fill, "dose": kind == "dose"}
        raster = self._native.warp_image(source("thing", thing, kind), forward, how, target)
        return _of_raster(raster, kind)

    def _warp_points(self, points: ArrayLike, forward: bool, to: str) -> NDArray[np.float64]:
        remedy = "give an array of shape (n, 3), x, y, z in LPS mm"
        try:
            one = np.ndim(points) == 1
        except ValueError:
            one = False
        array = _given.array("thing", [points] if one else points, (None, 3), remedy)
        carried, covered = self._native.warp_points(array, forward)
        outside = int(np.count_nonzero(~covered))
        if outside:
            python_warnings.warn(
                f"{outside} of {covered.size} points lie outside the field to {to} and stay where they are",
                RuntimeWarning,
                stacklevel=3,
            )
        return carried[0] if one else carried

    def _image(self, name: str) -> Image:
        raster = self._native.image(name)
        assert raster is not None
        return _of_raster(raster, "image")

    def _labels(self, name: str) -> Image:
        labels = self._native.labels(name)
        assert labels is not None
        return _of_raster(labels[0], "labels", labels[1])

    def _mask(self, name: str) -> Image:
        mask = self._native.mask(name)
        assert mask is not None
        return _of_raster(mask, "labels")


def _sampled(drawn: _compiled.Samples, sample: int) -> Field:
    """The field of a sample."""
    return Field(lambda: _of_raster(drawn.field(sample)), "planning", "fraction")


def _kind(thing: Any) -> Kind | Literal["points", "contours"] | None:
    """What is given, where it tells."""
    if isinstance(thing, Contours):
        return "contours"
    if isinstance(thing, Image):
        return thing.kind
    if isinstance(thing, (np.ndarray, list, tuple)):
        return "points"
    return None


@overload
def register(
    planning: ImageLike,
    bones: ImageLike,
    fraction: ImageLike,
    labels: Names | None = None,
    settings: Settings = None,
    landmarks: Landmarks | None = None,
    *,
    bone_landmarks: BoneLandmarks | None = None,
    fraction_bones: ImageLike | None = None,
    fraction_labels: Names | None = None,
    guide: ImageLike | None = None,
    fraction_guide: ImageLike | None = None,
    guide_labels: Names | None = None,
    skeleton: Path | None = None,
    start: ArrayLike | None = None,
    organs: Path | None = None,
    volume_change: Mapping[str, float] | None = None,
    bones_folder: Path | None = None,
    dicom: bool = False,
    structures: Path | None = None,
    dose: Path | None = None,
    anonymous: bool = False,
    same_frame: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> Registration: ...
@overload
def register(
    planning: ImageLike,
    bones: ImageLike,
    fraction: list[ImageLike],
    labels: Names | None = None,
    settings: Settings = None,
    landmarks: Sequence[Landmarks | None] | None = None,
    *,
    fraction_bones: Sequence[ImageLike | None] | None = None,
    fraction_labels: Names | None = None,
    guide: ImageLike | None = None,
    fraction_guide: Sequence[ImageLike] | None = None,
    guide_labels: Names | None = None,
    skeleton: Path | None = None,
    organs: Path | None = None,
    volume_change: Mapping[str, float] | None = None,
    bones_folder: Path | None = None,
    dicom: bool = False,
    structures: Path | None = None,
    dose: Path | None = None,
    anonymous: bool = False,
    same_frame: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> list[Registration]: ...


def register(
    planning: ImageLike,
    bones: ImageLike,
    fraction: Any,
    labels: Names | None = None,
    settings: Settings = None,
    landmarks: Any = None,
    *,
    bone_landmarks: BoneLandmarks | None = None,
    fraction_bones: Any = None,
    fraction_labels: Names | None = None,
    guide: ImageLike | None = None,
    fraction_guide: Any = None,
    guide_labels: Names | None = None,
    skeleton: Path | None = None,
    start: ArrayLike | None = None,
    organs: Path | None = None,
    volume_change: Mapping[str, float] | None = None,
    bones_folder: Path | None = None,
    dicom: bool = False,
    structures: Path | None = None,
    dose: Path | None = None,
    anonymous: bool = False,
    same_frame: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> Any:
    """Registers a planning CT to a fraction CT; both in HU.

    ``planning``, ``bones`` (labels on the planning grid) and ``fraction`` are paths (NIfTI, MetaImage, NRRD, DICOM
    folders; a structure set or ``"auto"`` for the bones), SimpleITK images, nibabel images, or an :class:`Image`. ``labels`` names the
    bones where the labels do not, by TotalSegmentator's names. ``landmarks`` evaluate and never enter the fit;
    ``bone_landmarks`` place the skeleton; ``start`` is a 4x4 near which the fit begins, planning to fraction, LPS mm.
    ``organs`` is a file of their labels on the planning grid, or a structure set; ``volume_change`` says of an organ its
    volume in the fraction over that in planning, ``{"parotid_left": 0.8}``. Results do not depend on ``threads`` (0: one
    per core). The interpreter's lock is free meanwhile, and Ctrl-C raises KeyboardInterrupt.

    ``bones="auto"`` has TotalSegmentator, where it is installed, label the file ``planning``; the labels are kept in
    ``bones_folder`` (without it the current folder) and found there by the next run. Nobody has looked at them: look.

    Planning or fraction may be an MR. A DICOM series says that it is one; of other images say it with the settings
    ``{"planning": {"modality": "mr"}}`` and ``{"fraction": {"modality": "mr"}}``.

    ``fraction_bones`` are labels of bones in the fraction (named by ``fraction_labels`` where they do not name themselves; a path,
    an image, or ``"auto"``): where both scans have a bone's label, its surface places the bone before the image does. With the
    settings ``{"fit": {"bone_landmarks": "replace"}}`` the labels alone decide.

    ``guide`` and ``fraction_guide`` are structures outlined in both scans (label maps named by ``guide_labels`` where they do not
    name themselves, or structure sets): soft tissue is guided from one outline to the other of its name. The settings
    ``{"refine": {"guide": {"names": ["bladder"]}}}`` choose some; ``report["guides"]`` says how near the outlines come.

    With ``dicom=True`` planning and fraction are DICOM folders, and :meth:`Registration.save` also writes what a planning
    system imports: the planning CT on the fraction, the registrations, and ``structures`` (RTSTRUCT of planning) and
    ``dose`` (RTDOSE of the plan) carried to the fraction. ``anonymous`` leaves the patient's identity out of the report
    and of DICOM. ``same_frame`` says that planning and fraction truly lie in the one frame of reference that both claim.

    A list of fractions shares what depends on planning alone, and a list of registrations comes back; ``landmarks``,
    ``fraction_bones`` and ``fraction_guide`` are then lists too.

    >>> import aventail
    >>> phantom = aventail.phantom(spacing=(6, 6, 6))
    >>> registration = aventail.register(phantom.planning, phantom.bones, phantom.fraction)
    >>> registration.planning_to_fraction
    <aventail.Field planning to fraction, 85 x 59 x 70 voxels>
    >>> moved = registration.warp(phantom.contours, to="fraction")
    >>> sorted(moved.structures)[:3]
    ['body', 'brainstem', 'ctv']
    """
    given, names = label_source(bones, labels)
    more = _case.more(names, None, bone_landmarks, skeleton, start, bones_folder)
    more |= _case.give_back(dicom, structures, dose, anonymous, same_frame)
    more["organs"] = _given.path_or_none("organs", organs)
    more["volume_change"] = _case.volume_changes(volume_change)
    settled, threads = settings_source(settings), _given.whole("threads", threads)
    several = isinstance(fraction, list)
    fractions = fraction if several else [fraction]
    if several and (bone_landmarks is not None or start is not None):
        raise _errors.usage(
            "bone_landmarks and start belong to one fraction, and several are given", "register the fractions one by one"
        )
    if several and not fractions:
        raise _given.wrong("fraction", fraction, "give one fraction, or a list of at least one")
    if several and landmarks is not None and not isinstance(landmarks, (list, tuple)):
        raise _given.wrong("landmarks", landmarks, "several fractions have a list of landmarks, or None")
    points = [landmarks] * len(fractions) if landmarks is None or not several else list(landmarks)
    if len(points) != len(fractions):
        raise _errors.usage(
            f"{len(points)} sets of landmarks are given for {len(fractions)} fractions", "give one for each, or None"
        )
    labelled = _case.fraction_bones(fraction_bones, fraction_labels, len(fractions), several)
    more["guide"], guided = _case.guides(guide, fraction_guide, guide_labels, len(fractions), several)
    pairs = [
        (source("fraction", image), landmark_source("landmarks", each), own, there)
        for image, each, own, there in zip(fractions, points, labelled, guided)
    ]
    ct = source("planning", planning)
    with told(progress) as function:
        natives = _aventail.register((ct, given), pairs, more, settled, (threads, function))
    registrations = [Registration(native) for native in natives]
    return registrations if several else registrations[0]


def pose(
    planning: ImageLike,
    bones: ImageLike,
    pose: Path | Mapping[str, Mapping[str, Any]] | None = None,
    labels: Names | None = None,
    settings: Settings = None,
    *,
    transforms: Mapping[str, ArrayLike] | None = None,
    bone_landmarks: BoneLandmarks | None = None,
    couch: Mapping[str, Any] | None = None,
    margin_mm: float = 0.0,
    landmarks: Landmarks | None = None,
    skeleton: Path | None = None,
    bones_folder: Path | None = None,
    threads: int = 0,
    progress: Progress = None,
) -> Registration:
    """Puts the patient into another posture: an artificial CT, as ``planning_on_fraction``, with its exact field.

    ``pose`` is a pose file or a dict by bone, ``{"skull": {"axial_deg": 10.0}}`` with ``flexion_deg``, ``lateral_deg``,
    ``axial_deg`` and ``shift_mm``; ``transforms`` are 4x4 by bone, planning to fraction; other bones follow their joints.
    The artificial CT lies on the planning grid, grown by ``margin_mm`` on all sides. ``bones="auto"`` and
    ``bones_folder`` are those of :func:`register`.
    """
    motion: dict[str, Any] = {"text": None, "file": None, "transforms": None}
    ways = {"pose": pose, "couch": couch, "transforms": transforms, "bone_landmarks": bone_landmarks}
    given_ways = [name for name, thing in ways.items() if thing is not None]
    in_file = "couch" in given_ways and _given.is_path(pose)
    if in_file or given_ways != ["pose", "couch"] and len(given_ways) > 1:
        raise _errors.usage(f"several motions are given: {', '.join(given_ways)}", "give one, or pose and couch as dicts")
    if transforms is not None:
        entries = _given.named("transforms", transforms, 'give {"skull": 4x4}, planning to fraction, LPS mm')
        motion["transforms"] = [(bone, _given.matrix(f"transforms[{bone!r}]", rows)) for bone, rows in entries]
    elif _given.is_path(pose):
        motion["file"] = _given.path("pose", pose)
    elif pose is not None or couch is not None:
        motion["text"] = _case.pose_text(pose, couch)
    elif bone_landmarks is None:
        raise _errors.usage("no motion is given", "give pose, transforms or bone_landmarks")
    given, names = label_source(bones, labels)
    more = _case.more(names, landmarks, bone_landmarks, skeleton, None, bones_folder)
    settled, threads = settings_source(settings), _given.whole("threads", threads)
    motion["margin_mm"], ct = _given.within("margin_mm", margin_mm, 0, 500), source("planning", planning)
    with told(progress) as function:
        native = _aventail.pose((ct, given), motion, more, settled, (threads, function))
    return Registration(native)
