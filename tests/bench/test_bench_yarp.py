"""Our YARP ports and, where its bindings are, the C++ library, on the real wire.

Each system has both sides, in two processes, and a name server of its own. Without the bindings the
C++ library is left out, and its numbers of another machine stand for it.
"""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Any, Final

import pytest

from vertebra.errors import ConfigError
from vertebra_yarp.driver_bindings import load_bindings

from .conftest import Plan
from .peers.peer import Order, Stream
from .processes import Exchange, Pair, name_server, started
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(240)]

VGA: Final = (480, 640, 3)
BOTTLE: Final = (56,)
"""A bottle of one blob has 8 bytes beside it."""
STREAMS: Final = (
    ("VGA images", VGA, "tcp"),
    ("VGA images", VGA, "fast_tcp"),
    ("64-byte bottles", BOTTLE, "tcp"),
    ("64-byte bottles", BOTTLE, "fast_tcp"),
)
OURS_ALONE: Final = (("64-byte bottles", BOTTLE, "udp"),)
RATE_HZ: Final = 100.0
OURS: Final = "Vertebra"
CPP: Final = "C++ library"
CPP_IMAGES_HZ: Final = 2550
"""The C++ library through its Python bindings, measured on another machine (DESIGN 11)."""


@pytest.fixture(scope="module")
def systems() -> dict[str, str]:
    """Return the modules of the systems that can be measured here."""
    try:
        load_bindings()
    except ConfigError as error:
        print(f"YARP's C++ library is left out: {error}")  # noqa: T201 - the report of a bench
        return {OURS: "yarp"}
    return {OURS: "yarp", CPP: "yarp_cpp"}


async def test_yarp_streams(plan: Plan, report: Report, systems: dict[str, str]) -> None:
    rows, raw = [], {}
    for what, shape, carrier in STREAMS + OURS_ALONE:
        alone = (what, shape, carrier) in OURS_ALONE
        measured = {OURS: systems[OURS]} if alone else systems
        found = await _exchanges(measured, shape, carrier, plan)
        raw[f"{what}, {carrier}"] = found
        rows += [_row(f"{what}, {carrier}: {system}", *found[system]) for system in found]
        if shape == VGA and not alone:
            report.goals.append(_goal(carrier, found))
    report.raw["yarp streams"] = raw
    columns = ("stream", "received per second", "lost", f"one-way at {RATE_HZ:.0f} Hz", "p99")
    title = "YARP ports, two processes"
    report.tables.append(Table(title, columns, rows))


async def _exchanges(
    systems: dict[str, str], shape: tuple[int, ...], carrier: str, plan: Plan
) -> dict[str, tuple[list[Exchange], Exchange]]:
    """Return, for each system, its runs at full speed and the one at a steady rate."""
    async with AsyncExitStack() as stack:
        pairs = {}
        for system, module in systems.items():
            endpoint = await stack.enter_async_context(name_server())
            stream = Stream(endpoint=endpoint, dtype="|u1", shape=shape, option=carrier)
            pairs[system] = await stack.enter_async_context(Pair.of(module, stream))
        flood: dict[str, list[Exchange]] = {system: [] for system in pairs}
        for _ in range(plan.rounds):
            for system, pair in pairs.items():
                flood[system].append(await pair.exchange(plan.messages // 10))
        return {
            system: (flood[system], await pair.exchange(plan.images, rate_hz=RATE_HZ))
            for system, pair in pairs.items()
        }


def _received_hz(flood: list[Exchange]) -> float:
    return median([outcome.received_hz for outcome in flood])


def _row(name: str, flood: list[Exchange], paced: Exchange) -> tuple[str, ...]:
    return (
        name,
        f"{_received_hz(flood):,.0f}",
        str(sum(outcome.lost for outcome in (*flood, paced))),
        duration(median(paced.latency_ns)),
        duration(percentile(paced.latency_ns, 99)),
    )


def _goal(carrier: str, found: dict[str, tuple[list[Exchange], Exchange]]) -> Goal:
    received_hz = _received_hz(found[OURS][0])
    cpp_hz = _received_hz(found[CPP][0]) if CPP in found else CPP_IMAGES_HZ
    ratio = received_hz / cpp_hz
    return Goal(
        f"YARP driver, VGA images over {carrier}",
        f"{CPP}, {cpp_hz:,.0f}/s{'' if CPP in found else ' elsewhere'}",
        ">= 0.6 x",
        f"{received_hz:,.0f}/s, {ratio:.2f} x",
        ratio >= 0.6,
    )


async def test_yarp_calls(plan: Plan, report: Report, systems: dict[str, str]) -> None:
    found: dict[str, Any] = {}
    for system, module in systems.items():
        async with name_server() as endpoint:
            stream = Stream(endpoint=endpoint, dtype="|u1", shape=BOTTLE)
            async with started(module, "serve", stream), started(module, "call", stream) as caller:
                order = Order(run=0, count=plan.calls * plan.rounds)
                found[system] = await caller.ask(order, list[int])
    report.raw["yarp calls"] = found
    rows = [
        (system, duration(median(found[system])), duration(percentile(found[system], 99)))
        for system in found
    ]
    columns = ("system", "median", "p99")
    report.tables.append(Table("YARP RPC of 64-byte bottles, two processes", columns, rows))
    ours_ns = median(found[OURS])
    goal = Goal("YARP RPC", "", "median < 200 µs", duration(ours_ns), ours_ns < 200e3)
    report.goals.append(goal)
