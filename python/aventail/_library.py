"""Artificial CTs of one patient in many postures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from . import _errors, _given
from ._case import Settings, settings_source
from ._image import Path
from ._native import native as _aventail
from ._progress import Progress, told

if TYPE_CHECKING:
    from .reports import Library, PostureModes


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
    """Makes artificial CTs in randomly drawn postures, with their true fields and labels, as ``aventail library`` does.

    First come the postures listed in ``plan`` (TOML, docs/library.md), then ``sample`` random ones:
    those usual between fractions, or those of the plan. All results are files in the folder
    ``out``. Each posture has its CT, labels, pose, both fields (unless ``fields`` is false), and
    the ``structures`` and ``dose`` mapped to it. There are also a page and ``library.json``, a
    MONAI datalist, which this function returns. ``reject=True`` replaces implausible postures by
    new draws. ``volume_change`` draws organ volumes, ``{"parotid_left": (0.7, 1.0)}``. ``cbct``
    also writes simulated cone-beam CTs; ``noise_hu`` instead adds white noise of this standard
    deviation, HU. A library that was stopped continues when it is called again with the same
    settings. After Ctrl-C the current posture is finished first.

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
    files = {"plan": plan, "labels": labels, "organs": organs, "skeleton": skeleton, "structures": structures, "dose": dose}
    as_file = _given.is_path(cbct)
    noise = None if noise_hu is None else _given.within("noise_hu", noise_hu, 0, 1000)
    if noise == 0:
        raise _given.wrong("noise_hu", noise_hu, "give more than 0, or leave it out")
    if noise is not None and (as_file or _given.flag("cbct", cbct)):
        raise _errors.usage("cbct and noise_hu are both given, and a cone-beam CT brings its own noise", "give one of them")
    wanted: dict[str, Any] = {
        "planning": _given.path("planning", planning),
        "bones": _given.path("bones", bones),
        "out": _given.path("out", out),
        "sample": None if sample is None else _given.whole("sample", sample),
        "seed": _given.whole("seed", seed),
        "reject": _given.flag("reject", reject),
        "margin": _given.within("margin_mm", margin_mm, 0, 500),
        "volume_change": _ranges(volume_change),
        "fields": _given.flag("fields", fields),
        "cbct": as_file or _given.flag("cbct", cbct),
        "cbct_file": _given.path("cbct", cbct) if as_file else None,
        "noise": noise,
    }
    wanted |= {name: _given.path_or_none(name, thing) for name, thing in files.items()}
    settled, threads = settings_source(settings), _given.whole("threads", threads)
    with told(progress) as function, _errors.naming(out="out"):
        made: Library = json.loads(_aventail.make_library(wanted, settled, (threads, function)))
    return made


def library_modes(runs: Sequence[Path], out: Path) -> PostureModes:
    """Finds the principal modes of motion in a patient's own fractions; writes them to ``out`` as a plan, ``postures.toml``.

    ``runs`` are folders of two or more saved registrations of one planning CT.
    ``aventail library --fit`` does the same.
    """
    with _errors.naming(out="out"):
        text = _aventail.fit_postures(_given.paths("runs", runs), _given.path("out", out))
    found: PostureModes = json.loads(text)
    return found


def _ranges(volume_change: Mapping[str, tuple[float, float]] | None) -> list[tuple[str, list[float]]]:
    """Ranges of organs' volumes."""
    remedy = 'give ranges by organ, {"parotid_left": (0.7, 1.0)}'
    ranges = [] if volume_change is None else _given.named("volume_change", volume_change, remedy)
    return [
        (organ, _given.array(f"volume_change[{organ!r}]", both, (2,), remedy).tolist()) for organ, both in ranges
    ]
