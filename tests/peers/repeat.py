#!/usr/bin/env python3
"""Real scans of one patient, aventail beside other tools: what can be measured where nobody knows the truth.

usage: repeat.py AVENTAIL DIR [--out OUT] [--tools TOOL,TOOL] [--threads N]
       repeat.py AVENTAIL --scan FILE --scan FILE ... --bones FILE [--labels FILE] [--landmarks FILE] [...]

AVENTAIL     the aventail program
DIR          ct_1.nii.gz, ct_2.nii.gz, ... (any number), bones_1.nii.gz (labels of bones in the first) and bones.json (names)
--scan       instead of DIR: the scans one by one, the first the one that the bones are of
--landmarks  points known in the first two scans: planning_x, ..., fraction_z, LPS mm; no tool sees them
--out        folder of runs and results (default: repeat); runs that are finished there are kept
--tools      default: aventail,plastimatch,elastix,greedy (tools.py has their settings); what is not installed is named
--affine     the other tools begin with an affine step (a chest that breathes), not a rigid one
--no-air     the masks of the other tools are the patient without air (a lung)
--config     settings of aventail (TOML)
--leave-out  names of landmarks, with commas: errors also without them
--cut        names of bones, with commas: writes OUT/bones_cut.nii.gz, the labels without the voxels of these bones where greedy's
             field from the first scan to the second departs from the bone's rigid part by more than 1 mm. Give it as --bones
Other settings (--affine, --no-air, --config, --bones) need another OUT.

The first scan is registered to every other; of three or more every other also to every third, with the first's bones carried
by aventail's own field. The patient is what aventail finds in each scan. Measured in the first scan, lengths in mm:
  surface    distance of each bone's surface (350 HU), mapped, to the nearest surface of the other scan that faces the same way,
             along its normal; scan 2 against itself: the same scan on a grid half a voxel away (cubic)
  left       how far a rigid fit of one bone's surface would still move it: what the distance to the nearest surface hides
  bent       rms departure of each bone from rigid motion
  skin       distance of the skin (-350 HU) to the other scan's; positive: mapped outside of it
  agreement  local correlation of soft tissue in cubes of 20 mm, where the first scan varies by 15 HU
  came, went tissue (above -200 HU) where the first scan has air (below -500 HU) after registration, and the other way, ml;
             inside the patient (airway, mouth) and within 5 mm of the skin
  folded     cells of the grid in the patient that turn over, between two bones and elsewhere; volume: the 1st percentile of the
             others' volumes by what they were
  jaw        mean distance of the skin in front of the mandible, positive: mapped outside of the other scan's
  u          aventail's uncertainty, mean, of soft tissue and of tissue (went, inside) where the other scan has air
  way around 1 to i to j against 1 to j, for every i and j: bones, and soft tissue above -500 HU
  within     share of soft tissue whose miss around is within 1, 2, 3 times aventail's uncertainty (three runs in quadrature)
Time is processor time, with the files. The tables go to the terminal and to OUT/repeat.md, all figures to OUT/repeat.json.
"""
import argparse
import glob
import itertools
import json
import os
import re

import measures
import numpy as np
import SimpleITK as sitk
from fields import Field, Image, read_landmarks, write_like
from runs import Runs
from scipy import ndimage, stats
from tools import installed

POINTS = 400_000
ARRIVED = "couch shift"
JAW = "mandible"
# Departure from a bone's rigid motion beyond which a voxel is taken from its label, mm.
DEPARTS = 1.0


class Shift:
    """The same displacement everywhere."""

    def __init__(self, by):
        self.by = np.array(by)

    def map(self, points):
        return points + self.by


