"""Measuring any tool's fields, and looking at bone labels."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from . import _aventail
from ._field import Field, FieldLike, field_source
from ._image import ImageLike, Names, label_source, name_source, source
from ._progress import Progress, told
from ._registration import Landmarks, Registration, landmark_source

if TYPE_CHECKING:
    from .reports import Assessment, Skeleton


def both(
    fields: Registration | FieldLike | None, push: FieldLike | None, pull: FieldLike | None
) -> tuple[Any, Any]:
    """Both directions as the compiled module takes them."""
    if isinstance(fields, Registration):
        push, pull = fields.planning_to_fraction, fields.fraction_to_planning
    elif fields is not None:
        field = Field.of(fields, "planning", "fraction")
        push, pull = (field, None) if field.start != "fraction" else (None, field)
    return field_source(push, "planning", "fraction"), field_source(pull, "fraction", "planning")


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
    threads: int = 0,
    progress: Progress = None,
) -> Assessment:
    """Measures a field, of any tool, with everything that is given (docs/metrics.md has the formulas).

    ``fields`` is a registration or one field; else name the direction. A direction that is missing is made by inversion.
    ``mask`` says where to measure; without it the patient in the planning CT. Structures of one name in planning and
    fraction are compared.

    >>> import aventail
    >>> phantom = aventail.phantom(spacing=(6, 6, 6))
    >>> found = aventail.evaluate(phantom.truth, bones=phantom.bones, landmarks=phantom.landmarks)
    >>> found["landmarks"]["after"]["mean"] < 0.5
    True
    """
    push, pull = both(fields, planning_to_fraction, fraction_to_planning)
    own_names: Any = name_source(structure_names)
    given: dict[str, Any] = {
        "planning": None if planning is None else source(planning),
        "fraction": None if fraction is None else source(fraction),
        "mask": None if mask is None else source(mask),
        "bones": None,
        "labels": None,
        "structures": None,
        "structures_fraction": None,
        "structure_names": own_names,
        "landmarks": landmark_source(landmarks),
    }
    if bones is not None:
        given["bones"], given["labels"] = label_source(bones, labels)
    for key, thing in (("structures", structures), ("structures_fraction", structures_fraction)):
        if thing is not None:
            given[key], names = label_source(thing, structure_names, key)
            given["structure_names"] = given["structure_names"] or names
    with told(progress) as function:
        assessment: Assessment = json.loads(_aventail.evaluate(push, pull, given, threads, function))
    return assessment


def skeleton(bones: ImageLike, labels: Names | None = None) -> Skeleton:
    """The joint tree of bone labels, checked; ``["text"]`` is it as the program prints it.

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
