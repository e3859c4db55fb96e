#!/usr/bin/env python3
"""Target registration error on public sets that everybody must fetch himself: a table of yours, aventail beside other tools.

usage: public.py AVENTAIL LAYOUT --fixed IMAGE POINTS --moving IMAGE POINTS [--size X Y Z --spacing X Y Z] [--bones FILE] [...]
       public.py AVENTAIL self-test

AVENTAIL     the aventail program
LAYOUT       dirlab: raw int16 images (.img, little endian; --size and --spacing of DIR-Lab's table) and texts of three
             voxel indices a line, counted from 1
             popi: images with a header (.mhd), texts of three mm a line in the image's own frame, LPS
             learn2reg: NIfTI, and CSV files of three voxel indices a line, counted from 0
--fixed, --moving   the planning side and the other: its image and its points
--points     one-based, zero-based or mm, where the points are not as the layout has them
--axes       where the axes of a raw image lead: L or R, P or A, S or I (default LPS)
--hu-offset  what is added to stored values to give HU (default: -1024 for dirlab, else 0)
--bones      labels of bones in the fixed image, on its grid (a raw int16 file for dirlab), with --labels for their names; or
             auto (TotalSegmentator). Without them aventail is left out
--snap       mapped points go to the nearest voxel centre of the moving image first, as in DIR-Lab's tables
--affine     the other tools begin with an affine step (breathing)
--out        folder of runs and results (default: public); runs that are finished there are kept
--tools, --threads   as for repeat.py

The field takes fixed points to the moving image. The table has the error in mm before and after: mean, standard deviation
(n - 1), median, 95th percentile, greatest. It goes to the terminal and OUT/public.md, the errors point by point to OUT/public.json.
The self-test writes aventail's phantom in the three layouts and compares the errors with those that aventail itself tells of the
phantom's own files; exit code 1 when they differ by 0.02 mm.
"""
import argparse
import json
import os
import re
import subprocess
import sys
import tempfile

import measures
import numpy as np
import SimpleITK as sitk
from fields import Field, Image, read_landmarks
from runs import NEED_BONES, Runs
from tools import installed

POINTS = {"dirlab": "one-based", "popi": "mm", "learn2reg": "zero-based"}
OFFSET = {"dirlab": -1024}
# Directions of LPS by letter.
AXES = {"L": (0, 1), "R": (0, -1), "P": (1, 1), "A": (1, -1), "S": (2, 1), "I": (2, -1)}
LEAST, MOST = -1024, 3071
# Difference of an error that the self-test allows, mm.
SAME = 0.02


class Still:
    """No registration."""

    def map(self, points):
        return points


def read_raw(file, size, spacing, axes):
    """A raw int16 image, x fastest, its first voxel at the origin."""
    values = np.fromfile(file, dtype="<i2")
    if values.size != np.prod(size):
        sys.exit(f"{file}: {values.size} voxels, but {' x '.join(map(str, size))} = {np.prod(size)} were told: wrong --size?")
    image = sitk.GetImageFromArray(values.reshape(size[::-1]))
    direction = np.zeros((3, 3))
    for column, letter in enumerate(axes):
        row, sign = AXES[letter]
        direction[row, column] = sign
    if abs(np.linalg.det(direction)) != 1:
        sys.exit(f"--axes {axes}: one letter each of L or R, P or A, S or I")
    image.SetSpacing([float(s) for s in spacing])
    image.SetDirection(direction.ravel().tolist())
    return image


def read_image(file, given):
    return read_raw(file, given.size, given.spacing, given.axes) if file.endswith(".img") else sitk.ReadImage(file)


def read_points(file):
    """Three numbers a line, by blanks or commas; lines without numbers are headings."""
    rows = []
    with open(file, encoding="utf-8-sig") as text:
        for line in text:
            cells = [c for c in re.split(r"[\s,;]+", line.strip()) if c]
            try:
                rows.append([float(c) for c in cells])
            except ValueError:
                continue
    rows = [r for r in rows if r]
    if not rows or any(len(r) != 3 for r in rows):
        sys.exit(f"{file}: not three numbers in every line")
    return np.array(rows)


def placed(points, image, unit, file):
    """Points in LPS mm."""
    grid = Image(image)
    found = points if unit == "mm" else grid.world(points - (unit == "one-based"))
    outside = np.any((grid.index(found) < -0.5) | (grid.index(found) > np.array(grid.size) - 0.5), axis=1)
    if outside.any():
        sys.exit(f"{file}: {outside.sum()} of {len(found)} points lie outside of their image, the first {points[outside][0]}: wrong --points?")
    return found


