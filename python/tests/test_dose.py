"""Dose: carried, added up, compared, counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aventail


def test_a_shifted_dose_is_shifted(tmp_path: Path) -> None:
    grid = {"spacing": (2.0, 2.0, 2.0), "origin": (0.0, 0.0, 0.0)}
    dose = np.zeros((10, 10, 10), np.float32)
    dose[4:7, 4:7, 4:7] = 10.0
    # Fraction y shows planning y + v: what lies at x in planning lies at x - v.
    vectors = np.zeros((10, 10, 10, 3), np.float32)
    vectors[..., 0] = -4.0
    pull = aventail.Field(aventail.Image(vectors, **grid), "fraction", "planning")
    planned = aventail.Image(dose, **grid, kind="dose")
    mapped = aventail.dose.map(planned, pull, to="fraction")
    assert np.array_equal(mapped.dose.array[4:7, 4:7, 6:9], dose[4:7, 4:7, 4:7])
    assert mapped.dose.array.sum() == dose.sum()
    pull.save(tmp_path / "pull.nii.gz")
    by_file = aventail.dose.map(planned, fraction_to_planning=tmp_path / "pull.nii.gz", to="fraction")
    assert np.array_equal(by_file.dose.array, mapped.dose.array)
    for wrong in (pull, tmp_path / "pull.nii.gz"):
        with pytest.raises(aventail.InputError, match="fraction points? to planning"):
            aventail.dose.map(planned, planning_to_fraction=wrong, to="fraction")
    total = aventail.dose.accumulate([planned, mapped.dose], fractions=[2, 0.5])
    assert np.allclose(total.array, 2 * dose + 0.5 * mapped.dose.array)
    planned.save(tmp_path / "day.nii.gz")
    assert np.allclose(aventail.dose.accumulate([planned, tmp_path / "day.nii.gz"]).array, 2 * dose)
    with pytest.raises(aventail.UsageError, match="more than a whole plan"):
        aventail.dose.accumulate([planned, mapped.dose], [20, 15])
    with pytest.raises(aventail.InputError, match="500 Gy"):
        aventail.dose.accumulate([planned, mapped.dose], fractions=[20, 35])
    compared = aventail.dose.compare(mapped.dose, planned)
    assert np.allclose(compared.difference.array, mapped.dose.array - dose)
    assert compared.figures["magnitude"]["max"] == pytest.approx(10.0)


def test_energy_is_conserved(phantom: aventail.Phantom) -> None:
    mapped = aventail.dose.map(
        phantom.dose, phantom.truth, to="fraction", method="energy-mass", ct=phantom.planning, grid=phantom.fraction
    )
    balance = mapped.report["balance"]
    assert balance is not None
    assert balance["mapped_j"] + balance["outside_j"] == pytest.approx(balance["source_j"], rel=1e-6)
    assert mapped.dose.size == phantom.fraction.size


def test_histograms_of_contours_and_of_labels_agree(phantom: aventail.Phantom, tmp_path: Path) -> None:
    phantom.contours.save(tmp_path / "c.json")
    by_value = aventail.dose.dvh(phantom.dose, phantom.contours, at=[20.0, 50.0])
    by_file = aventail.dose.dvh(phantom.dose, tmp_path / "c.json", at=[20.0, 50.0])
    assert [c["mean"] for c in by_file] == pytest.approx([c["mean"] for c in by_value], rel=1e-3)
    target = next(c for c in by_value if c["name"] == "ctv")
    assert target["mean"] == pytest.approx(60.0, abs=2.0) and target["v"][0]["percent"] == pytest.approx(100.0)
    labels = aventail.dose.dvh(phantom.dose, phantom.bones)
    assert {c["name"] for c in labels} <= set((phantom.bones.names or {}).values())
    square = {"box": [[[0, 0, z], [40, 0, z], [40, 40, z], [0, 40, z]] for z in (-60.0, -57.0, -54.0)]}
    assert aventail.dose.dvh(phantom.dose, square)[0]["volume_ml"] == pytest.approx(40 * 40 * 9 / 1000, rel=0.05)


def test_what_is_no_dose_is_refused(phantom: aventail.Phantom) -> None:
    with pytest.raises(aventail.InputError) as refused:
        aventail.dose.dvh(phantom.planning, phantom.contours)
    assert (refused.value.code, refused.value.exit_code) == ("dose-units", 4)
