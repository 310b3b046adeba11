"""A YARP port on asyncio: one TCP listener for data, calls and administration."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from types import TracebackType
from typing import Literal, Self

from vertebra.yarp.bottle import Value
from vertebra.yarp.dialect import Dialect
from vertebra.yarp.link import Counters, Link
from vertebra.yarp.names import Contact, NameClient
from vertebra.yarp.wire import DEFAULT_LIMITS, Buffer, PeerLimits

Delivery = Literal["latest", "queue"]


class Incoming:
    """One message as it reached a port; its payload belongs to the receiver of this object.

    Attributes:
        payload: The serialised object, read-only. Text carriers deliver the binary bottle too.
        envelope: The text beside the payload, often a Stamp (`41 1234.5`); empty when absent.
        sender: Name that the sender gave; rooted (`/x`) for real ports.
        carrier: Such as `tcp`.
        reply_wanted: The sender waits for a reply.
    """

    payload: memoryview
    envelope: str
    sender: str
    carrier: str
    reply_wanted: bool

    def bottle(self) -> list[Value]:
        """Decode the payload as a bottle in the dialect of the port.

        Raises:
            DecodeError: It is not one.
        """
        raise NotImplementedError


Reply = Sequence[Value] | bytes | None
"""A bottle; or bytes that are sent as they are on every carrier; None acknowledges only."""

OnData = Callable[[Incoming], None]
"""Called in the event loop for each message: hand over and return at once."""

OnCall = Callable[[Incoming], Awaitable[Reply]]
"""Answers a message; one call per connection at a time, cancelled after `reply_timeout_s`."""


class Port:
    """A registered YARP port; `async with await Port.open(...) as port`.

    Attributes:
        name: As registered.
        contact: Where it listens.
    """

    name: str
    contact: Contact

    @classmethod
    async def open(
        cls,
        name: str,
        names: NameClient,
        *,
        on_data: OnData | None = None,
        on_call: OnCall | None = None,
        delivery: Delivery = "latest",
        depth: int = 16,
        bind_host: str = "127.0.0.1",
        advertise_host: str | None = None,
        tcp_port: int = 0,
        dialect: Dialect = Dialect.V3,
        limits: PeerLimits = DEFAULT_LIMITS,
        check_registration_s: float = 2.0,
    ) -> Port:
        """Listen, register `name` and keep it registered, also over restarts of the name server.

        With `on_call` the port answers every message that wants a reply, and gets the others too
        unless there is an `on_data`. With `on_data` alone, messages that want a reply are
        acknowledged only.

        Args:
            name: Rooted port name, or `...` for one that the name server makes up.
            names: The name server to register with.
            on_data: Gets messages in the event loop.
            on_call: Answers messages.
            delivery: What `write` does while a connection is busy with an earlier message:
                `latest` keeps the newest one, `queue` keeps up to `depth` and then refuses.
            depth: Messages that may wait for each connection when `delivery` is `queue`.
            bind_host: Interface to listen on.
            advertise_host: Address to register; by default `bind_host`, or, where that is a
                wildcard, the address from which the name server sees us.
            tcp_port: 0 takes any free one.
            dialect: How numbers are tagged in bottles; YARP 3 by default.
            limits: What peers may cost.
            check_registration_s: Time between two looks whether `name` is still registered.

        Raises:
            ConfigError: The address cannot be bound.
            NameMappingError: `name` is not a YARP port name.
            NotConnectedError, DeadlineError: The name server does not answer.
        """
        raise NotImplementedError

    @property
    def outputs(self) -> list[Link]:
        """Connections that carry what `write` is given."""
        raise NotImplementedError

    @property
    def inputs(self) -> list[Link]:
        """Connections that may send to us, tools such as `<ping>` included."""
        raise NotImplementedError

    @property
    def sent(self) -> Counters:
        """Totals over all outputs, closed ones included."""
        raise NotImplementedError

    @property
    def received(self) -> Counters:
        """Totals over all inputs, closed ones included."""
        raise NotImplementedError

    def write(self, payload: bytes | Sequence[Buffer], *, envelope: str = "") -> None:
        """Send one serialised object to all outputs, without waiting.

        The buffers must not change afterwards: a busy connection sends them later.

        Raises:
            BusyError: `delivery` is `queue` and at least one output refused; the others got it.
            EncodeError: The envelope holds control characters.
        """
        raise NotImplementedError

    async def connect(self, dest: str, carrier: str = "fast_tcp") -> Link:
        """Send to the port `dest` from now on, replacing an earlier connection to it.

        Raises:
            NotConnectedError: `dest` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
            EncodeError: We do not speak `carrier`.
        """
        raise NotImplementedError

    async def disconnect(self, dest: str) -> bool:
        """Stop sending to `dest`; say whether there was such a connection."""
        raise NotImplementedError

    async def close(self) -> None:
        """Unregister, tell the readers, close every connection and stop listening."""
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
