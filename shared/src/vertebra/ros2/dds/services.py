"""ROS services on DDS, both sides, as rmw_cyclonedds has them.

A service is two topics. In front of each request, and of its reply, are 8 bytes that name the
client and 8 that number the request; every reply reaches every client. Who puts them there says
so in the USER_DATA of its endpoints. Fast DDS does not: its requests are refused, and none are sent
to its servers, for each side would take the other's first fields for those 16 bytes.
"""

from __future__ import annotations

import asyncio
import logging
import random
import struct
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from vertebra.errors import DeadlineError, DecodeError, NotConnectedError, VertebraError
from vertebra.ros2.cdr import HEADER, HEADER_BYTES
from vertebra.ros2.dds.announced import Raw, user_data_of
from vertebra.ros2.dds.participant import Input, Participant, write
from vertebra.ros2.driver import OnRequest
from vertebra.ros2.graph import OTHER_MIDDLEWARE, entries_of
from vertebra.ros2.names import dds_name
from vertebra.ros2.qos import Qos

log = logging.getLogger(__name__)

MATCH_WITHIN_S: Final = 2.0
"""So long a client waits for a server that is not there yet."""
HOLD_REPLY_S: Final = 0.1
"""So long a server holds a reply for a client whose reader is not matched yet, as rmw does."""
MAX_REQUESTS: Final = 64
"""So many requests may wait for our answer."""
MAX_CALLS: Final = 8
"""So many calls of a client are under way at once: a ROS node keeps 10 requests, no more."""
_CALLER: Final = struct.Struct("<Qq")


class _Pair:
    """A writer and a reader of one service that belong together, as both say."""

    def __init__(
        self,
        dds: Participant,
        name: str,
        type_name: str,
        *,
        serves: bool,
        came: Callable[[Raw], None],
    ) -> None:
        number = random.getrandbits(32).to_bytes(4, "big")
        identity = ".".join(f"{byte:x}" for byte in dds.gid[:12] + number)
        said = f"{'serviceid' if serves else 'clientid'}={identity};"
        request = (dds_name("request", name), f"{type_name}_Request")
        reply = (dds_name("reply", name), f"{type_name}_Response")
        written, read = (reply, request) if serves else (request, reply)
        self.writer = dds.make_writer(*written, Qos(depth=MAX_REQUESTS), said)
        self.reader = dds.make_reader(*read, Qos(depth=MAX_REQUESTS), said)
        self.writer_matched = dds.follow_matches(self.writer)
        self.reader_matched = dds.follow_matches(self.reader)
        self.who_reads = lru_cache(MAX_REQUESTS)(self._who_reads)
        self.who_writes = lru_cache(MAX_REQUESTS)(self._who_writes)
        self._ended = False
        self._dds = dds
        dds.attach(Input(read[0], self.reader, MAX_REQUESTS, came))
        dds.add_own(self.writer, self.reader)

    @property
    def closed(self) -> bool:
        """Whether this, or the participant, has been closed."""
        return self._ended or self._dds.closed

    @property
    def readers(self) -> list[int]:
        """Who reads what we write."""
        return [] if self.closed else self.writer.get_matched_subscriptions()

    @property
    def writers(self) -> list[int]:
        """Who writes what we read."""
        return [] if self.closed else self.reader.get_matched_publications()

    def _who_reads(self, handle: int) -> str | None:
        """Return the identity of a reader: empty if it tells none, None if it has gone."""
        return _identity(self.writer.get_matched_subscription_data(handle))

    def _who_writes(self, handle: int) -> str | None:
        """Return the identity of a writer: empty if it tells none, None if it has gone."""
        return _identity(self.reader.get_matched_publication_data(handle))

    async def change(self) -> None:
        """Wait until one of both finds or loses somebody."""
        events = (self.writer_matched, self.reader_matched)
        waiting = [asyncio.ensure_future(event.wait()) for event in events]
        try:
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for event, task in zip(events, waiting, strict=True):
                event.clear()
                task.cancel()

    def close(self) -> None:
        if not self._ended:
            self._ended = True
            self._dds.end(self.writer)
            self._dds.end(self.reader)
            self.writer_matched.set()  # who waits for a change learns that none will come


