"""The behaviour of every driver of ROS 2; its tests subclass `TransportSuite`."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import cache
from importlib import import_module
from typing import ClassVar, NamedTuple

import msgspec
import pytest

from vertebra.errors import (
    DeadlineError,
    NameMappingError,
    NotConnectedError,
    TransportError,
)
from vertebra.ros2.cdr import PADDING_BYTES, Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Client, Participation, Transport, Writer
from vertebra.ros2.drivers import DriverName, open_driver
from vertebra.ros2.qos import LATCHED, Qos, mismatch
from vertebra.testing import ros2_member
from vertebra.testing.bus_suite import eventually

TIMEOUT_S = 10.0
MISSED_WITHIN_S = 30.0
"""Who dies has no chance to say so; Fast DDS waits for 20 s."""
TEXT = "std_msgs/msg/String"
BYTES = "std_msgs/msg/UInt8MultiArray"
ADD = "example_interfaces/srv/AddTwoInts"
FIBONACCI = "example_interfaces/action/Fibonacci"
ANY_QOS = [
    Qos(reliability=reliability, durability=durability)
    for reliability in ("reliable", "best_effort")
    for durability in ("volatile", "transient_local")
]


class Pair(NamedTuple):
    """Two nodes of one network."""

    here: Transport
    there: Transport


@cache
def standard_types() -> Types:
    """Return the types of both nodes; reads files, once."""
    return Types.standard()


@cache
def cdr() -> Cdr:
    """Return what encodes and decodes for the tests."""
    return Cdr(standard_types())


class Heard:
    """What a reader gave: payloads, when they were written, and in which thread they came."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []
        self.sent_ns: list[int] = []
        self.threads: set[int] = set()

    def __call__(self, payload: bytes, sent_ns: int) -> None:
        """Take a payload."""
        self.payloads.append(payload)
        self.sent_ns.append(sent_ns)
        self.threads.add(threading.get_ident())

    async def wait(self, count: int) -> list[bytes]:
        """Return the payloads when there are so many."""
        await eventually(lambda: len(self.payloads) >= count, timeout_s=TIMEOUT_S)
        return self.payloads


def same(payload: bytes, sent: bytes) -> bool:
    """Say whether a payload is what was sent; DDS fills up to whole multiples of 4 bytes."""
    return payload.startswith(sent) and len(payload) - len(sent) <= PADDING_BYTES


