"""Connections that are made when needed and again after a loss."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from vertebra_yarp.driver import Connection

C = TypeVar("C", bound=Connection)


class Redialled(Generic[C]):
    """A connection that `dial` makes when needed and again after a loss."""

    def __init__(self, dial: Callable[[], Awaitable[C]]) -> None:
        self._dial = dial
        self._connection: C | None = None
        self._closed: asyncio.Task[str] | None = None
        self._lock = asyncio.Lock()

    @property
    def connected(self) -> bool:
        """Whether there is a connection, alive as far as is known."""
        return self._closed is not None and not self._closed.done()

    async def get(self) -> C:
        """Return a connection that was alive a moment ago; raise `TransportError`."""
        async with self._lock:
            if self._connection is None or not self.connected:
                await self._drop()
                self._connection = await self._dial()
                self._closed = asyncio.create_task(self._connection.wait_closed())
            return self._connection

    async def wait_closed(self) -> str:
        """Return why the present connection ended, when it has."""
        return await asyncio.shield(self._closed) if self._closed is not None else "not connected"

    async def close(self) -> None:
        """End it."""
        async with self._lock:
            await self._drop()

    async def _drop(self) -> None:
        if self._connection is not None:
            await self._connection.close()
        if self._closed is not None:
            self._closed.cancel()
        self._connection = self._closed = None
