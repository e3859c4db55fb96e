"""From a planning system and back: DICOM in, DICOM out, and bones by a program that stands in for TotalSegmentator."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_program import program

import aventail


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The phantom as a planning system exports it, in ``dicom``, and its bones."""
    out = tmp_path_factory.mktemp("export") / "phantom"
    done = program("phantom", "--dicom", "--spacing", "9x9x9", "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def files(folder: Path) -> dict[str, bytes]:
    """What lies below a folder, by name."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@pytest.fixture(scope="module")
def by_program(export: Path) -> Path:
    """What the program writes of the same scans."""
    out = export.parent / "program"
    dicom = export / "dicom"
    options = [f"--planning={dicom / 'planning'}", f"--bones={export / 'bones.nii.gz'}", f"--fraction={dicom / 'fraction'}"]
    given = [f"--structures={dicom / 'planning/RS.dcm'}", f"--dose={dicom / 'planning/RD.dcm'}", "--anonymous"]
    done = program("register", *options, "--speed=fast", "--dicom", *given, "--quiet", f"--out={out}")
    assert done.returncode == 0, done.stderr
    return out


def test_dicom_comes_back_as_the_program_gives_it(export: Path, by_program: Path, tmp_path: Path) -> None:
    dicom = export / "dicom"
    registration = aventail.register(
        dicom / "planning",
        export / "bones.nii.gz",
        dicom / "fraction",
        settings="fast",
        dicom=True,
        structures=dicom / "planning/RS.dcm",
        dose=dicom / "planning/RD.dcm",
        anonymous=True,
    )
    registration.save(tmp_path / "own")
    own, other = files(tmp_path / "own" / "dicom"), files(by_program / "dicom")
    assert {"RS.dcm", "RD.dcm", "REG_couch.dcm", "ct/CT.0001.dcm"} < set(own) and set(own) == set(other)
    # UIDs and dates follow from what was read: the same bytes, whoever asked.
    assert [name for name in own if own[name] != other[name]] == []
    assert (tmp_path / "own" / "planning_to_fraction.nii.gz").read_bytes() == (
        by_program / "planning_to_fraction.nii.gz"
    ).read_bytes()

    def told(report: Any) -> tuple[Any, ...]:
        inputs = [{key: i.get(key) for key in ("role", "sha256", "about")} for i in report["inputs"]]
        outputs = {o["name"]: o["sha256"] for o in report["outputs"] if o["name"] != "report.html"}
        return inputs, outputs, [w["code"] for w in report["warnings"]]

    reports = [json.loads((folder / "report.json").read_text()) for folder in (tmp_path / "own", by_program)]
    assert told(reports[0]) == told(reports[1])
    assert [i["role"] for i in reports[0]["inputs"]] == ["planning", "bones", "structures", "dose", "fraction"]
    assert "patient" not in reports[0]["inputs"][0]["about"]
    assert "patient" not in registration.report["inputs"][0]["about"]


def test_what_comes_back_is_what_was_carried(export: Path, by_program: Path) -> None:
    pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed: DICOM is compared by our own reader only")
    fraction = pydicom.dcmread(next((export / "dicom/fraction").glob("*.dcm")))
    frame = fraction.FrameOfReferenceUID
    ct = pydicom.dcmread(by_program / "dicom/ct/CT.0001.dcm")
    dose = pydicom.dcmread(by_program / "dicom/RD.dcm")
    assert (ct.FrameOfReferenceUID, dose.FrameOfReferenceUID) == (frame, frame)
    assert str(ct.PatientName) == "" and str(fraction.PatientName) != ""
    assert ct.StudyInstanceUID == dose.StudyInstanceUID == fraction.StudyInstanceUID
    structures = pydicom.dcmread(by_program / "dicom/RS.dcm")
    names = [roi.ROIName for roi in structures.StructureSetROISequence]
    assert "ctv" in names and structures.ReferencedFrameOfReferenceSequence[0].FrameOfReferenceUID == frame
    # The vectors of the object are the field's.
    [item] = pydicom.dcmread(by_program / "dicom/REG_fraction_to_planning.dcm").DeformableRegistrationSequence
    grid = item.DeformableRegistrationGridSequence[0]
    x, y, z = (int(n) for n in grid.GridDimensions)
    vectors = np.frombuffer(grid.VectorGridData, "<f4").reshape(z, y, x, 3)
    field = aventail.Field.of(by_program / "fraction_to_planning.nii.gz", "fraction", "planning")
    assert np.array_equal(vectors, field.array)


def test_single_results_are_the_programs_objects(export: Path, by_program: Path, tmp_path: Path) -> None:
    planning, fraction = export / "dicom/planning", export / "dicom/fraction"
    registration = aventail.register(planning, export / "bones.nii.gz", fraction, settings="fast")
    structures, dose = planning / "RS.dcm", planning / "RD.dcm"
    own, other = tmp_path / "own", tmp_path / "program"
    own.mkdir()
    other.mkdir()
    registration.warp(structures, "fraction", kind="contours").save_dicom(own / "RS.dcm", fraction, of=structures)
    # As the program reads them: NIfTI would round their origin.
    push, pull = (by_program / f"dicom/REG_{name}.dcm" for name in ("planning_to_fraction", "fraction_to_planning"))
    carried = registration.warp(dose, "fraction", kind="dose", grid=fraction)
    carried.save_dicom(own / "RD.dcm", fraction, of=dose, registrations=[pull])
    registration.warp(planning, "fraction", kind="image").save_dicom(own / "ct", fraction, of=planning)
    registration.planning_to_fraction.save_dicom(own / "REG.dcm", planning, fraction)
    there, back = f"--field=planning:fraction={push}", f"--field=fraction:planning={pull}"
    frames = ["warp", "--from=planning", "--to=fraction", "--quiet"]
    like = f"--dicom-like={fraction}"
    for options in (
        [there, back, f"--input={structures}", like, f"--out={other / 'RS.dcm'}"],
        [back, f"--input={dose}", "--kind=dose", f"--grid={fraction}", like, f"--out={other / 'RD.dcm'}"],
        [back, f"--input={planning}", "--kind=image", like, f"--out={other / 'ct'}"],
        [there, f"--dicom-like={planning}", f"--dicom-to={fraction}", f"--out-field={other / 'REG.dcm'}"],
    ):
        done = program(*frames, *options)
        assert done.returncode == 0, done.stderr
    assert files(own).keys() == files(other).keys() and len(files(own)) > 20
    assert [name for name, content in files(own).items() if content != files(other)[name]] == []


def test_what_cannot_be_dicom_is_refused(export: Path, tmp_path: Path) -> None:
    planning, fraction = export / "dicom/planning", export / "dicom/fraction"
    bones, dose = aventail.Image.of(export / "bones.nii.gz", "labels"), aventail.Image.of(planning / "RD.dcm", "dose")
    with pytest.raises(aventail.UsageError, match="labels are not written"):
        bones.save_dicom(tmp_path / "bones", planning)
    with pytest.raises(aventail.UsageError, match=r"\*\.dcm"):
        dose.save_dicom(tmp_path / "dose.nii.gz", planning)
    with pytest.raises(aventail.UsageError, match="no DICOM series"):
        dose.save_dicom(tmp_path / "dose.dcm", export / "bones.nii.gz")
    with pytest.raises(aventail.UsageError, match="alone in its folder"):
        aventail.Image.of(planning).save_dicom(fraction, fraction)
    # A dose that came from nowhere has no plan, which is said.
    with pytest.warns(RuntimeWarning, match="dicom-no-plan"):
        dose.save_dicom(tmp_path / "dose.dcm", planning, of=export / "dose.nii.gz")


def test_every_fraction_comes_back(export: Path, tmp_path: Path) -> None:
    dicom = export / "dicom"
    days = [dicom / "fraction", dicom / "fraction_2"]
    both = aventail.register(dicom / "planning", export / "bones.nii.gz", days, settings="fast", dicom=True)
    for day, registration in zip(days, both, strict=True):
        registration.save(tmp_path / day.name, view=False)
    alone = aventail.register(dicom / "planning", export / "bones.nii.gz", days[1], settings="fast", dicom=True)
    alone.save(tmp_path / "alone", view=False)
    assert files(tmp_path / "alone" / "dicom") == files(tmp_path / "fraction_2" / "dicom")
    assert files(tmp_path / "fraction" / "dicom") != files(tmp_path / "fraction_2" / "dicom")
    # Nobody asked for anonymity.
    assert both[0].report["inputs"][0]["about"]["patient"]["name"]


def drawn(export: Path, out: Path) -> Path:
    """The bones as a structure set, each outline half a voxel around its voxels' centres."""
    pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed: no structure set of bones is made")
    contourpy = pytest.importorskip("contourpy", reason="contourpy is not installed: no bone is outlined")
    bones = aventail.Image.of(export / "bones.nii.gz", "labels")
    own = pydicom.dcmread(export / "dicom/planning/RS.dcm")
    own.SOPInstanceUID = own.file_meta.MediaStorageSOPInstanceUID = pydicom.uid.generate_uid()
    rois, outlines, observations = [], [], []
    for number, (label, name) in enumerate((bones.names or {}).items(), 1):
        roi, observation, outline = pydicom.Dataset(), pydicom.Dataset(), pydicom.Dataset()
        roi.update(own.StructureSetROISequence[0])
        observation.update(own.RTROIObservationsSequence[0])
        roi.ROINumber = outline.ReferencedROINumber = number
        observation.ObservationNumber = observation.ReferencedROINumber = number
        roi.ROIName, observation.RTROIInterpretedType = name, "ORGAN"
        polygons = []
        for k in np.flatnonzero((bones.array == label).any(axis=(1, 2))):
            mask = np.pad((bones.array[k] == label).astype(float), 1)
            for line in contourpy.contour_generator(z=mask).lines(0.5):
                points = [bones.point((x - 1, y - 1, k)) for x, y in line[:-1]]
                polygon = pydicom.Dataset()
                polygon.ContourGeometricType, polygon.NumberOfContourPoints = "CLOSED_PLANAR", len(points)
                polygon.ContourData = [f"{c:.4f}" for point in points for c in point]
                polygons.append(polygon)
        outline.ContourSequence = polygons
        rois, outlines, observations = [*rois, roi], [*outlines, outline], [*observations, observation]
    own.StructureSetROISequence, own.ROIContourSequence, own.RTROIObservationsSequence = rois, outlines, observations
    own.save_as(out)
    return out


def test_bones_of_a_structure_set_are_those_of_the_program(export: Path, tmp_path: Path) -> None:
    planning, fraction = export / "dicom/planning", export / "dicom/fraction"
    bones = drawn(export, tmp_path / "bones.dcm")
    found = aventail.register(planning, bones, fraction, settings="fast")
    assert len(found.bones) > 30
    options = [f"--planning={planning}", f"--bones={bones}", f"--fraction={fraction}", "--speed=fast"]
    done = program("register", *options, "--quiet", f"--out={tmp_path / 'out'}")
    assert done.returncode == 0, done.stderr
    field = aventail.Field.of(tmp_path / "out/planning_to_fraction.nii.gz", "planning", "fraction")
    assert np.array_equal(found.planning_to_fraction.array, field.array)
    # The set lies in planning's frame of reference.
    with pytest.raises(aventail.InputError, match="frame"):
        aventail.register(fraction, bones, planning)


def test_structures_and_dose_are_read(export: Path, registration: aventail.Registration) -> None:
    planning = export / "dicom" / "planning"
    dose = aventail.Image.of(planning / "RD.dcm", "dose")
    assert dose.array.max() > 10
    contours = aventail.Contours.of(planning / "RS.dcm")
    carried = registration.warp(planning / "RS.dcm", to="fraction", kind="contours")
    assert list(carried.structures) == list(contours.structures)
    assert registration.warp(planning / "RD.dcm", to="fraction", kind="dose").array.max() > 10
    # A set without bones is no skeleton.
    with pytest.raises(aventail.InputError):
        aventail.register(planning, planning / "RS.dcm", export / "dicom" / "fraction")


def test_what_cannot_go_back_is_refused_before_anything_long(export: Path, phantom: aventail.Phantom) -> None:
    dicom, bones = export / "dicom", export / "bones.nii.gz"
    stages: list[str] = []

    def refused(kind: type[aventail.Error], *scans: Any, **more: Any) -> str:
        with pytest.raises(kind) as caught:
            aventail.register(*scans, progress=lambda stage, share: stages.append(stage), **more)
        return str(caught.value)

    both = (dicom / "planning", bones, dicom / "fraction")
    assert "dicom=True" in refused(aventail.UsageError, *both, structures=dicom / "planning/RS.dcm")
    assert "memory" in refused(aventail.UsageError, phantom.planning, bones, dicom / "fraction", dicom=True)
    plain = export / "fraction_ct.nii.gz"
    assert "fraction_ct.nii.gz" in refused(aventail.UsageError, dicom / "planning", bones, plain, dicom=True)
    region = {"region": {"label": "mandible"}}
    assert "region" in refused(aventail.UsageError, *both, dicom=True, settings=region)
    # The second fraction lies in a frame of reference of its own, and its CT is no dose.
    elsewhere = refused(aventail.Error, *both, dicom=True, dose=dicom / "fraction_2")
    assert "fraction_2" in elsewhere and set(stages) <= {"read for DICOM"}


STANDS_IN = """#!/bin/sh
here='HERE'
[ "$1" = --version ] && { echo 2.11.0; exit 0; }
echo "$@" >> "$here/log"
task=total
while [ $# -gt 0 ]; do
  case "$1" in
    -o) out=$2 ;;
    --task) task=$2 ;;
  esac
  shift
done
[ -f "$here/waits" ] && { echo $$ > "$here/running"; exec sleep 60; }
cp "$here/$task.nii.gz" "$out"
"""
"""A program that does what TotalSegmentator does to its files."""


@pytest.fixture
def segmentator(small: aventail.Phantom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the program, first on the path, and the planning CT that it labels."""
    if os.name == "nt":
        pytest.skip("the program that stands in is a shell script")
    here = tmp_path / "here"
    here.mkdir()
    stands_in = here / "TotalSegmentator"
    stands_in.write_text(STANDS_IN.replace("HERE", str(here)))
    stands_in.chmod(0o755)
    for task in ("total", "craniofacial_structures", "headneck_bones_vessels"):
        small.bones.save(here / f"{task}.nii.gz")
    small.planning.save(here / "planning.nii.gz")
    small.fraction.save(here / "fraction.nii.gz")
    monkeypatch.setenv("PATH", f"{here}{os.pathsep}/usr/bin{os.pathsep}/bin")
    return here


def runs(here: Path) -> int:
    """How often the program ran."""
    log = here / "log"
    return len(log.read_text().splitlines()) if log.exists() else 0


def test_bones_are_made_once_as_the_program_makes_them(
    segmentator: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = (segmentator / "planning.nii.gz", "auto", segmentator / "fraction.nii.gz")
    stages: list[str] = []
    found = aventail.register(
        *scans, settings="fast", bones_folder=tmp_path / "kept", progress=lambda stage, share: stages.append(stage)
    )
    assert runs(segmentator) == 3 and "bones by TotalSegmentator" in stages
    kept = sorted(f.name for f in (tmp_path / "kept").iterdir())
    assert len(kept) == 2 and all(name.startswith("bones_auto_") for name in kept)
    assert "bones-auto" in [w.code for w in found.warnings]
    assert kept[1] in str(found.report["inputs"][1]["path"])
    options = [f"--{role}={given}" for role, given in zip(("planning", "bones", "fraction"), scans, strict=True)]
    done = program("register", *options, "--speed=fast", "--quiet", f"--out={tmp_path / 'made' / 'out'}")
    assert done.returncode == 0, done.stderr
    labels = [(tmp_path / folder / kept[1]).read_bytes() for folder in ("kept", "made")]
    assert labels[0] == labels[1] and runs(segmentator) == 6
    field = aventail.Field.of(tmp_path / "made/out/planning_to_fraction.nii.gz", "planning", "fraction")
    assert np.array_equal(field.array, found.planning_to_fraction.array)
    # The next run finds them, without the program; without a folder they are kept here.
    (segmentator / "TotalSegmentator").unlink()
    monkeypatch.chdir(tmp_path / "kept")
    again = aventail.pose(scans[0], "auto", {"skull": {"axial_deg": 3.0}}, settings="fast")
    assert "bones-auto" in [w.code for w in again.warnings] and runs(segmentator) == 6


def test_bones_that_cannot_be_made(
    segmentator: Path, phantom: aventail.Phantom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    planning, fraction = segmentator / "planning.nii.gz", segmentator / "fraction.nii.gz"
    with pytest.raises(aventail.UsageError, match="in memory"):
        aventail.register(phantom.planning, "auto", fraction)
    with pytest.raises(aventail.UsageError, match="the labels of TotalSegmentator bring their own names"):
        aventail.register(planning, "auto", fraction, labels={1: "skull"})
    with pytest.raises(aventail.ReadError, match="none.nii.gz"):
        aventail.register(planning, "auto", tmp_path / "none.nii.gz")
    assert runs(segmentator) == 0
    (segmentator / "total.nii.gz").unlink()
    with pytest.raises(aventail.ReadError, match="--task total"):
        aventail.register(planning, "auto", fraction)
    (segmentator / "TotalSegmentator").unlink()
    assert shutil.which("TotalSegmentator") is None
    with pytest.raises(aventail.UsageError, match="not on the PATH"):
        aventail.register(planning, "auto", fraction)
    assert not list(tmp_path.glob("bones_auto*"))


def test_ctrl_c_ends_the_other_program(segmentator: Path, tmp_path: Path) -> None:
    (segmentator / "waits").write_text("")
    running = segmentator / "running"

    def later() -> None:
        while not running.exists() or not running.read_text().strip():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    watcher = threading.Thread(target=later, daemon=True)
    watcher.start()
    with pytest.raises(KeyboardInterrupt):
        aventail.register(
            segmentator / "planning.nii.gz", "auto", segmentator / "fraction.nii.gz", bones_folder=tmp_path / "kept"
        )
    watcher.join()
    process = int(running.read_text())

    def lives() -> bool:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        return True

    # It is asked several times a second; waiting longer than its own minute would prove nothing.
    until = time.monotonic() + 20
    while lives() and time.monotonic() < until:
        time.sleep(0.05)
    assert not lives()
    while list((tmp_path / "kept").iterdir()) and time.monotonic() < until:
        time.sleep(0.05)
    assert not list((tmp_path / "kept").iterdir()), "no working folder stays"
