"""A sender that needs no port of its own: it writes into any input port."""

from __future__ import annotations

import asyncio
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.naming.names import NameClient, check_name
from vertebra.yarp.ports.link import Connection, Delivery, dial, find
from vertebra.yarp.ports.outputs import Outgoing, Output, Payload
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.receiver import Event
from vertebra.yarp.protocol.wire import DEFAULT_LIMITS, FAST_TCP, TCP, Carrier, PeerLimits

_CARRIERS: Final = {carrier.name: carrier for carrier in (FAST_TCP, TCP)}


class Sender(Output):
    """Messages into the input port of somebody else, such as a robot's `command:i`.

    Nothing is registered and nothing listens on our side. When the port goes away, `wait_closed`
    returns; dialling again is up to the caller.
    """

    def __init__(
        self,
        connection: Connection,
        peer: str,
        carrier: Carrier,
        dialect: Dialect,
        *,
        delivery: Delivery,
        depth: int,
    ) -> None:
        super().__init__(
            connection, peer, carrier, (), dialect, delivery=delivery, depth=depth, is_reverse=False
        )
        self._dialect = dialect
        self._taken = asyncio.Event()
        self._taken.set()

    @classmethod
    async def dial(
        cls,
        dest: str,
        names: NameClient,
        *,
        sender_name: str,
        carrier: str = "fast_tcp",
        delivery: Delivery = "latest",
        depth: int = 16,
        dialect: Dialect | None = None,
        limits: PeerLimits = DEFAULT_LIMITS,
    ) -> Self:
        """Connect to the input port `dest`, over tcp or fast_tcp.

        `sender_name` is how `dest` lists us; it must be rooted (`/x`) and unique at `dest`, which
        closes an older connection of the same name. `delivery` and `depth` are those of
        `Port.open`. Where `dialect` is None, `dest` is asked for it.

        Raises:
            NotConnectedError: `dest` is not registered, or nobody listens there.
            DeadlineError: It does not answer.
            EncodeError: `carrier` is another one.
        """
        if carrier not in _CARRIERS:
            raise EncodeError(f"cannot send over carrier {carrier!r}; use fast_tcp or tcp")
        spoken = _CARRIERS[carrier]
        contact = await find(dest, names)
        dialect = dialect or await names.dialects.of(contact)
        connection = await dial(contact, spoken, check_name(sender_name), (), limits)
        sender = cls(connection, dest, spoken, dialect, delivery=delivery, depth=depth)
        connection.release()
        return sender

    def write(self, payload: Payload, *, envelope: str = "") -> None:
        """Send an object, the values of a bottle, or bytes, without waiting; see `Port.write`.

        Raises:
            BusyError: `delivery` is `queue` and the queue is full.
            EncodeError: The payload has no form in the dialect of the port, or the envelope holds
                control characters.
        """
        message = Outgoing(payload, envelope, max_text_bytes=0)
        message.form(self._dialect, is_text=False)
        self._taken.clear()
        self.offer(message)
        self._note_taken()

    async def wait_taken(self) -> bool:
        """Wait until the port has acknowledged everything (tcp), or the kernel has it (fast_tcp).

        Return whether it did; else the connection has ended.
        """
        taken = asyncio.ensure_future(self._taken.wait())
        try:
            await asyncio.wait((taken, self.lost), return_when=asyncio.FIRST_COMPLETED)
        finally:
            taken.cancel()
        return self._taken.is_set()

    def _on_event(self, event: Event) -> None:
        super()._on_event(event)
        self._note_taken()

    def _flush(self) -> None:
        super()._flush()
        self._note_taken()

    def _note_taken(self) -> None:
        if not self._waiting and not self._unacknowledged:
            self._taken.set()
