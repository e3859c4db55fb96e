"""Displacement fields."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import _aventail, _errors
from ._image import Image, Path, _of_raster, _raster, imported

if TYPE_CHECKING:
    from ._aventail import _Raster

FieldFormat: TypeAlias = Literal[
    "nifti", "metaimage", "nrrd", "dispvect", "niftyreg-displacement", "niftyreg-deformation"
]
"""Layouts of field files; docs/formats.md says which tool reads which."""
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
        self._source = image
        self.start = start
        """Frame on whose grid it lies."""
        self.end = end
        """Frame where its points arrive."""

    @cached_property
    def image(self) -> Image:
        """Vectors and grid; float32, made at the first look, with one copy."""
        image = self._source() if callable(self._source) else self._source
        if image.array.ndim != 4 or image.array.shape[3] != 3:
            raise _errors.unsuitable("field", f"its shape is {image.array.shape}", "give [z, y, x, 3]")
        return image

    @property
    def array(self) -> NDArray[np.float32]:
        """Displacements ``[z, y, x, component]``, components x, y, z, LPS mm."""
        return self.image.array

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Distance of voxels along x, y, z, mm."""
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
        """Voxels along x, y, z."""
        return self.image.size

    def __repr__(self) -> str:
        x, y, z = self.size
        return f"<aventail.Field {self.start} to {self.end}, {x} x {y} x {z} voxels>"

    def to_sitk(self) -> Any:
        """The field as a SimpleITK DisplacementFieldTransform, which takes points of ``start`` to ``end``.

        ITK resamples with the transform from the fixed to the moving image: to bring planning onto the fraction take
        that of ``fraction_to_planning``::

            sitk.Resample(planning, fraction, registration.fraction_to_planning.to_sitk(), sitk.sitkLinear, -1000.0)
        """
        sitk = imported("SimpleITK")
        vectors = sitk.Cast(self.image.to_sitk(), sitk.sitkVectorFloat64)
        return sitk.DisplacementFieldTransform(vectors)

    def save(self, path: Path, format: FieldFormat | None = None) -> None:
        """Writes it with its direction in the header; the extension chooses the layout where ``format`` does not."""
        _aventail.write_field(os.fspath(path), _raster(self.image, np.float32), (self.start, self.end), format)

    def save_dicom(self, path: Path, start: Path, end: Path) -> None:
        """Writes a Deformable Spatial Registration, ``*.dcm``, that lies in the DICOM series ``start`` and leads to ``end``.

        Both are folders of the scans whose frames the field joins.
        """
        scans = os.fspath(start), os.fspath(end)
        _aventail.write_dicom_field(os.fspath(path), _raster(self.image, np.float32), *scans)

    @classmethod
    def of(cls, thing: FieldLike, start: str, end: str) -> Field:
        """A field of a file, a SimpleITK image or transform, or an :class:`Image`; the frames are for you to say.

        Of a file whose header tells them they are the header's.
        """
        if isinstance(thing, Field):
            return thing
        if isinstance(thing, (str, os.PathLike)):
            raster, frames = _aventail.read_field(os.fspath(thing))
            own = frames or (start, end)
            return cls(_of_raster(raster), *own)
        if hasattr(thing, "GetDisplacementField"):
            thing = thing.GetDisplacementField()
        return cls(Image.of(thing), start, end)


def field_source(thing: FieldLike | None, start: str, end: str) -> str | _Raster | None:
    """A field as the compiled module takes it; one that points the other way is refused."""
    if thing is None or isinstance(thing, (str, os.PathLike)):
        return None if thing is None else os.fspath(thing)
    field = Field.of(thing, start, end)
    if field.start == end or field.end == start:
        raise _errors.unsuitable(
            "field",
            f"it takes {field.start} points to {field.end}, not {start} to {end}",
            "give it as the other direction",
        )
    return _raster(field.image, np.float32)
