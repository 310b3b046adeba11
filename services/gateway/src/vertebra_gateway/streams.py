"""Streams of the backbone for many viewers: read once, encoded once, slow viewers slow nobody.

One `Feed` per key expression holds the one subscription on the bus; one form of it per way to
encode (`frame` as it is, `json`, `jpeg`) holds its viewers. Both end when their last viewer leaves,
or a while later where a feed is kept.
"""

from __future__ import annotations

import asyncio
import math
import time
from abc import ABC, abstractmethod
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, Literal

import msgspec

from vertebra.bus import Bus, Delivery, Sample
from vertebra.codec import CodecRegistry, to_json_value
from vertebra.errors import CodecError, EncodeError, NotConnectedError
from vertebra_gateway.pictures import to_jpeg

FormName = Literal["frame", "json", "jpeg"]
INTAKE_DEPTH: Final = 64
"""Samples of each key that wait while the event loop is busy with other things."""
MAX_KEYS: Final = 1024
"""Keys whose newest value and numbers are kept for one key expression, and for one viewer."""


MAX_WAITING_BYTES: Final = 64 << 20
"""Payload that waits for one viewer; a single larger item is let through."""


class Item:
    """One encoded sample, shared by all who look at it.

    Attributes:
        captured_ns: When it was true, 0 as long as nobody has decoded it.
    """

    __slots__ = ("arrived_s", "captured_ns", "encoding", "head", "key", "payload", "sent_ns")

    def __init__(
        self, key: str, encoding: str, payload: bytes, *, sent_ns: int, arrived_s: float
    ) -> None:
        self.key = key
        self.encoding = encoding
        self.payload = payload
        self.sent_ns = sent_ns
        self.arrived_s = arrived_s
        self.captured_ns = 0
        self.head = b""

    def encoded(self, encoding: str, payload: bytes, captured_ns: int) -> Item:
        """Return the same sample in another encoding."""
        item = Item(self.key, encoding, payload, sent_ns=self.sent_ns, arrived_s=self.arrived_s)
        item.captured_ns = captured_ns or self.sent_ns
        return item

    @property
    def age_s(self) -> float:
        """How long ago it was true, or sent if that is all that is known."""
        return (time.time_ns() - (self.captured_ns or self.sent_ns)) / 1e9


