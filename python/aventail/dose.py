"""Dose on a deforming patient: map, accumulate and compare doses, compute histograms. Doses in Gy.

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

from . import _errors, _given
from ._contours import Contours
from ._field import FieldLike
from ._image import Image, ImageLike, Names, _of_raster, grid_source, label_source, source, source_or_none
from ._measure import both
from ._native import native as _aventail
from ._progress import Progress, told
from ._registration import Frame, Registration

if TYPE_CHECKING:
    from .reports import DoseDifference, DoseReport, Dvh

__all__ = ["Compared", "Mapped", "accumulate", "compare", "dvh", "map"]


class Mapped(NamedTuple):
    """A dose in its new frame."""

    dose: Image
    """The mapped dose, Gy."""
    report: DoseReport
    """Energy balance, inversion residual, and where the result is doubtful."""

    def __repr__(self) -> str:
        return f"<aventail.dose.Mapped {self.report['direction']}: {self.dose!r}>"


class Compared(NamedTuple):
    """Comparison of two doses."""

    difference: Image
    """Dose minus reference, Gy, on the reference's grid."""
    distance: Image
    """Distance to dose difference, mm: from each voxel to the nearest one whose dose differs by the tolerance.

    A registration error below it changes no voxel's dose by the tolerance.
    """
    figures: DoseDifference
    """Statistics, Gy, over voxels that both doses cover and where either exceeds 10 % of the reference's maximum."""

    def __repr__(self) -> str:
        return f"<aventail.dose.Compared: {self.difference!r}>"


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
    """Maps a dose through a field: the planned dose ``to="fraction"``, or the dose of the day ``to="planning"``.

    ``interpolate`` takes the dose at the mapped point. ``energy-mass`` maps energy and mass
    together and conserves energy; it needs ``ct``, the CT in the frame that the dose comes from.
    The result lies on ``grid``; without it, on the grid of the field in the same frame.
    """
    forward = _given.choice("to", to, ("planning", "fraction")) == "fraction"
    by_mass = _given.choice("method", method, ("interpolate", "energy-mass")) == "energy-mass"
    parts, threads = _given.whole("parts", parts, 1, 8), _given.whole("threads", threads)
    directions = both(fields, planning_to_fraction, fraction_to_planning)
    mapping: dict[str, Any] = {
        "to_fraction": forward,
        "parts": parts if by_mass else None,
        "ct": source_or_none("ct", ct),
        "grid": grid_source("grid", grid),
    }
    given = source("dose", dose, "dose")
    with told(progress) as function:
        raster, report = _aventail.map_dose(given, directions, mapping, (threads, function))
    return Mapped(_of_raster(raster, "dose"), json.loads(report))


def accumulate(
    doses: Sequence[ImageLike], weights: Sequence[float] | None = None, *, fractions: Sequence[float] | None = None
) -> Image:
    """Adds doses that lie on one grid, as :func:`map` returns them. By default each counts once.

    If each dose is that of the whole plan, give ``weights``: the share of the plan delivered with
    it, from 0 to 1. If each dose is that of one fraction, give ``fractions``: the number of
    fractions delivered with it.
    """
    each = "give one number of 0 or more for each dose"
    shares = [] if weights is None else _given.numbers_of("weights", weights, each)
    times = [] if fractions is None else _given.numbers_of("fractions", fractions, each)
    all_of_them = _given.several("doses", doses, "give a list of doses")
    given = [source(f"doses[{n}]", dose, "dose") for n, dose in enumerate(all_of_them)]
    for name, counts in (("weights", weights), ("fractions", fractions)):
        if counts is not None and not (shares if name == "weights" else times) and given:
            raise _given.wrong(name, counts, each)
    return _of_raster(_aventail.accumulate(given, shares, times), "dose")


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
    given: dict[str, Any] = {"labels": None, "names": None, "contours": None, "contour_file": None}
    if isinstance(structures, (Contours, Mapping)):
        given["contours"] = Contours.of(structures)._json()
    elif _given.is_path(structures) and _of_contours(_given.path("structures", structures)):
        given["contour_file"] = _given.path("structures", structures)
    else:
        given["labels"], given["names"] = label_source(structures, labels, "structures")
    if labels is not None and given["labels"] is None:
        raise _errors.usage("labels has no meaning for contours, which have names", "leave labels out")
    doses = _given.numbers_of("at", at, "give doses of 0 Gy or more")
    if any(gy < 0 for gy in doses):
        raise _given.wrong("at", at, "give doses of 0 Gy or more")
    width = _given.number("bin", bin, "give the width of a bin, 0.001 Gy or more")
    curves: list[Dvh] = json.loads(_aventail.dvh(source("dose", dose, "dose"), given, doses, width))
    return curves


def _of_contours(path: str) -> bool:
    """Whether a file holds contours: a JSON, DICOM, or a folder with a structure set."""
    return path.lower().endswith((".json", ".dcm")) or os.path.isdir(path)


def compare(
    dose: ImageLike, reference: ImageLike, *, tolerance: float | None = None, limit: float = 20.0
) -> Compared:
    """Compares two doses in one frame: their difference, and the distance to dose difference.

    ``tolerance`` is the dose difference that matters, Gy (default: 3 % of the reference's maximum).
    ``limit`` is the largest distance that is searched, mm.
    """
    least = None if tolerance is None else _given.number("tolerance", tolerance, "give a dose above 0 Gy")
    most = _given.number("limit", limit, "give a distance above 0 and up to 100 mm")
    given, other = source("dose", dose, "dose"), source("reference", reference, "dose")
    difference, distance, figures = _aventail.compare_doses(given, other, least, most)
    return Compared(_of_raster(difference, "image"), _of_raster(distance, "image"), json.loads(figures))
