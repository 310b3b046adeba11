"""A YARP adapter on a backbone of its own, in memory, for tests that bring the YARP side."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.messages import Message
from vertebra.service import MessagePublisher, MessageReader, run_service
from vertebra.yarp import NameClient
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

CODECS = CodecRegistry.installed()


@dataclass
class Fleet:
    """A backbone with an adapter on it."""

    network: MemoryNetwork
    bus: MemoryBus

    def read(self, key: str, wanted: type[Message] = Message) -> MessageReader[Message]:
        return MessageReader(self.bus.subscribe(key, Delivery.queue(5000)), CODECS, wanted)

    def publisher(self, key: str) -> MessagePublisher:
        return MessagePublisher(self.bus, CODECS, key)

    async def ask(self, leaf: str, **document: str) -> Any:
        reply = await self.bus.call(
            f"@vertebra/services/yarp/1/{leaf}", json.dumps(document).encode(), timeout_s=5
        )
        return json.loads(reply.payload)

    async def route(self, name: str) -> dict[str, Any]:
        """Return the row of a YARP port in the table of routes, {} if there is none."""
        rows = (await self.ask("routes"))["routes"]
        return next((row for row in rows if row["yarp"] == name), {})

    async def metrics(self) -> str:
        reply = await self.bus.call("@vertebra/services/yarp/1/metrics", timeout_s=5)
        return reply.payload.decode()


@asynccontextmanager
async def fleet(
    names: NameClient, routes: Path | None = None, prefix: str = ""
) -> AsyncIterator[Fleet]:
    network = MemoryNetwork()
    bus = MemoryBus(network)
    settings = YarpSettings(
        name_server=f"{names.host}:{names.tcp_port}", routes=routes, prefix=prefix
    )
    service = asyncio.create_task(run_service("yarp", settings, serve, bus=MemoryBus(network)))
    try:
        async with bus.presence("@vertebra/services/yarp/1/alive") as presence:
            await asyncio.wait_for(anext(presence), 5)
        yield Fleet(network, bus)
    finally:
        service.cancel()
        await asyncio.wait([service], timeout=5)
        await bus.close()
    assert service.done()
