"""A Zenoh session, our node on it, and the graph that the tokens of all nodes make.

The session is a client of the router, whereas nodes of rmw_zenoh also connect to each other: what
they exchange with us goes through the router. Zenoh calls back in threads of its own; everything
else happens in the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Protocol, TypeVar, TypeVarTuple

import zenoh

from vertebra.bus import Delivery, Subscription
from vertebra.errors import (
    CodecError,
    CodecNotFoundError,
    DeadlineError,
    NameMappingError,
    TransportError,
)
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation
from vertebra.ros2.graph import Endpoint, Graph
from vertebra.ros2.names import Role
from vertebra.ros2.qos import Qos
from vertebra.ros2.rmw_zenoh import wire
from vertebra.ros2.rmw_zenoh.wire import Kind, Token

log = logging.getLogger(__name__)

_GRAPH_DEPTH: Final = 16384
"""So many news of the graph wait for the event loop at most."""
_TELL_EVERY_S: Final = 10.0

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


def in_loop(loop: asyncio.AbstractEventLoop, what: Callable[[*Ts], object], *given: *Ts) -> None:
    """Do something in the event loop, from a thread of Zenoh's."""
    with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits for it any more
        loop.call_soon_threadsafe(what, *given)


@contextlib.contextmanager
def refusals(what: str) -> Iterator[None]:
    """Tell what Zenoh refuses as `TransportError`."""
    try:
        yield
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh refuses {what}: {error}") from error


class Declared(Protocol):
    """Anything that has been declared with Zenoh."""

    def undeclare(self) -> None:
        """Take it back."""
        ...


