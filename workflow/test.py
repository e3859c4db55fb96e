"""Runs the workflow on phantom patients (6 unless told) with 3 fractions each, kills it in the middle, finishes it, and checks what it made.
Where Slurm takes jobs and Snakemake has its plugin, two of them go through the profile for Slurm as well.

python workflow/test.py PROGRAM FOLDER [PATIENTS]     (snakemake on PATH; FOLDER is made anew)
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

PATIENTS, FRACTIONS = int(sys.argv[3]) if len(sys.argv) > 3 else 6, 3
WEIGHTS = [0.3, 0.3, 0.4]
# Of each registration, for intervals of the dose.
SAMPLES = 4
# Killed when this many registrations are done.
KILLED_AT = 5


def call(*words, **more):
    return subprocess.run([str(w) for w in words], check=True, **more)


def make_patients(program, folder):
    """One phantom, and as many of its postures as there are fractions; their dose is carried with the tissue."""
    phantom, library = folder / "phantom", folder / "library"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    call(program, "phantom", "--spacing", "9x9x9", "--out", phantom, **quiet)
    images = ["--planning", phantom / "planning_ct.nii.gz", "--bones", phantom / "bones.nii.gz"]
    more = ["--dose", phantom / "dose.nii.gz", "--sample", PATIENTS * FRACTIONS, "--seed", 3]
    call(program, "library", *images, *more, "--out", library, "--quiet", **quiet)
    postures = sorted(p for p in library.iterdir() if p.is_dir())
    assert len(postures) == PATIENTS * FRACTIONS, postures
    columns = ["patient", "fraction", "planning", "bones", "image", "dose", "weight", "structures"]
    with open(folder / "cases.csv", "w", newline="") as lines:
        writer = csv.DictWriter(lines, columns)
        writer.writeheader()
        for n, posture in enumerate(postures):
            patient, fraction = divmod(n, FRACTIONS)
            writer.writerow({
                "patient": f"patient {patient + 1}", "fraction": f"fx{fraction + 1}",
                "planning": phantom / "planning_ct.nii.gz", "bones": phantom / "bones.nii.gz",
                "image": posture / "ct.nii.gz", "dose": posture / "dose.nii.gz", "weight": WEIGHTS[fraction],
                "structures": phantom / "contours.json",
            })
    (folder / "settings.toml").write_text('preset = "fast"\n[output]\nuncertainty = true\n')
    return phantom


def snakemake(program, folder, *more, quiet="all"):
    settings = {"cases": folder / "cases.csv", "out": folder / "results", "program": program, "threads": 1}
    settings |= {"settings": folder / "settings.toml", "samples": SAMPLES, "limits": '["spinal_cord:D2<=45"]'}
    words = ["snakemake", "--snakefile", Path(__file__).parent / "Snakefile", "--directory", folder, "--cores", 2]
    words += [*more, "--quiet", quiet, "--config", *[f"{name}={value}" for name, value in settings.items()]]
    return [str(w) for w in words]


def reports(folder):
    return sorted((folder / "results" / "runs").glob("*/*/report.json"))


def kill_in_the_middle(words, folder, killed_at):
    """Ends the workflow and its jobs as a power cut does; returns what was done until then."""
    run = subprocess.Popen(words, start_new_session=True)
    while len(reports(folder)) < killed_at:
        assert run.poll() is None, f"the workflow ended before it could be killed: {run.returncode}"
        time.sleep(0.2)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    return times(folder)


def times(folder):
    """When each report was written."""
    return {path: path.stat().st_mtime_ns for path in reports(folder)}


def main():
    program, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    phantom = make_patients(program, folder)
    begun = time.monotonic()
    before = kill_in_the_middle(snakemake(program, folder), folder, KILLED_AT)
    assert len(before) < PATIENTS * FRACTIONS, "it was done before it was killed"
    call(*snakemake(program, folder, "--unlock"))
    call(*snakemake(program, folder, "--rerun-incomplete"))
    print(f"{PATIENTS * FRACTIONS} registrations and what follows: {time.monotonic() - begun:.0f} s")

    made = reports(folder)
    assert len(made) == PATIENTS * FRACTIONS, made
    # What was done stays; only jobs that were at work, two at most, are done again.
    again = [path for path, then in before.items() if path.stat().st_mtime_ns != then]
    assert len(again) <= 2, f"made again: {again}"
    summary = json.loads((folder / "results/summary/summary.json").read_text())
    assert len(summary["runs"]) == PATIENTS * FRACTIONS and not summary["unfinished"]
    assert [r["fraction"] for r in summary["runs"][:FRACTIONS]] == [f"fx{n + 1}" for n in range(FRACTIONS)]
    assert len({r["patient"] for r in summary["runs"]}) == PATIENTS

    # Each patient's dose has its intervals there, which hold what was found but for rounding of few samples, and its limit.
    assert [d["patient"] for d in summary["doses"]] == [f"patient {n + 1}" for n in range(PATIENTS)]
    for dose in summary["doses"]:
        assert dose["number"] == SAMPLES and dose["doses"] == FRACTIONS and 0 <= dose["common_percent"] <= 100
        mean = {s["name"]: s["figures"][0] for s in dose["structures"]}["ptv"]
        assert mean["low"] <= mean["high"] and abs(mean["value"] - mean["low"]) < 5, mean
        assert [limit["structure"] for limit in dose["limits"]] == ["spinal_cord"]
    page = (folder / "results/summary/summary.html").read_text()
    assert "Dose over the course" in page and "D2 \u2264 45" in page

    # A dose that moves with the tissue adds up to the plan's.
    planned = folder / "planned"
    figures = ["dose", "dvh", "--structures", phantom / "contours.json", "--out"]
    call(program, *figures, planned, "--dose", phantom / "dose.nii.gz", stdout=subprocess.DEVNULL)
    mean = lambda out: {s["name"]: s["mean"] for s in json.loads((out / "dvh.json").read_text())[0]["structures"]}
    plan = mean(planned)
    worst = 0.0
    for n in range(PATIENTS):
        total = mean(folder / f"results/dose/patient {n + 1}/dvh")
        worst = max(worst, max(abs(total[name] - dose) for name, dose in plan.items()))
    most = max(plan.values())
    print(f"mean doses of {len(plan)} structures differ from the plan's by at most {worst:.2f} of {most:.1f} Gy")
    # Voxels of 9 mm blur the edge of the target.
    assert worst < 0.08 * most

    dry = subprocess.run(snakemake(program, folder, "--dry-run"), capture_output=True, text=True, check=True)
    assert "Nothing to be done" in dry.stdout + dry.stderr, dry.stdout + dry.stderr
    for image in ["bones.nii.gz", "nothing.nii.gz"]:
        refused(program, folder, image)
    if slurm_answers():
        through_slurm(program, folder)
    else:
        print("no Slurm that takes jobs here, or no plugin for it: its profile is not tested")


def slurm_answers():
    """Whether jobs can be given to Slurm, and Snakemake can do it."""
    plugin = find_spec("snakemake_executor_plugin_slurm")
    return plugin and shutil.which("sbatch") and subprocess.run(["sinfo"], capture_output=True).returncode == 0


def through_slurm(program, folder, patients=2):
    """Jobs of Slurm, whose Snakemake is killed in the middle; what it left in the queue is cancelled, and it is finished."""
    own = folder / "slurm"
    own.mkdir()
    lines = (folder / "cases.csv").read_text().splitlines(keepends=True)
    (own / "cases.csv").write_text("".join(lines[: 1 + patients * FRACTIONS]))
    shutil.copy(folder / "settings.toml", own)
    name = f"aventail-test-{os.getpid()}"
    options = ["--profile", Path(__file__).parent / "profiles/slurm", "--slurm-jobname-prefix", name]
    words = snakemake(program, own, *options, "--slurm-init-seconds-before-status-checks", 5)

    def jobs():
        """Number and memory of those that are in the queue."""
        told = call("squeue", "--noheader", "--me", "--format", "%i %m %j", capture_output=True, text=True).stdout
        return [line.split()[:2] for line in told.splitlines() if name in line.split()[2]]

    begun = time.monotonic()
    kill_in_the_middle(words, own, 3)
    left = jobs()
    asked = {json.loads(path.read_text())["memory_bytes"] for path in (own / "results/estimates").rglob("*.json")}
    asked = {f"{int(bytes / 1e6 * 1.1) + 350}M" for bytes in asked}
    assert left and {memory for _, memory in left} <= asked, (left, asked)
    call("scancel", *[number for number, _ in left])
    while jobs():
        time.sleep(0.5)
    before = times(own)
    assert len(before) < patients * FRACTIONS, "it was done before it was killed"
    call(*words, "--unlock")
    call(*words)
    assert len(reports(own)) == patients * FRACTIONS
    assert all(path.stat().st_mtime_ns == then for path, then in before.items()), "what was done was done again"
    summary = json.loads((own / "results/summary/summary.json").read_text())
    assert len(summary["runs"]) == patients * FRACTIONS and not summary["unfinished"]
    print(f"{patients * FRACTIONS} registrations and what follows through Slurm: {time.monotonic() - begun:.0f} s")


def refused(program, folder, image):
    """A row that cannot be registered stops its own run with the program's word, and leaves no report."""
    own = folder / f"refused_{image.split('.')[0]}"
    own.mkdir()
    lines = (folder / "cases.csv").read_text().splitlines()
    header, first = lines[0].split(","), lines[1].split(",")
    first[header.index("image")] = str(folder / "phantom" / image)
    (own / "cases.csv").write_text("\n".join([lines[0], ",".join(first)]) + "\n")
    (own / "settings.toml").write_text('preset = "fast"\n')
    run = subprocess.run(snakemake(program, own, quiet="rules"), capture_output=True, text=True)
    assert run.returncode != 0, image
    assert not reports(own) and not (own / "results/summary/summary.json").exists()
    logs = "".join(path.read_text() for path in (own / "results").glob("logs/**/*.txt"))
    said = logs + run.stdout + run.stderr
    assert "remedy" in logs or "Missing input" in said, said


if __name__ == "__main__":
    main()
