"""What the backbone offers: publish, subscribe, serve, call, presence.

Two implementations behave alike (one suite, `tests/contract/test_bus.py`): `ZenohBus` for real
and `MemoryBus` in one process. Payloads are opaque here; `encoding` says how to read them.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from enum import Enum
from typing import Final, Protocol, runtime_checkable

from msgspec import Struct

from vertebra.bus.sample import Delivery, Sample
from vertebra.bus.subscription import Subscription


@runtime_checkable
class Gatherable(Protocol):
    """A payload in pieces, for example an encoded frame whose image is still where it was."""

    @property
    def nbytes(self) -> int:
        """Length of the whole payload."""
        ...

    def parts(self) -> Iterator[bytes | memoryview]:
        """Yield the pieces in order."""
        ...


Payload = bytes | Gatherable


class Priority(Enum):
    """What overtakes what when a link is busy."""

    CONTROL = "control"
    """Commands, replies, status."""
    DATA = "data"
    """Joint states, results."""
    BULK = "bulk"
    """Images, point clouds, audio."""


PRESENCE_DELIVERY: Final = Delivery.latest(depth=8)
"""Presence keeps the last changes of each key: a flapping peer must not hide another one."""


class Request(Struct, frozen=True, kw_only=True):
    """A call that arrived at a served key.

    Attributes:
        key: The key that was called.
        payload: Its argument; may be empty.
        encoding: How to read `payload`.
        timeout_s: What is left for the answer; the handler is cancelled after that.
    """

    key: str
    payload: bytes
    encoding: str
    timeout_s: float


class Reply(Struct, frozen=True, kw_only=True):
    """The answer to a call; `key` is the key that answered (set by the bus)."""

    payload: bytes
    encoding: str
    key: str = ""


Handler = Callable[[Request], Awaitable[Reply]]
"""Answers a call. A `VertebraError` it raises reaches the caller as a `RemoteError`."""


OnWanted = Callable[[bool], None]


class Publisher(Protocol):
    """Puts payloads on one key."""

    @property
    def key(self) -> str:
        """Where it publishes."""
        ...

    def put(self, payload: Payload, *, encoding: str | None = None) -> None:
        """Send `payload` now, without ever waiting.

        A link that is congested loses it; subscribers count that as `lost`. `encoding` overrides
        the publisher's own.

        Raises:
            NotConnectedError: The bus is closed.
        """
        ...

    def close(self) -> None:
        """Undeclare it; harmless when repeated."""
        ...


class Closeable(Protocol):
    """A declaration that ends with `close()`; harmless when repeated."""

    def close(self) -> None:
        """Undeclare it."""
        ...


class PresenceEvent(Struct, frozen=True):
    """A presence key appeared or went away."""

    key: str
    present: bool


class BusInfo(Struct, frozen=True, kw_only=True):
    """What doctor, log and metrics say about a bus.

    Attributes:
        identity: Names this session in the network.
        connected: Whether a router is reached now.
        shared_memory: How large payloads travel, in words.
        shared_memory_misses: Large payloads that found the pool full and went by copy.
    """

    identity: str
    connected: bool
    shared_memory: str
    shared_memory_misses: int = 0


class Bus(Protocol):
    """One process's membership in the backbone.

    All methods belong to the event loop that made the bus; only samples arrive from elsewhere.
    Every method raises `NameMappingError` for a bad key and `NotConnectedError` once closed.
    """

    def publisher(
        self, key: str, *, encoding: str, priority: Priority = Priority.DATA
    ) -> Publisher:
        """Declare a publisher on a key."""
        ...

    def follow_demand(self, key_expression: str, on_wanted: OnWanted) -> Closeable:
        """Learn whether anybody subscribes to a matching key, so that nothing is made for nobody.

        `on_wanted` is called in the event loop with True when the first subscriber comes, or is
        there already, and with False when the last one left.
        """
        ...

    def subscribe(self, key_expression: str, delivery: Delivery) -> Subscription[Sample]:
        """Subscribe to all keys that match."""
        ...

    def serve(self, key_expression: str, handler: Handler, *, depth: int = 64) -> Closeable:
        """Answer calls; more than `depth` unanswered ones are refused with `BusyError`."""
        ...

    async def call(
        self, key: str, payload: bytes = b"", *, encoding: str = "", timeout_s: float
    ) -> Reply:
        """Call a key and return its answer.

        Raises:
            NotConnectedError: Nobody serves `key`.
            DeadlineError: No answer within `timeout_s`.
            RemoteError: The handler over there raised an error.
        """
        ...

    def query(
        self,
        key_expression: str,
        payload: bytes = b"",
        *,
        encoding: str = "",
        timeout_s: float,
    ) -> AsyncIterator[Reply]:
        """Call everyone who serves a matching key; yield the answers that arrive in time.

        Refusals and missing answers are not yielded: ask with `call` to know about one.
        """
        ...

    def declare_presence(self, key: str) -> Closeable:
        """Be seen under `key` until closed, or until this process dies."""
        ...

    def presence(self, key_expression: str) -> Subscription[PresenceEvent]:
        """Follow who is there: first one event for each present key, then the changes."""
        ...

    def info(self) -> BusInfo:
        """Say how this bus is doing."""
        ...

    async def close(self) -> None:
        """End all declarations; harmless when repeated."""
        ...
