"""What a registration and a pose are given, as the compiled module takes it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, Union

from numpy.typing import ArrayLike

from . import _errors, _given
from ._image import Names, Path, label_source

Preset: TypeAlias = Literal["default", "fast", "thesis"]
"""Names of presets; docs/settings.md describes them."""
Settings: TypeAlias = Union[Preset, Path, Mapping[str, Any], None]
"""A preset, a TOML file (or the report.json of a run), or a dict nested as the TOML is."""
Landmarks: TypeAlias = Union[Path, Mapping[str, "tuple[Sequence[float], Sequence[float]]"]]
"""Points known in both images: a CSV file, or ``{name: (planning, fraction)}``, LPS mm."""
BoneLandmarks: TypeAlias = Union[Path, Sequence["tuple[str, str, Sequence[float], Sequence[float]]"]]
"""Landmarks on bones: a CSV file with a column ``bone``, or ``(bone, name, planning, fraction)``."""

_PRESETS = ("default", "fast", "thesis")
_PAIRS = "give a CSV file, or {name: (planning, fraction)}, each x, y, z in LPS mm"
_ON_BONES = "give a CSV file, or a list of (bone, name, planning, fraction), the last two x, y, z in LPS mm"


def settings_source(settings: Settings) -> dict[str, Any]:
    """Settings as the compiled module takes them."""
    out: dict[str, Any] = {"json": None, "file": None, "preset": None}
    if isinstance(settings, Mapping):
        out["json"] = _given.json_text("the settings", settings, "compare with docs/settings.md")
    elif isinstance(settings, str) and (settings in _PRESETS or "." not in settings and not os.path.exists(settings)):
        out["preset"] = settings
    elif settings is not None:
        if not _given.is_path(settings):
            raise _given.wrong("settings", settings, "give a preset's name, a file, or a dict nested as the TOML is")
        out["file"] = _given.path("settings", settings)
    return out


def landmark_source(name: str, landmarks: Landmarks | None) -> Any:
    """Landmarks as the compiled module takes them."""
    if landmarks is None or _given.is_path(landmarks):
        return _given.path_or_none(name, landmarks)
    out = []
    for point, pair in _given.named(name, landmarks, _PAIRS):
        both = _given.several(f"{name}[{point!r}]", pair, _PAIRS)
        if len(both) != 2:
            raise _given.wrong(f"{name}[{point!r}]", pair, _PAIRS)
        out.append((point, *(_given.three(f"{name}[{point!r}]", each, _PAIRS) for each in both)))
    return out


def bone_landmark_source(landmarks: BoneLandmarks | None) -> Any:
    """Landmarks on bones as the compiled module takes them."""
    if landmarks is None or _given.is_path(landmarks):
        return _given.path_or_none("bone_landmarks", landmarks)
    out = []
    for n, entry in enumerate(_given.several("bone_landmarks", landmarks, _ON_BONES)):
        name = f"bone_landmarks[{n}]"
        parts = _given.several(name, entry, _ON_BONES)
        if len(parts) != 4:
            raise _given.wrong(name, entry, _ON_BONES)
        bone, own = (_given.word(name, part) for part in parts[:2])
        out.append((bone, own, *(_given.three(name, part, _ON_BONES) for part in parts[2:])))
    return out


def more(
    names: Any,
    landmarks: Landmarks | None,
    bone_landmarks: BoneLandmarks | None,
    skeleton: Path | None,
    start: ArrayLike | None,
    bones_folder: Path | None = None,
) -> dict[str, Any]:
    """What goes beside the images."""
    return {
        "labels": names,
        "landmarks": landmark_source("landmarks", landmarks),
        "bone_landmarks": bone_landmark_source(bone_landmarks),
        "skeleton": _given.path_or_none("skeleton", skeleton),
        "start": None if start is None else _given.matrix("start", start),
        "organs": None,
        "volume_change": [],
        "bones_folder": _given.path_or_none("bones_folder", bones_folder),
        "guide": None,
        "dicom": False,
        "structures": None,
        "dose": None,
        "anonymous": False,
        "same_frame": False,
    }


def fraction_bones(
    bones: Any, names: Names | None, fractions: int, several: bool
) -> list[tuple[Any, Any] | None]:
    """Labels of each fraction's bones with their names, in the fractions' order."""
    if bones is None:
        if names is not None:
            raise _errors.usage("fraction_labels are given without fraction_bones", "give the label map that they name")
        return [None] * fractions
    if several and not isinstance(bones, (list, tuple)):
        raise _given.wrong("fraction_bones", bones, "several fractions have a list of labels, or None")
    given = list(bones) if several else [bones]
    if len(given) != fractions:
        raise _errors.usage(f"{len(given)} label maps are given for {fractions} fractions", "give one for each, or None")
    return [None if own is None else label_source(own, names, "fraction_bones") for own in given]


def guides(
    guide: Any, fraction_guide: Any, names: Names | None, fractions: int, several: bool
) -> tuple[tuple[Any, Any] | None, list[tuple[Any, Any] | None]]:
    """Structures that guide: planning's, and those of each fraction in their order."""
    if (guide is None) != (fraction_guide is None) or guide is None and names is not None:
        raise _errors.usage(
            "guides are given for one scan only; they need the structures of both",
            "give guide and fraction_guide",
        )
    if guide is None:
        return None, [None] * fractions
    if several and not isinstance(fraction_guide, (list, tuple)):
        raise _given.wrong("fraction_guide", fraction_guide, "several fractions have a list of structures")
    given = list(fraction_guide) if several else [fraction_guide]
    if len(given) != fractions or any(own is None for own in given):
        raise _errors.usage(f"{len(given)} fraction_guide are given for {fractions} fractions", "give one for each")
    own = [label_source(each, names, "fraction_guide") for each in given]
    return label_source(guide, names, "guide"), list(own)


