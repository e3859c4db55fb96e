"""Images with their geometry, from files, SimpleITK, nibabel and numpy.

Axis order and frame: arrays are indexed ``[z, y, x]``, components last, as
``SimpleITK.GetArrayFromImage`` gives them. Everything that is a position, a spacing or a vector is
in the order x, y, z, in mm, in LPS: x to the patient's left, y to the back, z up, as in DICOM and
ITK. ``direction`` has one column per axis of the image, x first.
"""

from __future__ import annotations

import os
import warnings as python_warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, Union
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from . import _errors, _given
from ._native import native as _aventail

if TYPE_CHECKING:
    from ._aventail import _Geometry, _Raster

Path: TypeAlias = Union[str, "os.PathLike[str]"]
"""A file, or the folder of a DICOM series."""
Kind: TypeAlias = Literal["image", "labels", "dose"]
"""Type of an image's voxels."""
ImageLike: TypeAlias = Any
"""An :class:`Image`, a path, a SimpleITK image or a nibabel image."""
Names: TypeAlias = Union[Path, Mapping[int, str], Mapping[str, int]]
"""Names of labels: ``{1: "skull"}``, ``{"skull": 1}``, or a JSON file of them."""

_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_KINDS = ("image", "labels", "dose")
_PERPENDICULAR = 1e-3
_NAMES = 'give {1: "skull"} or {"skull": 1}'


def _identity() -> NDArray[np.float64]:
    return np.eye(3)


