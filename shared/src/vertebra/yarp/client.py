"""Clients that need no port of their own: read any output port, call any RPC port."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from vertebra.yarp.bottle import Value
from vertebra.yarp.dialect import Dialect
from vertebra.yarp.link import Link
from vertebra.yarp.names import NameClient
from vertebra.yarp.port import OnData
from vertebra.yarp.wire import DEFAULT_LIMITS, PeerLimits


class Reader(Link):
    """A subscription to an output port, made by dialling it (reverse connection).

    Nothing is registered and nothing listens on our side. When the source goes away,
    `wait_closed` returns; dialling again is up to the caller.
    """

    @classmethod
    async def dial(
        cls,
        source: str,
        names: NameClient,
        *,
        on_data: OnData,
        reader_name: str,
        carrier: str = "fast_tcp",
        dialect: Dialect = Dialect.V3,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> Reader:
        """Subscribe to the output port `source`.

        `reader_name` is how the source lists us; it must be rooted (`/x`) and unique at the
        source, which closes an older connection of the same name.

        Raises:
            NotConnectedError: `source` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
        """
        raise NotImplementedError


class RpcClient(Link):
    """A connection to a YARP RPC port; `async with await RpcClient.connect(...) as client`."""

    @classmethod
    async def connect(
        cls,
        name: str,
        names: NameClient,
        *,
        sender: str = "anon_rpc",
        dialect: Dialect = Dialect.V3,
        limits: PeerLimits = DEFAULT_LIMITS,
        max_waiting_calls: int = 64,
    ) -> RpcClient:
        """Dial the RPC port `name` over tcp.

        Raises:
            NotConnectedError: `name` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
        """
        raise NotImplementedError

    async def call(self, values: Sequence[Value], *, timeout_s: float) -> list[Value]:
        """Send one bottle and return the reply; calls are answered in their order.

        A port that does not reply gives an empty list. After a failed or cancelled call the
        place in the stream is lost: the connection is closed and a new client is needed.

        Raises:
            DeadlineError: No reply in time, waiting for earlier calls included.
            NotConnectedError: The connection is or was lost.
            BusyError: `max_waiting_calls` are waiting already.
            DecodeError: The reply is not a bottle.
        """
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
