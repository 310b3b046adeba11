"""From a YARP port through the adapter to a Zenoh subscriber, beside Zenoh without any YARP."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Final

import pytest

from .conftest import Plan
from .peers.peer import Stream, Taken
from .peers.yarp_adapter import RUN
from .processes import Exchange, Pair, name_server, router, started
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(240)]

SHAPES: Final = {"images of 32 x 32": (32, 32, 3), "VGA images": (480, 640, 3)}
RATE_HZ: Final = 100.0
KEY: Final = "yarp/bench/out"
GOAL_NS: Final = 300e3
WAYS: Final = {
    "adapter": "YARP port, adapter, Zenoh, typed subscriber",
    "vertebra": "typed publisher, Zenoh, typed subscriber",
    "zenoh": "Zenoh by hand on both sides, in an event loop",
    "yarp": "YARP port to YARP reader",
}


async def test_the_adapter_adds_little(plan: Plan, report: Report) -> None:
    rows = []
    for what, shape in SHAPES.items():
        found, own_ns = await _exchanges(shape, plan)
        report.raw[f"yarp adapter, {what}"] = found
        latency_ns = {
            way: [ns for exchange in exchanges for ns in exchange.latency_ns]
            for way, exchanges in found.items()
        }
        rows += [
            (
                f"{what}: {words}",
                duration(median(latency_ns[way])),
                duration(percentile(latency_ns[way], 99)),
                str(sum(exchange.lost for exchange in found[way])),
            )
            for way, words in WAYS.items()
        ]
        own = f"{what}: of it in the adapter, socket readable to put returned"
        rows.append((own, duration(median(own_ns)), duration(percentile(own_ns, 99)), ""))
        added_ns = median(
            [
                median(through.latency_ns) - median(direct.latency_ns)
                for through, direct in zip(found["adapter"], found["zenoh"], strict=True)
            ]
        )
        report.goals.append(
            Goal(
                f"YARP port to Zenoh sample, {what}",
                "Zenoh by hand",
                "adds < 0.3 ms",
                duration(added_ns),
                added_ns < GOAL_NS,
            )
        )
    columns = ("way", "median", "p99", "lost")
    title = f"One-way latency through the YARP adapter, {RATE_HZ:.0f} Hz, a process each"
    report.tables.append(Table(title, columns, rows))


async def _exchanges(
    shape: tuple[int, ...], plan: Plan
) -> tuple[dict[str, list[Exchange]], list[int]]:
    """Take every way in turns, on one router and one name server.

    Returns:
        The exchanges of each way, and how long the adapter had each message.
    """
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        names = await enter(name_server())
        locator, _ = await enter(router())

        def stream(endpoint: str, key: str, option: str = "") -> Stream:
            return Stream(endpoint=endpoint, dtype="|u1", shape=shape, key=key, option=option)

        adapter = await enter(started("yarp_adapter", "adapt", stream(locator, KEY, names)))
        sender = await enter(started("yarp", "send", stream(names, "")))
        receiver = await enter(started("vertebra", "receive", stream(locator, KEY)))
        pairs = {"adapter": Pair(sender, receiver, [])}
        await pairs["adapter"].meet()
        for way, options in {"vertebra": (), "zenoh": ("asyncio",)}.items():
            pairs[way] = await enter(Pair.of(way, stream(locator, f"bench/{way}", *options)))
        outcomes: dict[str, list[Exchange]] = {way: [] for way in pairs}
        await adapter.ask(RUN, str)
        for _ in range(plan.rounds):
            for way, pair in pairs.items():
                outcomes[way].append(await pair.exchange(plan.images, rate_hz=RATE_HZ))
        own_ns = (await adapter.ask("take", Taken)).latency_ns
    async with (
        name_server() as names,
        Pair.of("yarp", stream(names, "", "fast_tcp")) as pair,
    ):
        outcomes["yarp"] = [
            await pair.exchange(plan.images, rate_hz=RATE_HZ) for _ in range(plan.rounds)
        ]
    return outcomes, own_ns
