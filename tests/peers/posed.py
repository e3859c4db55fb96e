#!/usr/bin/env python3
"""Posed cases with known truth: errors, folds, there and back, and what the map of uncertainty is worth.

usage: posed.py AVENTAIL [CASES] [--case NAME,NAME] [--fraction FILE] [--circle X,Y,RADIUS] [--config FILE] [--threads N]

AVENTAIL    the aventail program
CASES       folder with planning_ct.nii.gz, bones.nii.gz, bones.json and a folder NAME per case with the fraction, landmarks.csv
            and truth_points.csv.gz (x, y, z of planning in LPS mm, the true displacement, 0 or the bone's label);
            default: AVENTAIL_CASES
--fraction  its name in the case's folder (default: fraction_ct.nii.gz; cbct.nii.gz for a cone-beam CT)
--circle    of a cone-beam CT that shows only this circle, mm from its origin: soft tissue in it and out of it apart
--config    settings, for a stage off or another value

Errors are at the true points, mm: the mean of each bone that the image shows (of all, and of those with 200 points), of those
that follow their joints; soft tissue (95th, 99.5th percentile). Folds are cells away from contact of bones. Of the map of
uncertainty u: Spearman's correlation with the error of soft tissue, errors below u, 2u and 3u in %, and how many of those above
1 mm its highest tenth holds. The table goes to the terminal, row by row.
"""
import argparse
import json
import os
import tempfile

import numpy as np
from fields import Image
from scipy import stats
from side_by_side import errors, true_points
from tools import Job, aventail

COLUMNS = ["case", "bones", "of 200 points", "by joints", "soft tissue", "in the circle", "out of it", "landmarks", "folds",
           "there and back: mean, worst", "Spearman", "below u, 2u, 3u", "above 1 mm in the highest tenth"]  # fmt: skip


def both(values):
    return f"{np.mean(values):.2f} / {max(values):.2f}" if values else ""


def spread(error):
    return f"{error.mean():.2f} ({np.percentile(error, 95):.1f}, {np.percentile(error, 99.5):.1f})" if len(error) else ""


def worth(u, error):
    """Cells of what the map says of an error."""
    high = u > np.quantile(u, 0.9)
    below = ", ".join(f"{100 * (error < k * u).mean():.0f}" for k in (1, 2, 3))
    return [f"{stats.spearmanr(u, error)[0]:.2f}", below, f"{100 * ((error > 1) & high).sum() / (error > 1).sum():.0f}"]


def row(given, name, out):
    case = f"{given.cases}/{name}"
    planning, bones, labels = (f"{given.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json"))
    job = Job(given.aventail, planning, f"{case}/{given.fraction}", bones, labels, out=out, threads=given.threads)
    more = ["--no-view", "--landmarks", f"{case}/landmarks.csv"] + (["--config", given.config] if given.config else [])
    field = aventail(job, more)
    with open(f"{out}/report.json", encoding="utf-8") as file:
        report = json.load(file)
    with open(labels, encoding="utf-8") as file:
        number = {name: int(label) for label, name in json.load(file)["labels"].items()}
    truth = true_points(case)
    error, label = errors(field, truth), truth[:, 6]
    soft = label == 0
    shown = [number[b["name"]] for b in report["bones"] if b["determined_by"] == "image"]
    points = {b: error[label == b] for b in np.unique(label[~soft])}
    circle = ["", ""]
    if given.circle:
        x, y, radius = given.circle
        at = (truth[:, :3] + truth[:, 3:6] - Image(f"{case}/{given.fraction}").origin)[:, :2]
        inside = np.hypot(at[:, 0] - x, at[:, 1] - y) < radius
        circle = [spread(error[soft & inside]), spread(error[soft & ~inside])]
    each = [mark["after"] for mark in report["landmarks"]["each"]]
    back = report["consistency"]["there_and_back_mm"]
    return [
        name,
        both([e.mean() for b, e in points.items() if b in shown]),
        both([e.mean() for b, e in points.items() if b in shown and len(e) >= 200]),
        both([e.mean() for b, e in points.items() if b not in shown]),
        spread(error[soft]),
        *circle,
        f"{report['landmarks']['before']['mean']:.2f} -> {np.mean(each):.2f}, {max(each):.1f}",
        str(report["jacobian"]["body"]["folded"]),
        f"{back['mean']:.3f}, {back['max']:.2f}",
        *worth(Image(f"{out}/uncertainty.nii.gz").at(truth[soft, :3]), error[soft]),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("cases", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--case", default="small,moderate,change,spline")
    parser.add_argument("--fraction", default="fraction_ct.nii.gz")
    parser.add_argument("--circle", type=lambda text: [float(value) for value in text.split(",")])
    parser.add_argument("--config")
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    if not given.cases:
        parser.error("give CASES or set AVENTAIL_CASES")
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    for name in given.case.split(","):
        with tempfile.TemporaryDirectory(prefix="posed-") as folder:
            print("| " + " | ".join(row(given, name, f"{folder}/out")) + " |", flush=True)


if __name__ == "__main__":
    main()
