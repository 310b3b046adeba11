"""What `vertebra.ros2.driver` asks for, on Zenoh as `rmw_zenoh_cpp` uses it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Final

from vertebra.bus.links import open_client
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import OnPayload, OnRequest, Participation
from vertebra.ros2.graph import Graph
from vertebra.ros2.qos import Qos
from vertebra.ros2.rmw_zenoh.services import ServiceClient, ServiceServer
from vertebra.ros2.rmw_zenoh.session import Session, refusals
from vertebra.ros2.rmw_zenoh.topics import TopicReader, TopicWriter

_SETTINGS: Final[dict[str, Any]] = {
    "timestamping/enabled": True,  # latched samples are told apart by their time
    "transport/shared_memory/enabled": False,
}


class RmwZenohTransport:
    """One node; see `driver.Transport`. Open it with `rmw_zenoh_driver`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    @property
    def graph(self) -> Graph:
        """What others have."""
        return self._session.graph

    @property
    def failed(self) -> asyncio.Future[None]:
        """Ends with the error that stopped us; Zenoh itself comes back by itself."""
        return self._session.failed

    @property
    def participant(self) -> bytes:
        """What the gids of our endpoints begin with."""
        return self._session.participant

    def on_graph(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each change of the graph."""
        self._session.on_graph(changed)

    def reader(self, name: str, type_name: str, qos: Qos, on_payload: OnPayload) -> TopicReader:
        """Read a topic."""
        with refusals(f"to read {name}"):
            return TopicReader(self._session, name, type_name, qos, on_payload)

    def writer(self, name: str, type_name: str, qos: Qos) -> TopicWriter:
        """Write a topic."""
        with refusals(f"to write {name}"):
            return TopicWriter(self._session, name, type_name, qos)

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Be a client of a service; `type_name` such as `std_srvs/srv/Trigger`."""
        with refusals(f"to ask {name}"):
            return ServiceClient(self._session, name, type_name)

    def server(self, name: str, type_name: str, on_request: OnRequest) -> ServiceServer:
        """Offer a service."""
        with refusals(f"to serve {name}"):
            return ServiceServer(self._session, name, type_name, on_request)


@asynccontextmanager
async def rmw_zenoh_driver(part: Participation, types: Types) -> AsyncIterator[RmwZenohTransport]:
    """Be a node while the block runs; waits for the router, and says so in the log.

    Raises:
        ConfigError: The router's locator is none.
    """
    session = Session(await open_client(part.router, _SETTINGS), part, types)
    try:
        yield RmwZenohTransport(session)
    finally:
        await session.close()
