"""Runs of registration tools between scans of one patient, kept in a folder; what is finished there is not run again."""
import json
import os
import resource

import measures
import SimpleITK as sitk
from fields import Image, patient, write_like
from tools import TOOLS, Job

# The tools that need bone labels; the second scan's are the first's, carried by the tool's own field.
NEED_BONES = ("aventail", "fast")


def processor_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


class Runs:
    def __init__(self, program, scans, bones, names, out, threads=0, affine=False, more=(), air=True):
        """Scans by their names, the first the one that the bones are of; more: options of aventail alone.

        air: whether the masks of the other tools hold the air in the patient.
        """
        self.program, self.scans, self.bones, self.names, self.out = program, scans, bones, names, out
        self.threads, self.affine, self.more, self.air = threads, affine, list(more), air
        self.first = next(iter(scans))

    def folder(self, tool, a, b):
        return f"{self.out}/{tool}/{a}_{b}"

    def mask(self, scan):
        """File of the patient in a scan: as aventail found him where it has registered this scan, else by a threshold."""
        for other in self.scans:
            found = f"{self.folder('aventail', scan, other)}/body.nii.gz"
            if os.path.exists(found):
                return found
        file = f"{self.out}/patient_{scan}.nii.gz"
        if not os.path.exists(file):
            image = sitk.ReadImage(self.scans[scan])
            write_like(image, patient(Image(image).values).astype("uint8"), file)
        return file

    def tissue(self, scan):
        """File of the patient without air."""
        file = f"{self.out}/tissue_{scan}.nii.gz"
        if not os.path.exists(file):
            image = sitk.ReadImage(self.scans[scan])
            inside = measures.without_air(Image(image).values, Image(self.mask(scan)).values > 0)
            write_like(image, inside.astype("uint8"), file)
        return file

    def run(self, tool, a, b):
        """A record of the run from scan a to b: the field's file and processor seconds, or what went wrong."""
        folder = self.folder(tool, a, b)
        record = f"{folder}/run.json"
        if os.path.exists(record):
            with open(record, encoding="utf-8") as file:
                return json.load(file)
        os.makedirs(folder, exist_ok=True)
        job = Job(self.program, self.scans[a], self.scans[b], self.bones, self.names, out=folder, threads=self.threads, affine=self.affine)
        before = processor_seconds()
        try:
            if tool in NEED_BONES:
                if a != self.first:
                    job.bones, job.names = f"{self.folder(tool, self.first, a)}/bones_on_fraction.nii.gz", None
                field = TOOLS[tool](job, self.more)
            else:
                job.mask = self.mask(a) if self.air else self.tissue(a)
                field = TOOLS[tool](job)
            done = {"field": os.path.relpath(field, self.out), "processor_s": round(processor_seconds() - before, 1)}
        except RuntimeError as error:
            done = {"failed": str(error)}
        with open(record, "w", encoding="utf-8") as file:
            json.dump(done, file, indent=1)
        return done
