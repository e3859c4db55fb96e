"""Every public call: each kind of thing that it takes, and ten things that it must refuse by name."""

from __future__ import annotations

import json
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


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("scene"))


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


def test_register_refuses(scene: Scene) -> None:
    p = scene.phantom
    given = {"planning": p.planning, "bones": p.bones, "fraction": p.fraction, "settings": "fast"}
    wrong: dict[str, list[Any]] = {
        "planning": not_images(scene),
        "bones": not_labels(scene),
        "fraction": [*not_images(scene), [], None],
        "labels": NOT_NAMES,
        "settings": NOT_SETTINGS,
        "landmarks": NOT_POINTS,
        "bone_landmarks": NOT_ON_BONES,
        "start": NOT_RIGID,
        "volume_change": [5, "a", ["a"], {1: 1.0}, {"a": "b"}, {"a": None}, {"a": -1.0}, {"a": np.nan}, {"": 1.0}, b""],
        "threads": [*NOT_WHOLE, 10**6],
        "progress": NOT_PROGRESS,
    }
    wrong |= {name: NOT_PATHS for name in ("skeleton", "organs", "bones_folder", "structures", "dose")}
    wrong |= {name: NOT_FLAGS for name in ("dicom", "anonymous", "same_frame")}
    check(aventail.register, given, wrong)
    several = {**given, "fraction": [p.fraction, p.fraction]}
    check(aventail.register, several, {"landmarks": [*NOT_POINTS, [None], [p.landmarks] * 3]})


def test_pose_refuses(scene: Scene) -> None:
    p = scene.phantom
    given = {"planning": p.planning, "bones": p.bones, "settings": "fast"}
    poses = [
        5,
        ["skull"],
        "none.toml",
        {"skull": 5},
        {"skull": {"axial_deg": "x"}},
        {"skull": {"axial_deg": np.nan}},
        {"skull": {"axial": 5.0}},
        {"skul": {"axial_deg": 5.0}},
        {5: {"axial_deg": 5.0}},
        {"skull": {"axial_deg": object()}},
        {"skull": None},
    ]
    margins = [*NOT_NUMBERS, -1.0, 501.0]
    check(aventail.pose, given, {"pose": poses})
    check(aventail.pose, {**given, "pose": {"skull": {"axial_deg": 3.0}}}, {"margin_mm": margins, "labels": NOT_NAMES})
    check(aventail.pose, given, {"transforms": [*({"skull": m} for m in NOT_RIGID), 5, "a", {5: np.eye(4)}]})
    check(aventail.pose, given, {"bone_landmarks": NOT_ON_BONES})
    couches = [5, "a", ["a"], {"shift_mm": "x"}, {"shift": 1}, {1: 2}, {"shift_mm": [np.nan] * 3}, b"", 1.5, object()]
    check(aventail.pose, given, {"couch": couches})
    for ways in ({"pose": {}, "transforms": {}}, {"pose": "a.toml", "couch": {}}, {"transforms": {}, "bone_landmarks": []}, {}):
        with pytest.raises(aventail.UsageError, match="motion"):
            aventail.pose(**given, **ways)


def test_measures_refuse(scene: Scene) -> None:
    p = scene.phantom
    check(aventail.skeleton, {"bones": p.bones}, {"bones": not_labels(scene), "labels": NOT_NAMES})
    given = {"fields": p.truth, "bones": p.bones}
    wrong: dict[str, list[Any]] = {
        "fields": not_fields(scene),
        "bones": not_labels(scene),
        "landmarks": NOT_POINTS,
        "labels": NOT_NAMES,
        "settings": NOT_SETTINGS,
        "threads": NOT_WHOLE,
        "progress": NOT_PROGRESS,
    }
    wrong |= {name: not_images(scene) for name in ("planning", "fraction", "mask")}
    check(aventail.evaluate, given, wrong)
    check(aventail.evaluate, {**given, "structures": p.bones}, {"structure_names": NOT_NAMES})
    both = {"structures": p.bones, "structures_fraction": p.bones}
    check(aventail.evaluate, {"fields": p.truth, **both}, {name: not_labels(scene) for name in both})
    for name in ("planning_to_fraction", "fraction_to_planning"):
        check(aventail.evaluate, {"bones": p.bones}, {name: not_fields(scene)})
        with pytest.raises(aventail.UsageError, match=name):
            aventail.evaluate(p.truth, **{name: p.truth})
    for idle in ({"labels": p.bones.names}, {"structure_names": p.bones.names}):
        with pytest.raises(aventail.UsageError, match=next(iter(idle))):
            aventail.evaluate(p.truth, planning=p.planning, **idle)


