"""Channels over UDP: what the carriers udp and mcast do after their greeting over TCP."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
import struct
import sys
from collections.abc import Awaitable, Callable, Iterator
from typing import Final

from vertebra.errors import DecodeError, TransportError
from vertebra.yarp.ports.link import CLOSE_GRACE_S, Channel
from vertebra.yarp.protocol.packets import MAX_DATAGRAM_BYTES, Reassembly, cut
from vertebra.yarp.protocol.receiver import Event, Lost
from vertebra.yarp.protocol.wire import Buffer, PeerLimits

log = logging.getLogger(__name__)

Farewell = Callable[[], Awaitable[None]]

_WANTED_BUFFER_BYTES: Final = 8 * 1024 * 1024  # several images; the kernel may give less
_DATAGRAMS_AT_ONCE: Final = 32  # before others get their turn
_MAX_RECEIVED_BYTES: Final = 65536
_PAUSE_S: Final = 0.001  # after a long datagram, as YARP pauses: readers have small buffers
_LONG_BYTES: Final = MAX_DATAGRAM_BYTES * 3 // 4

_COUNTS_DROPS: Final = sys.platform == "linux"
_SO_RXQ_OVFL: Final = 40  # Linux: what the kernel dropped for want of buffer comes with a datagram
_DROPS = struct.Struct("=I")


def _udp_socket(family: int = socket.AF_INET) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_DGRAM)
    sock.settimeout(0)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _WANTED_BUFFER_BYTES)
    return sock


def receiving_socket(host: str) -> socket.socket:
    """Return a socket on a free UDP port of `host`."""
    sock = _udp_socket(_family(host))
    sock.bind((host, 0))
    return sock


def sending_socket(host: str, udp_port: int, dest: tuple[str, int]) -> socket.socket:
    """Return a socket that sends to `dest` from `udp_port`, or another one where that is taken."""
    sock = _udp_socket(_family(host))
    try:
        sock.bind((host, udp_port))
    except OSError:
        sock.bind((host, 0))
    sock.connect(dest)
    return sock


def group_receiving_socket(group: tuple[str, int], interface: str) -> socket.socket:
    """Return a socket that has joined a multicast group on the interface of that address.

    Raises:
        DecodeError: The peer wants us to join what is no multicast group.
    """
    if not ipaddress.ip_address(group[0]).is_multicast or not group[1]:
        raise DecodeError(f"{group[0]}:{group[1]} is no multicast group")
    sock = _udp_socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # other readers on this machine
    sock.bind(group)
    membership = socket.inet_aton(group[0]) + socket.inet_aton(interface)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    return sock


def group_sending_socket(group: tuple[str, int], interface: str) -> socket.socket:
    """Return a socket that sends to a multicast group through the interface of that address."""
    sock = _udp_socket()
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))
    sock.connect(group)
    return sock


def _family(host: str) -> int:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


class DatagramReader(Channel):
    """Delivers the messages that arrive whole, and a `Lost` for each that does not.

    Whole messages that fell out on the way leave no trace, unless our own kernel dropped them.
    """

    def __init__(
        self,
        sock: socket.socket,
        peer_host: str,
        limits: PeerLimits,
        on_event: Callable[[Event], None],
        on_lost: Callable[[], None] | None,
    ) -> None:
        super().__init__(on_event, on_lost)
        self.peer = self.peer_host = peer_host
        self._sock = sock
        self._drops = 0
        self._reassembly = Reassembly(limits, self._deliver, self._miss)
        if _COUNTS_DROPS:
            sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._loop = asyncio.get_running_loop()
        self._held = True
        self.release()

    def hold(self) -> None:
        """See `Channel.hold`; what comes meanwhile waits in the kernel."""
        if not self._held:
            self._held = True
            self._loop.remove_reader(self._sock)

    def release(self) -> None:
        """See `Channel.release`."""
        if self._held and not self.closing:
            self._held = False
            self._loop.add_reader(self._sock, self._receive)

    def write(self, *buffers: Buffer) -> None:
        """Do nothing: neither replies nor acks go back to who sends datagrams."""

    def close(self, reason: str) -> None:
        """See `Channel.close`."""
        if self.closing:
            return
        self.hold()
        self.reason = reason
        self._sock.close()
        self._loop.call_soon(self._end)

    def _receive(self) -> None:
        for _ in range(_DATAGRAMS_AT_ONCE):
            if self._held:
                return
            try:
                datagram, ancillary, _, (host, *_) = self._sock.recvmsg(
                    _MAX_RECEIVED_BYTES, socket.CMSG_SPACE(_DROPS.size)
                )
            except BlockingIOError:
                return
            except OSError as error:
                self.close(f"lost: {error}")
                return
            for _, kind, value in ancillary:
                if kind == _SO_RXQ_OVFL:
                    self._note_drops(*_DROPS.unpack(value))
            if host != self.peer_host:
                self._miss(f"a datagram came from {host}, the peer is at {self.peer_host}")
                continue
            self._reassembly.feed(datagram)

    def _deliver(self, event: Event) -> None:
        try:
            self.on_event(event)
        except DecodeError as error:
            self.refuse(str(error))

    def _miss(self, reason: str) -> None:
        self.on_event(Lost(reason))

    def _note_drops(self, drops: int) -> None:
        new, self._drops = drops - self._drops, drops
        if new > 0:
            self.on_event(
                Lost(
                    f"this machine dropped {new} datagrams, its buffers are too small: "
                    "sysctl -w net.core.rmem_max=8388608",
                    new,
                )
            )


class _LeavingChannel(Channel):
    """A channel to a reader whom only another connection can tell that we leave."""

    def __init__(self, farewell: Farewell) -> None:
        super().__init__(lambda _: None, None)
        self._farewell = farewell
        self._leaving: asyncio.Task[None] | None = None

    def hold(self) -> None:
        """Do nothing: no events come from who reads datagrams."""

    def release(self) -> None:
        """Do nothing, see `hold`."""

    def close(self, reason: str) -> None:
        """End the channel; a message on its way stays a part of one."""
        if not self.closing:
            self.reason = reason
            self._stop()
            self._leaving = asyncio.get_running_loop().create_task(self._take_leave())

    def _stop(self) -> None:
        raise NotImplementedError

    async def _take_leave(self) -> None:
        try:
            async with asyncio.timeout(CLOSE_GRACE_S):
                await self._farewell()
        except (TransportError, TimeoutError) as error:
            reason = str(error) or "no answer"
            log.info("could not tell %s that we leave: %s", self.peer, reason)
        finally:
            self._end()


class DatagramWriter(_LeavingChannel):
    """Sends messages as datagrams, not faster than readers of YARP are used to."""

    def __init__(self, sock: socket.socket, farewell: Farewell) -> None:
        super().__init__(farewell)
        self._sock = sock
        self._datagrams: Iterator[bytes] = iter(())
        self._unsent = b""
        self._pause: asyncio.TimerHandle | None = None
        self._loop = asyncio.get_running_loop()

    def write(self, *buffers: Buffer) -> None:
        """See `Channel.write`."""
        if self.closing:
            return
        self._datagrams = cut(buffers)
        self._advance()
        self.writable = self._send()

    def _send(self) -> bool:
        """Send until a pause is due; say whether all is sent."""
        while self._unsent and not self.closing:
            try:
                self._sock.send(self._unsent)
            except BlockingIOError:
                self._loop.add_writer(self._sock, self._on_room)
                return False
            except OSError as error:  # nobody listens there any more, such as
                self.close(f"lost: {error}")
                return False
            is_long = len(self._unsent) > _LONG_BYTES
            self._advance()
            if is_long:
                self._pause = self._loop.call_later(_PAUSE_S, self._go_on)
                return False
        return not self.closing

    def _advance(self) -> None:
        self._unsent = next(self._datagrams, b"")

    def _on_room(self) -> None:
        self._loop.remove_writer(self._sock)
        self._go_on()

    def _go_on(self) -> None:
        self.writable = self._send()
        if self.writable and self.on_writable is not None:
            self.on_writable()

    def _stop(self) -> None:
        if self._pause is not None:
            self._pause.cancel()
        self._loop.remove_writer(self._sock)
        self._sock.close()


class Group:
    """A multicast group of one port; one transmission serves all its members."""

    def __init__(self, address: tuple[str, int], interface: str, farewell: Farewell) -> None:
        self.address = address
        self.members: list[GroupMember] = []
        self._writer = DatagramWriter(group_sending_socket(address, interface), farewell)
        self._writer.peer = f"{address[0]}:{address[1]}"
        self._writer.on_writable = self._on_writable
        self._writer.on_lost = self._on_lost

    @property
    def closing(self) -> bool:
        """Whether the last member has left."""
        return self._writer.closing

    @property
    def writable(self) -> bool:
        """Whether the message before is with the kernel."""
        return self._writer.writable

    def join(self, farewell: Farewell) -> GroupMember:
        """Return the channel to one more reader."""
        member = GroupMember(self, farewell)
        self.members.append(member)
        return member

    def write(self, *buffers: Buffer) -> None:
        """Send one message to all."""
        self._writer.write(*buffers)
        self._pass_on()

    def leave(self, member: GroupMember) -> None:
        """Let a member go, and the group after the last one."""
        self.members.remove(member)
        if not self.members:
            self._writer.close("the last reader has left")

    def _on_writable(self) -> None:
        self._pass_on()
        for member in [*self.members]:
            if member.on_writable is not None:
                member.on_writable()

    def _on_lost(self) -> None:
        for member in [*self.members]:
            member.close(self._writer.reason)

    def _pass_on(self) -> None:
        for member in self.members:
            member.writable = self._writer.writable


class GroupMember(_LeavingChannel):
    """The way to one reader in a group; the first member's messages are those that are sent."""

    def __init__(self, group: Group, farewell: Farewell) -> None:
        super().__init__(farewell)
        self.writable = group.writable
        self._group = group

    def write(self, *buffers: Buffer) -> None:
        """See `Channel.write`."""
        if not self.closing and self is self._group.members[0]:
            self._group.write(*buffers)

    def _stop(self) -> None:
        self._group.leave(self)
