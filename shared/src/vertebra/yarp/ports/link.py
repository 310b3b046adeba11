"""One TCP connection between two YARP ports, and what was carried over it."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Literal

from vertebra.errors import DeadlineError, DecodeError, NotConnectedError
from vertebra.yarp.naming.names import Contact, NameClient
from vertebra.yarp.protocol.receiver import Event, Message, Receiver
from vertebra.yarp.protocol.wire import (
    SMALL_BYTES,
    Buffer,
    Carrier,
    PeerLimits,
    UnknownCarrierError,
    greeting,
)

log = logging.getLogger(__name__)

Delivery = Literal["latest", "queue"]

CLOSE_GRACE_S = 1.0


@dataclass(slots=True)
class Counters:
    """What passed one way since the start.

    Attributes:
        messages: Delivered to the callback, or handed to the kernel.
        bytes: Their payload bytes.
        dropped: Replaced by a newer message before they could be sent (`delivery="latest"`).
        refused: Not sent because the queue was full, or not readable here.
        lost: Messages by udp or mcast that came in part, and datagrams that our kernel dropped.
    """

    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    refused: int = 0
    lost: int = 0

    def __add__(self, other: Counters) -> Counters:
        return Counters(
            self.messages + other.messages,
            self.bytes + other.bytes,
            self.dropped + other.dropped,
            self.refused + other.refused,
            self.lost + other.lost,
        )


def is_power_of_two(count: int) -> bool:
    """Say whether to log the `count`-th fault of a stream: a thousand faults make ten lines."""
    return count & (count - 1) == 0


class Channel:
    """What carries messages to or from one peer; events for `on_event`, one after the other.

    Attributes:
        on_writable: Called when a channel that was not `writable` has become so.
        local_host: Address of our side.
        peer_host: Address of the other side; `peer` is with its TCP port.
        reason: Why the channel ended, empty while it lives.
        writable: All that was written so far is with the kernel.
        replies: What we write are replies and acks; while a peer does not take them, nothing
            more is taken from it.
        lost: Done when the channel has ended.
    """

    def __init__(
        self, on_event: Callable[[Event], None], on_lost: Callable[[], None] | None
    ) -> None:
        self.on_event = on_event
        self.on_lost = on_lost
        self.on_writable: Callable[[], None] | None = None
        self.local_host = self.peer_host = self.peer = "?"
        self.reason = ""
        self.writable = True
        self.replies = False
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def hold(self) -> None:
        """Deliver no more events until `release`."""
        raise NotImplementedError

    def release(self) -> None:
        """Deliver events again."""
        raise NotImplementedError

    def write(self, *buffers: Buffer) -> None:
        """Send one message; nothing happens on a channel that ends."""
        raise NotImplementedError

    def postpone(self, *buffers: Buffer) -> None:
        """Send one message, together with others if it is small; `flush` sends the last of them."""
        self.write(*buffers)

    def flush(self) -> None:
        """Send what was postponed; what was taken in events is followed by a `flush`."""

    def close(self, reason: str) -> None:
        """End the channel, sending first what was written."""
        raise NotImplementedError

    def refuse(self, reason: str) -> None:
        """End the channel because of what the peer did."""
        log.warning("closed the YARP connection from %s: %s", self.peer, reason)
        self.close(reason)

    @property
    def closing(self) -> bool:
        """Whether the channel has ended or is about to."""
        return bool(self.reason)

    def _end(self) -> None:
        self.lost.set_result(None)
        if self.on_lost is not None:
            self.on_lost()


class Connection(Channel, asyncio.BufferedProtocol):
    """A TCP connection as a channel."""

    def __init__(
        self,
        receiver: Receiver,
        on_event: Callable[[Event], None],
        on_lost: Callable[[], None] | None,
    ) -> None:
        super().__init__(on_event, on_lost)
        self.receiver = receiver
        self._held = False
        self._paused = False
        self._postponed = bytearray()
        self._ended = False  # the peer sends no more, but may still read
        self._grace: asyncio.TimerHandle | None = None
        self._transport: asyncio.Transport | None = None
        self.local_tcp_port = 0

    # What asyncio calls:

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 -- what loop.create_server gives
        self._transport = transport
        if self.reason:
            transport.abort()
            return
        transport.set_write_buffer_limits(high=0)  # tells at once that the peer does not keep up
        host, tcp_port = transport.get_extra_info("peername")[:2]
        self.peer_host, self.peer = host, f"{host}:{tcp_port}"
        self.local_host, self.local_tcp_port = transport.get_extra_info("sockname")[:2]
        _keep_alive(transport.get_extra_info("socket"))

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 -- asyncio's signature
        """Return where to receive into."""
        return self.receiver.get_buffer()

    def buffer_updated(self, nbytes: int) -> None:
        """Take what was received."""
        self.receiver.buffer_updated(nbytes)
        self._pump()

    def pause_writing(self) -> None:
        """Note that the kernel is full."""
        self.writable = False

    def resume_writing(self) -> None:
        """Note that the kernel has taken everything."""
        self.writable = True
        if self.on_writable is not None:
            self.on_writable()
        if self.replies and not self._held:
            self._resume()

    def eof_received(self) -> bool:
        """Close, unless a reply is under way to a peer that has only stopped sending."""
        self._ended = True
        return self._held

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        if self._grace is not None:
            self._grace.cancel()
        self.reason = self.reason or (f"lost: {exc}" if exc else "closed by the peer")
        self._end()

    # What the owner calls:

    def hold(self) -> None:
        """Deliver no more events until `release`."""
        self._held = True

    def release(self) -> None:
        """Deliver events again."""
        self._held = False
        self._resume()

    def write(self, *buffers: Buffer) -> None:
        """Send; nothing happens on a connection that ends."""
        if self._transport is None or self.closing:
            return
        self.flush()
        for buffer in buffers:
            self._transport.write(buffer)

    def postpone(self, *buffers: Buffer) -> None:
        """Send one message, together with others if it is small."""
        if sum(map(len, buffers)) > SMALL_BYTES:
            self.write(*buffers)
            return
        for buffer in buffers:
            self._postponed += buffer

    def flush(self) -> None:
        """Send what was postponed."""
        if self._postponed and self._transport is not None and not self.closing:
            self._transport.write(bytes(self._postponed))
            self._postponed.clear()

    def close(self, reason: str) -> None:
        """End the connection, sending first what was written."""
        if self.closing:
            return
        self.flush()
        self.reason = reason
        if self._transport is not None:  # else it is being made, and ends as soon as it is
            self._transport.close()
            loop = asyncio.get_running_loop()
            self._grace = loop.call_later(CLOSE_GRACE_S, self._transport.abort)

    @property
    def closing(self) -> bool:
        """Whether the connection has ended or is about to."""
        return bool(self.reason) or (self._transport is not None and self._transport.is_closing())

    def _resume(self) -> None:
        if self._transport is None or self.closing:
            return
        if self._paused:
            self._paused = False
            self._transport.resume_reading()
        self._pump()
        if self._ended and not self._held:
            self.close("closed by the peer")

    def _pump(self) -> None:
        try:
            while not (self._held or self.closing or (self.replies and not self.writable)):
                event = self.receiver.next_event()
                if event is None:
                    break
                self.on_event(event)
        except UnknownCarrierError as error:
            self.write(error.answer)
            self.refuse(str(error))
        except DecodeError as error:
            self.refuse(str(error))
        self.flush()
        if self.receiver.full and not self._paused and not self.closing:
            assert self._transport is not None  # noqa: S101 -- it is not closing
            self._paused = True
            self._transport.pause_reading()


def _keep_alive(sock: socket.socket) -> None:
    """Make the kernel notice within half a minute that the other machine is gone."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, option):  # not on every system
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)


