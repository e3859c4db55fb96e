"""Errors are exceptions by cause, with the program's exit codes."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

import aventail
from aventail._errors import _ARGUMENTS, in_python


def refused(kind: type[aventail.Error], *arguments: object, **keywords: object) -> aventail.Error:
    with pytest.raises(kind) as caught:
        aventail.register(*arguments, **keywords)  # type: ignore[arg-type]
    error = caught.value
    assert error.cause and error.remedy and error.remedy in str(error)
    return error


def test_causes_and_exit_codes(phantom: aventail.Phantom, tmp_path: Path) -> None:
    p, b, f = phantom.planning, phantom.bones, phantom.fraction
    error = refused(aventail.ReadError, tmp_path / "none.nii.gz", b, f)
    assert error.exit_code == 3 and error.what == str(tmp_path / "none.nii.gz")
    assert refused(aventail.UsageError, p, b, f, settings={"chainmail": {"exponant": 2}}).exit_code == 2
    assert "exponant" in str(refused(aventail.UsageError, p, b, f, settings={"chainmail": {"exponant": 2}}))
    assert "slow" in str(refused(aventail.UsageError, p, b, f, settings="slow"))
    assert "threads" in str(refused(aventail.UsageError, p, b, f, threads=10**6))
    # Labels on another grid, labels without names, values that are no labels, a CT that is none.
    moved = aventail.Image(b.array, b.spacing, (0, 0, 0), b.direction, b.names, "labels")
    assert refused(aventail.InputError, p, moved, f).exit_code == 4
    bare = aventail.Image(b.array, b.spacing, b.origin, b.direction)
    assert "without a name" in str(refused(aventail.InputError, p, bare, f))
    half = aventail.Image(b.array + 0.5, b.spacing, b.origin, b.direction, b.names)
    assert "no whole number" in str(refused(aventail.InputError, p, half, f))
    flat = aventail.Image(np.zeros_like(f.array), f.spacing, f.origin, f.direction)
    assert refused(aventail.InputError, p, b, flat).what == "fraction CT"
    holes = f.array.copy()
    holes[3, 3, 3] = np.nan
    assert "NaN" in str(refused(aventail.InputError, p, b, aventail.Image(holes, f.spacing, f.origin, f.direction)))


def test_a_bare_array_has_no_geometry(phantom: aventail.Phantom) -> None:
    assert "geometry" in str(refused(aventail.UsageError, phantom.planning.array, phantom.bones, phantom.fraction))


def test_a_result_that_cannot_be_written(registration: aventail.Registration, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(aventail.WriteError) as caught:
        registration.save(tmp_path / "file" / "out")
    assert caught.value.exit_code == 5
    with pytest.raises(aventail.UsageError):
        registration.planning_to_fraction.save(tmp_path / "field.xyz")


def test_what_a_volume_is_must_be_known(registration: aventail.Registration, phantom: aventail.Phantom) -> None:
    bare = aventail.Image(phantom.planning.array, phantom.planning.spacing)
    with pytest.raises(aventail.UsageError, match="kind"):
        registration.warp(bare, to="fraction")
    with pytest.raises(aventail.UsageError, match="sideways"):
        registration.warp(phantom.planning, to="sideways")  # type: ignore[call-overload]


def test_errors_travel_between_processes() -> None:
    error = pickle.loads(pickle.dumps(aventail.InputError("a: b\n  remedy: c", "a", "b", "c", "code")))
    assert isinstance(error, aventail.InputError)
    assert (str(error), error.what, error.cause, error.remedy, error.code) == ("a: b\n  remedy: c", "a", "b", "c", "code")


# Strings of the library that may be told; the program's own verbs are left out but for what Python calls of them.
SOURCES = [
    path
    for path in sorted((ROOT / "src").rglob("*.rs"))
    if path.stem not in ("tests", "args") and (not {"tests", "cli"} & set(path.parts) or path.parent.name == "library")
]
# Options of other programs, and of verbs that Python does not call.
OTHERS = {
    "around": "curve",
    "at": "figure",
    "direction": "evaluate, where no option names the direction",
    "max-memory": "register",
    "ml": "TotalSegmentator",
    "only-bones": "labels merge",
    "json": "labels merge",
    "raw": "gdcmconv",
    "roi": "register",
    "roi_subset": "TotalSegmentator",
    "scale-by-jacobian": "warp, of masks",
    "space": "warp, of points and matrices",
    "task": "TotalSegmentator",
    "version": "TotalSegmentator",
    "labels-planning": "evaluate's page",
    "labels-fraction": "evaluate's page",
}


def test_messages_name_arguments_and_not_options() -> None:
    for text, own in {
        "add --ct FILE, the CT, or take --method interpolate": 'add ct, the CT, or take method="interpolate"',
        "give another --out: a folder holds one run": "give another folder: a folder holds one run",
        "give the --out folders of finished runs": "give the folders of finished runs",
        "a file for --skeleton (`aventail skeleton --out` writes one)": "a file for skeleton (`aventail skeleton --out` writes one)",
        "written with --ml, or name it in --volume-change.": "written with --ml, or name it in volume_change.",
        "/data/run--out/x.nii and /data/--out/y: --labels": "/data/run--out/x.nii and /data/--out/y: labels",
        "but --planning-to-fraction takes planning points": "but planning_to_fraction takes planning points",
        "an MR needs --modality mr": 'an MR needs settings={"fraction": {"modality": "mr"}}',
        "--match skul: no bone has this name": "couch in the settings, skul: no bone has this name",
        "made by `--bones auto`": 'made by `bones="auto"`',
    }.items():
        assert in_python(text) == own
    known, seen = set(_ARGUMENTS), set()
    for path in SOURCES:
        code = path.read_text().split("#[cfg(test)]")[0]
        told = "\n".join(line for line in code.splitlines() if not line.lstrip().startswith("//"))
        # Commands of the program, and the pages' style.
        told = re.sub(r"`[a-z][^`]*`|var\(--[^)]*\)|--[a-z]+:", "", told)
        seen |= set(re.findall(r"(?<![\w/.-])--([a-z][a-z_-]*[a-z])(?![\w(])", told))
    assert seen - known - set(OTHERS) == set(), "an option without a name in Python"
    assert {"organs", "labels", "bone-landmarks", "start", "out", *OTHERS} <= seen


def test_errors_and_warnings_name_arguments(phantom: aventail.Phantom, tmp_path: Path) -> None:
    p = phantom
    bare = tmp_path / "bare.nii.gz"
    aventail.Image(p.bones.array, p.bones.spacing, p.bones.origin, kind="labels").save(bare)
    p.planning.save(tmp_path / "ct.nii.gz")
    p.bones.save(tmp_path / "bones.nii.gz")
    calls: dict[str, Any] = {
        "labels": lambda: aventail.skeleton(bare),
        "ct": lambda: aventail.dose.map(p.dose, p.truth, to="fraction", grid=p.fraction, method="energy-mass"),
        "settings": lambda: aventail.register(p.planning, p.bones, p.fraction, settings=tmp_path / "none.toml"),
        "threads": lambda: aventail.register(p.planning, p.bones, p.fraction, threads=10**6),
        "sample": lambda: aventail.library(tmp_path / "ct.nii.gz", tmp_path / "bones.nii.gz", tmp_path / "out"),
        "folder": lambda: aventail.library_modes([tmp_path / "a", tmp_path / "b"], tmp_path / "out"),
        "fraction_to_planning": lambda: aventail.evaluate(planning_to_fraction=pulled, bones=p.bones),
    }
    pulled = tmp_path / "pull.nii.gz"
    aventail.Field(p.truth.image, "fraction", "planning").save(pulled)
    for name, call in calls.items():
        with pytest.raises(aventail.Error) as caught:
            call()
        told = (str(caught.value), caught.value.cause, caught.value.remedy)
        left = re.findall(r"(?<![\w`])--([a-z-]+)", " ".join(told))
        assert name in told[0] and set(left) <= {"ml"}, told
