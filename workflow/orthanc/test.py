"""Runs the node in an Orthanc of its own on phantom patients: sends as a scanner does, and looks into the archive.

python workflow/orthanc/test.py PROGRAM FOLDER [FRACTIONS]     (Orthanc and DCMTK on PATH; FOLDER is made anew)
"""

import base64
import hashlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pydicom

HERE = Path(__file__).resolve().parent
# Series of a fraction's results: CT, structures, dose, three registrations.
RESULTS = {901: 1, 902: 1, 903: 1, 904: 1, 905: 1, 906: 1, 907: 1}
SECONDS = 600
# DCMTK, in storescu and in Orthanc: without it each image waits 80 ms for acknowledgements.
os.environ["TCP_NODELAY"] = "1"


def call(*words, **more):
    return subprocess.run([str(w) for w in words], check=True, **more)


def free_ports(count):
    """Ports of this machine that nothing listens on."""
    with_port = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in with_port]
    for one in with_port:
        one.close()
    return ports


class Archive:
    """An Orthanc with the node, which can be killed and started again."""

    def __init__(self, program, folder, rules):
        self.folder, self.process = folder, None
        self.http, self.dicom = free_ports(2)
        self.user = base64.b64encode(f"test:{(word := secrets.token_hex())}".encode()).decode()
        conf = folder / "conf"
        conf.mkdir(parents=True)
        # The configuration that the README has people copy, but for places and ports.
        lines = (HERE / "orthanc.json").read_text().splitlines()
        told = json.loads("\n".join(line for line in lines if not line.strip().startswith("//")))
        told |= {"StorageDirectory": str(folder / "db"), "IndexDirectory": str(folder / "db"), "StableAge": 2}
        told |= {"PythonScript": str(HERE / "node.py"), "Aventail": {"Rules": str(folder / "rules.toml")}}
        told |= {"HttpPort": self.http, "DicomPort": self.dicom}
        (conf / "orthanc.json").write_text(json.dumps(told))
        users = conf / "users.json"
        users.touch(0o600)
        users.write_text(json.dumps({"RegisteredUsers": {"test": word}}))
        head = f"program = {json.dumps(str(program))}\nwork = {json.dumps(str(folder / 'work'))}\n"
        (folder / "rules.toml").write_text(head + rules)

    def start(self):
        with open(self.folder / "log.txt", "a") as log:
            words = ["Orthanc", str(self.folder / "conf")]
            self.process = subprocess.Popen(words, stdout=log, stderr=log, cwd=self.folder)
        self.until("Orthanc answers", self.answers)
        return self

    def answers(self):
        assert self.process.poll() is None, (self.folder / "log.txt").read_text()[-2000:]
        try:
            return self.get("/system")
        except OSError:
            return None

    def kill(self):
        """As a power cut does, but that the program of the job is not touched."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self):
        self.process.terminate()
        self.process.wait(60)

    def ask(self, path, body=None, user=None):
        headers = {"Authorization": f"Basic {user or self.user}"} if user != "" else {}
        return urllib.request.urlopen(
            urllib.request.Request(f"http://127.0.0.1:{self.http}{path}", body, headers), timeout=60
        )

    def get(self, path):
        with self.ask(path) as answer:
            return json.load(answer)

    def jobs(self, patient=None):
        return [job for job in self.get("/aventail/jobs") if patient in (None, job["patient"])]

    def send(self, *folders, sender="SENDER"):
        words = [
            "storescu",
            "-aet",
            sender,
            "-aec",
            "AVENTAIL",
            "127.0.0.1",
            str(self.dicom),
            "+sd",
            "+r",
            *map(str, folders),
        ]
        return subprocess.run(words, check=False, capture_output=True).returncode

    def until(self, what, found):
        begun = time.monotonic()
        while not (value := found()):
            assert time.monotonic() - begun < SECONDS, (
                f"{what}: not within {SECONDS} s; {(self.folder / 'log.txt').read_text()[-2000:]}"
            )
            time.sleep(0.05)
        return value

    def until_state(self, patient, *states, count=1):
        """Waits until so many of a patient's jobs are in one of the states, and returns them."""

        def found():
            jobs = [job for job in self.jobs(patient) if job["state"] in states]
            return jobs if len(jobs) >= count else None

        return self.until(
            f"{count} of {patient} {' or '.join(states)}; now {[j['state'] for j in self.jobs(patient)]}", found
        )

    def series(self, patient):
        """Series of a patient by study and number, with their instances."""
        found = {}
        for one in self.patient(patient):
            number = int(one["MainDicomTags"].get("SeriesNumber") or 0)
            found.setdefault(one["ParentStudy"], []).append(
                (number, one["MainDicomTags"]["Modality"], len(one["Instances"]))
            )
        return {study: sorted(entries) for study, entries in found.items()}

    def patient(self, patient):
        with self.ask(
            "/tools/find", json.dumps({"Level": "Series", "Expand": True, "Query": {"PatientID": patient}}).encode()
        ) as answer:
            return json.load(answer)

    def fetch(self, one, folder):
        """A series as files."""
        folder.mkdir(parents=True)
        for n, instance in enumerate(sorted(one["Instances"])):
            with self.ask(f"/instances/{instance}/file") as answer:
                (folder / f"{n:05}.dcm").write_bytes(answer.read())

    def report(self, job):
        with self.ask(f"/series/{job['series']}/attachments/aventail-report/data") as answer:
            return answer.read().decode()


