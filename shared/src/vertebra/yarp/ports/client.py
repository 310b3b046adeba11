"""Calls to any RPC port, and administration of any port, without a port of our own."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Self

from vertebra.errors import BusyError, DeadlineError, DecodeError, NotConnectedError
from vertebra.yarp.naming.names import Contact, NameClient
from vertebra.yarp.ports.link import Connection, Link, dial, find
from vertebra.yarp.protocol.bottle import Value, encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.receiver import CallReply, Event
from vertebra.yarp.protocol.wire import (
    DEFAULT_LIMITS,
    TCP,
    PeerLimits,
    binary_message,
    command,
    quit_message,
)


class RpcClient(Link):
    """A connection to a YARP RPC port; `async with await RpcClient.connect(...) as client`."""

    def __init__(
        self, connection: Connection, peer: str, dialect: Dialect, max_waiting_calls: int
    ) -> None:
        super().__init__(connection, peer, TCP.name)
        self._dialect = dialect
        self._max_waiting_calls = max_waiting_calls
        self._calls = 0
        self._turn = asyncio.Lock()
        self._reply: asyncio.Future[list[Value]] | None = None
        connection.receiver.expect_replies(dialect)
        connection.on_event = self._on_event
        connection.on_lost = self._on_lost

    @classmethod
    async def connect(
        cls,
        name: str,
        names: NameClient,
        *,
        sender: str = "anon_rpc",
        dialect: Dialect | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
        max_waiting_calls: int = 64,
    ) -> Self:
        """Dial the RPC port `name` over tcp; where `dialect` is None the port is asked for it.

        Raises:
            NotConnectedError: `name` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
        """
        contact = await find(name, names)
        return await cls.dial(
            contact,
            sender=sender,
            dialect=dialect or await names.dialects.of(contact),
            limits=limits,
            max_waiting_calls=max_waiting_calls,
        )

    @classmethod
    async def dial(
        cls,
        contact: Contact,
        *,
        sender: str = "anon_rpc",
        dialect: Dialect = Dialect.V3,
        limits: PeerLimits = DEFAULT_LIMITS,
        max_waiting_calls: int = 64,
    ) -> Self:
        """Dial a port whose place is known; see `connect`."""
        connection = await dial(contact, TCP, sender, (), limits)
        client = cls(connection, contact.name, dialect, max_waiting_calls)
        connection.release()
        return client

    @property
    def dialect(self) -> Dialect:
        """How the numbers of this connection are tagged."""
        return self._dialect

    async def call(self, values: Sequence[Value], *, timeout_s: float) -> list[Value]:
        """Send one bottle and return the reply; calls are answered in their order.

        A port that does not reply gives an empty list. After a failed or cancelled call the
        place in the stream is lost: the connection is closed and a new client is needed.

        Raises:
            DeadlineError: No reply in time, waiting for earlier calls included.
            NotConnectedError: The connection is or was lost, or the reply is not a bottle.
            BusyError: `max_waiting_calls` are waiting already.
            EncodeError: A value has no form in a bottle.
        """
        return await self._ask("d", values, timeout_s)

    async def administer(self, values: Sequence[Value], *, timeout_s: float) -> list[Value]:
        """Send a request to the port itself, not to its owner, such as `[list] [out]`.

        Raises what `call` raises.
        """
        return await self._ask("a", values, timeout_s)

    async def close(self) -> None:
        """Tell the port, then end the connection; a call that waits fails."""
        if self._reply is None:
            self._connection.write(quit_message(TCP))
        await super().close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _ask(self, letter: str, values: Sequence[Value], timeout_s: float) -> list[Value]:
        request = encode(values, self._dialect)
        if self._calls > self._max_waiting_calls:
            raise BusyError(f"the YARP connection to {self.peer}", self._max_waiting_calls)
        self._calls += 1
        try:
            async with asyncio.timeout(timeout_s), self._turn:
                return await self._exchange(letter, request)
        except TimeoutError:
            raise DeadlineError(f"YARP port {self.peer}", timeout_s) from None
        finally:
            self._calls -= 1

    async def _exchange(self, letter: str, request: bytes) -> list[Value]:
        if self._connection.closing:
            raise self._lost()
        self._reply = asyncio.get_running_loop().create_future()
        try:
            self._connection.write(*binary_message(command(letter), (request,)))
            reply = await self._reply
        except BaseException:
            self._connection.close("a call was given up, and with it the place in the stream")
            raise
        finally:
            self._reply = None
        self.counters.messages += 1
        self.counters.bytes += len(request)
        return reply

    def _on_event(self, event: Event) -> None:
        reply = self._reply
        if not isinstance(event, CallReply) or reply is None or reply.done():
            raise DecodeError(f"{self.peer} sent something without being asked")
        reply.set_result(event.values or [])

    def _on_lost(self) -> None:
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(self._lost())

    def _lost(self) -> NotConnectedError:
        return NotConnectedError(
            f"the connection to YARP port {self.peer} has ended: {self._connection.reason}; "
            "connect a new client"
        )
