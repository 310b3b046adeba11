"""What arrives at a subscription, and what is kept of it while its consumer is busy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

from msgspec import Struct


class Sample(Struct, frozen=True, kw_only=True):
    """One payload on a key.

    Attributes:
        key: Where it was put; never an expression.
        payload: Opaque bytes.
        encoding: How to read them, for example `application/vnd.vertebra.frame;Image/1`.
        sent_ns: When it was put (UTC, ns), 0 if its publisher does not say.
    """

    key: str
    payload: bytes
    encoding: str
    sent_ns: int = 0


@dataclass(frozen=True, slots=True)
class Delivery:
    """What a subscription keeps while its consumer is busy.

    `latest` keeps the newest `depth` samples of each key and lets older ones go: streams.
    `queue` keeps every sample in order and refuses new ones when `depth` are waiting: events.
    """

    policy: Literal["latest", "queue"]
    depth: int

    def __post_init__(self) -> None:
        if self.depth < 1:
            raise ValueError(f"a delivery has a depth of at least 1, not {self.depth}")

    @classmethod
    def latest(cls, depth: int = 1) -> Self:
        """Keep the newest `depth` samples of each key."""
        return cls("latest", depth)

    @classmethod
    def queue(cls, depth: int) -> Self:
        """Keep up to `depth` samples, in order."""
        return cls("queue", depth)