class TransportSuite(ABC):
    """What may be asked of a driver, between two nodes that both use it.

    Attributes:
        driver: Its name.
        library: What it needs to be importable; without it, its tests are skipped.
        remedy: How to get that.
        unknown_types: Whether it carries types of which nothing but the name is known.
        compares_qos: Whether a reader hears only a writer that offers what it requests.
        confirms: Whether readers confirm what they have.
        counts_all: Whether what is lost before it reaches the driver is counted as well.
    """

    driver: ClassVar[DriverName]
    library: ClassVar[str]
    remedy: ClassVar[str]
    unknown_types: ClassVar[bool] = True
    compares_qos: ClassVar[bool] = True
    confirms: ClassVar[bool] = True
    counts_all: ClassVar[bool] = True

    @abstractmethod
    def places(self) -> AbstractAsyncContextManager[tuple[Participation, Participation]]:
        """Provide a network, and say as which two nodes to take part: `here` and `there`."""

    @pytest.fixture
    def types(self) -> Types:
        try:
            import_module(self.library)
        except ImportError:
            pytest.skip(f"there is no {self.library}; {self.remedy}")
        return standard_types()

    @pytest.fixture
    async def network(self, types: Types) -> AsyncIterator[tuple[Participation, Participation]]:
        async with self.places() as places:
            yield places

    @pytest.fixture
    async def pair(
        self, network: tuple[Participation, Participation], types: Types
    ) -> AsyncIterator[Pair]:
        here, there = network
        async with (
            open_driver(self.driver, here, types) as one,
            open_driver(self.driver, there, types) as other,
        ):
            yield Pair(one, other)

    @asynccontextmanager
    async def member(self, part: Participation) -> AsyncIterator[asyncio.subprocess.Process]:
        """Run a node in a process of its own."""
        place = msgspec.json.encode(ros2_member.Place(self.driver, part)).decode()
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", ros2_member.__name__, place,
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            async with asyncio.timeout(TIMEOUT_S):
                assert await process.stdout.readline() == b"ready\n"
            yield process
        finally:
            process.stdin.close()
            if process.returncode is None:
                process.send_signal(signal.SIGCONT)
            try:
                await asyncio.wait_for(process.wait(), TIMEOUT_S)
            except TimeoutError:
                process.kill()
                await process.wait()

    # Topics

    async def test_payloads_arrive_in_order_with_their_times(self, pair: Pair) -> None:
        heard = Heard()
        pair.here.reader("/suite/order", TEXT, Qos(depth=100), heard)
        writer = pair.there.writer("/suite/order", TEXT, Qos(depth=100))
        await matched(writer)
        sent = [text(f"number {number}") for number in range(50)]
        began_ns = time.time_ns()
        for payload in sent:
            writer.write(payload)
        got = await heard.wait(50)
        assert all(same(one, other) for one, other in zip(got, sent, strict=True))
        assert heard.sent_ns == sorted(heard.sent_ns)
        assert began_ns - 1e9 < heard.sent_ns[0] <= heard.sent_ns[-1] < time.time_ns() + 1e9
        assert heard.threads == {threading.get_ident()}

    @pytest.mark.parametrize("nbytes", [0, 1, 1000, 65_536, 1_000_001])
    async def test_payloads_of_any_size_stay_whole(self, pair: Pair, nbytes: int) -> None:
        heard = Heard()
        pair.here.reader("/suite/large", BYTES, Qos(), heard)
        writer = pair.there.writer("/suite/large", BYTES, Qos())
        await matched(writer)
        body = bytes(range(256)) * (nbytes // 256) + bytes(nbytes % 256)
        sent = cdr().encode({"data": body}, BYTES)
        writer.write(sent)
        (got,) = await heard.wait(1)
        assert isinstance(got, bytes)
        assert same(got, sent)

    async def test_a_type_of_which_only_the_name_is_known(self, pair: Pair) -> None:
        if not self.unknown_types:
            pytest.skip(f"the driver {self.driver} needs every type; choose another one for this")
        heard = Heard()
        pair.here.reader("/suite/strange", "lab_msgs/msg/Strange", Qos(), heard)
        writer = pair.there.writer("/suite/strange", "lab_msgs/msg/Strange", Qos())
        await matched(writer)
        sent = bytes.fromhex("00010000 01000000 02000000")
        writer.write(sent)
        assert await heard.wait(1) == [sent]

    async def test_everyone_who_reads_a_topic_hears_it(self, pair: Pair) -> None:
        both = [Heard(), Heard()]
        for heard in both:
            pair.here.reader("/suite/two", TEXT, LATCHED, heard)
        pair.there.writer("/suite/two", TEXT, LATCHED).write(text("for all"))
        for heard in both:
            (got,) = await heard.wait(1)
            assert same(got, text("for all"))

    async def test_who_comes_late_gets_what_is_latched(self, pair: Pair) -> None:
        kept, late, volatile = Qos(durability="transient_local", depth=3), Heard(), Heard()
        writer = pair.there.writer("/suite/latched", TEXT, kept)
        for number in range(5):
            writer.write(text(str(number)))
        pair.here.reader("/suite/latched", TEXT, kept, late)
        assert words(await late.wait(3)) == ["2", "3", "4"]
        pair.here.reader("/suite/latched", TEXT, Qos(), volatile)
        await eventually(lambda: len(pair.there.graph.readers("/suite/latched")) == 2)
        writer.write(text("5"))
        assert words(await volatile.wait(1)) == ["5"]
        assert words(await late.wait(4)) == ["2", "3", "4", "5"]

    @pytest.mark.parametrize("requested", ANY_QOS, ids=lambda qos: qos.durability)
    @pytest.mark.parametrize("offered", ANY_QOS, ids=lambda qos: qos.reliability)
    async def test_qos_decides_who_hears_whom(
        self, pair: Pair, offered: Qos, requested: Qos
    ) -> None:
        heard = Heard()
        reader = pair.here.reader("/suite/qos", TEXT, requested, heard)
        writer = pair.there.writer("/suite/qos", TEXT, offered)
        differs = mismatch(offered, requested)
        if not (differs and self.compares_qos):
            await matched(writer)
            await until_heard(heard, lambda: writer.write(text("fits")))
            assert (reader.mismatch, writer.mismatch) == ("", "")
            return
        await eventually(lambda: bool(reader.mismatch and writer.mismatch), timeout_s=TIMEOUT_S)
        assert reader.mismatch in differs
        assert writer.mismatch in differs
        writer.write(text("does not fit"))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(writer.matched(), 0.3)
        assert heard.payloads == []

    async def test_a_reader_that_closes_hears_no_more(self, pair: Pair) -> None:
        gone, stays = Heard(), Heard()
        reader = pair.here.reader("/suite/close", TEXT, Qos(), gone)
        pair.here.reader("/suite/close", TEXT, Qos(), stays)
        writer = pair.there.writer("/suite/close", TEXT, Qos())
        await eventually(lambda: len(pair.there.graph.readers("/suite/close")) == 2)
        await until_heard(stays, lambda: writer.write(text("before")))
        await until_heard(gone, lambda: writer.write(text("before")))
        before = len(stays.payloads)
        reader.close()
        heard = len(gone.payloads)
        writer.write(text("after"))
        await stays.wait(before + 1)
        await eventually(lambda: len(pair.there.graph.readers("/suite/close")) == 1)
        assert len(gone.payloads) == heard

    async def test_a_writer_that_closes_is_gone(self, pair: Pair) -> None:
        writer = pair.there.writer("/suite/close", TEXT, Qos())
        await eventually(lambda: bool(pair.here.graph.writers("/suite/close")))
        writer.close()
        await eventually(lambda: not pair.here.graph.writers("/suite/close"))
        with pytest.raises(NotConnectedError, match="/suite/close"):
            writer.write(text("late"))

    async def test_what_the_event_loop_is_late_for_is_counted(self, pair: Pair) -> None:
        if not self.counts_all:
            pytest.skip(f"the driver {self.driver} is not told of what its library overwrites")
        heard, count = Heard(), 2000
        reader = pair.here.reader("/suite/late", TEXT, Qos(depth=10), heard)
        writer = pair.there.writer("/suite/late", TEXT, Qos(depth=count))
        await matched(writer)
        for number in range(count):  # the event loop does nothing else meanwhile
            writer.write(text(str(number)))
        await eventually(lambda: len(heard.payloads) + reader.dropped >= count, timeout_s=TIMEOUT_S)
        assert len(heard.payloads) + reader.dropped == count
        assert reader.dropped > 0
        assert words(heard.payloads)[-1] == str(count - 1)

    async def test_many_may_wait_for_a_reader_until_the_writer_closes(self, pair: Pair) -> None:
        writer = pair.there.writer("/suite/matched", TEXT, Qos())
        waiting = [asyncio.create_task(matched(writer)) for _ in range(3)]
        await asyncio.sleep(0.05)
        assert not any(one.done() for one in waiting)
        pair.here.reader("/suite/matched", TEXT, Qos(), Heard())
        await asyncio.gather(*waiting)
        lonely = pair.there.writer("/suite/nobody", TEXT, Qos())
        waiting = [asyncio.create_task(matched(lonely)) for _ in range(3)]
        await asyncio.sleep(0.05)
        lonely.close()
        for one in (*waiting, lonely.matched()):
            with pytest.raises(NotConnectedError, match="/suite/nobody"):
                await one

    async def test_delivered_waits_for_who_reads(self, pair: Pair) -> None:
        heard = Heard()
        writer = pair.there.writer("/suite/delivered", TEXT, Qos())
        await writer.delivered(TIMEOUT_S)  # nobody has to be waited for
        pair.here.reader("/suite/delivered", TEXT, Qos(), heard)
        await matched(writer)
        for number in range(10):
            writer.write(text(str(number)))
        await writer.delivered(TIMEOUT_S)
        await heard.wait(10)

    async def test_a_peer_that_stands_still_blocks_nobody(
        self, network: tuple[Participation, Participation], types: Types
    ) -> None:
        part, other = network
        async with open_driver(self.driver, part, types) as here, self.member(other) as peer:
            writer = here.writer("/member/in", TEXT, Qos())
            await matched(writer)
            peer.send_signal(signal.SIGSTOP)
            longest_s = asyncio.create_task(longest_step())
            for _ in range(100):
                writer.write(text("x" * 100_000))
                await asyncio.sleep(0)
            if self.confirms:
                with pytest.raises(DeadlineError, match="/member/in"):
                    await writer.delivered(0.3)
            longest_s.cancel()
            assert await longest_s < 0.5

    async def test_names_and_types_are_checked(self, pair: Pair) -> None:
        with pytest.raises(NameMappingError):
            pair.here.reader("no/slash", TEXT, Qos(), Heard())
        with pytest.raises(NameMappingError):
            pair.here.writer("/7", TEXT, Qos())
        with pytest.raises(NameMappingError):
            pair.here.client("/a b", ADD)
        with pytest.raises(NameMappingError):
            pair.here.server("/", ADD, echo)

    # Services

    async def test_a_service_answers(self, pair: Pair) -> None:
        pair.there.server("/suite/add", ADD, add)
        client = pair.here.client("/suite/add", ADD)
        for number in range(5):
            assert await ask(client, number, 2) == number + 2

    async def test_each_of_many_callers_gets_its_answer(self, pair: Pair) -> None:
        async def slow(request: bytes) -> bytes:
            asked = cdr().decode(request, f"{ADD}_Request")
            await asyncio.sleep(0.01 * (asked["b"] % 3))  # answers overtake each other
            return await add(request)

        pair.there.server("/suite/add", ADD, slow)
        clients = [pair.here.client("/suite/add", ADD) for _ in range(2)]
        clients.append(pair.there.client("/suite/add", ADD))
        questions = [(client, a, b) for b in range(20) for a, client in enumerate(clients)]
        sums = await asyncio.gather(*(ask(client, a, b) for client, a, b in questions))
        assert sums == [a + b for _, a, b in questions]

    async def test_an_answer_that_does_not_come_is_a_deadline(self, pair: Pair) -> None:
        async def answer(request: bytes) -> bytes | None:
            asked = cdr().decode(request, f"{ADD}_Request")
            if asked["a"] == 1:
                return None
            if asked["a"] == 2:
                await asyncio.sleep(0.5)
            return cdr().encode({"sum": asked["b"]}, f"{ADD}_Response")

        pair.there.server("/suite/add", ADD, answer)
        client = pair.here.client("/suite/add", ADD)
        assert await ask(client, 0, 7) == 7
        for silent in (1, 2):
            began_s = time.monotonic()
            with pytest.raises(DeadlineError, match="/suite/add"):
                await ask(client, silent, 8, timeout_s=0.2)
            assert time.monotonic() - began_s < 1.5
        await asyncio.sleep(0.5)  # the late answer comes now, and must not be taken for this one
        assert await ask(client, 0, 9) == 9

    async def test_a_service_that_nobody_offers_is_told(self, pair: Pair) -> None:
        client = pair.here.client("/suite/nobody", ADD)
        with pytest.raises(NotConnectedError, match="/suite/nobody"):
            await ask(client, 1, 2)
        with pytest.raises(NotConnectedError, match="/suite/nobody"):
            await ask(client, 1, 2, timeout_s=0.1)

    async def test_a_service_that_comes_late_is_found(self, pair: Pair) -> None:
        client = pair.here.client("/suite/late", ADD)
        asking = asyncio.create_task(ask(client, 1, 2))
        await asyncio.sleep(0.1)
        pair.there.server("/suite/late", ADD, add)
        assert await asking == 3

    async def test_a_service_that_closes_is_gone(self, pair: Pair) -> None:
        server = pair.there.server("/suite/add", ADD, add)
        client = pair.here.client("/suite/add", ADD)
        assert await ask(client, 1, 2) == 3
        await eventually(lambda: pair.here.graph.service("/suite/add") is not None)
        server.close()
        await eventually(lambda: pair.here.graph.service("/suite/add") is None)
        with pytest.raises(NotConnectedError, match="/suite/add"):
            await ask(client, 1, 2)

    async def test_a_client_that_closes_ends_its_calls(self, pair: Pair) -> None:
        reached = asyncio.Event()

        async def never(_: bytes) -> None:
            reached.set()

        pair.there.server("/suite/add", ADD, never)
        client = pair.here.client("/suite/add", ADD)
        asking = asyncio.create_task(ask(client, 1, 2))
        async with asyncio.timeout(TIMEOUT_S):
            await reached.wait()
        client.close()
        with pytest.raises(NotConnectedError, match="/suite/add"):
            await asyncio.wait_for(asking, 1)
        with pytest.raises(NotConnectedError, match="/suite/add"):
            await ask(client, 1, 2)
        looking = pair.here.client("/suite/nobody", ADD)
        asking = asyncio.create_task(ask(looking, 1, 2))
        await asyncio.sleep(0.05)
        looking.close()
        with pytest.raises(NotConnectedError, match="/suite/nobody"):
            await asyncio.wait_for(asking, 1)

    async def test_the_parts_of_an_action_are_services_and_topics(self, pair: Pair) -> None:
        goal = {"goal_id": {"uuid": bytes(range(16))}, "goal": {"order": 5}}
        accept, feedback_type = f"{FIBONACCI}_SendGoal", f"{FIBONACCI}_FeedbackMessage"
        asked, heard = [], Heard()

        async def take(request: bytes) -> bytes:
            asked.append(cdr().decode(request, f"{accept}_Request"))
            return cdr().encode({"accepted": True}, f"{accept}_Response")

        pair.there.server("/suite/fibonacci/_action/send_goal", accept, take)
        told = pair.there.writer("/suite/fibonacci/_action/feedback", feedback_type, Qos())
        pair.here.reader("/suite/fibonacci/_action/feedback", feedback_type, Qos(), heard)
        client = pair.here.client("/suite/fibonacci/_action/send_goal", accept)
        reply = await client.call(cdr().encode(goal, f"{accept}_Request"), timeout_s=TIMEOUT_S)
        assert cdr().decode(reply, f"{accept}_Response")["accepted"] is True
        assert asked[0]["goal"]["order"] == 5
        assert bytes(asked[0]["goal_id"]["uuid"].data) == bytes(range(16))
        await matched(told)
        sent = cdr().encode({"feedback": {"sequence": [0, 1, 1]}}, feedback_type)
        told.write(sent)
        (got,) = await heard.wait(1)
        assert same(got, sent)
        graph, name = pair.here.graph, "/suite/fibonacci/_action/send_goal"
        await eventually(lambda: name in graph.services(), timeout_s=TIMEOUT_S)
        assert graph.services()[name].type == accept

    # The graph

    async def test_endpoints_are_seen_with_type_qos_hash_and_node(
        self, pair: Pair, types: Types
    ) -> None:
        offered = Qos(reliability="best_effort", durability="volatile", depth=5)
        changes: list[None] = []
        pair.here.on_graph(lambda: changes.append(None))
        pair.there.writer("/suite/seen", TEXT, offered)
        pair.there.reader("/suite/latched", TEXT, LATCHED, Heard())
        pair.there.server("/suite/add", ADD, echo)
        graph = pair.here.graph
        await eventually(
            lambda: bool(
                graph.writers("/suite/seen")
                and graph.readers("/suite/latched")
                and graph.services().get("/suite/add")
            ),
            timeout_s=TIMEOUT_S,
        )
        assert changes
        (writer,), (reader,) = graph.writers("/suite/seen"), graph.readers("/suite/latched")
        assert (writer.type, writer.qos.reliability) == (TEXT, "best_effort")
        assert writer.qos.durability == "volatile"
        assert (reader.type, reader.qos.durability) == (TEXT, "transient_local")
        assert writer.type_hash == reader.type_hash == types.hash_of(TEXT)
        assert graph.topics()["/suite/seen"] == {TEXT}
        assert graph.services()["/suite/add"].type == ADD
        assert graph.services()["/suite/add"].problem == ""
        await eventually(lambda: graph.node_of(writer) == "/suite/there", timeout_s=TIMEOUT_S)
        await eventually(lambda: graph.node_of(reader) == "/suite/there", timeout_s=TIMEOUT_S)
        assert "/suite/there" in graph.nodes()
        ours = {"/suite/seen", "/suite/latched"}
        assert ours.isdisjoint(pair.there.graph.topics()), "what is ours is not what others have"

    async def test_who_leaves_is_gone(
        self, network: tuple[Participation, Participation], types: Types
    ) -> None:
        part, other = network
        async with open_driver(self.driver, part, types) as here:
            async with open_driver(self.driver, other, types) as there:
                there.writer("/suite/gone", TEXT, Qos())
                there.server("/suite/add", ADD, echo)
                await eventually(
                    lambda: bool(here.graph.topics() and here.graph.services()),
                    timeout_s=TIMEOUT_S,
                )
                await eventually(lambda: here.graph.nodes() == ["/suite/there"])
            await eventually(
                lambda: not (here.graph.topics() or here.graph.services() or here.graph.nodes()),
                timeout_s=TIMEOUT_S,
            )

    async def test_who_dies_is_gone_and_may_come_again(
        self, network: tuple[Participation, Participation], types: Types
    ) -> None:
        part, other = network
        heard = Heard()
        async with open_driver(self.driver, part, types) as here:
            writer = here.writer("/member/in", TEXT, Qos())
            here.reader("/member/out", TEXT, Qos(), heard)
            client = here.client("/member/echo", ros2_member.ECHO)
            sent = text("back and forth")
            for dies in (True, False):
                async with self.member(other) as peer:
                    await eventually(
                        lambda: len(here.graph.writers("/member/out")) == 1, timeout_s=TIMEOUT_S
                    )
                    await matched(writer)
                    heard.payloads.clear()
                    await until_heard(heard, lambda: writer.write(sent))
                    assert same(heard.payloads[0], sent)
                    request = cdr().encode({}, f"{ros2_member.ECHO}_Request")
                    assert await client.call(request, timeout_s=TIMEOUT_S)
                    if dies:
                        peer.kill()
                await eventually(
                    lambda: not (here.graph.writers("/member/out") or here.graph.nodes()),
                    timeout_s=MISSED_WITHIN_S,
                )

    async def test_closing_is_harmless_when_repeated(
        self, network: tuple[Participation, Participation], types: Types
    ) -> None:
        part, other = network
        async with open_driver(self.driver, part, types) as here:
            async with open_driver(self.driver, other, types) as there:
                reader = there.reader("/suite/close", TEXT, Qos(), Heard())
                writer = there.writer("/suite/close", TEXT, Qos())
                ends = [
                    reader,
                    writer,
                    there.client("/suite/add", ADD),
                    there.server("/suite/add", ADD, echo),
                ]
                left_open = there.writer("/suite/open", TEXT, Qos())
                await eventually(lambda: bool(here.graph.topics()), timeout_s=TIMEOUT_S)
                for one in [*ends, *ends]:
                    one.close()
            for one in ends:
                one.close()
            assert (reader.mismatch, reader.dropped, writer.mismatch) == ("", 0, "")
            left_open.close()
            with pytest.raises(TransportError):
                left_open.write(text("too late"))


async def matched(writer: Writer) -> None:
    """Wait until somebody reads, but not for ever."""
    await asyncio.wait_for(writer.matched(), TIMEOUT_S)


async def longest_step() -> float:
    """Return how long the event loop was away at most, until this is cancelled."""
    longest_s, before_s = 0.0, time.monotonic()
    while True:
        try:
            await asyncio.sleep(0.01)
        except asyncio.CancelledError:
            return longest_s
        now_s = time.monotonic()
        longest_s, before_s = max(longest_s, now_s - before_s), now_s


async def until_heard(heard: Heard, write: Callable[[], None]) -> None:
    """Write again and again until it is heard: that we are matched says nothing of the other."""
    async with asyncio.timeout(TIMEOUT_S):
        while not heard.payloads:
            write()
            await asyncio.sleep(0.02)


def text(data: str) -> bytes:
    """Return a `std_msgs/msg/String`."""
    return cdr().encode({"data": data}, TEXT)


def words(payloads: list[bytes]) -> list[str]:
    """Return what several `std_msgs/msg/String` say."""
    return [cdr().decode(payload, TEXT)["data"] for payload in payloads]


async def ask(client: Client, a: int, b: int, *, timeout_s: float = TIMEOUT_S) -> int:
    """Call the service that adds two numbers."""
    request = cdr().encode({"a": a, "b": b}, f"{ADD}_Request")
    reply = await client.call(request, timeout_s=timeout_s)
    return int(cdr().decode(reply, f"{ADD}_Response")["sum"])


async def add(request: bytes) -> bytes:
    """Answer with the sum."""
    asked = cdr().decode(request, f"{ADD}_Request")
    return cdr().encode({"sum": asked["a"] + asked["b"]}, f"{ADD}_Response")


async def echo(request: bytes) -> bytes:
    """Answer with the question."""
    return request
