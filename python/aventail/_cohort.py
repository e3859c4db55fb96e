"""Many runs side by side."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import _aventail
from ._image import Path

if TYPE_CHECKING:
    from .reports import CohortSummary


def summary(runs: Path | Sequence[Path], out: Path | None = None, *, anonymous: bool = False) -> CohortSummary:
    """Gathers saved registrations: their figures, what stands apart from the others, and medians.

    ``runs`` are folders of saved registrations, or folders that hold them, ``PATIENT/FRACTION``, six levels deep. A run's
    patient is the one that its DICOM names, else, and with ``anonymous``, the folder around it. With ``out`` the files of
    ``aventail summary`` are written there: ``summary.html``, ``summary.csv`` and ``summary.json``. A figure stands apart
    where it is worse than the median by more than 3.5 modified z-scores and by an amount that matters; five runs are needed.

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
    folders = [runs] if isinstance(runs, (str, os.PathLike)) else runs
    told = _aventail.summary([os.fspath(f) for f in folders], None if out is None else os.fspath(out), anonymous)
    found: CohortSummary = json.loads(told)
    return found