@dataclass(frozen=True, eq=False)
class Image:
    """An array with its geometry (spacing, origin, direction).

    >>> import numpy as np, aventail
    >>> ct = aventail.Image(np.zeros((4, 5, 6), np.float32), spacing=(1, 1, 3), origin=(-10, 0, 0))
    >>> ct.size
    (6, 5, 4)
    >>> ct.point((1, 0, 2)).tolist()
    [-9.0, 0.0, 6.0]
    """

    array: NDArray[Any]
    """Values ``[z, y, x]``, or ``[z, y, x, component]``."""
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Voxel spacing along x, y, z, mm."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of voxel ``[0, 0, 0]``, LPS mm."""
    direction: NDArray[np.float64] = field(default_factory=_identity)
    """3x3, one column per axis, x first; LPS."""
    names: Mapping[int, str] | None = None
    """Names of the labels, if the image is a label map with names."""
    kind: Kind | None = None
    """Type of the voxels (image, labels or dose), if known."""

    def __post_init__(self) -> None:
        spacing = _given.three("spacing", self.spacing, "give three numbers above 0: x, y, z, mm")
        if min(spacing) <= 0:
            raise _errors.unsuitable("spacing", f"it is {spacing}", "give three numbers above 0: x, y, z, mm")
        names = None if self.names is None else _given.label_names("names", _given.table("names", self.names, _NAMES))
        if self.kind is not None:
            _given.choice("kind", self.kind, _KINDS)
        object.__setattr__(self, "array", _voxels(self.array))
        object.__setattr__(self, "spacing", spacing)
        object.__setattr__(self, "origin", _given.three("origin", self.origin, "give three finite numbers: x, y, z, mm"))
        object.__setattr__(self, "direction", _direction(self.direction))
        object.__setattr__(self, "names", names)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """``numpy.asarray(image)`` gives :attr:`array`, indexed ``[z, y, x]``, without its geometry."""
        return to_numpy(self.array, dtype, copy)

    def __repr__(self) -> str:
        x, y, z = self.size
        return f"<aventail.Image {x} x {y} x {z} voxels, {self.array.dtype}>"

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels along x, y, z."""
        z, y, x = self.array.shape[:3]
        return x, y, z

    @property
    def affine(self) -> NDArray[np.float64]:
        """4x4 matrix from voxel index (x, y, z) to position, LPS mm."""
        out = np.eye(4)
        out[:3, :3] = self.direction * np.asarray(self.spacing)
        out[:3, 3] = self.origin
        return out

    def point(self, index: Sequence[float]) -> NDArray[np.float64]:
        """Position of a voxel index (x, y, z), LPS mm."""
        affine = self.affine
        place = np.asarray(_given.three("index", index), np.float64)
        out: NDArray[np.float64] = affine[:3, :3] @ place + affine[:3, 3]
        return out

    @classmethod
    def of(cls, thing: ImageLike, kind: Kind = "image") -> Image:
        """Makes an image from a path, a SimpleITK image or a nibabel image; returns an :class:`Image` unchanged.

        ``kind`` is the type of the voxels: ``"image"``, ``"labels"`` or ``"dose"``.
        """
        _given.choice("kind", kind, _KINDS)
        if isinstance(thing, Image):
            return thing
        if _given.is_path(thing):
            path = _given.path("image", thing)
            if kind == "labels":
                raster, names = _aventail.read_labels(path)
                return _of_raster(raster, kind="labels", names=names)
            return _of_raster(_aventail.read_image(path, kind == "dose"), kind=kind)
        if all(hasattr(thing, name) for name in ("GetSpacing", "GetOrigin", "GetDirection", "GetPixelIDValue")):
            return _of_sitk(thing, kind)
        if hasattr(thing, "affine") and hasattr(thing, "dataobj"):
            return _of_nibabel(thing, kind)
        raise _errors.usage(
            f"{type(thing).__name__} is no image: a bare array has no geometry",
            "give a path, a SimpleITK or nibabel image, or aventail.Image(array, spacing, origin, direction)",
        )

    def to_sitk(self) -> Any:
        """Converts it to a SimpleITK image."""
        sitk = imported("SimpleITK")
        array = _common(self.array)
        image = sitk.GetImageFromArray(array, isVector=self.array.ndim == 4)
        image.SetSpacing(self.spacing)
        image.SetOrigin(self.origin)
        image.SetDirection(self.direction.ravel().tolist())
        return image

    def to_nibabel(self) -> Any:
        """Converts it to a nibabel NIfTI image: array ``[x, y, z]``, affine in RAS."""
        nibabel = imported("nibabel")
        array = _common(self.array)
        # It asks for the type of whole numbers of 64 bits by name.
        return nibabel.Nifti1Image(np.moveaxis(array, (0, 1, 2), (2, 1, 0)), _RAS @ self.affine, dtype=array.dtype)

    def save(self, path: Path) -> None:
        """Writes it; the extension chooses the format: ``.nii``, ``.nii.gz``, ``.mha``, ``.nrrd``.

        Whole numbers are written as int16, labels with their names.
        """
        labels = self.kind == "labels" or self.array.dtype == np.bool_
        if labels:
            _aventail.write_labels(_given.path("path", path), _label_raster(self, "labels"), dict(self.names or {}))
        else:
            whole = bool(np.issubdtype(self.array.dtype, np.integer))
            _aventail.write_image(_given.path("path", path), _raster(self, np.float32), whole)

    def save_dicom(
        self, path: Path, like: Path, *, of: Path | Sequence[Path] | None = None, registrations: Sequence[Path] = ()
    ) -> None:
        """Writes it as DICOM in the frame of the scan ``like``, the folder of a DICOM series, as ``--dicom-like`` does.

        An image in HU becomes a series in a new folder, a dose (``kind="dose"``) an RT Dose,
        ``*.dcm``. ``of`` is the source that it was made from (for a sum of doses, all of them): if
        it is DICOM, the new object refers to it, and both must be of the same patient.
        ``registrations`` are the DICOM registrations that mapped a dose; the new object refers to
        them too. Labels cannot be written as DICOM: write contours.
        """
        sources = [] if of is None else _given.paths("of", of)
        fields = _given.paths("registrations", registrations)
        out, scan = _given.path("path", path), _given.path("like", like)
        if self.kind == "labels" or self.array.dtype == np.bool_:
            raise _errors.usage("labels are not written as DICOM", "write contours, or the labels in another format")
        if self.kind != "dose" and (fields or len(sources) > 1):
            raise _errors.usage("an image is made of one other", "give registrations and several sources for a dose")
        raster = _raster(self, np.float32)
        with _errors.naming(out="path"):
            if self.kind != "dose":
                _aventail.write_dicom_image(out, raster, scan, sources[0] if sources else None)
                return
            told = _aventail.write_dicom_dose(out, raster, scan, sources, fields)
        for code, message in told:
            text = f"{_errors.in_python(message)} ({code})"
            python_warnings.warn(text, RuntimeWarning, stacklevel=2)


def imported(name: str) -> Any:
    """A package that is needed only where its things are asked for."""
    try:
        return import_module(name)
    except ImportError:
        raise _errors.usage(f"{name} is not installed", f"pip install {name}") from None


def to_numpy(array: NDArray[Any], dtype: Any, copy: bool | None) -> NDArray[Any]:
    """What ``__array__`` returns: the array itself where nothing asks for another."""
    if copy:
        return np.array(array, dtype)
    if copy is False and dtype is not None and np.dtype(dtype) != array.dtype:
        # numpy's own protocol asks for this error.
        raise ValueError(f"values of {array.dtype} become {np.dtype(dtype)} by a copy only")
    return np.asarray(array, dtype)


def perpendicular(name: str, axes: NDArray[np.float64], given: Any) -> None:
    """Refuses columns that are no perpendicular unit vectors."""
    off = float(np.abs(axes.T @ axes - np.eye(axes.shape[1])).max())
    if not off <= _PERPENDICULAR:
        what = "its axes are not perpendicular or not of unit length"
        raise _errors.unsuitable(name, f"it is {_given.shown(given)}: {what} (departure {off:.2g})", "give unit vectors")


def _direction(given: Any) -> NDArray[np.float64]:
    """A 3x3 of perpendicular unit vectors, or its nine numbers row by row, as SimpleITK gives them."""
    remedy = "give 3x3, one column per axis, x first"
    try:
        flat = np.asarray(given).ravel()
    except Exception:
        raise _given.wrong("direction", given, remedy) from None
    direction = _given.array("direction", flat, (9,), remedy).reshape(3, 3)
    perpendicular("direction", direction, given)
    return direction


def _voxels(given: Any) -> NDArray[Any]:
    """An array of values, which must be numbers."""
    if isinstance(given, np.ma.MaskedArray):
        raise _errors.unsuitable("array", "it is masked, and an image knows no mask", "fill it: array.filled(-1000)")
    try:
        array = np.asarray(given)
    except Exception as error:
        raise _errors.unsuitable("array", f"it is none: {error}", "give an array [z, y, x]") from None
    if array.ndim not in (3, 4):
        raise _errors.unsuitable("array", f"its shape is {array.shape}", "give [z, y, x] or [z, y, x, component]")
    if array.size == 0:
        raise _errors.unsuitable("array", f"its shape is {array.shape}: it is empty", "give at least one voxel")
    if array.dtype.kind not in "biuf":
        raise _errors.unsuitable("array", f"its values are of type {array.dtype}", "give real numbers")
    return array


def _common(array: NDArray[Any]) -> NDArray[Any]:
    """The values in a type and byte order that every package knows."""
    own: np.dtype[Any] = array.dtype.newbyteorder("=")
    if own.kind == "b":
        own = np.dtype(np.uint8)
    elif own.kind == "f":
        own = np.dtype(np.float32 if own.itemsize <= 4 else np.float64)
    return np.asarray(array, own)


def _of_raster(raster: _Raster, kind: Kind | None = None, names: Mapping[int, str] | None = None) -> Image:
    array, spacing, origin, direction = raster
    return Image(array, spacing, origin, np.asarray(direction), names, kind)


def _of_sitk(image: Any, kind: Kind) -> Image:
    sitk = imported("SimpleITK")
    if image.GetDimension() != 3:
        raise _errors.unsuitable("image", f"it has {image.GetDimension()} dimensions", "give an image of three")
    try:
        # A view of it would point to memory that goes with the image.
        array = sitk.GetArrayFromImage(image)
    except Exception as error:
        raise _errors.unsuitable("image", f"SimpleITK gives no array of it: {error}", "cast it to numbers") from None
    return Image(array, image.GetSpacing(), image.GetOrigin(), np.asarray(image.GetDirection()), kind=kind)


def _of_nibabel(image: Any, kind: Kind) -> Image:
    try:
        affine, array = np.asarray(image.affine, np.float64), np.asanyarray(image.dataobj)
    except Exception as error:
        raise _errors.unsuitable("image", f"nibabel gives no array of it: {error}", "look at its file") from None
    if array.ndim != 3:
        raise _errors.unsuitable("image", f"its shape is {array.shape}", "give an image of three axes")
    spacing = np.linalg.norm(affine[:3, :3], axis=0) if affine.shape == (4, 4) else np.zeros(3)
    if not np.isfinite(affine).all() or not spacing.all():
        cause = f"it is {_given.shown(affine.tolist())}"
        raise _errors.unsuitable("affine", cause, "give a 4x4 of a rotation and voxel sizes")
    affine = _RAS @ affine
    direction = affine[:3, :3] / spacing
    names = _nibabel_names(image) if kind == "labels" else None
    return Image(array.transpose(2, 1, 0), spacing, affine[:3, 3], direction, names, kind)  # type: ignore[arg-type]


def _nibabel_names(image: Any) -> dict[int, str] | None:
    """Names of labels in a NIfTI header's extension, as TotalSegmentator writes them."""
    for extension in getattr(image.header, "extensions", ()):
        content = extension.get_content()
        text = content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        if "<LabelTable" in text:
            try:
                labels = ElementTree.fromstring(text.strip("\0 \n")).iter("Label")
                return {int(e.attrib["Key"]): (e.text or "").strip() for e in labels if e.attrib["Key"] != "0"}
            except (ElementTree.ParseError, KeyError, ValueError) as error:
                cause = f"its header's table of labels cannot be read: {error}"
                raise _errors.unsuitable("image", cause, "give the names as labels, and an aventail.Image") from None
    return None