def prepare(given):
    """Writes both images as NIfTI in HU; their files and the points of both, LPS mm."""
    unit, offset = given.points or POINTS[given.layout], given.hu_offset
    offset = OFFSET.get(given.layout, 0) if offset is None else offset
    files, points = {}, {}
    for side, (image_file, point_file) in (("planning", given.fixed), ("fraction", given.moving)):
        image = read_image(image_file, given)
        hu = sitk.Clamp(sitk.Cast(image, sitk.sitkFloat32) + float(offset), lowerBound=LEAST, upperBound=MOST)
        darkest = np.percentile(sitk.GetArrayViewFromImage(hu), 1)
        if darkest > -700:
            sys.exit(f"{image_file}: the darkest values are {darkest:.0f} HU, which is no air: give --hu-offset")
        files[side] = f"{given.out}/{side}.nii.gz"
        sitk.WriteImage(sitk.Cast(hu, sitk.sitkInt16), files[side])
        points[side] = placed(read_points(point_file), image, unit, point_file)
    if len(points["planning"]) != len(points["fraction"]):
        sys.exit(f"{len(points['planning'])} fixed points, {len(points['fraction'])} moving ones")
    bones = given.bones
    if bones and bones.endswith(".img"):
        bones = f"{given.out}/bones.nii.gz"
        sitk.WriteImage(read_image(given.bones, given), bones)
    return files, bones, points


def measure(given):
    """Rows of the table."""
    os.makedirs(given.out, exist_ok=True)
    files, bones, points = prepare(given)
    runs = Runs(given.aventail, files, bones, given.labels, given.out, given.threads, given.affine)
    snap = Image(files["fraction"]) if given.snap else None
    rows = {"before": {"errors": measures.target_errors(Still(), points["planning"], points["fraction"]).tolist()}}
    for tool in given.tools.split(","):
        if not installed(tool):
            rows[tool] = {"failed": "not installed"}
        elif tool in NEED_BONES and not bones:
            rows[tool] = {"failed": "needs --bones"}
        else:
            rows[tool] = runs.run(tool, "planning", "fraction")
            if "failed" not in rows[tool]:
                field = Field(f"{given.out}/{rows[tool]['field']}")
                rows[tool]["errors"] = measures.target_errors(field, points["planning"], points["fraction"], snap).tolist()
    return rows


def table(rows):
    lines = ["| tool | points | mean, mm | sd | median | 95th | greatest | processor s |", "|---" * 8 + "|"]
    for tool, row in rows.items():
        if "failed" in row:
            lines += [f"| {tool} | {row['failed'].strip().splitlines()[-1]} |" + " |" * 6]
            continue
        e = np.array(row["errors"])
        lines += [f"| {tool} | {len(e)} | {e.mean():.2f} | {e.std(ddof=1):.2f} | {np.median(e):.2f} | {np.percentile(e, 95):.2f} | "
                  f"{e.max():.2f} | {row.get('processor_s', '')} |"]  # fmt: skip
    return "\n".join(lines) + "\n"


