"""Streams over plain HTTP: the newest value, at the pace of the reader.

Images are MJPEG (`multipart/x-mixed-replace`), everything else is server-sent events.
"""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from typing import ClassVar, Final

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from vertebra.errors import EncodeError, NotConnectedError
from vertebra_gateway.problems import problem_of
from vertebra_gateway.streams import FormName, Item, Streams, Viewer

IDLE_S: Final = 15.0
"""After so long without news a reader of events is told that the connection lives: proxies end
those that seem dead."""
_BOUNDARY: Final = "vertebra-image"


class LiveResponse(Response):
    """Sends the values of a key until the reader leaves or the gateway stops."""

    form: ClassVar[FormName]
    opening = b""
    idle = b""

    def __init__(self, streams: Streams, key: str) -> None:
        super().__init__(headers={"cache-control": "no-store"})
        del self.headers["content-length"]
        self._streams = streams
        self._key = key

    @abstractmethod
    def part(self, item: Item) -> bytes:
        """Return one value as it is sent."""

    def complaint(self, error: EncodeError) -> bytes:  # noqa: ARG002  - an image has no words
        """Return what is sent where the values have not this form, before the end."""
        return b""

    async def __call__(self, _: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        with self._streams.viewing(self._key, self.form) as viewer:
            async with asyncio.TaskGroup() as tasks:
                sending = tasks.create_task(self._send_values(viewer, send))
                while (await receive())["type"] != "http.disconnect":
                    pass
                sending.cancel()

    async def _send_values(self, viewer: Viewer, send: Send) -> None:
        async def give(body: bytes, *, more: bool = True) -> None:
            await send({"type": "http.response.body", "body": body, "more_body": more})

        await give(self.opening)
        last = b""
        while True:
            # Sending nothing waits until the reader has taken what was sent before (`HttpLink`):
            # only then is the next value chosen.
            await give(b"")
            try:
                async with asyncio.timeout(IDLE_S):
                    item = await viewer.next()
            except TimeoutError:
                await give(self.idle)
            except NotConnectedError:  # the gateway stops
                break
            except EncodeError as error:
                last = self.complaint(error)
                break
            else:
                await give(self.part(item))
        await give(last, more=False)


class MjpegResponse(LiveResponse):
    """The images of a key."""

    media_type = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
    form = "jpeg"
    opening = f"--{_BOUNDARY}\r\n".encode()

    def part(self, item: Item) -> bytes:
        """Return an image; the boundary at its end lets browsers show it at once."""
        head = (
            f"Content-Type: {item.encoding}\r\nContent-Length: {len(item.payload)}\r\n"
            f"X-Captured-Ns: {item.captured_ns}\r\nX-Age-S: {item.age_s:.3f}\r\n\r\n"
        )
        return b"".join((head.encode(), item.payload, b"\r\n", self.opening))


class EventsResponse(LiveResponse):
    """The values of a key as JSON, one per event; an `error` event tells what has no JSON."""

    media_type = "text/event-stream"
    form = "json"
    idle = b": nothing new\n\n"

    def part(self, item: Item) -> bytes:
        """Return an event; the JSON is one line."""
        return b"data: %b\n\n" % item.payload

    def complaint(self, error: EncodeError) -> bytes:
        """Return the event that tells the problem."""
        return b"event: error\ndata: %b\n\n" % problem_of(error).body()
