"""Subscriptions: bounded buffers between Zenoh's threads and one event loop."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Final, Generic, Self, TypeVar

from vertebra.bus.sample import Delivery

log = logging.getLogger(__name__)

MAX_KEYS: Final = 16384
"""A `latest` subscription keeps samples of at most this many keys."""
_LOG_EVERY_S: Final = 10.0

T = TypeVar("T")


class Subscription(Generic[T]):
    """Samples of a key expression, as an asynchronous iterator; ends after `close()`.

    A slow consumer slows nobody and grows nothing: what does not fit is let go by the delivery's
    policy and counted.

    Attributes:
        received: Samples that arrived.
        dropped: Samples that arrived and were let go here because the consumer was busy.
        lost: Samples that were published and never arrived, by gaps in the publishers' counting.
    """

    def __init__(
        self,
        key_expression: str,
        delivery: Delivery,
        *,
        key_of: Callable[[T], str],
        on_close: Callable[[], None] = lambda: None,
    ) -> None:
        self.key_expression = key_expression
        self.received = 0
        self.dropped = 0
        self.lost = 0
        self._delivery = delivery
        self._key_of = key_of
        self._on_close = on_close
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()
        self._queue: deque[T] = deque()
        self._by_key: OrderedDict[str, deque[T]] = OrderedDict()
        self._next_sequence: OrderedDict[bytes, int] = OrderedDict()
        self._changed = asyncio.Event()
        self._wake_pending = False
        self._closed = False
        self._logged_at_s = -_LOG_EVERY_S
        self._unlogged = 0

    def offer(self, item: T, publisher: bytes = b"", sequence: int = -1) -> None:
        """Take an item in; called from any thread, never waits.

        Args:
            item: What arrived.
            publisher: Identity of its publisher, empty if unknown.
            sequence: Its number among that publisher's items.
        """
        with self._lock:
            if self._closed:
                return
            self.received += 1
            if publisher:
                self._count_gap(publisher, sequence)
            if self._delivery.policy == "queue":
                if len(self._queue) >= self._delivery.depth:
                    self.dropped += 1
                    self._report(1)
                else:
                    self._queue.append(item)
            else:
                self._keep_newest(item)
            wake = not self._wake_pending
            self._wake_pending = True
        if wake:
            self._call_loop()

    def _keep_newest(self, item: T) -> None:
        key = self._key_of(item)
        kept = self._by_key.get(key)
        if kept is None:
            if len(self._by_key) >= MAX_KEYS:
                self.dropped += 1
                self._report(1)
                return
            kept = self._by_key[key] = deque()
        elif len(kept) >= self._delivery.depth:
            kept.popleft()
            self.dropped += 1
        kept.append(item)

    def _count_gap(self, publisher: bytes, sequence: int) -> None:
        expected = self._next_sequence.get(publisher)
        if expected is not None and sequence > expected:
            self.lost += sequence - expected
            self._report(sequence - expected)
        if expected is None and len(self._next_sequence) >= MAX_KEYS:
            self._next_sequence.popitem(last=False)
        self._next_sequence[publisher] = sequence + 1

    def _report(self, count: int) -> None:
        self._unlogged += count
        now_s = time.monotonic()
        if now_s - self._logged_at_s >= _LOG_EVERY_S:
            log.error(
                "lost %d samples of %s (so far: %d refused because the consumer is slow, "
                "%d lost on the way)",
                self._unlogged,
                self.key_expression,
                self.dropped,
                self.lost,
            )
            self._logged_at_s = now_s
            self._unlogged = 0

    def _call_loop(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._wake)
        except RuntimeError:  # the loop is closed: nobody is left to be woken
            with self._lock:
                self._closed = True

    def _wake(self) -> None:
        with self._lock:
            self._wake_pending = False
        self._changed.set()

    def take(self) -> T | None:
        """Return the next item if one is waiting; a `latest` subscription serves keys in turn."""
        with self._lock:
            if self._queue:
                return self._queue.popleft()
            if not self._by_key:
                return None
            key, kept = self._by_key.popitem(last=False)
            item = kept.popleft()
            if kept:
                self._by_key[key] = kept
            return item

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        while True:
            item = self.take()
            if item is not None:
                return item
            if self._closed:
                raise StopAsyncIteration
            self._changed.clear()
            if self._queue or self._by_key or self._closed:
                continue
            await self._changed.wait()

    def close(self) -> None:
        """End the iteration after what is waiting; harmless when repeated."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._changed.set()
        self._on_close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()
