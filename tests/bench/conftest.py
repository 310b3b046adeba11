"""`./vertebra bench [--quick]`: both sides in one run, in turns; tables and raw data."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import pytest

from .report import Report

RESULTS: Final = Path(__file__).parents[2] / ".vertebra" / "bench"
REPORT: Final = pytest.StashKey[Report]()


@dataclass(frozen=True, slots=True)
class Plan:
    """How long to look. Rounds alternate between the systems."""

    rounds: int
    images: int
    steady_s: float
    messages: int
    calls: int


FULL: Final = Plan(rounds=5, images=60, steady_s=60, messages=10_000, calls=300)
QUICK: Final = Plan(rounds=2, images=30, steady_s=3, messages=5_000, calls=100)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="measure for a minute only")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[REPORT] = Report(quick=config.getoption("quick"))


@pytest.fixture(scope="session", autouse=True)
def _peers() -> None:
    for module in ("wrapyfi", "zmq"):
        if find_spec(module) is None:
            pytest.skip(f"{module} is not installed; ./vertebra bench installs it")


@pytest.fixture(scope="session")
def plan(report: Report) -> Plan:
    return QUICK if report.quick else FULL


@pytest.fixture(scope="session")
def report(pytestconfig: pytest.Config) -> Report:
    return pytestconfig.stash[REPORT]


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    report = config.stash[REPORT]
    if report.tables:
        file = report.keep(RESULTS)
        terminalreporter.section("measured")
        terminalreporter.line(report.markdown())
        terminalreporter.line(f"\nRaw data: {file}")
