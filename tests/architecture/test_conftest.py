"""The rig of the tests does what it promises: each promise is broken here, in a copy."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace with our configuration and rig, one blocking service, and no tests yet."""
    (tmp_path / "tests").mkdir()
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copy(ROOT / "tests/conftest.py", tmp_path / "tests")
    sources = tmp_path / "services" / "slow"
    sources.mkdir(parents=True)
    (sources / "slow.py").write_text("import time\n\ndef work():\n    time.sleep(0.01)\n")
    return tmp_path


def run(
    workspace: Path, lane: str, test: str, *arguments: str, require: str = ""
) -> subprocess.CompletedProcess[str]:
    folder = workspace / "tests" / lane
    folder.mkdir(exist_ok=True)
    (folder / "test_it.py").write_text(dedent(test))
    environment = {
        **os.environ,
        "VERTEBRA_REQUIRE": require,
        "PYTHONPATH": str(workspace / "services/slow"),
    }
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=workspace,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


LEAKS = {
    "thread 'Thread-": """
        import threading
        stop = threading.Event()
        def test_it():
            threading.Thread(target=stop.wait, args=(3,)).start()
        """,
    "socket:[": """
        import socket
        kept = []
        def test_it():
            kept.append(socket.socket())
        """,
    "<Task pending": """
        import asyncio
        kept = []
        async def test_it():
            kept.append(asyncio.create_task(asyncio.sleep(60)))
        """,
}


@pytest.mark.parametrize("words", LEAKS)
def test_what_outlives_a_test_fails_it(workspace: Path, words: str) -> None:
    done = run(workspace, "live", LEAKS[words])
    assert done.returncode == 1
    assert f"left behind: {words}" in done.stdout


def test_what_fixtures_clean_up_is_no_leak(workspace: Path) -> None:
    test = """
        import asyncio, socket, threading, pytest

        @pytest.fixture(scope="module")
        def shared():
            with socket.socket() as kept:
                yield kept

        @pytest.fixture
        async def worker():
            task = asyncio.create_task(asyncio.sleep(60))
            stop = threading.Event()
            thread = threading.Thread(target=stop.wait)
            thread.start()
            with socket.socket():
                yield
            task.cancel()
            stop.set()
            thread.join()

        async def test_async(shared, worker):
            await asyncio.to_thread(lambda: None)

        def test_sync(shared):
            assert shared
        """
    done = run(workspace, "unit", test)
    assert done.returncode == 0, done.stdout


BLOCKING = """
    import time, slow
    async def test_it():
        time.sleep(0.01)  # the test itself may
        slow.work()
    """


def test_code_of_ours_may_not_block_the_loop_in_the_fast_lanes(workspace: Path) -> None:
    done = run(workspace, "unit", BLOCKING)
    assert done.returncode == 1
    assert "Blocking call to time.sleep" in done.stdout
    assert run(workspace, "live", BLOCKING, "tests/live").returncode == 0


SKIPPING = """
    import pytest
    def test_one():
        pytest.skip("no robot; buy one")
    @pytest.mark.skipif(True, reason="no robot; buy one")
    def test_two(): pass
    @pytest.mark.xfail(reason="known")
    def test_three():
        raise AssertionError
    """


def test_a_skip_is_listed_with_its_reason_before_the_last_line(workspace: Path) -> None:
    done = run(workspace, "live", SKIPPING)
    assert done.returncode == 0
    *_, reason, last = done.stdout.splitlines()
    assert reason == "live, 2 tests: no robot; buy one"
    assert "2 skipped, 1 xfailed" in last


def test_a_skip_in_a_required_lane_is_a_failure(workspace: Path) -> None:
    done = run(workspace, "live", SKIPPING, "tests", require="e2e,live")
    assert done.returncode == 1
    assert "lane live is required (VERTEBRA_REQUIRE): no robot; buy one" in done.stdout
    assert "1 failed, 1 xfailed, 1 error" in done.stdout


def test_only_what_needs_an_installed_ros_may_be_skipped_in_a_required_lane(
    workspace: Path,
) -> None:
    test = "import pytest\n@pytest.mark.installed_ros\ndef test_it():\n    pytest.skip('no ROS')\n"
    done = run(workspace, "live", test, require="live")
    assert done.returncode == 0, done.stdout
    assert "1 skipped" in done.stdout


def test_a_file_that_skips_itself_in_a_required_lane_is_a_failure(workspace: Path) -> None:
    test = "import pytest\npytest.skip('no robot; buy one', allow_module_level=True)\n"
    done = run(workspace, "live", test, "tests", require="live")
    assert done.returncode == 2
    assert "no robot; buy one" in done.stdout


def test_a_required_lane_without_tests_fails_the_whole_run(workspace: Path) -> None:
    done = run(workspace, "unit", "def test_it(): pass\n", require="unit,browser")
    assert done.returncode != 0
    assert "required lanes without any test: browser" in done.stdout + done.stderr


def test_a_lane_that_does_not_exist_is_refused(workspace: Path) -> None:
    done = run(workspace, "unit", "def test_it(): pass\n", require="life")
    assert done.returncode == 4
    assert "'life', which is no lane; lanes: architecture, unit" in done.stderr


def test_the_folder_is_the_marker(workspace: Path) -> None:
    done = run(workspace, "live", "def test_it(): pass\n", "-m", "not live")
    assert (done.returncode, "1 deselected" in done.stdout) == (5, True)