def test_doses_refuse(scene: Scene) -> None:
    p = scene.phantom
    doses = [*not_images(scene), p.planning]
    given = {"dose": p.dose, "fields": p.truth, "to": "fraction", "grid": p.fraction}
    words = [5, None, "", "sideways", b"planning", ["planning"], {}, 1.0, object(), True]
    parts = {"method": "energy-mass", "ct": p.planning}
    wrong = {"dose": doses, "fields": not_fields(scene), "to": words, "method": words, "threads": NOT_WHOLE}
    # A grid may be that of vectors.
    grids = [thing for thing in not_images(scene) if not isinstance(thing, Image)]
    check(aventail.dose.map, given, {**wrong, "grid": grids, "ct": not_images(scene)})
    check(aventail.dose.map, {**given, **parts}, {"parts": [*NOT_WHOLE, 0, 9]})
    sums = [5, "dose.nii.gz", scene.files["dose"], None, [], {}, [5], [p.planning], [p.dose, None], b"x", [p.dose.array]]
    check(aventail.dose.accumulate, {"doses": [p.dose]}, {"doses": sums, "weights": [*without_none(NOT_GRAY), [2.0], [], [1, 1]]})
    check(aventail.dose.accumulate, {"doses": [p.dose]}, {"fractions": [*without_none(NOT_GRAY), [], [1, 1]]})
    structures = [*not_labels(scene)[:8], vectors(), {"a": 5}, {"a": [[[0, 0]]]}, {5: []}, {"a": [[[0, 0, np.nan]] * 3]}, None]
    widths = [*NOT_NUMBERS, 0.0, -1.0]
    given = {"dose": p.dose, "structures": p.contours}
    check(aventail.dose.dvh, given, {"dose": doses, "structures": structures, "at": NOT_GRAY, "bin": widths})
    check(aventail.dose.dvh, {"dose": p.dose, "structures": p.bones}, {"labels": NOT_NAMES})
    given = {"dose": p.dose, "reference": p.dose}
    wrong = {"dose": doses, "reference": doses, "limit": [*NOT_NUMBERS, 0.0, 101.0]}
    check(aventail.dose.compare, given, {**wrong, "tolerance": [*without_none(NOT_NUMBERS), 0.0, -1.0]})


def test_carrying_refuses(scene: Scene) -> None:
    p, registration = scene.phantom, scene.registration
    warp = registration.warp
    words = [5, None, "", "sideways", b"planning", ["planning"], {}, 1.0, object(), True]
    wrong: dict[str, list[Any]] = {
        "to": words,
        "kind": without_none(words) + ["field"],
        "interpolation": words,
        "outside": [thing for thing in NOT_NUMBERS if not isinstance(thing, float)] + [(), "air", 1j],
        "grid": [thing for thing in not_images(scene) if not isinstance(thing, Image)],
    }
    check(warp, {"thing": p.planning, "to": "fraction", "kind": "image"}, {**wrong, "thing": not_images(scene)})
    check(warp, {"thing": p.planning, "to": "fraction"}, {"labels": [*NOT_NAMES, p.bones.names]})
    check(warp, {"thing": p.bones, "to": "fraction"}, {"labels": NOT_NAMES})
    check(warp, {"to": "fraction", "kind": "labels"}, {"thing": not_labels(scene)})
    check(warp, {"to": "fraction", "kind": "dose"}, {"thing": [*not_images(scene), p.planning]})
    contours = [5, None, "none.json", "", b"", ["a"], {"a": 5}, {"a": [[0, 0, 0]]}, {5: []}, p.planning, {}, np.zeros((3, 3))]
    check(warp, {"to": "fraction", "kind": "contours"}, {"thing": contours})
    points = [5, None, "a", {"a": 1}, [], [0, 0], [[0, 0]], [[0, 0, "x"]], [[[0]], 1], [[0, 0, np.nan]], np.zeros((2, 2, 3)), p.planning]
    check(warp, {"to": "fraction", "kind": "points"}, {"thing": points})
    for thing, idle in ((p.bones, "interpolation"), (p.dose, "interpolation"), (p.contours, "interpolation")):
        with pytest.raises(aventail.UsageError, match=idle):
            warp(thing, to="fraction", interpolation="cubic")
    with pytest.raises(aventail.UsageError, match="outside"):
        warp(p.dose, to="fraction", outside=0.0)
    assert np.isnan(warp(p.planning, to="fraction", outside=np.nan).array).any()


