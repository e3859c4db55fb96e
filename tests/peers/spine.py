#!/usr/bin/env python3
"""Few vertebrae alone in view, as before a treatment of the spine: is the level right, or said to be unsure?

usage: spine.py AVENTAIL TRUNK OUT [--seeds N] [--vertebrae 5,4,3,2] [--circles 0,250,100,25]

AVENTAIL     the aventail program
TRUNK        folder as for trunk.py, whose posed scans (`bend`) are cut
OUT          gets the views and results
--seeds      poses, from seed 1 on
--vertebrae  each view reaches from the middle of a vertebra's upper neighbour to the middle of its lower one, so that so many are
             whole; from the top of the lumbar spine down, by turns
--circles    diameters, mm, about the vertebrae's middle, beyond which nothing is measured; 0: none

A level is right where each vertebra of which a third is in view lies nearest to its own true place among those of all vertebrae. A view
is told of by `weak-start` or `level-unsure`. A row for each view: vertebrae, circle, outcome, worst vertebra in mm.
"""
import argparse
import json
import sys

import numpy as np
import SimpleITK as sitk
from slabs import UNSEEN, refusal
from tools import Job, aventail
from trunk import SPINE, Trunk, make

TOLD = {"weak-start", "level-unsure"}
LUMBAR = [b for b in SPINE if b.startswith("vertebrae_L") or b.startswith("vertebrae_T")]


def view(image, middles, names, circle):
    """The part of an image that shows these vertebrae whole and half of the next above and below."""
    order = list(middles)
    low, high = order.index(names[0]), order.index(names[-1])
    step = (middles[order[-1]][2] - middles[order[0]][2]) / (len(order) - 1)
    bottom, top = middles[names[0]][2] - step, middles[names[-1]][2] + step
    bottom = middles[order[low - 1]][2] if low else bottom
    top = middles[order[high + 1]][2] if high + 1 < len(order) else top
    spacing, origin = image.GetSpacing(), image.GetOrigin()
    first, last = (int(np.clip(round((z - origin[2]) / spacing[2]), 0, image.GetSize()[2])) for z in (bottom, top))
    image = image[:, :, first:last]
    if circle:
        values = sitk.GetArrayFromImage(image)
        at = np.mean([middles[n][:2] for n in names], axis=0)
        y, x = np.indices(values.shape[1:])
        far = np.hypot(x * spacing[0] + origin[0] - at[0], y * spacing[1] + origin[1] - at[1]) > circle / 2
        values[:, far] = UNSEEN
        cut = sitk.GetImageFromArray(values)
        cut.CopyInformation(image)
        image = cut
    return image


def judge(out, trunk, middles):
    """Outcome and worst vertebra of a finished run."""
    with open(f"{out}/report.json", encoding="utf-8") as file:
        report = json.load(file)
    with open(f"{out}/bone_transforms.json", encoding="utf-8") as file:
        motions = json.load(file)
    told = TOLD & {w["code"] for w in report["warnings"]}
    worst, wrong, seen = 0.0, False, 0
    for bone in report["bones"]:
        if bone["name"] not in middles or bone["visible"] < 0.3 or bone["determined_by"] != "image":
            continue
        seen += 1
        centre = np.r_[trunk.points(bone["name"]).mean(0), 1.0]
        found = (np.array(motions[bone["name"]]) @ centre)[:3]
        away = {name: np.linalg.norm(found - middle) for name, middle in middles.items()}
        worst = max(worst, away[bone["name"]])
        wrong |= min(away, key=away.get) != bone["name"]
    kind = "none found" if not seen else "wrong level" if wrong else "right"
    return kind + (", told" if told else ""), worst


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aventail")
    parser.add_argument("trunk")
    parser.add_argument("out")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--vertebrae", default="5,4,3,2")
    parser.add_argument("--circles", default="0,250,100,25")
    given = parser.parse_args()
    trunk = Trunk(given.trunk)
    print("| seed | vertebrae | circle, mm | outcome | worst vertebra, mm |\n|---|---|---|---|---|", flush=True)
    counts = {}
    for seed in range(1, given.seeds + 1):
        case = f"{given.out}/seed-{seed}"
        at, _, _ = make(trunk, "bend", seed, case)
        middles = {n: (at[n] @ np.r_[trunk.points(n).mean(0), 1.0])[:3] for n in SPINE}
        image = sitk.ReadImage(f"{case}/fraction_ct.nii.gz")
        for turn, number in enumerate(map(int, given.vertebrae.split(","))):
            first = (turn + seed) % (len(LUMBAR) - number + 1)
            names = LUMBAR[first : first + number]
            for circle in map(float, given.circles.split(",")):
                part, out = f"{case}/view.nii.gz", f"{case}/{number}-{circle:.0f}"
                sitk.WriteImage(view(image, middles, names, circle), part)
                job = Job(given.aventail, f"{given.trunk}/ct.nii.gz", part, f"{given.trunk}/totalsegmentator.nii.gz", None, out=out)
                try:
                    aventail(job, ["--no-view"])
                    outcome, worst = judge(out, trunk, middles)
                except RuntimeError as error:
                    outcome, worst = "refused: " + refusal(error), float("nan")
                counts[outcome] = counts.get(outcome, 0) + 1
                shown = f"{names[-1].removeprefix('vertebrae_')}-{names[0].removeprefix('vertebrae_')}"
                print(f"| {seed} | {shown} | {circle:.0f} | {outcome} | {worst:.2f} |", flush=True)
    print("\n" + ", ".join(f"{outcome} {n}" for outcome, n in sorted(counts.items())))
    return 1 if "wrong level" in counts else 0


if __name__ == "__main__":
    sys.exit(main())
