"""The connections of one YARP port: who sends to it, who reads from it, what each may do."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine, Sequence
from typing import Any

from vertebra.errors import BusyError, CommandRefusedError, DeadlineError, VertebraError
from vertebra.yarp.naming.names import Contact, NameClient
from vertebra.yarp.ports.dialling import Dialler, ask_to_stop
from vertebra.yarp.ports.incoming import OnCall, OnData, ReadingLink
from vertebra.yarp.ports.inputs import Input
from vertebra.yarp.ports.link import (
    CLOSE_GRACE_S,
    Channel,
    Connection,
    Counters,
    Delivery,
    Link,
    dial,
    find,
    is_power_of_two,
)
from vertebra.yarp.ports.outputs import Outgoing, Output, Payload
from vertebra.yarp.ports.reading import Subscription
from vertebra.yarp.ports.viewers import Viewer
from vertebra.yarp.protocol.bottle import Value
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec, installed_jpeg
from vertebra.yarp.protocol.wire import MJPEG, Carrier, PeerLimits, parse_carrier

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
        dialect: Dialect | None,
        limits: PeerLimits,
        sends: bool = True,
        jpeg: JpegCodec | None = None,
    ) -> None:
        self.contact = contact
        self.names = names
        self.properties: dict[str, Value] = {}
        self.on_data = on_data
        self.on_call = on_call
        self.dialect = dialect
        self.sends = sends
        self._jpeg = jpeg
        self.limits = limits
        self._delivery: Delivery = delivery
        self._depth = depth
        self._dialler = Dialler(names, limits)
        self._inputs: dict[Input, None] = {}  # oldest first
        self._pulled: list[Subscription] = []
        self._arrival = asyncio.Event()
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
    def jpeg(self) -> JpegCodec | None:
        """What turns images into JPEGs and back."""
        return self._jpeg or installed_jpeg()

    @property
    def inputs(self) -> list[ReadingLink]:
        """Connections that have greeted and do not read, and those that we have made to read."""
        greeted = (link for link in self._inputs if not link.is_silent)
        return [link for link in (*greeted, *self._pulled) if not link.closed]

    @property
    def outputs(self) -> list[Output]:
        """Connections to which the port writes."""
        return [link for link in self._outputs if not link.closed]

    @property
    def received(self) -> Counters:
        """Totals over all inputs, closed ones included."""
        links = (*self._inputs, *self._pulled)
        return sum((link.counters for link in links), self._past_received)

    @property
    def sent(self) -> Counters:
        """Totals over all outputs, closed ones included."""
        return sum((link.counters for link in self._outputs), self._past_sent)

    def write(self, payload: Payload, envelope: str) -> None:
        """Offer a message to all outputs.

        Raises:
            BusyError: One of them refused it.
            EncodeError: The payload has no form in any dialect, or the envelope holds control
                characters.
        """
        outputs = self.outputs
        message = Outgoing(payload, envelope, self.limits.max_text_bytes)
        if outputs:
            message.check(first=outputs[0].dialect)
        refused: BusyError | None = None
        for output in outputs:
            try:
                output.offer(message)
            except BusyError as error:
                refused = error
        if refused is not None:
            raise refused

    async def wait_for_room(self) -> None:
        """Wait until no output would drop or refuse a message."""
        for output in self.outputs:
            await output.wait_for_room()

    async def connect(self, dest: str, carrier: str) -> Link:
        """Dial `dest` and write to it from now on, instead of over an earlier connection.

        Over mjpeg it is the other way round: `dest` writes to us.

        Raises:
            CommandRefusedError: This port only reads.
        """
        spoken, modifiers = parse_carrier(carrier)
        if not spoken.is_push:
            return await self._pull(dest, spoken)
        contact = await find(dest, self.names)
        if not self.sends:
            raise CommandRefusedError("Outputs not allowed")  # in the words of YARP
        dialect = self.dialect or await self.names.dialects.of(contact)
        for output in self.outputs:
            if output.peer == dest and output.is_connectionless:
                # Its leave is taken by name, and would be that of the new one.
                output.leave("replaced")
                await output.wait_closed()
        channel = await self._dialler.open(self.name, contact, spoken, modifiers)
        self.drop_output(dest)
        output = self._add_output(channel, dest, spoken, modifiers, dialect, is_reverse=False)
        channel.release()
        if self._closing:  # it was not there to be closed with the others
            output.leave("closed by us")
        return output

    async def _pull(self, source: str, carrier: Carrier) -> Subscription:
        if self.on_data is None:
            raise CommandRefusedError(f"{self.name} does not read")
        contact = await find(source, self.names)
        connection = await dial(contact, carrier, self.name, (), self.limits)
        self.drop_input(source)
        link = Subscription(connection, source, carrier, self.dialect, self.on_data, jpeg=self.jpeg)

        def on_lost() -> None:
            self._pulled.remove(link)
            self._past_received += link.counters

        connection.on_lost = on_lost
        self._pulled.append(link)
        connection.release()
        if self._closing:
            link.drop("closed by us")
        return link

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

    async def wait_input(self, peer: str) -> Link:
        """Wait until `peer` has connected to us and return the connection.

        Raises:
            DeadlineError: It has not in `connect_timeout_s`.
        """
        try:
            async with asyncio.timeout(self.limits.connect_timeout_s):
                while True:
                    for link in self.inputs:
                        if link.peer == peer:
                            return link
                    await self._arrival.wait()
        except TimeoutError:
            raise DeadlineError(
                f"the connection from {peer}", self.limits.connect_timeout_s
            ) from None

    async def ask_writers_to_stop(self) -> None:
        """Ask those who write to us to close their connections; they know best how."""
        writers = {link.peer for link in self._inputs if link.peer.startswith("/")}
        asked = (ask_to_stop(self.names, peer, self.name, self.limits) for peer in writers)
        for outcome in await asyncio.gather(*asked, return_exceptions=True):
            if isinstance(outcome, VertebraError):
                log.debug("%s could not ask a writer to stop: %s", self.name, outcome)
            elif isinstance(outcome, BaseException):
                raise outcome

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
        return new.tcp

    def replace(self, new: Input) -> None:
        """Close older connections under the same rooted name, as YARP does."""
        self._arrival.set()
        self._arrival = asyncio.Event()
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
        if carrier is MJPEG and self.jpeg is not None:
            viewer = Viewer(link.tcp, link.peer, self.jpeg, self.spawn,
                            delivery=self._delivery, depth=self._depth)  # fmt: skip
            self._add(viewer, link.tcp)
            return
        output = self._add_output(
            link.tcp, link.peer, carrier, modifiers, link.dialect, is_reverse=True
        )
        if link.dialect is None:
            self.spawn(self._settle(output))

    async def _settle(self, output: Output) -> None:
        output.settle(await self.names.dialects.of_sender(output.peer))

    def spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run `work` until the port closes."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def close(self) -> None:
        """Cancel what runs, take leave from every peer and wait until all are gone."""
        self._closing = True
        tasks = [*self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for output in self._outputs:
            output.leave("closed by us")
        for link in (*self._inputs, *self._pulled):
            link.drop("closed by us")
        leaving = [link.lost for link in (*self._outputs, *self._inputs, *self._pulled)]
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
        channel: Channel,
        peer: str,
        carrier: Carrier,
        modifiers: Sequence[str],
        dialect: Dialect | None,
        *,
        is_reverse: bool,
    ) -> Output:
        output = Output(
            channel,
            peer,
            carrier,
            modifiers,
            dialect,
            delivery=self._delivery,
            depth=self._depth,
            is_reverse=is_reverse,
        )
        self._add(output, channel)
        return output

    def _add(self, output: Output, channel: Channel) -> None:
        def on_lost() -> None:
            self._outputs.remove(output)
            output.let_go()
            self._past_sent += output.counters
            log.info("%s no longer writes to %s: %s", self.name, output.peer, channel.reason)

        channel.on_lost = on_lost
        self._outputs.append(output)
        log.info("%s writes to %s over %s", self.name, output.peer, output.carrier)
