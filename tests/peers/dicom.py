#!/usr/bin/env python3
"""Do other readers of DICOM read what aventail writes, as aventail means it?

usage: dicom.py AVENTAIL [--reuse DIR]

AVENTAIL  the aventail program
--reuse   the phantom with its DICOM set is kept here, and taken if it is here already

`aventail phantom --dicom` writes a CT series of planning and fraction, a structure set, a dose and the true registrations, beside the
same things as NIfTI and JSON. Each reader opens the DICOM; the table compares with the other files:
  ct       greatest difference to planning_ct.nii.gz, HU (geometry within 0.001 mm)
  outline  greatest difference of a structure's volume to that of contours.json, as mean shift of its outline, mm
  dose     greatest difference to dose.nii.gz, Gy
  field    greatest distance between true_planning_to_fraction.nii.gz and PS3.3 C.20.3.1.1 applied to the object, mm
  bone     greatest distance between the skull's transform and PS3.3 C.20.2.1.1 applied to the object, mm
  labels   voxels whose segment's name is not that of bones.nii.gz, which `aventail warp --kind labels --dicom-like` wrote
"highdicom, read" is the other way round: its segmentations (bits, fractions, numbers; RLE, JPEG 2000), read by aventail.
dciodvfy checks every object against the standard's modules; each error is printed. It cannot parse pixels of 32 bits, so the dose is
checked as a copy of 16 bits. A reader that is not installed is skipped and named. Exit code 1 when a reader differs by more than
LIMITS or dciodvfy finds an error.
"""
import argparse
import glob
import json
import os
import shutil
import subprocess
import sys
import tempfile
import warnings

# This file's name is that of a module that dicompyler-core looks for.
sys.path.pop(0)

import numpy as np

warnings.filterwarnings("ignore")
# HU (NIfTI and DICOM both hold whole HU), mm, Gy, mm, mm. Masks of voxels may be off by half a pixel.
LIMITS = {"ct": 0.0, "outline": 1.0, "dose": 1e-5, "field": 1e-3, "bone": 1e-6, "labels": 0}


class Set:
    """The phantom's files."""

    def __init__(self, folder, aventail):
        self.folder, self.aventail = folder, aventail
        self.dicom = os.path.join(folder, "dicom")
        self.planning = os.path.join(self.dicom, "planning")
        self.structures = os.path.join(self.planning, "RS.dcm")
        self.dose = os.path.join(self.planning, "RD.dcm")
        self.field = os.path.join(self.dicom, "registration", "fraction.dcm")
        self.bone = os.path.join(self.dicom, "registration", "fraction_skull.dcm")
        self.labels = os.path.join(folder, "SEG.dcm")
        self.slices = sorted(glob.glob(os.path.join(self.planning, "CT.*.dcm")))

    def segmentation(self):
        """The bones, where they are, as a segmentation."""
        same = os.path.join(self.folder, "same.txt")
        np.savetxt(same, np.eye(4), fmt="%g")
        run([self.aventail, "warp", "--field", f"planning:copy={same}", "--space", "lps", "--from", "planning", "--to", "copy",
             "--kind", "labels", "--input", os.path.join(self.folder, "bones.nii.gz"), "--dicom-like", self.planning,
             "--out", self.labels])

    def named(self, path):
        """The name of the label of each voxel (k, j, i)."""
        told = json.loads(run([self.aventail, "inspect", "--json", path]))["files"][0]["content"]["labels"]
        names = np.full(1 + max(l["label"] for l in told), "", object)
        for label in told:
            names[label["label"]] = label["name"]
        return names[self.image(os.path.abspath(path))[0]]

    def image(self, name):
        """An image as (array k, j, i; spacing; origin), LPS."""
        import SimpleITK as sitk

        image = sitk.ReadImage(os.path.join(self.folder, name))
        return sitk.GetArrayFromImage(image), np.array(image.GetSpacing()), np.array(image.GetOrigin())

    def outlines(self):
        """Volume, cm3, and length of all outlines x slice, cm2, of each structure of contours.json."""
        contours = json.load(open(os.path.join(self.folder, "contours.json")))
        _, spacing, _ = self.image("planning_ct.nii.gz")
        sizes = {}
        for structure in contours["structures"]:
            planes, length = {}, 0.0
            for points in map(np.array, structure["contours"]):
                x, y = points[:, 0], points[:, 1]
                area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
                # Holes turn the other way round.
                plane = round(points[0, 2], 3)
                planes[plane] = planes.get(plane, 0.0) + area
                length += np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum()
            volume = sum(map(abs, planes.values())) * spacing[2] / 1000.0
            sizes[structure["name"]] = (volume, length * spacing[2] / 100.0)
        return sizes


