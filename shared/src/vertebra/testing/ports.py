"""Free TCP ports for servers that cannot be asked which one they took."""

from __future__ import annotations

import socket


def free_tcp_port() -> int:
    """Return a TCP port of the loopback interface that was free a moment ago."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
