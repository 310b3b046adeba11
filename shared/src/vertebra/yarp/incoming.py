"""Messages as they arrive: what a callback gets, and the side of a connection that reads."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeAlias

from vertebra.errors import CodecError
from vertebra.yarp.bottle import Value, decode, encode
from vertebra.yarp.dialect import Dialect
from vertebra.yarp.link import Channel, Link, is_power_of_two
from vertebra.yarp.receiver import Message
from vertebra.yarp.text import from_text, to_text
from vertebra.yarp.wire import ACK, TEXT_ACK_LINE, Carrier, text_line

log = logging.getLogger(__name__)


class Incoming:
    """One message as it reached a port; its payload belongs to whoever gets this object.

    Attributes:
        payload: The serialised object, read-only. Text carriers deliver the binary bottle too.
        envelope: The text beside the payload, often a Stamp (`41 1234.5`); empty when absent.
        sender: Name that the sender gave; rooted (`/x`) for real ports.
        sender_host: Address from which it came.
        carrier: Such as `tcp`.
        reply_wanted: The sender waits for a reply.
    """

    __slots__ = (
        "_dialect",
        "carrier",
        "envelope",
        "payload",
        "reply_wanted",
        "sender",
        "sender_host",
    )

    def __init__(
        self,
        payload: memoryview,
        *,
        envelope: str,
        sender: str,
        sender_host: str,
        carrier: str,
        reply_wanted: bool,
        dialect: Dialect,
    ) -> None:
        self.payload = payload
        self.envelope = envelope
        self.sender = sender
        self.sender_host = sender_host
        self.carrier = carrier
        self.reply_wanted = reply_wanted
        self._dialect = dialect

    def bottle(self) -> list[Value]:
        """Decode the payload as a bottle in the dialect of the port.

        Raises:
            DecodeError: It is not one.
        """
        return decode(self.payload, self._dialect)


Reply: TypeAlias = Sequence[Value] | bytes | None
"""A bottle; or bytes that are sent as they are on every carrier; None acknowledges only."""

OnData: TypeAlias = Callable[[Incoming], None]
"""Called in the event loop for each message: hand over and return at once."""

OnCall: TypeAlias = Callable[[Incoming], Awaitable[Reply]]
"""Answers a message; one call per connection at a time, cancelled after `reply_timeout_s`."""


class ReadingLink(Link):
    """A connection from which we read, and the manners that this takes."""

    def __init__(self, connection: Channel, peer: str, carrier: str, dialect: Dialect) -> None:
        super().__init__(connection, peer, carrier)
        self._dialect = dialect

    def _incoming(self, message: Message, *, reply_wanted: bool) -> Incoming:
        payload = message.payload
        if isinstance(payload, str):
            values = from_text(payload, self._dialect)
            payload = memoryview(encode(values, self._dialect))
        return Incoming(
            payload,
            envelope=message.envelope,
            sender=self.peer,
            sender_host=self._connection.peer_host,
            carrier=self.carrier,
            reply_wanted=reply_wanted,
            dialect=self._dialect,
        )

    def _deliver(self, incoming: Incoming, on_data: OnData) -> None:
        """Hand over a message; what is wrong with one message leaves the stream alone."""
        try:
            on_data(incoming)
        except CodecError as error:
            self._lose(error)
        except Exception:
            self.counters.refused += 1
            if is_power_of_two(self.counters.refused):
                log.exception(
                    "the reader of the YARP connection from %s failed; it lost %d messages so far",
                    self.peer,
                    self.counters.refused,
                )
        else:
            self.counters.messages += 1
            self.counters.bytes += len(incoming.payload)


def acknowledgement(carrier: Carrier) -> bytes:
    """Return what tells the sender that its message was taken."""
    if not carrier.acks:
        return b""
    return text_line(TEXT_ACK_LINE) if carrier.is_text else ACK


def reply_bytes(reply: Reply, carrier: Carrier, dialect: Dialect) -> bytes:
    """Return a reply as `carrier` sends it.

    Raises:
        EncodeError: A value has no form in a bottle.
    """
    if reply is None:
        return b""
    if isinstance(reply, bytes):
        return reply
    if carrier.is_text:
        return text_line(to_text(reply, dialect))
    return encode(reply, dialect)
