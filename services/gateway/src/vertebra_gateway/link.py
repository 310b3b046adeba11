"""Connections that hide no backlog: what is sent is gone before the next thing is chosen.

Between a sender and a slow reader lie the buffers of asyncio, of both kernels and of the reader's
WebSocket library; together they hold minutes of small messages. So asyncio's buffer is kept empty,
the kernel's is kept small, and a WebSocket can be asked to wait until its client has read
everything: it sends a ping, which the client answers in its turn (RFC 6455, 5.5.2).
"""

from __future__ import annotations

import asyncio
import socket
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import InvalidState
from websockets.frames import Frame

UNTIL_READ: Final = "vertebra.until_read"
"""ASGI extension of a WebSocket scope: `{"wait": <coroutine function>}`."""
UNSENT_BYTES: Final = 16 << 10
_ABORT_AFTER_S: Final = 1.0


def limit_unsent(listener: socket.socket) -> None:
    """Let the kernel keep little that it cannot send yet, on all connections accepted here.

    What is on its way to a reader that keeps up is not limited by this, as it would be by a small
    send buffer.
    """
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)


class HttpLink(H11Protocol):
    """HTTP/1.1 whose `send` starts only when everything before has left this process."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)

    def shutdown(self) -> None:
        """End soon: a client that does not read must not hold up the stop."""
        super().shutdown()
        self.loop.call_later(_ABORT_AFTER_S, self.transport.abort)


class WebSocketLink(WebSocketsSansIOProtocol):
    """A WebSocket whose `send` returns when the message has left this process."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._marks = 0
        self._waiting: dict[bytes, asyncio.Future[None]] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=0)

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        super().connection_lost(exc)
        for waiter in self._waiting.values():
            if not waiter.done():
                waiter.set_result(None)

    async def run_asgi(self) -> None:
        """Offer `until_read` to the application."""
        extensions: dict[str, Any] = self.scope["extensions"]
        extensions[UNTIL_READ] = {"wait": self.until_read}
        await super().run_asgi()

    async def send(self, message: Any) -> None:
        """See ASGI."""
        await super().send(message)
        await self.writable.wait()

    async def until_read(self) -> None:
        """Return when the client has read all that was sent so far, or is gone."""
        if self.disconnected:
            raise ClientDisconnected
        self._marks += 1
        mark = b"read" + self._marks.to_bytes(8, "little")
        try:
            self.conn.send_ping(mark)
        except InvalidState as error:
            raise ClientDisconnected from error
        waiter = self._waiting[mark] = self.loop.create_future()
        self.transport.write(b"".join(self.conn.data_to_send()))
        try:
            await waiter
        finally:
            del self._waiting[mark]

    def handle_pong(self, event: Frame) -> None:
        """Let go who waits for this pong."""
        waiter = self._waiting.get(bytes(event.data))
        if waiter is None:
            super().handle_pong(event)
        elif not waiter.done():
            waiter.set_result(None)

    def shutdown(self) -> None:
        """End soon: a client that does not read must not hold up the stop."""
        super().shutdown()
        self.loop.call_later(_ABORT_AFTER_S, self.transport.abort)
