"""One-way latency of VGA images between two processes, from the array to the array."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Final

import pytest

from vertebra.testing.ports import free_tcp_port

from .conftest import Plan
from .peers.peer import Stream
from .processes import Exchange, Pair, router
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(240)]

SYSTEMS: Final = {
    "vertebra": "Vertebra (typed, bus)",
    "zenoh": "Zenoh by hand, in the callback",
    "zenoh-asyncio": "Zenoh by hand, in an event loop",
    "pyzmq": "ZeroMQ by hand, no router",
    "wrapyfi": "Wrapyfi 0.5 over ZeroMQ",
}
RATE_HZ: Final = 30.0
SHAPE: Final = (480, 640, 3)


async def test_one_way_latency(plan: Plan, report: Report) -> None:
    outcomes: dict[str, list[Exchange]] = {name: [] for name in SYSTEMS}
    async with AsyncExitStack() as stack:
        locator, _ = await stack.enter_async_context(router())
        endpoints = {"pyzmq": f"tcp://127.0.0.1:{free_tcp_port()}"}
        pairs = {}
        for name in SYSTEMS:
            module, _, option = name.partition("-")
            endpoint = endpoints.get(name, locator)
            stream = Stream(
                endpoint=endpoint, dtype="|u1", shape=SHAPE, key=f"bench/{name}", option=option
            )
            pairs[name] = await stack.enter_async_context(Pair.of(module, stream))
        for _ in range(plan.rounds):
            for name, pair in pairs.items():
                outcomes[name].append(await pair.exchange(plan.images, rate_hz=RATE_HZ))
    report.raw["one-way"] = outcomes
    assert all(outcome.latency_ns for found in outcomes.values() for outcome in found)
    rows = [_row(label, outcomes[name]) for name, label in SYSTEMS.items()]
    columns = ("system", "median", "p10", "p99", "lost")
    title = f"One-way latency: VGA images at {RATE_HZ:.0f} Hz, two processes"
    report.tables.append(Table(title, columns, rows))
    what = "one-way latency, VGA image"
    ratio = _ratio(outcomes, "wrapyfi")
    report.goals.append(
        Goal(what, SYSTEMS["wrapyfi"], ">= 20 x lower", f"{ratio:.1f} x", ratio >= 20)
    )
    for name in ("zenoh", "zenoh-asyncio"):
        ratio = 1 / _ratio(outcomes, name)
        report.goals.append(Goal(what, SYSTEMS[name], "<= 1.3 x", f"{ratio:.2f} x", ratio <= 1.3))


def _row(label: str, found: list[Exchange]) -> tuple[str, ...]:
    latency_ns = [ns for outcome in found for ns in outcome.latency_ns]
    return (
        label,
        duration(median(latency_ns)),
        duration(percentile(latency_ns, 10)),
        duration(percentile(latency_ns, 99)),
        str(sum(outcome.lost for outcome in found)),
    )


def _ratio(outcomes: dict[str, list[Exchange]], other: str) -> float:
    """Return how much slower `other` is than Vertebra: medians of a round, median of the rounds."""
    return median(
        [
            median(theirs.latency_ns) / median(ours.latency_ns)
            for ours, theirs in zip(outcomes["vertebra"], outcomes[other], strict=True)
        ]
    )
