"""The heartbeat file: how a service without HTTP tells its container that it works.

`python -m vertebra.heartbeat` is the health check: it exits with 0 if the heartbeat is fresh and
good, else with 1 and the reason. It imports nothing but the standard library, because it runs
every few seconds in every container.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Final

MAX_AGE_S: Final = 10.0
_GOOD: Final = "ok"


def heartbeat_path(service: str) -> Path:
    """Return where `service` writes: `$VERTEBRA_HEARTBEAT_DIR`, or the temporary directory."""
    folder = os.environ.get("VERTEBRA_HEARTBEAT_DIR") or tempfile.gettempdir()
    return Path(folder) / f"vertebra-{service}.heartbeat"


def beat(service: str, problem: str = "") -> None:
    """Say that `service` is alive and either works or has a `problem`."""
    path = heartbeat_path(service)
    writer = f"{os.getpid()}-{threading.get_ident()}"  # two of one name may run on a machine
    draft = path.with_suffix(f".{writer}.draft")
    draft.write_text(problem or _GOOD, encoding="utf-8")
    draft.replace(path)


def check(path: Path, *, max_age_s: float = MAX_AGE_S) -> str:
    """Return what is wrong with the service that writes `path`; empty if it is well."""
    try:
        text = path.read_text(encoding="utf-8")
        age_s = time.time() - path.stat().st_mtime
    except FileNotFoundError:
        return f"no heartbeat at {path}: the service has not started"
    if age_s > max_age_s:
        return f"the last heartbeat at {path} is {age_s:.0f} s old: the service hangs"
    return "" if text == _GOOD else text


def main() -> int:
    """Check the services named as arguments, by default all that write on this machine."""
    folder = heartbeat_path("x").parent
    paths = [heartbeat_path(name) for name in sys.argv[1:]] or sorted(
        folder.glob("vertebra-*.heartbeat")
    )
    problems = [problem for path in paths if (problem := check(path))]
    if not paths:
        problems = [f"no heartbeat in {folder}: no service has started"]
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
