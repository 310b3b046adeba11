"""The side of a connection that writes, and messages on their way out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from vertebra.errors import BusyError, CodecError, DecodeError
from vertebra.yarp.bottle import decode
from vertebra.yarp.dialect import Dialect
from vertebra.yarp.link import Channel, Delivery, Link
from vertebra.yarp.receiver import Event, Message, Number
from vertebra.yarp.text import to_text
from vertebra.yarp.wire import (
    TEXT_ACK_LINE,
    Buffer,
    Carrier,
    binary_message,
    command,
    quit_message,
    text_message,
)


class Outgoing:
    """A message on its way to several outputs; each form is made once, where one needs it."""

    __slots__ = (
        "_buffers",
        "_dialect",
        "_envelope",
        "_max_text_bytes",
        "_payload",
        "_text",
        "size",
    )

    def __init__(
        self, payload: Sequence[Buffer], envelope: str, dialect: Dialect, max_text_bytes: int
    ) -> None:
        self.size = sum(map(len, payload))
        self._payload = payload
        self._envelope = envelope
        self._dialect = dialect
        self._max_text_bytes = max_text_bytes
        self._buffers = binary_message(command("D", envelope), payload)
        self._text: bytes | None = None

    def buffers(self, carrier: Carrier) -> Iterable[Buffer]:
        """Return what goes to the socket.

        Raises:
            CodecError: The payload has no text form, or one that is too long.
        """
        return (self._as_text(),) if carrier.is_text else self._buffers

    def _as_text(self) -> bytes:
        if self._text is None:
            if self.size > self._max_text_bytes:
                raise DecodeError(
                    f"a payload of {self.size} bytes is not turned into text, the limit "
                    f"max_text_bytes is {self._max_text_bytes}; use tcp or fast_tcp"
                )
            values = decode(b"".join(self._payload), self._dialect)
            self._text = text_message("D", self._envelope, to_text(values, self._dialect))
        return self._text


class Output(Link):
    """A connection to which a port writes; never blocks, holds at most `depth` messages back.

    Attributes:
        is_reverse: The reader has dialled us.
    """

    def __init__(
        self,
        connection: Channel,
        peer: str,
        carrier: Carrier,
        modifiers: Sequence[str],
        *,
        delivery: Delivery,
        depth: int,
        is_reverse: bool,
    ) -> None:
        super().__init__(connection, peer, "+".join((carrier.name, *modifiers)))
        self.is_reverse = is_reverse
        self._carrier = carrier
        self._delivery = delivery
        self._waiting: deque[Outgoing] = deque()
        self._depth = 1 if delivery == "latest" else depth
        self._awaits_ack = False
        connection.on_event = self._on_event
        connection.on_writable = self._flush
        connection.replies = False

    def offer(self, message: Outgoing) -> None:
        """Send now, or keep for later, or drop, as `delivery` says.

        Raises:
            BusyError: The queue is full.
        """
        if not self._waiting and not self._awaits_ack and self._connection.writable:
            self._send(message)
            return
        if len(self._waiting) == self._depth:
            if self._delivery == "queue":
                self.counters.refused += 1
                raise BusyError(f"the YARP connection to {self.peer}", self._depth)
            self._waiting.popleft()
            self.counters.dropped += 1
        self._waiting.append(message)

    async def close(self) -> None:
        """Tell the reader, then end the connection; what waits is not sent any more."""
        self.leave("closed by us")
        await self.wait_closed()

    def leave(self, reason: str) -> None:
        """Begin to end the connection."""
        self._waiting.clear()
        if farewell := quit_message(self._carrier):
            self._connection.write(farewell)
        self._connection.close(reason)

    def _send(self, message: Outgoing) -> None:
        try:
            buffers = message.buffers(self._carrier)
        except CodecError as error:
            self._lose(error)
            return
        self._awaits_ack = self._carrier.acks
        self._connection.write(*buffers)
        self.counters.messages += 1
        self.counters.bytes += message.size

    def _flush(self) -> None:
        while self._waiting and not self._awaits_ack and self._connection.writable:
            self._send(self._waiting.popleft())

    def _on_event(self, event: Event) -> None:
        if self._awaits_ack and _is_ack(event):
            self._awaits_ack = False
            self._flush()
        elif not (isinstance(event, Message) and event.command == ""):
            raise DecodeError(f"{self.peer} reads over {self.carrier}, but sent {event!r:.80}")


def _is_ack(event: Event) -> bool:
    if isinstance(event, Number):
        return event.value == 0
    return isinstance(event, Message) and event.command == TEXT_ACK_LINE
