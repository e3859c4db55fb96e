"""Exceptions by cause.

Every message names the file or object, the value found, and what to do about it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar


class Error(Exception):
    """Base class of aventail's errors; there is a subclass for each cause.

    ``str(error)`` is the message that the command line prints.
    """

    exit_code: int = 1
    """Exit code of the command line for this cause."""

    def __init__(self, message: str, what: str | None, cause: str, remedy: str, code: str = "") -> None:
        super().__init__(message, what, cause, remedy, code)
        self.message = message
        self.what = what
        """The file or object at fault; ``None`` if there is none."""
        self.cause = cause
        """What is wrong, with the value found."""
        self.remedy = remedy
        """What to do about it."""
        self.code = code
        """Stable code of the error, as in docs/refusals.md; empty if it has none."""

    def __str__(self) -> str:
        return self.message


class InternalError(Error):
    """An internal error: a bug in aventail."""


class UsageError(Error):
    """An argument or a setting is wrong."""

    exit_code = 2


class ReadError(Error):
    """A file is missing, truncated, or not in a format that can be read."""

    exit_code = 3


class InputError(Error):
    """The inputs do not fit the task or each other."""

    exit_code = 4


class WriteError(Error):
    """A result cannot be written."""

    exit_code = 5


class RegistrationError(Error):
    """The registration failed: it has no reliable result."""

    exit_code = 6


_KINDS: dict[int, type[Error]] = {
    kind.exit_code: kind
    for kind in (InternalError, UsageError, ReadError, InputError, WriteError, RegistrationError)
}


# What the program's options are called here. An option that is not named is no argument of the package, or another program's.
_ARGUMENTS: dict[str, str] = {
    "bone-landmarks": "bone_landmarks",
    "bones": "bones",
    "cbct": "cbct",
    "config": "settings",
    "ct": "ct",
    "dicom-like": "like",
    "dose": "dose",
    "dvf-format": "format",
    "fit": "runs",
    "fraction": "fraction",
    "fraction-bones": "fraction_bones",
    "fraction-guide": "fraction_guide",
    "fraction-labels": "fraction_labels",
    "fraction-to-planning": "fraction_to_planning",
    "fractions": "fractions",
    "grid": "grid",
    "guide": "guide",
    "guide-labels": "guide_labels",
    "guide-names": "refine.guide.names in the settings",
    "labels": "labels",
    "landmarks": "landmarks",
    "mask": "mask",
    "match": "couch in the settings,",
    "method": "method",
    "modality": "fraction.modality in the settings",
    "organs": "organs",
    "out": "folder",
    "plan": "plan",
    "planning": "planning",
    "planning-modality": "planning.modality in the settings",
    "planning-to-fraction": "planning_to_fraction",
    "pose": "pose",
    "reference": "reference",
    "reject": "reject",
    "same-frame": "same_frame=True",
    "sample": "sample",
    "skeleton": "skeleton",
    "start": "start",
    "structures": "structures",
    "threads": "threads",
    "transforms": "transforms",
    "volume-change": "volume_change",
    "weights": "weights",
}
# Phrases that an argument alone does not make right.
_PHRASES: tuple[tuple[str, str], ...] = (
    ("as --out, or leave --dicom-like out", "as --out"),
    ("name it *.dcm, or leave --dicom-like out", "name it *.dcm"),
    ("with --dicom-like the result is", "the result is"),
    ("the --out folder", "the folder"),
    ("take --method interpolate", 'take method="interpolate"'),
    ("--bones auto", 'bones="auto"'),
    ("--modality mr", 'settings={"fraction": {"modality": "mr"}}'),
    ("give spine, or some of", "leave couch.bones empty for the spine, or name some of"),
    ("report it with the command line", "report it with the call"),
)
# In backticks stands a command of a program, right as it is; behind an option may stand what its value is.
_OPTION = re.compile(r"`[A-Za-z][^`]*`|(?<![\w/.-])--([a-z][a-z-]*[a-z]|[a-z])(?:(?: |=)(?:FILE|SERIES|N)\b)?(?![\w/])")

_own_words: ContextVar[Mapping[str, str] | None] = ContextVar("_own_words", default=None)


@contextmanager
def naming(**words: str) -> Iterator[None]:
    """Messages of the compiled module name an option as this call does: ``naming(out="path")``."""
    token = _own_words.set({option.replace("_", "-"): argument for option, argument in words.items()})
    try:
        yield
    finally:
        _own_words.reset(token)


def in_python(text: str) -> str:
    """A text of the program with the names of this package's arguments in place of the program's options."""
    for phrase, own in _PHRASES:
        text = text.replace(phrase, own)
    names = {**_ARGUMENTS, **(_own_words.get() or {})}
    return _OPTION.sub(lambda found: names.get(found[1] or "", found[0]), text)


def made(message: str, what: str | None, cause: str, remedy: str, code: str, exit_code: int) -> Error:
    """The exception of an error of the compiled module."""
    named = what if what is None or not what.startswith("--") else in_python(what)
    texts = in_python(message), named, in_python(cause), in_python(remedy)
    return _KINDS.get(exit_code, Error)(*texts, code)


def usage(cause: str, remedy: str) -> UsageError:
    """An argument that cannot be."""
    return UsageError(f"{cause}\n  remedy: {remedy}", None, cause, remedy)


def unsuitable(what: str, cause: str, remedy: str) -> InputError:
    """An input that does not fit."""
    return InputError(f"{what}: {cause}\n  remedy: {remedy}", what, cause, remedy)
