"""Subscriptions to output ports, over every carrier that takes one there."""

from __future__ import annotations

from contextlib import suppress
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.naming.names import NameClient, check_name
from vertebra.yarp.ports.connections import NoSuchConnectionError, connect, disconnect
from vertebra.yarp.ports.incoming import OnData
from vertebra.yarp.ports.link import Counters, Link, dial, find
from vertebra.yarp.ports.port import Port
from vertebra.yarp.ports.reading import Subscription
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec
from vertebra.yarp.protocol.wire import (
    DEFAULT_LIMITS,
    FAST_TCP,
    MCAST,
    MJPEG,
    TCP,
    UDP,
    PeerLimits,
    reverse_message,
)

_REVERSE: Final = {carrier.name: carrier for carrier in (FAST_TCP, TCP)}
_DIALLED: Final = _REVERSE | {MJPEG.name: MJPEG}
_REQUESTED: Final = {carrier.name: carrier for carrier in (UDP, MCAST)}
_NAMES: Final = ", ".join((*_DIALLED, *_REQUESTED))


class Reader:
    """A subscription to an output port.

    When the source goes away, `wait_closed` returns; subscribing again is up to the caller.

    Attributes:
        peer: Name of the source.
        carrier: Such as `fast_tcp`.
    """

    def __init__(self, link: Link, port: Port | None) -> None:
        self.peer = link.peer
        self.carrier = link.carrier
        self._link = link
        self._port = port

    @classmethod
    async def dial(
        cls,
        source: str,
        names: NameClient,
        *,
        on_data: OnData,
        reader_name: str,
        carrier: str = "fast_tcp",
        jpeg: JpegCodec | None = None,
        bind_host: str = "127.0.0.1",
        advertise_host: str | None = None,
        dialect: Dialect | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> Self:
        """Subscribe to the output port `source`.

        Over fast_tcp, tcp and mjpeg we dial, nothing is registered and nothing listens on our
        side. Datagrams (udp, mcast) go to ports only: one is opened, and the source is asked to
        connect to it.

        Args:
            source: Name of the port.
            names: Its name server.
            on_data: Gets messages in the event loop.
            reader_name: How the source lists us; it must be rooted (`/x`) and unique at the
                source, which closes an older connection of the same name.
            carrier: One of fast_tcp, tcp, mjpeg, udp, mcast.
            jpeg: What turns the JPEGs of mjpeg into serialised images; without it they are the
                payload as they come.
            bind_host: Where the port for datagrams listens; see `Port.open`.
            advertise_host: What it registers; see `Port.open`.
            dialect: What the source speaks; without it each message shows it.
            limits: What the source may cost.

        Raises:
            NotConnectedError: `source` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
            CommandRefusedError: It does not connect to us.
            EncodeError: `carrier` is another one.
        """
        check_name(reader_name)
        dialect = dialect or names.dialects.told_of(source)
        if carrier in _REQUESTED:
            port = await Port.open(
                reader_name,
                names,
                on_data=on_data,
                sends=False,
                bind_host=bind_host,
                advertise_host=advertise_host,
                dialect=dialect,
                limits=limits,
            )
            try:
                with suppress(NoSuchConnectionError):  # that of one who had this name before
                    await disconnect(names, source, port.name)
                await connect(names, source, port.name, carrier)
                link = await port.wait_input(source)
            except BaseException:
                await port.close()
                raise
            return cls(link, port)
        if carrier not in _DIALLED:
            raise EncodeError(f"cannot read over carrier {carrier!r}; use one of {_NAMES}")
        spoken = _DIALLED[carrier]
        contact = await find(source, names)
        connection = await dial(contact, spoken, reader_name, (), limits)
        connection.on_lost = None
        link = Subscription(connection, source, spoken, dialect, on_data, jpeg=jpeg)
        if carrier in _REVERSE:
            connection.write(reverse_message())
        connection.release()
        return cls(link, None)

    @property
    def counters(self) -> Counters:
        """What arrived."""
        return self._link.counters

    @property
    def closed(self) -> bool:
        """Whether the subscription has ended or is about to."""
        return self._link.closed

    async def wait_closed(self) -> str:
        """Wait for the end of the subscription, whoever ends it, and return the reason."""
        reason = await self._link.wait_closed()
        if self._port is not None:
            await self._port.close()
        return reason

    async def close(self) -> None:
        """End the subscription."""
        if self._port is not None:
            await self._port.close()
        await self._link.close()
