"""The built-in phantom: head, neck and shoulders, with the true motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _aventail as _compiled
from . import _errors, _given
from ._contours import Contours
from ._field import Field
from ._image import Image, _of_raster
from ._native import check, native as _aventail

# The program's own range: smaller ones fill the memory of any machine.
_VOXEL_MM = (0.2, 20.0)


class Phantom:
    """A planning CT and a fraction CT of the same anatomy, with labels, dose and the true motion."""

    def __init__(self, native: _aventail.Phantom, options: tuple[Any, ...]) -> None:
        if not isinstance(native, _compiled.Phantom):
            raise TypeError("a Phantom is what aventail.phantom returns")
        self._made = native
        self._options = options

    @property
    def _native(self) -> _aventail.Phantom:
        check()
        return self._made

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return _phantom, self._options

    def __repr__(self) -> str:
        x, y, z = self.planning.size
        return f"<aventail.Phantom, {x} x {y} x {z} voxels, {len(self.landmarks)} landmarks>"

    @cached_property
    def planning(self) -> Image:
        """Planning CT, HU."""
        return _of_raster(self._native.planning(), "image")

    @cached_property
    def fraction(self) -> Image:
        """Fraction CT, HU."""
        return _of_raster(self._native.fraction(), "image")

    @cached_property
    def bones(self) -> Image:
        """Bone labels on the planning grid, with TotalSegmentator's names."""
        raster, names = self._native.bones()
        return _of_raster(raster, "labels", names)

    @cached_property
    def body(self) -> Image:
        """Mask of the patient on the planning grid, with cavities filled."""
        return _of_raster(self._native.body(), "labels")

    @cached_property
    def landmarks(self) -> dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]:
        """Points of soft tissue in planning and fraction, LPS mm."""
        return {name: (planning, fraction) for name, planning, fraction in self._native.landmarks()}

    @cached_property
    def transforms(self) -> dict[str, NDArray[np.float64]]:
        """True rigid 4x4 matrix of each bone, planning to fraction, LPS mm."""
        return {name: np.asarray(rows) for name, rows in self._native.transforms()}

    @cached_property
    def truth(self) -> Field:
        """The true displacement field, planning to fraction."""
        return Field(lambda: _of_raster(self._native.truth()), "planning", "fraction")

    @cached_property
    def _plan(self) -> tuple[Image, Contours]:
        raster, text = self._native.plan()
        return _of_raster(raster, "dose"), Contours._parse(text)

    @property
    def dose(self) -> Image:
        """Planned dose, Gy, on a grid of its own."""
        return self._plan[0]

    @property
    def contours(self) -> Contours:
        """Contours of ``body``, ``ctv``, ``ptv``, ``spinal_cord``, ``brainstem``, ``parotid_left``, ``parotid_right``."""
        return self._plan[1]


def phantom(
    spacing: Sequence[float] | None = None, *, second: bool = False, cbct: bool = False, **options: Any
) -> Phantom:
    """Makes the phantom.

    ``spacing`` is the voxel spacing along x, y, z, mm (default: 2 x 2 x 3); the field of view stays
    the same. ``second=True`` takes the posture of the second fraction. ``cbct=True`` makes the
    fraction a simulated cone-beam CT.

    Further options, by name: ``size``, ``top_mm``, ``edge_mm``, ``fat_mm``, ``planning_noise_hu``,
    ``fraction_noise_hu``, ``fraction_gain``, ``fraction_offset_hu``, ``fraction_spacing_mm``,
    ``fraction_grid_shift``, ``fraction_cut_top_mm``, ``fraction_cut_bottom_mm``,
    ``scanner_shift_mm``, ``couch_shift_mm``, ``posture`` (by bone, ``rotation_deg`` and
    ``shift_mm``), ``soft_tissue_mm``, ``seed``.

    >>> import aventail
    >>> aventail.phantom(spacing=(6, 6, 6))
    <aventail.Phantom, 85 x 59 x 70 voxels, 18 landmarks>
    """
    remedy = f"give three numbers from {_VOXEL_MM[0]} to {_VOXEL_MM[1]} mm"
    voxel = None if spacing is None else _given.three("spacing", spacing, remedy)
    if voxel is not None and not all(_VOXEL_MM[0] <= mm <= _VOXEL_MM[1] for mm in voxel):
        raise _errors.usage(f"spacing is {voxel}", remedy)
    text = _given.json_text("options", options, "help(aventail.phantom) names them")
    return _phantom(text, voxel, _given.flag("second", second), _given.flag("cbct", cbct))


def _phantom(text: str, spacing: tuple[float, float, float] | None, second: bool, cbct: bool) -> Phantom:
    return Phantom(_aventail.Phantom(text, spacing, second, cbct), (text, spacing, second, cbct))
