"""Arrays of 200 x 200 float64 at a true 100 Hz and at 1 kHz: does anything grow?"""

from __future__ import annotations

import statistics
from typing import Final

import pytest

from .conftest import Plan
from .peers.peer import Stream
from .processes import Exchange, Pair, router
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(600)]

SYSTEMS: Final = {"vertebra": "Vertebra", "wrapyfi": "Wrapyfi 0.5 over ZeroMQ"}
RATES_HZ: Final = (100, 1000)
WATCH_S: Final = 0.5
GROWN_BYTES: Final = 16 << 20


async def test_steady_arrays(plan: Plan, report: Report) -> None:
    outcomes: dict[int, dict[str, Exchange]] = {rate_hz: {} for rate_hz in RATES_HZ}
    async with router() as (locator, route):
        stream = Stream(endpoint=locator, dtype="<f8", shape=(200, 200))
        for name in SYSTEMS:
            async with Pair.of(name, stream, [route] if name == "vertebra" else []) as pair:
                for rate_hz in RATES_HZ:
                    outcomes[rate_hz][name] = await pair.exchange(
                        round(plan.steady_s * rate_hz),
                        rate_hz=rate_hz,
                        limit_s=plan.steady_s,
                        watch_s=WATCH_S,
                    )
    report.raw["steady"] = {str(rate_hz): found for rate_hz, found in outcomes.items()}
    for rate_hz, found in outcomes.items():
        assert all(outcome.latency_ns for outcome in found.values())
        rows = [_row(label, found[name]) for name, label in SYSTEMS.items()]
        columns = ("system", "sent at", "median", "p99", "lost", "latency grows", "memory grows")
        title = f"200 x 200 float64 at {rate_hz} Hz for {plan.steady_s:.0f} s"
        report.tables.append(Table(title, columns, rows))
        ours, theirs = found["vertebra"], found["wrapyfi"]
        what = f"200 x 200 float64 at {rate_hz} Hz"
        for name, percent in (("median", 50), ("p99", 99)):
            ratio = percentile(theirs.latency_ns, percent) / percentile(ours.latency_ns, percent)
            measured = f"{ratio:.1f} x lower"
            report.goals.append(Goal(what, "Wrapyfi 0.5", f"lower {name}", measured, ratio > 1))
        reached = growth_bytes(ours) < GROWN_BYTES and growth_ns_per_s(ours) * plan.steady_s < 1e6
        measured = f"{_slope(ours)}, {_megabytes(ours)}"
        report.goals.append(Goal(what, "itself", "no growth", measured, reached))


def growth_ns_per_s(outcome: Exchange) -> float:
    """Return the slope over the medians of each second."""
    began_ns = outcome.sent_ns[0]
    seconds: dict[int, list[int]] = {}
    for sent_ns, latency_ns in zip(outcome.sent_ns, outcome.latency_ns, strict=True):
        seconds.setdefault((sent_ns - began_ns) // 1_000_000_000, []).append(latency_ns)
    if len(seconds) < 2:
        return 0.0
    medians = [median(values) for values in seconds.values()]
    return statistics.linear_regression([*map(float, seconds)], medians).slope


def growth_bytes(outcome: Exchange) -> int:
    """Return by how much memory grew from the first third of the run to the last."""
    third = max(1, len(outcome.resident_bytes) // 3)
    first, last = outcome.resident_bytes[:third], outcome.resident_bytes[-third:]
    return round(median(last) - median(first))


def _row(label: str, outcome: Exchange) -> tuple[str, ...]:
    return (
        label,
        f"{outcome.sent_hz:.0f} Hz",
        duration(median(outcome.latency_ns)),
        duration(percentile(outcome.latency_ns, 99)),
        str(outcome.lost),
        _slope(outcome),
        _megabytes(outcome),
    )


def _slope(outcome: Exchange) -> str:
    return f"{growth_ns_per_s(outcome) / 1e3:+.1f} µs/s"


def _megabytes(outcome: Exchange) -> str:
    return f"{growth_bytes(outcome) / 1e6:+.1f} MB"
