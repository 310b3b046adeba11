"""The connections of one YARP port: who sends to it, who reads from it, what each may do."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from functools import partial
from typing import Any

from vertebra.errors import BusyError, CodecError, DecodeError, EncodeError, VertebraError
from vertebra.yarp.admin import administer, fail, obey
from vertebra.yarp.bottle import Value
from vertebra.yarp.dialect import Dialect
from vertebra.yarp.incoming import (
    Incoming,
    OnCall,
    OnData,
    ReadingLink,
    Reply,
    acknowledgement,
    reply_bytes,
)
from vertebra.yarp.link import (
    CLOSE_GRACE_S,
    Connection,
    Counters,
    Delivery,
    Outgoing,
    Output,
    dial,
    find,
    is_power_of_two,
)
from vertebra.yarp.names import Contact, NameClient
from vertebra.yarp.wire import (
    NAME_SER,
    Buffer,
    Carrier,
    Event,
    Greeting,
    Message,
    PeerLimits,
    Receiver,
    parse_carrier,
    text_line,
    welcome,
)

log = logging.getLogger(__name__)


class Switchboard:
    """All connections of one port.

    Attributes:
        contact: Where the port listens, under which name.
        properties: Set and read by tools.
    """

    def __init__(
        self,
        contact: Contact,
        names: NameClient,
        *,
        on_data: OnData | None,
        on_call: OnCall | None,
        delivery: Delivery,
        depth: int,
        dialect: Dialect,
        limits: PeerLimits,
    ) -> None:
        self.contact = contact
        self.names = names
        self.properties: dict[str, Value] = {}
        self.on_data = on_data
        self.on_call = on_call
        self.dialect = dialect
        self.limits = limits
        self._delivery: Delivery = delivery
        self._depth = depth
        self._inputs: dict[Input, None] = {}  # oldest first
        self._outputs: list[Output] = []
        self._past_received = Counters()
        self._past_sent = Counters()
        self._turned_away = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._closing = False

    @property
    def name(self) -> str:
        """Name of the port."""
        return self.contact.name

    @property
    def inputs(self) -> list[Input]:
        """Connections that have greeted and do not read."""
        return [link for link in self._inputs if not link.is_silent and not link.closed]

    @property
    def outputs(self) -> list[Output]:
        """Connections to which the port writes."""
        return [link for link in self._outputs if not link.closed]

    @property
    def received(self) -> Counters:
        """Totals over all inputs, closed ones included."""
        return sum((link.counters for link in self._inputs), self._past_received)

    @property
    def sent(self) -> Counters:
        """Totals over all outputs, closed ones included."""
        return sum((link.counters for link in self._outputs), self._past_sent)

    def write(self, payload: Sequence[Buffer], envelope: str) -> None:
        """Offer a message to all outputs.

        Raises:
            BusyError: One of them refused it.
            EncodeError: The envelope holds control characters.
        """
        message = Outgoing(payload, envelope, self.dialect, self.limits.max_text_bytes)
        refused: BusyError | None = None
        for output in self.outputs:
            try:
                output.offer(message)
            except BusyError as error:
                refused = error
        if refused is not None:
            raise refused

    async def connect(self, dest: str, carrier: str) -> Output:
        """Dial `dest` and write to it from now on, instead of over an earlier connection."""
        spoken, modifiers = parse_carrier(carrier)
        contact = await find(dest, self.names)
        connection = await dial(contact, spoken, self.name, modifiers, self.limits)
        self.drop_output(dest)
        output = self._add_output(connection, dest, spoken, modifiers, is_reverse=False)
        connection.release()
        if self._closing:  # it was not there to be closed with the others
            output.leave("closed by us")
        return output

    def drop_output(self, peer: str) -> Output | None:
        """Begin to close the output to `peer` and return it, or None if there is none."""
        for output in self.outputs:
            if output.peer == peer:
                output.leave("closed by us")
                return output
        return None

    def drop_input(self, peer: str) -> bool:
        """Begin to close all inputs from `peer`; say whether there were any."""
        found = [link for link in self.inputs if link.peer == peer]
        for link in found:
            link.drop("closed by us")
        return bool(found)

    # --- called by the listener and the inputs ---

    def accept(self) -> Connection:
        """Return the protocol of a connection that is being made to us."""
        new = Input(self)
        self._inputs[new] = None
        taken = [link for link in (*self._inputs, *self._outputs) if not link.closed]
        if len(taken) > self.limits.max_connections:
            longest_silent = next(
                link for link in self._inputs if link.is_silent and not link.closed
            )  # which may be the new one
            self._turn_away(longest_silent)
        return new.connection

    def replace(self, new: Input) -> None:
        """Close older connections under the same rooted name, as YARP does."""
        if not new.peer.startswith("/"):
            return
        reason = f"{new.peer} has connected again"
        for link in self._inputs:
            if link is not new and link.peer == new.peer:
                link.drop(reason)
        for output in self._outputs:
            if output.is_reverse and output.peer == new.peer:
                output.leave(reason)

    def forget(self, link: Input) -> None:
        """Let go of an input that has ended."""
        del self._inputs[link]
        self._past_received += link.counters

    def turn_round(self, link: Input, carrier: Carrier, modifiers: Sequence[str]) -> None:
        """Write from now on to a peer that has dialled us."""
        self.forget(link)
        self._add_output(link.connection, link.peer, carrier, modifiers, is_reverse=True)

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        """Run `work` until the port closes."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Cancel what runs, take leave from every peer and wait until all are gone."""
        self._closing = True
        tasks = [*self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for output in self._outputs:
            output.leave("closed by us")
        for link in self._inputs:
            link.drop("closed by us")
        leaving = [link.lost for link in (*self._outputs, *self._inputs)]
        if leaving:
            await asyncio.wait(leaving, timeout=2 * CLOSE_GRACE_S)

    def _turn_away(self, link: Input) -> None:
        reason = f"max_connections is {self.limits.max_connections}"
        self._turned_away += 1
        if is_power_of_two(self._turned_away):
            log.warning(
                "%s turned away %d connections so far: %s", self.name, self._turned_away, reason
            )
        link.drop(reason)

    def _add_output(
        self,
        connection: Connection,
        peer: str,
        carrier: Carrier,
        modifiers: Sequence[str],
        *,
        is_reverse: bool,
    ) -> Output:
        output = Output(
            connection,
            peer,
            carrier,
            modifiers,
            delivery=self._delivery,
            depth=self._depth,
            is_reverse=is_reverse,
        )

        def on_lost() -> None:
            self._outputs.remove(output)
            self._past_sent += output.counters
            log.info("%s no longer writes to %s: %s", self.name, peer, connection.reason)

        connection.on_lost = on_lost
        self._outputs.append(output)
        log.info("%s writes to %s over %s", self.name, peer, output.carrier)
        return output


class Input(ReadingLink):
    """A connection that was made to a port, from before its greeting on."""

    def __init__(self, board: Switchboard) -> None:
        self._board = board
        self._greeted: Greeting | None = None
        loop = asyncio.get_running_loop()
        self._silence = loop.call_later(board.limits.greeting_timeout_s, self._end_silence)
        connection = Connection(Receiver(board.limits), self._on_event, self._on_lost)
        connection.replies = True
        super().__init__(connection, "", "", board.dialect)

    @property
    def connection(self) -> Connection:
        """The socket, which an output takes over when the peer asks to read."""
        return self._connection

    @property
    def is_silent(self) -> bool:
        """Whether the peer has not chosen a carrier yet."""
        return self._greeted is None

    def drop(self, reason: str) -> None:
        """Begin to end the connection."""
        self._connection.close(reason)

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
        tcp_port = self._board.contact.tcp_port
        self._connection.write(welcome(greeted.carrier, greeted.sender, tcp_port))

    def _on_message(self, message: Message, carrier: Carrier) -> None:
        letter = message.command[:1]
        if letter == "D":
            self._on_object(message, carrier, reply_wanted=False)
        elif letter == "d":
            self._on_object(message, carrier, reply_wanted=True)
        elif letter == "a":
            self._in_order(partial(self._administer, message), carrier)
        elif letter == "q":
            self._acknowledge(carrier)
            self._connection.close("closed by the peer")
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
            self._connection.write(acknowledgement(carrier))

    def _in_order(self, reply: Callable[[], Awaitable[Reply]], carrier: Carrier) -> None:
        """Send a reply when it is there; the next message waits until then."""
        self._connection.hold()
        self._board.spawn(self._send(reply, carrier))

    async def _send(self, answer: Callable[[], Awaitable[Reply]], carrier: Carrier) -> None:
        try:
            reply = await answer()
            try:
                raw = reply_bytes(reply, carrier, self._dialect)
            except EncodeError as error:
                self._lose(error)
                raw = reply_bytes(fail(str(error)), carrier, self._dialect)
            self._connection.write(raw + acknowledgement(carrier))
        finally:
            self._connection.release()

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

    async def _administer(self, message: Message) -> Reply:
        try:
            request = self._incoming(message, reply_wanted=True).bottle()
        except CodecError as error:
            return fail(str(error))
        return await administer(self._board, request)

    async def _obey(self, command: str) -> Reply:
        return b"".join(map(text_line, await obey(self._board, command)))
