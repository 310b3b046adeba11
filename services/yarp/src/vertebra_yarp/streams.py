"""Streams: messages one way between a YARP port and a key."""

from __future__ import annotations

import asyncio
import time

from vertebra.bus import Delivery
from vertebra.errors import BusyError, CodecError, DecodeError
from vertebra.messages import Header, Message
from vertebra.service import MessageReader, Received
from vertebra.yarp import Counters, Incoming, objects
from vertebra_yarp import mapping
from vertebra_yarp.carried import ORIGIN, Carried, Kit
from vertebra_yarp.driver import Writer
from vertebra_yarp.routes import Stream


class InboundStream(Carried):
    """From a YARP output port to a key, connected only while someone subscribes to the key."""

    kind = "inbound stream"

    def __init__(self, kit: Kit, route: Stream) -> None:
        super().__init__(kit, route.yarp, route.key)
        self.route = route
        self._wanted = asyncio.Event()
        self._unwanted = asyncio.Event()
        self._unwanted.set()
        self._publisher = kit.publisher(route)
        self._demand = kit.context.bus.follow_demand(route.key, self._on_wanted)
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
        reader_name = f"{kit.own_name}/reader{self.route.yarp}"
        link = await kit.transport.read(self.route.yarp, reader_name, self._arrived)
        self.connected()
        try:
            return await link.wait_closed()
        finally:
            await link.close()

    def _arrived(self, incoming: Incoming) -> None:
        received_ns = time.time_ns()
        if self._interval_ns:
            if received_ns < self._next_ns:
                self.traffic.dropped += 1
                return
            self._next_ns = max(self._next_ns + self._interval_ns, received_ns)
        try:
            message = self.to_message(incoming)
        except DecodeError as error:
            self.refuse(error)
            raise  # the link logs it
        captured_ns = mapping.captured_ns(incoming.envelope, received_ns)
        self._publisher.publish(message, captured_ns=captured_ns, hops=1)
        self.traffic.messages += 1
        self.traffic.bytes += len(incoming.payload)

    def to_message(self, incoming: Incoming) -> Message:
        """Return the message in what arrived; raise `DecodeError`."""
        return mapping.to_message(
            incoming.payload,
            self.route.type,
            frame_id=self.route.frame_id,
            dialect=incoming.dialect,
        )

    async def close(self) -> None:
        """End it."""
        self._demand.close()
        await super().close()
        self._publisher.close()


class OutboundStream(Carried):
    """From a key to a YARP output port of ours."""

    kind = "outbound stream"

    def __init__(self, kit: Kit, route: Stream) -> None:
        super().__init__(kit, route.yarp, route.key)
        self.route = route
        self._interval_s = 1.0 / route.max_rate_hz if route.max_rate_hz else 0.0
        self._next_s = 0.0
        self._thinned = 0
        self._past = Counters()  # of ports that were lost

    async def work(self) -> None:
        """Open the port, then write what comes."""
        await self.persist(self._write)

    async def _write(self) -> str:
        kit, route = self.kit, self.route
        writer = await kit.transport.open_writer(
            route.yarp, delivery=route.delivery, depth=route.depth
        )
        self.connected()
        kept = Delivery(route.delivery, route.depth)
        try:
            async with kit.context.bus.subscribe(route.key, kept) as subscription:
                reader = MessageReader(subscription, kit.context.codecs, Message)
                async for received in reader:
                    # What came from YARP does not go back to YARP: no ring, no doubles.
                    if not received.header.origin.startswith(ORIGIN):
                        self._send(received, writer)
        finally:
            self._past += writer.sent
            await writer.close()
        return f"the subscription to {route.key} ended"

    def _send(self, received: Received[Message], writer: Writer) -> None:
        now_s = time.monotonic()
        if now_s < self._next_s:
            self._thinned += 1
        else:
            self._next_s = now_s + self._interval_s
            try:
                payload = mapping.to_payload(received.message, frame_id=self.route.frame_id)
                writer.write(payload, envelope=_envelope(received.header))
            except (CodecError, BusyError) as error:
                self.refuse(error)
                self.kit.context.report(self.name, "warning", str(error))
            else:
                self.traffic.messages += 1
        sent = self._past + writer.sent
        self.traffic.bytes = sent.bytes
        self.traffic.dropped = self._thinned + sent.dropped


def _envelope(header: Header) -> str:
    stamp = objects.Stamp(header.sequence % 2**31, header.captured_ns / 1e9)
    return stamp.to_envelope()
