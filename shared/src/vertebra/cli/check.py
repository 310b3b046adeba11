"""`check`: format, lint, types and import contracts, all of them, then one summary."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

from vertebra.cli.backbone import table
from vertebra.cli.checkout import checkout


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser("check", help="check format, lint, types and import contracts")
    parser.set_defaults(run=run)


def run(_: argparse.Namespace) -> int:
    """Run every check; return 1 if one of them failed."""
    root = checkout()
    sources = sorted(root.glob("*/src")) + sorted(root.glob("*/*/src"))
    environment = {**os.environ, "MYPYPATH": os.pathsep.join(map(str, sources))}
    folders = [str(path.relative_to(root)) for path in sources]
    steps = {
        "format": ["ruff", "format", "--check"],
        "lint": ["ruff", "check"],
        "types": ["mypy", *folders, "tests", "vertebra"],
        "import contracts": ["lint-imports"],
    }
    rows = []
    for name, step in steps.items():
        print(f"== {name}", flush=True)
        started_s = time.monotonic()
        tool = Path(sys.executable).with_name(step[0])
        done = subprocess.run(  # noqa: S603 - the commands are above
            [tool, *step[1:]], cwd=root, env=environment, check=False
        )
        verdict = "failed" if done.returncode else "ok"
        rows.append((verdict, name, f"{time.monotonic() - started_s:.1f} s"))
    print(f"\n{table(rows)}")
    return int(any(verdict != "ok" for verdict, *_ in rows))
