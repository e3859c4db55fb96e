#!/usr/bin/env python3
"""Short and narrow views of cone-beam CTs, posed with known truth: are the bones found, and what is refused?

usage: slabs.py AVENTAIL CASES CONE_BEAMS [--case NAME,NAME] [--slab LOW-HIGH,...] [--circle MM,...] [--random N] [--seed N] [--limit MM] [--threads N]

AVENTAIL    the aventail program
CASES       folder as for posed.py
CONE_BEAMS  folder with the cone-beam CT of each case, NAME.nii.gz; without it CASES/NAME/cbct.nii.gz is taken
--slab      shares of the scan's height (default: 0-0.5,0.25-0.75,0.5-1,0.15-0.5,0.4-0.75)
--circle    diameters about the middle of the view beyond which nothing is measured, each slab with each; 0: none (default)
--random    instead: this many slabs of 36 to 90 mm, each in a circle of 100 to 250 mm about the middle of the view, the cases in
            turn; --seed draws others
--limit     mean error, mm, beyond which a bone that is more than half in view is wrong (default 3)

A true point is in view where the slab was measured (not -1000 over most of its slices). Errors in mm; beyond: share of the
points, in view and out of it, whose error is above 3 u + 0.5 mm by the map of uncertainty, in % of what the map knows. Time is
wall time with files. A row for each slab goes to the terminal, a summary at the end: right, wrong, refused, and the worst bone of
those that are right.
"""
import argparse
import json
import re
import tempfile
import time
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from fields import Image, like
from posed import both, spread
from scipy import ndimage
from side_by_side import errors, true_points
from tools import Job, aventail

UNSEEN = -1000
COLUMNS = ["case", "slab", "bones in view", "out of view", "soft tissue in view", "out of view", "beyond, in view, out of it", "s",
           "warnings"]  # fmt: skip
# Of a random slab: height and circle, mm.
HEIGHT, CIRCLE = (36.0, 90.0), (100.0, 250.0)
# Exit codes of aventail for inputs that do not fit and registrations that fail.
REFUSED = re.compile(r"exit [46]\n")


def cut(image, low, high, circle=None):
    """Slices between two shares of the height; beyond a circle (diameter, mm) about the view's middle nothing is measured."""
    slices = image.GetSize()[2]
    image = image[:, :, round(low * slices) : round(high * slices)]
    if circle:
        found = Image(image)
        seen = measured(found.values)
        x, y = np.indices(seen.shape)
        far = np.hypot((x - x[seen].mean()) * found.spacing[0], (y - y[seen].mean()) * found.spacing[1]) > circle / 2
        found.values[far] = UNSEEN
        image = like(image, found.values)
    return image


def measured(values):
    """Columns of an image that its detector saw."""
    return (values != UNSEEN).mean(2) > 0.3


def drawn(number, seed, heights):
    """Random slabs: shares of the height, and the circle; heights of the scans in mm, case by case."""
    draw, cases = np.random.default_rng(seed), list(heights)
    for n in range(number):
        case = cases[n % len(cases)]
        share = min(1.0, draw.uniform(*HEIGHT) / heights[case])
        low = draw.uniform(0, 1 - share)
        yield case, low, low + share, draw.uniform(*CIRCLE)


def score(case, out, slab):
    """Cells of a finished run, and the mean error of each bone in view."""
    truth = true_points(case)
    error, label = errors(f"{out}/planning_to_fraction.nii.gz", truth), truth[:, 6]
    view = Image(slab)
    seen = ndimage.binary_closing(measured(view.values), iterations=3)
    view.values = np.repeat(seen[:, :, None], view.size[2], 2).astype(float)
    inside = view.at(truth[:, :3] + truth[:, 3:6], order=0, outside=0.0) > 0.5
    bones = [(error[label == b].mean(), inside[label == b].mean() > 0.5) for b in np.unique(label[label > 0])]
    parts = [[e for e, here in bones if here == where] for where in (True, False)]
    u = Image(f"{out}/uncertainty.nii.gz").at(truth[:, :3], order=0, outside=-1.0)
    beyond = []
    for place in (inside, ~inside):
        known = place & (u >= 0)
        beyond += [f"{100 * (error[known] > 3 * u[known] + 0.5).mean():.2f}" if known.any() else "-"]
    soft = [spread(error[(label == 0) & place]) for place in (inside, ~inside)]
    return [*map(both, parts), *soft, ", ".join(beyond)], parts[0]


