"""Runs of registration tools between scans of one patient, kept in a folder; what is finished there is not run again."""
import json
import os
import resource

import SimpleITK as sitk
from fields import Image, patient
from tools import TOOLS, Job

# The tools that need bone labels; the second scan's are the first's, carried by the tool's own field.
NEED_BONES = ("aventail", "fast")


def processor_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


class Runs:
    def __init__(self, program, scans, bones, names, out, threads=0, affine=False, more=()):
        """Scans by their names, the first the one that the bones are of; more: options of aventail alone."""
        self.program, self.scans, self.bones, self.names, self.out = program, scans, bones, names, out
        self.threads, self.affine, self.more = threads, affine, list(more)
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
            found = sitk.GetImageFromArray(patient(Image(image).values).astype("uint8").transpose(2, 1, 0))
            found.CopyInformation(image)
            sitk.WriteImage(found, file)
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
                job.mask = self.mask(a)
                field = TOOLS[tool](job)
            done = {"field": os.path.relpath(field, self.out), "processor_s": round(processor_seconds() - before, 1)}
        except RuntimeError as error:
            done = {"failed": str(error)}
        with open(record, "w", encoding="utf-8") as file:
            json.dump(done, file, indent=1)
        return done
