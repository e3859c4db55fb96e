"""Measuring any tool's fields, and looking at bone labels."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from . import _errors, _given
from ._case import Landmarks, Settings, landmark_source, settings_source
from ._field import FieldLike, field_source, taken
from ._image import ImageLike, Names, label_source, name_source, source_or_none
from ._native import native as _aventail
from ._progress import Progress, told
from ._registration import Registration

if TYPE_CHECKING:
    from .reports import Assessment, Skeleton


def both(
    fields: Registration | FieldLike | None, push: FieldLike | None, pull: FieldLike | None
) -> tuple[Any, Any]:
    """Both directions as the compiled module takes them."""
    if fields is not None and (push is not None or pull is not None):
        raise _errors.usage(
            "fields is given, and planning_to_fraction or fraction_to_planning too", "give fields, or the directions"
        )
    if isinstance(fields, Registration):
        push, pull = fields.planning_to_fraction, fields.fraction_to_planning
    elif fields is not None:
        field = taken("fields", fields, "planning", "fraction")
        push, pull = (field, None) if field.start != "fraction" else (None, field)
    there = field_source("planning_to_fraction", push, "planning", "fraction")
    return there, field_source("fraction_to_planning", pull, "fraction", "planning")


def evaluate(
    fields: Registration | FieldLike | None = None,
    *,
    planning_to_fraction: FieldLike | None = None,
    fraction_to_planning: FieldLike | None = None,
    planning: ImageLike | None = None,
    fraction: ImageLike | None = None,
    mask: ImageLike | None = None,
    bones: ImageLike | None = None,
    labels: Names | None = None,
    structures: ImageLike | None = None,
    structures_fraction: ImageLike | None = None,
    structure_names: Names | None = None,
    landmarks: Landmarks | None = None,
    settings: Settings = None,
    threads: int = 0,
    progress: Progress = None,
) -> Assessment:
    """Measures a displacement field of any tool with all inputs that you give (docs/metrics.md has the formulas).

    ``fields`` is a registration or one field; otherwise give ``planning_to_fraction``,
    ``fraction_to_planning`` or both. A missing direction is computed by inversion. ``mask`` is the
    region to measure in; the default is the patient in the planning CT. Structures of the same name
    in planning and fraction are compared. Of ``settings`` only the limits of the verdict are used,
    ``{"verdict": {"dice": [0.9, 0.8]}}``.

    >>> import aventail
    >>> phantom = aventail.phantom(spacing=(6, 6, 6))
    >>> found = aventail.evaluate(phantom.truth, bones=phantom.bones, landmarks=phantom.landmarks)
    >>> found["landmarks"]["after"]["mean"] < 0.5
    True
    """
    directions = both(fields, planning_to_fraction, fraction_to_planning)
    for name, idle in (
        ("labels", labels is not None and bones is None),
        ("structure_names", structure_names is not None and structures is None and structures_fraction is None),
    ):
        if idle:
            raise _errors.usage(f"{name} is given without what it names", "give bones or structures too")
    own_names: Any = name_source("structure_names", structure_names)
    given: dict[str, Any] = {
        "planning": source_or_none("planning", planning),
        "fraction": source_or_none("fraction", fraction),
        "mask": source_or_none("mask", mask),
        "bones": None,
        "labels": None,
        "structures": None,
        "structures_fraction": None,
        "structure_names": own_names,
        "landmarks": landmark_source("landmarks", landmarks),
    }
    if bones is not None:
        given["bones"], given["labels"] = label_source(bones, labels)
    for key, thing in (("structures", structures), ("structures_fraction", structures_fraction)):
        if thing is not None:
            given[key], names = label_source(thing, structure_names, key)
            given["structure_names"] = given["structure_names"] or names
    limits, threads = settings_source(settings), _given.whole("threads", threads)
    with told(progress) as function:
        assessment: Assessment = json.loads(_aventail.evaluate(directions, given, limits, (threads, function)))
    return assessment


def skeleton(bones: ImageLike, labels: Names | None = None) -> Skeleton:
    """Builds and checks the joint tree of bone labels; ``["text"]`` is the tree as the command line prints it.

    >>> import aventail
    >>> tree = aventail.skeleton(aventail.phantom(spacing=(6, 6, 6)).bones)
    >>> len(tree["bones"])
    42
    """
    given, names = label_source(bones, labels)
    found, text = _aventail.skeleton(given, names)
    out: Skeleton = json.loads(found)
    out["text"] = text
    return out
