"""The archive, by Orthanc's interface: the planning side of a fraction, files out of it, results into it."""

import base64
import hashlib
import json
from dataclasses import dataclass

import orthanc
import rules

RESULTS = range(901, 910)
# The number of the series of reports, after those of the results.
REPORT = 909


class Waits(Exception):
    """What is needed is not there yet."""


class Refused(Exception):
    """What is there cannot be used, and no waiting changes that."""


@dataclass
class Planning:
    """One planning side: series of the CT, instances of the structure set and of the dose (or None)."""

    ct: str
    structures: str
    dose: str


def get(path):
    return json.loads(orthanc.RestApiGet(path))


def tags(instance):
    """Attributes by keyword; long values are left out by Orthanc."""
    return get(f"/instances/{instance}/simplified-tags")


def series(identifier):
    """What Orthanc knows of a series, or None where it was deleted meanwhile."""
    try:
        return get(f"/series/{identifier}")
    except orthanc.OrthancException:
        return None


def number(text):
    try:
        return int(text)
    except (TypeError, ValueError):
        return None


def own(one):
    """Whether a series holds results: marked by this node, or told by what the program writes."""
    if "aventail-of" in get(f"/series/{one['ID']}/metadata"):
        return True
    main = one["MainDicomTags"]
    return main.get("Manufacturer") == "aventail" and number(main.get("SeriesNumber")) in RESULTS


def digest(one):
    """Of the instances that a series has."""
    return hashlib.sha256("".join(sorted(one["Instances"])).encode()).hexdigest()


def patient_of(one):
    """Orthanc's number of the patient, and the Patient ID."""
    patient = get(f"/series/{one['ID']}/patient")
    return patient["ID"], patient["MainDicomTags"].get("PatientID", "")


def of_modality(patient, modality):
    """Series of a patient that are no results."""
    found = [one for one in get(f"/patients/{patient}/series") if one["MainDicomTags"].get("Modality") == modality]
    return [one for one in found if not own(one)]


def referenced_series(structure_tags):
    """Series that a structure set is drawn on."""
    return {
        entry.get("SeriesInstanceUID")
        for frame in structure_tags.get("ReferencedFrameOfReferenceSequence") or []
        for study in frame.get("RTReferencedStudySequence") or []
        for entry in study.get("RTReferencedSeriesSequence") or []
    }


def is_planning(patient, uid, rule):
    """Whether a structure set of planning is drawn on a series."""
    return any(uid in referenced_series(told) for _, told in structure_sets(patient, rule))


def structure_sets(patient, rule):
    instances = [instance for one in of_modality(patient, "RTSTRUCT") for instance in settled(one)["Instances"]]
    found = [(instance, tags(instance)) for instance in instances]
    return [(instance, told) for instance, told in found if rules.fits(rule.structures_have, told)]


def settled(one):
    if not one["IsStable"]:
        raise Waits(f"a series is still coming in: {one['MainDicomTags'].get('Modality')}")
    return one


def planning_of(patient, rule):
    """The planning side of a patient. Never guesses: several are refused unless the rule takes the newest."""
    sets = structure_sets(patient, rule)
    if not sets:
        raise Waits("no structure set of planning is in the archive")
    scans = {one["MainDicomTags"]["SeriesInstanceUID"]: one for one in of_modality(patient, "CT")}
    sets = [
        (instance, told, [scans[uid] for uid in referenced_series(told) if uid in scans]) for instance, told in sets
    ]
    sets = [entry for entry in sets if entry[2]]
    if not sets:
        raise Waits("the CT that the structure set is drawn on is not in the archive")
    instance, told, drawn_on = one_of(sets, rule, "structure sets", "StructureSetLabel", "StructureSet")
    if len(drawn_on) > 1:
        raise Refused(f"the structure set {told.get('StructureSetLabel')} is drawn on {len(drawn_on)} series")
    ct = settled(drawn_on[0])
    return Planning(ct["ID"], instance, dose_of(patient, rule, tags(ct["Instances"][0]), told))


