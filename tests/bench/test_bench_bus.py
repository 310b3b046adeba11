"""Small messages and calls through the router, beside Zenoh by hand."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Final

import pytest

from vertebra.testing.ports import free_tcp_port

from .conftest import Plan
from .peers.peer import Order, Stream
from .processes import Exchange, Pair, router, started
from .report import Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(120)]

SYSTEMS: Final = {
    "vertebra": "Vertebra",
    "zenoh": "Zenoh by hand",
    "pyzmq": "ZeroMQ by hand, no router",
}
CALLERS: Final = ("vertebra", "zenoh")


async def test_small_messages(plan: Plan, report: Report) -> None:
    outcomes: dict[str, list[Exchange]] = {name: [] for name in SYSTEMS}
    async with AsyncExitStack() as stack:
        locator, _ = await stack.enter_async_context(router())
        endpoints = {"pyzmq": f"tcp://127.0.0.1:{free_tcp_port()}"}
        pairs = {}
        for name in SYSTEMS:
            endpoint = endpoints.get(name, locator)
            stream = Stream(endpoint=endpoint, dtype="|u1", shape=(64,), key=f"bench/{name}")
            pairs[name] = await stack.enter_async_context(Pair.of(name, stream))
        for _ in range(plan.rounds):
            for name, pair in pairs.items():
                outcomes[name].append(await pair.exchange(plan.messages))
    report.raw["small messages"] = outcomes
    assert all(outcome.latency_ns for found in outcomes.values() for outcome in found)
    rows = [
        (
            SYSTEMS[name],
            f"{median([outcome.sent_hz for outcome in found]):,.0f}",
            f"{median([outcome.received_hz for outcome in found]):,.0f}",
            f"{sum(outcome.lost for outcome in found) / sum(o.sent for o in found):.1%}",
        )
        for name, found in outcomes.items()
    ]
    columns = ("system", "sent per second", "received per second", "lost")
    report.tables.append(Table("64-byte messages as fast as they go", columns, rows))


async def test_calls(plan: Plan, report: Report) -> None:
    round_trips_ns: dict[str, list[int]] = {name: [] for name in CALLERS}
    async with AsyncExitStack() as stack:
        locator, _ = await stack.enter_async_context(router())
        callers = {}
        for name in CALLERS:
            stream = Stream(endpoint=locator, dtype="|u1", shape=(64,), key=f"bench/{name}")
            await stack.enter_async_context(started(name, "serve", stream))
            callers[name] = await stack.enter_async_context(started(name, "call", stream))
        for _ in range(plan.rounds):
            for name, caller in callers.items():
                order = Order(run=0, count=plan.calls)
                round_trips_ns[name] += await caller.ask(order, list[int])
    report.raw["calls"] = round_trips_ns
    rows = [
        (SYSTEMS[name], duration(median(found)), duration(percentile(found, 99)))
        for name, found in round_trips_ns.items()
    ]
    report.tables.append(Table("Calls through the router", ("system", "median", "p99"), rows))
