"""Reading on connections that we dialled."""

from __future__ import annotations

import asyncio
import logging

from vertebra.errors import CodecError, DecodeError
from vertebra.yarp.ports.incoming import OnData, ReadingLink, acknowledgement
from vertebra.yarp.ports.link import Channel
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec
from vertebra.yarp.protocol.receiver import Event, Message, Number
from vertebra.yarp.protocol.wire import MJPEG, Carrier

log = logging.getLogger(__name__)


class Subscription(ReadingLink):
    """The reading end of a connection that we dialled: in reverse, or pulled by mjpeg.

    Args:
        jpeg: Turns the JPEGs of mjpeg into serialised images; without it they are the payload.
    """

    def __init__(
        self,
        connection: Channel,
        source: str,
        carrier: Carrier,
        dialect: Dialect | None,
        on_data: OnData,
        *,
        jpeg: JpegCodec | None,
    ) -> None:
        super().__init__(connection, source, carrier.name, dialect)
        self._carrier = carrier
        self._awaits_ack = carrier.acks
        self._on_data = on_data
        self._jpeg = jpeg if carrier is MJPEG else None
        self._decoding: asyncio.Task[None] | None = None
        connection.on_event = self._on_event
        connection.replies = True

    def _on_event(self, event: Event) -> None:
        if isinstance(event, Message):
            letter = event.command[:1]
            if letter in ("D", "d"):
                self._take(event)
            if ack := acknowledgement(self._carrier):
                self._connection.postpone(ack)
            if letter == "q":
                self._connection.close("closed by the peer")
        elif self._awaits_ack and event == Number(0):
            self._awaits_ack = False  # of our request; from now on the acks are ours
        else:
            raise DecodeError(f"{self.peer} sent {event} where a message should be")

    def _take(self, message: Message) -> None:
        if self._jpeg is None:
            self._deliver(self._incoming(message, reply_wanted=False), self._on_data)
            return
        self._connection.hold()
        self._decoding = asyncio.create_task(self._decode(message, self._jpeg))

    async def _decode(self, message: Message, jpeg: JpegCodec) -> None:
        assert not isinstance(message.payload, str)  # noqa: S101 -- no text comes by mjpeg
        try:
            payload = await asyncio.to_thread(jpeg.decode, message.payload)
        except CodecError as error:
            self._lose(error)
        except Exception as error:
            log.exception("a JPEG from %s could not become an image", self.peer)
            self._lose(error)
        else:
            image = Message(message.command, memoryview(payload))
            self._deliver(self._incoming(image, reply_wanted=False), self._on_data)
        finally:
            self._connection.release()
