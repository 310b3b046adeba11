"""What all routes have in common: one task each, which lives through losses of the peer."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Final

from prometheus_client import Counter

from vertebra.bus import Priority
from vertebra.errors import TransportError
from vertebra.service import Context, MessagePublisher
from vertebra_yarp.driver import Transport
from vertebra_yarp.routes import Stream
from vertebra_yarp.settings import YarpSettings

ORIGIN: Final = "yarp:"
"""Begins the origin of every message that came from YARP."""
RETRY_FIRST_S: Final = 0.2
RETRY_LAST_S: Final = 2.0
_BULK: Final = frozenset({"auto", "Image"})


class Kit:
    """What every route has at hand."""

    def __init__(self, context: Context[YarpSettings], transport: Transport) -> None:
        self.context = context
        self.transport = transport
        self.refused = context.counter("yarp_refused", "Messages that could not be read or mapped")
        self._messages = Counter(
            "yarp_messages",
            "Messages that a route carried",
            ["yarp", "key", "direction"],
            namespace="vertebra",
            registry=context.metrics,
        )

    def count(self, route: Stream) -> Callable[[], None]:
        """Return what counts a message of a route."""
        return self._messages.labels(route.yarp, route.key, route.direction).inc

    def publisher(self, route: Stream) -> MessagePublisher:
        """Return the publisher of an inbound route."""
        return self.context.publisher(
            route.key,
            priority=Priority.BULK if route.type in _BULK else Priority.DATA,
            origin=f"{ORIGIN}{route.yarp}",
        )


class Carried:
    """A route at work: what it does is one task, which lives through losses of the peer."""

    def __init__(self, kit: Kit, name: str) -> None:
        self.kit = kit
        self.name = name
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to work."""
        self._task = self.kit.context.tasks.create_task(self.work(), name=f"route {self.name}")

    async def work(self) -> None:
        """Do the work of the route until cancelled."""
        raise NotImplementedError

    async def close(self) -> None:
        """End the work and everything it opened."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    async def persist(self, connect: Callable[[], Awaitable[str]]) -> None:
        """Run `connect`, which returns why the connection ended, again and again."""
        report = self.kit.context.report
        pause_s = RETRY_FIRST_S
        while True:
            began_s = time.monotonic()
            try:
                reason = await connect()
            except TransportError as error:
                reason = str(error)
            report(self.name, "warning", reason)
            if time.monotonic() - began_s > RETRY_LAST_S:
                pause_s = RETRY_FIRST_S
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, RETRY_LAST_S)
