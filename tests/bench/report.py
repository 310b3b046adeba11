"""What was measured: tables for people, goals, and all raw data."""

from __future__ import annotations

import os
import platform
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

LIBRARIES: Final = ("cyclonedds", "eclipse-zenoh", "msgspec", "numpy", "pyzmq", "wrapyfi")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of one measurement; the first column names the system."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]

    def markdown(self) -> str:
        return f"### {self.title}\n\n{_markdown(self.columns, self.rows)}"


@dataclass(frozen=True, slots=True)
class Goal:
    """A number of DESIGN 11 and whether it was reached."""

    what: str
    against: str
    goal: str
    measured: str
    reached: bool


@dataclass(slots=True)
class Report:
    """Everything that one run found out."""

    quick: bool
    tables: list[Table] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    raw: dict[str, Any] = field(default_factory=dict)
    began_at: float = field(default_factory=time.time)
    load_before: tuple[float, float, float] = field(default_factory=os.getloadavg)

    def markdown(self) -> str:
        """Return the report as it is printed, and quoted by README."""
        goals = [
            (goal.what, goal.against, goal.goal, goal.measured, "yes" if goal.reached else "**no**")
            for goal in self.goals
        ]
        columns = ("what", "against", "goal", "measured", "reached")
        parts = [
            *(table.markdown() for table in self.tables),
            f"### Goals\n\n{_markdown(columns, goals)}",
            self._circumstances(),
        ]
        return "\n\n".join(parts)

    def keep(self, folder: Path) -> Path:
        """Write everything, raw data included, to a JSON file named after the date."""
        folder.mkdir(parents=True, exist_ok=True)
        began = time.strftime("%Y-%m-%dT%H%M%S", time.localtime(self.began_at))
        file = folder / f"{began}.json"
        machine = {"circumstances": self._circumstances()}
        file.write_bytes(msgspec.json.encode({**machine, **_fields(self)}))
        return file

    def _circumstances(self) -> str:
        libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
        before, after = self.load_before[0], os.getloadavg()[0]
        return (
            f"{'Quick' if self.quick else 'Full'} run of "
            f"{time.strftime('%Y-%m-%d %H:%M', time.localtime(self.began_at))} on "
            f"{os.cpu_count()} cores of {_processor()}, load {before:.1f} before and {after:.1f} "
            f"after, {platform.system()} {platform.release()}, "
            f"Python {platform.python_version()}, {libraries}."
        )


def _fields(report: Report) -> dict[str, Any]:
    return {
        "quick": report.quick,
        "tables": report.tables,
        "goals": report.goals,
        "raw": report.raw,
    }


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] + ["---:"] * (len(columns) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def median(values: Sequence[float]) -> float:
    """Return the middle of the sorted values."""
    return statistics.median(values)


def percentile(values: Sequence[float], percent: float) -> float:
    """Return the value that `percent` of the values do not exceed."""
    return sorted(values)[min(len(values) - 1, int(len(values) * percent / 100))]


def duration(nanoseconds: float) -> str:
    """Return a duration with three digits and a fitting unit."""
    for unit, size in (("s", 1e9), ("ms", 1e6)):
        if nanoseconds >= size:
            return f"{nanoseconds / size:.3g} {unit}"
    return f"{nanoseconds / 1e3:.3g} µs"
