"""YARP port names and the name server: finding it and talking to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

DEFAULT_TCP_PORT = 10000


@dataclass(frozen=True, slots=True)
class Contact:
    """Where a YARP port listens."""

    name: str
    carrier: str
    host: str
    tcp_port: int


def find_name_server(env: Mapping[str, str]) -> tuple[str, int]:
    """Return host and TCP port of the name server that `yarp.conf` names, found as YARP finds it.

    Without a file it is 127.0.0.1:10000, the server's own default.

    Raises:
        ConfigError: The file cannot be read as `HOST PORT [yarp]` or an ini section.
    """
    raise NotImplementedError


class NameClient:
    """Ask a YARP name server; each request has its own connection and deadline.

    Every method raises NotConnectedError (nobody listens there), DeadlineError (no answer in
    time) or RemoteError (the answer is not one a name server gives).
    """

    def __init__(self, host: str, tcp_port: int, *, timeout_s: float = 5.0) -> None:
        self.host = host
        self.tcp_port = tcp_port
        self.timeout_s = timeout_s

    async def query(self, name: str) -> Contact | None:
        """Return where `name` listens, or None when it is not registered."""
        raise NotImplementedError

    async def register(
        self,
        name: str,
        *,
        carrier: str = "tcp",
        host: str | None = None,
        tcp_port: int | None = None,
    ) -> Contact:
        """Register `name`, replacing an older registration, and return what was granted.

        The server chooses what is None: the host from which this request comes, a free TCP port.
        The name `...` asks for a fresh one.
        """
        raise NotImplementedError

    async def unregister(self, name: str) -> None:
        """Forget `name`; unknown names are fine."""
        raise NotImplementedError

    async def announce(self, name: str) -> None:
        """Tell the server that `name` accepts connections from now on."""
        raise NotImplementedError

    async def set_property(self, name: str, key: str, *values: str) -> None:
        """Store a property of a registered port; the server sorts the values."""
        raise NotImplementedError

    async def get_property(self, name: str, key: str) -> list[str]:
        """Return the words of a property, none when port or property are unknown."""
        raise NotImplementedError

    async def list_ports(self, prefix: str = "") -> list[Contact]:
        """Return all registered ports below `prefix` (whole path components), sorted by name."""
        raise NotImplementedError

    async def exists(self, name: str) -> bool:
        """Say whether `name` is registered and a YARP port answers there."""
        raise NotImplementedError
