"""Connections between any two YARP ports, as `yarp connect` and its kin list and make them.

A YARP connection is known to the two ports that it joins and to nobody else. So every registered
port is asked, and a connection is made or removed by asking the port at one end.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from vertebra.errors import CommandRefusedError, NotConnectedError, TransportError
from vertebra.yarp.naming.names import Contact, NameClient, check_name
from vertebra.yarp.ports.client import RpcClient
from vertebra.yarp.ports.link import find
from vertebra.yarp.protocol.bottle import Value, Vocab

PULLED: Final = frozenset({"mjpeg"})
"""Carriers whose connections the reader makes: it is the one to ask."""
_UNSAFE: Final = frozenset({"text", "text_ack"})
_CARRIER: Final = re.compile(r"[A-Za-z0-9_]+(\+[A-Za-z0-9_.]+)*")
_SENDER: Final = "admin"  # unrooted: shows nowhere as a connection

Direction = Literal["in", "out"]


class NoSuchConnectionError(NotConnectedError):
    """These two YARP ports are not connected."""


@dataclass(frozen=True, slots=True, order=True)
class PortConnection:
    """What one YARP port sends to another, over which carrier."""

    source: str
    dest: str
    carrier: str


@dataclass(frozen=True, slots=True)
class PortState:
    """How a registered YARP port was when it was asked.

    Attributes:
        contact: Where it is registered.
        trouble: Why it did not answer; empty for a port that is alive.
        connections: Those it knows of, both ways.
    """

    contact: Contact
    trouble: str = ""
    connections: tuple[PortConnection, ...] = ()


async def survey(
    names: NameClient, *, timeout_s: float = 1.0, at_once: int = 16
) -> list[PortState]:
    """Ask all registered ports for their connections, in the order of their names.

    Ports that do not answer in `timeout_s` are part of the result. `at_once` are asked at a time.
    What is registered and no port (multicast groups) is left out.

    Raises:
        NotConnectedError, DeadlineError: The name server does not answer.
    """
    gate = asyncio.Semaphore(at_once)

    async def ask(contact: Contact) -> PortState:
        async with gate:
            return await _ask(contact, timeout_s)

    contacts = [contact for contact in await names.list_ports() if contact.carrier != "mcast"]
    return [*await asyncio.gather(*map(ask, contacts))]


def connections_of(states: Iterable[PortState]) -> list[PortConnection]:
    """Return each connection once, though both its ends may tell of it."""
    found: dict[tuple[str, str], PortConnection] = {}
    for state in states:
        for connection in state.connections:
            ends = (connection.source, connection.dest)
            if ends not in found or connection.source == state.contact.name:
                found[ends] = connection  # the sender chose the carrier: it knows best
    return sorted(found.values())


async def connect(
    names: NameClient, source: str, dest: str, carrier: str = "tcp", *, timeout_s: float = 5.0
) -> PortConnection:
    """Make `source` send to `dest` over `carrier`, instead of over another one.

    A connection that is as wanted already is left alone.

    Raises:
        PortNotFoundError: One of them is not registered.
        NotConnectedError, DeadlineError: The port that has to make it does not answer.
        CommandRefusedError: It refuses, or the carrier must not be used.
    """
    _check(source, dest, carrier)
    contacts = {name: await find(name, names) for name in (source, dest)}
    asked, peer, direction = _ends(source, dest, carrier)
    async with await RpcClient.dial(contacts[asked], sender=_SENDER) as port:
        present = await _details(port, asked, direction, peer, timeout_s)
        if present == PortConnection(source, dest, carrier):
            return present
        if present is not None:
            await port.administer([Vocab("del"), peer], timeout_s=timeout_s)
        target = f"{carrier}:/{peer}"  # tcp://b is port /b: the slashes merge
        code, text = _outcome(await port.administer([Vocab("add"), target], timeout_s=timeout_s))
        if code != 0:
            raise CommandRefusedError(f"{asked} does not connect {source} to {dest}: {text}")
        made = await _details(port, asked, direction, peer, timeout_s)
    return made or PortConnection(source, dest, carrier)


async def disconnect(
    names: NameClient, source: str, dest: str, *, timeout_s: float = 5.0
) -> PortConnection:
    """End what `source` sends to `dest`, asking `dest` if `source` cannot do it.

    Raises:
        PortNotFoundError: One of them is not registered.
        NoSuchConnectionError: They are not connected.
        NotConnectedError, DeadlineError: No answer from either.
        CommandRefusedError: They refuse.
    """
    _check(source, dest)
    contacts = {name: await find(name, names) for name in (source, dest)}
    ends: tuple[tuple[str, str, Direction], ...] = ((source, dest, "out"), (dest, source, "in"))
    trouble: TransportError | None = None
    for asked, peer, direction in ends:
        try:
            removed = await _remove(contacts[asked], peer, direction, timeout_s)
        except TransportError as error:
            trouble = error
        else:
            if removed is not None:
                return removed
    raise trouble or NoSuchConnectionError(f"{source} is not connected to {dest}")


async def _remove(
    contact: Contact, peer: str, direction: Direction, timeout_s: float
) -> PortConnection | None:
    async with await RpcClient.dial(contact, sender=_SENDER) as port:
        found = await _details(port, contact.name, direction, peer, timeout_s)
        if found is None:
            return None
        # [del] takes an output before an input of that name: that would be the wrong one.
        if direction == "in" and await _details(port, contact.name, "out", peer, timeout_s):
            return None
        code, text = _outcome(await port.administer([Vocab("del"), peer], timeout_s=timeout_s))
    if code != 0:
        raise CommandRefusedError(f"{contact.name} does not disconnect {peer}: {text}")
    return found


async def _ask(contact: Contact, timeout_s: float) -> PortState:
    try:
        async with asyncio.timeout(timeout_s):
            async with await RpcClient.dial(contact, sender=_SENDER) as port:
                found = [
                    connection
                    for direction in ("out", "in")
                    for peer in await _peers(port, direction, timeout_s)
                    if (
                        connection := await _details(port, contact.name, direction, peer, timeout_s)
                    )
                ]
    except TimeoutError:
        return PortState(contact, f"no answer within {timeout_s:g} s")
    except TransportError as error:
        return PortState(contact, str(error))
    return PortState(contact, connections=tuple(found))


async def _peers(port: RpcClient, direction: str, timeout_s: float) -> list[str]:
    request: list[Value] = [Vocab("list"), Vocab(direction)]
    reply = await port.administer(request, timeout_s=timeout_s)
    # Callers without a rooted name, such as ourselves, are no connections.
    return [str(peer) for peer in reply if isinstance(peer, str) and peer.startswith("/")]


async def _details(
    port: RpcClient, asked: str, direction: str, peer: str, timeout_s: float
) -> PortConnection | None:
    request: list[Value] = [Vocab("list"), Vocab(direction), peer]
    reply = await port.administer(request, timeout_s=timeout_s)
    found = {str(pair[0]): pair[1] for pair in reply if isinstance(pair, list) and len(pair) == 2}
    if not found:
        return None
    source, dest = (asked, peer) if direction == "out" else (peer, asked)
    return PortConnection(source, dest, str(found.get("carrier", "")))


def _ends(source: str, dest: str, carrier: str) -> tuple[str, str, Direction]:
    if carrier.partition("+")[0] in PULLED:
        return dest, source, "in"
    return source, dest, "out"


def _check(source: str, dest: str, carrier: str = "tcp") -> None:
    check_name(source)
    check_name(dest)
    if not _CARRIER.fullmatch(carrier):
        raise CommandRefusedError(f"{carrier!r} is no carrier; tcp, fast_tcp and udp are")
    if carrier.partition("+")[0] in _UNSAFE:
        raise CommandRefusedError(
            f"a connection over {carrier} is not made: a YARP port that streams images or vectors "
            "over it crashes (a fault of YARP); take tcp or fast_tcp"
        )


def _outcome(reply: Sequence[Value]) -> tuple[object, str]:
    code, text = [*reply, "", ""][:2]
    return code, str(text).strip()
