"""A ROS 2 adapter on a backbone in memory, and peers beside it, for tests of both sides."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import random
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.messages import Message, Status
from vertebra.ros2.driver import Participation
from vertebra.service import MessagePublisher, MessageReader, Received, run_service
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

ROOT = Path(__file__).parents[2]
PEER = "tests.live.ros2_peer"
DOMAINS = itertools.cycle(random.sample(range(10, 90), 80))
ON_LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)


@dataclass
class Peer:
    process: asyncio.subprocess.Process
    lines: asyncio.Queue[list[Any]]
    kept: list[list[Any]] = field(default_factory=list)

    async def until(self, *first: Any) -> list[Any]:
        """Return the next line that begins so; others are kept for later."""
        async with asyncio.timeout(10):
            while True:
                for line in self.kept:
                    if line[: len(first)] == list(first):
                        self.kept.remove(line)
                        return line
                self.kept.append(await self.lines.get())
                assert self.kept[-1] != ["ended"]

    def lines_so_far(self) -> list[list[Any]]:
        """Return all lines that nobody waited for."""
        while not self.lines.empty():
            self.kept.append(self.lines.get_nowait())
        return self.kept


@dataclass
class Lab:
    """A running adapter and the backbone it is on."""

    bus: MemoryBus
    codecs: CodecRegistry
    domain_id: int
    service: asyncio.Task[None]
    routes: Path
    instance: str = "1"

    def publisher(self, key: str) -> MessagePublisher:
        return MessagePublisher(self.bus, self.codecs, key)

    def read(self, key: str, wanted: type[Message] = Message) -> MessageReader[Message]:
        return MessageReader(self.bus.subscribe(key, Delivery.queue(5000)), self.codecs, wanted)

    async def call(self, key: str, document: object, timeout_s: float = 5) -> Any:
        payload = json.dumps(document).encode()
        reply = await self.bus.call(key, payload, encoding="application/json", timeout_s=timeout_s)
        return json.loads(reply.payload)

    async def carried(self) -> dict[str, str]:
        key = f"@vertebra/services/ros2/{self.instance}/info"
        reply = await self.bus.call(key, timeout_s=5)
        return dict(json.loads(reply.payload)["routes"])

    async def told(self, fits: Callable[[str], bool]) -> str:
        """Return the first status text that fits."""
        reader = self.read(f"@vertebra/services/ros2/{self.instance}/status", Status)
        async with asyncio.timeout(10):
            async for received in reader:
                assert isinstance(received.message, Status)
                if fits(received.message.text):
                    reader.subscription.close()
                    return received.message.text
        raise AssertionError


@asynccontextmanager
async def adapter(
    network: MemoryNetwork, domain_id: int, routes: Path, **settings: Any
) -> AsyncIterator[Lab]:
    bus = MemoryBus(network)
    chosen = Ros2Settings(domain_id=domain_id, routes=routes, **settings)
    service = asyncio.create_task(run_service("ros2", chosen, serve, bus=MemoryBus(network)))
    lab = Lab(bus, CodecRegistry(), domain_id, service, routes, chosen.instance)
    await lab.told(lambda text: "not ready" not in text)
    try:
        yield lab
    finally:
        service.cancel()
        await asyncio.wait([service], timeout=5)
        await bus.close()
        assert service.done()


@asynccontextmanager
async def lab_with(folder: Path, routes: str = "", **settings: Any) -> AsyncIterator[Lab]:
    """Run an adapter with these routes in a domain, and on a backbone, of its own."""
    file = folder / "routes.yaml"
    await asyncio.to_thread(file.write_text, routes)
    async with adapter(MemoryNetwork(), next(DOMAINS), file, **settings) as lab:
        yield lab


def peer(place: Lab | Participation, *role: str) -> AbstractAsyncContextManager[Peer]:
    """Run a node of Cyclone DDS."""
    environment = {"ROS_DOMAIN_ID": str(place.domain_id), "CYCLONEDDS_URI": ON_LOOPBACK}
    return running(PEER, *role, environment=environment)


@asynccontextmanager
async def running(
    program: str, *arguments: str, environment: dict[str, str]
) -> AsyncIterator[Peer]:
    """Run a module that prints lines of JSON and ends with its input."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", program, *arguments, cwd=ROOT,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        env={**os.environ, **environment},
    )  # fmt: skip
    lines: asyncio.Queue[list[Any]] = asyncio.Queue()

    async def read() -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            lines.put_nowait(json.loads(line))
        lines.put_nowait(["ended"])

    reading = asyncio.create_task(read())
    try:
        yield Peer(process, lines)
    finally:
        assert process.stdin is not None
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), 5)
        except TimeoutError:
            process.kill()
            await process.wait()
        await reading


async def first(reader: MessageReader[Message]) -> Received[Message]:
    async with asyncio.timeout(10):
        return await anext(aiter(reader))


def drain(reader: MessageReader[Message]) -> None:
    while reader.subscription.take() is not None:
        pass


@asynccontextmanager
async def repeated(*doing: Callable[[], object]) -> AsyncIterator[None]:
    """Do something again and again: at first it may be that nobody hears it."""

    async def repeat() -> None:
        while True:
            for one in doing:
                one()
            await asyncio.sleep(0.05)

    repeating = asyncio.create_task(repeat())
    try:
        yield
    finally:
        repeating.cancel()
        await asyncio.wait([repeating])
