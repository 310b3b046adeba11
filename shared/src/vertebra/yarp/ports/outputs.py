"""The side of a connection that writes, and messages on their way out."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from vertebra.errors import BusyError, CodecError, DecodeError, EncodeError
from vertebra.yarp.objects import YarpObject, read
from vertebra.yarp.ports.link import Channel, Delivery, Link
from vertebra.yarp.protocol.bottle import Value, decode, encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.hints import dialect_of
from vertebra.yarp.protocol.mjpeg import JpegCodec
from vertebra.yarp.protocol.receiver import Event, Message, Number
from vertebra.yarp.protocol.text import to_text
from vertebra.yarp.protocol.wire import (
    TEXT_ACK_LINE,
    Buffer,
    Carrier,
    binary_message,
    command,
    quit_message,
    text_message,
)

Payload: TypeAlias = Buffer | YarpObject | Sequence[Value]
"""Bytes that are one serialised object, an object, or the values of a bottle."""


_AHEAD: Final = 8
"""Messages of a queue that travel before the first of them is acknowledged. Readers take one after
the other all the same, but do not wait for us in between."""


class Outgoing:
    """A message on its way to several outputs; each form is made once, where one needs it."""

    __slots__ = (
        "_command",
        "_jpeg",
        "_max_text_bytes",
        "_messages",
        "_payload",
        "_texts",
        "envelope",
    )

    def __init__(self, payload: Payload, envelope: str, max_text_bytes: int) -> None:
        self._payload = payload
        self.envelope = envelope
        self._command = command("D", envelope)
        self._max_text_bytes = max_text_bytes
        self._messages: dict[Dialect, Form] = {}
        self._texts: dict[Dialect, Form] = {}
        self._jpeg: asyncio.Future[bytes] | None = None

    def check(self, first: Dialect | None) -> None:
        """Raise EncodeError if the payload has no form at all; try the dialect `first` first."""
        try:
            self.form(first or Dialect.V3, is_text=False)
        except EncodeError:
            # Readers of one dialect need not keep the writer from serving the others.
            self.form(Dialect.V3 if first is Dialect.V4 else Dialect.V4, is_text=False)

    def form(self, dialect: Dialect, *, is_text: bool) -> Form:
        """Return what goes to the socket.

        Raises:
            CodecError: The payload has no such form, or one that is too long.
        """
        forms = self._texts if is_text else self._messages
        form = forms.get(dialect)
        if form is None:
            make = self._as_text if is_text else self._as_message
            form = forms[dialect] = make(parts_of(self._payload, dialect), dialect)
        return form

    def _as_message(self, parts: Sequence[Buffer], _: Dialect) -> Form:
        return Form(binary_message(self._command, parts), sum(map(len, parts)))

    def _as_text(self, parts: Sequence[Buffer], dialect: Dialect) -> Form:
        size = sum(map(len, parts))
        if size > self._max_text_bytes:
            raise DecodeError(
                f"a payload of {size} bytes is not turned into text, the limit max_text_bytes is "
                f"{self._max_text_bytes}; use tcp or fast_tcp"
            )
        text = to_text(decode(b"".join(parts), dialect), dialect)
        return Form((text_message("D", self.envelope, text),), size)

    async def jpeg(self, codec: JpegCodec) -> bytes:
        """Return the image as a JPEG, made once in a thread for all who want it.

        Raises:
            CodecError: It is no image, or one of pixels that JPEG does not know.
        """
        if self._jpeg is None:
            loop = asyncio.get_running_loop()
            parts = parts_of(self._payload, Dialect.V3)  # images are the same in both
            payload = parts[0] if len(parts) == 1 else b"".join(parts)
            self._jpeg = loop.run_in_executor(None, codec.encode, payload)
        return await asyncio.shield(self._jpeg)


class Form(NamedTuple):
    """A message as one kind of connection carries it, and the size of its payload."""

    buffers: Sequence[Buffer]
    size: int


def parts_of(payload: Payload, dialect: Dialect) -> Sequence[Buffer]:
    """Return a payload in a dialect, large data not copied.

    Raises:
        EncodeError: It has no form in this dialect.
    """
    if isinstance(payload, YarpObject):
        return [*map(_octets, payload.encode_parts(dialect))]
    if isinstance(payload, bytes | bytearray | memoryview):
        written_in = dialect_of(payload)
        if written_in in (None, dialect):
            return [_octets(payload)]
        payload = read(payload, written_in)
        return parts_of(payload, dialect)
    return [encode(payload, dialect)]


def _octets(part: Buffer) -> Buffer:
    return part if isinstance(part, bytes) else memoryview(part).cast("B")


class Output(Link):
    """A connection to which a port writes; never blocks, holds at most `depth` messages back.

    Attributes:
        dialect: What the reader speaks; None holds messages back until it is known.
        is_reverse: The reader has dialled us.
    """

    def __init__(
        self,
        connection: Channel,
        peer: str,
        carrier: Carrier,
        modifiers: Sequence[str],
        dialect: Dialect | None,
        *,
        delivery: Delivery,
        depth: int,
        is_reverse: bool,
    ) -> None:
        super().__init__(connection, peer, "+".join((carrier.name, *modifiers)))
        self.is_reverse = is_reverse
        self.dialect = dialect
        self._carrier = carrier
        self._delivery = delivery
        self._waiting: deque[Outgoing] = deque()
        self._depth = 1 if delivery == "latest" else depth
        self._ahead = 1 if delivery == "latest" else min(depth, _AHEAD)
        self._unacknowledged = 0
        self._room = asyncio.Event()
        connection.on_event = self._on_event
        connection.on_writable = self._flush
        connection.replies = False

    @property
    def is_connectionless(self) -> bool:
        """Whether messages go as datagrams."""
        return self._carrier.is_connectionless

    def offer(self, message: Outgoing) -> None:
        """Send now, or keep for later, or drop, as `delivery` says.

        Raises:
            BusyError: The queue is full.
        """
        if not self._waiting and self._takes_more:
            self._send(message, self._connection.write)
            return
        if self._is_full:
            if self._delivery == "queue":
                self.counters.refused += 1
                raise BusyError(f"the YARP connection to {self.peer}", self._depth)
            self._waiting.popleft()
            self.counters.dropped += 1
        self._waiting.append(message)

    def settle(self, dialect: Dialect) -> None:
        """Note what the reader speaks, and send what waits."""
        self.dialect = dialect
        self._flush()

    async def wait_for_room(self) -> None:
        """Wait until `offer` would neither drop nor refuse a message."""
        while self._is_full and not self.closed:
            self._room.clear()
            await self._room.wait()

    def let_go(self) -> None:
        """Keep nothing for a reader that has gone, and nobody waiting for it."""
        self._waiting.clear()
        self._room.set()

    async def close(self) -> None:
        """Tell the reader, then end the connection; what waits is not sent any more."""
        self.leave("closed by us")
        await self.wait_closed()

    def leave(self, reason: str) -> None:
        """Begin to end the connection."""
        if farewell := quit_message(self._carrier):
            self._connection.write(farewell)
        self._connection.close(reason)
        self.let_go()

    @property
    def _backlog(self) -> int:
        """Messages that wait for the acknowledgement of an earlier one, sent or not."""
        return len(self._waiting) + max(0, self._unacknowledged - 1)

    @property
    def _is_full(self) -> bool:
        return self._backlog >= self._depth

    @property
    def _takes_more(self) -> bool:
        return (
            self._unacknowledged < self._ahead
            and self._connection.writable
            and self.dialect is not None
        )

    def _send(self, message: Outgoing, write: Callable[..., None]) -> None:
        try:
            form = message.form(self.dialect or Dialect.V3, is_text=self._carrier.is_text)
        except CodecError as error:
            self._lose(error)
            return
        self._unacknowledged += self._carrier.acks
        self.counters.messages += 1
        self.counters.bytes += form.size
        write(*form.buffers)

    def _flush(self) -> None:
        while self._waiting and self._takes_more:
            self._send(self._waiting.popleft(), self._connection.postpone)
        self._connection.flush()
        if self._backlog <= self._depth // 2:  # so that a writer wakes for several messages
            self._room.set()

    def _on_event(self, event: Event) -> None:
        if _is_ack(event):
            # A reader who ends our connection because we have made another one acks once more.
            self._unacknowledged = max(0, self._unacknowledged - 1)
            if self._unacknowledged <= self._ahead // 2:  # several leave at once, as they came
                self._flush()
        elif not (isinstance(event, Message) and event.command == ""):
            raise DecodeError(f"{self.peer} reads over {self.carrier}, but sent {event!r:.80}")


def _is_ack(event: Event) -> bool:
    if isinstance(event, Number):
        return event.value == 0
    return isinstance(event, Message) and event.command == TEXT_ACK_LINE
