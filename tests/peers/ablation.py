#!/usr/bin/env python3
"""What each ingredient of the default gives, and what a wrong input takes: two tables, of error, folds and time.

usage: ablation.py AVENTAIL [CASES] [--case NAME,NAME] [--part ingredients,disturbed] [--threads N]

AVENTAIL  the aventail program
CASES     folder with planning_ct.nii.gz, bones.nii.gz, bones.json and a folder NAME per case with fraction_ct.nii.gz,
          landmarks.csv and truth_points.csv.gz (x, y, z of planning in LPS mm, the true displacement, 0 or the bone's label);
          default: AVENTAIL_CASES
--case    cases of the first table (default moderate,spline); the second takes the first of them

Errors are at the true points: soft tissue, and the mean of each bone that has 200 or more of them. Folds are cells away from
contact of bones / in contact, points those voxels whose way to the fraction and back misses by more than 0.5 mm, as the
report counts them. Times are the program's own, with its files. The tables go to the terminal, row by row.
"""
import argparse
import functools
import json
import os
import shutil
import subprocess
import tempfile

import numpy as np
import SimpleITK as sitk
from side_by_side import errors, true_points

INGREDIENTS = [
    ("default", ""),
    ("without images", "[refine]\nweight = 0"),
    ("without grey values, the skin instead", "[refine]\nweight = 0\nskin.weight = 1"),
    ("without relaxation and images", "[refine]\nweight = 0\n[chainmail]\nrelaxation = []"),
    ("links that do not turn (heterogeneous), no images", '[refine]\nweight = 0\n[chainmail.variant]\nelasticity = "heterogeneous"'),
    ("images not held to the links", "[refine]\ndeparture = 1000"),
    ("differences not robust", "[refine]\nrobust = 1000"),
    ("compressible tissue", "[chainmail]\npoisson = 0"),
    ("one material for all tissue", "[chainmail]\nmaterial = [{ hu = -500, min = 0.7, max = 1.3, shear = 0.3 }, "
     "{ hu = 250, min = 1, max = 1, shear = 0 }]"),
    ("without mending", "[chainmail]\nmend = 0"),
    ("fields left as they are", "[consistency]\nrounds = 0"),
    ("no bone by itself first", "[fit]\noutward = []"),
    ("bones all together, coarse only", "[fit]\nlevels = [[2.0, 4000]]"),
    ("HU as they are in the fit", '[fit]\nmeasure = "squared-difference"'),
    ("nearest bone's motion for all tissue", 'soft_tissue = "nearest-bone"'),
    ("thin-plate splines between bones", 'soft_tissue = "thin-plate-splines"'),
]


class Job:
    def __init__(self, options):
        self.options, self.folder = options, tempfile.mkdtemp(prefix="ablation-")
        self.truth = functools.cache(true_points)
        self.planning, self.bones, self.names = (
            f"{options.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json")
        )

    def case(self, name):
        return f"{self.options.cases}/{name}"

    def run(self, case, settings="", bones=None, fraction=None):
        """Registers; cells of a row of the table, or what went wrong."""
        out, config = f"{self.folder}/out", f"{self.folder}/settings.toml"
        with open(config, "w", encoding="utf-8") as file:
            file.write(settings + "\n")
        done = subprocess.run(
            [self.options.aventail, "register", "-q", "--planning", self.planning, "--bones", bones or self.bones]
            + ["--labels", self.names, "--fraction", fraction or f"{self.case(case)}/fraction_ct.nii.gz", "--config", config]
            + ["--landmarks", f"{self.case(case)}/landmarks.csv", "--threads", str(self.options.threads), "--out", out],
            capture_output=True, text=True, check=False,
        )
        if done.returncode != 0:
            return [f"refused, exit {done.returncode}: {done.stderr.strip().splitlines()[-1]}"] + [""] * 6
        with open(f"{out}/report.json", encoding="utf-8") as file:
            report = json.load(file)
        truth = self.truth(self.case(case))
        error = errors(f"{out}/planning_to_fraction.nii.gz", truth)
        shutil.rmtree(out)
        label, points = np.unique(truth[:, 6], return_counts=True)
        bones = [error[truth[:, 6] == b].mean() for b, n in zip(label, points) if b > 0 and n >= 200]
        soft = error[truth[:, 6] == 0]
        jacobian, back = report["jacobian"], report["consistency"]
        residuals = [l["after"] for l in report["landmarks"]["each"]]
        return [
            f"{np.mean(bones):.2f} / {max(bones):.2f}",
            f"{soft.mean():.2f}",
            f"{np.percentile(soft, 95):.1f}, {np.percentile(soft, 99.5):.1f}",
            f"{np.mean(residuals):.2f}",
            f"{jacobian['body']['folded']} / {jacobian['contact']['folded']}",
            f"{back['beyond']}, {back['there_and_back_mm']['max']:.2f}",
            f"{sum(s['seconds'] for s in report['stages']):.1f}",
        ]


