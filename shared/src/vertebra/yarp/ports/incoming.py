"""Messages as they arrive: what a callback gets, and the side of a connection that reads."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeAlias

from vertebra.errors import CodecError
from vertebra.yarp.ports.link import Channel, Link, is_power_of_two
from vertebra.yarp.protocol.bottle import Value, decode, encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.hints import dialect_of
from vertebra.yarp.protocol.receiver import Message
from vertebra.yarp.protocol.text import from_text, to_text
from vertebra.yarp.protocol.wire import ACK, TEXT_ACK_LINE, Buffer, Carrier, text_line

log = logging.getLogger(__name__)


class PeerDialect:
    """What is known of the dialect of one peer.

    Attributes:
        known: None as long as nothing has shown it.
    """

    __slots__ = ("known",)

    def __init__(self, known: Dialect | None) -> None:
        self.known = known

    def of(self, payload: Buffer) -> Dialect:
        """Return how to read a payload of this peer; what it shows is remembered."""
        if self.known is None:
            self.known = dialect_of(payload)
        return self.known or Dialect.V3


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
        "_peer_dialect",
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
        peer_dialect: PeerDialect,
    ) -> None:
        self.payload = payload
        self.envelope = envelope
        self.sender = sender
        self.sender_host = sender_host
        self.carrier = carrier
        self.reply_wanted = reply_wanted
        self._peer_dialect = peer_dialect

    @property
    def dialect(self) -> Dialect:
        """How the payload is written."""
        return self._peer_dialect.of(self.payload)

    def bottle(self) -> list[Value]:
        """Decode the payload as a bottle.

        Raises:
            DecodeError: It is not one.
        """
        return decode(self.payload, self.dialect)


Reply: TypeAlias = Sequence[Value] | bytes | None
"""A bottle; or bytes that are sent as they are on every carrier; None acknowledges only."""

OnData: TypeAlias = Callable[[Incoming], None]
"""Called in the event loop for each message: hand over and return at once."""

OnCall: TypeAlias = Callable[[Incoming], Awaitable[Reply]]
"""Answers a message; one call per connection at a time, cancelled after `reply_timeout_s`."""


class ReadingLink(Link):
    """A connection from which we read, and the manners that this takes."""

    def __init__(
        self, connection: Channel, peer: str, carrier: str, dialect: Dialect | None
    ) -> None:
        super().__init__(connection, peer, carrier)
        self._peer_dialect = PeerDialect(dialect)

    def drop(self, reason: str) -> None:
        """Begin to end the connection."""
        self._connection.close(reason)

    def _incoming(self, message: Message, *, reply_wanted: bool) -> Incoming:
        payload, peer_dialect = message.payload, self._peer_dialect
        if isinstance(payload, str):
            dialect = peer_dialect.known or Dialect.V3
            payload = memoryview(encode(from_text(payload, dialect), dialect))
            peer_dialect = PeerDialect(dialect)  # of these bytes, which are ours
        if reply_wanted:
            peer_dialect.of(payload)  # our reply is to be in it
        return Incoming(
            payload,
            envelope=message.envelope,
            sender=self.peer,
            sender_host=self._connection.peer_host,
            carrier=self.carrier,
            reply_wanted=reply_wanted,
            peer_dialect=peer_dialect,
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
