"""Images with their geometry, from files, SimpleITK, nibabel and numpy.

Order and frame, told once. Arrays are indexed ``[z, y, x]``, components last, as
``SimpleITK.GetArrayFromImage`` gives them. Everything that is a position, a spacing or a vector is in the
order x, y, z, in mm, in LPS: x to the patient's left, y to the back, z up, as in DICOM and ITK. ``direction``
has one column per axis of the image, x first.
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

from . import _aventail, _errors

if TYPE_CHECKING:
    from ._aventail import _Geometry, _Raster

Path: TypeAlias = Union[str, "os.PathLike[str]"]
"""A file, or the folder of a DICOM series."""
Kind: TypeAlias = Literal["image", "labels", "dose"]
"""What the voxels of an image are."""
ImageLike: TypeAlias = Any
"""An :class:`Image`, a path, a SimpleITK image or a nibabel image."""
Names: TypeAlias = Union[Path, Mapping[int, str], Mapping[str, int]]
"""Names of labels: ``{1: "skull"}``, ``{"skull": 1}``, or a JSON file of them."""

_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def _identity() -> NDArray[np.float64]:
    return np.eye(3)


@dataclass(frozen=True, eq=False)
class Image:
    """An array with its place in the patient.

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
    """Distance of voxels along x, y, z, mm."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of voxel ``[0, 0, 0]``, LPS mm."""
    direction: NDArray[np.float64] = field(default_factory=_identity)
    """3x3, one column per axis, x first; LPS."""
    names: Mapping[int, str] | None = None
    """Names of labels, where the image is a label map with names."""
    kind: Kind | None = None
    """What the voxels are, where that is known."""

    def __post_init__(self) -> None:
        array = np.asarray(self.array)
        if array.ndim not in (3, 4):
            raise _errors.unsuitable("array", f"its shape is {array.shape}", "give [z, y, x] or [z, y, x, component]")
        direction = np.asarray(self.direction, np.float64).reshape(3, 3)
        object.__setattr__(self, "array", array)
        object.__setattr__(self, "spacing", _three(self.spacing))
        object.__setattr__(self, "origin", _three(self.origin))
        object.__setattr__(self, "direction", direction)

    def __repr__(self) -> str:
        x, y, z = self.size
        return f"<aventail.Image {x} x {y} x {z} voxels, {self.array.dtype}>"

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        z, y, x = self.array.shape[:3]
        return x, y, z

    @property
    def affine(self) -> NDArray[np.float64]:
        """4x4 from the index (x, y, z) to LPS mm."""
        out = np.eye(4)
        out[:3, :3] = self.direction * np.asarray(self.spacing)
        out[:3, 3] = self.origin
        return out

    def point(self, index: Sequence[float]) -> NDArray[np.float64]:
        """Position of an index (x, y, z), LPS mm."""
        affine = self.affine
        out: NDArray[np.float64] = affine[:3, :3] @ np.asarray(index, np.float64) + affine[:3, 3]
        return out

    @classmethod
    def of(cls, thing: ImageLike, kind: Kind = "image") -> Image:
        """An image of a path, a SimpleITK image or a nibabel image; an :class:`Image` as it is.

        ``kind`` says what a file holds.
        """
        if isinstance(thing, Image):
            return thing
        if isinstance(thing, (str, os.PathLike)):
            if kind == "labels":
                raster, names = _aventail.read_labels(os.fspath(thing))
                return _of_raster(raster, kind="labels", names=names)
            return _of_raster(_aventail.read_image(os.fspath(thing), kind == "dose"), kind=kind)
        if hasattr(thing, "GetSpacing") and hasattr(thing, "GetDirection"):
            return _of_sitk(thing, kind)
        if hasattr(thing, "affine") and hasattr(thing, "dataobj"):
            return _of_nibabel(thing, kind)
        raise _errors.usage(
            f"{type(thing).__name__} is no image: a bare array has no geometry",
            "give a path, a SimpleITK or nibabel image, or aventail.Image(array, spacing, origin, direction)",
        )

    def to_sitk(self) -> Any:
        """The same as a SimpleITK image."""
        sitk = imported("SimpleITK")
        array = self.array.astype(np.uint8) if self.array.dtype == np.bool_ else self.array
        image = sitk.GetImageFromArray(array, isVector=self.array.ndim == 4)
        image.SetSpacing(self.spacing)
        image.SetOrigin(self.origin)
        image.SetDirection(self.direction.ravel().tolist())
        return image

    def to_nibabel(self) -> Any:
        """The same as a nibabel NIfTI image: array ``[x, y, z]``, affine in RAS."""
        nibabel = imported("nibabel")
        array = self.array.astype(np.uint8) if self.array.dtype == np.bool_ else self.array
        return nibabel.Nifti1Image(np.moveaxis(array, (0, 1, 2), (2, 1, 0)), _RAS @ self.affine)

    def save(self, path: Path) -> None:
        """Writes it; the extension chooses the format: ``.nii``, ``.nii.gz``, ``.mha``, ``.nrrd``.

        Whole numbers are written as int16, labels with their names.
        """
        labels = self.kind == "labels" or self.array.dtype == np.bool_
        if labels:
            _aventail.write_labels(os.fspath(path), _label_raster(self, "labels"), dict(self.names or {}))
        else:
            whole = bool(np.issubdtype(self.array.dtype, np.integer))
            _aventail.write_image(os.fspath(path), _raster(self, np.float32), whole)

    def save_dicom(
        self, path: Path, like: Path, *, of: Path | Sequence[Path] | None = None, registrations: Sequence[Path] = ()
    ) -> None:
        """Writes it as DICOM in the frame of the scan ``like``, the folder of a DICOM series, as ``--dicom-like`` does.

        An image in HU becomes a series in a new folder, a dose (``kind="dose"``) an RT Dose, ``*.dcm``. ``of`` is what it
        was made of: where that is DICOM the object refers to it, and it must be of the same patient; of a sum of doses,
        all of them. ``registrations`` are DICOM registrations that carried a dose, to be referred to as well. Labels are not
        written as DICOM: write contours.
        """
        of = [of] if isinstance(of, (str, os.PathLike)) else list(of or ())
        sources = [os.fspath(thing) for thing in of]
        out, scan = os.fspath(path), os.fspath(like)
        if self.kind == "labels" or self.array.dtype == np.bool_:
            raise _errors.usage("labels are not written as DICOM", "write contours, or the labels in another format")
        if self.kind == "dose":
            fields = [os.fspath(r) for r in registrations]
            for code, message in _aventail.write_dicom_dose(out, _raster(self, np.float32), scan, sources, fields):
                python_warnings.warn(f"{message} ({code})", RuntimeWarning, stacklevel=2)
            return
        if registrations or len(sources) > 1:
            raise _errors.usage("an image is made of one other", "give registrations and several sources for a dose")
        _aventail.write_dicom_image(out, _raster(self, np.float32), scan, sources[0] if sources else None)


