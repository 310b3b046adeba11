"""MJPEG, live images over plain HTTP: the newest image, at the pace of the reader."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Final

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from vertebra.errors import EncodeError, NotConnectedError
from vertebra_gateway.streams import Item, Streams, Viewer

_BOUNDARY: Final = "vertebra-image"


class MjpegResponse(Response):
    """Sends the images of a key until the reader leaves or the gateway stops."""

    media_type = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"

    def __init__(self, streams: Streams, key: str) -> None:
        super().__init__(headers={"cache-control": "no-store"})
        del self.headers["content-length"]
        self._streams = streams
        self._key = key

    async def __call__(self, _: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        with self._streams.viewing(self._key, "jpeg") as viewer:
            async with asyncio.TaskGroup() as tasks:
                sending = tasks.create_task(_send_images(viewer, send))
                while (await receive())["type"] != "http.disconnect":
                    pass
                sending.cancel()


async def _send_images(viewer: Viewer, send: Send) -> None:
    async def give(body: bytes, *, more: bool = True) -> None:
        await send({"type": "http.response.body", "body": body, "more_body": more})

    await give(f"--{_BOUNDARY}\r\n".encode())
    # Where the gateway stops, or no images come any more, the stream just ends.
    with contextlib.suppress(NotConnectedError, EncodeError):
        while True:
            # Sending nothing waits until the reader has taken what was sent before (`HttpLink`):
            # only then is the next image chosen.
            await give(b"")
            await give(part(await viewer.next()))
    await give(b"", more=False)


def part(item: Item) -> bytes:
    """Return one part; the boundary at its end lets browsers show it at once."""
    head = (
        f"Content-Type: {item.encoding}\r\nContent-Length: {len(item.payload)}\r\n"
        f"X-Captured-Ns: {item.captured_ns}\r\nX-Age-S: {item.age_s:.3f}\r\n\r\n"
    )
    return b"".join((head.encode(), item.payload, f"\r\n--{_BOUNDARY}\r\n".encode()))