class ServiceClient:
    """See `driver.Client`."""

    def __init__(self, dds: Participant, name: str, type_name: str) -> None:
        self._name = name
        self._caller = random.getrandbits(64)
        self._calls = 0
        self._waiting: dict[int, asyncio.Future[bytes]] = {}
        self._turn = asyncio.Semaphore(MAX_CALLS)
        self._pair = _Pair(dds, name, type_name, serves=False, came=self._came)

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """Send a request and return the reply."""
        began_s = time.monotonic()
        await self._find_server(min(MATCH_WITHIN_S, timeout_s))
        try:
            async with asyncio.timeout(began_s + timeout_s - time.monotonic()), self._turn:
                return await self._ask(payload)
        except TimeoutError as error:
            raise DeadlineError(f"the ROS service {self._name}", timeout_s) from error

    async def _ask(self, payload: bytes) -> bytes:
        if self._pair.closed:
            raise self._closed_error()
        self._calls += 1
        number = self._calls
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        try:
            write(self._pair.writer, _with_caller(payload, self._caller, number))
            return await answer
        finally:
            del self._waiting[number]

    async def _find_server(self, timeout_s: float) -> None:
        """Wait until both directions are there: a reply would be lost else."""
        try:
            async with asyncio.timeout(timeout_s):
                while not self._is_matched():
                    await self._pair.change()
        except TimeoutError as error:
            raise NotConnectedError(
                f"nobody offers the ROS service {self._name}; start its node, and look whether "
                "'vertebra ros2 services' lists it"
            ) from error

    def _is_matched(self) -> bool:
        if self._pair.closed:
            raise self._closed_error()
        servers = self._pair.readers
        if any(self._pair.who_reads(server) == "" for server in servers):
            raise NotConnectedError(f"the ROS service {self._name}: {OTHER_MIDDLEWARE}")
        return bool(servers and self._pair.writers)

    def _closed_error(self) -> NotConnectedError:
        return NotConnectedError(f"the client of {self._name} is closed")

    def _came(self, sample: Raw) -> None:
        caller, number, payload = _without_caller(sample.payload)
        answer = self._waiting.get(number)
        if caller == self._caller and answer is not None and not answer.done():
            answer.set_result(payload)

    def close(self) -> None:
        """End it; calls that wait fail."""
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(self._closed_error())
        self._pair.close()


class ServiceServer:
    """Offers a service; each request is a task of its own."""

    def __init__(self, dds: Participant, name: str, type_name: str, on_request: OnRequest) -> None:
        self._name = name
        self._on_request = on_request
        self._tasks: set[asyncio.Task[None]] = set()
        self._accepts = lru_cache(MAX_REQUESTS)(self._look_who_asks)
        self._pair = _Pair(dds, name, type_name, serves=True, came=self._came)

    def _look_who_asks(self, client: int) -> bool:
        """Say whether the requests of a client are taken, and tell once if they are not."""
        identity = self._pair.who_writes(client)
        if identity == "":
            log.error("%s: a client is not answered: %s", self._name, OTHER_MIDDLEWARE)
        return bool(identity)

    def _came(self, sample: Raw) -> None:
        if self._pair.closed or not self._accepts(sample.sample_info.publication_handle):
            return
        caller, number, payload = _without_caller(sample.payload)
        if len(self._tasks) >= MAX_REQUESTS:
            log.error("%s: a request is lost: %d are open already", self._name, MAX_REQUESTS)
            return
        task = asyncio.get_running_loop().create_task(self._answer(caller, number, payload))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, caller: int, number: int, payload: bytes) -> None:
        try:
            reply = await self._on_request(payload)
            if reply is None:
                return
            await self._find_clients()
            if not self._pair.closed:
                write(self._pair.writer, _with_caller(reply, caller, number))
        except VertebraError as error:
            log.error("%s: a request gets no answer: %s", self._name, error)  # noqa: TRY400

    async def _find_clients(self) -> None:
        """Hold a reply until as many read replies as write requests, but not for long."""
        try:
            async with asyncio.timeout(HOLD_REPLY_S):
                while len(self._pair.readers) < len(self._pair.writers):
                    await self._pair.change()
        except TimeoutError:
            log.debug("%s: somebody asks who does not read replies", self._name)

    def close(self) -> None:
        """End it, and what is being answered."""
        for task in self._tasks:
            task.cancel()
        self._pair.close()


def _identity(endpoint: Any) -> str | None:
    if endpoint is None:
        return None
    entries = entries_of(user_data_of(endpoint.qos))
    return entries.get("serviceid") or entries.get("clientid", "")


def _with_caller(payload: bytes, caller: int, number: int) -> bytes:
    return b"".join((HEADER, _CALLER.pack(caller, number), memoryview(payload)[HEADER_BYTES:]))


def _without_caller(payload: bytes) -> tuple[int, int, bytes]:
    """Return who asked, the number of the request, and the payload without both."""
    if payload[:2] != HEADER[:2] or len(payload) < HEADER_BYTES + _CALLER.size:
        raise DecodeError(f"{len(payload)} bytes on a ROS service do not say who asked")
    caller, number = _CALLER.unpack_from(payload, HEADER_BYTES)
    fields = memoryview(payload)[HEADER_BYTES + _CALLER.size :]
    return caller, number, b"".join((HEADER, fields))
