"""Images, fields, contours and registrations as Python's objects: as arrays, in print, in a pickle, and in other processes."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import aventail

ARRAYS = ("planning_on_fraction", "bones_on_fraction", "jacobian", "body", "computed", "inside_planning")
MAPS = ("uncertainty", "regions")
FIELDS = ("planning_to_fraction", "fraction_to_planning")


@pytest.fixture(scope="module")
def coarse() -> aventail.Phantom:
    return aventail.phantom(spacing=(9, 9, 9))


@pytest.fixture(scope="module")
def found(coarse: aventail.Phantom) -> aventail.Registration:
    return aventail.register(coarse.planning, coarse.bones, coarse.fraction, settings="fast")


def test_numpy_sees_the_voxels(coarse: aventail.Phantom) -> None:
    for thing in (coarse.planning, coarse.bones, coarse.truth):
        array = np.asarray(thing)
        assert np.shares_memory(array, thing.array) and array.shape == thing.array.shape and array.dtype == thing.array.dtype
        assert array.shape[:3] == thing.size[::-1]
        copied = np.array(thing)
        assert np.array_equal(copied, array) and not np.shares_memory(copied, array)
        wide = np.asarray(thing, np.float64)
        assert wide.dtype == np.float64 and np.array_equal(wide, array)
        # As numpy 1 calls it, and numpy 2.
        assert thing.__array__() is thing.array and thing.__array__(np.float64).dtype == np.float64
        assert thing.__array__(None, copy=False) is thing.array
        assert not np.shares_memory(thing.__array__(copy=True), thing.array)
        with pytest.raises(ValueError, match="by a copy only"):
            thing.__array__(np.complex128, copy=False)
    hu = coarse.planning
    assert np.mean(hu) == hu.array.mean() and np.isclose(np.abs(hu).max(), np.abs(hu.array).max())
    # A field's memory is its own, also where the field goes first.
    array = np.asarray(aventail.Field(aventail.Image(np.ones((9, 9, 9, 3), np.float32)), "a", "b"))
    assert [np.ones(9**3 * 3, np.float32).sum() for _ in range(20)] and (array == 1).all()


def test_each_is_told_in_one_short_line(coarse: aventail.Phantom, found: aventail.Registration) -> None:
    many = aventail.Contours({f"structure number {n} of this plan": [np.zeros((4, 3))] * 50 for n in range(300)})
    mapped = aventail.dose.map(coarse.dose, found, to="fraction")
    compared = aventail.dose.compare(coarse.dose, coarse.dose)
    things = [coarse, coarse.planning, coarse.truth, coarse.contours, many, found, mapped, compared, aventail.Contours({})]
    for thing in things:
        assert len(repr(thing)) < 140 and "\n" not in repr(thing) and repr(thing).startswith("<aventail.")
    assert repr(many).endswith("and 297 more; 15000 polygons>")


def test_what_is_pickled_comes_back(coarse: aventail.Phantom, found: aventail.Registration) -> None:
    for again in (pickle.loads(pickle.dumps(found)), pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(found))))):
        for name in (*ARRAYS, *FIELDS):
            own, other = getattr(found, name), getattr(again, name)
            assert np.array_equal(own, other) and own.array.dtype == other.array.dtype, name
            assert own.spacing == other.spacing and own.origin == other.origin, name
            assert np.array_equal(own.direction, other.direction), name
        assert [getattr(again, name) is None for name in MAPS] == [getattr(found, name) is None for name in MAPS]
        assert again.bones_on_fraction.names == found.bones_on_fraction.names
        assert again.warnings == found.warnings
        # These two are asked for when a report is told.
        now = {"created": 0, "peak_memory": 0}
        assert again.report | now == found.report | now
        assert again.bones.keys() == found.bones.keys()
        assert all(np.array_equal(again.bones[name], found.bones[name]) for name in found.bones)
        assert (again.planning_to_fraction.start, again.planning_to_fraction.end) == ("planning", "fraction")
        dose = [aventail.dose.map(coarse.dose, one, to="fraction").dose for one in (found, again)]
        assert np.array_equal(*dose)
        with pytest.raises(aventail.UsageError, match=r"registration\.save"):
            again.save("out")
        for kind in ("image", "points", "contours"):
            thing = {"image": coarse.planning, "points": [0.0, 0.0, 0.0], "contours": coarse.contours}[kind]
            with pytest.raises(aventail.UsageError, match="pickle"):
                again.warp(thing, to="fraction", kind=kind)  # type: ignore[call-overload]


def test_copies_do_what_the_first_does(coarse: aventail.Phantom, found: aventail.Registration) -> None:
    point = [0.0, -20.0, -60.0]
    for other in (copy.copy(found), copy.deepcopy(found)):
        assert np.array_equal(other.warp(point, to="fraction"), found.warp(point, to="fraction"))
    for thing in (coarse.planning, coarse.bones, coarse.truth, found.planning_to_fraction):
        for other in (copy.deepcopy(thing), pickle.loads(pickle.dumps(thing))):
            assert type(other) is type(thing) and np.array_equal(other, thing) and other.spacing == thing.spacing
            assert not np.shares_memory(other.array, thing.array)
    field = pickle.loads(pickle.dumps(found.fraction_to_planning))
    assert (field.start, field.end) == ("fraction", "planning")
    assert pickle.loads(pickle.dumps(coarse.bones)).names == coarse.bones.names
    contours = pickle.loads(pickle.dumps(coarse.contours))
    assert list(contours.structures) == list(coarse.contours.structures) and contours.colours == coarse.contours.colours
    assert np.array_equal(contours.structures["ctv"][0], coarse.contours.structures["ctv"][0])
    assert np.array_equal(pickle.loads(pickle.dumps(coarse)).fraction, coarse.fraction)


SCRIPT = """
import multiprocessing, pickle, sys
from concurrent.futures import ProcessPoolExecutor
import numpy
import aventail


def work(n):
    return aventail.phantom(spacing=(20, 20, 20)).size if n is None else n.size


def told(call):
    try:
        return call()
    except aventail.Error as error:
        return f"{type(error).__name__}: {error}"


if __name__ == "__main__":
    fork, spawn = (multiprocessing.get_context(way) for way in ("fork", "spawn"))
    if sys.argv[1] == "before":
        # Only the children use it.
        with fork.Pool(1) as pool:
            print(pool.map(aventail.phantom, [(20, 20, 20)]))
        sys.exit()
    phantom = aventail.phantom(spacing=(20, 20, 20))
    image = aventail.Image(numpy.zeros((2, 3, 4)))
    with fork.Pool(1) as pool:
        print(told(lambda: pool.map(aventail.phantom, [(20, 20, 20)])))
        print(pool.map(numpy.shape, [image, phantom.planning]))
    with ProcessPoolExecutor(1, mp_context=fork) as pool:
        print(told(lambda: pool.submit(aventail.skeleton, phantom.bones).result()))
    with spawn.Pool(1) as pool:
        print(pool.map(aventail.phantom, [(20, 20, 20)]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_child_is_told_instead_of_waiting_for_ever(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)

    def run(when: str) -> list[str]:
        command = [sys.executable, str(script), when]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        return [line for line in done.stdout.splitlines() if "remedy" not in line or "spawn" not in line]

    made = "[<aventail.Phantom, 26 x 18 x 21 voxels, 18 landmarks>]"
    assert run("before") == [made]
    forked = "UsageError: this process was forked from one that had used aventail, whose threads do not exist here"
    assert run("after") == [forked, "[(2, 3, 4), (21, 18, 26)]", forked, made]
