"""The compiled module, which a child that was forked after its first use is refused.

Its threads do not come along into a forked child, and what waits for them there would wait for ever.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from . import _aventail, _errors

__all__ = ["check", "native"]

_used = False
_forked = False


def check() -> None:
    """Refuses a call in a process that was forked after the module had been used."""
    global _used
    if _forked:
        raise _errors.usage(
            "this process was forked from one that had used aventail, whose threads do not exist here",
            'start processes with multiprocessing.get_context("spawn"), or "forkserver", or fork before the first call',
        )
    _used = True


def _in_child() -> None:
    global _forked
    _forked = _forked or _used


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)


class _Guarded:
    """The module, each of whose names is looked up after the check."""

    def __getattr__(self, name: str) -> Any:
        check()
        return getattr(_aventail, name)


if TYPE_CHECKING:
    native = _aventail
else:
    native = _Guarded()
