"""Summary of many runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import _errors, _given
from ._image import Path
from ._native import native as _aventail

if TYPE_CHECKING:
    from .reports import CohortSummary


def summary(runs: Path | Sequence[Path], out: Path | None = None, *, anonymous: bool = False) -> CohortSummary:
    """Summarises saved registrations: their numbers (``figures``), medians and outliers (``stand_apart``).

    ``runs`` are folders of saved registrations, or folders that contain them
    (``PATIENT/FRACTION``), at most six levels deep. The patient of a run is the one named in its
    DICOM; without DICOM, or with ``anonymous``, it is the name of the folder around the run. With
    ``out`` the files of ``aventail summary`` are written there: ``summary.html``, ``summary.csv``
    and ``summary.json``. A number is an outlier if it is worse than the median by more than 3.5
    modified z-scores and by an amount that matters; five runs are needed.

    >>> import tempfile, aventail
    >>> phantom = aventail.phantom(spacing=(9, 9, 9))
    >>> run = aventail.register(phantom.planning, phantom.bones, phantom.fraction, settings="fast")
    >>> with tempfile.TemporaryDirectory() as cohort:
    ...     for patient in ("anna", "bert"):
    ...         run.save(f"{cohort}/{patient}/monday", view=False)
    ...     found = aventail.summary(cohort, out=f"{cohort}/summary")
    >>> [(row["patient"], row["fraction"], row["stand_apart"]) for row in found["runs"]]
    [('anna', 'monday', []), ('bert', 'monday', [])]
    >>> sorted(file["name"] for file in found["outputs"])
    ['summary.csv', 'summary.html']
    """
    folders, target = _given.paths("runs", runs), _given.path_or_none("out", out)
    if not folders:
        raise _given.wrong("runs", runs, "give at least one folder")
    with _errors.naming(out="out"):
        found: CohortSummary = json.loads(_aventail.summary(folders, target, _given.flag("anonymous", anonymous)))
    return found