def imported(name: str) -> Any:
    """A package that is needed only where its things are asked for."""
    try:
        return import_module(name)
    except ImportError:
        raise _errors.usage(f"{name} is not installed", f"pip install {name}") from None


def _three(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _of_raster(raster: _Raster, kind: Kind | None = None, names: Mapping[int, str] | None = None) -> Image:
    array, spacing, origin, direction = raster
    return Image(array, spacing, origin, np.asarray(direction).reshape(3, 3), names, kind)


def _of_sitk(image: Any, kind: Kind) -> Image:
    sitk = imported("SimpleITK")
    if image.GetDimension() != 3:
        raise _errors.unsuitable("image", f"it has {image.GetDimension()} dimensions", "give an image of three")
    # A view of it would point to memory that goes with the image.
    array = sitk.GetArrayFromImage(image)
    return Image(array, image.GetSpacing(), image.GetOrigin(), np.asarray(image.GetDirection()), kind=kind)


def _of_nibabel(image: Any, kind: Kind) -> Image:
    affine = _RAS @ np.asarray(image.affine, np.float64)
    array = np.asanyarray(image.dataobj)
    if array.ndim != 3:
        raise _errors.unsuitable("image", f"its shape is {array.shape}", "give an image of three axes")
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    direction = affine[:3, :3] / spacing
    names = _nibabel_names(image) if kind == "labels" else None
    return Image(array.transpose(2, 1, 0), _three(spacing), _three(affine[:3, 3]), direction, names, kind)


def _nibabel_names(image: Any) -> dict[int, str] | None:
    """Names of labels in a NIfTI header's extension, as TotalSegmentator writes them."""
    for extension in getattr(image.header, "extensions", ()):
        content = extension.get_content()
        text = content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        if "<LabelTable" in text:
            labels = ElementTree.fromstring(text.strip("\0 \n")).iter("Label")
            return {int(e.attrib["Key"]): (e.text or "").strip() for e in labels if e.attrib["Key"] != "0"}
    return None


def _geometry(image: Image) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, ...]]:
    return image.spacing, image.origin, tuple(float(v) for v in image.direction.ravel())


def _raster(image: Image, dtype: Any) -> _Raster:
    """The image as the compiled module takes it."""
    return (np.ascontiguousarray(image.array, dtype), *_geometry(image))


def _label_raster(image: Image, what: str) -> _Raster:
    """The same as labels, which must be whole numbers from 0 to 65535."""
    array = image.array
    labels = array.astype(np.uint16)
    if array.dtype not in (np.uint8, np.uint16, np.bool_) and not np.array_equal(labels, array):
        raise _errors.unsuitable(
            what,
            f"{int(np.count_nonzero(labels != array))} voxels hold no whole number from 0 to 65535",
            "give a label map, resampled with nearest neighbour if at all",
        )
    return _raster(Image(labels, image.spacing, image.origin, image.direction), np.uint16)


def source(thing: ImageLike, kind: Kind = "image") -> str | _Raster:
    """An image as the compiled module takes it: a path, or a raster of float32."""
    if isinstance(thing, (str, os.PathLike)):
        return os.fspath(thing)
    return _raster(Image.of(thing, kind), np.float32)


def label_source(thing: ImageLike, labels: Names | None, what: str = "bones") -> tuple[str | _Raster, Any]:
    """A label map and the names of its labels as the compiled module takes them."""
    names = name_source(labels)
    if isinstance(thing, (str, os.PathLike)):
        return os.fspath(thing), names
    image = Image.of(thing, "labels")
    if names is None and image.names is not None:
        names = dict(image.names)
    return _label_raster(image, what), names


def name_source(labels: Names | None) -> str | dict[int, str] | None:
    """Names of labels as the compiled module takes them."""
    if labels is None or isinstance(labels, (str, os.PathLike)):
        return None if labels is None else os.fspath(labels)
    return dict(_numbered(key, value) for key, value in labels.items())


def _numbered(key: int | str, value: int | str) -> tuple[int, str]:
    """Number and name, whichever of the two is the key."""
    by_name = isinstance(key, str) and not key.isdigit()
    return (int(value), str(key)) if by_name else (int(key), str(value))


def grid_source(thing: ImageLike | None) -> _Geometry | None:
    """The grid of an image as the compiled module takes it."""
    if thing is None:
        return None
    if isinstance(thing, (str, os.PathLike)):
        return _aventail.read_grid(os.fspath(thing))
    image = Image.of(thing)
    return (image.size, *_geometry(image))
