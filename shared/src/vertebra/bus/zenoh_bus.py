"""The backbone on Eclipse Zenoh.

A session is a client of the router: it comes back by itself when the router does. Zenoh's
callbacks run in its own threads and hand over to bounded buffers at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import struct
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from typing import Final

import zenoh

from vertebra.bus.calls import ERROR_ENCODING, Server, decode_failure, encode_failure
from vertebra.bus.interface import (
    PRESENCE_DELIVERY,
    BusInfo,
    Closeable,
    Handler,
    OnWanted,
    Payload,
    PresenceEvent,
    Priority,
    Reply,
    Request,
)
from vertebra.bus.links import DEFAULT_ROUTER, open_client
from vertebra.bus.sample import Delivery, Sample
from vertebra.bus.shared_memory import SharedMemory
from vertebra.bus.subscription import Subscription
from vertebra.errors import DeadlineError, NotConnectedError, RemoteError
from vertebra.keys import check_key, check_key_expression

log = logging.getLogger(__name__)

_ATTACHMENT: Final = struct.Struct("<8sQq")  # publisher, its sequence number, sent_ns

_PRIORITIES: Final = {
    Priority.CONTROL: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.BULK: zenoh.Priority.DATA_LOW,
}


class _Publisher:
    def __init__(self, bus: ZenohBus, publisher: zenoh.Publisher, key: str) -> None:
        self.key = key
        self._bus = bus
        self._publisher = publisher
        self._identity = bus.next_publisher_identity()
        self._sequence = 0

    def put(self, payload: Payload, *, encoding: str | None = None) -> None:
        self._bus.check_open()
        attachment = _ATTACHMENT.pack(self._identity, self._sequence, time.time_ns())
        self._sequence += 1
        if isinstance(payload, bytes):
            body = self._bus.shared_memory.hold((payload,), len(payload)) or payload
        else:
            body = self._bus.shared_memory.hold(payload.parts(), payload.nbytes) or b"".join(
                payload.parts()
            )
        self._publisher.put(body, encoding=encoding, attachment=attachment)

    def close(self) -> None:
        if self._bus.forget(self):
            self._publisher.undeclare()


class _Declared:
    """Anything that Zenoh can undeclare, with what else has to end."""

    def __init__(self, bus: ZenohBus, undeclare: Callable[[], None]) -> None:
        self._bus = bus
        self._undeclare = undeclare

    def close(self) -> None:
        if self._bus.forget(self):
            self._undeclare()


class ZenohBus:
    """A `Bus` on a Zenoh session. Make one with `await ZenohBus.open(...)`."""

    def __init__(self, session: zenoh.Session, shared_memory: SharedMemory) -> None:
        self.shared_memory = shared_memory
        self._session = session
        shared_memory.join(session)
        self._declared: set[Closeable] = set()
        self._publishers = 0
        self._closed = False

    @classmethod
    async def open(
        cls,
        router: str = DEFAULT_ROUTER,
        *,
        shared_memory: bool = True,
        timeout_s: float | None = None,
    ) -> ZenohBus:
        """Join the backbone through the router at a Zenoh locator.

        Waits for a router that is not there yet, for ever if `timeout_s` is None, and says so in
        the log.

        Raises:
            ConfigError: `router` is no locator such as `tcp/127.0.0.1:7447`.
            DeadlineError: No router answered within `timeout_s`.
        """
        pool = await asyncio.to_thread(SharedMemory, enabled=shared_memory)
        log.info("shared memory for large payloads is %s", pool.description)
        settings = {"transport/shared_memory/enabled": pool.available}
        return cls(await open_client(router, settings, timeout_s=timeout_s), pool)

    def check_open(self) -> None:
        """Raise `NotConnectedError` once closed."""
        if self._closed:
            raise NotConnectedError("this bus is closed")

    def forget(self, declaration: Closeable) -> bool:
        """Take a declaration off the list; say whether it was still there."""
        known = declaration in self._declared
        self._declared.discard(declaration)
        return known

    def next_publisher_identity(self) -> bytes:
        """Return 8 bytes that no other publisher of the network has."""
        self._publishers += 1
        session = bytes.fromhex(str(self._session.info.zid()).zfill(32))[-5:]
        return session + self._publishers.to_bytes(3, "little")

    def publisher(
        self,
        key: str,
        *,
        encoding: str,
        priority: Priority = Priority.DATA,
    ) -> _Publisher:
        """See `Bus.publisher`."""
        self.check_open()
        declared = self._session.declare_publisher(
            check_key(key),
            encoding=encoding,
            priority=_PRIORITIES[priority],
            congestion_control=zenoh.CongestionControl.DROP,
            # Express samples are batches of their own, of which a busy link holds 16: streams of
            # 1 kHz would lose some whenever a process is not scheduled for that many milliseconds.
            express=priority is Priority.CONTROL,
        )
        publisher = _Publisher(self, declared, key)
        self._declared.add(publisher)
        return publisher

    def follow_demand(self, key_expression: str, on_wanted: OnWanted) -> Closeable:
        """See `Bus.follow_demand`."""
        self.check_open()
        publisher = self._session.declare_publisher(check_key_expression(key_expression))
        loop = asyncio.get_running_loop()
        wanted = False

        def tell(now: bool) -> None:  # noqa: FBT001  - called back
            nonlocal wanted
            if now != wanted and demand in self._declared:
                wanted = now
                on_wanted(now)

        def changed(status: zenoh.MatchingStatus) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to be told
                loop.call_soon_threadsafe(tell, status.matching)

        listener = publisher.declare_matching_listener(changed)
        # The stub says bool; version 1.10.2 returns a MatchingStatus.
        loop.call_soon(lambda: tell(publisher.matching_status.matching))  # type: ignore[attr-defined]

        def end() -> None:
            listener.undeclare()
            publisher.undeclare()

        demand = _Declared(self, end)
        self._declared.add(demand)
        return demand

    def subscribe(self, key_expression: str, delivery: Delivery) -> Subscription[Sample]:
        """See `Bus.subscribe`."""
        self.check_open()
        subscription: Subscription[Sample] = Subscription(
            check_key_expression(key_expression),
            delivery,
            key_of=lambda sample: sample.key,
            on_close=lambda: declared.undeclare() if self.forget(subscription) else None,
        )
        offer = subscription.offer
        only_key = None if "*" in key_expression else key_expression

        def arrived(sample: zenoh.Sample) -> None:
            publisher, sequence, sent_ns = _read_attachment(sample.attachment)
            offer(
                Sample(
                    key=only_key or str(sample.key_expr),
                    payload=sample.payload.to_bytes(),
                    encoding=_read_encoding(sample.encoding),
                    sent_ns=sent_ns,
                ),
                publisher,
                sequence,
            )

        declared = self._session.declare_subscriber(key_expression, arrived)
        self._declared.add(subscription)
        return subscription

    def serve(self, key_expression: str, handler: Handler, *, depth: int = 64) -> Closeable:
        """See `Bus.serve`."""
        self.check_open()
        server = Server(check_key_expression(key_expression), handler, depth)

        def arrived(query: zenoh.Query) -> None:
            asked = str(query.key_expr)
            key = key_expression if "*" in asked and "*" not in key_expression else asked

            def respond(answer: Reply | BaseException) -> None:
                # The session may be gone by the time of an answer; then nobody waits for it.
                with contextlib.suppress(zenoh.ZError), query:
                    if isinstance(answer, Reply):
                        query.reply(key, answer.payload, encoding=answer.encoding)
                    else:
                        query.reply_err(encode_failure(answer), encoding=ERROR_ENCODING)

            server.accept(
                Request(
                    key=key,
                    payload=query.payload.to_bytes() if query.payload is not None else b"",
                    encoding=_read_encoding(query.encoding),
                    timeout_s=_read_timeout(query.attachment),
                ),
                respond,
            )

        declared = self._session.declare_queryable(key_expression, arrived, complete=True)

        def end() -> None:
            declared.undeclare()
            server.close()

        served = _Declared(self, end)
        self._declared.add(served)
        return served

    async def call(
        self, key: str, payload: bytes = b"", *, encoding: str = "", timeout_s: float
    ) -> Reply:
        """See `Bus.call`."""
        check_key(key)
        deadline_s = time.monotonic() + timeout_s
        async with contextlib.aclosing(self._ask(key, payload, encoding, timeout_s)) as outcomes:
            outcome = await anext(outcomes, None)
        if isinstance(outcome, Reply):
            return outcome
        late = time.monotonic() >= deadline_s
        if outcome is not None and not (late and outcome.kind == "UnknownError"):
            raise outcome  # an error of unknown kind at the deadline is Zenoh's own "Timeout"
        if late:
            raise DeadlineError(key, timeout_s)
        raise NotConnectedError(f"nobody serves {key!r}")

    async def query(
        self,
        key_expression: str,
        payload: bytes = b"",
        *,
        encoding: str = "",
        timeout_s: float,
    ) -> AsyncIterator[Reply]:
        """See `Bus.query`."""
        check_key_expression(key_expression)
        async with contextlib.aclosing(
            self._ask(key_expression, payload, encoding, timeout_s)
        ) as outcomes:
            async for outcome in outcomes:
                if isinstance(outcome, Reply):
                    yield outcome

    async def _ask(
        self, target: str, payload: bytes, encoding: str, timeout_s: float
    ) -> AsyncGenerator[Reply | RemoteError, None]:
        self.check_open()
        loop = asyncio.get_running_loop()
        # Bounded by the number of servers, each of which answers a query once.
        outcomes: asyncio.Queue[Reply | RemoteError | None] = asyncio.Queue()

        def hand_over(outcome: Reply | RemoteError | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits
                loop.call_soon_threadsafe(outcomes.put_nowait, outcome)

        def arrived(reply: zenoh.Reply) -> None:
            if (ok := reply.ok) is not None:
                hand_over(
                    Reply(
                        payload=ok.payload.to_bytes(),
                        encoding=_read_encoding(ok.encoding),
                        key=str(ok.key_expr),
                    )
                )
            elif (err := reply.err) is not None:
                hand_over(decode_failure(err.payload.to_bytes()))

        self._session.get(
            target,
            zenoh.handlers.Callback(arrived, lambda: hand_over(None)),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            payload=payload,
            encoding=encoding or None,
            attachment=struct.pack("<d", timeout_s),
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )
        try:
            async with asyncio.timeout(timeout_s + 0.5):  # Zenoh keeps the deadline; we see to it
                while (outcome := await outcomes.get()) is not None:
                    yield outcome
        except TimeoutError:
            return

    def declare_presence(self, key: str) -> Closeable:
        """See `Bus.declare_presence`."""
        self.check_open()
        token = self._session.liveliness().declare_token(check_key(key))
        presence = _Declared(self, token.undeclare)
        self._declared.add(presence)
        return presence

    def presence(self, key_expression: str) -> Subscription[PresenceEvent]:
        """See `Bus.presence`."""
        self.check_open()
        watcher: Subscription[PresenceEvent] = Subscription(
            check_key_expression(key_expression),
            PRESENCE_DELIVERY,
            key_of=lambda event: event.key,
            on_close=lambda: declared.undeclare() if self.forget(watcher) else None,
        )

        def arrived(sample: zenoh.Sample) -> None:
            present = sample.kind == zenoh.SampleKind.PUT
            watcher.offer(PresenceEvent(str(sample.key_expr), present))

        declared = self._session.liveliness().declare_subscriber(
            key_expression, arrived, history=True
        )
        self._declared.add(watcher)
        return watcher

    def info(self) -> BusInfo:
        """See `Bus.info`."""
        return BusInfo(
            identity=str(self._session.info.zid()),
            connected=not self._closed and bool(self._session.info.routers_zid()),
            shared_memory=self.shared_memory.description,
            shared_memory_misses=self.shared_memory.misses,
        )

    async def close(self) -> None:
        """See `Bus.close`."""
        if self._closed:
            return
        for declaration in tuple(self._declared):
            declaration.close()
        self._closed = True
        await asyncio.to_thread(self._session.close)


def _read_encoding(encoding: zenoh.Encoding | None) -> str:
    return "" if encoding is None or encoding == zenoh.Encoding.ZENOH_BYTES else str(encoding)


def _read_attachment(attachment: zenoh.ZBytes | None) -> tuple[bytes, int, int]:
    raw = b"" if attachment is None else attachment.to_bytes()
    return _ATTACHMENT.unpack(raw) if len(raw) == _ATTACHMENT.size else (b"", -1, 0)


def _read_timeout(attachment: zenoh.ZBytes | None) -> float:
    raw = b"" if attachment is None else attachment.to_bytes()
    timeout_s = float(struct.unpack("<d", raw)[0]) if len(raw) == 8 else 10.0
    return timeout_s if 0.0 < timeout_s < 3600.0 else 10.0