def same_place(spacing, origin, expected):
    assert np.allclose(spacing, expected[1], atol=1e-5) and np.allclose(origin, expected[2], atol=1e-3), (spacing, origin)


def worst_outline(found, phantom, left_out=()):
    expected = {name: size for name, size in phantom.outlines().items() if name not in left_out}
    missing = set(expected) - set(found)
    assert not missing, f"no {missing}"
    off = {name: 10.0 * abs(found[name] - volume) / surface for name, (volume, surface) in expected.items()}
    worst = max(off, key=off.get)
    print(f"  {worst}: {found[worst]:.2f} of {expected[worst][0]:.2f} cm3, outline off by {off[worst]:.3f} mm")
    return off[worst]


def read_pydicom(phantom):
    import pydicom

    results = {}
    expected = phantom.image("planning_ct.nii.gz")
    slices = [pydicom.dcmread(path) for path in phantom.slices]
    slices.sort(key=lambda s: float(s.ImagePositionPatient[2]))
    hu = np.stack([s.pixel_array * float(s.RescaleSlope) + float(s.RescaleIntercept) for s in slices])
    first = slices[0]
    step = float(slices[1].ImagePositionPatient[2]) - float(first.ImagePositionPatient[2])
    spacing = [float(first.PixelSpacing[1]), float(first.PixelSpacing[0]), step]
    same_place(spacing, [float(v) for v in first.ImagePositionPatient], expected)
    results["ct"] = np.abs(hu - expected[0]).max()
    # Areas of keyholes are right by the shoelace formula.
    rs = pydicom.dcmread(phantom.structures)
    names = {r.ROINumber: r.ROIName for r in rs.StructureSetROISequence}
    known = {s.SOPInstanceUID: float(s.ImagePositionPatient[2]) for s in slices}
    found = {}
    for roi in rs.ROIContourSequence:
        for contour in roi.get("ContourSequence", []):
            points = np.array(contour.ContourData, float).reshape(-1, 3)
            image = contour.ContourImageSequence[0].ReferencedSOPInstanceUID
            assert abs(known[image] - points[0, 2]) < 1e-3, "a contour names the image of another plane"
            x, y = points[:, 0], points[:, 1]
            area = abs(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
            name = names[roi.ReferencedROINumber]
            found[name] = found.get(name, 0.0) + area * step / 1000.0
    results["outline"] = worst_outline(found, phantom)
    rd = pydicom.dcmread(phantom.dose)
    truth = phantom.image("dose.nii.gz")
    results["dose"] = np.abs(rd.pixel_array.astype(float) * float(rd.DoseGridScaling) - truth[0]).max()
    spacing = [float(rd.PixelSpacing[1]), float(rd.PixelSpacing[0]), float(np.diff(rd.GridFrameOffsetVector)[0])]
    same_place(spacing, [float(v) for v in rd.ImagePositionPatient], truth)
    results["field"] = field_error(pydicom.dcmread(phantom.field), phantom)
    reg = pydicom.dcmread(phantom.bone)
    matrix = reg.RegistrationSequence[1].MatrixRegistrationSequence[0].MatrixSequence[0]
    matrix = np.array(matrix.FrameOfReferenceTransformationMatrix, float).reshape(4, 4)
    truth = np.array(json.load(open(os.path.join(phantom.folder, "true_bone_transforms.json")))["skull"])
    corners = np.array([[x, y, z, 1.0] for x in (-250, 250) for y in (-200, 200) for z in (-300, 200)])
    results["bone"] = np.linalg.norm(corners @ (matrix - truth).T, axis=1).max()
    assert reg.RegistrationSequence[1].FrameOfReferenceUID == first.FrameOfReferenceUID
    return results


def field_error(reg, phantom):
    """The standard's equation at every node: Post (Pre x + d)."""
    import SimpleITK as sitk

    item = reg.DeformableRegistrationSequence[0]
    matrix = lambda s: np.array(s[0].FrameOfReferenceTransformationMatrix, float).reshape(4, 4)
    before = matrix(item.PreDeformationMatrixRegistrationSequence)
    after = matrix(item.PostDeformationMatrixRegistrationSequence)
    grid = item.DeformableRegistrationGridSequence[0]
    n = [int(v) for v in grid.GridDimensions]
    d = np.frombuffer(grid.VectorGridData, "<f4").reshape(n[2], n[1], n[0], 3).astype(float)
    row, column = np.array(grid.ImageOrientationPatient, float).reshape(2, 3)
    k, j, i = np.meshgrid(*[np.arange(m) for m in (n[2], n[1], n[0])], indexing="ij")
    res = np.array(grid.GridResolution, float)
    x = (
        np.array(grid.ImagePositionPatient, float)
        + i[..., None] * res[0] * row
        + j[..., None] * res[1] * column
        + k[..., None] * res[2] * np.cross(row, column)
    )
    got = (x @ before[:3, :3].T + before[:3, 3] + d) @ after[:3, :3].T + after[:3, 3]
    image = sitk.ReadImage(os.path.join(phantom.folder, "true_planning_to_fraction.nii.gz"), sitk.sitkVectorFloat64)
    expected = sitk.GetArrayFromImage(image)
    origin, spacing = np.array(image.GetOrigin()), np.array(image.GetSpacing())
    index = np.rint((x - origin) / spacing).astype(int)
    assert np.abs(index * spacing + origin - x).max() < 1e-3
    expected = expected[index[..., 2], index[..., 1], index[..., 0]]
    return np.linalg.norm(got - x - expected, axis=-1).max()


def read_simpleitk(phantom):
    import SimpleITK as sitk

    series = sitk.ReadImage(phantom.slices[0]).GetMetaData("0020|000e")
    names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(phantom.planning, series)
    assert len(names) == len(phantom.slices)
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(names)
    image = reader.Execute()
    expected = phantom.image("planning_ct.nii.gz")
    same_place(image.GetSpacing(), image.GetOrigin(), expected)
    results = {"ct": np.abs(sitk.GetArrayFromImage(image).astype(float) - expected[0]).max()}
    # It leaves Dose Grid Scaling to the caller.
    dose, truth = sitk.ReadImage(phantom.dose), phantom.image("dose.nii.gz")
    same_place(dose.GetSpacing(), dose.GetOrigin(), truth)
    values = sitk.GetArrayFromImage(dose).astype(float) * float(dose.GetMetaData("3004|000e"))
    results["dose"] = np.abs(values - truth[0]).max()
    return results


def read_highdicom(phantom):
    import highdicom as hd
    import pydicom

    volume = hd.get_volume_from_series([pydicom.dcmread(p) for p in phantom.slices])
    expected = phantom.image("planning_ct.nii.gz")
    array, affine = volume.array.astype(float), volume.affine
    # Axes are frames, rows, columns; frames may run either way.
    if affine[2, 0] < 0:
        array, origin = array[::-1], affine[:3, 3] + affine[:3, 0] * (array.shape[0] - 1)
    else:
        origin = affine[:3, 3]
    same_place(np.abs([affine[0, 2], affine[1, 1], affine[2, 0]]), origin, expected)
    return {"ct": np.abs(array - expected[0]).max(), "labels": segments_off(phantom)}


def segments_off(phantom):
    import highdicom as hd

    segmentation = hd.seg.segread(phantom.labels)
    volume = segmentation.get_volume(combine_segments=True)
    truth, spacing, origin = phantom.image("bones.nii.gz")
    expected = phantom.named(os.path.join(phantom.folder, "bones.nii.gz"))
    found = np.full(truth.shape, "", object)
    names = {n: segmentation.get_segment_description(n).segment_label for n in segmentation.segment_numbers}
    for at in np.argwhere(volume.array):
        i, j, k = np.rint(((volume.affine @ [*at, 1.0])[:3] - origin) / spacing).astype(int)
        found[k, j, i] = names[int(volume.array[tuple(at)])]
    return int((found != expected).sum())


def written_by_highdicom(phantom):
    import highdicom as hd
    import pydicom
    from highdicom.sr.coding import CodedConcept
    from pydicom.uid import JPEG2000Lossless, RLELossless

    slices = [pydicom.dcmread(path) for path in phantom.slices]
    path = os.path.join(phantom.folder, "bones.nii.gz")
    expected = phantom.named(path)
    names = sorted(set(expected.ravel()) - {""})
    numbers = {name: n + 1 for n, name in enumerate(names)}
    labels = np.vectorize(lambda name: numbers.get(name, 0))(expected).astype(np.uint8)
    anatomy = CodedConcept("123037004", "SCT", "Anatomical Structure")
    made_by = hd.AlgorithmIdentificationSequence("test", CodedConcept("123109", "DCM", "Artificial Intelligence"), "1")
    segments = [
        hd.seg.SegmentDescription(n, name, anatomy, anatomy, "AUTOMATIC", algorithm_identification=made_by)
        for name, n in numbers.items()
    ]
    shares = np.stack([(labels == n) * np.float32(0.8) for n in numbers.values()], -1)
    kinds = [("BINARY", labels, {}), ("BINARY", labels, {"omit_empty_frames": False})]
    kinds += [("FRACTIONAL", shares, {"transfer_syntax_uid": RLELossless, "max_fractional_value": 200})]
    kinds += [("FRACTIONAL", shares, {"transfer_syntax_uid": JPEG2000Lossless})]
    kinds += [("LABELMAP", labels, {}), ("LABELMAP", labels, {"transfer_syntax_uid": RLELossless})]
    worst = 0
    with tempfile.TemporaryDirectory() as folder:
        given, got = os.path.join(folder, "seg.dcm"), os.path.join(folder, "labels.nii.gz")
        for kind, array, more in kinds:
            hd.seg.Segmentation(
                slices, array, kind, segments, hd.UID(), 1, hd.UID(), 1, "test", "test", "1", "1", **more
            ).save_as(given)
            run([phantom.aventail, "labels", "merge", given, "--grid", phantom.planning, "--out", got])
            worst = max(worst, int((phantom.named(got) != expected).sum()))
    return {"labels": worst}


def read_rt_utils(phantom):
    from rt_utils import RTStructBuilder

    with tempfile.TemporaryDirectory() as folder:
        # It takes every file of the folder for an image.
        for path in phantom.slices:
            os.link(path, os.path.join(folder, os.path.basename(path)))
        rs = RTStructBuilder.create_from(dicom_series_path=folder, rt_struct_path=phantom.structures)
        _, spacing, _ = phantom.image("planning_ct.nii.gz")
        found = {n: rs.get_roi_mask_by_name(n).sum() * np.prod(spacing) / 1000.0 for n in rs.get_roi_names()}
    # It fills pixels that the rounded outline touches: half a pixel too many all around. Masks of images that are not square
    # are cut off (columns and rows are taken for each other), and the body reaches there.
    return {"outline": max(0.0, worst_outline(found, phantom, ["body"]) - 0.5 * spacing[0])}


def read_dicompyler(phantom):
    import pydicom.dicomio

    # pydicom 3 has no name that it wants.
    pydicom.dicomio.read_file = pydicom.dicomio.dcmread
    from dicompylercore import dicomparser, dvhcalc

    parser = dicomparser.DicomParser(phantom.structures)
    structures = parser.GetStructures()
    found, peaks = {}, {}
    for number, structure in structures.items():
        dvh = dvhcalc.get_dvh(phantom.structures, phantom.dose, number, interpolation_resolution=None)
        found[structure["name"]], peaks[structure["name"]] = float(dvh.volume), dvh.max
    truth = phantom.image("dose.nii.gz")[0].max()
    # It counts dose voxels inside contours, in bins of 0.01 Gy.
    print("  dicompyler-core, dose voxels in contours: " + ", ".join(
        f"{n} {found[n]:.1f} of {v:.1f} cm3" for n, (v, _) in phantom.outlines().items()))
    dose = dicomparser.DicomParser(phantom.dose).GetDoseData()
    return {"dose": abs(dose["dosemax"] * float(dose["dosegridscaling"]) - truth)}


def read_plastimatch(phantom):
    import SimpleITK as sitk

    if not shutil.which("plastimatch"):
        raise ImportError("plastimatch")
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        at = lambda name: os.path.join(folder, name)
        run(["plastimatch", "convert", "--input", phantom.planning, "--output-img", at("ct.nii.gz"),
             "--output-dose-img", at("dose.nii.gz"), "--output-prefix", at("masks"), "--prefix-format", "nii.gz"])
        expected = phantom.image("planning_ct.nii.gz")
        image = sitk.ReadImage(at("ct.nii.gz"))
        same_place(image.GetSpacing(), image.GetOrigin(), expected)
        results["ct"] = np.abs(sitk.GetArrayFromImage(image).astype(float) - expected[0]).max()
        truth, dose = phantom.image("dose.nii.gz"), sitk.ReadImage(at("dose.nii.gz"))
        same_place(dose.GetSpacing(), dose.GetOrigin(), truth)
        results["dose"] = np.abs(sitk.GetArrayFromImage(dose).astype(float) - truth[0]).max()
        found = {}
        for path in glob.glob(at("masks/*.nii.gz")):
            mask = sitk.ReadImage(path)
            name = os.path.basename(path)[: -len(".nii.gz")]
            found[name] = (sitk.GetArrayFromImage(mask) > 0).sum() * np.prod(mask.GetSpacing()) / 1000.0
        results["outline"] = worst_outline(found, phantom)
    return results


def read_dcmtk(phantom):
    if not shutil.which("dcmdump"):
        raise ImportError("dcmdump")
    for path in objects(phantom):
        out = run(["dcmdump", "+E", path])
        assert "W:" not in out and "E:" not in out, f"{path}: {out[:400]}"
    return {}


def objects(phantom):
    fraction = sorted(glob.glob(os.path.join(phantom.dicom, "fraction", "*.dcm")))
    return [phantom.slices[0], fraction[-1], phantom.structures, phantom.dose, phantom.field, phantom.bone, phantom.labels]


def check_dciodvfy(phantom):
    import pydicom

    if not shutil.which("dciodvfy"):
        raise ImportError("dciodvfy")
    errors = []
    with tempfile.TemporaryDirectory() as folder:
        short = os.path.join(folder, "RD16.dcm")
        rd = pydicom.dcmread(phantom.dose)
        pixels, scaling = rd.pixel_array, float(rd.DoseGridScaling)
        factor = max(1, int(pixels.max()) // 65000)
        rd.DoseGridScaling = f"{scaling * factor:.9g}"
        rd.BitsAllocated = rd.BitsStored = 16
        rd.HighBit = 15
        rd.PixelData = (pixels // factor).astype("<u2").tobytes()
        rd.save_as(short)
        for path in [short if p == phantom.dose else p for p in objects(phantom)]:
            out = run(["dciodvfy", "-new", path], check=False)
            lines = [line for line in out.splitlines() if line.startswith(("Error", "Warning"))]
            for line in lines:
                print(f"  dciodvfy, {os.path.basename(path)}: {line}")
            errors += [line for line in lines if line.startswith("Error")]
            assert "failed" not in out, f"{path}: {out[-300:]}"
    assert not errors, f"{len(errors)} errors"
    return {}


READERS = {
    "pydicom": read_pydicom,
    "SimpleITK (GDCM)": read_simpleitk,
    "highdicom": read_highdicom,
    "highdicom, read": written_by_highdicom,
    "rt-utils": read_rt_utils,
    "dicompyler-core": read_dicompyler,
    "plastimatch": read_plastimatch,
    "DCMTK": read_dcmtk,
    "dciodvfy": check_dciodvfy,
}


def run(command, check=True):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, errors="replace")
    if check and done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stdout[-500:]}")
    return done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aventail")
    parser.add_argument("--reuse")
    args = parser.parse_args()
    folder = args.reuse or tempfile.mkdtemp()
    if not os.path.exists(os.path.join(folder, "phantom.json")):
        run([args.aventail, "phantom", "--dicom", "--out", folder])
    phantom, bad = Set(folder, args.aventail), 0
    phantom.segmentation()
    table = []
    for name, read in READERS.items():
        try:
            results = read(phantom)
        except ImportError as e:
            table.append((name, f"not installed: {e}", {}))
            continue
        except Exception as e:  # a reader that fails is a finding
            table.append((name, f"FAILED: {type(e).__name__}: {str(e)[:200]}", {}))
            bad += 1
            continue
        off = [key for key, value in results.items() if value > LIMITS[key]]
        bad += bool(off)
        table.append((name, "differs: " + ", ".join(off) if off else "read", results))
    print(f"\n{'reader':18} {'ct HU':>9} {'outline mm':>10} {'dose Gy':>9} {'field mm':>9} {'bone mm':>9} {'labels':>7}")
    for name, verdict, results in table:
        cell = lambda key, width: f"{results[key]:{width}.2g}" if key in results else " " * (width - 1) + "-"
        cells = " ".join([cell("ct", 9), cell("outline", 10), cell("dose", 9), cell("field", 9), cell("bone", 9), cell("labels", 7)])
        print(f"{name:18} {cells}  {verdict}")
    if not args.reuse:
        shutil.rmtree(folder)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
