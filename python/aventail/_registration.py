"""Registration, artificial postures, and their results."""

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
"""The coordinate frame of one of the two scans."""

_FRAMES = ("planning", "fraction")
_KINDS = ("image", "labels", "dose", "points", "contours")


class RunWarning(NamedTuple):
    """A warning of a run: something unusual that did not stop it."""

    code: str
    """Stable code of the warning (docs/refusals.md)."""
    message: str
    """What was found, with values, and what to do about it."""


class Registration:
    """The result of a registration (or a pose), in memory. Each array is copied once, at its first use.

    It can be pickled, with all its arrays. The unpickled object has every result, but cannot warp,
    draw samples or save.
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
        """Pull field on the fraction grid: fraction point y shows planning y + v(y).

        Use it to resample images.
        """
        return Field(lambda: _of_raster(self._native.field(False)), "fraction", "planning")

    @cached_property
    def planning_on_fraction(self) -> Image:
        """The deformed planning CT on the fraction grid, HU; -1000 where the planning CT does not reach."""
        return self._image("planning_on_fraction")

    @cached_property
    def bones_on_fraction(self) -> Image:
        """The deformed bone labels on the fraction grid, with names."""
        return self._labels("bones_on_fraction")

    @cached_property
    def jacobian(self) -> Image:
        """Jacobian determinant (volume after / before) on the planning grid; -1 where the field folds, 1 outside tissue."""
        return self._image("jacobian")

    @cached_property
    def uncertainty(self) -> Image | None:
        """Estimated error on the planning grid, mm; -1 where it is unknown.

        About two thirds of the errors, as lengths, are smaller. ``None`` if the settings ask for no
        map.
        """
        raster = self._native.image("uncertainty")
        return None if raster is None else _of_raster(raster, "image")

    @cached_property
    def regions(self) -> Image | None:
        """Label of the bone that each planning voxel follows; ``None`` without the setting ``output.regions``."""
        labels = self._native.labels("regions")
        return None if labels is None else _of_raster(labels[0], "labels", labels[1])

    @cached_property
    def body(self) -> Image:
        """Mask of the patient in the planning CT, with cavities filled."""
        return self._mask("body")

    @cached_property
    def computed(self) -> Image:
        """Mask of the planning voxels whose motion was computed; elsewhere the field is a smooth continuation."""
        return self._mask("computed")

    @cached_property
    def inside_planning(self) -> Image:
        """Mask of the fraction voxels that map into the planning scan."""
        return self._mask("inside_planning")

    @cached_property
    def bones(self) -> dict[str, NDArray[np.float64]]:
        """Rigid 4x4 matrix of each bone by name, planning to fraction, LPS mm."""
        return {name: np.asarray(rows) for name, rows in self._native.bones()}

    @property
    def warnings(self) -> list[RunWarning]:
        """Warnings of the run."""
        return [RunWarning(code, _errors.in_python(message)) for code, message in self._native.warnings()]

    @property
    def report(self) -> Report:
        """All numbers of the run, as in ``report.json`` (docs/formats.md)."""
        report: Report = json.loads(self._native.report())
        return report

    def save(self, folder: Path, *, view: bool = True, progress: Progress = None) -> None:
        """Writes the files of ``aventail register --out``: fields, images, masks, ``report.html``, ``report.json``.

        A registration with ``dicom=True`` also writes DICOM, into the subfolder ``dicom``.
        ``view=False`` leaves the image volumes out of ``report.html``.
        """
        with told(progress) as function:
            self._native.save(_given.path("folder", folder), _given.flag("view", view), function)

    def samples(self, number: int = 50, *, seed: int = 0, scale: float | None = None) -> Iterator[Field]:
        """Draws random fields that fit about as well as ``planning_to_fraction``: samples of the error.

        Bones vary within the uncertainty of the fit, together with their neighbours. Soft tissue
        varies by ``uncertainty``, correlated over some millimetres. The same seed gives the same
        fields. ``scale`` is the standard deviation of soft tissue along each axis, as a multiple of
        ``uncertainty`` (``None``: 0.6). The iterator computes each field when it is asked for it.
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
        """Warps an image, labels, a dose, points or contours into the frame ``to``.

        ``kind`` is ``"image"``, ``"labels"`` or ``"dose"``; leave it out for an :class:`Image` that
        has a ``kind``, such as those of a :class:`Phantom`. Points are an array of shape (n, 3),
        LPS mm. Contours are :class:`Contours`, or a file with ``kind="contours"``. A volume is
        returned as an :class:`Image` on the grid of the target scan, or of ``grid``.
        ``interpolation`` and ``outside`` (the value where the input does not reach) are for images
        only. Points outside the field stay where they are, with a warning.
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

    ``planning``, ``bones`` (labels on the planning grid) and ``fraction`` are paths, SimpleITK
    images, nibabel images, or an :class:`Image`. A path is a NIfTI, MetaImage or NRRD file or a
    DICOM folder; for the bones also a structure set, or ``"auto"``. ``labels`` gives the bones'
    names (those of TotalSegmentator) if the label map has none. ``settings`` is a preset, a file or
    a dict (docs/settings.md). ``landmarks`` only measure the error; ``bone_landmarks`` place the
    skeleton before it is fitted to the image. ``skeleton`` is a TOML file of changes to the
    skeleton. ``start`` is a 4x4 matrix, planning to fraction, LPS mm, near which the fit begins;
    where it explains little of the bones, all shifts are searched. ``organs`` is a file of organ
    labels on the planning grid, or a structure set. ``volume_change`` gives organs' volumes in the
    fraction divided by those in planning, ``{"parotid_left": 0.8}``.
    ``threads=0`` takes one thread per core; results do not depend on it. Other Python threads run
    meanwhile, and Ctrl-C raises KeyboardInterrupt.

    ``bones="auto"`` labels the file ``planning`` with TotalSegmentator, which must be installed.
    The labels are kept in ``bones_folder`` (default: the current folder), and the next run finds
    them there. Check them before you trust the result.

    Planning or fraction may be an MR. DICOM series state their modality; for other images use the
    settings ``{"planning": {"modality": "mr"}}`` and ``{"fraction": {"modality": "mr"}}``.

    ``fraction_bones`` are bone labels of the fraction (a path, an image, or ``"auto"``);
    ``fraction_labels`` gives their names if the label map has none. A bone labelled in both scans
    is first placed by its surface, then fitted to the image. With the settings
    ``{"fit": {"bone_landmarks": "replace"}}`` the labels alone place the bones.

    ``guide`` and ``fraction_guide`` are structures outlined in both scans (label maps or structure
    sets); ``guide_labels`` gives their names if a label map has none. Soft tissue is pulled from
    the outline in planning to the outline of the same name in the fraction. The settings
    ``{"refine": {"guide": {"names": ["bladder"]}}}`` choose some of them. ``report["guides"]``
    shows how well the outlines agree.

    With ``dicom=True`` planning and fraction must be DICOM folders, and :meth:`Registration.save`
    also writes DICOM for a planning system: the planning CT on the fraction, the registrations, and
    ``structures`` (RTSTRUCT of planning) and ``dose`` (RTDOSE of the plan) mapped to the fraction.
    ``anonymous`` leaves the patient's identity out of the report and the DICOM files.
    ``same_frame=True`` states that planning and fraction truly share the frame of reference that
    both name.

    For a list of fractions the work on the planning scan is done once, and a list of registrations
    is returned; ``landmarks``, ``fraction_bones`` and ``fraction_guide`` are then lists too.

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
    """Puts the patient into another posture: an artificial CT (``planning_on_fraction``) with its exact field.

    Give the motion in one of three ways. ``pose`` is a pose file, or a dict by bone,
    ``{"skull": {"axial_deg": 10.0}}``, with ``flexion_deg``, ``lateral_deg``, ``axial_deg`` and
    ``shift_mm``; ``couch``, a dict of ``rotation_deg`` and ``shift_mm``, moves the whole patient.
    ``transforms`` are 4x4 matrices by bone, planning to fraction, LPS mm. ``bone_landmarks`` are
    points on bones in both postures. Other bones follow their joints. The artificial CT lies on the
    planning grid, grown by ``margin_mm`` on all sides. ``bones="auto"`` and ``bones_folder`` are
    those of :func:`register`.
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
