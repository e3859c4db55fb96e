"""A scene of every kind of input, what must be refused in the place of each, and how."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aventail

sitk = pytest.importorskip("SimpleITK")
nibabel = pytest.importorskip("nibabel")

Image = aventail.Image


class Scene:
    """A coarse phantom with its files, and a registration of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.phantom = aventail.phantom(spacing=(9, 9, 9))
        p = self.phantom
        self.images = {"planning": p.planning, "bones": p.bones, "fraction": p.fraction, "dose": p.dose}
        self.files = {name: folder / f"{name}.nii.gz" for name in self.images}
        for name, image in self.images.items():
            image.save(self.files[name])
        p.truth.save(folder / "field.nii.gz")
        (folder / "text.nii.gz").write_text("no image")
        (folder / "empty").mkdir()
        self.registration: Any = aventail.register(p.planning, p.bones, p.fraction, settings="fast")


def vectors() -> Image:
    return Image(np.zeros((2, 3, 4, 3), np.float32))


def not_images(scene: Scene) -> list[Any]:
    flat = sitk.Image([3, 4], sitk.sitkFloat32)
    sheared = nibabel.Nifti1Image(np.zeros((2, 3, 4), np.float32), np.array([[1, 1, 0, 0], *np.eye(4)[1:]]))
    several = nibabel.Nifti1Image(np.zeros((2, 3, 4, 5), np.float32), np.eye(4))
    return [
        5,
        b"ct.nii.gz",
        "",
        "ct\0.nii.gz",
        scene.folder / "none.nii.gz",
        scene.folder / "text.nii.gz",
        scene.folder / "empty",
        scene.phantom.planning.array,
        scene.phantom.contours,
        vectors(),
        flat,
        sheared,
        several,
        sitk.Image([3, 4, 5], sitk.sitkComplexFloat32),
        sitk.Transform(3, sitk.sitkIdentity),
        {"array": 1},
        Image,
    ]


def not_labels(scene: Scene) -> list[Any]:
    bones = scene.phantom.bones
    odd = [bones.array - 0.5, bones.array.astype(np.int32) - 1, bones.array + 1e5, np.where(bones.array, np.nan, 0)]
    return not_images(scene) + [Image(array, bones.spacing, bones.origin, names=bones.names) for array in odd]


def not_fields(scene: Scene) -> list[Any]:
    return not_images(scene)[:9] + [
        scene.phantom.planning,
        sitk.Image([3, 4, 5], sitk.sitkFloat32),
        Image(np.zeros((2, 3, 4, 2), np.float32)),
        Image(np.full((2, 3, 4, 3), np.nan, np.float32)),
        np.zeros((2, 3, 4, 3)),
    ]


NOT_PATHS = [5, 1.5, b"x", "", "a\0b", ["a"], {"a": 1}, object(), np.zeros(3), True]
NOT_FLAGS = [0, 1, "no", "True", None, [], 1.0, np.zeros(2), object(), b""]
NOT_WHOLE = [-1, 1.0, 2.5, "2", None, True, [1], 2**70, float("nan"), np.float32(1)]
NOT_NUMBERS = ["2", None, True, [1.0], float("nan"), float("inf"), 1j, b"1", {}, np.zeros(2), 10**400]
NOT_NAMES = [
    5,
    ["skull"],
    ("skull", 1),
    {"skull"},
    {1: 2},
    {"a": "b"},
    {1.5: "skull"},
    {-1: "skull"},
    {70000: "skull"},
    {"skull": 1, "mandible": 1},
    {True: "skull"},
    {None: "skull"},
    "none.json",
    np.zeros(3),
]
NOT_POINTS = [
    5,
    ["a"],
    {"a": 1},
    {"a": ((0, 0, 0),)},
    {"a": ((0, 0, 0), (1, 2))},
    {"a": ((0, 0, 0), (1, 2, "x"))},
    {"a": ((0, 0, 0), (1, 2, float("nan")))},
    {"a": "point"},
    {"a": {1: 2}},
    {5: ((0, 0, 0), (1, 1, 1))},
    "none.csv",
    np.zeros((2, 3)),
]
NOT_ON_BONES = [
    5,
    {"skull": 1},
    ["skull"],
    [("skull", "a")],
    [("skull", "a", (0, 0, 0), (0, 0))],
    [("skull", "a", (0, 0, 0), "b")],
    [("skull", 5, (0, 0, 0), (0, 0, 0))],
    [(None, "a", (0, 0, 0), (0, 0, 0))],
    [("skull", "a", (0, 0, 0), (0, 0, np.inf))],
    [("no_bone", "a", (0, 0, 0), (0, 0, 0))],
    "none.csv",
]
NOT_SETTINGS = [
    5,
    ["fast"],
    "slow",
    "none.toml",
    "",
    b"fast",
    {"fit": 5},
    {"no_such": {}},
    {"fit": {"max_iterations": "many"}},
    {"fit": {"max_iterations": float("nan")}},
    {1: 2},
    {("a", "b"): 1},
    {"fit": object()},
    np.zeros(3),
]
NOT_RIGID = [
    5,
    "near",
    np.zeros((4, 4)),
    2 * np.eye(4),
    np.eye(3),
    np.full((4, 4), np.nan),
    np.eye(4)[:3],
    [[1, 0], [0]],
    np.eye(4).astype(complex),
    np.eye(4).astype(str),
    {"a": np.eye(4)},
    [object()] * 16,
]
NOT_PROGRESS = [5, "yes", [], {}, 1.0, 0, b"", (), object(), np.zeros(2)]
NOT_GRAY = [5, "20", b"20", {1: 2}, [-1.0], [float("nan")], ["20"], [None], [[1]], None, [True], object()]


def refused(call: Callable[..., Any], given: dict[str, Any], name: str, wrong: Any) -> str | None:
    """What is wrong with how a call refuses: nothing, or a line to read."""
    shown = f"{call.__qualname__}({name}={type(wrong).__name__} {wrong!r:.60})"
    try:
        call(**{**given, name: wrong})
    except aventail.Error as error:
        text = str(error)
        if isinstance(error, aventail.InternalError) or not error.cause or not error.remedy:
            return f"{shown}: {text}"
        if re.search(r"(?<![\w`])--[a-z]", re.sub(r"`[a-z][^`]*`", "", text)):
            return f"{shown} names an option: {text}"
        told = error.what or text
        if name not in text and name.replace("_", " ") not in text and str(wrong) not in told and error.what is None:
            return f"{shown} does not name it: {text}"
        return None
    except TypeError as error:
        return None if name in str(error) else f"{shown} does not name it: {error}"
    except BaseException as error:  # A panic is no Exception.
        return f"{shown} raised {type(error).__name__}: {error}"
    return f"{shown} was taken"


def check(call: Callable[..., Any], given: dict[str, Any], wrong: dict[str, list[Any]]) -> None:
    assert all(len(things) >= 10 for things in wrong.values())
    found = [refused(call, given, name, thing) for name, things in wrong.items() for thing in things]
    assert_all(found)


def without_none(things: list[Any]) -> list[Any]:
    return [thing for thing in things if thing is not None]


def refused_as(call: Callable[..., Any], given: dict[str, Any], name: str, things: list[Any]) -> list[str | None]:
    """As :func:`refused`, where the message has another name for the thing."""
    assert len(things) >= 10
    lines = [refused(call, given, name, thing) for thing in things]
    return [line for line in lines if line and "does not name it" not in line]


def assert_all(lines: list[str | None]) -> None:
    found = [line for line in lines if line]
    if found:
        pytest.fail("\n".join(found), pytrace=False)
