"""Contours of structures: closed planar polygons, LPS mm."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _aventail
from ._image import Path

_AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Contours:
    """Polygons by the name of their structure, on parallel planes.

    >>> import aventail
    >>> square = [[0, 0, 9], [8, 0, 9], [8, 8, 9], [0, 8, 9]]
    >>> contours = aventail.Contours({"target": [square]})
    >>> contours.structures["target"][0].shape
    (4, 3)
    """

    structures: Mapping[str, Sequence[NDArray[np.float64]]]
    """Polygons of each structure, arrays of shape (n, 3), LPS mm; inner polygons are holes."""
    orientation: tuple[float, float, float, float, float, float] = _AXIAL
    """The two in-plane axes."""
    colours: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """Colour of a structure, red, green, blue."""

    def __post_init__(self) -> None:
        own = {name: [np.asarray(p, np.float64) for p in polygons] for name, polygons in self.structures.items()}
        object.__setattr__(self, "structures", own)

    @classmethod
    def of(cls, thing: Contours | Path | Mapping[str, Any]) -> Contours:
        """Contours of a contour JSON, a DICOM structure set, or polygons by name."""
        if isinstance(thing, Contours):
            return thing
        if isinstance(thing, (str, os.PathLike)):
            return cls._parse(_aventail.read_contours(os.fspath(thing)))
        return cls(thing)

    def save(self, path: Path, frame: str = "planning") -> None:
        """Writes a contour JSON (docs/formats.md) of contours that lie in ``frame``."""
        _aventail.write_contours(os.fspath(path), self._json(), frame)

    def save_dicom(self, path: Path, like: Path, *, of: Path | None = None) -> None:
        """Writes a structure set, ``*.dcm``, on the slices of ``like``, the folder of a DICOM series in whose frame they lie.

        ``of`` is the structure set that they come from: structures keep its numbers and types, and it must be of the
        patient of ``like``. What ``aventail warp --dicom-like`` writes.
        """
        source = None if of is None else os.fspath(of)
        _aventail.write_dicom_contours(os.fspath(path), self._json(), os.fspath(like), source)

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