def ingredients(job, cases):
    for name, settings in INGREDIENTS:
        for case in cases:
            yield name, case, job.run(case, settings)


def disturbed(job, cases):
    case = cases[0]
    with open(job.names, encoding="utf-8") as file:
        value = {name: int(v) for v, name in json.load(file)["labels"].items()}
    labels, fraction = sitk.ReadImage(job.bones), sitk.ReadImage(f"{job.case(case)}/fraction_ct.nii.gz")
    l, f = sitk.GetArrayFromImage(labels), sitk.GetArrayFromImage(fraction).astype(np.float32)

    def save(array, like):
        image = sitk.GetImageFromArray(array)
        image.CopyInformation(like)
        sitk.WriteImage(image, f"{job.folder}/input.nii.gz")
        return f"{job.folder}/input.nii.gz"

    def labelled(array):
        return lambda: {"bones": save(array, labels)}

    def scanned(array):
        return lambda: {"fraction": save(np.clip(np.rint(array), -1024, 3071).astype(np.int16), fraction)}

    def cut():
        sitk.WriteImage(fraction[:, :, 12 : fraction.GetSize()[2] - 12], f"{job.folder}/input.nii.gz")
        return {"fraction": f"{job.folder}/input.nii.gz"}

    larger = l.copy()
    for by in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        larger = np.where(larger == 0, np.roll(l, by, (1, 2)), larger)
    c4, c5 = value["vertebrae_C4"], value["vertebrae_C5"]
    rows = [
        ("as it is", dict),
        ("noise of 40 HU added to the fraction", scanned(f + np.random.default_rng(1).normal(0, 40, f.shape))),
        ("fraction's HU plus 40", scanned(f + 40)),
        ("fraction's HU times 1.1, plus 40", scanned(f * 1.1 + 40)),
        ("all labels one voxel larger in plane", labelled(larger)),
        ("all labels moved by two voxels in plane", labelled(np.roll(l, 2, 2))),
        ("no label for C4", labelled(np.where(l == c4, 0, l))),
        ("labels of C4 and C5 swapped", labelled(np.where(l == c4, c5, np.where(l == c5, c4, l)))),
        ("12 slices cut off the fraction at either end", cut),
    ]
    for name, change in rows:
        yield name, case, job.run(case, **change())


PARTS = {"ingredients": ingredients, "disturbed": disturbed}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("cases", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--case", default="moderate,spline")
    parser.add_argument("--part", default=",".join(PARTS))
    parser.add_argument("--threads", type=int, default=0)
    options = parser.parse_args()
    if not options.cases:
        parser.error("give CASES or set AVENTAIL_CASES")
    job = Job(options)
    for part in options.part.split(","):
        print("| | case | bones mean / worst, mm | soft tissue mean, mm | 95th, 99.5th | landmarks, mm "
              "| folded away from / in contact | points above 0.5 mm there and back, worst | time, s |")
        print("|---" * 9 + "|", flush=True)
        for name, case, cells in PARTS[part](job, options.case.split(",")):
            print(f"| {name} | {case} | " + " | ".join(cells) + " |", flush=True)
        print()
    shutil.rmtree(job.folder)


if __name__ == "__main__":
    main()