class Session:
    """Our node on Zenoh.

    Attributes:
        zenoh: What everything of ours is declared with.
        domain_id: Our domain.
        graph: What others have.
        own: What we have.
        participant: What the gids of what we have begin with.
        failed: Ends with the error that stopped us.
    """

    def __init__(self, session: zenoh.Session, part: Participation, types: Types) -> None:
        self.zenoh = session
        self.domain_id = part.domain_id
        self.graph = Graph()
        self.own = Graph()
        self.failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._types = types
        self._identity = str(session.info.zid())
        self._part = part
        self._entities = 0
        self._change = asyncio.Event()
        self._on_graph: list[Callable[[], None]] = []
        self._announced: set[Announced] = set()
        self._followers: set[asyncio.Task[None]] = set()
        self._writers: dict[bytes, bytes] = {}
        node = self._token("NN")
        self.participant = node.participant
        self._node_key = node.key
        self._node = session.liveliness().declare_token(self._node_key)
        self._tokens = self._follow_graph()

    def on_graph(self, changed: Callable[[], None]) -> None:
        """Call `changed` after each change of the graph."""
        self._on_graph.append(changed)

    def readers(self, name: str, role: Role = "topic") -> list[Endpoint]:
        """Return who reads a topic, or serves requests: others and us."""
        return self.graph.readers(name, role) + self.own.readers(name, role)

    async def until(self, find: Callable[[], T]) -> T:
        """Return what `find` finds, once it finds anything; asked at each change of the graph."""
        while not (found := find()):
            await self._change.wait()
        return found

    def hash_of(self, type_name: str) -> str:
        """Return the hash of a type; empty if it is not known here."""
        try:
            return self._types.hash_of(type_name)
        except CodecNotFoundError:
            return ""

    def own_keys(self, name: str, type_name: str) -> tuple[str, ...]:
        """Return where others look for a topic or service of ours; Humble knows no hash."""
        hashes = dict.fromkeys((self.hash_of(type_name), ""))
        return tuple(wire.key_of(self.domain_id, name, type_name, each) for each in hashes)

    def announce(
        self, kind: Kind, name: str, type_name: str, qos: Qos, declared: Sequence[Declared] = ()
    ) -> Announced:
        """Let an endpoint be seen, with what has been declared for it: who sees it relies on that.

        Both stay, whoever keeps what is returned or not, until that is closed.
        """
        self._entities += 1
        announced = Announced(self, self._token(kind, name, type_name, qos), declared)
        self._announced.add(announced)
        self.own.add(announced.endpoint)
        self._note_writer(announced.endpoint, is_there=True)
        self._tell_change()
        return announced

    def forget(self, announced: Announced) -> bool:
        """Let an endpoint go; say whether it was still there."""
        if announced not in self._announced:
            return False
        self._announced.remove(announced)
        self.own.remove(announced.endpoint.gid)
        self._note_writer(announced.endpoint, is_there=False)
        self._tell_change()
        return True

    def _token(
        self, kind: Kind, name: str = "", type_name: str = "", qos: Qos | None = None
    ) -> Token:
        return Token(
            domain_id=self.domain_id,
            session=self._identity,
            node_id="0",
            entity_id=str(self._entities),
            kind=kind,
            namespace=self._part.namespace,
            node=self._part.node,
            name=name,
            type=type_name,
            type_hash=self.hash_of(type_name) if type_name else "",
            qos=qos or Qos(),
        )

    def follow(self, subscription: Subscription[T], take: Callable[[T], None]) -> None:
        """Give `take` what a subscription brings until it closes; what it refuses is logged."""
        follower = asyncio.get_running_loop().create_task(_follow(subscription, take))
        self._followers.add(follower)
        follower.add_done_callback(self._followed)

    def _followed(self, follower: asyncio.Task[None]) -> None:
        self._followers.discard(follower)
        error = None if follower.cancelled() else follower.exception()
        if error is not None and not self.failed.done():
            self.failed.set_exception(error)

    def _follow_graph(self) -> Declared:
        news: Subscription[tuple[str, bool]] = Subscription(
            wire.graph_of(self.domain_id),
            Delivery.queue(_GRAPH_DEPTH),
            key_of=lambda told: told[0],
        )

        def arrived(sample: zenoh.Sample) -> None:
            news.offer((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        self.follow(news, self._token_changed)
        return self.zenoh.liveliness().declare_subscriber(
            news.key_expression, arrived, history=True
        )

    def _token_changed(self, told: tuple[str, bool]) -> None:
        key, is_there = told
        token = wire.read_token(key)
        if token.session == self._identity:
            return
        if token.kind == "NN":
            gid = token.participant + wire.gid_of(key)
            if is_there:
                self.graph.set_nodes(gid, {token.node_name: frozenset()})
            else:
                self.graph.remove_participant(gid)
        else:
            endpoint = wire.endpoint_of(token, key)
            if is_there:
                self.graph.add(endpoint)
            else:
                self.graph.remove(endpoint.gid)
            self._note_writer(endpoint, is_there=is_there)
        self._tell_change()
        for changed in self._on_graph:
            changed()

    def _note_writer(self, endpoint: Endpoint, *, is_there: bool) -> None:
        of_node, in_messages = endpoint.gid[: wire.GID_BYTES], endpoint.gid[wire.GID_BYTES :]
        if is_there:
            self._writers[in_messages] = of_node
        else:
            self._writers.pop(in_messages, None)

    def is_ignored(self, gid: bytes) -> bool:
        """Say whether a message is of ourselves, or of a node that the graph ignores."""
        return self._writers.get(gid, b"").startswith((self.participant, *self.graph.ignored))

    def _tell_change(self) -> None:
        """Let those look who wait `until` something is there."""
        self._change.set()
        self._change = asyncio.Event()

    async def pass_through(self, timeout_s: float) -> None:
        """Wait until the router has what was sent: it answers in the order in which it is told.

        Raises:
            DeadlineError: It does not answer.
        """
        loop = asyncio.get_running_loop()
        passed = asyncio.Event()
        replies: list[zenoh.Reply] = []  # Zenoh's own, at the deadline; nobody else answers there
        ask: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(
            replies.append, lambda: in_loop(loop, passed.set)
        )
        with refusals("to ask the router"):
            self.zenoh.get(
                f"{self._node_key}/nobody",
                ask,
                timeout=timeout_s,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
        await passed.wait()
        if replies:
            raise DeadlineError("the Zenoh router", timeout_s)

    async def close(self) -> None:
        """Leave the network; what is declared goes with the session."""
        for follower in self._followers:
            follower.cancel()
        if self._followers:
            await asyncio.wait(self._followers)
        self.failed.cancel()
        await asyncio.to_thread(self.zenoh.close)


class Announced:
    """An endpoint of ours, seen by all until it closes.

    Attributes:
        endpoint: What it is in the graph.
        gid: Its identity in messages.
    """

    def __init__(self, session: Session, token: Token, declared: Sequence[Declared]) -> None:
        self.endpoint = wire.endpoint_of(token, token.key)
        self.gid = wire.gid_of(token.key)
        self._session = session
        self._declared = (session.zenoh.liveliness().declare_token(token.key), *declared)

    def close(self) -> None:
        """End it."""
        if self._session.forget(self):
            with contextlib.suppress(zenoh.ZError):  # the session has gone, and all with it
                for one in self._declared:
                    one.undeclare()


async def _follow(subscription: Subscription[T], take: Callable[[T], None]) -> None:
    refused, told_s = 0, -_TELL_EVERY_S
    async for item in subscription:
        try:
            take(item)
        except (CodecError, NameMappingError) as error:
            refused += 1
            now_s = time.monotonic()
            if now_s - told_s >= _TELL_EVERY_S:
                log.warning("refused %d on %s: %s", refused, subscription.key_expression, error)
                refused, told_s = 0, now_s
        await asyncio.sleep(0)  # a stream that never pauses leaves others their turn
