#!/usr/bin/env python3
"""The tables of docs/study.md: every stage of the thesis on four cases, beside what it prints, with the trend of each row.

usage: study.py AVENTAIL [CASES] [--out DIR] [--case NAME,NAME] [--threads N] [--peers TOOL,TOOL]

AVENTAIL  the aventail program
CASES     as for ablation.py, with the fractions `small`, `moderate` and `spline`; default: AVENTAIL_CASES
--out     folder for the runs and studies (default: study); what is finished there is kept
--case    cases to run (default: small,moderate,spline,arms); `arms` is the phantom whose raised arms are lowered
--peers   instead of the stages: image-driven tools that are told of the bones, as ANACONDA in the thesis:
          plastimatch-bones, elastix-bones (tools.py has their settings), judged by `aventail evaluate`

Each cell: J < 0 in %, mean J over all tissue above -500 HU (thesis Tab. 2), mean relative residual, seconds. A trend says
whether folds and residual change against the row named in the same direction as in the thesis: patient 1 by
the cases that move little, patient 2 by the arms. The tables go to the terminal, as Markdown; OUT/arms_lowered.png
shows coronal planes of six stages.
"""
import argparse
import json
import os
import subprocess
import time
import tomllib

import numpy as np
import SimpleITK as sitk
from PIL import Image, ImageDraw
from tools import WITH_BONES, Job, installed

HEAD_AND_NECK = ("small", "moderate", "spline")
PLAN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "data", "study.toml")
RAISE = os.path.join(os.path.dirname(PLAN), "raise_arms.toml")
LANDMARKS, LEAST_MM, SEED = 40, 20.0, 1
SHOWN = [
    ("violation-stiff", "constraint violation"), ("timestamps-stiff", "timestamps, no rotation"),
    ("linear-decay-stiff", "linear decay"), ("superposition-4-stiff", "superposition t^-4"),
    ("thin-plate-splines", "thin-plate splines"), ("default", "aventail's default"),
]  # fmt: skip
# What a change of less than this is called, in percent of voxels folded and in relative residual.
SAME = {"folded": 0.1, "residual": 0.01}


def run(*command):
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)


def finished(folder):
    return os.path.exists(f"{folder}/report.json")


def head_and_neck(options, name):
    """A registration of one of the shared fractions."""
    out, cases = f"{options.out}/run_{name}", options.cases
    if not finished(out):
        run(options.aventail, "register", "-q", "--planning", f"{cases}/planning_ct.nii.gz",
            "--bones", f"{cases}/bones.nii.gz", "--labels", f"{cases}/bones.json",
            "--fraction", f"{cases}/{name}/fraction_ct.nii.gz",
            "--landmarks", f"{cases}/{name}/landmarks.csv", "--out", out)  # fmt: skip
    return out


def arms(options):
    """The phantom with its arms raised, then lowered by the inverse transforms: a large motion with known truth."""
    phantom, raised, out = (f"{options.out}/{n}" for n in ("arms_phantom", "arms_raised", "run_arms"))
    if finished(out):
        return out
    if not finished(raised):
        run(options.aventail, "phantom", "--spacing", "3x3x3", "--out", phantom)
        run(options.aventail, "pose", "-q", "--planning", f"{phantom}/planning_ct.nii.gz", "--bones",
            f"{phantom}/bones.nii.gz", "--pose", RAISE, "--margin", 250, "--out", raised)  # fmt: skip
    with open(f"{raised}/bone_transforms.json", encoding="utf-8") as file:
        there = json.load(file)
    back = {name: np.linalg.inv(np.array(rows)).tolist() for name, rows in there.items()}
    with open(f"{options.out}/arms_back.json", "w", encoding="utf-8") as file:
        json.dump(back, file)
    # Random places in soft tissue that move far; raised they are the planning side, lowered the fraction's.
    field = sitk.ReadImage(f"{raised}/planning_to_fraction.nii.gz", sitk.sitkVectorFloat64)
    u = sitk.GetArrayFromImage(field)
    inside = sitk.GetArrayFromImage(sitk.ReadImage(f"{phantom}/body.nii.gz")) > 0
    bone = sitk.GetArrayFromImage(sitk.ReadImage(f"{phantom}/bones.nii.gz")) > 0
    far = np.argwhere(inside & ~bone & (np.linalg.norm(u, axis=-1) > LEAST_MM))
    chosen = far[np.random.default_rng(SEED).choice(len(far), LANDMARKS, replace=False)]
    with open(f"{options.out}/arms_landmarks.csv", "w", encoding="utf-8") as file:
        file.write("name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n")
        for n, (k, j, i) in enumerate(chosen):
            low = np.array(field.TransformIndexToPhysicalPoint((int(i), int(j), int(k))))
            row = ",".join(f"{v:.3f}" for v in (*(low + u[k, j, i]), *low))
            file.write(f"tissue_{n},{row}\n")
    run(options.aventail, "pose", "-q", "--planning", f"{raised}/planning_on_fraction.nii.gz", "--bones",
        f"{raised}/bones_on_fraction.nii.gz", "--transforms", f"{options.out}/arms_back.json",
        "--landmarks", f"{options.out}/arms_landmarks.csv", "--out", out)  # fmt: skip
    return out


