"""The addresses of this machine, and the one under which others are told to reach a YARP port."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import struct
from collections.abc import Mapping, Sequence
from typing import Final

WILDCARDS: Final = ("", "0.0.0.0", "::")  # noqa: S104 -- compared with, not bound to
_SIOCGIFADDR: Final = 0x8915  # linux/sockios.h


def own_addresses() -> list[str]:
    """Return the IPv4 addresses of this machine, one for each interface that has any."""
    try:
        return _addresses_of_interfaces()
    except (ImportError, AttributeError, OSError):  # not Linux
        return [*dict.fromkeys(("127.0.0.1", address_towards("192.0.2.1")))]


def address_towards(host: str) -> str:
    """Return our address as `host` would see it, were there no translation in between.

    No packet is sent; without a way to `host` the result is 127.0.0.1.
    """
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        sock.connect((host, 9))
        address: str = sock.getsockname()[0]
        return address
    return "127.0.0.1"


def advertised_host(
    wanted: str | None, bind_host: str, env: Mapping[str, str], addresses: Sequence[str]
) -> str | None:
    """Return under which address to register a YARP port; None lets the name server see for itself.

    What was `wanted` wins, then an interface that the port is bound to, then `YARP_IP`: an
    address, or the beginning of one that this machine has.
    """
    if wanted:
        return wanted
    if bind_host not in WILDCARDS:
        return bind_host
    prefix = env.get("YARP_IP", "")
    return next((each for each in addresses if prefix and each.startswith(prefix)), prefix or None)


def is_loopback(host: str) -> bool:
    """Say whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _addresses_of_interfaces() -> list[str]:
    import fcntl  # noqa: PLC0415 -- not on every system

    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            with contextlib.suppress(OSError):  # an interface without an address
                answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, request)
                found.append(socket.inet_ntoa(answer[20:24]))
    return found
