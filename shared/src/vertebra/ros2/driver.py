"""How ROS 2 is reached: one interface, whatever library is behind it.

A driver carries payloads: CDR with its header, nothing decoded. All callbacks come in the event
loop that opened it, and none of its methods waits for the network unless it is `async`.
`vertebra.testing.ros2_suite` is what every driver has to pass.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

from msgspec import Struct

from vertebra.bus import DEFAULT_ROUTER
from vertebra.ros2.graph import Graph
from vertebra.ros2.qos import Qos

OnPayload = Callable[[bytes, int], None]
"""Takes a payload, and when it was written (UTC, ns)."""
OnRequest = Callable[[bytes], Awaitable[bytes | None]]
"""Answers a request with a reply; with None, that nobody gets one."""


class Participation(Struct, frozen=True, kw_only=True):
    """As which node we take part in which ROS graph.

    Attributes:
        domain_id: What ROS_DOMAIN_ID is to ROS.
        node: Name of our node.
        namespace: Of our node.
        interface: Network interface; if this and `peers` are empty, the driver's own way decides.
        peers: Addresses of hosts to look for without multicast.
        router: Zenoh locator of the router, for `rmw_zenoh`, which needs nothing else.
    """

    domain_id: int = 0
    node: str = "vertebra"
    namespace: str = "/"
    interface: str = ""
    peers: tuple[str, ...] = ()
    router: str = DEFAULT_ROUTER


class Closeable(Protocol):
    """Something that ends with `close()`; harmless when repeated."""

    def close(self) -> None:
        """End it."""
        ...


class Reader(Closeable, Protocol):
    """What we read of a topic."""

    @property
    def dropped(self) -> int:
        """Payloads that we were late for, or that never came and whose writers count them."""
        ...

    @property
    def mismatch(self) -> str:
        """The QoS for which a writer is not heard; empty if there is none."""
        ...


class Writer(Closeable, Protocol):
    """What we write of a topic."""

    @property
    def mismatch(self) -> str:
        """The QoS for which a reader does not hear us; empty if there is none."""
        ...

    def write(self, payload: bytes) -> None:
        """Send a payload; raise `TransportError` if the driver refuses it."""
        ...

    async def matched(self) -> None:
        """Wait until somebody reads the topic; raise `NotConnectedError` if this is closed."""
        ...

    async def delivered(self, timeout_s: float) -> None:
        """Wait until all who read the topic reliably have what was written.

        Where readers confirm nothing (`rmw_zenoh`), until the router has it.

        Raises:
            DeadlineError: Somebody has not got it in time.
        """
        ...


class Client(Closeable, Protocol):
    """Our side of a service that others offer."""

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """Send a request and return the reply.

        Raises:
            NotConnectedError: No server that this driver can reach is there.
            DeadlineError: It did not answer in time.
        """
        ...


class Transport(Protocol):
    """One participant in the ROS graph, seen there as one node."""

    @property
    def graph(self) -> Graph:
        """What others have; it changes as they come and go."""
        ...

    @property
    def failed(self) -> Awaitable[None]:
        """Ends with the error that stopped the driver."""
        ...

    @property
    def participant(self) -> bytes:
        """What the gids of our endpoints begin with; empty if they have nothing in common."""
        ...

    def on_graph(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each change of the graph."""
        ...

    def reader(self, name: str, type_name: str, qos: Qos, on_payload: OnPayload) -> Reader:
        """Read a topic."""
        ...

    def writer(self, name: str, type_name: str, qos: Qos) -> Writer:
        """Write a topic."""
        ...

    def client(self, name: str, type_name: str) -> Client:
        """Be a client of a service; `type_name` such as `std_srvs/srv/Trigger`."""
        ...

    def server(self, name: str, type_name: str, on_request: OnRequest) -> Closeable:
        """Offer a service."""
        ...
