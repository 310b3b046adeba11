"""What people ask of the adapter: its routes, the YARP ports, and connections between them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any, Final

import msgspec
from msgspec import Struct, field

from vertebra.bus import Reply, Request
from vertebra.errors import CommandRefusedError
from vertebra.service import Context
from vertebra.yarp.ports.connections import (
    PortConnection,
    PortState,
    connect,
    connections_of,
    disconnect,
    survey,
)
from vertebra_yarp.driver import Transport
from vertebra_yarp.settings import YarpSettings

log = logging.getLogger(__name__)

JSON: Final = "application/json"


class Ends(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Two YARP ports, as the calls `connect` and `disconnect` take them.

    Attributes:
        source: The port that sends.
        dest: The port that gets it.
        carrier: How it travels; `disconnect` does not mind.
    """

    source: str = field(name="from")
    dest: str = field(name="to")
    carrier: str = "tcp"


class Desk:
    """Answers the calls `routes`, `ports`, `connections`, `connect` and `disconnect`."""

    def __init__(
        self,
        context: Context[YarpSettings],
        transport: Transport,
        routes: Callable[[], list[dict[str, Any]]],
    ) -> None:
        self._names = transport.names
        self._routes = routes
        self._surveying = asyncio.Lock()  # asking every port is work for all of them
        self._served = [
            context.bus.serve(context.key(leaf), handler)
            for leaf, handler in {
                "routes": self._list_routes,
                "ports": self._list_ports,
                "connections": self._list_connections,
                "connect": self._connect,
                "disconnect": self._disconnect,
            }.items()
        ]

    def close(self) -> None:
        """Answer no more."""
        for served in self._served:
            served.close()

    async def _list_routes(self, _: Request) -> Reply:
        return _reply({"routes": self._routes()})

    async def _list_ports(self, _: Request) -> Reply:
        states = await self._survey()
        return _reply({"ports": [_port(state) for state in states]})

    async def _list_connections(self, _: Request) -> Reply:
        states = await self._survey()
        return _reply(
            {
                "connections": [_connection(found) for found in connections_of(states)],
                "silent": [_port(state) for state in states if state.trouble],
            }
        )

    async def _connect(self, request: Request) -> Reply:
        ends = _ends(request)
        made = await connect(
            self._names, ends.source, ends.dest, ends.carrier, timeout_s=request.timeout_s
        )
        log.info("connected %s to %s over %s", made.source, made.dest, made.carrier)
        return _reply(_connection(made))

    async def _disconnect(self, request: Request) -> Reply:
        ends = _ends(request)
        removed = await disconnect(self._names, ends.source, ends.dest, timeout_s=request.timeout_s)
        log.info("disconnected %s from %s", removed.dest, removed.source)
        return _reply(_connection(removed))

    async def _survey(self) -> list[PortState]:
        async with self._surveying:
            return await survey(self._names)


def _ends(request: Request) -> Ends:
    try:
        return msgspec.json.decode(request.payload, type=Ends)
    except msgspec.DecodeError as error:
        raise CommandRefusedError(
            f'a connection is {{"from": "/a", "to": "/b", "carrier": "tcp"}}: {error}'
        ) from error


def _port(state: PortState) -> dict[str, Any]:
    contact = state.contact
    return {
        "name": contact.name,
        "carrier": contact.carrier,
        "address": f"{contact.host}:{contact.tcp_port}",
        "alive": not state.trouble,
        "trouble": state.trouble,
    }


def _connection(connection: PortConnection) -> dict[str, str]:
    return {"from": connection.source, "to": connection.dest, "carrier": connection.carrier}


def _reply(document: object) -> Reply:
    return Reply(payload=msgspec.json.encode(document), encoding=JSON)
