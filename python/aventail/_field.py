"""Displacement fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from . import _errors, _given
from ._image import Image, Path, _of_raster, _raster, imported, to_numpy
from ._native import native as _aventail

if TYPE_CHECKING:
    from ._aventail import _Raster

FieldFormat: TypeAlias = Literal[
    "nifti", "metaimage", "nrrd", "dispvect", "niftyreg-displacement", "niftyreg-deformation"
]
"""Formats of field files; docs/formats.md lists the tools that read each."""
FieldLike: TypeAlias = Any
"""A :class:`Field`, a path, a SimpleITK vector image or DisplacementFieldTransform, or an :class:`Image` of vectors."""


class Field:
    """A displacement field on the grid of frame ``start``: its point x goes to x + u(x) in frame ``end``.

    >>> import numpy as np, aventail
    >>> image = aventail.Image(np.full((2, 3, 4, 3), 1.5, np.float32), spacing=(2, 2, 2))
    >>> aventail.Field(image, "planning", "fraction")
    <aventail.Field planning to fraction, 4 x 3 x 2 voxels>
    """

    def __init__(self, image: Image | Callable[[], Image], start: str, end: str) -> None:
        self._source: Callable[[], Image] | None = None
        self.start = _given.word("start", start)
        """Frame on whose grid the field lies."""
        self.end = _given.word("end", end)
        """Frame to which it takes points."""
        if isinstance(image, Image):
            # A cached property lies here once it is known.
            self.__dict__["image"] = _of_vectors(image)
        elif callable(image):
            self._source = image
        else:
            raise _given.wrong("image", image, "give an aventail.Image of vectors, or aventail.Field.of(...)")

    @cached_property
    def image(self) -> Image:
        """Vectors (float32) with their grid; copied once, at the first use."""
        made = None if self._source is None else self._source()
        if not isinstance(made, Image):
            raise _given.wrong("what makes the field's image", made, "return an aventail.Image of vectors")
        return _of_vectors(made)

    @property
    def array(self) -> NDArray[np.float32]:
        """Displacements ``[z, y, x, component]``, components x, y, z, LPS mm."""
        return self.image.array

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Voxel spacing along x, y, z, mm."""
        return self.image.spacing

    @property
    def origin(self) -> tuple[float, float, float]:
        """Centre of voxel ``[0, 0, 0]``, LPS mm."""
        return self.image.origin

    @property
    def direction(self) -> NDArray[np.float64]:
        """3x3, one column per axis, x first."""
        return self.image.direction

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels along x, y, z."""
        return self.image.size

    def __repr__(self) -> str:
        x, y, z = self.size
        return f"<aventail.Field {self.start} to {self.end}, {x} x {y} x {z} voxels>"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """``numpy.asarray(field)`` gives :attr:`array`, ``[z, y, x, component]``."""
        return to_numpy(self.array, dtype, copy)

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return self.array.__array_interface__

    def __reduce__(self) -> tuple[type[Field], tuple[Image, str, str]]:
        return Field, (self.image, self.start, self.end)

    def to_sitk(self) -> Any:
        """The field as a SimpleITK DisplacementFieldTransform, which takes points of ``start`` to ``end``.

        ITK resamples with the transform from the fixed to the moving image. To resample the
        planning CT on the fraction grid, use ``fraction_to_planning``::

            transform = registration.fraction_to_planning.to_sitk()
            sitk.Resample(planning, fraction, transform, sitk.sitkLinear, -1000.0)
        """
        sitk = imported("SimpleITK")
        vectors = sitk.Cast(self.image.to_sitk(), sitk.sitkVectorFloat64)
        return sitk.DisplacementFieldTransform(vectors)

    def save(self, path: Path, format: FieldFormat | None = None) -> None:
        """Writes the field, with its frames in the header.

        Without ``format`` the extension chooses the format.
        """
        layout = None if format is None else _given.choice("format", format, get_args(FieldFormat))
        raster = _raster(self.image, np.float32)
        _aventail.write_field(_given.path("path", path), raster, (self.start, self.end), layout)

    def save_dicom(self, path: Path, start: Path, end: Path) -> None:
        """Writes a Deformable Spatial Registration, ``*.dcm``, from the DICOM series ``start`` to the series ``end``.

        ``start`` and ``end`` are the folders of the two scans whose frames the field connects.
        """
        out, scans = _given.path("path", path), (_given.path("start", start), _given.path("end", end))
        with _errors.naming(out="path", dicom_like="start"):
            _aventail.write_dicom_field(out, _raster(self.image, np.float32), *scans)

    @classmethod
    def of(cls, thing: FieldLike, start: str, end: str) -> Field:
        """Makes a field from a file, a SimpleITK image or transform, or an :class:`Image`.

        Name the frames with ``start`` and ``end``; if a file's header names them, those of the
        header are used.
        """
        if isinstance(thing, Field):
            return thing
        frames = _given.word("start", start), _given.word("end", end)
        if _given.is_path(thing):
            raster, own = _aventail.read_field(_given.path("field", thing))
            return cls(_of_raster(raster), *(own or frames))
        if hasattr(thing, "GetDisplacementField"):
            thing = thing.GetDisplacementField()
        return cls(Image.of(thing), *frames)


def _of_vectors(image: Image) -> Image:
    """An image of displacements as float32."""
    if image.array.ndim != 4 or image.array.shape[3] != 3:
        raise _errors.unsuitable("field", f"its shape is {image.array.shape}", "give [z, y, x, 3]")
    with np.errstate(over="ignore"):
        vectors = np.asarray(image.array, np.float32)
    odd = vectors.size - int(np.count_nonzero(np.isfinite(vectors)))
    if odd:
        cause = f"{odd} of {vectors.size} components are NaN or infinite"
        raise _errors.unsuitable("field", cause, "give 0 where it is unknown")
    return image if vectors is image.array else replace(image, array=vectors)


def taken(name: str, thing: FieldLike, start: str, end: str) -> Field:
    """A field, whose argument is named where it is none."""
    with _given.about(name):
        return Field.of(thing, start, end)


def field_source(name: str, thing: FieldLike | None, start: str, end: str) -> str | _Raster | None:
    """A field as the compiled module takes it; one that points the other way is refused."""
    if thing is None or _given.is_path(thing):
        return _given.path_or_none(name, thing)
    field = taken(name, thing, start, end)
    if field.start == end or field.end == start:
        raise _errors.unsuitable(
            "field",
            f"it takes {field.start} points to {field.end}, not {start} to {end}",
            "give it as the other direction",
        )
    return _raster(field.image, np.float32)
