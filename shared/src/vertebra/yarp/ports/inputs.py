"""The connections that are made to a port, and the manners that its peers expect."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Final

from vertebra.errors import CodecError, DecodeError, EncodeError, VertebraError
from vertebra.yarp.ports.admin import administer, fail, obey
from vertebra.yarp.ports.datagrams import (
    DatagramReader,
    group_receiving_socket,
    receiving_socket,
)
from vertebra.yarp.ports.dialling import why_silent
from vertebra.yarp.ports.incoming import (
    Incoming,
    OnCall,
    ReadingLink,
    Reply,
    acknowledgement,
    reply_bytes,
)
from vertebra.yarp.ports.link import Connection
from vertebra.yarp.ports.web import answer
from vertebra.yarp.protocol.bottle import encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.hints import dialect_of
from vertebra.yarp.protocol.mjpeg import NO_CODEC, STREAM_HEAD
from vertebra.yarp.protocol.receiver import Event, Greeting, Lost, Message, Receiver, Request
from vertebra.yarp.protocol.wire import (
    HTTP,
    MCAST,
    MJPEG,
    NAME_SER,
    UDP,
    Carrier,
    text_line,
    welcome,
)

if TYPE_CHECKING:
    from vertebra.yarp.ports.switchboard import Switchboard

log = logging.getLogger(__name__)


class Input(ReadingLink):
    """A connection that was made to a port, from before its greeting on.

    Attributes:
        tcp: How it was made; an output takes it over when the peer asks to read.
    """

    def __init__(self, board: Switchboard) -> None:
        self._board = board
        self._greeted: Greeting | None = None
        self._silence = self._later(board.limits.greeting_timeout_s, self._end_silence)
        self.tcp = Connection(Receiver(board.limits), self._on_event, self._on_lost)
        self.tcp.replies = True
        super().__init__(self.tcp, "", "", board.dialect)
        self._asking: asyncio.Task[None] | None = None

    @property
    def is_silent(self) -> bool:
        """Whether the peer has not chosen a carrier yet."""
        return self._greeted is None

    @property
    def dialect(self) -> Dialect | None:
        """What the peer speaks, as far as its messages have shown it."""
        return self._peer_dialect.known

    def _later(self, delay_s: float, then: Callable[[], None]) -> asyncio.TimerHandle:
        return asyncio.get_running_loop().call_later(delay_s, then)

    def _end_silence(self) -> None:
        self._connection.refuse(f"no greeting within {self._board.limits.greeting_timeout_s:g} s")

    def _on_lost(self) -> None:
        self._silence.cancel()
        self._board.forget(self)
        log.debug("%s no longer reads from %s: %s", self._board.name, self.peer or "a silent peer",
                  self._connection.reason)  # fmt: skip

    def _on_event(self, event: Event) -> None:
        if self._greeted is None:
            assert isinstance(event, Greeting)  # noqa: S101 -- a receiver begins with it
            self._welcome(event)
        elif isinstance(event, Message):
            self._on_message(event, self._greeted.carrier)
        elif isinstance(event, Request):
            self._in_order(partial(self._respond, event), HTTP)
        elif isinstance(event, Lost):
            self._miss(event.reason, event.count)
        else:
            raise DecodeError(f"{self.peer} sent {event} where a message should be")

    def _welcome(self, greeted: Greeting) -> None:
        self._silence.cancel()
        self.peer = greeted.sender
        self.carrier = "+".join((greeted.carrier.name, *greeted.modifiers))
        for modifier in greeted.modifiers:
            if modifier.partition(".")[0] in ("recv", "send"):
                raise DecodeError(f"{self.peer} needs the plug-in {modifier!r}, which is not here")
        self._greeted = greeted
        self._board.replace(self)
        _WELCOMES.get(greeted.carrier, Input._greet_back)(self, greeted)
        # Now, because a caller that waits for its reply may not answer questions any more.
        if self.dialect is None and self._board.on_call is not None and self.peer.startswith("/"):
            self._asking = self._board.spawn(self._ask_dialect())

    def _greet_back(self, greeted: Greeting) -> None:
        tcp_port = self._board.contact.tcp_port
        self.tcp.write(welcome(greeted.carrier, greeted.sender, tcp_port))

    def _go_on_by_udp(self, greeted: Greeting) -> None:
        with _as_decode_error("listen for datagrams"):
            sock = receiving_socket(self.tcp.local_host)
        self.tcp.write(welcome(greeted.carrier, greeted.sender, sock.getsockname()[1]))
        self._go_on_by(sock)

    def _go_on_by_mcast(self, greeted: Greeting) -> None:
        with _as_decode_error(f"join the multicast group {greeted.group}"):
            sock = group_receiving_socket(greeted.group, self.tcp.local_host)
        self._go_on_by(sock)

    def _show(self, _: Greeting) -> None:
        """Wait for the request, which follows at once."""

    def _stream(self, greeted: Greeting) -> None:
        if self._board.jpeg is None:
            self.tcp.write(NO_CODEC)
            self.tcp.refuse("it wants JPEGs, and this port has no codec for them")
            return
        self.tcp.write(STREAM_HEAD)
        self._board.turn_round(self, greeted.carrier, greeted.modifiers)

    def _go_on_by(self, sock: socket.socket) -> None:
        self.tcp.on_lost = None
        self.tcp.close("goes on by datagrams")
        self._connection = DatagramReader(
            sock, self.tcp.peer_host, self._board.limits, self._on_event, self._on_lost
        )
        self._listen_for_silence()

    def _listen_for_silence(self) -> None:
        heard = self.counters.messages + self.counters.refused + self.counters.lost
        after_s = self._board.limits.datagram_silence_s
        self._silence = self._later(after_s, partial(self._on_silence, heard))

    def _on_silence(self, heard: int) -> None:
        if heard == self.counters.messages + self.counters.refused + self.counters.lost:
            self._board.spawn(self._ask_writer())
        else:
            self._listen_for_silence()

    async def _ask_writer(self) -> None:
        """End the connection if the writer is gone, of which datagrams do not tell."""
        board = self._board
        trouble = await why_silent(board.names, self.peer, board.name, board.limits)
        if trouble:
            self._connection.close(f"lost: {trouble}")
        elif not self._connection.closing:
            self._listen_for_silence()

    def _on_message(self, message: Message, carrier: Carrier) -> None:
        letter = message.command[:1]
        if letter == "D" or (letter == "d" and carrier.is_connectionless):
            self._on_object(message, carrier, reply_wanted=False)
        elif letter == "d":
            self._on_object(message, carrier, reply_wanted=True)
        elif letter == "q":
            self._acknowledge(carrier)
            self._connection.close("closed by the peer")
        elif carrier.is_connectionless:
            self._lose(f"{message.command!r:.20} cannot be answered over {carrier.name}")
        elif letter == "a":
            self._in_order(partial(self._administer, message), carrier)
        elif letter == "r" and carrier is not NAME_SER:
            self._acknowledge(carrier)
            modifiers = self._greeted.modifiers if self._greeted else []
            self._board.turn_round(self, carrier, modifiers)
        elif carrier.is_text:
            self._in_order(partial(self._obey, message.command), carrier)
        else:  # what YARP does with letters that it does not know
            self._acknowledge(carrier)

    def _on_object(self, message: Message, carrier: Carrier, *, reply_wanted: bool) -> None:
        on_data, on_call = self._board.on_data, self._board.on_call
        try:
            incoming = self._incoming(message, reply_wanted=reply_wanted)
        except CodecError as error:
            self._lose(error)
        else:
            if on_call is not None and (reply_wanted or on_data is None):
                self._in_order(partial(self._answer, incoming, on_call), carrier)
                return
            if on_data is not None:
                self._deliver(incoming, on_data)
            else:
                self._lose(f"{self._board.name} only sends")
        self._acknowledge(carrier)

    def _acknowledge(self, carrier: Carrier) -> None:
        if carrier.acks:
            self._connection.postpone(acknowledgement(carrier))

    def _in_order(self, reply: Callable[[], Awaitable[Reply]], carrier: Carrier) -> None:
        """Send a reply when it is there; the next message waits until then."""
        self._connection.hold()
        self._board.spawn(self._send(reply, carrier))

    async def _send(self, answer: Callable[[], Awaitable[Reply]], carrier: Carrier) -> None:
        try:
            reply = await answer()
            try:
                raw = reply_bytes(reply, carrier, await self._dialect_for(reply))
            except EncodeError as error:
                self._lose(error)
                raw = reply_bytes(fail(str(error)), carrier, Dialect.V3)
            self._connection.write(raw + acknowledgement(carrier))
        finally:
            self._connection.release()

    async def _ask_dialect(self) -> None:
        found = await self._board.names.dialects.of_sender(self.peer)
        self._peer_dialect.known = self._peer_dialect.known or found

    async def _dialect_for(self, reply: Reply) -> Dialect:
        """Return how to write a reply; waits only where the peer's dialect makes a difference."""
        asking = self._asking if self.dialect is None else None
        if asking is not None and not isinstance(reply, bytes | None):
            differs = dialect_of(encode(reply, Dialect.V4)) is not None
            if differs:
                await asyncio.wait([asking])
        return self.dialect or Dialect.V3

    async def _answer(self, incoming: Incoming, on_call: OnCall) -> Reply:
        timeout_s = self._board.limits.reply_timeout_s
        try:
            async with asyncio.timeout(timeout_s):
                reply = await on_call(incoming)
        except VertebraError as error:
            self._lose(error)
            reply = fail(str(error))
        except TimeoutError:
            self._lose(f"no reply within {timeout_s:g} s")
            reply = fail(f"no reply within {timeout_s:g} s")
        except Exception:
            self.counters.refused += 1
            log.exception("on_call of %s failed", self._board.name)
            reply = fail(f"{self._board.name} failed; its log says why")
        else:
            self.counters.messages += 1
            self.counters.bytes += len(incoming.payload)
        return reply if incoming.reply_wanted else None

    async def _respond(self, request: Request) -> Reply:
        response = await answer(self._board, request, self._ask_owner)
        self._connection.write(response)
        self._connection.close("answered")
        return None

    async def _ask_owner(self, text: str) -> Reply:
        on_data, on_call = self._board.on_data, self._board.on_call
        incoming = self._incoming(Message("d", text), reply_wanted=True)
        if on_call is not None:
            return await self._answer(incoming, on_call)
        if on_data is not None:
            self._deliver(incoming, on_data)
        else:
            self._lose(f"{self._board.name} only sends")
        return None

    async def _administer(self, message: Message) -> Reply:
        size, limit = len(message.payload), self._board.limits.max_text_bytes
        if size > limit:  # some of it may be kept, as a property
            return fail(f"an administrative message of {size} bytes; max_text_bytes is {limit}")
        try:
            request = self._incoming(message, reply_wanted=True).bottle()
        except CodecError as error:
            return fail(str(error))
        return await administer(self._board, request)

    async def _obey(self, command: str) -> Reply:
        return b"".join(map(text_line, await obey(self._board, command)))


@contextlib.contextmanager
def _as_decode_error(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DecodeError(f"cannot {what}: {error}") from error


_WELCOMES: Final[dict[Carrier, Callable[[Input, Greeting], None]]] = {
    UDP: Input._go_on_by_udp,  # noqa: SLF001 -- methods of this module
    MCAST: Input._go_on_by_mcast,  # noqa: SLF001
    MJPEG: Input._stream,  # noqa: SLF001
    HTTP: Input._show,  # noqa: SLF001
}
"""How a peer is welcomed; those of other carriers get the answer to a greeting."""
