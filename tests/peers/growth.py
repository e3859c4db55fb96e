#!/usr/bin/env python3
"""How does the time of `aventail register` grow with the patient's voxels and with the bones?

usage: growth.py AVENTAIL [--out DIR] [--repeat N]

Writes phantoms of several voxel sizes, registers each, and registers one of them with ever fewer of its bones labelled. Prints
both tables, with the exponent of a power law through them (1 is linear), and draws DIR/growth.png. Times are medians of N runs;
nothing else should be running.
"""
import argparse
import json
import os
import subprocess
import tempfile

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import SimpleITK as sitk

SPACINGS = (6.0, 4.5, 3.5, 2.75, 2.2)
BONES = (42, 32, 21, 10, 5)
AMONG = 3.5


def run(*command):
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def register(program, case, labels, out, repeat):
    """Median wall time of the whole, and of the propagation, s."""
    whole, carried = [], []
    for _ in range(repeat):
        run(program, "register", "-q", "--planning", f"{case}/planning_ct.nii.gz", *labels,
            "--fraction", f"{case}/fraction_ct.nii.gz", "--out", out)  # fmt: skip
        with open(f"{out}/report.json", encoding="utf-8") as file:
            stages = {s["stage"]: s["seconds"] for s in json.load(file)["stages"]}
        whole.append(sum(stages.values()))
        carried.append(stages["propagate to soft tissue"])
    return float(np.median(whole)), float(np.median(carried))


def exponent(x, y):
    return np.polyfit(np.log(x), np.log(y), 1)[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("--out", default="growth")
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    os.makedirs(args.out, exist_ok=True)
    voxels, bones = [], []
    with tempfile.TemporaryDirectory() as folder:
        for spacing in SPACINGS:
            case = f"{folder}/{spacing}"
            run(args.aventail, "phantom", "--spacing", "x".join([str(spacing)] * 3), "--out", case)
            body = np.count_nonzero(sitk.GetArrayFromImage(sitk.ReadImage(f"{case}/body.nii.gz")))
            times = register(args.aventail, case, ["--bones", f"{case}/bones.nii.gz"], f"{folder}/out", args.repeat)
            voxels.append((spacing, body, *times))
        case = f"{folder}/{AMONG}"
        run(args.aventail, "phantom", "--spacing", "x".join([str(AMONG)] * 3), "--out", case)
        labels = f"{case}/bones.nii.gz"
        found = subprocess.run([args.aventail, "inspect", labels, "--json"], check=True, capture_output=True).stdout
        present = dict(json.loads(found)["files"][0]["content"])["labels"]
        for count in BONES:
            image = sitk.ReadImage(labels)
            values = sitk.GetArrayFromImage(image)
            kept = sorted(present, key=lambda label: -label["voxels"])[:count]
            values[~np.isin(values, [label["label"] for label in kept])] = 0
            part = sitk.GetImageFromArray(values)
            part.CopyInformation(image)
            sitk.WriteImage(part, f"{folder}/part.nii.gz")
            with open(f"{folder}/part.json", "w", encoding="utf-8") as file:
                json.dump({"labels": {str(label["label"]): label["name"] for label in kept}}, file)
            part = ["--bones", f"{folder}/part.nii.gz", "--labels", f"{folder}/part.json"]
            times = register(args.aventail, case, part, f"{folder}/out", args.repeat)
            bones.append((count, *times))
    print("| voxels, mm | patient's voxels | register, s | propagation, s |\n|---|---|---|---|")
    for spacing, body, whole, carried in voxels:
        print(f"| {spacing} | {body:,} | {whole:.2f} | {carried:.2f} |")
    size = [v[1] for v in voxels]
    print(f"exponent {exponent(size, [v[2] for v in voxels]):.2f} {exponent(size, [v[3] for v in voxels]):.2f}\n")
    print("| bones | register, s | propagation, s |\n|---|---|---|")
    for count, whole, carried in bones:
        print(f"| {count} | {whole:.2f} | {carried:.2f} |")
    count = [b[0] for b in bones]
    print(f"exponent {exponent(count, [b[1] for b in bones]):.2f} {exponent(count, [b[2] for b in bones]):.2f}")
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
    for axes, x, rows, title in (
        (left, size, [v[2:] for v in voxels], "the patient's voxels"),
        (right, count, [b[1:] for b in bones], f"bones (phantom, {AMONG} mm)"),
    ):
        for n, name in enumerate(("register", "propagation")):
            axes.plot(x, [r[n] for r in rows], "o-", label=name)
        linear = np.array([min(x), max(x)])
        axes.plot(linear, rows[int(np.argmax(x))][0] * linear / max(x), ":", color="grey", label="linear")
        axes.set(xlabel=title, ylabel="wall time, s", xlim=(0, None), ylim=(0, None))
        axes.legend()
    figure.tight_layout()
    figure.savefig(f"{args.out}/growth.png", dpi=110)


if __name__ == "__main__":
    main()
