"""What README, docs/python.md, the notebook and the docstrings say runs."""

from __future__ import annotations

import doctest
import importlib
import json
import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from test_program import program

import aventail


@pytest.fixture
def files(phantom: aventail.Phantom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the examples name."""
    phantom.planning.save(tmp_path / "planning_ct.nii.gz")
    phantom.bones.save(tmp_path / "bones.nii.gz")
    phantom.fraction.save(tmp_path / "fraction_ct.nii.gz")
    phantom.dose.save(tmp_path / "dose.nii.gz")
    phantom.contours.save(tmp_path / "contours.json")
    done = program("phantom", "--dicom", "--spacing", "5x5x6", "--out", tmp_path / "export")
    assert done.returncode == 0, done.stderr
    for series in ("planning", "fraction"):
        (tmp_path / "export" / "dicom" / series).rename(tmp_path / series)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks(path: Path) -> list[str]:
    """The Python in a page."""
    return re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)


def test_the_readmes_example(files: Path) -> None:
    [code] = blocks(ROOT / "README.md")
    assert len(code.strip().splitlines()) <= 10
    pytest.importorskip("SimpleITK")
    exec(code, {})
    assert (files / "out" / "report.html").exists()


def test_the_pages_examples(files: Path) -> None:
    pytest.importorskip("SimpleITK")
    names: dict[str, Any] = {}
    for code in blocks(ROOT / "docs" / "python.md"):
        exec(code, names)


def test_the_packages_page(files: Path) -> None:
    for code in blocks(ROOT / "python" / "README.md"):
        exec(code, {})


def test_the_notebook(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: the notebook is not run")
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs" / "notebook.ipynb").read_text())
    names: dict[str, Any] = {}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 5
    for cell in cells:
        assert not cell["outputs"], "the notebook is kept without outputs"
        exec("".join(cell["source"]), names)


def test_docstrings() -> None:
    modules = [aventail, *(importlib.import_module(f"aventail.{m.name}") for m in pkgutil.iter_modules(aventail.__path__))]
    results = [doctest.testmod(module) for module in modules if hasattr(module, "__file__")]
    assert sum(r.failed for r in results) == 0 and sum(r.attempted for r in results) > 15
