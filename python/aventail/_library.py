"""Artificial CTs of one patient in many postures."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from . import _aventail
from ._image import Path
from ._progress import Progress, told
from ._registration import Settings, settings_source

if TYPE_CHECKING:
    from .reports import Library, PostureModes


def _path(thing: Path | None) -> str | None:
    return None if thing is None else os.fspath(thing)


def library(
    planning: Path,
    bones: Path,
    out: Path,
    *,
    sample: int | None = None,
    plan: Path | None = None,
    seed: int = 1,
    reject: bool = False,
    margin_mm: float = 0.0,
    labels: Path | None = None,
    organs: Path | None = None,
    volume_change: Mapping[str, tuple[float, float]] | None = None,
    skeleton: Path | None = None,
    structures: Path | None = None,
    dose: Path | None = None,
    fields: bool = True,
    cbct: bool | Path = False,
    noise_hu: float | None = None,
    settings: Settings = None,
    threads: int = 0,
    progress: Progress = None,
) -> Library:
    """Makes artificial CTs in sampled postures, with all that is true about them, as ``aventail library`` does.

    ``sample`` postures are drawn, of those that are usual between fractions or of a ``plan`` (TOML, docs/library.md), after
    those that the plan lists. Everything is a file and is written to the folder ``out``: for each posture its CT, labels,
    pose, both fields (unless ``fields`` is false), and the ``structures`` and ``dose`` that are carried along;
    ``library.json``, which is MONAI's datalist and what comes back here; a page. ``reject`` draws again where a posture is
    implausible. ``volume_change`` draws volumes of organs, ``{"parotid_left": (0.7, 1.0)}``. ``cbct``, or white noise of
    ``noise_hu``, makes images as a machine would show them too. A library that was stopped goes on when it is asked for
    again with the same settings; Ctrl-C waits for the posture at hand.

    >>> import pathlib, tempfile, aventail
    >>> phantom = aventail.phantom(spacing=(9, 9, 9))
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = pathlib.Path(name)
    ...     phantom.planning.save(folder / "ct.nii.gz")
    ...     phantom.bones.save(folder / "bones.nii.gz")
    ...     made = aventail.library(folder / "ct.nii.gz", folder / "bones.nii.gz", folder / "out", sample=1, fields=False)
    ...     sorted(path.name for path in (folder / "out").iterdir())
    ['library.html', 'library.json', 'posture_001', 'postures.toml']
    >>> len(made["training"] + made["implausible"])
    1
    """
    wanted: dict[str, Any] = {
        "planning": os.fspath(planning),
        "bones": os.fspath(bones),
        "out": os.fspath(out),
        "plan": _path(plan),
        "sample": sample,
        "seed": seed,
        "reject": reject,
        "margin": float(margin_mm),
        "labels": _path(labels),
        "organs": _path(organs),
        "volume_change": [(organ, [float(a), float(b)]) for organ, (a, b) in (volume_change or {}).items()],
        "skeleton": _path(skeleton),
        "structures": _path(structures),
        "dose": _path(dose),
        "fields": fields,
        "cbct": cbct is not False,
        "cbct_file": None if isinstance(cbct, bool) else os.fspath(cbct),
        "noise": noise_hu,
    }
    with told(progress) as function:
        made: Library = json.loads(_aventail.make_library(wanted, settings_source(settings), threads, function))
    return made


def library_modes(runs: Sequence[Path], out: Path) -> PostureModes:
    """Finds the principal modes of a patient's own fractions, and writes them into ``out`` as a plan, ``postures.toml``.

    ``runs`` are folders of two or more saved registrations of one planning CT; what ``aventail library --fit`` does.
    """
    found: PostureModes = json.loads(_aventail.fit_postures([os.fspath(run) for run in runs], os.fspath(out)))
    return found