def refused_as(call: Callable[..., Any], given: dict[str, Any], name: str, things: list[Any]) -> list[str | None]:
    """As :func:`refused`, where the message has another name for the thing."""
    assert len(things) >= 10
    lines = [refused(call, given, name, thing) for thing in things]
    return [line for line in lines if line and "does not name it" not in line]


def assert_all(lines: list[str | None]) -> None:
    found = [line for line in lines if line]
    if found:
        pytest.fail("\n".join(found), pytrace=False)


def test_folders_refuse(scene: Scene, tmp_path: Path) -> None:
    runs = [5, None, b"x", "", [], [5], {"a": 1}, [""], tmp_path / "none", [tmp_path / "none"], object()]
    check(aventail.summary, {"runs": tmp_path}, {"runs": runs, "out": NOT_PATHS, "anonymous": NOT_FLAGS})
    check(aventail.library_modes, {"runs": runs, "out": tmp_path}, {"runs": runs})
    check(aventail.library_modes, {"runs": [tmp_path] * 2}, {"out": NOT_PATHS})
    given = {"planning": scene.files["planning"], "bones": scene.files["bones"], "out": tmp_path / "o", "sample": 1}
    optional = ("plan", "labels", "organs", "skeleton", "structures", "dose")
    wrong: dict[str, list[Any]] = {name: NOT_PATHS for name in ("planning", "bones", "out", *optional)}
    wrong |= {name: NOT_FLAGS for name in ("reject", "fields")}
    noise = [*without_none(NOT_NUMBERS), 0.0, -5.0]
    wrong |= {"margin_mm": [*NOT_NUMBERS, -1.0], "seed": NOT_WHOLE, "sample": without_none(NOT_WHOLE) + [0], "noise_hu": noise}
    wrong |= {"cbct": [5, 0, 1, None, b"", [], {}, 1.0, object(), "none.toml"], "threads": NOT_WHOLE, "settings": NOT_SETTINGS}
    ranges = [5, "a", {"a": 1}, {"a": (1,)}, {"a": (1, "b")}, {1: (1, 1)}, {"a": (np.nan, 1)}, {"a": (2, 1)}, {"a": None}, ["a"]]
    check(aventail.library, given, {**wrong, "volume_change": ranges, "progress": NOT_PROGRESS})
    with pytest.raises(aventail.UsageError, match="noise_hu"):
        aventail.library(**given, cbct=True, noise_hu=20.0)
    check(scene.registration.save, {"folder": tmp_path / "s"}, {"folder": NOT_PATHS, "view": NOT_FLAGS, "progress": NOT_PROGRESS})


def test_the_phantom_refuses() -> None:
    voxels = [5, "9", (9, 9), (0, 0, 0), (-9, 9, 9), (np.nan,) * 3, (0.01,) * 3, (1e4,) * 3, {"x": 9}, ("a", "b", "c")]
    check(aventail.phantom, {}, {"spacing": voxels, "second": NOT_FLAGS, "cbct": NOT_FLAGS})
    given = {"spacing": (20, 20, 20)}
    # These are named by their place in the options.
    assert_all(refused_as(aventail.phantom, given, "seed", [-1, 2.5, "2", True, [1], 2**70, float("nan"), None, {}, object()]))


