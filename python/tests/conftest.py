"""What several tests look at: the phantom, coarse, and its registration."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

import aventail

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Ctrl-C is heard, also where a shell started the tests in the background and ignores it for them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def phantom() -> aventail.Phantom:
    return aventail.phantom(spacing=(5, 5, 6))


@pytest.fixture(scope="session")
def small() -> aventail.Phantom:
    """Of large voxels, for runs whose accuracy does not matter."""
    return aventail.phantom(spacing=(9, 9, 9))


@pytest.fixture(scope="session")
def registration(phantom: aventail.Phantom) -> aventail.Registration:
    return aventail.register(phantom.planning, phantom.bones, phantom.fraction, landmarks=phantom.landmarks)