def output(command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def write_layout(layout, folder, side, image, points):
    """Image and points (LPS mm) of one side as files of a layout; the files, and the points as the layout can hold them."""
    grid = Image(image)
    index = grid.index(points)
    image = sitk.Image(image)
    for key in image.GetMetaDataKeys():
        image.EraseMetaData(key)
    if layout == "dirlab":
        files, index = [f"{folder}/{side}.img", f"{folder}/{side}_xyz.txt"], np.round(index)
        (grid.values.astype("<i2") + np.int16(1024)).ravel("F").tofile(files[0])
        np.savetxt(files[1], index + 1, fmt="%d", delimiter="\t")
    elif layout == "popi":
        files = [f"{folder}/{side}.mhd", f"{folder}/{side}.txt"]
        sitk.WriteImage(image, files[0])
        np.savetxt(files[1], points, fmt="%.6f")
    else:
        files = [f"{folder}/{side}.nii.gz", f"{folder}/{side}.csv"]
        sitk.WriteImage(image, files[0])
        np.savetxt(files[1], index, fmt="%.6f", delimiter=",")
    return files, grid.world(index)


def self_test(aventail):
    """The phantom in every layout, against its own files and the points as `aventail warp` maps them; whether any differs."""
    bad = False
    with tempfile.TemporaryDirectory() as folder:
        own = f"{folder}/phantom"
        output([aventail, "phantom", "-q", "--spacing", "4x4x4", "--out", own])
        bones, names = sitk.ReadImage(f"{own}/bones.nii.gz"), f"{folder}/names.json"
        labels = json.loads(output([aventail, "inspect", "--json", f"{own}/bones.nii.gz"]))["files"][0]["content"]["labels"]
        with open(names, "w", encoding="utf-8") as file:
            json.dump({"labels": {str(x["label"]): x["name"] for x in labels}}, file)
        images = {side: sitk.ReadImage(f"{own}/{side}_ct.nii.gz") for side in ("planning", "fraction")}
        # Images of one size, as DIR-Lab's.
        more = [int(a - b) for a, b in zip(images["planning"].GetSize(), images["fraction"].GetSize())]
        images["fraction"] = sitk.ConstantPad(images["fraction"], [0, 0, 0], more, -1000)
        sitk.WriteImage(images["fraction"], f"{own}/fraction_ct.nii.gz")
        output([aventail, "register", "-q", "--planning", f"{own}/planning_ct.nii.gz", "--bones", f"{own}/bones.nii.gz",
                "--fraction", f"{own}/fraction_ct.nii.gz", "--out", f"{own}/out"])  # fmt: skip
        known = read_landmarks(f"{own}/landmarks.csv")
        for layout in POINTS:
            case = f"{folder}/{layout}"
            os.makedirs(case)
            fixed, planning = write_layout(layout, case, "fixed", images["planning"], known[0])
            moving, fraction = write_layout(layout, case, "moving", images["fraction"], known[1])
            options = ["--fixed", *fixed, "--moving", *moving, "--labels", names, "--out", f"{case}/out", "--tools", "aventail"]
            if layout == "dirlab":
                sitk.GetArrayFromImage(bones).astype("<i2").tofile(f"{case}/bones.img")
                numbers = [[str(v) for v in values] for values in (bones.GetSize(), bones.GetSpacing())]
                options += ["--bones", f"{case}/bones.img", "--size", *numbers[0], "--spacing", *numbers[1], "--snap"]
            else:
                options += ["--bones", f"{own}/bones.nii.gz"]
            rows = measure(arguments().parse_args([aventail, layout, *options]))
            np.savetxt(f"{case}/straight.csv", planning, header="x,y,z", comments="", fmt="%.6f", delimiter=",")
            output([aventail, "warp", "--field", f"{own}/out/planning_to_fraction.nii.gz", "--from", "planning", "--to", "fraction",
                    "--input", f"{case}/straight.csv", "--out", f"{case}/mapped.csv"])  # fmt: skip
            mapped, between = np.loadtxt(f"{case}/mapped.csv", skiprows=1, delimiter=","), planning - fraction
            if layout == "dirlab":
                origin, spacing = np.array(images["fraction"].GetOrigin()), np.array(images["fraction"].GetSpacing())
                mapped = np.round((mapped - origin) / spacing) * spacing + origin
                # Raw images have lost their origins.
                between -= np.array(images["planning"].GetOrigin()) - origin
            straight = {"before": np.linalg.norm(between, axis=1), "aventail": np.linalg.norm(mapped - fraction, axis=1)}
            print(f"{layout}: {len(planning)} points")
            for row, expected in straight.items():
                if "errors" not in rows[row]:
                    print(f"  {row}: {rows[row]['failed']}")
                    bad = True
                    continue
                found = np.array(rows[row]["errors"])
                off = np.abs(found - expected).max()
                print(f"  {row:9} mean {found.mean():.4f} mm, straight {expected.mean():.4f}, greatest difference {off:.4f}")
                bad |= not off < SAME
    return bad


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aventail")
    parser.add_argument("layout", choices=[*POINTS, "self-test"])
    parser.add_argument("--fixed", nargs=2)
    parser.add_argument("--moving", nargs=2)
    parser.add_argument("--size", nargs=3, type=int)
    parser.add_argument("--spacing", nargs=3, type=float)
    parser.add_argument("--axes", default="LPS")
    parser.add_argument("--points", choices=sorted(set(POINTS.values())))
    parser.add_argument("--hu-offset", type=float)
    parser.add_argument("--bones")
    parser.add_argument("--labels")
    parser.add_argument("--snap", action="store_true")
    parser.add_argument("--affine", action="store_true")
    parser.add_argument("--out", default="public")
    parser.add_argument("--tools", default="aventail,plastimatch,elastix,greedy")
    parser.add_argument("--threads", type=int, default=0)
    return parser


def main():
    parser = arguments()
    given = parser.parse_args()
    if given.layout == "self-test":
        return 1 if self_test(given.aventail) else 0
    if not given.fixed or not given.moving:
        parser.error("give --fixed IMAGE POINTS and --moving IMAGE POINTS")
    if any(file.endswith(".img") for file in (given.fixed[0], given.moving[0])) and not (given.size and given.spacing):
        parser.error("a raw image needs --size and --spacing")
    rows = measure(given)
    with open(f"{given.out}/public.json", "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)
    text = table(rows)
    with open(f"{given.out}/public.md", "w", encoding="utf-8") as file:
        file.write(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
