"""Registering, posing, and what comes of it."""

from __future__ import annotations

import json
import os
import warnings as python_warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, Union, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _aventail, _errors
from ._contours import Contours
from ._field import Field
from ._image import Image, ImageLike, Kind, Names, Path, _of_raster, grid_source, label_source, source
from ._progress import Progress, told

if TYPE_CHECKING:
    from .reports import Report

Preset: TypeAlias = Literal["default", "fast", "thesis"]
"""Named settings; docs/settings.md says what each is."""
Settings: TypeAlias = Union[Preset, Path, Mapping[str, Any], None]
"""A preset, a TOML file (or the report.json of a run), or a dict nested as the TOML is."""
Landmarks: TypeAlias = Union[Path, Mapping[str, "tuple[Sequence[float], Sequence[float]]"]]
"""Points known in both images: a CSV file, or ``{name: (planning, fraction)}``, LPS mm."""
BoneLandmarks: TypeAlias = Union[Path, Sequence["tuple[str, str, Sequence[float], Sequence[float]]"]]
"""The same on bones: a CSV file with a column ``bone``, or ``(bone, name, planning, fraction)``."""
Frame: TypeAlias = Literal["planning", "fraction"]
"""One of the two scans' worlds."""

_PRESETS = ("default", "fast", "thesis")


class RunWarning(NamedTuple):
    """Something legal but unusual that a run found."""

    code: str
    """Stable name of its kind."""
    message: str
    """What was found, with values, and what to do about it."""


class Registration:
    """What a registration (or a pose) found, in memory. Arrays are made at the first look, with one copy."""

    def __init__(self, native: _aventail.Registration) -> None:
        self._native = native

    def __repr__(self) -> str:
        return f"<aventail.Registration of {len(self.bones)} bones, {len(self.warnings)} warnings>"

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
        return [RunWarning(code, message) for code, message in self._native.warnings()]

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
            self._native.save(os.fspath(folder), view, function)

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
        if to not in ("planning", "fraction"):
            raise _errors.usage(f"to is {to!r}", 'give to="fraction" or to="planning"')
        forward = to == "fraction"
        kind = kind or _kind(thing)
        target = grid_source(grid)
        if kind == "points":
            return self._warp_points(thing, forward, to)
        if kind == "contours":
            text = self._native.warp_contours(Contours.of(thing)._json(), forward, target)
            return Contours._parse(text)
        if kind == "labels":
            given, names = label_source(thing, labels, "labels")
            if isinstance(names, str):
                raise _errors.usage("names of labels are a file", "give them as a dict")
            raster, own = self._native.warp_labels(given, names, forward, target)
            return _of_raster(raster, "labels", own)
        if kind in ("image", "dose"):
            cubic, dose = interpolation == "cubic", kind == "dose"
            given = source(thing, kind)
            raster = self._native.warp_image(given, forward, cubic, float(outside), dose, target)
            return _of_raster(raster, kind)
        raise _errors.usage(
            "it is not known what the voxels are" if kind is None else f"kind is {kind!r}",
            'give kind="image", "labels" or "dose"',
        )

    def _warp_points(self, points: ArrayLike, forward: bool, to: str) -> NDArray[np.float64]:
        array = np.ascontiguousarray(points, np.float64)
        one = array.ndim == 1
        carried, covered = self._native.warp_points(np.atleast_2d(array), forward)
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


def _kind(thing: Any) -> Kind | Literal["points", "contours"] | None:
    """What is given, where it tells."""
    if isinstance(thing, Contours):
        return "contours"
    if isinstance(thing, Image):
        return thing.kind
    if isinstance(thing, (np.ndarray, list, tuple)):
        return "points"
    return None


