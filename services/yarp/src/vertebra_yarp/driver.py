"""How the adapter reaches YARP: one interface, and the driver that needs no YARP installation."""

from __future__ import annotations

import contextlib
import os
from collections.abc import AsyncIterator, Sequence
from typing import Protocol

from vertebra.errors import ConfigError, NotConnectedError
from vertebra.yarp import (
    Counters,
    Delivery,
    Dialect,
    NameClient,
    NameServer,
    OnCall,
    OnData,
    Payload,
    Port,
    Reader,
    RpcClient,
    Sender,
    Value,
    find_name_server,
)


class Connection(Protocol):
    """A connection that was made and may be lost."""

    async def wait_closed(self) -> str:
        """Return why it ended, when it has."""
        ...

    async def close(self) -> None:
        """End it; harmless when repeated."""
        ...


class Caller(Connection, Protocol):
    """A connection to a YARP RPC port."""

    @property
    def dialect(self) -> Dialect:
        """The YARP generation of the other side."""
        ...

    async def call(self, values: Sequence[Value], *, timeout_s: float) -> list[Value]:
        """Send a bottle and return the reply; see `RpcClient.call`."""
        ...


class Sink(Connection, Protocol):
    """A connection into a YARP input port of somebody else."""

    def write(self, payload: Payload, *, envelope: str = "") -> None:
        """Send one object, without waiting; see `Sender.write`."""
        ...

    async def wait_taken(self) -> bool:
        """Wait until the port has everything; see `Sender.wait_taken`."""
        ...


class Writer(Protocol):
    """A YARP port of ours that others read."""

    @property
    def sent(self) -> Counters:
        """What left, and what was let go."""
        ...

    def write(self, payload: Payload, *, envelope: str = "") -> None:
        """Send one object to all readers, without waiting; see `Port.write`."""
        ...

    async def close(self) -> None:
        """Unregister it and close its connections."""
        ...


class Transport(Protocol):
    """What the adapter needs of YARP; raises `TransportError` when a peer is away."""

    @property
    def names(self) -> NameClient:
        """The name server."""
        ...

    async def read(self, source: str, reader_name: str, on_data: OnData) -> Connection:
        """Receive what the output port `source` sends."""
        ...

    async def dial(self, name: str) -> Caller:
        """Connect to the RPC port `name`."""
        ...

    async def send_to(
        self, dest: str, sender_name: str, *, carrier: str = "fast_tcp", depth: int = 0
    ) -> Sink:
        """Connect to the input port `dest`, which keeps the newest message, or a queue."""
        ...

    async def open_writer(self, name: str, *, delivery: Delivery, depth: int) -> Writer:
        """Open an output port that others connect to readers, or read in reverse.

        A name that a living port has is not taken from it: `NotConnectedError`.
        """
        ...

    async def open_server(self, name: str, on_call: OnCall) -> Writer:
        """Open an RPC port; see `open_writer`."""
        ...


class NativeDriver:
    """`Transport` on our own implementation of the wire protocol."""

    def __init__(self, names: NameClient, *, bind_host: str, advertise_host: str | None) -> None:
        self.names = names
        self._bind_host = bind_host
        self._advertise_host = advertise_host

    async def read(self, source: str, reader_name: str, on_data: OnData) -> Reader:
        """See `Transport.read`: by reverse connection, so that the robot opens nothing for us."""
        return await Reader.dial(source, self.names, on_data=on_data, reader_name=reader_name)

    async def dial(self, name: str) -> RpcClient:
        """See `Transport.dial`."""
        return await RpcClient.connect(name, self.names)

    async def send_to(
        self, dest: str, sender_name: str, *, carrier: str = "fast_tcp", depth: int = 0
    ) -> Sender:
        """See `Transport.send_to`: nothing of ours is registered or listens."""
        return await Sender.dial(
            dest,
            self.names,
            sender_name=sender_name,
            carrier=carrier,
            delivery="queue" if depth else "latest",
            depth=depth,
        )

    async def open_writer(self, name: str, *, delivery: Delivery, depth: int) -> Port:
        """See `Transport.open_writer`."""
        await check_free(name, self.names)
        return await Port.open(
            name,
            self.names,
            delivery=delivery,
            depth=depth,
            bind_host=self._bind_host,
            advertise_host=self._advertise_host,
        )

    async def open_server(self, name: str, on_call: OnCall) -> Port:
        """See `Transport.open_server`."""
        await check_free(name, self.names)
        return await Port.open(
            name,
            self.names,
            on_call=on_call,
            bind_host=self._bind_host,
            advertise_host=self._advertise_host,
        )


async def check_free(name: str, names: NameClient) -> None:
    """Raise NotConnectedError if a living port has this name.

    YARP gives a name to whoever asks last, and the program that had it is not even told.
    """
    if await names.exists(name):
        raise NotConnectedError(
            f"the YARP port {name} is another program's, perhaps that of a second fleet; stop "
            "that program, or give the route another name"
        )


@contextlib.asynccontextmanager
async def name_service(
    *, name_server: str, serve_names_on: str, advertise_host: str
) -> AsyncIterator[NameClient]:
    """Yield a client of an external name server, or of the built-in one if `name_server` is empty.

    With `auto` it is the one that YARP programs would use here; see `find_name_server`.

    Raises:
        ConfigError: An address is malformed or taken.
    """
    if name_server:
        if name_server == "auto":
            yield await find_name_server(os.environ)
        else:
            yield NameClient(*split_address(name_server))
        return
    host, tcp_port = split_address(serve_names_on)
    async with await NameServer.start(
        bind_host=host, tcp_port=tcp_port, advertise_host=advertise_host or None
    ) as server:
        yield server.client()


def split_address(address: str) -> tuple[str, int]:
    """Return host and tcp_port of `host:tcp_port`; raise `ConfigError`."""
    host, colon, tcp_port = address.rpartition(":")
    if not colon or not host or not tcp_port.isdecimal() or int(tcp_port) > 65535:
        raise ConfigError(f"{address!r} is not of the form host:tcp_port, such as 127.0.0.1:10000")
    return host, int(tcp_port)
