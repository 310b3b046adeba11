"""The WebSocket protocol without I/O: text in, orders and answers out; see PROTOCOL.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from vertebra.bus import Delivery
from vertebra.errors import NameMappingError
from vertebra.keys import check_key_expression
from vertebra_gateway.problems import Problem

SUBPROTOCOL: Final = "vertebra.v1"
MAX_TEXT_BYTES: Final = 256 << 10
MAX_SUBSCRIPTIONS: Final = 256
MAX_CALLS: Final = 64
MAX_DEPTH: Final = 1024
CLOSE_POLICY: Final = 1008
CLOSE_TOO_BIG: Final = 1009
_ALIGNMENT: Final = 64
_PADDING: Final = bytes(_ALIGNMENT)

Id = Annotated[int, Meta(ge=1, le=0xFFFFFFFF)]


class Subscribe(Struct, frozen=True, kw_only=True, tag_field="op", tag="subscribe"):
    """Send me what comes on a key expression."""

    id: Id
    key: Annotated[str, Meta(max_length=1024)]
    delivery: Literal["latest", "queue"] = "latest"
    depth: Annotated[int, Meta(ge=1, le=MAX_DEPTH)] | UnsetType = UNSET
    max_rate_hz: Annotated[float, Meta(gt=0, le=100_000)] | UnsetType = UNSET
    form: Literal["frame", "json", "jpeg"] = "frame"
    window: Annotated[int, Meta(ge=1, le=MAX_DEPTH)] | UnsetType = UNSET

    def buffer(self) -> Delivery:
        """Return what to keep while the client is busy."""
        if self.delivery == "queue":
            return Delivery.queue(64 if self.depth is UNSET else self.depth)
        return Delivery.latest(1 if self.depth is UNSET else self.depth)


class Unsubscribe(Struct, frozen=True, kw_only=True, tag_field="op", tag="unsubscribe"):
    """Send no more of it."""

    id: Id


class Acknowledge(Struct, frozen=True, kw_only=True, tag_field="op", tag="ack"):
    """I have dealt with a data message of this subscription."""

    id: Id


class Call(Struct, frozen=True, kw_only=True, tag_field="op", tag="call"):
    """Have a robot do something."""

    id: Id
    robot: str
    path: str
    body: Any = msgspec.field(default_factory=dict)
    timeout_s: Annotated[float, Meta(gt=0)] | None = None


class _Ping(Struct, frozen=True, kw_only=True, tag_field="op", tag="ping"):
    id: Id
    client_ns: int | float | Annotated[str, Meta(max_length=32)]


class End(Struct, frozen=True):
    """Close the connection."""

    code: int
    reason: str


Order = Subscribe | Unsubscribe | Acknowledge | Call
_Message = Subscribe | Unsubscribe | Acknowledge | Call | _Ping


class _Id(Struct):
    id: Id


_MESSAGES: Final = msgspec.json.Decoder(_Message)
_IDS: Final = msgspec.json.Decoder(_Id)


class Conversation:
    """What one client has open, and what its next message means.

    `receive` returns an `Order` to carry out, the text of an answer, an `End`, or None. For an
    order the caller sends `subscribed`, `unsubscribed`, `reply` or `error`; at the end of a call
    it says `call_ended`.
    """

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self.subscriptions: set[int] = set()
        self.calls: set[int] = set()
        self._clock_ns = clock_ns

    def receive(self, text: str | bytes) -> Order | End | str | None:
        """Take in a message of the client; binary ones are none of this protocol."""
        if isinstance(text, bytes):
            return error(None, Problem(status=422, detail="send text messages, not binary ones"))
        if len(text) > MAX_TEXT_BYTES:
            return End(
                CLOSE_TOO_BIG, f"a message of {len(text)} bytes; the limit is {MAX_TEXT_BYTES}"
            )
        try:
            message = _MESSAGES.decode(text)
        except (msgspec.MsgspecError, UnicodeError, RecursionError) as fault:
            return error(_id_in(text), Problem(status=422, detail=f"not understood: {fault}"))
        if isinstance(message, _Ping):
            return _encode(
                {
                    "op": "pong",
                    "id": message.id,
                    "client_ns": message.client_ns,
                    "server_ns": str(self._clock_ns()),
                }
            )
        if isinstance(message, Call):
            return self._call(message)
        if isinstance(message, Subscribe):
            return self._subscribe(message)
        return self._refer(message)

    def call_ended(self, call_id: int) -> None:
        """Forget a call that was answered."""
        self.calls.discard(call_id)

    def _call(self, message: Call) -> Order | str:
        if message.id in self.calls:
            return error(
                message.id, Problem(status=422, detail=f"call {message.id} is not answered yet")
            )
        if len(self.calls) >= MAX_CALLS:
            return error(
                message.id, Problem(status=429, detail=f"{MAX_CALLS} calls are waiting already")
            )
        self.calls.add(message.id)
        return message

    def _subscribe(self, message: Subscribe) -> Order | End | str:
        if message.id in self.subscriptions:
            detail = f"subscription {message.id} exists already; unsubscribe it first"
            return error(message.id, Problem(status=422, detail=detail))
        if len(self.subscriptions) >= MAX_SUBSCRIPTIONS:
            return End(CLOSE_POLICY, f"more than {MAX_SUBSCRIPTIONS} subscriptions")
        if message.delivery == "queue" and message.max_rate_hz is not UNSET:
            detail = "max_rate_hz lets samples go; use it with delivery latest"
            return error(message.id, Problem(status=422, detail=detail))
        try:
            check_key_expression(message.key)
        except NameMappingError as fault:
            return error(message.id, Problem(status=422, detail=str(fault)))
        self.subscriptions.add(message.id)
        return message

    def _refer(self, message: Unsubscribe | Acknowledge) -> Order | str:
        if message.id not in self.subscriptions:
            detail = f"there is no subscription {message.id}"
            return error(message.id, Problem(status=404, detail=detail))
        if isinstance(message, Unsubscribe):
            self.subscriptions.discard(message.id)
        return message


def subscribed(subscription_id: int) -> str:
    """Return the answer to a subscribe."""
    return _encode({"op": "subscribed", "id": subscription_id})


def unsubscribed(subscription_id: int) -> str:
    """Return the answer to an unsubscribe."""
    return _encode({"op": "unsubscribed", "id": subscription_id})


def reply(call_id: int, body: Any) -> str:
    """Return what a call gave."""
    return _encode({"op": "reply", "id": call_id, "body": body})


def error(message_id: int | None, problem: Problem) -> str:
    """Return why something did not work."""
    return _encode({"op": "error", "id": message_id, **problem.document()})


def drops(subscription_id: int, dropped: int, lost: int) -> str:
    """Return how much a subscription has missed so far."""
    return _encode({"op": "drops", "id": subscription_id, "dropped": dropped, "lost": lost})


def robots(described: list[dict[str, Any]]) -> str:
    """Return the robots as they are now."""
    return _encode({"op": "robots", "robots": described})


def shared_head(key: str, encoding: str, sent_ns: int, captured_ns: int) -> bytes:
    """Return the part of a head that is the same for all viewers of a sample."""
    return b'{"key":%b,"encoding":%b,"sent_ns":"%d","captured_ns":"%d","dropped":' % (
        msgspec.json.encode(key),
        msgspec.json.encode(encoding),
        sent_ns,
        captured_ns,
    )


def data_message(subscription_id: int, head: bytes, dropped: int, payload: bytes) -> bytes:
    """Return a binary message; `head` is a `shared_head`."""
    head = b"%b%d}" % (head, dropped)
    padding = -(8 + len(head)) % _ALIGNMENT
    return b"".join(
        (
            subscription_id.to_bytes(4, "little"),
            len(head).to_bytes(4, "little"),
            head,
            _PADDING[:padding],
            payload,
        )
    )


def _encode(message: dict[str, Any]) -> str:
    return msgspec.json.encode(message).decode()


def _id_in(text: str) -> int | None:
    try:
        return _IDS.decode(text).id
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
