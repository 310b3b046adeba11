"""Streams: messages one way between a YARP port and a key."""

from __future__ import annotations

import asyncio
import time

from vertebra.bus import Delivery
from vertebra.errors import CodecError, DecodeError
from vertebra.messages import Header, Message
from vertebra.service import MessageReader
from vertebra.yarp import Incoming, objects
from vertebra_yarp import mapping
from vertebra_yarp.carried import ORIGIN, Carried, Kit
from vertebra_yarp.routes import Stream


class InboundStream(Carried):
    """From a YARP output port to a key, connected only while someone subscribes to the key."""

    def __init__(self, kit: Kit, route: Stream) -> None:
        super().__init__(kit, route.yarp)
        self.route = route
        self._wanted = asyncio.Event()
        self._unwanted = asyncio.Event()
        self._unwanted.set()
        self._publisher = kit.publisher(route)
        self._demand = kit.context.bus.follow_demand(route.key, self._on_wanted)
        self._count = kit.count(route)
        self._interval_ns = round(1e9 / route.max_rate_hz) if route.max_rate_hz else 0
        self._next_ns = 0

    def _on_wanted(self, wanted: bool) -> None:  # noqa: FBT001  - the callback of the interface
        (self._wanted if wanted else self._unwanted).set()
        (self._unwanted if wanted else self._wanted).clear()

    async def work(self) -> None:
        """Connect while wanted."""
        context = self.kit.context
        while True:
            await self._wanted.wait()
            reading = asyncio.create_task(self.persist(self._read))
            leaving = asyncio.create_task(self._unwanted.wait())
            try:
                await asyncio.wait([reading, leaving], return_when=asyncio.FIRST_COMPLETED)
            finally:
                reading.cancel()
                leaving.cancel()
                await asyncio.wait([reading, leaving])
            if not reading.cancelled():
                reading.result()
            context.report(self.name, "ok")

    async def _read(self) -> str:
        kit = self.kit
        reader_name = f"{kit.context.settings.prefix}/reader{self.route.yarp}"
        link = await kit.transport.read(self.route.yarp, reader_name, self._arrived)
        kit.context.report(self.name, "ok")
        try:
            return await link.wait_closed()
        finally:
            await link.close()

    def _arrived(self, incoming: Incoming) -> None:
        received_ns = time.time_ns()
        if self._interval_ns:
            if received_ns < self._next_ns:
                return
            self._next_ns = max(self._next_ns + self._interval_ns, received_ns)
        try:
            message = self.to_message(incoming)
        except DecodeError:
            self.kit.refused.inc()
            raise  # the link counts and logs it
        captured_ns = mapping.captured_ns(incoming.envelope, received_ns)
        self._publisher.publish(message, captured_ns=captured_ns, hops=1)
        self._count()

    def to_message(self, incoming: Incoming) -> Message:
        """Return the message in what arrived; raise `DecodeError`."""
        return mapping.to_message(incoming.payload, self.route.type)

    async def close(self) -> None:
        """End it."""
        self._demand.close()
        await super().close()
        self._publisher.close()


class OutboundStream(Carried):
    """From a key to a YARP output port of ours."""

    def __init__(self, kit: Kit, route: Stream) -> None:
        super().__init__(kit, route.yarp)
        self.route = route

    async def work(self) -> None:
        """Open the port, then write what comes."""
        await self.persist(self._write)

    async def _write(self) -> str:
        kit, route = self.kit, self.route
        writer = await kit.transport.open_writer(
            route.yarp, delivery=route.delivery, depth=route.depth
        )
        kit.context.report(self.name, "ok")
        kept = Delivery(route.delivery, route.depth)
        count = kit.count(route)
        interval_s = 1.0 / route.max_rate_hz if route.max_rate_hz else 0.0
        next_s = 0.0
        try:
            async with kit.context.bus.subscribe(route.key, kept) as subscription:
                reader = MessageReader(subscription, kit.context.codecs, Message)
                async for received in reader:
                    # What came from YARP does not go back to YARP: no ring, no doubles.
                    if received.header.origin.startswith(ORIGIN) or time.monotonic() < next_s:
                        continue
                    next_s = time.monotonic() + interval_s
                    try:
                        payload = mapping.to_payload(received.message)
                    except CodecError as error:
                        kit.refused.inc()
                        kit.context.report(self.name, "warning", str(error))
                        continue
                    writer.write(payload, envelope=_envelope(received.header))
                    count()
        finally:
            await writer.close()
        return f"the subscription to {route.key} ended"


def _envelope(header: Header) -> str:
    stamp = objects.Stamp(header.sequence % 2**31, header.captured_ns / 1e9)
    return stamp.to_envelope()
