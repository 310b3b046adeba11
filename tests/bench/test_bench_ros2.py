"""Between ROS 2 and the backbone through the adapter, beside two DDS programs without it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from .conftest import Plan
from .peers.peer import Stream, Taken
from .peers.ros2 import RUN
from .processes import Exchange, Pair, Peer, router, started
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(400)]

DOMAIN: Final = "89"
ON_LOOPBACK: Final = {
    "CYCLONEDDS_URI": (
        '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/>'
        "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
        "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers>"
        "</Discovery></Domain></CycloneDDS>"
    )
}
ROUTES: Final = """
topics:
  - {ros: /bench/image_in, key: bench/image_in, type: sensor_msgs/msg/Image, direction: outbound,
     delivery: queue, depth: 1000}
  - {ros: /bench/joints_in, key: bench/joints_in, type: sensor_msgs/msg/JointState,
     direction: outbound, delivery: queue, depth: 1000}
  - {ros: /bench/image_out, key: bench/image_out, depth: 1000}
  - {ros: /bench/joints_out, key: bench/joints_out, depth: 1000}
"""
SHAPES: Final = {"1 kB": (18, 18, 3), "VGA image": (480, 640, 3)}
GOALS_NS: Final = {"1 kB": 0.5e6, "VGA image": 3e6}
RATE_HZ: Final = 100.0
IMAGE_HZ: Final = 30.0
JOINTS_HZ: Final = 1000.0
JOINTS: Final = 20
"""Which are 1 kB."""
WATCH_S: Final = 0.5


@dataclass
class Lab:
    """A router, an adapter on it, and how to start both sides."""

    locator: str
    adapter: Peer
    stack: AsyncExitStack

    async def pair(self, way: str, shape: tuple[int, ...]) -> Pair:
        """Return a sender and a receiver: `dds` or `zenoh` alone, `out` of ROS, or `in`to it."""
        kind = "image" if len(shape) == 3 else "joints"
        dtype = "|u1" if len(shape) == 3 else "<f8"
        topic = f"{kind}_{way}"

        def on(endpoint: str) -> Stream:
            return Stream(
                endpoint=endpoint, dtype=dtype, shape=shape, key=f"bench/{topic}", option=topic
            )

        system, send, take = (
            ("vertebra", "send", "receive") if kind == "image" else ("ros2", "publish", "subscribe")
        )
        start = self.stack.enter_async_context
        if way in ("in", "zenoh"):
            sender = await start(started(system, send, on(self.locator)))
        else:
            sender = await start(started("ros2", "send", on(DOMAIN), ON_LOOPBACK))
        if way in ("out", "zenoh"):
            receiver = await start(started(system, take, on(self.locator)))
        else:
            receiver = await start(started("ros2", "receive", on(DOMAIN), ON_LOOPBACK))
        pair = Pair(sender, receiver, [self.adapter])
        await pair.meet()
        return pair


@asynccontextmanager
async def lab(folder: Path) -> AsyncIterator[Lab]:
    routes = folder / "routes.yaml"
    routes.write_text(ROUTES)
    async with AsyncExitStack() as stack:
        locator, _ = await stack.enter_async_context(router())
        stream = Stream(endpoint=locator, dtype="|u1", shape=(), key=str(routes), option=DOMAIN)
        adapter = await stack.enter_async_context(started("ros2", "adapt", stream))
        yield Lab(locator, adapter, stack)


WAYS: Final = {
    "dds": "DDS to DDS",
    "zenoh": "typed publisher, Zenoh, typed subscriber",
    "out": "DDS, adapter, Zenoh, typed subscriber",
    "in": "typed publisher, Zenoh, adapter, DDS",
}


async def test_the_adapter_adds_little_to_dds(plan: Plan, report: Report, tmp_path: Path) -> None:
    rows = []
    for what, shape in SHAPES.items():
        async with lab(tmp_path) as bench:
            pairs = {way: await bench.pair(way, shape) for way in WAYS}
            found: dict[str, list[Exchange]] = {way: [] for way in WAYS}
            await bench.adapter.ask(RUN, str)
            for _ in range(plan.rounds):
                for way, pair in pairs.items():
                    found[way].append(await pair.exchange(plan.images, rate_hz=RATE_HZ))
            own_ns = (await bench.adapter.ask("take", Taken)).latency_ns
        report.raw[f"ros2 adapter, {what}"] = found
        for way, words in WAYS.items():
            latency_ns = [ns for exchange in found[way] for ns in exchange.latency_ns]
            lost = sum(exchange.lost for exchange in found[way])
            rows.append(
                (
                    f"{what}: {words}",
                    duration(median(latency_ns)),
                    duration(percentile(latency_ns, 99)),
                    str(lost),
                )
            )
        own = f"{what}: of it in the adapter, taken from DDS to put returned"
        rows.append((own, duration(median(own_ns)), duration(percentile(own_ns, 99)), ""))
        for way in ("out", "in"):
            added_ns = median(
                [
                    median(through.latency_ns) - median(direct.latency_ns)
                    for through, direct in zip(found[way], found["dds"], strict=True)
                ]
            )
            report.goals.append(
                Goal(
                    f"{what}, {WAYS[way]}",
                    "DDS to DDS",
                    f"adds < {duration(GOALS_NS[what])}",
                    duration(added_ns),
                    added_ns < GOALS_NS[what],
                )
            )
    columns = ("way", "median", "p99", "lost")
    title = f"One-way latency through the ROS 2 adapter, {RATE_HZ:.0f} Hz, a process each"
    report.tables.append(Table(title, columns, rows))
