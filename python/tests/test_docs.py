"""What README, docs/python.md, the notebook and the docstrings say runs."""

from __future__ import annotations

import doctest
import importlib
import json
import pkgutil
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from test_program import program

import aventail


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the examples name, of large voxels: what they print is not looked at."""
    out = tmp_path_factory.mktemp("examples")
    phantom = aventail.phantom(spacing=(9, 9, 9))
    phantom.planning.save(out / "planning_ct.nii.gz")
    phantom.bones.save(out / "bones.nii.gz")
    phantom.fraction.save(out / "fraction_ct.nii.gz")
    phantom.dose.save(out / "dose.nii.gz")
    phantom.contours.save(out / "contours.json")
    done = program("phantom", "--dicom", "--spacing", "9x9x9", "--out", out / "export")
    assert done.returncode == 0, done.stderr
    for series in ("planning", "fraction"):
        (out / "export" / "dicom" / series).rename(out / series)
    return out


@pytest.fixture
def files(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with them."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
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
        # Its phantom takes four times as long.
        exec("".join(cell["source"]).replace("(4, 4, 4)", "(7, 7, 7)"), names)


def test_docstrings() -> None:
    modules = [aventail, *(importlib.import_module(f"aventail.{m.name}") for m in pkgutil.iter_modules(aventail.__path__))]
    results = [doctest.testmod(module) for module in modules if hasattr(module, "__file__")]
    assert sum(r.failed for r in results) == 0 and sum(r.attempted for r in results) > 15