def records(options, name, case):
    out = f"{options.out}/study_{name}"
    run(options.aventail, "study", "-q", "--case", case, "--plan", PLAN, "--threads", options.threads, "--out", out)
    folder, found = f"{out}/stages", {}
    for file in sorted(os.listdir(folder)):
        with open(f"{folder}/{file}", encoding="utf-8") as text:
            found[file.removesuffix(".json")] = json.load(text)
    return found


def figures(record):
    return {"folded": record["jacobian"]["all"]["folded_percent"], "residual": (record["residual"] or [None])[0]}


def cell(record):
    j, r = record["jacobian"]["all"], record["residual"]
    residual = f"{r[0]:.2f}" if r else ""
    return f"{j['folded_percent']:.2f}, {j['mean']:.3f}, {residual}, {record['seconds']:.1f}"


def printed(p):
    parts = [p.get("folded"), p.get("mean"), p.get("residual_mean")]
    return f"P{p['patient'][-1]} " + ", ".join("-" if v is None else f"{v:g}" for v in parts)


def before(stage):
    """The row that the thesis would have one compare with."""
    literal = "literal-" if stage.startswith("literal-") else ""
    name = stage.removeprefix("literal-")
    kind, _, material = name.rpartition("-")
    against = {
        "timestamps": None if literal else "violation", "constraint-based": "timestamps", "linear-decay": "timestamps",
        "superposition-1": "linear-decay", "superposition-2": "superposition-1",
        "superposition-4": "linear-decay" if literal else "superposition-2",
    }.get(kind)  # fmt: skip
    if against:
        return f"{literal}{against}-{material}"
    return {"thin-plate-splines": "superposition-4-stiff"}.get(name)


def sign(change, of):
    return 0 if abs(change) < SAME[of] else int(np.sign(change))


def trend(stage, published, found):
    """In words: of folds and residual, in how many cases the change is that of the thesis."""
    other = before(stage)
    if other is None or other not in published:
        return ""
    words = []
    for patient, cases in (("1", HEAD_AND_NECK), ("2", ("arms",))):
        here, there = (published[s].get(patient) for s in (stage, other))
        if not here or not there:
            continue
        for of, key in (("folded", "folded"), ("residual", "residual_mean")):
            if here.get(key) is None or there.get(key) is None:
                continue
            wanted = sign(here[key] - there[key], of)
            got = [sign(figures(found[c][stage])[of] - figures(found[c][other])[of], of)
                   for c in cases if c in found]  # fmt: skip
            same = sum(g == wanted for g in got)
            verdict = "same" if same == len(got) else "not" if same == 0 else f"{same} of {len(got)}"
            words.append(f"P{patient} {of} {verdict}")
    return f"to {other.removeprefix('literal-')}: " + ", ".join(words)


def planes(picture):
    """The planes of a fusion, which lie one under another between white lines."""
    white = (np.asarray(picture.convert("RGB")) == 255).all(axis=(1, 2))
    edges = np.flatnonzero(np.diff(np.concatenate([[1], white.astype(int), [1]])))
    return [picture.crop((0, top, picture.width, end)) for top, end in zip(edges[::2], edges[1::2])]


