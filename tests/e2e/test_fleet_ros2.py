"""ROS nodes in containers of their own, on the network of the fleet: found by multicast."""

from __future__ import annotations

import asyncio
import json
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Final

import pytest

from vertebra.bus import Delivery, ZenohBus
from vertebra.codec import CodecRegistry
from vertebra.messages import Odometry, Text
from vertebra.service import MessageReader

from .fleet import ROOT, Fleet

PEERS: Final = ROOT / "tests/live"
WITHIN_S: Final = 30.0
BACK_WITHIN_S: Final = 10.0


@asynccontextmanager
async def ros_node(fleet: Fleet, *role: str) -> AsyncIterator[Process]:
    """Run a node that shares nothing with the fleet but the network and what is installed."""
    process = await asyncio.create_subprocess_exec(
        "docker", "run", "--rm", "--init", "--interactive", "--network", f"{fleet.project}_default",
        "--volume", f"{PEERS}:/peers/tests/live:ro", "--workdir", "/peers",
        "--env", "ROS_DOMAIN_ID=0",
        "vertebra/ros2", "python", "-m", "tests.live.ros2_peer", *role,
        stdin=PIPE, stdout=PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        assert process.stdin is not None
        process.stdin.close()  # with which the node ends
        await process.communicate()


async def said(process: Process, *first: str) -> list[Any]:
    """Return the next line that begins so."""
    assert process.stdout is not None
    async with asyncio.timeout(WITHIN_S):
        while line := await process.stdout.readline():
            words: list[Any] = json.loads(line)
            if words[: len(first)] == list(first):
                return words
    raise AssertionError(f"it ended before it said {first}")


@pytest.fixture
async def bus(fleet: Fleet) -> AsyncIterator[ZenohBus]:
    for service in ("ros2", "simulator", "face_tracking"):
        fleet.wait_healthy(service)
    bus = await ZenohBus.open(fleet.router, timeout_s=10.0)
    yield bus
    await bus.close()


async def test_what_a_ros_node_says_is_on_the_backbone(fleet: Fleet, bus: ZenohBus) -> None:
    for attempt in range(2):  # the second is a node that comes back
        async with (
            bus.subscribe("ros2/chatter", Delivery.latest()) as subscription,
            ros_node(fleet, "talk", f"hello{attempt}"),
            asyncio.timeout(WITHIN_S),
        ):
            async for received in MessageReader(subscription, CodecRegistry.installed(), Text):
                if received.message.text.startswith(f"hello{attempt}"):
                    break


async def test_a_ros_node_sees_the_faces_of_the_fleet(fleet: Fleet, bus: ZenohBus) -> None:
    async with ros_node(fleet, "know_humans") as node:
        await said(node, "ready")
        while not (told := await said(node, "tracked"))[1]:
            pass  # nobody is in the picture yet
        assert told[3] == "vizzy_camera_left_optical"


async def test_the_adapter_hears_the_robot_again_after_it_crashed(
    fleet: Fleet, bus: ZenohBus
) -> None:
    async with bus.subscribe("vizzy/base/odometry", Delivery.latest()) as subscription:
        reader = MessageReader(subscription, CodecRegistry.installed(), Odometry)
        async with asyncio.timeout(WITHIN_S):
            await anext(aiter(reader))
        fleet.crash("ros2")
        fleet.wait_healthy("ros2")
        subscription.take()
        async with asyncio.timeout(BACK_WITHIN_S):
            await anext(aiter(reader))
