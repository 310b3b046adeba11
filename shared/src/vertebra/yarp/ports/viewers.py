"""Outputs to those who watch images as JPEGs (mjpeg): browsers, and YARP ports that pull."""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine
from typing import Any

from vertebra.errors import CodecError
from vertebra.yarp.ports.link import Connection, Delivery, is_power_of_two
from vertebra.yarp.ports.outputs import Outgoing, Output
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec, part
from vertebra.yarp.protocol.wire import MJPEG

log = logging.getLogger(__name__)


class Viewer(Output):
    """Sends images as JPEGs; while one is made in a thread, the next one waits its turn."""

    def __init__(
        self,
        connection: Connection,
        peer: str,
        codec: JpegCodec,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        *,
        delivery: Delivery,
        depth: int,
    ) -> None:
        super().__init__(
            connection, peer, MJPEG, (), Dialect.V3, delivery=delivery, depth=depth, is_reverse=True
        )
        self._ahead = 1  # so that none overtakes another
        self._codec = codec
        self._spawn = spawn

    def _send(self, message: Outgoing, _: Callable[..., None]) -> None:
        self._unacknowledged = 1
        self._spawn(self._encode(message))

    async def _encode(self, message: Outgoing) -> None:
        try:
            jpeg = await message.jpeg(self._codec)
            buffers = part(jpeg, message.envelope)
        except CodecError as error:
            self._lose(error)
        except Exception:
            self.counters.refused += 1
            if is_power_of_two(self.counters.refused):
                log.exception("an image for %s could not become a JPEG", self.peer)
        else:
            self._connection.write(*buffers)
            self.counters.messages += 1
            self.counters.bytes += len(jpeg)
        finally:
            self._unacknowledged = 0
        self._flush()