def arms_lowered(options):
    """Coronal planes of six stages with the arms, side by side."""
    width, line = 320, 16
    drawn = []
    for stage, name in SHOWN:
        file = f"{options.out}/study_arms/pictures/{stage}_fusion_after.png"
        plane = planes(Image.open(file).convert("RGB"))[1]
        drawn.append((name, plane.resize((width, round(plane.height * width / plane.width)), Image.Resampling.LANCZOS)))
    height = max(plane.height for _, plane in drawn) + line
    sheet = Image.new("RGB", (3 * width, 2 * height), "white")
    for n, (name, plane) in enumerate(drawn):
        at = (n % 3 * width, n // 3 * height)
        sheet.paste(plane, (at[0], at[1] + line))
        ImageDraw.Draw(sheet).text((at[0] + 4, at[1] + 2), name, fill="black")
    sheet.quantize(128).save(f"{options.out}/arms_lowered.png", optimize=True)


def sides(options, name, case):
    """Planning CT, labels, their names, fraction CT and landmarks behind a run."""
    if name == "arms":
        raised = f"{options.out}/arms_raised"
        return (f"{raised}/planning_on_fraction.nii.gz", f"{raised}/bones_on_fraction.nii.gz", None,
                f"{case}/planning_on_fraction.nii.gz", f"{options.out}/arms_landmarks.csv")  # fmt: skip
    cases = options.cases
    return (f"{cases}/planning_ct.nii.gz", f"{cases}/bones.nii.gz", f"{cases}/bones.json",
            f"{cases}/{name}/fraction_ct.nii.gz", f"{cases}/{name}/landmarks.csv")  # fmt: skip


def as_record(assessment, seconds):
    """What `evaluate` found, in the shape of a stage's record."""
    each = assessment["landmarks"]["each"]
    relative = float(np.mean([m["after"] / m["before"] for m in each]))
    return {"jacobian": assessment["regularity"][0][1]["jacobian"], "residual": [relative], "seconds": seconds}


def peer(options, tool, name, case):
    """A cell of a tool that is told of the bones: its field as `evaluate` judges it, and its time."""
    planning, bones, names, fraction, landmarks = sides(options, name, case)
    job = Job(options.aventail, planning, fraction, bones, names, f"{case}/body.nii.gz", f"{options.out}/{tool}_{name}")
    os.makedirs(job.out, exist_ok=True)
    start = time.monotonic()
    field = WITH_BONES[tool](job)
    seconds = time.monotonic() - start
    judged = f"{job.out}/evaluation"
    run(options.aventail, "evaluate", "-q", "--planning", job.fixed, "--fraction", job.moving, "--bones", job.bones,
        *(["--labels", job.names] if job.names else []), "--planning-to-fraction", field,
        "--landmarks", landmarks, "--out", judged)  # fmt: skip
    with open(f"{judged}/evaluation.json", encoding="utf-8") as file:
        found = json.load(file)["fields"][0]["assessment"]
    return cell(as_record(found, seconds))


def peers(options, names):
    print(f"| tool | {' | '.join(names)} |\n" + "|---" * (len(names) + 1) + "|", flush=True)
    for tool in options.peers.split(","):
        if not installed(tool):
            print(f"| {tool} | not installed |" + " |" * (len(names) - 1), flush=True)
            continue
        cells = [peer(options, tool, n, arms(options) if n == "arms" else head_and_neck(options, n)) for n in names]
        print(f"| {tool} | {' | '.join(cells)} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("aventail")
    parser.add_argument("cases", nargs="?", default=os.environ.get("AVENTAIL_CASES"))
    parser.add_argument("--out", default="study")
    parser.add_argument("--case", default="small,moderate,spline,arms")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--peers")
    options = parser.parse_args()
    os.makedirs(options.out, exist_ok=True)
    if options.peers:
        return peers(options, options.case.split(","))
    found = {}
    for name in options.case.split(","):
        found[name] = records(options, name, arms(options) if name == "arms" else head_and_neck(options, name))
    if "arms" in found:
        arms_lowered(options)
    with open(PLAN, "rb") as file:
        plan = tomllib.load(file)
    stages = [s for table in plan["table"] for s in table["stage"]]
    published = {s["id"]: {p["patient"][-1]: p for p in s.get("published", [])} for s in stages}
    for table in plan["table"]:
        print(f"\n### {table['title']}\n\n| stage | {' | '.join(found)} | thesis | trend |")
        print("|---" * (len(found) + 3) + "|")
        for s in table["stage"]:
            cells = [cell(found[c][s["id"]]) for c in found]
            thesis = "; ".join(printed(p) for p in s.get("published", []))
            print(f"| {s['name']} | {' | '.join(cells)} | {thesis} | {trend(s['id'], published, found)} |")


if __name__ == "__main__":
    main()