def dose_of(patient, rule, ct_tags, structure_tags):
    if rule.dose == "none":
        return None
    doses = []
    for instance in [instance for one in of_modality(patient, "RTDOSE") for instance in settled(one)["Instances"]]:
        told = tags(instance)
        here = told.get("FrameOfReferenceUID") == ct_tags.get("FrameOfReferenceUID")
        whole = told.get("DoseSummationType") in ("PLAN", "MULTI_PLAN")
        if here and whole and not of_other_plan(told, structure_tags):
            doses.append((instance, told, None))
    if doses:
        return one_of(doses, rule, "doses", "SeriesDescription", "InstanceCreation")[0]
    if rule.dose == "required":
        raise Waits("no dose of the plan (PLAN or MULTI_PLAN, in the frame of reference of planning) is in the archive")
    return None


def of_other_plan(dose_tags, structure_tags):
    """Whether the plan of a dose is here and was made on other structures."""
    for reference in dose_tags.get("ReferencedRTPlanSequence") or []:
        for plan in find("Instance", {"SOPInstanceUID": reference.get("ReferencedSOPInstanceUID") or "-"}):
            sets = tags(plan).get("ReferencedStructureSetSequence") or []
            if sets and structure_tags["SOPInstanceUID"] not in [s.get("ReferencedSOPInstanceUID") for s in sets]:
                return True
    return False


def one_of(entries, rule, what, name, when):
    """The only entry, or the newest; each is (instance, tags, more)."""
    if len(entries) == 1:
        return entries[0]
    age = lambda entry: (entry[1].get(f"{when}Date") or "", entry[1].get(f"{when}Time") or "")
    entries = sorted(entries, key=age)
    if rule.planning == "newest" and age(entries[-1])[0] and age(entries[-1]) != age(entries[-2]):
        return entries[-1]
    named = "; ".join(
        f"{e[1].get(name) or 'without a name'} of {' '.join(age(e)).strip() or 'no date'}" for e in entries
    )
    raise Refused(
        f"the patient has {len(entries)} {what} that can be meant ({named}). Choose with `structures_have` or "
        '`planning = "newest"` in the rules, or remove those that do not count'
    )


def find(level, query):
    return json.loads(orthanc.RestApiPost("/tools/find", json.dumps({"Level": level, "Query": query})))


def export(instances, folder):
    """Writes instances as files."""
    folder.mkdir(parents=True)
    for n, instance in enumerate(sorted(instances)):
        (folder / f"{n:05}.dcm").write_bytes(orthanc.GetDicomForInstance(instance))


def store(files):
    """Puts files into the archive; those that are there stay. Returns the instances, and their series."""
    stored = {}
    for path in files:
        told = json.loads(orthanc.RestApiPost("/instances", path.read_bytes()))
        if told["Status"] not in ("Success", "AlreadyStored"):
            raise OSError(f"{path.name} was not stored: {told['Status']}")
        stored[told["ID"]] = told["ParentSeries"]
    return stored


def mark(identifier, state):
    """Says of the series of a fraction what became of it."""
    orthanc.RestApiPut(f"/series/{identifier}/metadata/aventail", state)


def mark_result(identifier, fraction):
    """Says of a series of results which fraction's they are."""
    orthanc.RestApiPut(f"/series/{identifier}/metadata/aventail-of", fraction)


def attach(identifier, page):
    """The report of a fraction, as an attachment of its series; a later one replaces it."""
    orthanc.RestApiPut(f"/series/{identifier}/attachments/aventail-report", page)


def store_pdf(one, pdf, title, seed):
    """A report as encapsulated PDF in the study of the fraction; the same seed is stored once."""
    uid = lambda what: f"2.25.{int.from_bytes(hashlib.sha256(f'{seed} {what}'.encode()).digest()[:16], 'big')}"
    content = "data:application/pdf;base64," + base64.b64encode(pdf).decode()
    named = {"SeriesDescription": title, "DocumentTitle": title, "Modality": "DOC", "SeriesNumber": str(REPORT)}
    named |= {"Manufacturer": "aventail", "SeriesInstanceUID": uid("series"), "SOPInstanceUID": uid("instance")}
    asked = {"Parent": one["ParentStudy"], "Force": True, "Tags": named, "Content": content}
    made = json.loads(orthanc.RestApiPost("/tools/create-dicom", json.dumps(asked)))
    mark_result(made["ParentSeries"], one["ID"])
