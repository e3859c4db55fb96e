"""A library of postures is that of the program, file by file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from test_clinic import files
from test_program import program
from test_registration import keys_match

import aventail


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The phantom's files, coarse."""
    out = tmp_path_factory.mktemp("library") / "phantom"
    done = program("phantom", "--spacing", "9x9x9", "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def test_the_postures_are_the_programs(scans: Path, tmp_path: Path) -> None:
    told: list[str] = []
    given = [scans / "planning_ct.nii.gz", scans / "bones.nii.gz"]
    more = {"structures": scans / "contours.json", "dose": scans / "dose.nii.gz"}
    made = aventail.library(
        *given,
        tmp_path / "own",
        sample=2,
        seed=3,
        noise_hu=20.0,
        settings={"output": {"field_format": "metaimage"}},
        progress=lambda stage, share: told.append(stage),
        **more,
    )
    keys_match(made, aventail.reports.Library, "library")
    assert any(stage.startswith("1 of 2") for stage in told), told
    options = [f"--planning={given[0]}", f"--bones={given[1]}", "--sample=2", "--seed=3", "--noise=20"]
    options += [f"--{name}={path}" for name, path in more.items()] + ["--dvf-format=mha", "--quiet"]
    done = program("library", *options, f"--out={tmp_path / 'other'}")
    assert done.returncode == 0, done.stderr
    own, other = files(tmp_path / "own"), files(tmp_path / "other")
    assert own.keys() == other.keys() and len(own) > 20
    # Time and command are told in these.
    telling = ("posture.json", "library.json", "library.html")
    assert [name for name in own if own[name] != other[name] and not name.endswith(telling)] == []
    manifest: dict[str, Any] = json.loads(own["library.json"])
    assert manifest == made and made["command"] == "aventail (Python)"
    by_program = json.loads(other["library.json"])
    assert (made["training"], made["implausible"]) == (by_program["training"], by_program["implausible"])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"sample": 0}, "0 postures"), ({"sample": 1, "noise_hu": -1.0}, "noise"), ({}, "no posture is asked for")],
)
def test_what_makes_no_library_is_refused(scans: Path, tmp_path: Path, wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(aventail.UsageError, match=said):
        aventail.library(scans / "planning_ct.nii.gz", scans / "bones.nii.gz", tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()


def test_modes_of_fractions_are_the_programs(registration: aventail.Registration, tmp_path: Path) -> None:
    registration.save(tmp_path / "fx1", view=False)
    report = json.loads((tmp_path / "fx1" / "report.json").read_text())
    # Another day: another turn of the first joint below the root.
    report["pose"]["joints"][1]["rotation"][0] += 0.02
    (tmp_path / "fx2").mkdir()
    (tmp_path / "fx2" / "report.json").write_text(json.dumps(report))
    runs = [tmp_path / "fx1", tmp_path / "fx2"]
    found = aventail.library_modes(runs, tmp_path / "own")
    keys_match(found, aventail.reports.PostureModes, "modes")
    assert len(found["modes"]) == 1 and abs(found["modes"][0]["share"] - 1.0) < 1e-9
    done = program("library", "--fit", *runs, "--out", tmp_path / "other")
    assert done.returncode == 0, done.stderr
    plans = [(tmp_path / folder / "postures.toml").read_bytes() for folder in ("own", "other")]
    assert plans[0] == plans[1]
