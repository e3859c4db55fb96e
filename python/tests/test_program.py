"""The console script is the program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import aventail


def program(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A run of the program inside the module."""
    command = [sys.executable, "-m", "aventail", *(str(a) for a in arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd)


def test_version_help_and_refusals() -> None:
    assert program("--version").stdout == f"aventail {aventail.__version__}\n"
    shown = program("register", "--help")
    assert shown.returncode == 0 and "Usage: aventail register" in shown.stdout
    wrong = program("register", "--nonsense")
    assert wrong.returncode == 2 and "--nonsense" in wrong.stderr and not wrong.stdout
    missing = program("inspect", "none.nii.gz")
    assert missing.returncode == 3 and missing.stderr.startswith("aventail: cannot read none.nii.gz")


def test_the_console_script_is_installed() -> None:
    script = Path(sys.executable).parent / "aventail"
    if not script.exists():
        pytest.skip("the package is not installed here, only on the path")
    done = subprocess.run([script, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"aventail {aventail.__version__}\n")


def test_it_is_the_program_that_cargo_builds(tmp_path: Path) -> None:
    binary = os.environ.get("AVENTAIL_PROGRAM")
    if not binary:
        pytest.skip("AVENTAIL_PROGRAM names no program to compare with")
    for arguments in (["--help"], ["warp", "--help"], ["register"], ["inspect", "none.nii.gz"], ["completions", "bash"]):
        own = program(*arguments)
        other = subprocess.run([binary, *arguments], capture_output=True, text=True)
        assert (own.returncode, own.stdout, own.stderr) == (other.returncode, other.stdout, other.stderr), arguments


def test_the_demo_and_its_command_line(tmp_path: Path) -> None:
    done = program("demo", "--speed", "fast", "--out", tmp_path / "demo", "--json")
    assert done.returncode == 0, done.stderr
    assert '"command": "aventail demo --speed fast --out' in done.stdout
    assert "fit skeleton" in done.stderr
    assert (tmp_path / "demo" / "report.html").stat().st_size > 100_000


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_ctrl_c_ends_the_program(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "aventail", "demo", "--out", str(tmp_path / "demo")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as run:
        assert run.stderr is not None
        # It has begun.
        assert run.stderr.readline()
        run.send_signal(signal.SIGINT)
        assert run.wait() == -signal.SIGINT
