"""Options do what they say: each changes a result by a known amount."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aventail
from aventail import _case

GRID: dict[str, Any] = {"spacing": (2.0, 2.0, 2.0), "origin": (5.0, -3.0, 40.0)}
SIZE = (12, 10, 14)


def volume(values: Any, kind: Any = None) -> aventail.Image:
    return aventail.Image(np.ascontiguousarray(np.broadcast_to(values, SIZE), np.float32), **GRID, kind=kind)


def step() -> aventail.Image:
    """40 Gy in the lower half, 0 above."""
    return volume(np.where(np.arange(12) < 6, 40.0, 0.0)[:, None, None], "dose")


def still() -> aventail.Field:
    return aventail.Field(aventail.Image(np.zeros((*SIZE, 3), np.float32), **GRID), "planning", "fraction")


@pytest.fixture(scope="module")
def coarse() -> aventail.Phantom:
    return aventail.phantom(spacing=(9, 9, 9))


def test_a_dose_is_carried_in_these_parts_onto_this_grid() -> None:
    part = aventail.Image(np.zeros((3, 4, 5), np.float32), (2.0, 2.0, 2.0), (9.0, -1.0, 44.0))
    for parts in (1, 3):
        mapped = aventail.dose.map(
            step(), still(), to="fraction", method="energy-mass", ct=volume(0.0), parts=parts, grid=part
        )
        method: Any = mapped.report["method"]
        assert method["energy-mass"]["parts"] == parts
        assert mapped.dose.size == part.size and np.array_equal(mapped.dose.affine, part.affine)
        assert np.allclose(mapped.dose.array, 40.0)


def test_doses_are_compared_by_this_tolerance_up_to_this_distance() -> None:
    # 2.5 Gy per mm along z.
    slope = volume(5.0 * np.arange(12)[:, None, None], "dose")

    def distance(tolerance: float, limit: float) -> float:
        found = aventail.dose.compare(slope, slope, tolerance=tolerance, limit=limit).distance
        return float(found.array[6, 5, 7])

    assert distance(5.0, 9.0) == pytest.approx(2.0) and distance(15.0, 9.0) == pytest.approx(6.0)
    assert distance(15.0, 3.0) == 3.0


def test_a_histogram_has_bins_of_this_width_at_these_doses() -> None:
    labels = aventail.Image(np.ones(SIZE, np.uint16), **GRID, names={1: "all"})
    for width in (0.5, 4.0):
        [curve] = aventail.dose.dvh(step(), labels, at=[20.0, 30.0], bin=width)
        assert curve["bin"] == width and len(curve["cumulative"]) == pytest.approx(40.0 / width, abs=2)
        assert [v["percent"] for v in curve["v"]] == pytest.approx([50.0, 50.0])


def test_a_field_is_measured_within_the_mask_on_both_images() -> None:
    random = np.random.default_rng(3)
    values = random.normal(0, 100, SIZE).astype(np.float32)
    one, other = volume(values), volume(values[::-1])
    mask = volume((np.arange(12) < 6)[:, None, None])

    def found(**more: Any) -> Any:
        return aventail.evaluate(still(), planning=one, **more)

    def voxels(assessment: Any) -> int:
        return int(assessment["regularity"][0][1]["displacement_mm"]["n"])

    assert [voxels(found(mask=own)) for own in (mask, volume(1.0))] == [840, 1680]
    same, apart = (found(mask=volume(1.0), fraction=image)["similarity"]["after"] for image in (one, other))
    assert same["ncc"] > 0.99 > 0.5 > apart["ncc"]


def test_contours_keep_their_planes_and_colours(tmp_path: Path) -> None:
    # Sagittal: the axes in the plane are y and z.
    axes = (0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    square = [[12.0, 0.0, 50.0], [12.0, 10.0, 50.0], [12.0, 10.0, 60.0], [12.0, 0.0, 60.0]]
    own = aventail.Contours({"cord": [np.array(square)]}, axes, {"cord": (0, 255, 9)})
    own.save(tmp_path / "c.json", "fraction")
    back = aventail.Contours.of(tmp_path / "c.json")
    assert back.orientation == axes and back.colours == {"cord": (0, 255, 9)}
    assert np.array_equal(back.structures["cord"][0], square)
    assert '"fraction"' in (tmp_path / "c.json").read_text()


def test_a_pose_follows_couch_and_landmarks(coarse: aventail.Phantom) -> None:
    given = (coarse.planning, coarse.bones)
    shifted = aventail.pose(*given, couch={"shift_mm": [5.0, -3.0, 2.0]}, settings="fast")
    assert np.allclose([rows[:3, 3] for rows in shifted.bones.values()], [5.0, -3.0, 2.0])
    corners = [(0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 30.0)]
    marks = [("skull", str(n), corner, (corner[0], corner[1], corner[2] + 4.0)) for n, corner in enumerate(corners)]
    placed = aventail.pose(*given, bone_landmarks=marks, settings="fast")
    assert np.allclose(placed.bones["skull"][:3, 3], [0.0, 0.0, 4.0], atol=1e-6)


def test_a_fit_begins_where_it_is_told() -> None:
    coarse = aventail.phantom(spacing=(14, 14, 14))
    start = np.eye(4)
    start[2, 3] = 150.0
    found = aventail.register(coarse.planning, coarse.bones, coarse.fraction, settings="fast", start=start)
    assert "start-left" in [warning.code for warning in found.warnings]


def test_a_phantom_is_shown_as_it_is_asked_for(coarse: aventail.Phantom) -> None:
    circle = aventail.phantom(spacing=(9, 9, 9), cbct=True)
    assert np.array_equal(circle.planning, coarse.planning) and not np.array_equal(circle.fraction, coarse.fraction)


def test_a_library_is_made_as_it_is_asked_for(tmp_path: Path) -> None:
    coarse = aventail.phantom(spacing=(13, 13, 13))
    coarse.planning.save(tmp_path / "ct.nii.gz")
    coarse.bones.save(tmp_path / "bones.nii.gz")
    (tmp_path / "plan.toml").write_text("scale = 3.0\n[limits]\noverlap_mm = 0.0\n")
    more: dict[str, Any] = {"sample": 1, "plan": tmp_path / "plan.toml"}
    given = (tmp_path / "ct.nii.gz", tmp_path / "bones.nii.gz")
    made = aventail.library(*given, tmp_path / "out", fields=False, margin_mm=13.0, **more)
    assert (len(made["training"]), len(made["implausible"])) == (0, 1)
    assert not list(tmp_path.rglob("*planning_to_fraction*"))
    grown = aventail.Image.of(tmp_path / "out" / "posture_001" / "ct.nii.gz").size
    assert grown == tuple(n + 2 for n in coarse.planning.size)
    drawn = aventail.library(*given, tmp_path / "rejected", reject=True, fields=False, **more)
    assert (len(drawn["training"]), drawn["implausible"]) == (1, []) and drawn["rejected"]


def test_a_skeleton_that_is_given_is_the_one_that_moves(coarse: aventail.Phantom, tmp_path: Path) -> None:
    bones = aventail.skeleton(coarse.bones)["bones"]
    turn: Any = {"skull": {"axial_deg": 10.0}}
    own = aventail.pose(coarse.planning, coarse.bones, turn, settings="fast")
    centre = [bone["joint"]["centre"] for bone in bones if bone["name"] == "skull"][0]
    moved = [centre[0] + 30.0, *centre[1:]]
    (tmp_path / "skeleton.toml").write_text(f"[bones.skull]\ncentre_mm = {json.dumps(moved)}\n")
    other = aventail.pose(coarse.planning, coarse.bones, turn, skeleton=tmp_path / "skeleton.toml", settings="fast")
    shift = [found.bones["skull"][:3, 3] for found in (own, other)]
    # The centre of a turn by 10 degrees lies 30 mm farther to the left.
    assert np.linalg.norm(shift[0] - shift[1]) == pytest.approx(60.0 * np.sin(np.radians(5.0)), abs=0.5)


def test_labels_go_with_their_fractions() -> None:
    first, third = (aventail.Image(np.full(SIZE, n, np.uint16), **GRID, names={n: "skull"}) for n in (1, 3))
    given: Any = _case.fraction_bones([first, None, third], None, 3, True)
    assert given[1] is None and [names for _, names in (given[0], given[2])] == [{1: "skull"}, {3: "skull"}]
