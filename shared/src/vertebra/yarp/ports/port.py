"""A YARP port on asyncio: one TCP listener for data, calls and administration."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Mapping
from typing import Final, Self

from vertebra.errors import ConfigError, TransportError
from vertebra.yarp.naming.addresses import advertised_host, own_addresses
from vertebra.yarp.naming.conf import opened_as
from vertebra.yarp.naming.names import CHOOSE_FOR_ME, Contact, NameClient, check_name
from vertebra.yarp.ports.incoming import OnCall, OnData
from vertebra.yarp.ports.link import Counters, Delivery, Link
from vertebra.yarp.ports.outputs import Payload
from vertebra.yarp.ports.switchboard import Switchboard
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec
from vertebra.yarp.protocol.wire import CARRIERS, DEFAULT_LIMITS, PeerLimits

log = logging.getLogger(__name__)

_FAREWELL_S: Final = 1.0  # closing must not wait for a name server that is gone


class Port:
    """A registered YARP port; `async with await Port.open(...) as port`."""

    def __init__(self, board: Switchboard, advertise_host: str | None) -> None:
        self._board = board
        self._advertise_host = advertise_host
        self._listener: asyncio.Server | None = None
        self._keeper: asyncio.Task[None] | None = None

    @classmethod
    async def open(
        cls,
        name: str,
        names: NameClient,
        *,
        on_data: OnData | None = None,
        on_call: OnCall | None = None,
        delivery: Delivery = "latest",
        depth: int = 16,
        bind_host: str = "127.0.0.1",
        advertise_host: str | None = None,
        tcp_port: int = 0,
        sends: bool = True,
        jpeg: JpegCodec | None = None,
        dialect: Dialect | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
        check_registration_s: float = 2.0,
        env: Mapping[str, str] | None = None,
    ) -> Self:
        """Listen, register `name` and keep it registered, also over restarts of the name server.

        With `on_call` the port answers every message that wants a reply, and gets the others too
        unless there is an `on_data`. With `on_data` alone, messages that want a reply are
        acknowledged only.

        Args:
            name: Rooted port name, or `...` for one that the name server makes up.
            names: The name server to register with.
            on_data: Gets messages in the event loop.
            on_call: Answers messages.
            delivery: What `write` does while a connection is busy with an earlier message:
                `latest` keeps the newest one, `queue` keeps up to `depth` and then refuses.
            depth: Messages that may wait for each connection when `delivery` is `queue`.
            bind_host: Interface to listen on.
            advertise_host: Address to register; by default `bind_host`, or, where that is a
                wildcard, `YARP_IP` or the address from which the name server sees us.
            tcp_port: 0 takes any free one.
            sends: Whether others may connect this port to readers.
            jpeg: Makes JPEGs of the images that are written, for those who watch by mjpeg, and
                images of the JPEGs that are read; by default `installed_jpeg()`. Where there is
                none, viewers are told so, and JPEGs arrive as they are.
            dialect: What the peers speak; None finds it out for each of them.
            limits: What peers may cost.
            check_registration_s: Time between two looks whether `name` is still registered.
            env: Where users rename and move ports, see `conf.opened_as`; by default `os.environ`.

        Raises:
            ConfigError: The address cannot be bound, or a variable cannot work.
            NameMappingError: `name` is not a YARP port name.
            NotConnectedError, DeadlineError: The name server does not answer.
        """
        env = os.environ if env is None else env
        name, moved_to = opened_as(name, env)
        tcp_port = moved_to or tcp_port
        if name != CHOOSE_FOR_ME:
            check_name(name)
        board = Switchboard(
            Contact(name, "tcp", bind_host, tcp_port),
            names,
            on_data=on_data,
            on_call=on_call,
            delivery=delivery,
            depth=depth,
            dialect=dialect or names.dialects.told_of(name),
            limits=limits,
            sends=sends,
            jpeg=jpeg,
        )
        port = cls(board, advertised_host(advertise_host, bind_host, env, own_addresses()))
        try:
            await port._listen(bind_host, tcp_port)
            await port._register()
        except BaseException:
            await port._shut()
            raise
        port._keeper = asyncio.create_task(port._keep_registered(check_registration_s))
        return port

    @property
    def name(self) -> str:
        """The name as registered."""
        return self._board.contact.name

    @property
    def contact(self) -> Contact:
        """Where the port listens, as registered."""
        return self._board.contact

    @property
    def outputs(self) -> list[Link]:
        """Connections that carry what `write` is given."""
        return [*self._board.outputs]

    @property
    def inputs(self) -> list[Link]:
        """Connections that may send to us, tools such as `<ping>` included."""
        return [*self._board.inputs]

    @property
    def sent(self) -> Counters:
        """Totals over all outputs, closed ones included."""
        return self._board.sent

    @property
    def received(self) -> Counters:
        """Totals over all inputs, closed ones included."""
        return self._board.received

    def write(self, payload: Payload, *, envelope: str = "") -> None:
        """Send an object, the values of a bottle, or bytes to all outputs, without waiting.

        Each output gets them in the dialect of its reader, bytes too if they are written in the
        other one. They must not change afterwards: a busy connection sends them later.

        Raises:
            BusyError: `delivery` is `queue` and at least one output refused; the others got it.
            EncodeError: The payload has no form in any dialect, or the envelope holds control
                characters.
        """
        self._board.write(payload, envelope)

    async def wait_for_room(self) -> None:
        """Wait until the next `write` loses nothing: what YARP calls strict writing.

        A reader that takes nothing makes this wait as long as it is connected.
        """
        await self._board.wait_for_room()

    async def connect(self, dest: str, carrier: str = "fast_tcp") -> Link:
        """Send to the port `dest` from now on, replacing an earlier connection to it.

        Over mjpeg it is `dest` that sends: images, which we read.

        Raises:
            CommandRefusedError: This port was opened with `sends=False`, or reads nothing.
            NotConnectedError: `dest` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
            EncodeError: We do not speak `carrier`.
        """
        return await self._board.connect(dest, carrier)

    async def wait_input(self, peer: str) -> Link:
        """Wait until the port `peer` has connected to us and return the connection.

        Raises:
            DeadlineError: It has not in `connect_timeout_s`.
        """
        return await self._board.wait_input(peer)

    async def disconnect(self, dest: str) -> bool:
        """Stop sending to `dest`; say whether there was such a connection."""
        output = self._board.drop_output(dest)
        if output is None:
            return False
        await output.wait_closed()
        return True

    async def close(self) -> None:
        """Take leave of writers, name server and readers, and stop listening."""
        if self._keeper is None:
            return
        self._keeper.cancel()
        await asyncio.wait([self._keeper])
        self._keeper = None
        try:
            async with asyncio.timeout(_FAREWELL_S):
                await self._board.ask_writers_to_stop()
        except TimeoutError:
            log.info("%s does not wait for writers that do not answer", self.name)
        try:
            async with asyncio.timeout(_FAREWELL_S):
                await self._board.names.unregister(self.name)
        except (TransportError, TimeoutError) as error:
            log.warning("%s stays registered: %s", self.name, str(error) or "no answer in time")
        await self._shut()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _listen(self, bind_host: str, tcp_port: int) -> None:
        # One family only: "localhost" is two addresses, which would get two TCP ports.
        family = socket.AF_INET6 if ":" in bind_host else socket.AF_INET
        loop = asyncio.get_running_loop()
        try:
            self._listener = await loop.create_server(
                self._board.accept, bind_host, tcp_port, family=family
            )
        except OSError as error:
            raise ConfigError(
                f"YARP port {self.name} cannot listen on {bind_host}:{tcp_port}: {error}; "
                "choose another address, or stop the program that has it"
            ) from error

    async def _register(self) -> None:
        assert self._listener is not None  # noqa: S101 -- _listen comes first
        tcp_port = self._listener.sockets[0].getsockname()[1]
        names = self._board.names
        self._board.contact = await names.register(
            self.name, host=self._advertise_host, tcp_port=tcp_port
        )
        await asyncio.gather(
            *(names.set_property(self.name, key, *words) for key, words in _properties().items())
        )
        await names.announce(self.name)

    async def _keep_registered(self, interval_s: float) -> None:
        trouble = ""
        while True:
            await asyncio.sleep(interval_s)
            before, trouble = trouble, await self._check_registration()
            if trouble and not before:
                log.warning("YARP port %s: %s", self.name, trouble)
            elif before and not trouble:
                log.info("YARP port %s is registered again", self.name)

    async def _check_registration(self) -> str:
        """Register again if the name server has forgotten us; return what is wrong."""
        try:
            found = await self._board.names.query(self.name)
            if found is None:
                await self._register()
        except TransportError as error:
            return str(error)
        if found not in (None, self.contact):
            return f"another port has taken its name: {found}; ours is {self.contact}"
        return ""

    async def _shut(self) -> None:
        if self._listener is not None:
            self._listener.close()
        await self._board.close()


def _properties() -> dict[str, list[str]]:
    """Return what YARP's own library tells the name server about each port."""
    carriers = [*CARRIERS]
    return {
        "offers": carriers,
        "accepts": carriers,
        "ips": own_addresses(),
        "process": [str(os.getpid())],
    }
