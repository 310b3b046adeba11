"""Our YARP ports against each other, on the real wire, between two processes."""

from __future__ import annotations

from typing import Final

import pytest

from .conftest import Plan
from .peers.peer import Order, Stream
from .processes import Pair, name_server, started
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(120)]

CARRIERS: Final = ("tcp", "fast_tcp")
SHAPES: Final = {"VGA images": (480, 640, 3), "64-byte bottles": (56,)}
"""A bottle of one blob has 8 bytes beside it."""
RATE_HZ: Final = 100.0
CPP_IMAGES_HZ: Final = 2550
CPP_ONE_WAY: Final = "61 µs"
CPP_RPC: Final = "69 µs"
"""The C++ library through its Python bindings, measured on another machine (DESIGN 11)."""


async def test_yarp_streams(plan: Plan, report: Report) -> None:
    rows, raw = [], {}
    for what, shape in SHAPES.items():
        for carrier in CARRIERS:
            async with name_server() as endpoint:
                stream = Stream(endpoint=endpoint, dtype="|u1", shape=shape, option=carrier)
                async with Pair.of("yarp", stream) as pair:
                    flood = [await pair.exchange(plan.messages // 10) for _ in range(plan.rounds)]
                    paced = await pair.exchange(plan.images, rate_hz=RATE_HZ)
            raw[f"{what}, {carrier}"] = {"flood": flood, "paced": paced}
            received_hz = median([outcome.received_hz for outcome in flood])
            rows.append(
                (
                    f"{what}, {carrier}",
                    f"{received_hz:,.0f}",
                    str(sum(outcome.lost for outcome in (*flood, paced))),
                    duration(median(paced.latency_ns)),
                    duration(percentile(paced.latency_ns, 99)),
                )
            )
            if shape == SHAPES["VGA images"]:
                ratio = received_hz / CPP_IMAGES_HZ
                measured = f"{received_hz:,.0f}/s, {ratio:.2f} x"
                against = f"C++ library, {CPP_IMAGES_HZ}/s elsewhere"
                what_goal = f"YARP driver, VGA images over {carrier}"
                report.goals.append(Goal(what_goal, against, ">= 0.6 x", measured, ratio >= 0.6))
    report.raw["yarp streams"] = raw
    columns = ("stream", "received per second", "lost", f"one-way at {RATE_HZ:.0f} Hz", "p99")
    title = f"YARP ports, two processes (C++ bindings elsewhere: one-way {CPP_ONE_WAY})"
    report.tables.append(Table(title, columns, rows))


async def test_yarp_calls(plan: Plan, report: Report) -> None:
    async with name_server() as endpoint:
        stream = Stream(endpoint=endpoint, dtype="|u1", shape=(56,))
        async with started("yarp", "serve", stream), started("yarp", "call", stream) as caller:
            order = Order(run=0, count=plan.calls * plan.rounds)
            found = await caller.ask(order, list[int])
    report.raw["yarp calls"] = found
    rows = [("Vertebra", duration(median(found)), duration(percentile(found, 99)))]
    title = f"YARP RPC, two processes (C++ bindings elsewhere: {CPP_RPC})"
    report.tables.append(Table(title, ("system", "median", "p99"), rows))
    reached = median(found) < 200e3
    goal = Goal("YARP RPC", "", "median < 200 µs", duration(median(found)), reached)
    report.goals.append(goal)
