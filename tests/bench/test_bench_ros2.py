"""Between ROS 2 and the backbone through the adapter, beside two DDS programs without it."""

from __future__ import annotations

import asyncio
import time
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
from .test_bench_steady import GROWN_BYTES, growth_bytes

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
     delivery: queue, depth: 30}
  - {ros: /bench/joints_in, key: bench/joints_in, type: sensor_msgs/msg/JointState,
     direction: outbound, delivery: queue, depth: 1000}
  - {ros: /bench/image_out, key: bench/image_out, depth: 64}
  - {ros: /bench/joints_out, key: bench/joints_out, depth: 1000}
"""
SHAPES: Final = {"1 kB": (18, 18, 3), "VGA image": (480, 640, 3)}
GOALS_NS: Final = {"1 kB": 0.5e6, "VGA image": 3e6}
RATES_HZ: Final = {"1 kB": 1000, "VGA image": 30}
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
        rate_hz = RATES_HZ[what]
        async with lab(tmp_path) as bench:
            pairs = {way: await bench.pair(way, shape) for way in WAYS}
            found: dict[str, list[Exchange]] = {way: [] for way in WAYS}
            await bench.adapter.ask(RUN, str)
            for _ in range(plan.rounds):
                for way, pair in pairs.items():
                    found[way].append(await pair.exchange(rate_hz, rate_hz=rate_hz))
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
    title = "One-way latency through the ROS 2 adapter, a process each; 1 kB at 1 kHz, VGA at 30 Hz"
    report.tables.append(Table(title, columns, rows))


async def test_images_and_joints_cross_steadily(plan: Plan, report: Report, tmp_path: Path) -> None:
    """VGA images at 30 Hz and 1 kB of joints at 1 kHz at the same time, first out, then in."""
    rows = []
    for way in ("out", "in"):
        async with lab(tmp_path) as bench:
            pairs = {
                30: await bench.pair(way, SHAPES["VGA image"]),
                1000: await bench.pair(way, (JOINTS,)),
            }
            began_s, began_cpu_s = time.monotonic(), bench.adapter.cpu_s()
            exchanges = [
                pair.exchange(round(plan.steady_s * rate_hz), rate_hz=rate_hz, watch_s=WATCH_S)
                for rate_hz, pair in pairs.items()
            ]
            images, joints = await asyncio.gather(*exchanges)
            cpu = (bench.adapter.cpu_s() - began_cpu_s) / (time.monotonic() - began_s)
        report.raw[f"ros2 steady, {way}"] = {"images": images, "joints": joints}
        grown_bytes = growth_bytes(joints)
        for what, exchange in (("VGA image at 30 Hz", images), ("joints at 1 kHz", joints)):
            rows.append(
                (
                    f"{what}: {WAYS[way]}",
                    f"{exchange.sent_hz:.0f} Hz",
                    duration(median(exchange.latency_ns)),
                    duration(percentile(exchange.latency_ns, 99)),
                    str(exchange.lost),
                    f"{cpu:.0%}",
                    f"{grown_bytes / 1e6:+.1f} MB",
                )
            )
        lost = images.lost + joints.lost
        report.goals.append(
            Goal(
                f"VGA at 30 Hz and joints at 1 kHz, {WAYS[way]}",
                "itself",
                "no loss, no growth",
                f"{lost} lost, {grown_bytes / 1e6:+.1f} MB",
                lost == 0 and grown_bytes < GROWN_BYTES,
            )
        )
    columns = ("stream", "sent at", "median", "p99", "lost", "CPU of the adapter", "memory grows")
    title = f"Images and joints through the ROS 2 adapter for {plan.steady_s:.0f} s"
    report.tables.append(Table(title, columns, rows))