def _plain(value: Any) -> Any:
    """numpy's numbers and arrays as JSON knows them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no setting")


def settings_source(settings: Settings) -> dict[str, Any]:
    """Settings as the compiled module takes them."""
    out: dict[str, Any] = {"json": None, "file": None, "preset": None}
    if isinstance(settings, Mapping):
        try:
            out["json"] = json.dumps(dict(settings), allow_nan=False, default=_plain)
        except (TypeError, ValueError) as error:
            raise _errors.usage(f"the settings are not legal: {error}", "compare with docs/settings.md") from None
    elif isinstance(settings, str) and (settings in _PRESETS or "." not in settings and not os.path.exists(settings)):
        out["preset"] = settings
    elif settings is not None:
        out["file"] = os.fspath(settings)
    return out


def landmark_source(landmarks: Landmarks | None) -> Any:
    """Landmarks as the compiled module takes them."""
    if landmarks is None or isinstance(landmarks, (str, os.PathLike)):
        return None if landmarks is None else os.fspath(landmarks)
    return [(str(name), _point(a), _point(b)) for name, (a, b) in landmarks.items()]


def _point(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _more(
    names: Any,
    landmarks: Landmarks | None,
    bone_landmarks: BoneLandmarks | None,
    skeleton: Path | None,
    start: ArrayLike | None,
    bones_folder: Path | None = None,
) -> dict[str, Any]:
    on_bones: Any = bone_landmarks
    if bone_landmarks is not None and not isinstance(bone_landmarks, (str, os.PathLike)):
        on_bones = [(bone, name, _point(a), _point(b)) for bone, name, a, b in bone_landmarks]
    return {
        "labels": names,
        "landmarks": landmark_source(landmarks),
        "bone_landmarks": on_bones,
        "skeleton": None if skeleton is None else os.fspath(skeleton),
        "start": None if start is None else np.asarray(start, np.float64).tolist(),
        "organs": None,
        "volume_change": [],
        "bones_folder": None if bones_folder is None else os.fspath(bones_folder),
        "dicom": False,
        "structures": None,
        "dose": None,
        "anonymous": False,
        "same_frame": False,
    }


def _give_back(
    dicom: bool, structures: Path | None, dose: Path | None, anonymous: bool, same_frame: bool
) -> dict[str, Any]:
    """What goes back to a planning system, as the compiled module takes it."""
    if not dicom and (structures is not None or dose is not None):
        raise _errors.usage(
            "structures and dose go back as DICOM, which is not asked for", "give dicom=True too, or leave them out"
        )
    paths = {"structures": structures, "dose": dose}
    files = {role: None if path is None else os.fspath(path) for role, path in paths.items()}
    return {"dicom": bool(dicom), **files, "anonymous": bool(anonymous), "same_frame": bool(same_frame)}


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

    With ``dicom=True`` planning and fraction are DICOM folders, and :meth:`Registration.save` also writes what a planning
    system imports: the planning CT on the fraction, the registrations, and ``structures`` (RTSTRUCT of planning) and
    ``dose`` (RTDOSE of the plan) carried to the fraction. ``anonymous`` leaves the patient's identity out of the report
    and of DICOM. ``same_frame`` says that planning and fraction truly lie in the one frame of reference that both claim.

    A list of fractions shares what depends on planning alone, and a list of registrations comes back; ``landmarks`` is
    then a list too.

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
    more = _more(names, None, bone_landmarks, skeleton, start, bones_folder)
    more |= _give_back(dicom, structures, dose, anonymous, same_frame)
    more["organs"] = None if organs is None else os.fspath(organs)
    more["volume_change"] = [(str(organ), float(factor)) for organ, factor in (volume_change or {}).items()]
    settled = settings_source(settings)
    several = isinstance(fraction, list)
    fractions = fraction if several else [fraction]
    if several and (bone_landmarks is not None or start is not None):
        raise _errors.usage(
            "bone_landmarks and start belong to one fraction, and several are given", "register the fractions one by one"
        )
    points = [landmarks] * len(fractions) if landmarks is None or not several else list(landmarks)
    if len(points) != len(fractions):
        raise _errors.usage(
            f"{len(points)} sets of landmarks are given for {len(fractions)} fractions", "give one for each, or None"
        )
    pairs = [(source(image), landmark_source(each)) for image, each in zip(fractions, points)]
    with told(progress) as function:
        natives = _aventail.register(source(planning), given, pairs, more, settled, threads, function)
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
    if transforms is not None:
        motion["transforms"] = [(name, np.asarray(m, np.float64).tolist()) for name, m in transforms.items()]
    elif isinstance(pose, (str, os.PathLike)):
        motion["file"] = os.fspath(pose)
    elif pose is not None or couch is not None:
        motion["text"] = _pose_text(pose or {}, couch or {})
    elif bone_landmarks is None:
        raise _errors.usage("no motion is given", "give pose, transforms or bone_landmarks")
    given, names = label_source(bones, labels)
    more = _more(names, landmarks, bone_landmarks, skeleton, None, bones_folder)
    with told(progress) as function:
        native = _aventail.pose(
            source(planning), given, motion, margin_mm, more, settings_source(settings), threads, function
        )
    return Registration(native)


def _pose_text(pose: Mapping[str, Mapping[str, Any]], couch: Mapping[str, Any]) -> str:
    """A pose file's text; JSON's texts, numbers and lists are TOML's."""

    def lines(table: Mapping[str, Any]) -> list[str]:
        return [f"{json.dumps(key)} = {json.dumps(value, default=_plain)}" for key, value in table.items()]

    out = ["[couch]", *lines(couch)] if couch else []
    for bone, motion in pose.items():
        out += [f"[bones.{json.dumps(bone)}]", *lines(motion)]
    return "\n".join(out)
