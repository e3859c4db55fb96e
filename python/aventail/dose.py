"""Dose on a deforming patient: carry it, add it up, compare it, read histograms. Gy.

>>> import aventail
>>> phantom = aventail.phantom(spacing=(6, 6, 6))
>>> day = aventail.dose.map(phantom.dose, phantom.truth, to="fraction", grid=phantom.fraction).dose
>>> curves = aventail.dose.dvh(phantom.dose, phantom.contours, at=[20.0])
>>> [curve["name"] for curve in curves][:3]
['body', 'ctv', 'ptv']
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from . import _aventail, _errors
from ._contours import Contours
from ._field import FieldLike
from ._image import Image, ImageLike, Names, _of_raster, grid_source, label_source, source
from ._measure import both
from ._progress import Progress, told
from ._registration import Frame, Registration

if TYPE_CHECKING:
    from .reports import DoseDifference, DoseReport, Dvh

__all__ = ["Compared", "Mapped", "accumulate", "compare", "dvh", "map"]


class Mapped(NamedTuple):
    """A dose in its new frame."""

    dose: Image
    """Gy."""
    report: DoseReport
    """Balance, inversion, and where the result deserves doubt."""


class Compared(NamedTuple):
    """How two doses differ."""

    difference: Image
    """Dose minus reference, Gy, on the reference's grid."""
    distance: Image
    """Distance to dose difference, mm: how exactly a field must be known so that no dose changes by the tolerance."""
    figures: DoseDifference
    """Where both are known and either is above 10 % of the maximum, Gy."""


def map(
    dose: ImageLike,
    fields: Registration | FieldLike | None = None,
    *,
    to: Frame,
    grid: ImageLike | None = None,
    method: Literal["interpolate", "energy-mass"] = "interpolate",
    ct: ImageLike | None = None,
    parts: int = 2,
    planning_to_fraction: FieldLike | None = None,
    fraction_to_planning: FieldLike | None = None,
    threads: int = 0,
    progress: Progress = None,
) -> Mapped:
    """Carries a dose through a field: the planned dose ``to="fraction"``, or that of the day back ``to="planning"``.

    ``energy-mass`` carries energy and mass together and conserves energy; it needs ``ct``, the CT in the frame that the
    dose comes from. The result lies on ``grid``, or on that of the field in its frame.
    """
    if to not in ("planning", "fraction"):
        raise _errors.usage(f"to is {to!r}", 'give to="fraction" or to="planning"')
    push, pull = both(fields, planning_to_fraction, fraction_to_planning)
    by_mass = parts if method == "energy-mass" else None
    scan = None if ct is None else source(ct)
    with told(progress) as function:
        raster, report = _aventail.map_dose(
            source(dose, "dose"), push, pull, to == "fraction", grid_source(grid), by_mass, scan, threads, function
        )
    return Mapped(_of_raster(raster, "dose"), json.loads(report))


def accumulate(
    doses: Sequence[ImageLike], weights: Sequence[float] | None = None, *, fractions: Sequence[float] | None = None
) -> Image:
    """The sum of doses on one grid, as :func:`map` makes them; each counts once by default.

    ``weights``: of doses of the whole plan, the share of it that each stands for, from 0 to 1. ``fractions``: of doses of one
    fraction, how many fractions were given so.
    """
    given = [source(dose, "dose") for dose in doses]
    return _of_raster(_aventail.accumulate(given, _numbers("weights", weights), _numbers("fractions", fractions)), "dose")


def _numbers(name: str, given: Sequence[float] | None) -> list[float]:
    try:
        return [] if given is None else [float(n) for n in given]
    except (TypeError, ValueError):
        raise _errors.usage(f"{name} is {given!r}", "give one number for each dose") from None


def dvh(
    dose: ImageLike,
    structures: Contours | ImageLike | Mapping[str, Any],
    labels: Names | None = None,
    *,
    at: Sequence[float] = (),
    bin: float = 0.1,
) -> list[Dvh]:
    """Dose-volume histograms of structures with D95, Dmean, Dmax, D0.03cc, and V_x at the doses ``at``.

    ``structures`` are contours, which may overlap (:class:`Contours`, a contour JSON, a structure set, polygons by name),
    or a label map.
    """
    given: Any = None
    names: Any = None
    text: str | None = None
    path: str | None = None
    if isinstance(structures, (Contours, Mapping)):
        text = Contours.of(structures)._json()
    elif isinstance(structures, (str, os.PathLike)) and _of_contours(os.fspath(structures)):
        path = os.fspath(structures)
    else:
        given, names = label_source(structures, labels, "structures")
    curves: list[Dvh] = json.loads(
        _aventail.dvh(source(dose, "dose"), given, names, text, path, [float(d) for d in at], bin)
    )
    return curves


def _of_contours(path: str) -> bool:
    """Whether a file holds contours: a JSON, DICOM, or a folder with a structure set."""
    return path.lower().endswith((".json", ".dcm")) or os.path.isdir(path)


def compare(
    dose: ImageLike, reference: ImageLike, *, tolerance: float | None = None, limit: float = 20.0
) -> Compared:
    """Difference of two doses of one frame; ``tolerance`` in Gy is 3 % of the reference's maximum without it."""
    difference, distance, figures = _aventail.compare_doses(
        source(dose, "dose"), source(reference, "dose"), tolerance, limit
    )
    return Compared(_of_raster(difference, "image"), _of_raster(distance, "image"), json.loads(figures))
