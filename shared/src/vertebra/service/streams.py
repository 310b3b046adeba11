"""Typed streams: messages on the bus, encoded and decoded at its edge."""

from __future__ import annotations

import logging
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from vertebra.bus import Bus, Priority, Sample, Subscription
from vertebra.codec import ENCODING, CodecRegistry
from vertebra.errors import CodecError, DecodeError
from vertebra.messages import Header, Message

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)
_LOG_EVERY_S: Final = 10.0


class MessagePublisher:
    """Publishes messages on one key and numbers them."""

    def __init__(
        self,
        bus: Bus,
        codecs: CodecRegistry,
        key: str,
        *,
        priority: Priority = Priority.DATA,
        origin: str = "",
        encoding: str = ENCODING,
    ) -> None:
        self._publisher = bus.publisher(key, encoding=encoding, priority=priority)
        self._codecs = codecs
        self._origin = origin
        self._encoding = encoding
        self._sequence = 0

    @property
    def key(self) -> str:
        """Where it publishes."""
        return self._publisher.key

    def publish(self, message: Message, *, captured_ns: int | None = None, hops: int = 0) -> None:
        """Send `message`; `captured_ns` says when its content was true, by default now.

        Raises:
            EncodeError: The message has no form in the encoding of this publisher.
            NotConnectedError: The bus is closed.
        """
        header = Header(
            captured_ns=time.time_ns() if captured_ns is None else captured_ns,
            sequence=self._sequence,
            origin=self._origin,
            hops=hops,
        )
        payload, encoding = self._codecs.encode(message, header, self._encoding)
        self._publisher.put(payload, encoding=encoding)
        self._sequence += 1

    def close(self) -> None:
        """Undeclare it; harmless when repeated."""
        self._publisher.close()


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
    """A message that arrived, where, and what travelled with it."""

    key: str
    message: M
    header: Header


class MessageReader(Generic[M]):
    """Decodes the samples of a subscription to messages of one type.

    A sample that cannot be read is refused, counted, logged and reported; the stream lives on.

    Attributes:
        refused: Samples that could not be read.
        refusal: Why the last of them was refused.
    """

    def __init__(
        self, subscription: Subscription[Sample], codecs: CodecRegistry, wanted: type[M]
    ) -> None:
        self.subscription = subscription
        self.refused = 0
        self.refusal = ""
        self._codecs = codecs
        self._wanted = wanted
        self._logged_at_s = -_LOG_EVERY_S

    async def __aiter__(self) -> AsyncIterator[Received[M]]:
        async for sample in self.subscription:
            try:
                received = self.read(sample)
            except CodecError as error:
                self._refuse(sample, error)
            else:
                yield received

    def read(self, sample: Sample) -> Received[M]:
        """Return the message in `sample`; raise `CodecError`.

        An encoding without a header of its own takes the time at which the sample was sent.
        """
        message, header = self._codecs.decode(sample.payload, sample.encoding)
        if not isinstance(message, self._wanted):
            raise DecodeError(
                f"{self._wanted.__name__} was expected, {type(message).__name__} arrived"
            )
        if not header.captured_ns:
            header = Header(captured_ns=sample.sent_ns, origin=header.origin, hops=header.hops)
        return Received(sample.key, message, header)

    def _refuse(self, sample: Sample, error: CodecError) -> None:
        self.refused += 1
        self.refusal = f"{sample.key}: {error}"
        now_s = time.monotonic()
        if now_s - self._logged_at_s >= _LOG_EVERY_S:
            log.error("refused sample %d of %s: %s", self.refused, sample.key, error)
            self._logged_at_s = now_s