def give_back(
    dicom: bool, structures: Path | None, dose: Path | None, anonymous: bool, same_frame: bool
) -> dict[str, Any]:
    """What goes back to a planning system."""
    flags = {"dicom": dicom, "anonymous": anonymous, "same_frame": same_frame}
    paths = {"structures": structures, "dose": dose}
    out: dict[str, Any] = {name: _given.flag(name, thing) for name, thing in flags.items()}
    out |= {name: _given.path_or_none(name, thing) for name, thing in paths.items()}
    if not out["dicom"] and (structures is not None or dose is not None):
        raise _errors.usage(
            "structures and dose go back as DICOM, which is not asked for", "give dicom=True too, or leave them out"
        )
    return out


def volume_changes(volume_change: Mapping[str, float] | None) -> list[tuple[str, float]]:
    """Changes of organs' volumes."""
    remedy = 'give volumes after over before by organ, {"parotid_left": 0.8}'
    changes = [] if volume_change is None else _given.named("volume_change", volume_change, remedy)
    return [(organ, _given.number(f"volume_change[{organ!r}]", factor, remedy)) for organ, factor in changes]


def pose_text(pose: Any, couch: Mapping[str, Any] | None) -> str:
    """A pose file's text; JSON's texts, numbers and lists are TOML's."""

    def lines(name: str, given: Any) -> list[str]:
        remedy = "give numbers and lists of them: flexion_deg, lateral_deg, axial_deg, shift_mm"
        entries = _given.named(name, given, remedy)
        return [f"{json.dumps(key)} = {_given.json_text(name, value, remedy)}" for key, value in entries]

    out = [] if couch is None else ["[couch]", *lines("couch", couch)]
    remedy = 'give {"skull": {"axial_deg": 10.0}} or a pose file'
    for bone, motion in _given.named("pose", {} if pose is None else pose, remedy):
        out += [f"[bones.{json.dumps(bone)}]", *lines(f"pose[{bone!r}]", motion)]
    return "\n".join(out)
