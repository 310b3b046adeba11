"""Become a program of the local fleet, and end with whoever started it.

Run as a file, `python -IS launch.py PROGRAMS NAME`, by the supervisor and for the supervisor
itself: imports only the standard library, so that it costs next to nothing.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from pathlib import Path

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Replace this process by program NAME of the JSON file PROGRAMS: [command, environment]."""
    parent = os.getppid()
    command, environment = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))[sys.argv[2]]
    if sys.platform == "linux":
        # Survives exec: when the parent dies in any way, this process is told to stop.
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            sys.exit(f"{sys.argv[2]}: who wanted this is gone")
    os.execvpe(command[0], command, {**os.environ, **environment})  # noqa: S606


if __name__ == "__main__":
    main()