class Outlet:
    """What waits for one viewer: bounded, and what is let go is counted.

    Delivery `latest` keeps the newest items of each key, `queue` refuses new ones when full.

    Attributes:
        dropped: Items let go because the viewer did not take them in time.
        waiting: Items that wait.
    """

    __slots__ = (
        "_delivery", "_due_s", "_in_flight", "_loop", "_on_refusal", "_period_s", "_queue",
        "_refusal", "_slots", "_waiting_bytes", "_wake", "_window", "dropped", "waiting",
    )  # fmt: skip

    def __init__(
        self,
        wake: Callable[[], None],
        *,
        delivery: Delivery | None = None,
        max_rate_hz: float = 0.0,
        window: int = 0,
        on_refusal: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Keep items for a viewer.

        Args:
            wake: Called when `take` may give something.
            delivery: What is kept; by default the newest item of each key.
            max_rate_hz: Give at most so many items of each key in a second; 0 is no bound.
            window: Give at most so many items before `acknowledge` is called; 0 is no bound.
            on_refusal: Told why the items that come have no form for this viewer.
        """
        self.dropped = 0
        self.waiting = 0
        self._waiting_bytes = 0
        self._wake = wake
        self._delivery = delivery or Delivery.latest()
        self._period_s = 1.0 / max_rate_hz if max_rate_hz else 0.0
        self._window = window
        self._in_flight = 0
        self._on_refusal = on_refusal
        self._refusal = ""
        self._queue: deque[Item] = deque()
        self._slots: dict[str, deque[Item]] = {}
        self._due_s: dict[str, float] = {}
        self._loop = asyncio.get_running_loop()

    def offer(self, item: Item) -> None:
        """Take an item in, or let one go."""
        self._refusal = ""
        if self._delivery.policy == "latest":
            self._offer_latest(item)
        elif len(self._queue) < self._delivery.depth and self._fits(item):
            self._queue.append(item)
            self._count(item)
            self._wake()
        else:
            self.dropped += 1

    def _fits(self, item: Item) -> bool:
        return self._waiting_bytes + len(item.payload) <= MAX_WAITING_BYTES or not self.waiting

    def _count(self, item: Item, by: int = 1) -> None:
        self.waiting += by
        self._waiting_bytes += by * len(item.payload)

    def _offer_latest(self, item: Item) -> None:
        slot = self._slots.get(item.key)
        if slot is None and len(self._slots) >= MAX_KEYS:
            self.dropped += 1
            return
        now_s = self._loop.time() if self._period_s else 0.0
        due_s = self._due_s.setdefault(item.key, now_s) if self._period_s else 0.0
        if slot is None:
            slot = self._slots[item.key] = deque()
            if due_s > now_s:
                self._loop.call_at(due_s, self._wake)
        elif len(slot) >= self._delivery.depth or not self._fits(item):
            self._count(slot.popleft(), -1)
            # What the viewer's own rate limit skips is not lost.
            self.dropped += now_s >= due_s + self._period_s
        slot.append(item)
        self._count(item)
        if due_s <= now_s:
            self._wake()

    def take(self) -> Item | None:
        """Return the next item, keys in turn, or None if none is due or the window is full."""
        if self._window and self._in_flight >= self._window:
            return None
        item = self._queue.popleft() if self._queue else self._take_latest()
        if item is not None:
            self._count(item, -1)
            self._in_flight += 1
        return item

    def _take_latest(self) -> Item | None:
        now_s = self._loop.time() if self._period_s else 0.0
        for key, slot in self._slots.items():
            if self._period_s and self._due_s.get(key, 0.0) > now_s:
                continue
            item = slot.popleft()
            del self._slots[key]
            if slot:
                self._slots[key] = slot
            if self._period_s:
                self._keep_pace(key, now_s)
            return item
        return None

    def _keep_pace(self, key: str, now_s: float) -> None:
        if len(self._due_s) >= MAX_KEYS:
            self._due_s = {key: due_s for key, due_s in self._due_s.items() if due_s > now_s}
        self._due_s[key] = now_s + self._period_s
        if key in self._slots:
            self._loop.call_at(self._due_s[key], self._wake)

    def acknowledge(self) -> None:
        """Make room in the window: the viewer has dealt with an item."""
        self._in_flight = max(0, self._in_flight - 1)
        if self.waiting:
            self._wake()

    def refuse(self, reason: str) -> None:
        """Tell the viewer once why it gets nothing."""
        if reason != self._refusal:
            self._refusal = reason
            self._on_refusal(reason)


class _Form(ABC):
    """The viewers of one key expression in one form."""

    def __init__(self) -> None:
        self.outlets: set[Outlet] = set()

    @abstractmethod
    def offer(self, item: Item) -> None:
        """Take in a sample as it came from the bus."""

    @abstractmethod
    def welcome(self, outlet: Outlet, newest: Iterable[Item]) -> None:
        """Give a new viewer the newest sample of each key, as they came from the bus."""

    def close(self) -> None:  # noqa: B027  - most forms have nothing to end
        """Stop working."""

    def _give(self, item: Item) -> None:
        for outlet in self.outlets:
            outlet.offer(item)


class _Frames(_Form):
    def offer(self, item: Item) -> None:
        self._give(item)

    def welcome(self, outlet: Outlet, newest: Iterable[Item]) -> None:
        for item in newest:
            outlet.offer(item)


class _Documents(_Form):
    def __init__(self, codecs: CodecRegistry) -> None:
        super().__init__()
        self._codecs = codecs

    def offer(self, item: Item) -> None:
        self._offer(item, self.outlets)

    def welcome(self, outlet: Outlet, newest: Iterable[Item]) -> None:
        for item in newest:
            self._offer(item, {outlet})

    def _offer(self, item: Item, outlets: set[Outlet]) -> None:
        try:
            document = to_document(item, self._codecs)
        except CodecError as error:
            _refuse(outlets, item, error)
            return
        for outlet in outlets:
            outlet.offer(document)


class _Pictures(_Form):
    """One image of each key is made into a JPEG at a time; the newest waits, older ones go."""

    def __init__(
        self,
        codecs: CodecRegistry,
        tasks: asyncio.TaskGroup,
        thread: ThreadPoolExecutor,
        quality: int,
        count: Counts,
    ) -> None:
        super().__init__()
        self._codecs = codecs
        self._tasks = tasks
        self._thread = thread
        self._quality = quality
        self._count = count
        self._waiting: OrderedDict[str, Item] = OrderedDict()
        self._newest: OrderedDict[str, Item] = OrderedDict()
        self._task: asyncio.Task[None] | None = None

    def offer(self, item: Item) -> None:
        if self._waiting.pop(item.key, None) is not None:
            self._count.jpegs_skipped += 1
        self._waiting[item.key] = item
        if self._task is None:
            self._task = self._tasks.create_task(self._encode())

    def welcome(self, outlet: Outlet, newest: Iterable[Item]) -> None:
        if len(self.outlets) == 1:
            for item in newest:
                self.offer(item)
        for picture in self._newest.values():
            outlet.offer(picture)

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()

    async def _encode(self) -> None:
        loop = asyncio.get_running_loop()
        while self._waiting:
            _, item = self._waiting.popitem(last=False)
            try:
                message, header = self._codecs.decode(item.payload, item.encoding)
                payload = await loop.run_in_executor(self._thread, to_jpeg, message, self._quality)
            except CodecError as error:
                _refuse(self.outlets, item, error)
                continue
            self._count.jpegs += 1
            picture = item.encoded("image/jpeg", payload, header.captured_ns)
            self._newest[item.key] = picture
            if len(self._newest) > MAX_KEYS:
                self._newest.popitem(last=False)
            self._give(picture)
        self._task = None


def _refuse(outlets: Iterable[Outlet], item: Item, error: CodecError) -> None:
    for outlet in outlets:
        outlet.refuse(f"{item.key}: {error}")


def to_document(item: Item, codecs: CodecRegistry) -> Item:
    """Return an item as the JSON document of its message; raise `CodecError`."""
    message, header = codecs.decode(item.payload, item.encoding)
    document = item.encoded("application/json", b"", header.captured_ns)
    fields = {
        "key": item.key,
        "schema": message.schema(),
        "captured_ns": str(document.captured_ns),
        "age_s": round(document.age_s, 6),
        "message": to_json_value(message),
    }
    try:
        document.payload = msgspec.json.encode(fields)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise EncodeError(f"this {message.schema()} has no JSON: {error}") from error
    return document


class Viewer:
    """Somebody who looks at the newest items of a feed, one after the other."""

    def __init__(self) -> None:
        self.outlet = Outlet(self._wake, on_refusal=self._refused)
        self._news = asyncio.Event()
        self._refusal = ""
        self._closed = False

    async def next(self) -> Item:
        """Return the newest item that was not returned before; wait for one.

        Raises:
            EncodeError: What comes has not the form that was asked for.
            NotConnectedError: The gateway stops.
        """
        while (item := self.outlet.take()) is None:
            if self._closed:
                raise NotConnectedError("the gateway stops")
            if self._refusal:
                raise EncodeError(self._refusal)
            self._news.clear()
            await self._news.wait()
        self._refusal = ""
        return item

    def close(self) -> None:
        """Let `next` fail from now on."""
        self._closed = True
        self._news.set()

    def _wake(self) -> None:
        self._news.set()

    def _refused(self, reason: str) -> None:
        self._refusal = reason
        self._news.set()


class Counts:
    """What the streams of this gateway have done so far."""

    __slots__ = ("jpegs", "jpegs_skipped")

    def __init__(self) -> None:
        self.jpegs = 0
        self.jpegs_skipped = 0


class _KeyNumbers:
    __slots__ = ("arrived_s", "encoding", "period_s")

    def __init__(self, encoding: str, now_s: float) -> None:
        self.encoding = encoding
        self.arrived_s = now_s
        self.period_s = 0.0

    def arrived(self, encoding: str, now_s: float) -> None:
        gap_s = now_s - self.arrived_s
        self.period_s = gap_s if not self.period_s else 0.9 * self.period_s + 0.1 * gap_s
        self.arrived_s = now_s
        self.encoding = encoding


class Feed:
    """Everything that comes on one key expression.

    Attributes:
        forms: In which forms it is looked at.
        kept: Ends the time for which it goes on when nobody looks; None if it does not.
        newest: The newest sample of each key.
    """

    def __init__(self, bus: Bus, tasks: asyncio.TaskGroup, key_expression: str) -> None:
        self.forms: dict[FormName, _Form] = {}
        self.kept: asyncio.TimerHandle | None = None
        self.newest: OrderedDict[str, Item] = OrderedDict()
        self._subscription = bus.subscribe(key_expression, Delivery.latest(INTAKE_DEPTH))
        self._numbers: OrderedDict[str, _KeyNumbers] = OrderedDict()
        tasks.create_task(self._read())

    @property
    def lost(self) -> int:
        """Samples that never got as far as the viewers' outlets."""
        return self._subscription.lost + self._subscription.dropped

    def close(self) -> None:
        """End the subscription; what still waits in it goes to nobody."""
        self._subscription.close()
        if self.kept is not None:
            self.kept.cancel()
        for form in self.forms.values():
            form.close()
        self.forms.clear()

    async def _read(self) -> None:
        async for sample in self._subscription:
            self._take(sample)

    def _take(self, sample: Sample) -> None:
        now_s = time.monotonic()
        item = Item(
            sample.key,
            sample.encoding,
            sample.payload,
            sent_ns=sample.sent_ns or time.time_ns(),
            arrived_s=now_s,
        )
        numbers = self._numbers.get(sample.key)
        if numbers is None:
            self._numbers[sample.key] = _KeyNumbers(sample.encoding, now_s)
        else:
            numbers.arrived(sample.encoding, now_s)
        self.newest[sample.key] = item
        if len(self.newest) > MAX_KEYS:
            self.newest.popitem(last=False)
            self._numbers.popitem(last=False)
        for form in self.forms.values():
            form.offer(item)

    def describe(self) -> list[dict[str, Any]]:
        """Return a row for each key that has come."""
        now_s = time.monotonic()
        viewers = sum(len(form.outlets) for form in self.forms.values())
        rows = []
        for key, numbers in self._numbers.items():
            age_s = now_s - numbers.arrived_s
            period_s = max(numbers.period_s, age_s if age_s > 3 * numbers.period_s else 0.0)
            rows.append(
                {
                    "key": key,
                    "encoding": numbers.encoding,
                    "rate_hz": round(1.0 / period_s, 2) if numbers.period_s else 0.0,
                    "age_s": round(age_s, 3),
                    "lost": self.lost,
                    "viewers": viewers,
                }
            )
        return rows


class Streams:
    """All feeds that somebody looks at.

    Attributes:
        counts: What was done so far.
    """

    def __init__(
        self, bus: Bus, codecs: CodecRegistry, tasks: asyncio.TaskGroup, *, jpeg_quality: int
    ) -> None:
        self.counts = Counts()
        self._bus = bus
        self._codecs = codecs
        self._tasks = tasks
        self._jpeg_quality = jpeg_quality
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="jpeg")
        self._feeds: dict[str, Feed] = {}
        self._viewers: set[Viewer] = set()
        self._closed = False

    def attach(self, key_expression: str, form: FormName, outlet: Outlet) -> Feed:
        """Let an outlet see what is known and what comes on a key expression, until detached.

        Raises:
            NameMappingError: `key_expression` is none.
            NotConnectedError: The gateway stops.
        """
        if self._closed:
            raise NotConnectedError("the gateway stops")
        feed = self._feed(key_expression)
        viewers = feed.forms.get(form)
        if viewers is None:
            viewers = feed.forms[form] = self._form(form)
        viewers.outlets.add(outlet)
        viewers.welcome(outlet, feed.newest.values())
        return feed

    def keep(self, key: str, for_s: float) -> None:
        """Read a key for a while also when nobody looks, so that its newest value is at hand.

        Raises:
            NotConnectedError: The gateway stops.
        """
        if self._closed:
            raise NotConnectedError("the gateway stops")
        feed = self._feed(key)
        if feed.kept is not None:
            feed.kept.cancel()
        feed.kept = asyncio.get_running_loop().call_later(for_s, self._let_go, key)

    def _let_go(self, key: str) -> None:
        self._feeds[key].kept = None
        self._end_unused(key)

    def _end_unused(self, key_expression: str) -> None:
        feed = self._feeds[key_expression]
        if not feed.forms and feed.kept is None:
            del self._feeds[key_expression]
            feed.close()

    def _feed(self, key_expression: str) -> Feed:
        feed = self._feeds.get(key_expression)
        if feed is None:
            feed = self._feeds[key_expression] = Feed(self._bus, self._tasks, key_expression)
        return feed

    def _form(self, form: FormName) -> _Form:
        if form == "frame":
            return _Frames()
        if form == "json":
            return _Documents(self._codecs)
        return _Pictures(self._codecs, self._tasks, self._thread, self._jpeg_quality, self.counts)

    def detach(self, key_expression: str, form: FormName, outlet: Outlet) -> None:
        """Take an outlet off; a form and a feed without viewers end."""
        if self._closed:
            return
        feed = self._feeds[key_expression]
        viewers = feed.forms[form]
        viewers.outlets.discard(outlet)
        if not viewers.outlets:
            viewers.close()
            del feed.forms[form]
        self._end_unused(key_expression)

    @contextmanager
    def viewing(self, key_expression: str, form: FormName) -> Iterator[Viewer]:
        """Look at a key expression for the length of a block."""
        viewer = Viewer()
        self.attach(key_expression, form, viewer.outlet)
        self._viewers.add(viewer)
        try:
            yield viewer
        finally:
            self._viewers.discard(viewer)
            self.detach(key_expression, form, viewer.outlet)

    async def newest(
        self, key: str, form: FormName, *, max_age_s: float = math.inf, within_s: float
    ) -> Item:
        """Return the newest item of `key` if it arrived not longer ago, else the next one.

        Raises:
            NotConnectedError: None came within `within_s`.
            EncodeError: What comes has no such form.
        """
        with self.viewing(key, form) as viewer:
            try:
                async with asyncio.timeout(within_s):
                    while True:
                        item = await viewer.next()
                        if time.monotonic() - item.arrived_s <= max_age_s:
                            return item
            except TimeoutError as error:
                raise NotConnectedError(
                    f"nothing came on {key!r} within {within_s:g} s; is its sender running?"
                ) from error

    def describe(self) -> list[dict[str, Any]]:
        """Return the table of streams."""
        return [row for feed in self._feeds.values() for row in feed.describe()]

    def close(self) -> None:
        """Send all viewers home and end all feeds."""
        self._closed = True
        for viewer in tuple(self._viewers):
            viewer.close()
        for feed in self._feeds.values():
            feed.close()
        self._thread.shutdown(wait=False, cancel_futures=True)