def test_images_refuse_a_geometry_that_is_none(tmp_path: Path) -> None:
    given = {"array": np.zeros((2, 3, 4), np.float32)}
    arrays = [5, "a", None, [[1], [1, 2]], np.zeros(3), np.zeros((2, 0, 4)), np.zeros((1, 2, 3), complex), np.zeros((2,) * 5)]
    arrays += [np.full((1, 1, 1), "a"), np.full((1, 1, 1), None), np.ma.masked_less(np.zeros((2, 3, 4)), 1), {}]
    threes = [5, "abc", None, (1, 2), (1, 2, 3, 4), (np.nan, 1, 1), (np.inf, 1, 1), ("1", "1", "1"), {}, (None,) * 3, [[1, 1, 1]]]
    tilted = np.eye(3) + 0.01 * np.eye(3)[[1, 2, 0]]
    axes = [5, "a", None, np.zeros((3, 3)), np.ones((3, 3)), np.diag([1, 1, np.nan]), 2 * np.eye(3), np.eye(4), [[1], [1, 2]], tilted]
    wrong = {"array": arrays, "spacing": [*threes, (0, 1, 1), (-1, 1, 1)], "origin": threes, "direction": axes, "names": NOT_NAMES[:12]}
    wrong["kind"] = [5, "ct", "", b"dose", ["dose"], {}, 1.0, object(), True, "points"]
    check(Image, given, wrong)
    for value in (0.0, -2.0):
        with pytest.raises(aventail.InputError, match=rf"spacing: it is \({value}, 1.0, 1.0\)"):
            Image(given["array"], (value, 1, 1))
    image = Image(**given)
    check(image.save, {}, {"path": [*NOT_PATHS, "a.xyz", tmp_path]})
    check(image.save_dicom, {"path": "o", "like": "l"}, {"path": NOT_PATHS, "like": NOT_PATHS, "of": NOT_PATHS[:5] * 2})
    check(image.point, {}, {"index": threes})
    check(Image.of, {"thing": image}, {"kind": [thing for thing in wrong["kind"]]})
    # A mirrored image is one, and nine numbers are SimpleITK's direction.
    assert Image(**given, direction=np.diag([-1, 1, 1])).direction[0, 0] == -1
    assert np.array_equal(Image(**given, direction=tuple(np.eye(3).ravel())).direction, np.eye(3))


def test_fields_and_contours_refuse(scene: Scene, tmp_path: Path) -> None:
    p = scene.phantom
    given = {"image": vectors(), "start": "planning", "end": "fraction"}
    words = [5, None, "", b"planning", ["planning"], {}, 1.0, object(), True, " "]
    images = [5, None, "f.nii.gz", p.planning, np.zeros((2, 3, 4, 3)), [], {}, b"", 1.5, not_fields(scene)[12]]
    check(aventail.Field, given, {"image": images, "start": words, "end": words})
    assert_all(refused_as(aventail.Field.of, {"start": "a", "end": "b"}, "thing", not_fields(scene)))
    layouts = [5, "", "mha", b"nrrd", ["nrrd"], {}, 1.0, object(), True, "text"]
    field = aventail.Field(**given)
    check(field.save, {"path": tmp_path / "f.nrrd"}, {"path": [*NOT_PATHS, "a.xyz"], "format": layouts})
    check(field.save_dicom, {"path": "a.dcm", "start": "a", "end": "b"}, {name: NOT_PATHS for name in ("path", "start", "end")})
    square = [[0, 0, 9], [8, 0, 9], [8, 8, 9], [0, 8, 9]]
    polygons = [5, None, "a", [], {"a": 5}, {"a": square}, {"a": [[[0, 0]]]}, {5: [square]}, {"a": [[[0, 0, np.inf]]]}, {"a": ["b"]}]
    axes = [5, None, "a", (1, 0, 0), np.eye(3), (0,) * 6, (1, 0, 0, 1, 0, 0), (np.nan,) * 6, ("a",) * 6, {}]
    colours = [5, None, "a", [], {"a": 5}, {"a": (1, 2)}, {"a": (1, 2, 300)}, {"a": (1, 2, 0.5)}, {5: (1, 2, 3)}, {"a": "red"}]
    given = {"structures": {"a": [square]}}
    check(aventail.Contours, given, {"structures": polygons, "orientation": axes, "colours": colours})
    assert list(aventail.Contours({"": [square]}).structures) == [""]
    contours = aventail.Contours(**given)
    check(contours.save, {"path": tmp_path / "c.json"}, {"path": NOT_PATHS, "frame": words})
    check(contours.save_dicom, {"path": "a.dcm", "like": "b"}, {name: NOT_PATHS for name in ("path", "like", "of")})
    for kind in (aventail.Registration, aventail.Phantom):
        with pytest.raises(TypeError, match=kind.__name__):
            kind(*[5] * (kind.__init__.__code__.co_argcount - 1))


def kinds_of(image: Image, file: Path) -> list[Any]:
    """The same image as everything that an image can be."""
    own = Image(image.array, image.spacing, image.origin, image.direction, image.names, image.kind)
    return [str(file), file, image, own, sitk.ReadImage(str(file)), nibabel.load(file)]


