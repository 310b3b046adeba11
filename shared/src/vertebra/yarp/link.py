"""One TCP connection between two YARP ports, and what was carried over it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Counters:
    """What passed one way since the start.

    Attributes:
        messages: Delivered to the callback, or handed to the kernel.
        bytes: Their payload bytes.
        dropped: Replaced by a newer message before they could be sent (`delivery="latest"`).
        refused: Not sent because the queue was full, or not readable here.
    """

    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    refused: int = 0


class Link:
    """A connection as its owner sees it.

    Attributes:
        peer: Port name of the other side (of an input: the name the sender gave).
        carrier: With its modifiers, such as `tcp` or `tcp+foo.bar`.
        counters: What passed over it in its data direction.
    """

    peer: str
    carrier: str
    counters: Counters

    @property
    def closed(self) -> bool:
        """Say whether the connection has ended."""
        raise NotImplementedError

    async def wait_closed(self) -> str:
        """Wait for the end of the connection, whoever ends it, and return the reason."""
        raise NotImplementedError

    async def close(self) -> None:
        """End the connection in order: a writer sends `q` first."""
        raise NotImplementedError
