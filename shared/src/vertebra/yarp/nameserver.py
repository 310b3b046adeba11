"""The built-in YARP name server: a YARP port that keeps the registrations in memory."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from vertebra.yarp.names import DEFAULT_TCP_PORT, Contact, NameClient
from vertebra.yarp.wire import DEFAULT_LIMITS, PeerLimits


class NameServer:
    """A running name server; `async with await NameServer.start() as server`."""

    contact: Contact

    @classmethod
    async def start(
        cls,
        *,
        bind_host: str = "127.0.0.1",
        tcp_port: int = DEFAULT_TCP_PORT,
        advertise_host: str | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> NameServer:
        """Listen on `bind_host:tcp_port` (0: any free one, see `contact`) and answer requests.

        Raises:
            ConfigError: The address is in use or not ours.
        """
        raise NotImplementedError

    def client(self) -> NameClient:
        """Return a client of this server."""
        raise NotImplementedError

    async def close(self) -> None:
        """Stop listening and close all connections."""
        raise NotImplementedError

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()
