"""How a port opens a way to a reader, for each carrier."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Final

from vertebra.errors import NotConnectedError, TransportError
from vertebra.yarp.naming.exchange import ask
from vertebra.yarp.naming.names import CHOOSE_FOR_ME, Contact, NameClient
from vertebra.yarp.ports.datagrams import DatagramWriter, Group, GroupMember, sending_socket
from vertebra.yarp.ports.link import Channel, Connection, dial, find, greet, reach
from vertebra.yarp.protocol.receiver import Event, Number
from vertebra.yarp.protocol.text import to_text
from vertebra.yarp.protocol.wire import (
    MCAST,
    TEXT,
    UDP,
    Carrier,
    PeerLimits,
    greeting,
    group_bytes,
    quit_message,
    text_line,
)

_TOOL: Final = "admin"  # how YARP ports call themselves when they ask another one


class Dialler:
    """Opens the ways from one port to its readers.

    Readers by mcast share a multicast group, one on each network interface.
    """

    def __init__(self, names: NameClient, limits: PeerLimits) -> None:
        self._names = names
        self._limits = limits
        self._groups: dict[str, Group] = {}  # by the address of the interface
        self._grouping = asyncio.Lock()

    async def open(
        self, sender: str, contact: Contact, carrier: Carrier, modifiers: Sequence[str]
    ) -> Channel:
        """Return a channel to a reader, held until its owner takes it over; raise as `dial`."""
        way = _WAYS.get(carrier)
        if way is None:
            return await dial(contact, carrier, sender, modifiers, self._limits)
        connection = await reach(contact, carrier, self._limits)
        try:
            hello = greeting(carrier, sender, modifiers)
            channel = await way(self, sender, contact, connection, hello)
        finally:
            connection.close("goes on by datagrams")
        channel.peer = f"{contact.host}:{contact.tcp_port}"
        return channel

    async def _by_udp(
        self, sender: str, contact: Contact, connection: Connection, hello: bytes
    ) -> DatagramWriter:
        answer = await greet(connection, hello, contact, UDP, self._limits)
        if not isinstance(answer, Number) or not 0 < answer.value < 65536:
            raise NotConnectedError(f"{contact.name} names no UDP port to send to: {answer}")
        # Readers may know us by the address from which we greeted.
        local = (connection.local_host, connection.local_tcp_port)
        sock = sending_socket(*local, (connection.peer_host, answer.value))
        return DatagramWriter(sock, partial(self._take_leave, sender, contact.name))

    async def _by_mcast(
        self, sender: str, contact: Contact, connection: Connection, hello: bytes
    ) -> GroupMember:
        async with self._grouping:
            group = self._groups.get(connection.local_host)
            if group is None or group.closing:
                group = await self._make_group(sender, connection.local_host)
                self._groups[connection.local_host] = group
            member = group.join(partial(self._take_leave, sender, contact.name))
        connection.write(hello + group_bytes(group.address))
        return member

    async def _make_group(self, sender: str, interface: str) -> Group:
        granted = await self._names.register(CHOOSE_FOR_ME, carrier="mcast")
        await self._names.set_property(sender, "owns", granted.name)
        address = (granted.host, granted.tcp_port)
        return Group(address, interface, partial(self._names.unregister, granted.name))

    async def _take_leave(self, sender: str, reader: str) -> None:
        """Tell a reader who has no connection from us that we write no more."""
        contact = await find(reader, self._names)
        connection = await dial(contact, TEXT, _TOOL, (), self._limits)
        connection.on_event = _ignore
        connection.on_lost = None
        connection.write(text_line(f"~{sender}") + quit_message(TEXT))
        connection.release()
        await connection.lost


async def why_silent(names: NameClient, writer: str, reader: str, limits: PeerLimits) -> str:
    """Ask `writer` whether it sends to `reader` still; return why not, empty if it may."""
    try:
        contact = await names.query(writer)
    except TransportError:
        return ""
    if contact is None:
        return f"{writer} is not registered any more"
    try:
        found = await _ask(contact, f"[list] [out] {to_text([reader])}", limits)
    except TransportError as error:
        return f"{writer} does not say whether it still writes: {error}"
    return "" if found else f"{writer} does not send to {reader} any more"


async def ask_to_stop(names: NameClient, writer: str, reader: str, limits: PeerLimits) -> None:
    """Ask `writer` to send no more to `reader`, as YARP does when a reader closes.

    Raises:
        NotConnectedError, DeadlineError: It cannot be asked.
    """
    contact = await find(writer, names)
    await _ask(contact, f"[del] {to_text([reader])}", limits)


async def _ask(contact: Contact, request: str, limits: PeerLimits) -> str:
    where = (contact.host, contact.tcp_port)
    return " ".join(await ask(*where, "a", request, limits.connect_timeout_s))


def _ignore(_: Event) -> None:
    """Let pass what a port says to one who leaves."""


_WAYS: Final[
    dict[Carrier, Callable[[Dialler, str, Contact, Connection, bytes], Awaitable[Channel]]]
] = {UDP: Dialler._by_udp, MCAST: Dialler._by_mcast}  # noqa: SLF001 -- methods of this module