def uid_of(*parts):
    return f"2.25.{int.from_bytes(hashlib.sha256(' '.join(parts).encode()).digest()[:15], 'big')}"


def copy(source, out, patient, study=None, shift=0.0, change=None):
    """A copy of a folder for another patient, or as another study with all UIDs of its own, moved along z."""
    fresh = {}
    for path in sorted(source.rglob("*.dcm")):
        told = pydicom.dcmread(path)
        told.PatientID = patient
        if study is not None:
            for keyword in ["StudyInstanceUID", "SeriesInstanceUID", "SOPInstanceUID", "FrameOfReferenceUID"]:
                old = told[keyword].value
                told[keyword].value = fresh.setdefault(old, uid_of(study, patient, old))
            told.file_meta.MediaStorageSOPInstanceUID = told.SOPInstanceUID
            told.ImagePositionPatient[2] += shift
        else:
            renew(told, patient)
        if change:
            change(told)
        target = out / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        told.save_as(target)
    return out


def renew(told, patient):
    """The same UIDs cannot be of two patients: each is told from the old one and the patient, in all references too."""

    def change(_, element):
        if (
            element.VR == "UI"
            and element.keyword.endswith("InstanceUID")
            or element.keyword.endswith("FrameOfReferenceUID")
        ):
            element.value = uid_of(patient, element.value)

    told.walk(change)
    told.file_meta.MediaStorageSOPInstanceUID = told.SOPInstanceUID


def only_loopback_and_no_default(archive):
    for user in ["", base64.b64encode(b"orthanc:orthanc").decode()]:
        try:
            archive.ask("/system", user=user)
            raise AssertionError("the archive let a stranger in")
        except urllib.error.HTTPError as error:
            assert error.code == 401, error
    assert archive.send(HERE, sender="STRANGER") != 0