async def dial(
    contact: Contact,
    carrier: Carrier,
    sender: str,
    modifiers: Sequence[str],
    limits: PeerLimits,
) -> Connection:
    """Connect to a YARP port and greet it; the connection is held until its owner takes it over.

    Raises:
        NotConnectedError: Nobody listens there, or it is no YARP port.
        DeadlineError: It does not answer.
    """
    hello = greeting(carrier, sender, modifiers)
    connection = await reach(contact, carrier, limits)
    await greet(connection, hello, contact, carrier, limits)
    return connection


async def reach(contact: Contact, carrier: Carrier, limits: PeerLimits) -> Connection:
    """Connect to a YARP port without a word; raise as `dial` does."""
    connection = Connection(Receiver(limits, carrier), lambda _: None, None)
    connect = asyncio.get_running_loop().create_connection
    async with _meeting(contact, connection, limits):
        await connect(lambda: connection, contact.host, contact.tcp_port)
    return connection


async def greet(
    connection: Connection, hello: bytes, contact: Contact, carrier: Carrier, limits: PeerLimits
) -> Event | None:
    """Say who we are and return the answer; raise as `dial` does."""
    answered = asyncio.Event()
    answer: Event | None = None

    def on_event(event: Event) -> None:
        nonlocal answer
        if isinstance(event, Message) and not event.command.startswith("Welcome"):
            raise DecodeError(f"a greeting is answered by a welcome, not by {event.command!r:.80}")
        answer = event
        connection.hold()
        answered.set()

    connection.on_event = on_event
    connection.on_lost = answered.set
    async with _meeting(contact, connection, limits):
        if not connection.closing:
            connection.write(hello)
            await answered.wait()
    if connection.closing:
        raise NotConnectedError(
            f"{_where(contact)} does not take {carrier.name}: {connection.reason}"
        )
    return answer


