r"""Find the name server: as configured, or on this machine, or by asking the network.

The question is one datagram to a multicast group, and so is the answer, which anybody may hear:

    u32 crc . i32 0 . "NAME_SERVER query /root\n"
    u32 crc . i32 0 . "registration name /root ip 192.168.1.10 port 10000 type tcp\n"
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from vertebra.yarp.naming.addresses import own_addresses
from vertebra.yarp.naming.conf import (
    ServerAddress,
    configured_name_servers,
    default_tcp_port,
    namespaces,
)
from vertebra.yarp.naming.names import Contact, NameClient, parse_registration

log = logging.getLogger(__name__)

GROUP: Final = "224.2.1.1"
_HEADER = struct.Struct("<Ii")
_MAX_DATAGRAM_BYTES: Final = 2048
_TRIES: Final = 3


async def find_name_server(env: Mapping[str, str], *, timeout_s: float = 1.0) -> NameClient:
    """Return a client of the name server that YARP programs would use here.

    That is the one in `yarp.conf` (of the first namespace; names of the others are found as well),
    else one on this machine at the usual TCP port, else one that answers within `timeout_s` to
    multicast, else the one on this machine that is not there yet.

    Raises:
        ConfigError: A configuration file or variable cannot work.
    """
    servers = configured_name_servers(env)
    if servers:
        first, *others = [NameClient(each.host, each.tcp_port) for each in servers]
        first.others = others
        return first
    here = ServerAddress(namespaces(env)[0], "127.0.0.1", default_tcp_port(env))
    if not await _answers(here):
        found = await discover(here.namespace, here.tcp_port, timeout_s=timeout_s)
        if found is not None:
            return NameClient(found.host, found.tcp_port)
    return NameClient(here.host, here.tcp_port)


async def _answers(address: ServerAddress) -> bool:
    try:
        _, writer = await asyncio.open_connection(address.host, address.tcp_port)
    except OSError:
        return False
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return True


async def discover(
    namespace: str,
    udp_port: int,
    *,
    interfaces: Sequence[str] | None = None,
    timeout_s: float = 1.0,
) -> Contact | None:
    """Ask for a name server by multicast, on all interfaces unless they are given by address."""
    if interfaces is None:
        interfaces = own_addresses()
    answered: asyncio.Future[Contact] = asyncio.get_running_loop().create_future()

    def on_line(line: str) -> None:
        contact = parse_registration(line)
        if contact is not None and contact.name == namespace and not answered.done():
            answered.set_result(contact)

    try:
        transport = await _listen(interfaces, udp_port, on_line)
    except OSError as error:
        log.info("no name server is looked for by multicast: %s", error)
        return None
    try:
        for _ in range(_TRIES):  # a datagram may get lost
            _send(f"NAME_SERVER query {namespace}", interfaces, udp_port)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s / _TRIES):
                    return await asyncio.shield(answered)
    finally:
        transport.close()
    return None


class Responder:
    """Answers those who look for the name server by multicast.

    Args:
        registration: The answer, as the name server gives it over TCP.
        interfaces: Own addresses of the interfaces on which to listen and to answer.
    """

    def __init__(self, namespace: str, registration: str, interfaces: Sequence[str]) -> None:
        self._question = f"NAME_SERVER query {namespace}"
        self._registration = registration
        self._interfaces = interfaces
        self._transport: asyncio.DatagramTransport | None = None
        self._udp_port = 0

    async def start(self, udp_port: int) -> bool:
        """Begin to listen; say whether this machine can, and log why it cannot."""
        self._udp_port = udp_port
        try:
            self._transport = await _listen(self._interfaces, udp_port, self._on_line)
        except OSError as error:
            log.warning(
                "nobody finds this name server by multicast: udp port %d of %s: %s; tell YARP "
                "programs where it is with `yarp conf HOST PORT`",
                udp_port, GROUP, error,
            )  # fmt: skip
            return False
        return True

    def close(self) -> None:
        """Answer no more."""
        if self._transport is not None:
            self._transport.close()

    def _on_line(self, line: str) -> None:
        if line == self._question:
            _send(self._registration, self._interfaces, self._udp_port)


class _Lines(asyncio.DatagramProtocol):
    """Takes single lines of text out of datagrams; anything else is no business of ours."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line = on_line

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        text = _parse(data)
        if text is not None:
            log.debug("%s said by multicast: %.200s", addr[0], text)
            self._on_line(text)


def _parse(datagram: bytes) -> str | None:
    if not _HEADER.size < len(datagram) <= _MAX_DATAGRAM_BYTES:
        return None
    crc, sequence = _HEADER.unpack_from(datagram)
    raw = datagram[_HEADER.size :]
    if sequence != 0 or crc != zlib.crc32(raw):
        return None
    return raw.decode("utf-8", "replace").partition("\n")[0].rstrip("\r")


async def _listen(
    interfaces: Sequence[str], udp_port: int, on_line: Callable[[str], None]
) -> asyncio.DatagramTransport:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # all programs share this one
        sock.bind((GROUP, udp_port))
        _join(sock, interfaces)
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: _Lines(on_line), sock=sock)
    except BaseException:
        sock.close()
        raise
    return transport


def _join(sock: socket.socket, interfaces: Sequence[str]) -> None:
    """Hear the group on the interfaces that can; raise OSError if none can."""
    trouble: list[OSError] = []
    for interface in interfaces:
        member = socket.inet_aton(GROUP) + socket.inet_aton(interface)
        try:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError as error:
            trouble.append(error)
    if len(trouble) == len(interfaces):
        raise trouble[0] if trouble else OSError("no interface has an address")


def _send(line: str, interfaces: Sequence[str], udp_port: int) -> None:
    raw = f"{line}\n".encode()
    datagram = _HEADER.pack(zlib.crc32(raw), 0) + raw
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for interface in interfaces:
            option = socket.inet_aton(interface)
            try:
                sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, option)
                sender.sendto(datagram, (GROUP, udp_port))
            except OSError as error:  # an interface without multicast; others may have it
                log.debug("%s carries no multicast: %s", interface, error)
