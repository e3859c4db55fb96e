"""Orthanc's plugin script: registers each fraction that comes in to its patient's planning CT, and stores the results.

Orthanc loads it by its Python plugin (`PythonScript`); README.md beside it says how.
"""

import fcntl
import html
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
import traceback
from pathlib import Path

import archive
import orthanc
import rules
from archive import Refused, Waits
from jobs import GROWN, Jobs

# Data, settings or the fit are to blame: another try ends the same. Others may be a full disk or lack of memory.
FAULT_OF_DATA = {2, 3, 4, 6}


class Node:
    def __init__(self):
        self.rules = rules.read(json.loads(orthanc.GetConfiguration())["Aventail"]["Rules"])
        self.work = self.rules.work
        self.work.mkdir(parents=True, exist_ok=True)
        os.chmod(self.work, 0o700)
        self.jobs = Jobs(self.work / "queue.sqlite")
        self.wake = threading.Event()
        # Patients of whom something came: what waits of theirs is looked at again.
        self.moved, self.moving = set(), threading.Lock()

    def touch(self, *patients):
        with self.moving:
            self.moved.update(patients)
        self.wake.set()

    def arrived(self, identifier, state="waiting"):
        """A series is whole: queues it if it may be a fraction, and has the patient's others looked at again."""
        one = archive.series(identifier)
        if one is None or archive.own(one):
            return
        _, patient = archive.patient_of(one)
        rule = self.rules.of(patient)
        if rule is None:
            return
        wanted = rule.fraction_has
        if one["MainDicomTags"].get("Modality") == "CT" and (
            not wanted or rules.fits(wanted, archive.tags(one["Instances"][0]))
        ):
            self.jobs.came(identifier, patient, archive.digest(one), state)
        self.touch(patient)

    def work_on(self):
        """Forever: the oldest job that can be done. Only one node works in a folder, and a program that outlived its
        Orthanc holds the lock until it ends."""
        with open(self.work / "lock", "w") as lock:
            self.lock = lock
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.start()
            while True:
                self.wake.clear()
                try:
                    busy = self.step()
                except Exception:  # The node must outlive whatever one job does.
                    orthanc.LogError(f"aventail: {traceback.format_exc()}")
                    busy = False
                    time.sleep(5)
                if not busy:
                    self.wake.wait()

    def start(self):
        # What a kill left: images of patients in folders that were to be gone when their job ends.
        for kind in ("in-*", "print-*", "page-*"):
            for path in self.work.glob(kind):
                shutil.rmtree(path)
        for job in self.jobs.all():
            if job["state"] == "running":
                self.jobs.set(job["series"], "ready", "it was at work when Orthanc ended")
        # Series that became whole unseen, as Orthanc ended.
        for identifier in archive.find("Series", {"Modality": "CT"}):
            self.arrived(identifier, "earlier" if self.jobs.fresh else "waiting")
        self.touch(*(job["patient"] for job in self.jobs.all()))

    def step(self):
        """Looks at what waits, and does one job; whether there was one."""
        with self.moving:
            moved, self.moved = self.moved, set()
        for job in self.jobs.all():
            if job["state"] == "waiting" and job["patient"] in moved:
                try:
                    self.judge(job)
                except Exception:
                    self.touch(job["patient"])
                    raise
        job = next((job for job in self.jobs.all() if job["state"] in ("ready", "storing")), None)
        if job is None:
            return bool(self.moved)
        try:
            self.do(job)
        except Waits as wait:
            self.jobs.set(job["series"], "waiting", str(wait))
        except Refused as refusal:
            self.refuse(job, "refused", str(refusal))
        except Exception as error:
            orthanc.LogError(f"aventail: {traceback.format_exc()}")
            self.try_later(job, f"{type(error).__name__}: {error}")
        return True

    def judge(self, job):
        """Whether a series that waits is a fraction, and has its planning side."""
        one, rule = archive.series(job["series"]), self.rules.of(job["patient"])
        if one is None or rule is None:
            self.jobs.set(
                job["series"], "failed", "its series was deleted" if rule else "no rule fits the patient any more"
            )
            return
        try:
            patient, _ = archive.patient_of(one)
            if archive.is_planning(patient, one["MainDicomTags"]["SeriesInstanceUID"], rule):
                self.jobs.set(job["series"], "planning")
                return
            archive.planning_of(patient, rule)
            self.jobs.set(job["series"], "ready")
        except Waits as wait:
            self.jobs.set(job["series"], "waiting", str(wait))
        except Refused as refusal:
            self.refuse(job, "refused", str(refusal))

    def do(self, job):
        one, rule = archive.series(job["series"]), self.rules.of(job["patient"])
        if one is None or rule is None:
            raise Waits("its series was deleted" if rule else "no rule fits the patient any more")
        patient, _ = archive.patient_of(one)
        planning = archive.planning_of(patient, rule)
        out = self.work / "runs" / planning.ct / one["ID"]
        # What was whole when Orthanc ended need not be made again.
        if job["state"] != "storing" or not (out / "report.json").is_file():
            if self.jobs.begin(one["ID"], archive.digest(one)) >= self.rules.tries:
                self.refuse(job, "failed", f"it was begun {self.rules.tries} times and never ended: {job['why']}")
                return
            self.register(one, job["patient"], planning, rule, out)
            if self.has_grown(one["ID"]):
                return
            self.jobs.set(one["ID"], "storing")
        self.store(one, out)
        if not rule.keep:
            shutil.rmtree(out)
        if not self.has_grown(one["ID"]):
            self.jobs.set(one["ID"], "done")
            archive.mark(one["ID"], "done")

    def has_grown(self, identifier):
        """Whether a series has other instances than those that were registered; it is queued again then."""
        now, job = archive.series(identifier), self.jobs.get(identifier)
        if now is None or archive.digest(now) == job["digest"]:
            return False
        self.jobs.again(identifier, archive.digest(now), GROWN)
        self.touch(job["patient"])
        return True

    def register(self, one, patient, planning, rule, out):
        """Runs the program on files of the archive, in a folder of its own."""
        shutil.rmtree(out, ignore_errors=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self.work, prefix="in-") as place:
            inputs = Path(place)
            archive.export(archive.series(planning.ct)["Instances"], inputs / "planning")
            archive.export(one["Instances"], inputs / "fraction")
            archive.export([planning.structures], inputs / "structures")
            structures = inputs / "structures" / "00000.dcm"
            words = [
                self.rules.program,
                "register",
                "--planning",
                inputs / "planning",
                "--fraction",
                inputs / "fraction",
            ]
            words += ["--bones", rule.bones(patient, structures), "--structures", structures, "--dicom", "--quiet"]
            if planning.dose:
                archive.export([planning.dose], inputs / "dose")
                words += ["--dose", inputs / "dose" / "00000.dcm"]
            words += ["--config", rule.settings] if rule.settings else []
            words += ["--threads", rule.threads, "--out", out]
            self.run([str(word) for word in words], inputs)

    def run(self, words, inputs):
        # The program ends with Orthanc where util-linux can have it so; where not, its lock is waited for.
        if shutil.which("setpriv"):
            words = ["setpriv", "--pdeathsig", "KILL", *words]
        with open(inputs / "said.txt", "w+") as said:
            run = subprocess.run(
                words, check=False, stdin=subprocess.DEVNULL, stdout=said, stderr=said, pass_fds=[self.lock.fileno()]
            )
            if run.returncode:
                said.seek(0)
                text = said.read().replace(f"{inputs}/", "").strip()[-4000:]
                if run.returncode in FAULT_OF_DATA:
                    raise Refused(text)
                raise RuntimeError(f"the program ended with {run.returncode}: {text}")

    def store(self, one, out):
        """Results, images first since the others refer to them, and then the report: it says that all is there."""
        files = sorted((out / "dicom").rglob("*.dcm"), key=lambda path: (path.parent == out / "dicom", path.name))
        stored = archive.store(files)
        for result in sorted(set(stored.values())):
            archive.mark_result(result, one["ID"])
        page = out / "report.html"
        archive.attach(one["ID"], page.read_bytes())
        if pdf := self.printed(page):
            archive.store_pdf(one, pdf, "aventail: report", " ".join(sorted(stored)))

    def printed(self, page):
        """A page as PDF, or None where no browser is or it fails: the page is attached in any case."""
        if not self.rules.browser:
            return None
        with tempfile.TemporaryDirectory(dir=self.work, prefix="print-") as place:
            pdf = Path(place) / "report.pdf"
            words = [
                self.rules.browser,
                "--headless",
                "--disable-gpu",
                "--no-pdf-header-footer",
                f"--user-data-dir={place}",
            ]
            # Chromium's sandbox does not work for root.
            words += ["--no-sandbox"] if os.geteuid() == 0 else []
            words += [f"--print-to-pdf={pdf}", page.resolve().as_uri()]
            try:
                subprocess.run(words, timeout=180, check=True, capture_output=True, stdin=subprocess.DEVNULL)
                return pdf.read_bytes()
            except (OSError, subprocess.SubprocessError) as error:
                orthanc.LogWarning(f"aventail: the report was not printed, its page is attached: {error}")
                return None

    def try_later(self, job, why):
        if self.jobs.count(job["series"], storing=job["state"] == "storing") >= self.rules.tries:
            self.refuse(job, "failed", why)
        else:
            state = "storing" if job["state"] == "storing" else "ready"
            self.jobs.set(job["series"], state, why)
            time.sleep(5)

    def refuse(self, job, state, why):
        """Nothing is stored; a report at the fraction's series tells why."""
        orthanc.LogWarning(f"aventail: series {job['series']}: {state}: {why}")
        for path in (self.work / "runs").glob(f"*/{job['series']}"):
            shutil.rmtree(path)
        one, rule = archive.series(job["series"]), self.rules.of(job["patient"])
        if one is not None:
            title = f"aventail: {state}, nothing was stored"
            page = (
                f'<!doctype html><meta charset="utf-8"><title>{title}</title><h1>{title}</h1>'
                f"<p>Patient {html.escape(job['patient'])}, series "
                f"{html.escape(one['MainDicomTags'].get('SeriesInstanceUID', ''))}</p>"
                f'<pre style="white-space: pre-wrap">{html.escape(why)}</pre>'
            )
            archive.attach(one["ID"], page.encode())
            archive.mark(one["ID"], state)
            if rule and rule.at_refusal == "pdf":
                with tempfile.TemporaryDirectory(dir=self.work, prefix="page-") as place:
                    path = Path(place) / "page.html"
                    path.write_text(page)
                    if pdf := self.printed(path):
                        archive.store_pdf(one, pdf, title, f"{job['digest']} {why}")
        self.jobs.set(job["series"], state, why)


def on_change(change, level, resource):
    if change == orthanc.ChangeType.ORTHANC_STARTED:
        threading.Thread(target=NODE.work_on, daemon=True).start()
    elif change == orthanc.ChangeType.STABLE_SERIES:
        try:
            NODE.arrived(resource)
        except Exception:
            orthanc.LogError(f"aventail: {traceback.format_exc()}")


def on_jobs(output, uri, **request):
    """GET: the queue. POST with the number of a series: that one again."""
    if request["method"] == "GET":
        output.AnswerBuffer(json.dumps(NODE.jobs.all(), indent=1), "application/json")
    elif request["method"] == "POST":
        job = NODE.jobs.get(request.get("body", b"").decode().strip())
        if job is None or job["state"] in ("running", "storing"):
            output.SendHttpStatusCode(404 if job is None else 409)
            return
        one = archive.series(job["series"])
        NODE.jobs.again(job["series"], archive.digest(one) if one else job["digest"])
        NODE.touch(job["patient"])
        output.AnswerBuffer("{}", "application/json")
    else:
        output.SendMethodNotAllowed("GET,POST")


NODE = Node()
orthanc.RegisterOnChangeCallback(on_change)
orthanc.RegisterRestCallback("/aventail/jobs", on_jobs)
