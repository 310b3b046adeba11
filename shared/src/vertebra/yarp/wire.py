"""What travels on a YARP connection, without any I/O: carriers, limits, greetings, messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

Buffer: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerLimits:
    """What a peer may cost us; beyond it the peer is refused and everybody else lives on.

    Attributes:
        max_message_bytes: Largest announced message or reply.
        max_text_bytes: Longest line on the text carriers, and largest payload turned into one.
        max_connections: Connections that one YARP port accepts at the same time.
        max_silent_connections: How many of these may not have chosen a carrier yet.
        greeting_timeout_s: How long a peer may take to choose its carrier.
        connect_timeout_s: How long dialling another port may take, its greeting included.
        reply_timeout_s: How long `on_call` may take before the caller gets `[fail]`.
    """

    max_message_bytes: int = 64 * 1024 * 1024
    max_text_bytes: int = 1024 * 1024
    max_connections: int = 256
    max_silent_connections: int = 64
    greeting_timeout_s: float = 30.0
    connect_timeout_s: float = 5.0
    reply_timeout_s: float = 10.0


DEFAULT_LIMITS: Final = PeerLimits()
