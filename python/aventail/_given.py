"""Arguments as they must be. What is not is refused by the argument's name, with its value."""

from __future__ import annotations

import json
import math
import numbers
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _errors

_LABELS = 65535
_LONGEST = 60


def shown(thing: Any) -> str:
    """A value as a message has it: short, on one line."""
    if isinstance(thing, np.ndarray) and thing.size > 9:
        return f"an array of shape {thing.shape}"
    text = " ".join(repr(thing.tolist() if isinstance(thing, np.ndarray) else thing).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def wrong(name: str, thing: Any, remedy: str) -> _errors.UsageError:
    """The error of an argument that cannot be."""
    return _errors.usage(f"{name} is {shown(thing)}", remedy)


@contextmanager
def about(name: str) -> Iterator[None]:
    """What is refused meanwhile is told of an argument."""
    try:
        yield
    except _errors.UsageError as error:
        raise _errors.usage(f"{name}: {error.cause}", error.remedy) from None
    except _errors.InputError as error:
        # A file has a name of its own.
        if error.code or error.what is not None and os.path.exists(error.what):
            raise
        raise _errors.unsuitable(name, f"{error.what}: {error.cause}", error.remedy) from None


def is_path(thing: Any) -> bool:
    """Whether something is meant as a path."""
    return isinstance(thing, (str, os.PathLike))


def path(name: str, thing: Any) -> str:
    """A path."""
    text = os.fspath(thing) if is_path(thing) else None
    if not isinstance(text, str) or not text or "\0" in text:
        raise wrong(name, thing, "give a path, as a str or os.PathLike")
    return text


def path_or_none(name: str, thing: Any) -> str | None:
    """A path, where one is given."""
    return None if thing is None else path(name, thing)


def several(name: str, things: Any, remedy: str) -> list[Any]:
    """A list or tuple, or something else to go through that is no text and no table."""
    if isinstance(things, (str, bytes, os.PathLike, Mapping)) or not isinstance(things, Iterable):
        raise wrong(name, things, remedy)
    try:
        return list(things)
    except TypeError:
        # numpy's arrays without axes say that they can be gone through.
        raise wrong(name, things, remedy) from None


def paths(name: str, things: Any) -> list[str]:
    """One path or several."""
    all_of_them = [things] if is_path(things) else several(name, things, "give a path or a list of paths")
    return [path(name, thing) for thing in all_of_them]


def choice(name: str, thing: Any, of: Sequence[str]) -> str:
    """One of a few words."""
    if not isinstance(thing, str) or thing not in of:
        words = ", ".join(f'"{word}"' for word in of[:-1])
        raise wrong(name, thing, f'give {words} or "{of[-1]}"')
    return thing


def word(name: str, thing: Any) -> str:
    """A text that names something."""
    if not isinstance(thing, str) or not thing.strip():
        raise wrong(name, thing, "give its name as a text")
    return thing


def flag(name: str, thing: Any) -> bool:
    """True or False, and nothing that only counts as one."""
    if not isinstance(thing, (bool, np.bool_)):
        raise wrong(name, thing, "give True or False")
    return bool(thing)


def number(name: str, thing: Any, remedy: str = "give a finite number") -> float:
    """A finite number."""
    if isinstance(thing, np.ndarray) and thing.ndim == 0:
        thing = thing.item()
    if isinstance(thing, (bool, np.bool_)) or not isinstance(thing, numbers.Real):
        raise wrong(name, thing, remedy)
    try:
        value = float(thing)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise wrong(name, thing, remedy)
    return value


def within(name: str, thing: Any, least: float, most: float) -> float:
    """A number of a range, its ends included."""
    remedy = f"give a number from {least:g} to {most:g}"
    value = number(name, thing, remedy)
    if not least <= value <= most:
        raise wrong(name, thing, remedy)
    return value


def numbers_of(name: str, things: Any, remedy: str) -> list[float]:
    """Several finite numbers."""
    return [number(name, thing, remedy) for thing in several(name, things, remedy)]


def whole(name: str, thing: Any, least: int = 0, most: int = 2**32 - 1) -> int:
    """A whole number of a range."""
    counts = isinstance(thing, numbers.Integral) and not isinstance(thing, bool)
    if not counts or not least <= int(thing) <= most:
        raise wrong(name, thing, f"give a whole number from {least} to {most}")
    return int(thing)


def array(name: str, values: Any, shape: tuple[int | None, ...], remedy: str) -> NDArray[np.float64]:
    """Finite numbers in an array of a shape; ``None`` is any number along an axis."""
    try:
        out = np.asarray(values)
    except Exception:
        raise wrong(name, values, remedy) from None
    fits = out.ndim == len(shape) and all(want in (None, n) for want, n in zip(shape, out.shape))
    if not fits or out.dtype.kind not in "iuf" and out.size > 0:
        raise wrong(name, values, remedy)
    own: NDArray[np.float64] = np.ascontiguousarray(out, np.float64)
    if not np.isfinite(own).all():
        raise _errors.usage(f"{name} holds NaN or an infinite number: {shown(values)}", remedy)
    return own


def three(name: str, values: Any, remedy: str = "give three finite numbers: x, y, z") -> tuple[float, float, float]:
    """Three finite numbers."""
    x, y, z = array(name, values, (3,), remedy).tolist()
    return x, y, z


def matrix(name: str, values: Any) -> list[list[float]]:
    """A 4x4."""
    rows: list[list[float]] = array(name, values, (4, 4), "give a 4x4, planning to fraction, LPS mm").tolist()
    return rows


def table(name: str, thing: Any, remedy: str) -> Mapping[Any, Any]:
    """A table."""
    if not isinstance(thing, Mapping):
        raise wrong(name, thing, remedy)
    return thing


def named(name: str, thing: Any, remedy: str) -> list[tuple[str, Any]]:
    """The entries of a table whose keys are names; DICOM has structures whose name is empty."""
    entries = list(table(name, thing, remedy).items())
    for key, _ in entries:
        if not isinstance(key, str):
            raise _errors.usage(f"{name} has the key {shown(key)}, which is no text", remedy)
    return entries


def _plain(value: Any) -> Any:
    """numpy's numbers and arrays as JSON knows them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is no number, text, list or table")


def json_text(name: str, values: Any, remedy: str) -> str:
    """A value or a table of them as JSON."""
    own = dict(values) if isinstance(values, Mapping) else values
    try:
        return json.dumps(own, allow_nan=False, default=_plain)
    except (TypeError, ValueError, RecursionError) as error:
        raise _errors.usage(f"{name} cannot be written: {error}", remedy) from None


def label_names(name: str, labels: Mapping[Any, Any]) -> dict[int, str]:
    """Names by number; number and name may stand either way round."""
    remedy = 'give {1: "skull"} or {"skull": 1}, numbers from 0 to 65535'
    out: dict[int, str] = {}
    for key, value in labels.items():
        by_name = isinstance(key, str) and not key.isdecimal()
        label, own = (value, key) if by_name else (key, value)
        if isinstance(label, str) and label.isdecimal():
            label = int(label)
        whole_number = isinstance(label, numbers.Integral) and not isinstance(label, bool)
        if not whole_number or not 0 <= label <= _LABELS or not isinstance(own, str):
            raise _errors.usage(f"{name} has the entry {shown(key)}: {shown(value)}", remedy)
        if out.get(int(label), own) != own:
            raise _errors.usage(f"{name} has two names of label {label}: {out[int(label)]}, {own}", "give each label once")
        out[int(label)] = own
    return out
