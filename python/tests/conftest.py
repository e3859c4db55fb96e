"""What several tests look at: the phantom, coarse, and its registration."""

from __future__ import annotations

from pathlib import Path

import pytest

import aventail

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""


@pytest.fixture(scope="session")
def phantom() -> aventail.Phantom:
    return aventail.phantom(spacing=(5, 5, 6))


@pytest.fixture(scope="session")
def registration(phantom: aventail.Phantom) -> aventail.Registration:
    return aventail.register(phantom.planning, phantom.bones, phantom.fraction, landmarks=phantom.landmarks)
