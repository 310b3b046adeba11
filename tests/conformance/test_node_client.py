"""The browser client outside of a browser: its tests under node/ run in Node's own test runner."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

FILES = sorted((Path(__file__).parent / "node").glob("*.test.mjs"))
OLDEST_NODE = 20


@pytest.fixture(scope="session")
def node() -> str:
    found = shutil.which("node")
    if found is None:
        pytest.skip("there is no node; install nodejs 20 or later")
    version = subprocess.run([found, "--version"], capture_output=True, text=True, check=True)
    if int(version.stdout.strip().removeprefix("v").partition(".")[0]) < OLDEST_NODE:
        pytest.skip(f"node is {version.stdout.strip()}; install nodejs {OLDEST_NODE} or later")
    return found


def test_there_are_tests_for_node() -> None:
    assert [path.name for path in FILES] >= ["client.test.mjs", "frames.test.mjs"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_node_passes(node: str, path: Path) -> None:
    run = subprocess.run(
        [node, "--test", "--test-reporter=tap", str(path)],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    counts = dict(line[2:].split(" ", 1) for line in run.stdout.splitlines() if line[:2] == "# ")
    assert run.returncode == 0, run.stdout + run.stderr
    assert int(counts["pass"]) == int(counts["tests"]) > 0, run.stdout
