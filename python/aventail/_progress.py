"""Progress of a run: a function of your own, or bars."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeAlias, Union

from . import _given

Progress: TypeAlias = Union[bool, Callable[[str, "float | None"], object], None]
"""``True`` shows progress bars (of tqdm, if installed; otherwise lines). A function is called as ``function(stage, share)``.

``share`` is ``None`` when the stage begins, then the part of it that is done. The function is
called in the thread that started the run; an exception that it raises ends the run.
"""


class _Bars:
    """A bar for each stage."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bar: Any = None

    def __call__(self, stage: str, share: float | None) -> None:
        if share is None:
            self.close()
            layout = "{desc:<34}{bar:30} {elapsed}"
            self._bar = self._tqdm(total=1.0, desc=stage, bar_format=layout, file=sys.stderr)
        elif self._bar is not None:
            self._bar.n = share
            self._bar.refresh()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _line(stage: str, share: float | None) -> None:
    if share is None:
        print(stage, "...", file=sys.stderr, flush=True)


@contextmanager
def told(progress: Progress) -> Iterator[Callable[[str, float | None], object] | None]:
    """The function that the compiled module calls."""
    if progress is None or progress is False:
        yield None
    elif progress is True:
        try:
            bars = _Bars(import_module("tqdm.auto").tqdm)
        except ImportError:
            yield _line
            return
        try:
            yield bars
        finally:
            bars.close()
    elif callable(progress):
        yield progress
    else:
        raise _given.wrong("progress", progress, "give True, False, or a function of stage and share")