def row_of_fractions(archive, program, folder, phantom, count):
    """All fractions of a patient sent at once, Orthanc killed as the program works and as results are stored."""
    dicom = phantom / "dicom"
    planning = copy(dicom / "planning", folder / "ROW" / "planning", "ROW")
    sides = ["fraction", "fraction_2"]
    days = [
        copy(dicom / sides[n % 2], folder / "ROW" / f"day{n + 1}", "ROW", f"day {n + 1}", 1.5 * n) for n in range(count)
    ]
    assert archive.send(planning) == 0
    begun = time.monotonic()
    assert archive.send(*days) == 0

    archive.until_state("ROW", "running")
    time.sleep(0.5)
    archive.kill()
    archive.start()
    before = len(archive.until_state("ROW", "done"))
    archive.until_state("ROW", "storing")
    archive.kill()
    archive.start()
    done = archive.until_state("ROW", "done", count=count)
    print(
        f"{count} fractions from storescu to the archive, killed twice: {time.monotonic() - begun:.0f} s; {before} done before the 2nd"
    )
    assert len(done) == count and {job["tries"] for job in done} <= {1, 2}, done

    sent = {len(list(day.iterdir())) for day in days}
    studies = [entries for entries in archive.series("ROW").values() if len(entries) > 4]
    assert len(studies) == count, archive.series("ROW")
    for entries in studies:
        counts = {number: instances for number, _, instances in entries}
        has_pdf = {909: 1} if shutil.which("chromium") else {}
        wanted = {**RESULTS, 901: counts[1], 1: counts[1]} | has_pdf
        assert counts[1] in sent and counts == wanted and len(entries) == len(wanted), entries
    for job in done:
        page = archive.report(job)
        assert "<html" in page and len(page) > 100_000
    asked = call(
        "findscu",
        "-S",
        "-aet",
        "SENDER",
        "-aec",
        "AVENTAIL",
        "127.0.0.1",
        archive.dicom,
        "-k",
        "QueryRetrieveLevel=SERIES",
        "-k",
        "PatientID=ROW",
        "-k",
        "Modality=REG",
        "-k",
        "SeriesInstanceUID",
        capture_output=True,
        text=True,
    )
    assert (asked.stdout + asked.stderr).count("(0020,000e) UI [") >= 3 * count, asked

    # The same objects as a run by hand on the archive's files: storescu writes them anew, and UIDs follow from bytes.
    alone = folder / "ROW" / "alone"
    for one in archive.patient("ROW"):
        kind = one["MainDicomTags"]["Modality"]
        mine = one["ID"] == done[0]["series"]
        if (
            mine
            or "planning" in one["MainDicomTags"]["SeriesDescription"]
            and one["MainDicomTags"]["SeriesNumber"] == "1"
        ):
            archive.fetch(one, alone / ("day" if mine else "planning"))
        elif kind in ("RTSTRUCT", "RTDOSE") and len(one["MainDicomTags"]["SeriesNumber"]) == 1:
            archive.fetch(one, alone / kind)
    inputs = [
        "--planning",
        alone / "planning",
        "--fraction",
        alone / "day",
        "--bones",
        phantom / "bones.nii.gz",
        "--dicom",
    ]
    more = ["--structures", alone / "RTSTRUCT/00000.dcm", "--dose", alone / "RTDOSE/00000.dcm"]
    more += ["--config", folder / "fast.toml", "--quiet", "--out", alone / "out"]
    call(program, "register", *inputs, *more, stdout=subprocess.DEVNULL)
    by_hand = list((alone / "out/dicom").rglob("*.dcm"))
    assert len(by_hand) > 6
    for path in by_hand:
        uid = pydicom.dcmread(path, stop_before_pixels=True, specific_tags=["SOPInstanceUID"]).SOPInstanceUID
        with archive.ask("/tools/lookup", uid.encode()) as answer:
            assert len(json.load(answer)) == 1, path

    # What is sent once more changes nothing.
    total, before = archive.get("/statistics")["CountInstances"], archive.jobs("ROW")
    assert archive.send(*days[:2]) == 0
    time.sleep(5)
    assert archive.get("/statistics")["CountInstances"] == total and archive.jobs("ROW") == before
    assert sum(job["state"] == "planning" for job in before) == 1


def refused(archive, folder, dicom):
    """A patient whose structure set has no bones: nothing is stored, a report tells why; it can be asked for again."""
    own = copy(dicom / "planning", folder / "BONELESS" / "planning", "BONELESS")
    day = copy(dicom / "fraction", folder / "BONELESS" / "day", "BONELESS", "day")
    assert archive.send(own, day) == 0
    job = archive.until_state("BONELESS", "refused")[0]
    page = archive.report(job)
    assert "bones-unnamed" in page and "remedy" in page and "nothing was stored" in page, page
    assert "bones-unnamed" in job["why"]
    assert sum(len(entries) for entries in archive.series("BONELESS").values()) == 4, archive.series("BONELESS")
    with archive.ask("/aventail/jobs", job["series"].encode()):
        pass
    archive.until(
        "refused again",
        lambda: (
            archive.jobs("BONELESS")
            and [j for j in archive.jobs("BONELESS") if j["state"] == "refused" and j["ended"] > job["ended"]]
        ),
    )
    pdf = copy(dicom / "planning", folder / "PRINTED" / "planning", "PRINTED")
    day = copy(dicom / "fraction", folder / "PRINTED" / "day", "PRINTED", "day")
    assert archive.send(pdf, day) == 0
    archive.until_state("PRINTED", "refused")
    kinds = sorted(one["MainDicomTags"]["Modality"] for one in archive.patient("PRINTED"))
    assert kinds == ["CT", "CT", *(["DOC"] if shutil.which("chromium") else []), "RTDOSE", "RTSTRUCT"], kinds


