"""Topics as `rmw_zenoh_cpp` has them; latched ones keep and fetch samples by zenoh-ext."""

from __future__ import annotations

import time
from typing import Any, Final, NamedTuple

import zenoh
from zenoh import ext

from vertebra.bus import Delivery, Subscription
from vertebra.errors import DecodeError, NotConnectedError
from vertebra.ros2.driver import OnPayload
from vertebra.ros2.qos import Qos
from vertebra.ros2.rmw_zenoh import wire
from vertebra.ros2.rmw_zenoh.session import Session, refusals
from vertebra.ros2.rmw_zenoh.wire import ANY_HASH, Attachment

_HEARTBEAT_S: Final = 0.5
_MAX_WRITERS: Final = 1024


class _Message(NamedTuple):
    payload: bytes
    sent_ns: int
    writer: bytes


class TopicReader:
    """See `driver.Reader`. It hears every definition of its type, also what tells no hash."""

    mismatch = ""  # Zenoh keeps nobody apart for a QoS

    def __init__(
        self, session: Session, name: str, type_name: str, qos: Qos, on_payload: OnPayload
    ) -> None:
        self._messages: Subscription[_Message | DecodeError] = Subscription(
            wire.key_of(session.domain_id, name, type_name, ANY_HASH),
            Delivery.latest(qos.depth),
            key_of=lambda _: "",
        )
        self._session = session
        self._on_payload = on_payload
        self._closed = False
        subscriber = _subscribe(session.zenoh, self._messages, qos)
        self._announced = session.announce("MS", name, type_name, qos, [subscriber])
        session.follow(self._messages, self._came)

    @property
    def dropped(self) -> int:
        """Payloads that were lost on the way, by their numbers, or that we were late for."""
        return self._messages.lost + self._messages.dropped

    def _came(self, message: _Message | DecodeError) -> None:
        if isinstance(message, DecodeError):
            raise message
        if not self._closed and not self._session.is_ignored(message.writer):
            self._on_payload(message.payload, message.sent_ns)

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._announced.close()
            self._messages.close()


def _subscribe(
    session: zenoh.Session, messages: Subscription[_Message | DecodeError], qos: Qos
) -> zenoh.Subscriber[None] | ext.AdvancedSubscriber[None]:
    heard_at: dict[bytes, str] = {}

    def arrived(sample: zenoh.Sample) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            return
        attachment = sample.attachment
        try:
            told = wire.read_attachment(b"" if attachment is None else attachment.to_bytes())
        except DecodeError as error:
            messages.offer(error)
            return
        key = str(sample.key_expr)
        if len(heard_at) >= _MAX_WRITERS:
            heard_at.clear()
        if heard_at.setdefault(told.gid, key) == key:  # writers like ours say everything twice
            message = _Message(sample.payload.to_bytes(), told.sent_ns, told.gid)
            messages.offer(message, told.gid, told.sequence)

    if qos.durability == "volatile":
        return session.declare_subscriber(messages.key_expression, arrived)
    heartbeats = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    return ext.declare_advanced_subscriber(
        session,
        messages.key_expression,
        arrived,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
        recovery=heartbeats if qos.reliability == "reliable" else None,
        subscriber_detection=True,
    )


class TopicWriter:
    """See `driver.Writer`."""

    mismatch = ""  # Zenoh keeps nobody apart for a QoS

    def __init__(self, session: Session, name: str, type_name: str, qos: Qos) -> None:
        self._session = session
        self._name = name
        self._closed = False
        self._sequence = 0
        keys = session.own_keys(name, type_name)
        self._publishers = [_declare_publisher(session.zenoh, key, qos) for key in keys]
        self._announced = session.announce("MP", name, type_name, qos, self._publishers)

    def write(self, payload: bytes) -> None:
        """Send a payload."""
        if self._closed:
            raise self._closed_error()
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self._announced.gid).encode()
        body = zenoh.ZBytes(payload)
        with refusals(f"{len(payload)} bytes for {self._name}"):
            for publisher in self._publishers:
                publisher.put(body, attachment=attachment)

    async def matched(self) -> None:
        """Wait until somebody reads the topic; raise `NotConnectedError` if this is closed."""
        await self._session.until(lambda: self._closed or self._session.readers(self._name))
        if self._closed:
            raise self._closed_error()

    def _closed_error(self) -> NotConnectedError:
        return NotConnectedError(f"the writer of {self._name} is closed")

    async def delivered(self, timeout_s: float) -> None:
        """Wait until the router has what was written; who reads it confirms nothing.

        Raises:
            DeadlineError: The router does not answer.
        """
        if self._closed:
            raise self._closed_error()
        await self._session.pass_through(timeout_s)

    def close(self) -> None:
        """End it."""
        if not self._closed:
            self._closed = True
            self._announced.close()


def _declare_publisher(
    session: zenoh.Session, key: str, qos: Qos
) -> zenoh.Publisher | ext.AdvancedPublisher:
    is_reliable = qos.reliability == "reliable"
    settings: dict[str, Any] = {
        "congestion_control": zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.RELIABLE if is_reliable else zenoh.Reliability.BEST_EFFORT,
    }
    if qos.durability == "volatile":
        return session.declare_publisher(key, **settings)
    heartbeats = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
    return ext.declare_advanced_publisher(
        session,
        key,
        **settings,
        cache=ext.CacheConfig(max_samples=qos.depth),
        publisher_detection=True,
        sample_miss_detection=heartbeats if is_reliable else None,
    )
