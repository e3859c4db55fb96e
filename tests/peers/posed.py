#!/usr/bin/env python3
"""Posed cases with known truth: errors, folds, there and back, and what the map of uncertainty is worth.

usage: posed.py AVENTAIL [CASES] [--case NAME,NAME] [--fraction FILE] [--circle X,Y,RADIUS] [--config FILE] [--threads N]
                [--tools TOOL,TOOL] [--affine]

AVENTAIL    the aventail program
CASES       folder with planning_ct.nii.gz, bones.nii.gz, bones.json and a folder NAME per case with the fraction, landmarks.csv
            and truth_points.csv.gz (x, y, z of planning in LPS mm, the true displacement, 0 or the bone's label);
            default: AVENTAIL_CASES
--fraction  its name in the case's folder (default: fraction_ct.nii.gz; cbct.nii.gz for a cone-beam CT)
--circle    of a cone-beam CT that shows only this circle, mm from its origin: soft tissue in it and out of it apart
--config    settings, for a stage off or another value
--tools     beside aventail, which always runs first: other tools (tools.py has their settings), or none for before registration;
            their folds are those that `aventail evaluate` finds
--affine    the other tools begin with an affine step

Errors are at the true points, mm: the mean of each bone that the image shows (mean, worst and number: of all, and of those with
200 points), of those that follow their joints; soft tissue (95th, 99.5th percentile). Folds are cells away from contact of
bones. Of the map of uncertainty u: Spearman's correlation with the error of soft tissue, errors below u, 2u and 3u in %, and
how many of those above 1 mm its highest tenth holds. The table goes to the terminal, row by row.
"""
import argparse
import json
import os
import subprocess
import tempfile

import numpy as np
from fields import Field, Image, read_landmarks
from measures import target_errors
from scipy import stats
from side_by_side import errors, true_points
from tools import TOOLS, Job, aventail, installed

COLUMNS = ["case", "tool", "bones", "of 200 points", "by joints", "soft tissue", "in the circle", "out of it", "landmarks", "folds",
           "there and back: mean, worst", "Spearman", "below u, 2u, 3u", "above 1 mm in the highest tenth"]  # fmt: skip


def both(values):
    """Mean, greatest, and of how many."""
    return f"{np.mean(values):.2f} / {max(values):.2f} ({len(values)})" if values else ""


def spread(error):
    return f"{error.mean():.2f} ({np.percentile(error, 95):.1f}, {np.percentile(error, 99.5):.1f})" if len(error) else ""


def worth(u, error):
    """Cells of what the map says of an error."""
    high = u > np.quantile(u, 0.9)
    below = ", ".join(f"{100 * (error < k * u).mean():.0f}" for k in (1, 2, 3))
    return [f"{stats.spearmanr(u, error)[0]:.2f}", below, f"{100 * ((error > 1) & high).sum() / (error > 1).sum():.0f}"]


class Case:
    """A case's files, and the run of aventail, by which the other tools are measured too."""

    def __init__(self, given, name, folder):
        self.given, self.name, self.folder = given, name, folder
        self.home = f"{given.cases}/{name}"
        planning, bones, self.labels = (f"{given.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json"))
        fraction = f"{self.home}/{given.fraction}"
        self.job = Job(given.aventail, planning, fraction, bones, self.labels, threads=given.threads, affine=given.affine)
        self.points = f"{self.home}/landmarks.csv"
        self.truth = true_points(self.home)
        self.shown = None

    def outputs(self, tool):
        self.job.out = f"{self.folder}/{tool}"
        os.makedirs(self.job.out, exist_ok=True)
        return self.job.out

    def report(self):
        with open(f"{self.folder}/aventail/report.json", encoding="utf-8") as file:
            return json.load(file)

    def aventail(self):
        """Its row."""
        out, given = self.outputs("aventail"), self.given
        more = ["--no-view", "--landmarks", self.points] + (["--config", given.config] if given.config else [])
        field = aventail(self.job, more)
        self.job.mask = f"{out}/body.nii.gz"
        report = self.report()
        with open(self.labels, encoding="utf-8") as file:
            number = {name: int(label) for label, name in json.load(file)["labels"].items()}
        self.shown = [number[b["name"]] for b in report["bones"] if b["determined_by"] == "image"]
        back = report["consistency"]["there_and_back_mm"]
        error = errors(field, self.truth)
        soft = self.truth[:, 6] == 0
        each = [mark["after"] for mark in report["landmarks"]["each"]]
        worth_of = worth(Image(f"{out}/uncertainty.nii.gz").at(self.truth[soft, :3]), error[soft])
        return self.cells("aventail", error, each, report["landmarks"]["before"]["mean"], report["jacobian"]) + [
            f"{back['mean']:.3f}, {back['max']:.2f}", *worth_of
        ]  # fmt: skip

    def other(self, tool):
        """The row of another tool, or of no registration."""
        before = self.report()["landmarks"]["before"]["mean"]
        if tool == "none":
            each = [mark["before"] for mark in self.report()["landmarks"]["each"]]
            return self.cells(tool, np.linalg.norm(self.truth[:, 3:6], axis=1), each, before, None)
        if not installed(tool):
            return [self.name, tool, "not installed"]
        out = self.outputs(tool)
        field = TOOLS[tool](self.job)
        judged = ["--planning", self.job.fixed, "--bones", self.job.bones, "--labels", self.labels, "--threads", str(self.given.threads)]
        command = [self.given.aventail, "evaluate", "-q", "--planning-to-fraction", field, *judged, "--out", f"{out}/evaluation"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with open(f"{out}/evaluation/evaluation.json", encoding="utf-8") as file:
            regularity = json.load(file)["fields"][0]["assessment"]["regularity"][0][1]
        each = target_errors(Field(field), *read_landmarks(self.points))
        return self.cells(tool, errors(field, self.truth), each, before, regularity["jacobian"])

    def cells(self, tool, error, each, before, jacobian):
        label = self.truth[:, 6]
        soft = label == 0
        points = {b: error[label == b] for b in np.unique(label[~soft])}
        circle = ["", ""]
        if self.given.circle:
            x, y, radius = self.given.circle
            at = (self.truth[:, :3] + self.truth[:, 3:6] - Image(self.job.moving).origin)[:, :2]
            inside = np.hypot(at[:, 0] - x, at[:, 1] - y) < radius
            circle = [spread(error[soft & inside]), spread(error[soft & ~inside])]
        return [
            self.name,
            tool,
            both([e.mean() for b, e in points.items() if b in self.shown]),
            both([e.mean() for b, e in points.items() if b in self.shown and len(e) >= 200]),
            both([e.mean() for b, e in points.items() if b not in self.shown]),
            spread(error[soft]),
            *circle,
            f"{before:.2f} -> {np.mean(each):.2f}, {max(each):.1f}",
            str(jacobian["body"]["folded"]) if jacobian else "",
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
    parser.add_argument("--tools", default="aventail")
    parser.add_argument("--affine", action="store_true")
    given = parser.parse_args()
    if not given.cases:
        parser.error("give CASES or set AVENTAIL_CASES")
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    for name in given.case.split(","):
        with tempfile.TemporaryDirectory(prefix="posed-") as folder:
            case = Case(given, name, folder)
            print("| " + " | ".join(case.aventail()) + " |", flush=True)
            for tool in given.tools.split(","):
                if tool != "aventail":
                    print("| " + " | ".join(case.other(tool)) + " |", flush=True)


if __name__ == "__main__":
    main()
