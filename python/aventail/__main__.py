"""The program: ``aventail`` and ``python -m aventail``."""

from __future__ import annotations

import signal
import sys

from . import _aventail


def main() -> int:
    """Runs this process's command line; returns the exit code."""
    # Ctrl-C ends the program at once, as it does without Python around it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _aventail.main(["aventail", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
