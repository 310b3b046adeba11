"""The built-in YARP name server: a YARP port in front of a table of names.

It answers like `yarpserver`, connects what is to be connected whenever it is there (`subscribe`),
and can be found by multicast. It never removes a name on its own: it cannot tell a dead port from
one behind a network that only its readers share. `vertebra.yarp.naming.clean` does, when asked to.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from dataclasses import replace
from typing import Final, Self

from vertebra.errors import TransportError, VertebraError
from vertebra.yarp.naming.addresses import WILDCARDS, address_towards, own_addresses
from vertebra.yarp.naming.conf import DEFAULT_TCP_PORT, ROOT
from vertebra.yarp.naming.discovery import GROUP, Responder
from vertebra.yarp.naming.names import Contact, NameClient
from vertebra.yarp.naming.nametable import NameTable, TableClient, is_question
from vertebra.yarp.naming.subscriptions import Match
from vertebra.yarp.ports.admin import fail
from vertebra.yarp.ports.connections import NoSuchConnectionError, connect, disconnect
from vertebra.yarp.ports.incoming import Incoming, Reply
from vertebra.yarp.ports.link import PortNotFoundError
from vertebra.yarp.ports.port import Port
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.wire import DEFAULT_LIMITS, HTTP, PeerLimits

log = logging.getLogger(__name__)

_MAX_REQUEST_BYTES: Final = 256 * 1024
_MAX_MATCHES: Final = 1000
_AT_ONCE: Final = 8
_RETRIES_S: Final = (0.2, 0.5, 1.0, 2.0)
_ANYWHERE: Final = "192.0.2.1"  # an address that is no one's, behind the default route


class NameServer:
    """A running name server; `async with await NameServer.start() as server`."""

    def __init__(self, port: Port, table: NameTable, matchmaker: _Matchmaker) -> None:
        self._port = port
        self._table = table
        self._matchmaker = matchmaker
        self._responder: Responder | None = None

    @classmethod
    async def start(
        cls,
        *,
        bind_host: str = "127.0.0.1",
        tcp_port: int = DEFAULT_TCP_PORT,
        advertise_host: str | None = None,
        namespace: str = ROOT,
        discovery_udp_port: int | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> Self:
        """Listen on `bind_host:tcp_port` (0: any free one, see `contact`) and answer requests.

        Args:
            bind_host: Interface to listen on.
            tcp_port: Where to listen.
            advertise_host: Address that others are told; by default `bind_host`, or, where that
                is a wildcard, the address towards the default route.
            namespace: Name of the server's own port.
            discovery_udp_port: Answer those who look for it by multicast on this UDP port (YARP's
                is 10000); a machine without multicast is no error.
            limits: What peers may cost.

        Raises:
            ConfigError: The address is in use or not ours.
        """
        if advertise_host is None and bind_host in WILDCARDS:
            advertise_host = address_towards(_ANYWHERE)
        matchmaker = _Matchmaker()
        table = NameTable(matchmaker.make)
        matchmaker.names = TableClient(table)

        async def answer(incoming: Incoming) -> Reply:
            request = incoming.bottle()
            if incoming.carrier == HTTP.name and not is_question(request):
                return fail("over http a name server tells, but changes nothing")
            return table.answer(request, incoming.sender_host)

        names = TableClient(table)
        port = await Port.open(
            namespace,
            names,
            on_call=answer,
            bind_host=bind_host,
            advertise_host=advertise_host,
            tcp_port=tcp_port,
            dialect=Dialect.V3,  # names and int32 are the same in all: nobody need be asked
            limits=replace(limits, max_message_bytes=_MAX_REQUEST_BYTES),
            env={},
        )
        names.host, names.tcp_port = port.contact.host, port.contact.tcp_port
        table.give_tcp_ports_from(port.contact.tcp_port + 2)
        table.answer(["set", namespace, "nameserver", "true"], "")
        server = cls(port, table, matchmaker)
        if discovery_udp_port is not None:
            interfaces = own_addresses() if bind_host in WILDCARDS else [bind_host]
            await server._be_found(interfaces, discovery_udp_port)
        return server

    @property
    def contact(self) -> Contact:
        """Where the server listens."""
        return self._port.contact

    def client(self) -> NameClient:
        """Return a client of this server."""
        return NameClient(self.contact.host, self.contact.tcp_port)

    async def close(self) -> None:
        """Stop listening and close all connections."""
        if self._responder is not None:
            self._responder.close()
        await self._matchmaker.close()
        await self._port.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _be_found(self, interfaces: list[str], udp_port: int) -> None:
        where = self.contact
        line = f"registration name {where.name} ip {where.host} port {where.tcp_port} type tcp"
        responder = Responder(where.name, line, interfaces)
        if await responder.start(udp_port):
            self._responder = responder
            self._table.answer(["register", "fallback", "mcast", GROUP, udp_port], "")


class _Matchmaker:
    """Connects ports, as `yarp connect` does, in the background."""

    def __init__(self) -> None:
        self.names: NameClient
        self._wanted: dict[tuple[str, str], Match] = {}
        self._tasks: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._gate = asyncio.Semaphore(_AT_ONCE)

    def make(self, match: Match) -> None:
        """Connect two ports soon; what is asked of the same two meanwhile comes after it."""
        pair = (match.source, match.dest)
        if pair not in self._tasks and len(self._tasks) >= _MAX_MATCHES:
            log.error("%s is not connected to %s: %d others wait already", *pair, _MAX_MATCHES)
            return
        self._wanted[pair] = match
        if pair not in self._tasks:
            self._tasks[pair] = asyncio.create_task(self._work(pair))

    async def close(self) -> None:
        """Connect no more."""
        tasks = [*self._tasks.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _work(self, pair: tuple[str, str]) -> None:
        try:
            while (match := self._wanted.pop(pair, None)) is not None:
                await self._connect(match)
        finally:
            del self._tasks[pair]

    async def _connect(self, match: Match) -> None:
        ends = (match.source, match.dest)
        for pause_s in (*_RETRIES_S, None):
            try:
                async with self._gate:
                    if match.afresh:
                        with contextlib.suppress(NoSuchConnectionError):
                            await disconnect(self.names, *ends)
                    await connect(self.names, *ends, match.carrier)
            except VertebraError as error:
                may_pass = isinstance(error, TransportError)
                if isinstance(error, PortNotFoundError) or not may_pass or pause_s is None:
                    log.warning("%s is not connected to %s: %s", *ends, error)
                    return
                await asyncio.sleep(pause_s)
            else:
                log.info("connected %s to %s, as subscribed", *ends)
                return
