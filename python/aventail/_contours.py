"""Contours of structures: closed planar polygons, LPS mm."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _errors, _given
from ._image import Path, perpendicular
from ._native import native as _aventail

_AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_REMEDY = 'give polygons by name, {"ctv": [polygon, ...]}, each an array of shape (n, 3), LPS mm'


@dataclass(frozen=True, eq=False)
class Contours:
    """Polygons on parallel planes, by the name of their structure.

    >>> import aventail
    >>> square = [[0, 0, 9], [8, 0, 9], [8, 8, 9], [0, 8, 9]]
    >>> contours = aventail.Contours({"target": [square]})
    >>> contours.structures["target"][0].shape
    (4, 3)
    """

    structures: Mapping[str, Sequence[NDArray[np.float64]]]
    """Polygons of each structure, arrays of shape (n, 3), LPS mm; inner polygons are holes."""
    orientation: tuple[float, float, float, float, float, float] = _AXIAL
    """Unit vectors of the two in-plane axes, six numbers."""
    colours: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """Colour of a structure, red, green, blue."""

    def __post_init__(self) -> None:
        own = {name: _polygons(name, polygons) for name, polygons in _given.named("structures", self.structures, _REMEDY)}
        axes = _given.array("orientation", self.orientation, (6,), "give two perpendicular unit vectors, six numbers")
        perpendicular("orientation", axes.reshape(2, 3).T, self.orientation)
        colours = _given.named("colours", self.colours, 'give {"ctv": (255, 0, 0)}')
        object.__setattr__(self, "structures", own)
        object.__setattr__(self, "orientation", tuple(axes.tolist()))
        object.__setattr__(self, "colours", {name: _colour(name, colour) for name, colour in colours})

    def __repr__(self) -> str:
        names = list(self.structures)
        told = ", ".join(name[:24] for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        polygons = sum(len(polygons) for polygons in self.structures.values())
        return f"<aventail.Contours {told or 'without structures'}; {polygons} polygons>"

    @classmethod
    def of(cls, thing: Contours | Path | Mapping[str, Any]) -> Contours:
        """Makes contours from a contour JSON, a DICOM structure set, or polygons by name."""
        if isinstance(thing, Contours):
            return thing
        if _given.is_path(thing):
            return cls._parse(_aventail.read_contours(_given.path("contours", thing)))
        return cls(_given.table("contours", thing, f"give a file of them, aventail.Contours, or {_REMEDY[5:]}"))

    def save(self, path: Path, frame: str = "planning") -> None:
        """Writes a contour JSON (docs/formats.md); ``frame`` is the frame in which the contours lie."""
        _aventail.write_contours(_given.path("path", path), self._json(), _given.word("frame", frame))

    def save_dicom(self, path: Path, like: Path, *, of: Path | None = None) -> None:
        """Writes a structure set, ``*.dcm``, on the slices of ``like``: the folder of the DICOM series in whose frame they lie.

        ``of`` is the structure set that they come from: structures keep its numbers and types. It
        must belong to the patient of ``like``. ``aventail warp --dicom-like`` writes the same.
        """
        out, scan, source = _given.path("path", path), _given.path("like", like), _given.path_or_none("of", of)
        with _errors.naming(out="path"):
            _aventail.write_dicom_contours(out, self._json(), scan, source)

    def _json(self) -> str:
        def structure(name: str, polygons: Sequence[NDArray[np.float64]]) -> dict[str, Any]:
            entry: dict[str, Any] = {"name": name, "contours": [p.tolist() for p in polygons]}
            if name in self.colours:
                entry["colour"] = list(self.colours[name])
            return entry

        structures = [structure(name, polygons) for name, polygons in self.structures.items()]
        return json.dumps(
            {"aventail_contours": 1, "orientation": list(self.orientation), "structures": structures}, allow_nan=False
        )

    @classmethod
    def _parse(cls, text: str) -> Contours:
        file = json.loads(text)
        structures = {s["name"]: [np.asarray(p, np.float64) for p in s["contours"]] for s in file["structures"]}
        colours = {s["name"]: tuple(s["colour"]) for s in file["structures"] if "colour" in s}
        return cls(structures, tuple(file.get("orientation", _AXIAL)), colours)


def _polygons(name: str, polygons: Any) -> list[NDArray[np.float64]]:
    given = _given.several(f"structures[{name!r}]", polygons, _REMEDY)
    return [_given.array(f"structures[{name!r}][{n}]", one, (None, 3), _REMEDY) for n, one in enumerate(given)]


def _colour(name: str, colour: Any) -> tuple[int, int, int]:
    remedy = "give red, green and blue, from 0 to 255"
    own = f"colours[{name!r}]"
    parts = [_given.whole(own, part, 0, 255) for part in _given.several(own, colour, remedy)]
    if len(parts) != 3:
        raise _given.wrong(own, colour, remedy)
    return parts[0], parts[1], parts[2]
