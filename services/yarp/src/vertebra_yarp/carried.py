"""What all routes have in common: one task each, which lives through losses of the peer."""

from __future__ import annotations

import asyncio
import platform
import re
import time
from collections.abc import Awaitable, Callable
from typing import ClassVar, Final

from msgspec import Struct

from vertebra.bus import Priority
from vertebra.errors import TransportError
from vertebra.service import Context, MessagePublisher
from vertebra_yarp.driver import Transport
from vertebra_yarp.routes import Stream
from vertebra_yarp.settings import YarpSettings

ORIGIN: Final = "yarp:"
"""Begins the origin of every message that came from YARP."""
OWN_NAMES: Final = "/vertebra/"
"""YARP names of all adapters begin with it; none mirrors what is below."""
RETRY_FIRST_S: Final = 0.2
RETRY_LAST_S: Final = 1.0
_BULK: Final = frozenset({"auto", "Image"})


class Traffic(Struct):
    """What a route has carried since it began, and how it is now.

    Attributes:
        messages: Messages, or calls that were answered.
        bytes: Their YARP payloads.
        dropped: Let go: thinned out by `max_rate_hz`, or replaced by newer ones.
        refused: Not carried: unreadable, of another type, without a form on the other side, or
            more than a queue holds.
        connected: The YARP side is there.
        last_error: What went wrong last, empty if nothing did.
    """

    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    refused: int = 0
    connected: bool = False
    last_error: str = ""


class Kit:
    """What every route has at hand.

    Attributes:
        own_name: Our own YARP names are below this; no other adapter has it.
        carried: The routes at work.
    """

    def __init__(self, context: Context[YarpSettings], transport: Transport) -> None:
        self.context = context
        self.transport = transport
        self.own_name = context.settings.prefix or _own_name(context.bus.info().identity)
        self.carried: list[Carried] = []
        self.refused = context.counter("yarp_refused", "Messages and calls not carried")

    def publisher(self, route: Stream) -> MessagePublisher:
        """Return the publisher of an inbound route."""
        return self.context.publisher(
            route.key,
            priority=Priority.BULK if route.type in _BULK else Priority.DATA,
            origin=f"{ORIGIN}{route.yarp}",
        )


class Carried:
    """A route at work: what it does is one task, which lives through losses of the peer.

    Attributes:
        kind: What the table of routes calls it.
        name: The YARP port or part.
        key: Where it is on the backbone.
        traffic: What it has carried.
    """

    kind: ClassVar[str]

    def __init__(self, kit: Kit, name: str, key: str) -> None:
        self.kit = kit
        self.name = name
        self.key = key
        self.traffic = Traffic()
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to work."""
        self.kit.carried.append(self)
        self._task = self.kit.context.tasks.create_task(self.work(), name=f"route {self.name}")

    async def work(self) -> None:
        """Do the work of the route until cancelled."""
        raise NotImplementedError

    async def close(self) -> None:
        """End the work and everything it opened."""
        if self._task is not None:
            self.kit.carried.remove(self)
            self._task.cancel()
            await asyncio.wait([self._task])
            self._task = None

    def connected(self) -> None:
        """Tell that the YARP side is there."""
        self.traffic.connected = True
        self.kit.context.report(self.name, "ok")

    def refuse(self, reason: object) -> None:
        """Count a message that cannot be carried."""
        self.traffic.refused += 1
        self.traffic.last_error = str(reason)
        self.kit.refused.inc()

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
            finally:
                self.traffic.connected = False
            self.traffic.last_error = reason
            report(self.name, "warning", reason)
            if time.monotonic() - began_s > RETRY_LAST_S:
                pause_s = RETRY_FIRST_S
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, RETRY_LAST_S)


def _own_name(identity: str) -> str:
    """Return a name for an adapter that no other has: two fleets may share a name server."""
    host = re.sub(r"[^A-Za-z0-9_.-]", "_", platform.node()) or "host"
    return f"{OWN_NAMES}{host}-{identity[:8]}"
