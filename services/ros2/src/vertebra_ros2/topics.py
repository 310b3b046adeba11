"""Topics: messages one way between a ROS topic and a key."""

from __future__ import annotations

import asyncio
import time
from typing import Final

from vertebra.bus import Delivery, Priority, Publisher, Sample
from vertebra.errors import CodecError, TransportError
from vertebra.messages import Message
from vertebra.ros2 import mapping
from vertebra.ros2.driver import Reader, Writer
from vertebra.ros2.qos import Qos, for_reader, for_writer
from vertebra.service import MessagePublisher
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Topic

CDR_ENCODING: Final = "application/cdr"
"""Payloads as they are on ROS; behind `;` stands their ROS type."""
LEAST_WAITING: Final = 64
"""So many messages of a topic may wait for us at least; those that are too many are counted."""
SILENT_S: Final = 5.0
_BULK: Final = frozenset(
    {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2"}
)


class InboundTopic:
    """From a ROS topic to a key, read only while someone subscribes to the key."""

    def __init__(self, kit: Kit, route: Topic) -> None:
        self.kit = kit
        self.route = route
        self._wanted = False
        self._reader: Reader | None = None
        self._read_as: tuple[str, Qos] | None = None
        self._dropped = 0
        self._heard_at_s = 0.0
        self._interval_ns = round(1e9 / route.max_rate_hz) if route.max_rate_hz else 0
        self._next_ns = 0
        self._count = kit.messages.labels(route.ros, route.key, route.direction)
        self._publisher: MessagePublisher | Publisher | None = None
        self._demand = kit.context.bus.follow_demand(route.key, self._on_wanted)

    def _on_wanted(self, wanted: bool) -> None:  # noqa: FBT001  - the callback of the interface
        self._wanted = wanted
        self.look()

    def look(self) -> None:
        """Read the topic as its publishers offer it, if anybody wants it."""
        writers = self.kit.transport.graph.writers(self.route.ros)
        if not self._wanted or not writers:
            self._stop()
            self._report("")
            return
        type_name = self.route.type or writers[0].type
        problem = self.kit.clash(writers, type_name)
        if problem:
            self._stop()
            self._report(problem)
            return
        depth = max(self.route.depth, LEAST_WAITING)
        wanted_as = (type_name, for_reader((one.qos for one in writers), depth))
        if self._reader is not None and wanted_as == self._read_as:
            self._watch()
            return
        self._stop()
        try:
            self._reader = self.kit.transport.reader(self.route.ros, *wanted_as, self._came)
        except TransportError as error:
            self._report(str(error))
            return
        self._read_as = wanted_as
        self._heard_at_s = time.monotonic()
        self._publisher = self._open(type_name)
        self._report("")

    def _open(self, type_name: str) -> MessagePublisher | Publisher:
        context, key = self.kit.context, self.route.key
        priority = Priority.BULK if type_name in _BULK else Priority.DATA
        if type_name not in self.kit.types:
            encoding = f"{CDR_ENCODING};{type_name}"
            return context.bus.publisher(key, encoding=encoding, priority=priority)
        origin = f"{self.kit.origin}{self.route.ros}"
        return context.publisher(key, priority=priority, origin=origin)

    def _watch(self) -> None:
        """Tell what DDS says of the reader."""
        if self._reader is None:
            return
        self.kit.dropped.inc(self._reader.dropped - self._dropped)
        self._dropped = self._reader.dropped
        differs = self._reader.mismatch
        problem = f"a publisher is not heard: its {differs} differs" if differs else ""
        if differs and time.monotonic() > self._heard_at_s + SILENT_S:
            problem = f"0 messages in {SILENT_S:g} s: the {differs} of its publisher differs"
        self._report(problem)

    def _report(self, problem: str) -> None:
        self.kit.report(f"topic {self.route.ros}", problem)

    def _came(self, payload: bytes, sent_ns: int) -> None:
        self._heard_at_s = time.monotonic()
        if self._interval_ns:
            if sent_ns < self._next_ns:
                return
            self._next_ns = max(self._next_ns + self._interval_ns, sent_ns)
        if self._read_as is None or self._publisher is None:
            return
        if isinstance(self._publisher, MessagePublisher):
            self._publish(self._publisher, payload, self._read_as[0], sent_ns)
        else:
            self._publisher.put(payload)
        self._count.inc()

    def _publish(
        self, publisher: MessagePublisher, payload: bytes, type_name: str, sent_ns: int
    ) -> None:
        try:
            record = self.kit.cdr.decode(payload, type_name)
            message = self.to_message(record, type_name)
        except CodecError:
            self.kit.refused.inc()
            raise  # the driver logs it
        publisher.publish(message, captured_ns=mapping.captured_ns(record, sent_ns), hops=1)

    def to_message(self, record: mapping.Record, type_name: str) -> Message:
        """Return the message that a record is on the backbone; raise `CodecError`."""
        return mapping.to_message(record, type_name, self.route.sound)

    def _stop(self) -> None:
        if self._reader is not None:
            self._watch()
            self._reader.close()
            self._reader = self._read_as = None
            self._dropped = 0
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None

    async def close(self) -> None:
        """End it."""
        self._demand.close()
        self._stop()
        self._report("")


class OutboundTopic:
    """From a key to a ROS topic, offered as its subscribers ask for it."""

    def __init__(self, kit: Kit, route: Topic) -> None:
        self.kit = kit
        self.route = route
        self._writer: Writer | None = None
        self._offered: Qos | None = None
        self._work: asyncio.Task[None] | None = None
        self._count = kit.messages.labels(route.ros, route.key, route.direction)
        kit.types.definition(route.type)  # an unknown type is a fault of the route
        self.look()

    def look(self) -> None:
        """Offer what the subscribers of the topic ask for; carry while there are any."""
        route = self.route
        readers = self.kit.transport.graph.readers(route.ros)
        offered = for_writer((one.qos for one in readers), route.depth)
        if route.retain:
            offered = Qos(durability="transient_local", depth=route.depth)
        if offered != self._offered or self._writer is None:
            if self._writer is not None:
                self._writer.close()
            self._writer = self.kit.transport.writer(route.ros, route.type, offered)
            self._offered = offered
        problem = self.kit.clash(readers, route.type)
        if not problem and readers and self._writer.mismatch:
            problem = f"a subscriber does not hear us: its {self._writer.mismatch} differs"
        self._report(problem)
        if self._work is None and (readers or route.retain):
            self._work = self.kit.context.tasks.create_task(self._carry(), name=f"to {route.ros}")
        elif self._work is not None and not readers and not route.retain:
            self._work.cancel()
            self._work = None

    def _report(self, problem: str) -> None:
        self.kit.report(f"topic {self.route.ros}", problem)

    async def _carry(self) -> None:
        route = self.route
        kept = Delivery(route.delivery, route.depth)
        interval_s = 1.0 / route.max_rate_hz if route.max_rate_hz else 0.0
        next_s = 0.0
        async with self.kit.context.bus.subscribe(route.key, kept) as subscription:
            async for sample in subscription:
                now_s = time.monotonic()
                if now_s < next_s:
                    continue
                try:
                    payload = self._payload(sample)
                    if payload is None or self._writer is None:
                        continue
                    self._writer.write(payload)
                except (CodecError, TransportError) as error:
                    self.kit.refused.inc()
                    self._report(str(error))
                else:
                    next_s = now_s + interval_s
                    self._count.inc()

    def _payload(self, sample: Sample) -> bytes | None:
        """Return the payload for ROS; None for what came from there: no ring, no doubles."""
        if sample.encoding.startswith(CDR_ENCODING):
            self.kit.cdr.decode(sample.payload, self.route.type)
            return sample.payload
        message, header = self.kit.context.codecs.decode(sample.payload, sample.encoding)
        if header.origin.startswith(self.kit.origin):
            return None
        stamp_ns = header.captured_ns or sample.sent_ns or time.time_ns()
        record = mapping.to_record(message, self.route.type, stamp_ns)
        return self.kit.cdr.encode(record, self.route.type)

    async def close(self) -> None:
        """End it."""
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait([self._work])
        if self._writer is not None:
            self._writer.close()
        self._report("")
