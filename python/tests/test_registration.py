"""A registration of the phantom: its fields, what it carries, and what it is given as."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import aventail

sitk = pytest.importorskip("SimpleITK")


def test_simpleitk_resamples_as_we_do(phantom: aventail.Phantom, registration: aventail.Registration) -> None:
    resampled = sitk.GetArrayFromImage(
        sitk.Resample(
            phantom.planning.to_sitk(),
            phantom.fraction.to_sitk(),
            registration.fraction_to_planning.to_sitk(),
            sitk.sitkLinear,
            -1000.0,
        )
    )
    own = registration.planning_on_fraction
    assert own.size == phantom.fraction.size and np.allclose(own.affine, phantom.fraction.affine)
    inside = registration.inside_planning.array
    difference = (resampled - own.array)[inside]
    assert inside.mean() > 0.5 and np.sqrt(np.mean(difference**2)) < 0.3


def test_the_fields_lie_on_their_grids_and_lead_to_each_other(
    phantom: aventail.Phantom, registration: aventail.Registration
) -> None:
    push, pull = registration.planning_to_fraction, registration.fraction_to_planning
    assert push.size == phantom.planning.size and pull.size == phantom.fraction.size
    assert push.array.dtype == np.float32 and push.array.shape == (*reversed(push.size), 3)
    assert push.array is push.array
    points = np.array([planning for planning, _ in phantom.landmarks.values()])
    there = registration.warp(points, to="fraction", kind="points")
    transform = push.to_sitk()
    assert np.allclose(there, [transform.TransformPoint(p) for p in points], atol=1e-3)
    back = registration.warp(there, to="planning", kind="points")
    assert np.abs(back - points).max() < 0.6
    # The report has the same landmarks.
    after = registration.report["landmarks"]
    assert after is not None
    truth = np.array([fraction for _, fraction in phantom.landmarks.values()])
    residuals = np.linalg.norm(there - truth, axis=1)
    assert np.allclose(residuals, [each["after"] for each in after["each"]], atol=1e-3)


def test_points_outside_stay_and_are_told(registration: aventail.Registration) -> None:
    far = np.array([[0.0, 0.0, 5000.0], [0.0, 0.0, 0.0]])
    with pytest.warns(RuntimeWarning, match="1 of 2 points"):
        carried = registration.warp(far, to="fraction")
    assert np.array_equal(carried[0], far[0]) and not np.array_equal(carried[1], far[1])


def test_images_labels_dose_and_contours_are_carried(
    phantom: aventail.Phantom, registration: aventail.Registration, tmp_path: Path
) -> None:
    image = registration.warp(phantom.planning, to="fraction")
    assert np.array_equal(image.array, registration.planning_on_fraction.array)
    labels = registration.warp(phantom.bones, to="fraction")
    assert np.array_equal(labels.array, registration.bones_on_fraction.array)
    assert labels.names == phantom.bones.names == registration.bones_on_fraction.names
    phantom.bones.save(tmp_path / "bones.nii.gz")
    by_file = registration.warp(tmp_path / "bones.nii.gz", to="fraction", kind="labels")
    assert np.array_equal(by_file.array, labels.array) and by_file.names == labels.names
    dose = registration.warp(phantom.dose, to="fraction")
    mapped = aventail.dose.map(phantom.dose, registration, to="fraction")
    assert dose.array.min() >= 0 and np.array_equal(dose.array, mapped.dose.array)
    there = registration.warp(phantom.contours, to="fraction")
    assert list(there.structures) == list(phantom.contours.structures)
    heights = {round(float(p[0, 2]), 3) for polygons in there.structures.values() for p in polygons}
    z = {round(phantom.fraction.point((0, 0, k))[2], 3) for k in range(phantom.fraction.size[2])}
    assert heights <= z
    there.save(tmp_path / "day.json", "fraction")
    again = aventail.Contours.of(tmp_path / "day.json")
    assert np.allclose(again.structures["ctv"][0], there.structures["ctv"][0], atol=1e-3)
    # On another grid, and back.
    coarse = aventail.Image(np.zeros((20, 20, 20), np.float32), (12, 12, 12), (-120, -140, -200))
    assert registration.warp(phantom.planning, to="fraction", grid=coarse).size == (20, 20, 20)
    cut = registration.warp(phantom.contours, to="fraction", grid=coarse)
    assert {round(float(p[0, 2]), 3) for polygons in cut.structures.values() for p in polygons} <= {
        round(coarse.point((0, 0, k))[2], 3) for k in range(20)
    }
    with pytest.raises(aventail.InputError, match="dose"):
        registration.warp(phantom.planning, to="fraction", kind="dose")
    home = registration.warp(phantom.fraction, to="planning")
    assert home.size == phantom.planning.size
    still = sitk.Resample(phantom.fraction.to_sitk(), phantom.planning.to_sitk(), sitk.Transform(), sitk.sitkLinear, -1000)
    bones = (phantom.bones.array > 0) & (home.array > -900)
    off = [np.abs(i - phantom.planning.array)[bones].mean() for i in (home.array, sitk.GetArrayFromImage(still))]
    assert off[0] < 0.5 * off[1]


def test_each_result_is_the_one_that_is_saved(registration: aventail.Registration, tmp_path: Path) -> None:
    registration.save(tmp_path / "out", view=False)
    names = ["jacobian", "uncertainty", "body", "computed", "inside_planning", "bones_on_fraction"]
    seen = []
    for name in names:
        own = getattr(registration, name).array
        saved = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "out" / f"{name}.nii.gz")))
        assert saved.shape == own.shape and np.allclose(saved, own, atol=1e-3), name
        assert not any(np.array_equal(own, other) for other in seen), name
        seen.append(own)


def test_the_options_of_warping_do_what_they_say(
    phantom: aventail.Phantom, registration: aventail.Registration
) -> None:
    own = registration.planning_on_fraction
    other = registration.warp(phantom.planning, to="fraction", outside=-77.5)
    nothing = other.array == -77.5
    assert nothing.any() and not nothing.all() and (own.array[nothing] == -1000.0).all()
    assert np.array_equal(own.array[~nothing], other.array[~nothing])
    # A part of the fraction's grid.
    size = (6, 7, 8)
    part = aventail.Image(np.zeros(size, np.float32), own.spacing, tuple(own.point((4, 3, 2))), own.direction)
    cut = registration.warp(phantom.planning, to="fraction", grid=part)
    assert cut.array.shape == size and np.allclose(cut.array, own.array[2:8, 3:10, 4:12], atol=0.5)
    # Cubic convolution has a square right, which lines between voxels have not.
    z, y, x = np.indices(phantom.planning.array.shape)
    affine = phantom.planning.affine
    place = np.stack([x, y, z], axis=-1) @ affine[:3, :3].T + affine[:3, 3]
    square = aventail.Image(
        (0.01 * (place**2).sum(axis=-1)).astype(np.float32),
        phantom.planning.spacing,
        phantom.planning.origin,
        phantom.planning.direction,
        kind="image",
    )
    z, y, x = np.indices(own.array.shape)
    there = np.stack([x, y, z], axis=-1) @ own.affine[:3, :3].T + own.affine[:3, 3]
    there += registration.fraction_to_planning.array
    index = (there - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T
    within = ((index > 2) & (index < np.array(phantom.planning.size) - 3)).all(axis=-1)
    assert within.sum() > 10_000

    def off(interpolation: Any) -> float:
        warped = registration.warp(square, to="fraction", interpolation=interpolation).array
        return float(np.abs(warped - 0.01 * (there**2).sum(axis=-1))[within].mean())

    assert off("cubic") < 0.1 * off("linear")


def test_every_kind_of_input_gives_the_same_bits(phantom: aventail.Phantom, tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    names = {"planning": phantom.planning, "bones": phantom.bones, "fraction": phantom.fraction}
    for name, image in names.items():
        image.save(tmp_path / f"{name}.nii.gz")
    files = [tmp_path / f"{name}.nii.gz" for name in names]
    settings = {"preset": "fast"}
    by_path = aventail.register(*files, settings=settings)
    expected = by_path.planning_to_fraction.array
    assert [i["role"] for i in by_path.report["inputs"]] == ["planning", "bones", "fraction"]
    read = [sitk.ReadImage(str(file)) for file in files]
    by_sitk = aventail.register(*read, labels=phantom.bones.names, settings=settings, threads=1)
    assert np.array_equal(by_sitk.planning_to_fraction.array, expected)
    by_name = {name: label for label, name in (phantom.bones.names or {}).items()}
    loaded = [nibabel.load(file) for file in files]
    by_nibabel = aventail.register(*loaded, settings="fast", threads=2)
    assert np.array_equal(by_nibabel.planning_to_fraction.array, expected)
    bare = aventail.Image(phantom.bones.array, *(getattr(phantom.bones, a) for a in ("spacing", "origin", "direction")))
    by_array = aventail.register(files[0], bare, files[2], labels=by_name, settings=settings)
    assert np.array_equal(by_array.planning_to_fraction.array, expected)


def test_what_is_saved_is_what_the_program_writes(phantom: aventail.Phantom, tmp_path: Path) -> None:
    from test_program import program

    for name, image in {"p": phantom.planning, "b": phantom.bones, "f": phantom.fraction}.items():
        image.save(tmp_path / f"{name}.nii.gz")
    (tmp_path / "s.toml").write_text('preset = "fast"\n')
    files = [tmp_path / f"{name}.nii.gz" for name in "pbf"]
    aventail.register(*files, settings=tmp_path / "s.toml").save(tmp_path / "own")
    options = [f"--{role}={file}" for role, file in zip(("planning", "bones", "fraction"), files, strict=True)]
    done = program("register", *options, f"--config={tmp_path / 's.toml'}", f"--out={tmp_path / 'other'}", "--quiet")
    assert done.returncode == 0, done.stderr

    def listed(folder: str) -> dict[str, str]:
        report = json.loads((tmp_path / folder / "report.json").read_text())
        # The page tells time and command.
        return {o["name"]: o["sha256"] for o in report["outputs"] if o["name"] != "report.html"}

    assert listed("own") == listed("other") and len(listed("own")) > 10
    # And the run can be repeated from its report.
    again = program("register", f"--config={tmp_path / 'own' / 'report.json'}", f"--out={tmp_path / 'again'}", "--quiet")
    assert again.returncode == 0, again.stderr
    assert listed("again") == listed("own")


def test_maps_bones_and_warnings(phantom: aventail.Phantom, registration: aventail.Registration) -> None:
    assert registration.jacobian.size == phantom.planning.size
    assert 0.8 < np.median(registration.jacobian.array[registration.body.array]) < 1.2
    assert registration.uncertainty is not None and registration.uncertainty.array.max() > 0
    assert registration.regions is None
    assert set(registration.bones) == set(phantom.transforms)
    for name, matrix in registration.bones.items():
        assert matrix.shape == (4, 4) and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-9), name
    point = np.array([0.0, 20.0, -60.0, 1.0])
    off = [np.linalg.norm((registration.bones[n] - phantom.transforms[n]) @ point) for n in ("skull", "vertebrae_C4")]
    assert max(off) < 2.0
    assert all(w.code and w.message for w in registration.warnings)


def keys_match(value: Any, hint: Any, where: str) -> None:
    """Whether dicts have the keys that their TypedDict says, all the way down."""
    if hasattr(hint, "__required_keys__"):
        assert hint.__required_keys__ <= set(value) <= hint.__required_keys__ | hint.__optional_keys__, where
        for key, inner in get_type_hints(hint).items():
            if key in value:
                keys_match(value[key], inner, f"{where}.{key}")
        return
    inner = get_args(hint)
    if isinstance(value, list) and inner:
        for entry in value:
            keys_match(entry, inner[0], where)
    elif isinstance(value, dict) and inner:
        for option in inner:
            if hasattr(option, "__required_keys__"):
                keys_match(value, option, where)


def test_dicts_are_what_their_types_say(phantom: aventail.Phantom, registration: aventail.Registration) -> None:
    keys_match(registration.report, aventail.reports.Report, "report")
    found = aventail.evaluate(
        registration,
        planning=phantom.planning,
        fraction=phantom.fraction,
        bones=phantom.bones,
        structures=phantom.bones,
        structures_fraction=registration.bones_on_fraction,
        landmarks=phantom.landmarks,
    )
    keys_match(found, aventail.reports.Assessment, "assessment")
    assert found["landmarks"] is not None and found["inversion"] is None
    limits = {"verdict": {"landmark_mean_mm": [1e-3, 2e-3]}}
    mild, strict = (aventail.evaluate(registration, landmarks=phantom.landmarks, settings=s) for s in (None, limits))
    passed = [sum(v["verdict"] == "pass" for v in found["verdicts"]) for found in (mild, strict)]
    assert passed[1] < passed[0]
    # What we carry ourselves is what we compare with.
    assert min(c["dice"] for c in found["contours"] if c["reference_ml"] > 5) > 0.9
    keys_match(aventail.skeleton(phantom.bones), aventail.reports.Skeleton, "skeleton")
    mapped = aventail.dose.map(phantom.dose, registration, to="fraction")
    keys_match(mapped.report, aventail.reports.DoseReport, "dose")
    for curve in aventail.dose.dvh(mapped.dose, registration.warp(phantom.contours, to="fraction"), at=[20]):
        keys_match(curve, aventail.reports.Dvh, "dvh")
    figures = aventail.dose.compare(phantom.dose, phantom.dose).figures
    keys_match(figures, aventail.reports.DoseDifference, "difference")


def test_progress_is_told_in_this_thread_and_what_it_raises_ends_the_run(phantom: aventail.Phantom) -> None:
    told: list[tuple[str, float | None]] = []

    def tell(stage: str, share: float | None) -> None:
        assert threading.current_thread() is threading.main_thread()
        told.append((stage, share))
        if stage == "fit skeleton":
            raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        aventail.register(phantom.planning, phantom.bones, phantom.fraction, progress=tell)
    assert ("read", None) in told and ("read", 1.0) in told
    assert told[-1] == ("fit skeleton", None)


def test_ctrl_c_ends_a_run_and_the_next_one_works() -> None:
    phantom = aventail.phantom(spacing=(3.5, 3.5, 4))
    begun = threading.Event()
    ran = threading.Event()

    def later() -> None:
        begun.wait()
        # Python's other threads run: the lock is free.
        ran.set()
        os.kill(os.getpid(), signal.SIGINT)

    watcher = threading.Thread(target=later)
    watcher.start()

    def tell(stage: str, share: float | None) -> None:
        if stage == "build skeleton, find the patient":
            begun.set()

    with pytest.raises(KeyboardInterrupt):
        aventail.register(phantom.planning, phantom.bones, phantom.fraction, progress=tell)
    watcher.join()
    assert ran.is_set()
    coarse = aventail.phantom(spacing=(8, 8, 8))
    aventail.register(coarse.planning, coarse.bones, coarse.fraction, settings="fast")


def test_what_was_stopped_can_be_asked_for_again(registration: aventail.Registration, tmp_path: Path) -> None:
    def stop(stage: str, share: float | None) -> None:
        raise LookupError(stage)

    with pytest.raises(LookupError):
        registration.save(tmp_path / "out", progress=stop)
    registration.save(tmp_path / "out", view=False)
    assert (tmp_path / "out" / "report.json").exists()


def test_several_fractions_are_those_of_single_runs(phantom: aventail.Phantom) -> None:
    second = aventail.phantom(spacing=(5, 5, 6), second=True).fraction
    fractions = [phantom.fraction, second]
    both = aventail.register(
        phantom.planning, phantom.bones, fractions, settings="fast", landmarks=[phantom.landmarks, None]
    )
    alone = aventail.register(phantom.planning, phantom.bones, second, settings="fast")
    assert len(both) == 2 and both[0].report["landmarks"] is not None and both[1].report["landmarks"] is None
    assert np.array_equal(both[1].planning_to_fraction.array, alone.planning_to_fraction.array)
    assert not np.array_equal(both[0].planning_to_fraction.array, alone.planning_to_fraction.array)
    with pytest.raises(aventail.UsageError, match="1 sets of landmarks"):
        aventail.register(phantom.planning, phantom.bones, fractions, landmarks=[None])


def test_an_organ_changes_its_volume_as_told(phantom: aventail.Phantom, tmp_path: Path) -> None:
    # A block around the parotid; bones win where they are.
    middle = np.concatenate(phantom.contours.structures["parotid_left"]).mean(axis=0)
    bones = phantom.bones
    index = np.linalg.solve(np.asarray(bones.direction), middle - bones.origin) / bones.spacing
    x, y, z = np.rint(index).astype(int)
    block = np.zeros(bones.array.shape, np.uint8)
    block[z - 2 : z + 3, y - 2 : y + 3, x - 2 : x + 3] = 1
    file = tmp_path / "parotid_left.nii.gz"
    aventail.Image(block, bones.spacing, bones.origin, bones.direction, kind="labels").save(file)
    registration = aventail.register(
        phantom.planning, phantom.bones, phantom.fraction, settings="fast", organs=file, volume_change={"parotid_left": 0.7}
    )
    report = registration.report
    assert [i["role"] for i in report["inputs"]] == ["organs"]
    change = report["volume_changes"][0]
    assert change["organ"] == "parotid_left" and change["factor"] == 0.7
    assert change["reached"] is not None and 0.6 < change["reached"] < 0.85
    with pytest.raises(aventail.UsageError, match="volume_change"):
        aventail.register(phantom.planning, phantom.bones, phantom.fraction, volume_change={"parotid_left": -1.0})


def test_a_pose_moves_what_it_names(phantom: aventail.Phantom) -> None:
    posed = aventail.pose(phantom.planning, phantom.bones, {"skull": {"axial_deg": 5.0}}, settings="fast", margin_mm=6.0)
    turn = posed.bones["skull"][:3, :3]
    assert np.isclose(np.degrees(np.arccos((np.trace(turn) - 1) / 2)), 5.0, atol=1e-6)
    assert np.allclose(posed.bones["vertebrae_C7"], np.eye(4))
    x, y, z = phantom.planning.size
    assert posed.planning_on_fraction.size == (x + 4, y + 4, z + 2)
    back = aventail.pose(phantom.planning, phantom.bones, transforms=posed.bones, settings="fast", margin_mm=6.0)
    assert np.allclose(back.planning_to_fraction.array, posed.planning_to_fraction.array, atol=1e-3)
    with pytest.raises(aventail.InputError, match="skul"):
        aventail.pose(phantom.planning, phantom.bones, {"skul": {"axial_deg": 5.0}})


def test_antspyx_reads_the_saved_field(
    phantom: aventail.Phantom, registration: aventail.Registration, tmp_path: Path
) -> None:
    ants = pytest.importorskip("ants", reason="antspyx is not installed: its reading of fields is not tested here")
    for name, image in {"p.nii.gz": phantom.planning, "f.nii.gz": phantom.fraction}.items():
        image.save(tmp_path / name)
    registration.fraction_to_planning.save(tmp_path / "field.nii.gz")
    moved = ants.apply_transforms(
        fixed=ants.image_read(str(tmp_path / "f.nii.gz")),
        moving=ants.image_read(str(tmp_path / "p.nii.gz")),
        transformlist=[str(tmp_path / "field.nii.gz")],
        interpolator="linear",
        defaultvalue=-1000,
    )
    own = registration.planning_on_fraction.array.transpose(2, 1, 0)
    inside = registration.inside_planning.array.transpose(2, 1, 0)
    assert np.sqrt(np.mean((moved.numpy() - own)[inside] ** 2)) < 0.3


def test_labels_of_the_fraction_place_its_bones(
    phantom: aventail.Phantom, registration: aventail.Registration
) -> None:
    """The labels that a registration has carried, alone."""
    labels = registration.warp(phantom.bones, to="fraction", kind="labels")
    alone = {"fit": {"bone_landmarks": "replace"}}
    made = aventail.register(phantom.planning, phantom.bones, phantom.fraction, settings=alone, fraction_bones=labels)
    given = [bone for bone in made.report["bones"] if bone["determined_by"] == "given"]
    assert len(given) > 25
    with pytest.raises(aventail.Error, match="fraction_bones"):
        aventail.register(phantom.planning, phantom.bones, phantom.fraction, fraction_labels={1: "skull"})


def test_outlines_of_both_scans_guide(phantom: aventail.Phantom) -> None:
    """A box of tissue that is outlined 4 mm higher in the same scan comes up with it; exchanged it goes down."""
    still = phantom.planning
    low = np.zeros(still.array.shape, np.uint16)
    depth, rows, columns = (size // 2 for size in low.shape)
    low[depth - 4 : depth + 4, rows - 4 : rows + 4, columns - 6 : columns + 6] = 1
    boxes = [aventail.Image(np.roll(low, n, 0), still.spacing, still.origin, still.direction) for n in (0, 1)]

    def raised(planning: aventail.Image, fraction: aventail.Image) -> float:
        made = aventail.register(
            still, phantom.bones, still, settings="fast", guide=planning, fraction_guide=fraction, guide_labels={1: "box"}
        )
        guides = made.report["guides"]
        assert [guide["name"] for guide in guides] == ["box"]
        before, after = guides[0]["before"], guides[0]["after"]
        assert before is not None and after is not None and after["mean_mm"] < before["mean_mm"]
        return float(made.planning_to_fraction.array[planning.array == 1][:, 2].mean())

    assert raised(boxes[0], boxes[1]) > 0.3
    assert raised(boxes[1], boxes[0]) < -0.3
    with pytest.raises(aventail.Error, match="fraction_guide"):
        aventail.register(still, phantom.bones, still, guide=boxes[0])


def test_samples_vary_as_the_map_says_and_keep_bones_rigid(
    phantom: aventail.Phantom, registration: aventail.Registration
) -> None:
    found = registration.planning_to_fraction.array
    fields = [field.array for field in registration.samples(6, seed=3)]
    again = next(iter(registration.samples(2, seed=3)))
    assert np.array_equal(again.array, fields[0]) and again.start == "planning" and again.end == "fraction"
    added = np.stack(fields) - found
    assert registration.uncertainty is not None
    told = registration.uncertainty.array
    soft = (told > 0) & (phantom.bones.array == 0)
    spread = added[:, soft].std(axis=0)
    # Where the map tells more, samples differ more.
    high, low = told[soft] > np.percentile(told[soft], 75), told[soft] < np.percentile(told[soft], 25)
    assert 0.05 < spread.mean() < 20.0 and spread[high].mean() > 1.5 * spread[low].mean()
    # Bones stay rigid: lengths between voxels of the skull do.
    label = next(number for number, name in (phantom.bones.names or {}).items() if name == "skull")
    voxels = np.argwhere(phantom.bones.array == label)[::97]
    places = voxels[:, ::-1] @ (phantom.bones.affine[:3, :3].T) + phantom.bones.affine[:3, 3]
    for field in [found, *fields]:
        moved = places + field[tuple(voxels.T)]
        lengths = np.linalg.norm(moved[1:] - moved[:-1], axis=1)
        assert np.allclose(lengths, np.linalg.norm(places[1:] - places[:-1], axis=1), atol=1e-3)
    # Soft tissue varies by the factor that is given.
    half, whole = (next(iter(registration.samples(2, seed=3, scale=s))).array for s in (0.5, 1.0))
    assert 0.3 < np.abs(half - found)[soft].mean() / np.abs(whole - found)[soft].mean() < 0.8
    with pytest.raises(aventail.Error):
        registration.samples(1)