def _geometry(image: Image) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, ...]]:
    return image.spacing, image.origin, tuple(float(v) for v in image.direction.ravel())


def _raster(image: Image, dtype: Any) -> _Raster:
    """The image as the compiled module takes it, which refuses what becomes infinite."""
    with np.errstate(over="ignore"):
        return (np.ascontiguousarray(image.array, dtype), *_geometry(image))


def _label_raster(image: Image, what: str) -> _Raster:
    """The same as labels, which must be whole numbers from 0 to 65535."""
    array = image.array
    with np.errstate(invalid="ignore", over="ignore"):
        labels = array.astype(np.uint16)
    if array.dtype not in (np.uint8, np.uint16, np.bool_) and not np.array_equal(labels, array):
        raise _errors.unsuitable(
            what,
            f"{int(np.count_nonzero(labels != array))} voxels hold no whole number from 0 to 65535",
            "give a label map, resampled with nearest neighbour if at all",
        )
    return _raster(Image(labels, image.spacing, image.origin, image.direction), np.uint16)


def source(name: str, thing: ImageLike, kind: Kind = "image") -> str | _Raster:
    """An image as the compiled module takes it: a path, or a raster of float32."""
    if _given.is_path(thing):
        return _given.path(name, thing)
    return _raster(_scalar(name, _image(name, thing, kind)), np.float32)