def two_structure_sets(archive, folder, dicom):
    """Two structure sets that can be meant: refused by name, not guessed."""
    own = copy(dicom / "planning", folder / "TWO" / "planning", "TWO")

    def other(told):
        told.SOPInstanceUID = told.file_meta.MediaStorageSOPInstanceUID = uid_of("two")
        told.StructureSetLabel = "SECOND"

    told = pydicom.dcmread(own / "RS.dcm")
    other(told)
    told.save_as(own / "RS2.dcm")
    assert archive.send(own, copy(dicom / "fraction", folder / "TWO" / "day", "TWO", "day")) == 0
    assert "SECOND" in archive.until_state("TWO", "refused")[0]["why"]


def in_any_order(archive, folder, dicom):
    """The fraction before its planning side, the dose last of all; and a series that grows after it was registered."""
    own = copy(dicom / "planning", folder / "LATE" / "planning", "LATE")
    day = copy(dicom / "fraction", folder / "LATE" / "day", "LATE", "day")
    slices = sorted(day.iterdir())
    rest = folder / "LATE" / "rest"
    rest.mkdir()
    for path in slices[-6:]:
        path.rename(rest / path.name)
    dose = folder / "LATE" / "dose"
    dose.mkdir()
    (own / "RD.dcm").rename(dose / "RD.dcm")
    assert archive.send(day) == 0
    archive.until("waits for planning", lambda: [j for j in archive.jobs("LATE") if "structure set" in j["why"]])
    assert archive.send(own) == 0
    archive.until("waits for the dose", lambda: [j for j in archive.jobs("LATE") if "dose" in j["why"]])
    assert archive.send(dose) == 0
    first = archive.until_state("LATE", "done")[0]
    assert archive.send(rest) == 0
    archive.until(
        "done again", lambda: [j for j in archive.jobs("LATE") if j["state"] == "done" and "grown" in j["note"]]
    )
    images = [n for entries in archive.series("LATE").values() for number, _, n in entries if number == 901]
    assert sorted(images) == [len(slices) - 6, len(slices)], images
    assert first["note"] == ""


def main():
    program, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 4
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "fast.toml").write_text('preset = "fast"\n')
    phantom = folder / "phantom"
    call(program, "phantom", "--dicom", "--spacing", "6x6x6", "--out", phantom, "--quiet", stdout=subprocess.DEVNULL)
    with_labels, settings = json.dumps(str(phantom / "bones.nii.gz")), json.dumps(str(folder / "fast.toml"))
    rules = "".join(
        f"[[rule]]\npatients = {patients}\nlabels = {labels}\nsettings = {settings}\nat_refusal = '{refusal}'\n"
        for patients, labels, refusal in [
            (["ROW", "LATE", "TWO"], with_labels, "attach"),
            (["BONELESS"], '"structures"', "attach"),
            (["PRINTED"], '"structures"', "pdf"),
        ]
    )
    archive = Archive(program, folder / "archive", rules)
    dicom = phantom / "dicom"
    try:
        archive.start()
        only_loopback_and_no_default(archive)
        # A patient without a rule: what came is kept, and nothing is done.
        assert archive.send(copy(dicom / "planning", folder / "OTHER" / "planning", "OTHER")) == 0
        row_of_fractions(archive, program, folder, phantom, count)
        refused(archive, folder, dicom)
        two_structure_sets(archive, folder, dicom)
        in_any_order(archive, folder, dicom)
        assert not archive.jobs("OTHER")
        left = [path.name for path in (archive.folder / "work").iterdir() if path.is_dir() and path.name != "runs"]
        left += [str(path) for path in (archive.folder / "work/runs").glob("*/*")]
        assert not left, f"images of patients are left: {left}"
        archive.stop()
    finally:
        if archive.process and archive.process.poll() is None:
            archive.kill()


if __name__ == "__main__":
    main()