class Planning:
    """The first scan with its bones, and the places where is measured."""

    def __init__(self, scan, mask, bones, names):
        self.image, self.labels = Image(scan), Image(bones).values.astype(np.int32)
        with open(names, encoding="utf-8") as file:
            table = json.load(file)
        table = table.get("labels", table)
        self.names = {int(k): v for k, v in table.items()} if all(k.isdigit() for k in table) else {int(v): k for k, v in table.items()}
        self.names = {k: v for k, v in self.names.items() if (self.labels == k).any()}
        self.patient = Image(mask).values > 0
        hu, spacing = self.image.values, self.image.spacing
        self.soft = self.patient & (hu > measures.AIR) & (ndimage.distance_transform_edt(self.labels == 0, spacing) > 4)
        self.surfaces = {name: measures.bone_surface(self.image, self.labels == k) for k, name in self.names.items()}
        self.skin = measures.skin(self.image, self.patient)
        index = np.argwhere(self.patient & (hu > measures.AIR))
        index = index[:: max(1, len(index) // POINTS)]
        self.points, self.point_labels = self.image.world(index), self.labels[tuple(index.T)]
        self.everywhere = self.image.world(np.indices(self.image.size).reshape(3, -1).T)

    def bone(self, label):
        """Voxel centres of a bone."""
        return self.image.world(np.argwhere(self.labels == label))

    def before_jaw(self, points):
        """Which points lie in front of the mandible, within its width and height."""
        jaw = [self.bone(label) for label, name in self.names.items() if name == JAW]
        if not jaw:
            return np.zeros(len(points), bool)
        low, high = jaw[0].min(0), jaw[0].max(0)
        beside = np.all((points >= low) & (points <= high), axis=1, where=[True, False, True])
        return beside & (points[:, 1] < low[1])


class Scan:
    """Another scan: its surfaces to measure distances to."""

    def __init__(self, file, mask):
        self.image = Image(file)
        self.bones = measures.Surface(*measures.surface(self.image, measures.BONE, lambda low, high: True))
        self.skin = measures.Surface(*measures.skin(self.image, Image(mask).values > 0))

    def inside(self, points, margin=2.0):
        """Which points lie in the scan, some mm away from its border."""
        at, border = self.image.index(points), margin / self.image.spacing
        return np.all((at >= border) & (at <= np.array(self.image.size) - 1 - border), axis=1)


def turned(field, points, normals):
    """Normals as a field turns them, from points half a millimetre to either side."""
    there = field.map(points + normals / 2) - field.map(points - normals / 2)
    return there / np.maximum(np.linalg.norm(there, axis=1), 1e-6)[:, None]


def one_way(planning, scan, field, landmarks=None, uncertainty=None):
    """All measures of one registration; landmarks by the name of their set."""
    found = {"bones": {}}
    for label, name in planning.names.items():
        points, normals = planning.surfaces[name]
        voxels = planning.bone(label)[:20000]
        moved = field.map(points)
        seen = scan.inside(moved)
        if seen.sum() < 100:
            found["bones"][name] = {"surface": {"n": int(seen.sum())}}
            continue
        facing = turned(field, points[seen], normals[seen])
        found["bones"][name] = {
            "surface": measures.summary(np.abs(scan.bones.offset(moved[seen], facing))),
            "left": scan.bones.move_left(moved[seen], facing),
            "bent": measures.shape_change(voxels, field.map(voxels)),
        }
    points, normals = planning.skin
    moved = field.map(points)
    seen = scan.inside(moved, 5.0)
    offset = scan.skin.offset(moved[seen], turned(field, points[seen], normals[seen]))
    found["skin"] = {**measures.summary(np.abs(offset)), "signed_mean": float(offset.mean())}
    jaw = offset[planning.before_jaw(points[seen])]
    if jaw.size:
        found["skin"]["before_jaw_signed_mean"] = float(jaw.mean())
    everywhere = field.map(planning.everywhere)
    shape, spacing, hu = planning.image.size, planning.image.spacing, planning.image.values
    seen = scan.inside(everywhere, 0.0).reshape(shape)
    warped = scan.image.at(everywhere).reshape(shape)
    found["agreement"], found["agreement_ml"] = measures.local_correlation(hu, warped, planning.soft & seen, spacing, 15.0)
    changes = measures.came_and_went(hu, warped, planning.patient, seen, spacing)
    found.update({f"{name}_ml": float(change.sum() * np.prod(spacing) / 1000) for name, change in changes.items()})
    if uncertainty is not None:
        u = uncertainty.values
        mean_of = lambda places: float(u[places & (u >= 0)].mean()) if (places & (u >= 0)).any() else None
        found["uncertainty"] = {"soft": mean_of(planning.soft), "went_inside": mean_of(changes["went_inside"])}
    found.update(measures.folds(planning.image, everywhere.reshape(*shape, 3), planning.patient, planning.labels))
    for name, points in (landmarks or {}).items():
        found[name] = measures.summary(measures.target_errors(field, *points))
    return found


def cut(planning, bones, field, image, file):
    """Writes the labels without the voxels of some bones that a field moves otherwise than the bone as a whole."""
    labels = planning.labels.copy()
    for label, name in planning.names.items():
        if name in bones:
            voxels = planning.bone(label)
            parts = measures.departure(voxels, field.map(voxels)) > DEPARTS
            labels[tuple(np.argwhere(planning.labels == label)[parts].T)] = 0
            print(f"{name}: {parts.sum()} of {len(parts)} voxels cut")
    write_like(image, labels.astype(np.uint8), file)


def floor(scan):
    """Mean distance of a scan's bone surface to itself on a grid half a voxel away."""
    image = scan.image
    moved = Image.__new__(Image)
    moved.values = ndimage.shift(image.values.astype(np.float32), (-0.5, -0.5, -0.5), order=3, mode="nearest")
    moved.origin, moved.spacing, moved.step, moved.size = image.world(np.full(3, 0.5)), image.spacing, image.step, image.size
    points, normals = measures.surface(moved, measures.BONE, lambda low, high: True)
    points, normals = points[:: max(1, len(points) // 100_000)], normals[:: max(1, len(normals) // 100_000)]
    return measures.summary(np.abs(scan.bones.offset(points, normals)))


def around(planning, fields, scans, uncertainty=None):
    """The way 1 to i to j against 1 to j: fields of 1 to i, i to j, 1 to j; with what the uncertainty says of it."""
    middle = fields[0].map(planning.points)
    end, direct = fields[1].map(middle), fields[2].map(planning.points)
    seen = scans[0].inside(middle) & scans[1].inside(end) & scans[1].inside(direct)
    miss, label = np.linalg.norm(end - direct, axis=1)[seen], planning.point_labels[seen]
    soft = label == 0
    found = {"soft": measures.summary(miss[soft])}
    found["bones"] = {n: measures.summary(miss[label == k]) for k, n in planning.names.items()}
    if uncertainty is None:
        return found
    parts = [u.at(p, order=0) for u, p in zip(uncertainty, (planning.points, middle, planning.points))]
    known = np.all([p >= 0 for p in parts], axis=0)[seen]
    whole = np.sqrt(sum(p.astype(float) ** 2 for p in parts))[seen]
    told = {}
    for name, which in (("soft", soft), ("bones", ~soft)):
        m, u = miss[which & known], whole[which & known]
        tenth = np.quantile(u, (0.1, 0.9))
        told[name] = {
            "known_percent": float(100 * known[which].mean()),
            "within_percent": [float(100 * (m <= n * u).mean()) for n in (1, 2, 3)],
            "beyond_3u_half_mm_percent": float(100 * (m > 3 * u + 0.5).mean()),
            "spearman": float(stats.spearmanr(m, u).statistic),
            "mean_uncertainty": float(u.mean()), "mean_miss": float(m.mean()),
            "miss_in_lowest_and_highest_tenth": [float(m[u <= tenth[0]].mean()), float(m[u >= tenth[1]].mean())],
        }  # fmt: skip
    found["uncertainty"] = told
    return found


def report(runs, a, b):
    with open(f"{runs.folder('aventail', a, b)}/report.json", encoding="utf-8") as file:
        return json.load(file)


def worst(bones, value):
    """The greatest of a figure over bones, with the bone's name."""
    told = {n: value(b) for n, b in bones.items() if value(b) is not None}
    name = max(told, key=told.get)
    return f"{told[name]:.2f} ({name.replace('vertebrae_', '')})"


def mean(bones, value):
    return np.mean([value(b) for b in bones.values() if value(b) is not None])


def tables(result):
    """Markdown."""
    surface, of = (lambda b: b["surface"].get("mean")), (lambda key: lambda b: b.get(key))
    lines = [f"Scan 2 against itself, half a voxel away, bone surfaces: {result['floor']['mean']:.2f} mm mean, {result['floor']['p95']:.2f} (95th)."]
    lines += [f"{name}, before: {e['mean']:.2f} mean, {e['max']:.1f} greatest." for name, e in result["before"].items()]
    lines += [f"Left out: {tool} ({why})." for tool, why in result["left_out"].items()]
    sets = [name for name in ("landmarks", "others") if any(name in r for r in result["runs"])]
    lines += ["", "| run | tool | bone surfaces: mean, worst | left: mean, worst | bent: worst | skin: mean, 95th, signed | agreement | "
              "came / went inside, ml | at the skin, ml | folded, between bones, volume | processor s |" + "".join(f" {name}: mean, max |" for name in sets)]  # fmt: skip
    lines += ["|---" * (11 + len(sets)) + "|"]
    for r in result["runs"]:
        if "failed" in r:
            lines += [f"| {r['run']} | {r['tool']} | {r['failed'].strip().splitlines()[-1]} |" + " |" * (8 + len(sets))]
            continue
        b, s = r["bones"], r["skin"]
        row = (f"| {r['run']} | {r['tool']} | {mean(b, surface):.2f}, {worst(b, surface)} | {mean(b, of('left')):.2f}, {worst(b, of('left'))} | "
               f"{worst(b, of('bent'))} | {s['mean']:.2f}, {s['p95']:.2f}, {s['signed_mean']:+.2f} | {r['agreement']:.3f} | "
               f"{r['came_inside_ml']:.2f} / {r['went_inside_ml']:.2f} | {r['came_skin_ml']:.2f} / {r['went_skin_ml']:.2f} | "
               f"{r['folded']}, {r['folded_between_bones']}, {r['volume_1st_percentile']:.2f} | {r.get('processor_s', '')} |")  # fmt: skip
        lines += [row + "".join(f" {r[name]['mean']:.2f}, {r[name]['max']:.1f} |" if name in r else " |" for name in sets)]
    if result["around"]:
        lines += ["", "| way around | tool | bones: mean, worst mean | soft tissue: mean, 95th | worst |", "|---" * 5 + "|"]
        for r in result["around"]:
            m = lambda b: b.get("mean")
            lines += [f"| {r['way']} | {r['tool']} | {mean(r['bones'], m):.2f}, {worst(r['bones'], m)} | "
                      f"{r['soft']['mean']:.2f}, {r['soft']['p95']:.2f} | {r['soft']['max']:.1f} |"]  # fmt: skip
    told = [r for r in result["around"] if "uncertainty" in r]
    if told:
        lines += ["", "| uncertainty, way around | of | mean, mean miss | miss within 1, 2, 3 u, % | beyond 3 u + 0.5 mm, % | Spearman | "
                  "miss in lowest, highest tenth |", "|---" * 7 + "|"]  # fmt: skip
        for r, of_what in itertools.product(told, ("soft", "bones")):
            u = r["uncertainty"][of_what]
            lines += [f"| {r['way']} | {of_what} | {u['mean_uncertainty']:.2f}, {u['mean_miss']:.2f} | "
                      f"{', '.join(f'{v:.0f}' for v in u['within_percent'])} | {u['beyond_3u_half_mm_percent']:.2f} | {u['spearman']:.2f} | "
                      f"{u['miss_in_lowest_and_highest_tenth'][0]:.2f}, {u['miss_in_lowest_and_highest_tenth'][1]:.2f} |"]  # fmt: skip
    measured = [r for r in result["runs"] if "failed" not in r]
    columns = [f"{r['tool']} {r['run']}" for r in measured]
    lines += ["", "Bone surfaces / left, mm", "", "| bone | " + " | ".join(columns) + " |", "|---" * (1 + len(columns)) + "|"]
    for name in result["bones"]:
        cell = lambda b: f"{b['surface']['mean']:.2f} / {b['left']:.2f}" if "left" in b else "-"
        lines += [f"| {name} | " + " | ".join(cell(r["bones"][name]) for r in measured) + " |"]
    lines += [""]
    for r in measured:
        jaw, u = r["skin"].get("before_jaw_signed_mean"), r.get("uncertainty", {})
        parts = [f"jaw {jaw:+.2f}"] if jaw is not None else []
        parts += [f"u {u['soft']:.2f}"] if u else []
        parts += [f"{u['went_inside']:.2f} (went, inside)"] if u.get("went_inside") else []
        lines += [f"- {r['run']}, {r['tool']}: {', '.join(parts)}"] if parts else []
    warned = [(r["run"], w) for r in measured for w in r.get("warnings", [])]
    if warned:
        lines += ["", "aventail warns:", ""] + [f"- {run}: {w['code']}: {w['message']}" for run, w in warned]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aventail")
    parser.add_argument("folder", nargs="?")
    parser.add_argument("--scan", action="append", default=[])
    parser.add_argument("--bones")
    parser.add_argument("--labels")
    parser.add_argument("--landmarks")
    parser.add_argument("--out", default="repeat")
    parser.add_argument("--tools", default="aventail,plastimatch,elastix,greedy")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--affine", action="store_true")
    parser.add_argument("--no-air", action="store_true")
    parser.add_argument("--config")
    parser.add_argument("--leave-out", default="")
    parser.add_argument("--cut", default="")
    given = parser.parse_args()
    if given.folder:
        number = lambda file: int(re.search(r"ct_(\d+)\.nii\.gz$", file).group(1))
        given.scan = sorted(glob.glob(f"{given.folder}/ct_[0-9]*.nii.gz"), key=number)
        given.bones, given.labels = given.bones or f"{given.folder}/bones_1.nii.gz", given.labels or f"{given.folder}/bones.json"
    if len(given.scan) < 2 or not given.bones or not given.labels:
        parser.error("give DIR, or --scan twice, --bones and --labels")
    os.makedirs(given.out, exist_ok=True)
    scans = {str(n + 1): file for n, file in enumerate(given.scan)}
    more = ["--config", given.config] if given.config else []
    runs = Runs(given.aventail, scans, given.bones, given.labels, given.out, given.threads, given.affine, more, not given.no_air)
    landmarks = {"landmarks": read_landmarks(given.landmarks)} if given.landmarks else {}
    if given.leave_out:
        landmarks["others"] = read_landmarks(given.landmarks, given.leave_out.split(","))
    tools = given.tools.split(",")
    left_out = {tool: "not installed" for tool in tools if not installed(tool)}
    tools = sorted((tool for tool in tools if tool not in left_out), key=lambda tool: tool != "aventail")
    # aventail first: its masks of the patient serve the others.
    ways = list(itertools.permutations(list(scans)[1:], 2))
    for tool, (a, b) in itertools.product(tools, [("1", name) for name in list(scans)[1:]] + ways):
        done = runs.run(tool, a, b)
        print(f"{a} to {b}, {tool}: {'failed' if 'failed' in done else 'there'}", flush=True)
    planning = Planning(scans["1"], runs.mask("1"), given.bones, given.labels)
    others = {name: Scan(file, runs.mask(name)) for name, file in scans.items() if name != "1"}
    result = {"scans": given.scan, "bones": list(planning.names.values()), "left_out": left_out,
              "floor": floor(others["2"]), "runs": [], "around": []}  # fmt: skip
    result["before"] = {name: measures.summary(measures.target_errors(Shift(np.zeros(3)), *points)) for name, points in landmarks.items()}
    for other in others:
        for tool in tools:
            done = runs.run(tool, "1", other)
            row = {"run": f"1 to {other}", "tool": tool, **done}
            known = landmarks if other == "2" else None
            if "failed" not in done:
                if tool == "aventail":
                    told = report(runs, "1", other)
                    before = one_way(planning, others[other], Shift(told["couch"]["shift_mm"]), known)
                    result["runs"].append({"run": row["run"], "tool": ARRIVED, **before})
                    row["warnings"] = [{k: w[k] for k in ("code", "message")} for w in told["warnings"]]
                field = Field(f"{given.out}/{done['field']}")
                u = Image(f"{runs.folder(tool, '1', other)}/uncertainty.nii.gz") if tool == "aventail" else None
                row |= one_way(planning, others[other], field, known, u)
                if tool == "greedy" and other == "2" and given.cut:
                    cut(planning, given.cut.split(","), field, sitk.ReadImage(given.bones), f"{given.out}/bones_cut.nii.gz")
            result["runs"].append(row)
            print(f"1 to {other}, {tool}: measured", flush=True)
    for (i, j), tool in itertools.product(ways, tools):
        parts = [("1", i), (i, j), ("1", j)]
        done = [runs.run(tool, a, b) for a, b in parts]
        if any("failed" in d for d in done):
            continue
        uncertainty = [Image(f"{runs.folder(tool, a, b)}/uncertainty.nii.gz") for a, b in parts] if tool == "aventail" else None
        fields = [Field(f"{given.out}/{d['field']}") for d in done]
        found = around(planning, fields, (others[i], others[j]), uncertainty)
        result["around"].append({"way": f"1 to {i} to {j}", "tool": tool, **found})
        print(f"1 to {i} to {j}, {tool}: measured", flush=True)
    with open(f"{given.out}/repeat.json", "w", encoding="utf-8") as file:
        json.dump(result, file, indent=1)
    text = tables(result)
    with open(f"{given.out}/repeat.md", "w", encoding="utf-8") as file:
        file.write(text)
    print("\n" + text)


if __name__ == "__main__":
    main()
