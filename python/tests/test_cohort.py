"""Many runs side by side, as the program gathers them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from test_program import program
from test_registration import keys_match

import aventail


@pytest.fixture
def cohort(registration: aventail.Registration, tmp_path: Path) -> Path:
    """Two patients with three fractions each, copies of one run; one of them has landmarks far off."""
    registration.save(tmp_path / "run", view=False)
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    for patient in ("anna", "bert"):
        for number, fraction in enumerate(("fx1", "fx2", "fx10")):
            own: dict[str, Any] = json.loads(json.dumps(report))
            odd = (patient, fraction) == ("bert", "fx10")
            own["landmarks"]["after"]["mean"] = 8.0 if odd else 0.5 + 0.01 * number
            folder = tmp_path / "cohort" / patient / fraction
            folder.mkdir(parents=True)
            (folder / "report.json").write_text(json.dumps(own))
    return tmp_path / "cohort"


def test_the_files_are_the_programs(cohort: Path, tmp_path: Path) -> None:
    found = aventail.summary(cohort, out=tmp_path / "own")
    done = program("summary", cohort, "--out", tmp_path / "other")
    assert done.returncode == 0, done.stderr
    own, other = tmp_path / "own", tmp_path / "other"
    assert (own / "summary.csv").read_bytes() == (other / "summary.csv").read_bytes()
    # Who asked, and when, is in the page and the JSON.
    pages = [(folder / "summary.html").read_text() for folder in (own, other)]
    records = [json.loads((folder / "summary.json").read_text()) for folder in (own, other)]
    assert found == records[0]
    commands = [record.pop("command") for record in records]
    assert commands[0] == "aventail (Python)" and "summary" in commands[1]
    for record in records:
        assert [file["name"] for file in record.pop("outputs")] == ["summary.csv", "summary.html"]
        record.pop("created")
    assert records[0] == records[1]
    assert pages[0].replace(commands[0], "") == pages[1].replace(commands[1], "")


def test_rows_are_typed_and_the_odd_run_is_found(cohort: Path) -> None:
    found = aventail.summary([cohort / "anna", cohort / "bert"], anonymous=True)
    keys_match(found, aventail.reports.CohortSummary, "summary")
    assert [run["fraction"] for run in found["runs"]] == ["fx1", "fx2", "fx10"] * 2
    assert [run["stand_apart"] for run in found["runs"]] == [[]] * 5 + [["landmarks_mean_mm"]]
    assert found["outputs"] == [] and not list(cohort.rglob("summary.*"))
    (cohort / "empty").mkdir()
    with pytest.raises(aventail.InputError, match=r"report\.json") as raised:
        aventail.summary(cohort / "empty")
    assert raised.value.code == "no-run"
