#!/usr/bin/env python3
"""aventail beside image-driven tools on one case, in one run: time and error of each.

usage: side_by_side.py AVENTAIL [CASES] [--case NAME] [--mr FILE] [--out DIR] [--tools TOOL,TOOL]

TOOL is aventail, fast, plastimatch, elastix, greedy, or one that is told of the planning bones, as structures guide
image-driven registration in clinics: plastimatch-bones (the bones, 3 mm around them included, are registered before
the rest) and elastix-bones (its rigidity penalty on them); or deeds. The first five by default.

AVENTAIL  the aventail program
CASES     folder with planning_ct.nii.gz, bones.nii.gz, bones.json, NAME/fraction_ct.nii.gz and NAME/truth_points.csv.gz
          (x, y, z of planning in LPS mm, the true displacement, 0 or the bone's label); default: AVENTAIL_CASES
--mr      an MR with the case's truth, registered in place of the fraction CT; greedy then compares by NMI

Planning is fixed, the fraction moving, so that each field takes planning points to the fraction. Every tool gets the patient's
mask in planning, that aventail finds, and all threads; its settings are those that a careful user would take, the same for all
cases. The time is the wall time of the program with its files. Errors are at the true points: soft tissue, and the mean of
each bone's. A tool that is not installed is skipped and named. The table goes to the terminal.
"""
import argparse
import gzip
import os
import shutil
import tempfile
import time

import numpy as np
from fields import Field
from tools import MORE, TOOLS, WITH_BONES, Job, aventail, installed


def true_points(case):
    """Rows of x, y, z, true displacement, label of a case's folder."""
    with gzip.open(f"{case}/truth_points.csv.gz", "rt") as file:
        next(file)
        return np.loadtxt(file, delimiter=",")


def errors(field, truth):
    """Error at each true point, mm."""
    return np.linalg.norm(Field(field).at(truth[:, :3]) - truth[:, 3:6], axis=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("cases", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--case", default="moderate")
    parser.add_argument("--mr")
    parser.add_argument("--out")
    parser.add_argument("--tools", default=",".join(TOOLS))
    given = parser.parse_args()
    if not given.cases:
        parser.error("give CASES or set AVENTAIL_CASES")
    folder = given.out or tempfile.mkdtemp(prefix="side-by-side-")
    case = f"{given.cases}/{given.case}"
    planning, bones, names = (f"{given.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json"))
    fraction = given.mr or f"{case}/fraction_ct.nii.gz"
    job = Job(given.aventail, planning, fraction, bones, names, out=f"{folder}/mask", is_mr=bool(given.mr))
    truth = true_points(case)
    bone = truth[:, 6]
    os.makedirs(job.out, exist_ok=True)
    aventail(job, ["--speed", "fast"])
    job.mask = f"{job.out}/body.nii.gz"
    print("| tool | time, s | soft tissue mean, mm | 95th | 99.5th | bones mean / worst, mm | time, ratio | error, ratio |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    first = None
    for tool in given.tools.split(","):
        if not installed(tool):
            print(f"| {tool} | not installed | | | | | | |", flush=True)
            continue
        job.out = f"{folder}/{tool}"
        os.makedirs(job.out, exist_ok=True)
        start = time.monotonic()
        field = {**TOOLS, **WITH_BONES, **MORE}[tool](job)
        seconds = time.monotonic() - start
        error = errors(field, truth)
        soft = error[bone == 0]
        bones = [error[bone == b].mean() for b in np.unique(bone[bone > 0])]
        first = first or (seconds, soft.mean())
        print(
            f"| {tool} | {seconds:.1f} | {soft.mean():.2f} | {np.percentile(soft, 95):.2f} | {np.percentile(soft, 99.5):.1f} "
            f"| {np.mean(bones):.2f} / {max(bones):.2f} | {seconds / first[0]:.1f} | {soft.mean() / first[1]:.1f} |",
            flush=True,
        )
    if not given.out:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