def refusal(error):
    """The finding's name, or the last line, of a refused run; any other failure is raised."""
    text = str(error)
    if not REFUSED.search(text):
        raise error
    named = re.search(r"\[([a-z-]+)\]", text)
    return named.group(1) if named else text.strip().splitlines()[-1]


def register(given, name, image, low, high, circle, folder):
    """Row of a slab, the worst mean error of its bones in view, and whether it was refused."""
    slab, out = f"{folder}/slab.nii.gz", f"{folder}/out"
    part = cut(image, low, high, circle)
    sitk.WriteImage(part, slab, True)
    height = part.GetSize()[2] * part.GetSpacing()[2]
    cells = [name, f"{low:.2f}-{high:.2f}, {height:.0f} mm" + (f", circle {circle:.0f} mm" if circle else "")]
    planning, bones, labels = (f"{given.cases}/{n}" for n in ("planning_ct.nii.gz", "bones.nii.gz", "bones.json"))
    job = Job(given.aventail, planning, slab, bones, labels, out=out, threads=given.threads)
    start = time.monotonic()
    try:
        aventail(job, ["--no-view"])
    except RuntimeError as error:
        return [*cells, "refused: " + refusal(error), "", "", "", "", f"{time.monotonic() - start:.1f}", ""], None, True
    seconds = time.monotonic() - start
    with open(f"{out}/report.json", encoding="utf-8") as file:
        warnings = sorted({warning["code"] for warning in json.load(file)["warnings"]})
    scored, seen = score(f"{given.cases}/{name}", out, slab)
    return [*cells, *scored, f"{seconds:.1f}", ", ".join(warnings)], max(seen, default=None), False


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aventail")
    parser.add_argument("cases")
    parser.add_argument("cone_beams")
    parser.add_argument("--case", default="small,moderate,change,spline")
    parser.add_argument("--slab", default="0-0.5,0.25-0.75,0.5-1,0.15-0.5,0.4-0.75")
    parser.add_argument("--circle", default="0")
    parser.add_argument("--random", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=3.0)
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    images = {}
    for name in given.case.split(","):
        own = f"{given.cone_beams}/{name}.nii.gz"
        images[name] = sitk.ReadImage(own if Path(own).exists() else f"{given.cases}/{name}/cbct.nii.gz")
    if given.random:
        slabs = list(drawn(given.random, given.seed, {n: i.GetSize()[2] * i.GetSpacing()[2] for n, i in images.items()}))
    else:
        circles = [float(c) or None for c in given.circle.split(",")]
        shares = [tuple(map(float, slab.split("-"))) for slab in given.slab.split(",")]
        slabs = [(name, *share, circle) for name in images for share in shares for circle in circles]
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    worst, refused, blind = [], 0, 0
    for name, low, high, circle in slabs:
        with tempfile.TemporaryDirectory(prefix="slabs-") as folder:
            cells, greatest, no = register(given, name, images[name], low, high, circle, folder)
        print("| " + " | ".join(cells) + " |", flush=True)
        refused += no
        blind += greatest is None and not no
        worst += [greatest] if greatest is not None else []
    right = [e for e in worst if e <= given.limit]
    print(f"\n{len(slabs)} slabs: {len(right)} right (worst bone {max(right, default=0):.2f}), {len(worst) - len(right)} wrong, "
          f"{refused} refused" + (f", {blind} with no bone half in view" if blind else ""))


if __name__ == "__main__":
    main()