def test_each_kind_of_image_is_taken(scene: Scene) -> None:
    p, registration = scene.phantom, scene.registration

    def same(call: Callable[[Any], Any], name: str) -> None:
        results = [call(thing) for thing in kinds_of(scene.images[name], scene.files[name])]
        assert all(np.allclose(result, results[0], atol=1e-2) for result in results), name

    dvh = aventail.dose.dvh
    same(lambda thing: len(aventail.skeleton(thing, p.bones.names)["bones"]), "bones")
    same(lambda thing: aventail.evaluate(p.truth, planning=thing)["shift"]["mm"], "planning")
    same(lambda thing: aventail.evaluate(p.truth, bones=thing, labels=p.bones.names)["rigidity"][0]["voxels"], "bones")
    same(lambda thing: aventail.dose.map(thing, p.truth, to="fraction", grid=p.fraction).dose, "dose")
    same(lambda thing: aventail.dose.map(p.dose, p.truth, to="fraction", grid=thing).dose, "fraction")
    same(lambda thing: aventail.dose.accumulate([thing, p.dose], [0.5, 0.5]), "dose")
    same(lambda thing: aventail.dose.compare(thing, p.dose).difference, "dose")
    same(lambda thing: dvh(thing, p.contours)[0]["mean"], "dose")
    same(lambda thing: dvh(p.dose, thing, p.bones.names)[0]["mean"], "bones")
    same(lambda thing: registration.warp(thing, to="fraction", kind="image"), "planning")
    same(lambda thing: registration.warp(thing, to="fraction", kind="labels", labels=p.bones.names), "bones")
    same(lambda thing: registration.warp(thing, to="fraction", kind="dose"), "dose")
    same(lambda thing: registration.warp(p.planning, to="fraction", grid=thing), "fraction")
    mixed = zip(kinds_of(p.planning, scene.files["planning"]), reversed(kinds_of(p.bones, scene.files["bones"])))
    pose = {"skull": {"axial_deg": 3.0}}
    posed = [aventail.pose(ct, bones, pose, labels=p.bones.names, settings="fast") for ct, bones in list(mixed)[1:4]]
    assert all(np.array_equal(posed[0].planning_to_fraction, other.planning_to_fraction) for other in posed)


def test_each_kind_of_field_and_of_contours_is_taken(scene: Scene) -> None:
    p, file = scene.phantom, scene.folder / "field.nii.gz"
    transform = p.truth.to_sitk()
    fields = [p.truth, p.truth.image, str(file), file, sitk.ReadImage(str(file)), transform]
    dose = [aventail.dose.map(p.dose, field, to="fraction", grid=p.dose).dose.array.max() for field in fields[::2]]
    assert np.allclose(dose, dose[0], rtol=1e-3)
    for field in fields:
        own = aventail.Field.of(field, "planning", "fraction")
        assert own.array.dtype == np.float32 and np.allclose(own, p.truth, atol=1e-3)
    small = {"parotid_left": p.contours.structures["parotid_left"]}
    file = scene.folder / "small.json"
    aventail.Contours(small).save(file)
    drawn = [aventail.Contours(small), str(file), file, small, {"parotid_left": [c.tolist() for c in small["parotid_left"]]}]
    means = [aventail.dose.dvh(p.dose, contours)[0]["mean"] for contours in drawn]
    assert np.allclose(means, means[0], rtol=1e-3)
    moved = [scene.registration.warp(contours, to="fraction", kind="contours") for contours in drawn]
    assert all(list(other.structures) == ["parotid_left"] for other in moved)


def test_each_kind_of_names_and_landmarks_is_taken(scene: Scene, tmp_path: Path) -> None:
    p = scene.phantom
    bare = Image(p.bones.array, p.bones.spacing, p.bones.origin)
    own = p.bones.names or {}
    file = tmp_path / "names.json"
    file.write_text(json.dumps({"labels": {str(label): name for label, name in own.items()}}))
    numbers = {np.int64(label): name for label, name in own.items()}
    for names in (own, {name: label for label, name in own.items()}, numbers, {str(k): v for k, v in own.items()}, str(file), file):
        assert len(aventail.skeleton(bare, names)["bones"]) == len(own)
    points = tmp_path / "points.csv"
    lines = [",".join(map(str, (f'"{name}"', *a, *b))) for name, (a, b) in p.landmarks.items()]
    points.write_text("\n".join(["name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z", *lines]))
    arrays = {name: (np.array(a), list(b)) for name, (a, b) in p.landmarks.items()}
    means = []
    for landmarks in (p.landmarks, arrays, str(points), points):
        after = aventail.evaluate(p.truth, landmarks=landmarks)["landmarks"]
        assert after is not None
        means.append(after["after"]["mean"])
    assert np.allclose(means, means[0], atol=1e-6)
