"""What holds for every test: lanes, required lanes, leaks, and an event loop that never waits.

The folder below tests/ is the lane of a test and its marker. `VERTEBRA_REQUIRE=live,e2e` turns a
skip in these lanes into a failure; without it, what was skipped is listed at the end with the
reason, which says how to enable it. Skip with `pytest.skip("<what is missing>; <what mends it>")`.
Tests marked `installed_ros` may be skipped all the same: no package registry has a ROS 2.
"""

from __future__ import annotations

import asyncio
import gc
import inspect
import os
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Generator, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import pytest
from blockbuster import BlockBuster, blockbuster_ctx
from hypothesis import settings

TESTS: Final = Path(__file__).parent
ROOT: Final = TESTS.parent
LANES: Final = (
    "architecture", "unit", "contract", "conformance", "live", "browser", "e2e", "bench",
)  # fmt: skip
MARKED_LANES: Final = ("live", "e2e", "browser", "bench")
WATCHED_LANES: Final = ("unit", "contract", "conformance")
"""Here the event loop is watched. In other lanes tests read files and start processes in it."""
SETTLE_S: Final = 2.0
"""Native libraries close their sockets a moment after they are told to."""

settings.register_profile("vertebra", settings(), deadline=None)  # two cores, many tests
settings.load_profile("vertebra")


def lane_of(path: Path) -> str:
    """Return the lane that a test file belongs to."""
    return path.relative_to(TESTS).parts[0]


def required_lanes() -> frozenset[str]:
    """Return the lanes in which nothing may be skipped."""
    return frozenset(filter(None, os.environ.get("VERTEBRA_REQUIRE", "").split(",")))


def pytest_configure() -> None:
    if unknown := sorted(required_lanes() - set(LANES)):
        raise pytest.UsageError(
            f"VERTEBRA_REQUIRE names {unknown[0]!r}, which is no lane; lanes: {', '.join(LANES)}"
        )


def pytest_itemcollected(item: pytest.Item) -> None:
    lane = lane_of(item.path)
    if lane in MARKED_LANES:
        item.add_marker(lane)
    if not isinstance(item, pytest.Function) or not inspect.iscoroutinefunction(item.obj):
        return
    # Asynchronous tests get two more fixtures, around their own and inside `leaks`.
    position = item.fixturenames.index("leaks") + 1
    item.fixturenames.insert(position, "leaked_tasks")
    if lane in WATCHED_LANES:
        item.fixturenames.insert(position + 1, "watched_loop")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run lane after lane, each in its random order: what is slow and heavy disturbs nobody."""
    items.sort(key=lambda item: LANES.index(lane_of(item.path)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, Any]:
    report = yield
    may_skip = hasattr(report, "wasxfail") or item.get_closest_marker("installed_ros")
    if report.skipped and not may_skip:
        _refuse_skip(report, item.path)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, Any]:
    report = yield
    if report.skipped:
        _refuse_skip(report, collector.path)
    return report


def _refuse_skip(report: pytest.TestReport | pytest.CollectReport, path: Path) -> None:
    lane = lane_of(path)
    if lane in required_lanes():
        report.outcome = "failed"
        report.longrepr = f"lane {lane} is required (VERTEBRA_REQUIRE): {_reason(report)}"


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    longrepr = report.longrepr
    text = str(longrepr[2] if isinstance(longrepr, tuple) else longrepr)
    return text.removeprefix("Skipped: ")


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    skipped = Counter(
        (lane_of(config.rootpath / report.nodeid.partition("::")[0]), _reason(report))
        for report in terminalreporter.getreports("skipped")
    )
    if not skipped:
        return
    terminalreporter.section("skipped, and how to enable it")
    for (lane, reason), count in sorted(skipped.items()):
        terminalreporter.line(f"{lane}, {count} test{'s' * (count > 1)}: {reason}")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a whole run in which a required lane had no test at all."""
    if session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    empty = required_lanes() - {lane_of(item.path) for item in session.items}
    if empty and not session.config.option.collectonly:
        raise pytest.UsageError(f"required lanes without any test: {', '.join(sorted(empty))}")


@pytest.fixture(autouse=True)
def leaks() -> Iterator[None]:
    """No thread and no socket outlives a test and its own fixtures."""
    threads = set(threading.enumerate())
    sockets = _open_sockets()
    yield
    deadline_s = time.monotonic() + SETTLE_S
    while leaked := _leaked(threads, sockets):
        gc.collect()
        if time.monotonic() >= deadline_s:
            pytest.fail(f"left behind: {', '.join(leaked)}")
        time.sleep(0.01)


def _leaked(threads: set[threading.Thread], sockets: set[str]) -> list[str]:
    left = [
        f"thread {thread.name!r}"
        for thread in threading.enumerate()
        if thread not in threads and not thread.daemon
    ]
    return left + sorted(_open_sockets() - sockets)


def _open_sockets() -> set[str]:
    """Return the sockets of this process, native ones included, where /proc tells."""
    found = set()
    for descriptor in Path("/proc/self/fd").glob("*"):
        try:
            target = str(descriptor.readlink())
        except FileNotFoundError:  # closed in the meantime, as the listing itself is
            continue
        if target.startswith("socket:"):
            found.add(target)
    return found


@pytest.fixture
async def leaked_tasks() -> AsyncIterator[None]:
    """No asyncio task outlives a test and its own fixtures."""
    before = asyncio.all_tasks()
    yield
    await asyncio.sleep(0)  # what was cancelled last ends in the next step of the loop
    left = asyncio.all_tasks() - before - {asyncio.current_task()}
    if left:
        pytest.fail(f"left behind: {', '.join(str(task) for task in left)}")


@pytest.fixture
def watched_loop() -> Iterator[BlockBuster]:
    """No code of ours blocks the event loop of a test; there is no exception."""
    folders = []
    for name in ("shared/src", "services", "plugins"):
        folder = ModuleType(name)
        folder.__path__ = [str(ROOT / name)]
        folders.append(folder)
    with blockbuster_ctx(folders) as blockbuster:
        yield blockbuster
