"""The backbone inside one process: for tests, and for programs without a network.

It behaves as `ZenohBus` does but does not imitate: links that are slow or break, priorities, the
copy that a payload makes on its way, shared memory, and routers.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import AsyncIterator
from functools import partial
from typing import TypeVar

from vertebra.bus.calls import Respond, Server, decode_failure, encode_failure
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
from vertebra.bus.sample import Delivery, Sample
from vertebra.bus.subscription import Subscription
from vertebra.errors import DeadlineError, NotConnectedError
from vertebra.keys import check_key, check_key_expression, intersects

T = TypeVar("T")


class MemoryNetwork:
    """What several `MemoryBus` share; a new one is a network of its own."""

    def __init__(self) -> None:
        self.subscriptions: set[Subscription[Sample]] = set()
        self.watchers: set[Subscription[PresenceEvent]] = set()
        self.servers: dict[_Served, Server] = {}
        self.present: list[str] = []
        self.demands: set[_Demand] = set()

    def tell_demand(self) -> None:
        """Tell those who follow a demand that has begun or ended."""
        for demand in tuple(self.demands):
            demand.look()


class _Served:
    def __init__(self, bus: MemoryBus, key_expression: str) -> None:
        self.bus = bus
        self.key_expression = key_expression

    def close(self) -> None:
        server = self.bus.network.servers.pop(self, None)
        if server is not None:
            server.close()
        self.bus.declared.discard(self)


class _Token:
    def __init__(self, bus: MemoryBus, key: str) -> None:
        self.bus = bus
        self.key = key
        self._announce(present=True)

    def close(self) -> None:
        if self in self.bus.declared:
            self.bus.declared.discard(self)
            self._announce(present=False)

    def _announce(self, *, present: bool) -> None:
        network = self.bus.network
        if present:
            network.present.append(self.key)
            changed = network.present.count(self.key) == 1
        else:
            network.present.remove(self.key)
            changed = self.key not in network.present
        if changed:
            for watcher in tuple(network.watchers):
                if intersects(watcher.key_expression, self.key):
                    watcher.offer(PresenceEvent(self.key, present))


class _Publisher:
    def __init__(self, bus: MemoryBus, key: str, encoding: str) -> None:
        self.key = key
        self._bus = bus
        self._encoding = encoding
        self._identity = uuid.uuid4().bytes[:8]
        self._sequence = 0

    def put(self, payload: Payload, *, encoding: str | None = None) -> None:
        self._bus.check_open()
        sample = Sample(
            key=self.key,
            payload=bytes(payload) if isinstance(payload, bytes) else b"".join(payload.parts()),
            encoding=self._encoding if encoding is None else encoding,
            sent_ns=time.time_ns(),
        )
        for subscription in tuple(self._bus.network.subscriptions):
            if intersects(subscription.key_expression, self.key):
                subscription.offer(sample, self._identity, self._sequence)
        self._sequence += 1

    def close(self) -> None:
        self._bus.declared.discard(self)


class _Demand:
    def __init__(self, bus: MemoryBus, key_expression: str, on_wanted: OnWanted) -> None:
        self._bus = bus
        self._key_expression = key_expression
        self._on_wanted = on_wanted
        self._wanted = False
        self._loop = asyncio.get_running_loop()

    def look(self) -> None:
        wanted = any(
            intersects(subscription.key_expression, self._key_expression)
            for subscription in self._bus.network.subscriptions
        )
        if wanted != self._wanted:
            self._wanted = wanted
            self._loop.call_soon(self._on_wanted, wanted)

    def close(self) -> None:
        self._bus.network.demands.discard(self)
        self._bus.declared.discard(self)


class MemoryBus:
    """A `Bus` on a `MemoryNetwork`."""

    def __init__(self, network: MemoryNetwork | None = None) -> None:
        self.network = network or MemoryNetwork()
        self.declared: set[Closeable] = set()
        self._identity = uuid.uuid4().hex
        self._closed = False

    def check_open(self) -> None:
        """Raise `NotConnectedError` once closed."""
        if self._closed:
            raise NotConnectedError("this bus is closed")

    def publisher(
        self,
        key: str,
        *,
        encoding: str,
        priority: Priority = Priority.DATA,  # noqa: ARG002  - nothing is ever busy here
    ) -> _Publisher:
        """See `Bus.publisher`."""
        self.check_open()
        publisher = _Publisher(self, check_key(key), encoding)
        self.declared.add(publisher)
        return publisher

    def follow_demand(self, key_expression: str, on_wanted: OnWanted) -> Closeable:
        """See `Bus.follow_demand`."""
        self.check_open()
        demand = _Demand(self, check_key_expression(key_expression), on_wanted)
        self.network.demands.add(demand)
        self.declared.add(demand)
        demand.look()
        return demand

    def subscribe(self, key_expression: str, delivery: Delivery) -> Subscription[Sample]:
        """See `Bus.subscribe`."""
        self.check_open()
        subscription: Subscription[Sample] = Subscription(
            check_key_expression(key_expression),
            delivery,
            key_of=lambda sample: sample.key,
            on_close=lambda: self._unsubscribe(subscription),
        )
        self.network.subscriptions.add(subscription)
        self.declared.add(subscription)
        self.network.tell_demand()
        return subscription

    def _unsubscribe(self, subscription: Subscription[Sample]) -> None:
        self._forget(self.network.subscriptions, subscription)
        self.network.tell_demand()

    def _forget(self, group: set[Subscription[T]], subscription: Subscription[T]) -> None:
        group.discard(subscription)
        self.declared.discard(subscription)

    def serve(self, key_expression: str, handler: Handler, *, depth: int = 64) -> Closeable:
        """See `Bus.serve`."""
        self.check_open()
        served = _Served(self, check_key_expression(key_expression))
        self.network.servers[served] = Server(key_expression, handler, depth)
        self.declared.add(served)
        return served

    async def call(
        self, key: str, payload: bytes = b"", *, encoding: str = "", timeout_s: float
    ) -> Reply:
        """See `Bus.call`."""
        check_key(key)
        answers = self._ask(key, payload, encoding, timeout_s)
        if not answers:
            raise NotConnectedError(f"nobody serves {key!r}")
        done, waiting = await asyncio.wait(
            answers, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED
        )
        for answer in waiting:
            answer.cancel()
        if not done:
            raise DeadlineError(key, timeout_s)
        return _unwrap(done.pop().result())

    async def query(
        self,
        key_expression: str,
        payload: bytes = b"",
        *,
        encoding: str = "",
        timeout_s: float,
    ) -> AsyncIterator[Reply]:
        """See `Bus.query`."""
        answers = self._ask(check_key_expression(key_expression), payload, encoding, timeout_s)
        try:
            for next_answer in asyncio.as_completed(answers, timeout=timeout_s):
                answer = await next_answer
                if isinstance(answer, Reply):
                    yield answer
        except TimeoutError:
            return  # documented: missing answers are not yielded
        finally:
            for future in answers:
                future.cancel()

    def _ask(
        self, target: str, payload: bytes, encoding: str, timeout_s: float
    ) -> list[asyncio.Future[Reply | BaseException]]:
        self.check_open()
        loop = asyncio.get_running_loop()
        answers = []
        for served, server in tuple(self.network.servers.items()):
            if intersects(served.key_expression, target):
                # A wildcard query reaches a server under the server's own key.
                key = target if "*" not in target else served.key_expression
                answer: asyncio.Future[Reply | BaseException] = loop.create_future()
                respond: Respond = partial(_resolve, answer, key)
                request = Request(key=key, payload=payload, encoding=encoding, timeout_s=timeout_s)
                server.accept(request, respond)
                answers.append(answer)
        return answers

    def declare_presence(self, key: str) -> Closeable:
        """See `Bus.declare_presence`."""
        self.check_open()
        token = _Token(self, check_key(key))
        self.declared.add(token)
        return token

    def presence(self, key_expression: str) -> Subscription[PresenceEvent]:
        """See `Bus.presence`."""
        self.check_open()
        watcher: Subscription[PresenceEvent] = Subscription(
            check_key_expression(key_expression),
            PRESENCE_DELIVERY,
            key_of=lambda event: event.key,
            on_close=lambda: self._forget(self.network.watchers, watcher),
        )
        for key in dict.fromkeys(self.network.present):
            if intersects(key_expression, key):
                watcher.offer(PresenceEvent(key, present=True))
        self.network.watchers.add(watcher)
        self.declared.add(watcher)
        return watcher

    def info(self) -> BusInfo:
        """See `Bus.info`."""
        return BusInfo(
            identity=self._identity,
            connected=not self._closed,
            shared_memory="not needed: everything is in one process",
        )

    async def close(self) -> None:
        """See `Bus.close`."""
        self._closed = True
        for declaration in tuple(self.declared):
            declaration.close()


def _resolve(
    answer: asyncio.Future[Reply | BaseException], key: str, outcome: Reply | BaseException
) -> None:
    if answer.done():
        return
    if isinstance(outcome, Reply):
        answer.set_result(Reply(payload=outcome.payload, encoding=outcome.encoding, key=key))
    else:
        answer.set_result(decode_failure(encode_failure(outcome)))


def _unwrap(outcome: Reply | BaseException) -> Reply:
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome
