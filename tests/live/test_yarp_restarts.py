"""Name server, robot, router and adapter are killed and come back in any order; data flow again."""

from __future__ import annotations

import asyncio
import itertools
import os
import sys
import time
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from vertebra.bus import Delivery, ZenohBus
from vertebra.codec import CodecRegistry
from vertebra.messages import Bottle
from vertebra.service import MessageReader
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port

pytestmark = pytest.mark.live

PEER: Final = Path(__file__).parent / "yarp_peer.py"
HEALS_WITHIN_S: Final = 5.0
OUTSIDE: Final = ("name server", "robot", "router")


class Lab:
    """Everything as processes of its own, and a subscriber here."""

    def __init__(self, folder: Path) -> None:
        name_server, router = free_tcp_port(), free_tcp_port()
        self.router = f"tcp/127.0.0.1:{router}"
        self._environment = {
            **{name: value for name, value in os.environ.items() if "VERTEBRA" not in name},
            "VERTEBRA_HEARTBEAT_DIR": str(folder),
            "VERTEBRA_ROUTER": self.router,
            "VERTEBRA_ROUTER_LISTEN": f'["{self.router}"]',
            "VERTEBRA_YARP_NAME_SERVER": f"127.0.0.1:{name_server}",
        }
        self._commands = {
            "name server": [str(PEER), "serve", "/root", str(name_server)],
            "robot": [str(PEER), "write", "/robot/out", str(name_server)],
            "router": ["-m", "vertebra_router"],
            "adapter": ["-m", "vertebra_yarp"],
        }
        self._running: dict[str, Process] = {}

    async def start(self, what: str) -> None:
        self._running[what] = await asyncio.create_subprocess_exec(
            sys.executable,
            *self._commands[what],
            env=self._environment,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )

    async def kill(self, what: str) -> None:
        process = self._running.pop(what)
        process.kill()
        await process.wait()

    async def stop(self) -> None:
        for what in [*self._running]:
            await self.kill(what)


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    lab = Lab(tmp_path)
    for what in ("router", "name server", "robot", "adapter"):
        await lab.start(what)
    yield lab
    await lab.stop()


@pytest.fixture
async def reader(lab: Lab) -> AsyncIterator[MessageReader[Bottle]]:
    bus = await ZenohBus.open(lab.router)
    subscription = bus.subscribe("yarp/robot/out", Delivery.latest())
    reader = MessageReader(subscription, CodecRegistry(), Bottle)
    await eventually(lambda: subscription.received > 0, timeout_s=15)
    yield reader
    subscription.close()
    await bus.close()


async def flows_again(reader: MessageReader[Bottle]) -> float:
    """Return how long it took until data came that nobody had sent before."""
    began_s, began_ns = time.monotonic(), time.time_ns()
    async with asyncio.timeout(HEALS_WITHIN_S):
        async for received in reader:
            if received.header.captured_ns > began_ns:
                break
    return time.monotonic() - began_s


@pytest.mark.parametrize("what", ["name server", "robot", "router", "adapter"])
async def test_one_is_killed_and_comes_back(
    lab: Lab, reader: MessageReader[Bottle], what: str
) -> None:
    await lab.kill(what)
    await lab.start(what)
    await flows_again(reader)


@pytest.mark.parametrize("order", [*itertools.permutations(OUTSIDE)], ids=" then ".join)
async def test_all_around_the_adapter_are_killed_and_come_back_in_any_order(
    lab: Lab, reader: MessageReader[Bottle], order: tuple[str, ...]
) -> None:
    for what in OUTSIDE:
        await lab.kill(what)
    for what in order:
        await lab.start(what)
    await flows_again(reader)


async def test_a_robot_streams_on_while_there_is_no_name_server(
    lab: Lab, reader: MessageReader[Bottle]
) -> None:
    await lab.kill("name server")
    received = reader.subscription.received
    await asyncio.sleep(3)  # the adapter has looked for it several times
    assert reader.subscription.received > received + 1000
    await lab.start("name server")
    for _ in range(30):  # an empty list of names ends nothing that is alive
        before = reader.subscription.received
        await asyncio.sleep(0.1)
        assert reader.subscription.received > before
