"""The browser client outside of a browser: its tests under node/ run in Node's own test runner."""

from __future__ import annotations

import subprocess
from pathlib import Path

import playwright
import pytest

FILES = sorted((Path(__file__).parent / "node").glob("*.test.mjs"))
NODE = Path(playwright.__file__).parent / "driver" / "node"
"""Playwright brings a Node along: the same everywhere, and Debian's is too old."""


def test_there_are_tests_for_node() -> None:
    assert [path.name for path in FILES] >= ["base.test.mjs", "client.test.mjs", "frames.test.mjs"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_node_passes(path: Path) -> None:
    run = subprocess.run(
        [NODE, "--test", "--test-reporter=tap", str(path)],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    counts = dict(line[2:].split(" ", 1) for line in run.stdout.splitlines() if line[:2] == "# ")
    assert run.returncode == 0, run.stdout + run.stderr
    assert int(counts["pass"]) == int(counts["tests"]) > 0, run.stdout
