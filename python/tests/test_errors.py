"""Errors are exceptions by cause, with the program's exit codes."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import aventail


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