def source_or_none(name: str, thing: ImageLike | None) -> str | _Raster | None:
    """The same, where something is given."""
    return None if thing is None else source(name, thing)


def label_source(thing: ImageLike, labels: Names | None, what: str = "bones") -> tuple[str | _Raster, Any]:
    """A label map and the names of its labels as the compiled module takes them."""
    names = name_source("labels", labels)
    if _given.is_path(thing):
        return _given.path(what, thing), names
    image = _scalar(what, _image(what, thing, "labels"))
    if names is None and image.names is not None:
        names = dict(image.names)
    return _label_raster(image, what), names


def name_source(name: str, labels: Names | None) -> str | dict[int, str] | None:
    """Names of labels as the compiled module takes them."""
    if labels is None or _given.is_path(labels):
        return _given.path_or_none(name, labels)
    return _given.label_names(name, _given.table(name, labels, f"{_NAMES}, or a JSON file of them"))


def grid_source(name: str, thing: ImageLike | None) -> _Geometry | None:
    """The grid of an image as the compiled module takes it."""
    if thing is None:
        return None
    if _given.is_path(thing):
        return _aventail.read_grid(_given.path(name, thing))
    image = _image(name, thing, "image")
    return (image.size, *_geometry(image))


def _image(name: str, thing: ImageLike, kind: Kind) -> Image:
    """An image, whose argument is named where it is none."""
    with _given.about(name):
        return Image.of(thing, kind)


def _scalar(name: str, image: Image) -> Image:
    """An image of one value a voxel."""
    if image.array.ndim != 3:
        raise _errors.unsuitable(name, f"its shape is {image.array.shape}", "give one value a voxel, [z, y, x]")
    return image