@asynccontextmanager
async def _meeting(
    contact: Contact, connection: Connection, limits: PeerLimits
) -> AsyncIterator[None]:
    """Let a connection be made in time, or not at all."""
    try:
        async with asyncio.timeout(limits.connect_timeout_s):
            yield
    except TimeoutError:
        connection.close("no answer to the greeting")
        raise DeadlineError(_where(contact), limits.connect_timeout_s) from None
    except OSError as error:
        raise NotConnectedError(
            f"cannot reach {_where(contact)}: {error}; is its process alive? "
            "`yarp clean` removes dead names"
        ) from error
    except asyncio.CancelledError:
        connection.close("cancelled")
        raise


def _where(contact: Contact) -> str:
    return f"YARP port {contact.name} at {contact.host}:{contact.tcp_port}"


class PortNotFoundError(NotConnectedError):
    """The name server does not know this YARP port; it may not have started yet."""


async def find(name: str, names: NameClient) -> Contact:
    """Return where `name` listens.

    Raises:
        PortNotFoundError: It is not registered.
    """
    contact = await names.query(name)
    if contact is None:
        raise PortNotFoundError(
            f"YARP port {name} is not registered at the name server {names.host}:{names.tcp_port}; "
            "start its program, or look with `yarp name list`"
        )
    return contact


class Link:
    """A connection as its owner sees it.

    Attributes:
        peer: Port name of the other side (of an input: the name the sender gave).
        carrier: With its modifiers, such as `tcp` or `tcp+foo.bar`.
        counters: What passed over it in its data direction.
    """

    def __init__(self, connection: Channel, peer: str, carrier: str) -> None:
        self.peer = peer
        self.carrier = carrier
        self.counters = Counters()
        self._connection = connection

    @property
    def closed(self) -> bool:
        """Whether the connection has ended or is about to."""
        return self._connection.closing

    @property
    def lost(self) -> asyncio.Future[None]:
        """Done when the connection has ended."""
        return self._connection.lost

    async def wait_closed(self) -> str:
        """Wait for the end of the connection, whoever ends it, and return the reason."""
        await asyncio.shield(self.lost)
        return self._connection.reason

    async def close(self) -> None:
        """End the connection."""
        self._connection.close("closed by us")
        await self.wait_closed()

    def _lose(self, reason: object) -> None:
        self.counters.refused += 1
        self._report_loss(reason)

    def _miss(self, reason: str, count: int) -> None:
        self.counters.lost += count
        self._report_loss(reason)

    def _report_loss(self, reason: object) -> None:
        gone = self.counters.refused + self.counters.lost
        if is_power_of_two(gone):
            log.error(
                "YARP connection with %s over %s lost %d messages so far: %s",
                self.peer,
                self.carrier,
                gone,
                reason,
            )
