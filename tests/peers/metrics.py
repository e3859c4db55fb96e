#!/usr/bin/env python3
"""Contour metrics of aventail, plastimatch and SimpleITK on solids whose answers are known, and on bones of a case.

usage: metrics.py AVENTAIL [CASES]

AVENTAIL  the aventail program
CASES     folder with bones.nii.gz and bones.json (default: AVENTAIL_CASES); left out without one

Prints a table; exit code 1 when aventail is off an analytic value by more than 1 %, or Dice differs between the tools.
"""
import json
import os
import re
import subprocess
import sys
import tempfile

import numpy as np
import SimpleITK as sitk


def image(array, spacing, origin):
    out = sitk.GetImageFromArray(array.astype(np.uint16).transpose(2, 1, 0))
    out.SetSpacing(spacing)
    out.SetOrigin(origin)
    return out


def centres(size, spacing, origin):
    axes = [o + s * np.arange(n) for n, s, o in zip(size, spacing, origin)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def solids():
    """Name, image a, image b, exact values."""
    size, spacing, origin = (120, 100, 100), (0.8, 1.0, 1.0), (-48.0, -50.0, -50.0)
    x = centres(size, spacing, origin)
    r, d = 25.0, 20.0
    ball = lambda at: ((x - [at, 0.3, 0.1]) ** 2).sum(-1) <= r * r
    volume = 4 / 3 * np.pi * r**3
    lens = np.pi * (4 * r + d) * (2 * r - d) ** 2 / 12
    cosine = -1 + 2 * (np.arange(100000) + 0.5) / 100000
    away = np.sort(np.abs(np.sqrt(r * r + d * d + 2 * r * d * cosine) - r))
    exact = dict(dice=lens / volume, mean=away.mean(), p95=away[95000], max=d, com=d)
    yield "balls r 25, 20 mm apart", image(ball(-10), spacing, origin), image(ball(10), spacing, origin), exact
    size, spacing, origin = (77, 77, 77), (1.0, 1.0, 1.0), (-38.0, -38.0, -38.0)
    y = centres(size, spacing, origin)
    round_ = lambda radius: (y**2).sum(-1) <= radius**2
    exact = dict(dice=2 * 20.5**3 / (20.5**3 + 35.5**3), mean=15, com=0)
    yield "concentric, 20.5 and 35.5", image(round_(20.5), spacing, origin), image(round_(35.5), spacing, origin), exact


def ours(program, a, b, folder):
    field = sitk.Image(a.GetSize(), sitk.sitkVectorFloat32, 3)
    field.CopyInformation(a)
    sitk.WriteImage(field, f"{folder}/identity.mha")
    names = f"{folder}/names.json"
    with open(names, "w") as out:
        json.dump({"labels": {"1": "solid"}}, out)
    command = [program, "evaluate", "--fraction-to-planning", f"{folder}/identity.mha", "--labels", names]
    command += ["--labels-planning", f"{folder}/a.nii.gz", "--labels-fraction", f"{folder}/b.nii.gz"]
    command += ["--out", f"{folder}/out", "--quiet", "--json"]
    run = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    c = run["fields"][0]["assessment"]["contours"][0]
    d = c["distances"]
    return dict(dice=c["dice"], mean=d["mean_mm"], p95=d["hausdorff_95_mm"], max=d["hausdorff_mm"], com=d["centre_of_mass_mm"])


def plastimatch(folder):
    text = subprocess.run(["plastimatch", "dice", "--all", f"{folder}/a.nii.gz", f"{folder}/b.nii.gz"], capture_output=True, text=True).stdout
    value = lambda pattern: float(re.search(pattern + r"\s*[:=]\s*([-\d.eE+]+)", text).group(1))
    coms = [[float(v) for v in m] for m in re.findall(r"^(?:ref|cmp)\s+(\S+)\s+(\S+)\s+(\S+)", text, re.M)]
    found = dict(dice=value("DICE"), max=value(r"Hausdorff distance"), mean=value(r"Avg average Hausdorff distance \(boundary\)"),
                 p95=value(r"Percent \(0\.95\) Hausdorff distance \(boundary\)"))
    found["com"] = float(np.linalg.norm(np.subtract(*coms[:2]))) if len(coms) > 1 else np.nan
    found["region mean"] = value(r"Avg average Hausdorff distance")
    found["max boundary"] = value(r"Hausdorff distance \(boundary\)")
    return found


def itk(a, b):
    overlap = sitk.LabelOverlapMeasuresImageFilter()
    overlap.Execute(a, b)
    hausdorff = sitk.HausdorffDistanceImageFilter()
    hausdorff.Execute(a, b)
    edges = [sitk.LabelContour(i == 1, fullyConnected=False) for i in (a, b)]
    maps = [sitk.Abs(sitk.SignedMaurerDistanceMap(e, squaredDistance=False, useImageSpacing=True)) for e in edges]
    far = [sitk.GetArrayFromImage(m)[sitk.GetArrayFromImage(e) > 0] for m, e in ((maps[1], edges[0]), (maps[0], edges[1]))]
    middle = []
    for i in (a, b):
        shape = sitk.LabelShapeStatisticsImageFilter()
        shape.Execute(i)
        middle.append(shape.GetCentroid(1))
    return dict(dice=overlap.GetDiceCoefficient(), mean=(far[0].mean() + far[1].mean()) / 2,
                p95=max(np.percentile(f, 95) for f in far), max=hausdorff.GetHausdorffDistance(),
                com=float(np.linalg.norm(np.subtract(*middle))), **{"region mean": hausdorff.GetAverageHausdorffDistance()})


def bones(folder):
    """Bones of a case against themselves, moved by a few voxels."""
    labels = sitk.ReadImage(f"{folder}/bones.nii.gz")
    with open(f"{folder}/bones.json") as source:
        table = json.load(source)
    names = {v: int(k) for k, v in table.get("labels", table).items()}
    for name in ("mandible", "vertebrae_C2"):
        a = sitk.Cast(labels == names[name], sitk.sitkUInt16)
        array = np.roll(sitk.GetArrayFromImage(a), (1, 2, 3), (0, 1, 2))
        b = sitk.GetImageFromArray(array)
        b.CopyInformation(a)
        yield f"{name}, moved 3, 2, 1 voxels", a, b, dict(com=float(np.linalg.norm(np.multiply(a.GetSpacing(), (3, 2, 1)))))


def main():
    program = sys.argv[1]
    cases = sys.argv[2] if len(sys.argv) > 2 else os.environ.get("AVENTAIL_CASES")
    bad = False
    print(f"{'solid':28} {'metric':14} {'exact':>9} {'aventail':>9} {'plastim.':>9} {'SimpleITK':>9}")
    for name, a, b, exact in [*solids(), *(bones(cases) if cases else [])]:
        with tempfile.TemporaryDirectory() as folder:
            sitk.WriteImage(a, f"{folder}/a.nii.gz")
            sitk.WriteImage(b, f"{folder}/b.nii.gz")
            found = [ours(program, a, b, folder), plastimatch(folder), itk(a, b)]
        for metric in ("dice", "com", "mean", "p95", "max", "max boundary", "region mean"):
            values = [f"{f[metric]:9.4f}" if metric in f else f"{'-':>9}" for f in found]
            truth = exact.get(metric)
            print(f"{name:28} {metric:14} {'-' if truth is None else f'{truth:.4f}':>9} " + " ".join(values))
            if truth is not None and abs(found[0][metric] - truth) > 0.01 * truth + 1e-6:
                bad = True
        bad |= max(f["dice"] for f in found) - min(f["dice"] for f in found) > 1e-5
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
