"""A DDS participant and the thread that waits for it.

The thread takes what came and hands it over to the event loop, where everything else happens. It
alone touches readers and the wait set, so that nothing is deleted while it is in use.
"""

from __future__ import annotations

import asyncio
import ctypes as ct
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, Final

from cyclonedds.core import (
    DDSException,
    DDSStatus,
    Entity,
    GuardCondition,
    InstanceState,
    Policy,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from vertebra.errors import CodecError, CodecNotFoundError, TransportError
from vertebra.ros2.dds.announced import RawTypes, dds_qos
from vertebra.ros2.definitions import Types
from vertebra.ros2.qos import Qos

log = logging.getLogger(__name__)

_BATCH: Final = 64
_MOST_WOKEN: Final = 64
_TELL_EVERY_S: Final = 10.0
_FOREVER: Final = duration(infinite=True)
_NOT_READ: Final = SampleState.NotRead | ViewState.Any | InstanceState.Any


class Input:
    """A DDS reader, what came of it, and who takes it in the event loop; `name` is for the log."""

    def __init__(
        self,
        name: str,
        reader: Any,
        depth: int,
        taken: Callable[[Any], None],
        *,
        only_valid: bool = True,
    ) -> None:
        self.reader = reader
        self._name = name
        self.condition = ReadCondition(reader, _NOT_READ)
        self._depth = depth
        self._overrun = 0
        self._refused = 0
        self._told = 0
        self._told_at_s = 0.0
        self._faulty = 0
        self._faulty_told_at_s = -_TELL_EVERY_S
        self._handing_over = False
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._taken = taken
        self._only_valid = only_valid
        self._best_effort = Policy.Reliability.BestEffort in reader.get_qos()

    @property
    def dropped(self) -> int:
        """Samples that were let go because the event loop, or the thread, was late."""
        return self._overrun + self._refused

    def take(self) -> bool:
        """Take what came, in the thread; say whether `hand_over` has to be called for it."""
        samples = self.reader.take(_BATCH, self.condition)
        if self._best_effort and len(samples) == _BATCH:  # a full reader refuses what comes
            self._refused = int(self.reader.get_sample_rejected_status().total_count)
        if self._only_valid:  # the others say that a writer went
            samples = [one for one in samples if one.sample_info.valid_data]
        self._overrun += max(len(self._waiting) + len(samples) - self._depth, 0)
        self._waiting.extend(samples)
        if not samples or self._handing_over:
            return False
        self._handing_over = True
        return True

    def hand_over(self) -> None:
        """Give what came to who takes it, in the event loop."""
        self._handing_over = False  # first of all: what comes from now on has itself handed over
        now_s = time.monotonic()
        if self.dropped > self._told and now_s > self._told_at_s + _TELL_EVERY_S:
            lost, self._told, self._told_at_s = self.dropped - self._told, self.dropped, now_s
            log.error("%d samples of %s were lost: this process was late", lost, self._name)
        for _ in range(len(self._waiting)):  # what comes meanwhile has its own turn
            sample = self._waiting.popleft()
            try:
                self._taken(sample)
            except CodecError as error:
                self._faulty += 1
                if now_s > self._faulty_told_at_s + _TELL_EVERY_S:
                    log.warning("refused %d samples of %s: %s", self._faulty, self._name, error)
                    self._faulty, self._faulty_told_at_s = 0, now_s


class WakeSet(WaitSet):
    """A wait set that says what has woken it, so that not everything has to be asked each time."""

    def attach(self, entity: Entity) -> None:
        """Let an entity wake us; harmless when repeated."""
        if self.is_attached(entity):
            return
        handle = handle_of(entity)
        result = self._waitset_attach(self._ref, handle, handle)
        if result < 0:
            raise DDSException(result, f"when attaching {entity!r}")
        self.attached.append((entity, handle))

    def woken(self) -> list[int]:
        """Wait, and return the handles of entities that have triggered; more come next time."""
        handles = (ct.c_void_p * _MOST_WOKEN)()
        count = self._waitset_wait(self._ref, handles, _MOST_WOKEN, _FOREVER)
        if count < 0:
            raise DDSException(count, "when waiting")
        return [handle for handle in handles[: min(count, _MOST_WOKEN)] if handle is not None]


class Participant:
    """A participant, its endpoints, and the thread that waits for them.

    Attributes:
        gid: Its identity, 16 bytes.
        own: Its endpoints that are part of the ROS graph.
        failed: Ends with the error that stopped the thread.
        closed: Whether it is gone; nothing can be done with its endpoints then.
    """

    def __init__(self, domain_id: int, types: Types, on_own: Callable[[], None]) -> None:
        self.own: list[Any] = []
        self._types = types
        self._raw_types = RawTypes(types)
        self._on_own = on_own
        self._loop = asyncio.get_running_loop()
        self.failed: asyncio.Future[None] = self._loop.create_future()
        self._commands: deque[Callable[[], None]] = deque()
        self._inputs: dict[int, Input] = {}
        self._matched: dict[int, tuple[Any, asyncio.Event]] = {}
        self._topics: dict[str, Any] = {}
        self._users: Counter[str] = Counter()
        self._stopping = self.closed = False
        self.entity = DomainParticipant(domain_id, qos=DdsQos(Policy.Userdata(data=b"enclave=/;")))
        self.gid = self.entity.guid.bytes
        self._waitset = WakeSet(self.entity)
        self._guard = GuardCondition(self.entity)
        self._waitset.attach(self._guard)
        self._thread = threading.Thread(target=self._run, name="ros2 dds", daemon=True)
        self._thread.start()

    def make_writer(self, topic: str, type_name: str, qos: Qos, said: str = "") -> Any:
        """Make a writer of raw samples."""
        settings = dds_qos(qos, said + self._hash(type_name))
        return DataWriter(self.entity, self._topic(topic, type_name), qos=settings)

    def make_reader(self, topic: str, type_name: str, qos: Qos, said: str = "") -> Any:
        """Make a reader of raw samples."""
        settings = dds_qos(qos, said + self._hash(type_name), reads=True)
        return DataReader(self.entity, self._topic(topic, type_name), qos=settings)

    def _topic(self, topic: str, type_name: str) -> Any:
        """Return the DDS topic. One name has one type in a participant, as long as it is used."""
        known = self._topics.get(topic)
        if known is None:
            known = Topic(self.entity, topic, self._raw_types.raw(type_name))
            self._topics[topic] = known
        if known.data_type is not self._raw_types.raw(type_name):
            raise TransportError(
                f"the DDS topic {topic!r} is in use here with another type than {type_name}; "
                "end the route or the subscription that uses it so"
            )
        self._users[topic] += 1
        return known

    def _release(self, topic: str) -> Any:
        """Count one user less; return the DDS topic if that was the last one."""
        self._users[topic] -= 1
        if self._users[topic]:
            return None
        del self._users[topic]
        return self._topics.pop(topic)

    def _hash(self, type_name: str) -> str:
        whole = type_name
        if type_name.split("/")[1] != "msg":
            whole = type_name.removesuffix("_Request").removesuffix("_Response")
        try:
            return f"typehash={self._types.hash_of(whole)};"
        except CodecNotFoundError:
            return ""

    def attach(self, one: Input) -> None:
        """Take what comes of an input from now on."""

        def attach() -> None:
            self._inputs[handle_of(one.condition)] = one
            self._waitset.attach(one.condition)

        self._in_thread(attach)

    def follow_matches(self, entity: Any) -> asyncio.Event:
        """Return what is set when a writer or reader finds, or loses, one on the other side."""
        event = asyncio.Event()
        entity.set_status_mask(_matched_status(entity))

        def attach() -> None:
            self._matched[handle_of(entity)] = (entity, event)
            self._waitset.attach(entity)

        self._in_thread(attach)
        return event

    def add_own(self, *entities: Any) -> None:
        """Let endpoints be seen as those of our node."""
        self.own += entities
        self._on_own()

    def end(self, entity: Any) -> None:
        """Delete a writer or reader, in the thread that uses it."""
        if self.closed:
            return
        if entity in self.own:
            self.own.remove(entity)
            self._on_own()
        topic = self._release(entity.topic.name)

        def end() -> None:
            if self._matched.pop(handle_of(entity), None) is not None:
                self._waitset.detach(entity)
            for one in [one for one in self._inputs.values() if one.reader is entity]:
                del self._inputs[handle_of(one.condition)]
                self._waitset.detach(one.condition)
                delete(one.condition)
            delete(entity)
            if topic is not None:
                delete(topic)

        self._in_thread(end)

    def _in_thread(self, command: Callable[[], None]) -> None:
        self._commands.append(command)
        self._guard.set(True)

    def _run(self) -> None:
        try:
            while not self._stopping:
                woken = self._waitset.woken()
                self._guard.take()
                while self._commands:
                    self._commands.popleft()()
                self._look(woken)
        except Exception as error:  # noqa: BLE001  - a thread that ends must not end silently
            failure = TransportError(f"DDS stopped: {error!r}; restart this service")
            self._tell(lambda: self._fail(failure))

    def _look(self, woken: list[int]) -> None:
        for entity, event in filter(None, map(self._matched.get, woken)):
            if entity.take_status(_matched_status(entity)):
                self._tell(event.set)
        came = [one for one in filter(None, map(self._inputs.get, woken)) if one.take()]
        if came:
            self._tell(lambda: _hand_over(came))

    def _fail(self, failure: TransportError) -> None:
        if not self.failed.done():
            self.failed.set_exception(failure)

    def _tell(self, what: Callable[[], None]) -> None:
        try:
            self._loop.call_soon_threadsafe(what)
        except RuntimeError:  # the event loop has closed: nobody is left to be told
            self._stopping = True

    async def close(self) -> None:
        """Leave the domain."""
        self._stopping = True
        self._guard.set(True)
        await asyncio.to_thread(self._thread.join)
        self.failed.cancel()
        while self._commands:
            self._commands.popleft()()
        for one in self._inputs.values():
            delete(one.condition)
            delete(one.reader)
        self.closed = True
        for entity in (*self.own, *self._topics.values(), self._waitset, self._guard):
            delete(entity)
        delete(self.entity)


def handle_of(entity: Entity) -> int:
    """Return the number by which DDS knows an entity."""
    return int(entity._ref)  # noqa: SLF001  - the library has no other way


def _hand_over(inputs: list[Input]) -> None:
    for one in inputs:
        one.hand_over()


def _matched_status(entity: Any) -> int:
    is_writer = isinstance(entity, DataWriter)
    return DDSStatus.PublicationMatched if is_writer else DDSStatus.SubscriptionMatched


def write(writer: Any, payload: bytes) -> None:
    """Write a payload; raise `TransportError` if DDS refuses it."""
    try:
        writer.write(writer.data_type(payload))
    except DDSException as error:
        raise TransportError(f"DDS refused {len(payload)} bytes: {error}") from error


def delete(entity: Entity) -> None:
    """End a DDS entity now, and not when the last reference to it goes; it may be gone."""
    entity.__del__()
