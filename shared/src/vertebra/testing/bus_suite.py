"""The behaviour of every `Bus`; an implementation subclasses `BusSuite` in its tests."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Iterator

import pytest

from vertebra.bus import Bus, Delivery, Priority, Reply, Request, Sample, Subscription
from vertebra.errors import (
    CommandRefusedError,
    DeadlineError,
    NameMappingError,
    NotConnectedError,
    RemoteError,
)

TIMEOUT_S = 5.0


class Pieces:
    """A payload in pieces, as an encoded frame is."""

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = pieces
        self.nbytes = sum(len(piece) for piece in pieces)

    def parts(self) -> Iterator[bytes | memoryview]:
        """Yield bytes and memory views in turn."""
        for index, piece in enumerate(self._pieces):
            yield memoryview(piece) if index % 2 else piece


async def take(subscription: Subscription[Sample], count: int) -> list[Sample]:
    """Return the next samples; fail if they do not come."""
    async with asyncio.timeout(TIMEOUT_S):
        return [await anext(subscription) for _ in range(count)]


async def eventually(condition: Callable[[], bool], *, timeout_s: float = TIMEOUT_S) -> None:
    """Wait until a condition that nobody signals becomes true; fail if it does not."""
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110  - there is no event to wait for
            await asyncio.sleep(0.01)


class BusSuite(ABC):
    """What publishers, subscribers, servers and callers may rely on."""

    @abstractmethod
    def buses(self) -> AsyncIterator[tuple[Bus, Bus]]:
        """Yield two connected members of one network, then close them."""

    @pytest.fixture
    async def pair(self) -> AsyncIterator[tuple[Bus, Bus]]:
        """Two connected members of one network."""
        async for pair in self.buses():
            yield pair

    async def reach(self, here: Bus, there: Bus) -> None:
        """Wait until declarations of `here` are known to `there`."""
        marker = here.declare_presence("suite/reach")
        async with there.presence("suite/reach") as presence, asyncio.timeout(TIMEOUT_S):
            while not (await anext(presence)).present:
                pass
        marker.close()

    async def test_samples_arrive_in_order_with_key_encoding_and_time(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair
        async with there.subscribe("suite/*/stream", Delivery.queue(100)) as subscription:
            await self.reach(there, here)
            publisher = here.publisher("suite/a/stream", encoding="text/plain")
            for number in range(50):
                publisher.put(b"%d" % number)
            samples = await take(subscription, 50)
        assert [sample.payload for sample in samples] == [b"%d" % number for number in range(50)]
        assert {(sample.key, sample.encoding) for sample in samples} == {
            ("suite/a/stream", "text/plain")
        }
        assert all(sample.sent_ns > 10**18 for sample in samples)
        assert (subscription.received, subscription.dropped, subscription.lost) == (50, 0, 0)

    async def test_encoding_with_schema_survives(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair
        encoding = "application/vnd.vertebra.frame;Image/1"
        async with there.subscribe("suite/encoding", Delivery.queue(4)) as subscription:
            await self.reach(there, here)
            publisher = here.publisher("suite/encoding", encoding=encoding)
            publisher.put(b"x")
            publisher.put(b"{}", encoding="application/json")
            samples = await take(subscription, 2)
        assert [sample.encoding for sample in samples] == [encoding, "application/json"]

    @pytest.mark.parametrize("nbytes", [0, 1, 100_000, 6_220_800])
    async def test_payloads_of_any_size_in_pieces(self, pair: tuple[Bus, Bus], nbytes: int) -> None:
        here, there = pair
        body = bytes(range(256)) * (nbytes // 256) + bytes(nbytes % 256)
        async with there.subscribe("suite/large", Delivery.queue(4)) as subscription:
            await self.reach(there, here)
            publisher = here.publisher("suite/large", encoding="", priority=Priority.BULK)
            publisher.put(Pieces(body[:100], body[100:]))
            (sample,) = await take(subscription, 1)
        assert sample.payload == body

    async def test_latest_keeps_the_newest_of_each_key_and_counts_the_rest(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair
        async with there.subscribe("suite/latest/*", Delivery.latest()) as subscription:
            await self.reach(there, here)
            one = here.publisher("suite/latest/one", encoding="")
            two = here.publisher("suite/latest/two", encoding="")
            for number in range(10):
                one.put(b"%d" % number)
            two.put(b"only")
            await eventually(lambda: subscription.received == 11)
            samples = await take(subscription, 2)
        assert {sample.key: sample.payload for sample in samples} == {
            "suite/latest/one": b"9",
            "suite/latest/two": b"only",
        }
        assert subscription.dropped == 9

    async def test_full_queue_refuses_the_new_and_says_so(
        self, pair: tuple[Bus, Bus], caplog: pytest.LogCaptureFixture
    ) -> None:
        here, there = pair
        async with there.subscribe("suite/queue", Delivery.queue(3)) as subscription:
            await self.reach(there, here)
            publisher = here.publisher("suite/queue", encoding="")
            for number in range(10):
                publisher.put(b"%d" % number)
            await eventually(lambda: subscription.received == 10)
            samples = await take(subscription, 3)
        assert [sample.payload for sample in samples] == [b"0", b"1", b"2"]
        assert subscription.dropped == 7
        assert [record.levelname for record in caplog.records].count("ERROR") == 1

    async def test_closed_subscription_ends_its_iteration(self, pair: tuple[Bus, Bus]) -> None:
        here, _ = pair
        subscription = here.subscribe("suite/closed", Delivery.latest())
        waiter = asyncio.create_task(anext(subscription, None))
        await asyncio.sleep(0)
        subscription.close()
        subscription.close()
        assert await asyncio.wait_for(waiter, TIMEOUT_S) is None

    @pytest.mark.parametrize("followed", ["suite/wanted/a", "suite/*/a"])
    async def test_demand_is_told_when_it_begins_and_ends(
        self, pair: tuple[Bus, Bus], followed: str
    ) -> None:
        here, there = pair
        told: list[bool] = []
        demand = here.follow_demand(followed, told.append)
        first = there.subscribe("suite/**", Delivery.latest())
        await eventually(lambda: told == [True])
        second = there.subscribe("suite/wanted/a", Delivery.latest())
        first.close()
        await self.reach(there, here)
        assert told == [True]
        second.close()
        await eventually(lambda: told == [True, False])
        demand.close()
        demand.close()
        async with there.subscribe("suite/wanted/a", Delivery.latest()):
            await self.reach(there, here)
        assert told == [True, False]

    async def test_demand_that_was_there_before_is_told(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair
        told: list[bool] = []
        async with there.subscribe("suite/wanted", Delivery.latest()):
            await self.reach(there, here)
            here.follow_demand("suite/wanted", told.append)
            await eventually(lambda: told == [True])

    async def test_call_is_answered(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair
        seen: list[Request] = []

        async def handler(request: Request) -> Reply:
            seen.append(request)
            return Reply(payload=request.payload.upper(), encoding="text/plain")

        served = there.serve("suite/echo", handler)
        await self.reach(there, here)
        reply = await here.call("suite/echo", b"abc", encoding="text/x-a", timeout_s=TIMEOUT_S)
        assert reply == Reply(payload=b"ABC", encoding="text/plain", key="suite/echo")
        assert (seen[0].key, seen[0].encoding) == ("suite/echo", "text/x-a")
        assert 0 < seen[0].timeout_s <= TIMEOUT_S
        served.close()

    async def test_error_of_the_handler_reaches_the_caller_with_its_kind(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair

        async def handler(_: Request) -> Reply:
            raise CommandRefusedError("neck_yaw goes to 30 deg, not to 99")

        there.serve("suite/refuse", handler)
        await self.reach(there, here)
        with pytest.raises(RemoteError, match="not to 99") as caught:
            await here.call("suite/refuse", timeout_s=TIMEOUT_S)
        assert caught.value.kind == "CommandRefusedError"

    async def test_bug_in_a_handler_is_an_error_reply_and_the_server_lives(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair

        async def handler(request: Request) -> Reply:
            return Reply(payload=b"%d" % (10 // len(request.payload)), encoding="")

        there.serve("suite/bug", handler)
        await self.reach(there, here)
        with pytest.raises(RemoteError, match="ZeroDivisionError"):
            await here.call("suite/bug", timeout_s=TIMEOUT_S)
        assert (await here.call("suite/bug", b"ab", timeout_s=TIMEOUT_S)).payload == b"5"

    async def test_call_to_nobody_fails_at_once(self, pair: tuple[Bus, Bus]) -> None:
        here, _ = pair
        async with asyncio.timeout(TIMEOUT_S):
            with pytest.raises(NotConnectedError, match="nobody serves 'suite/nobody'"):
                await here.call("suite/nobody", timeout_s=60.0)

    async def test_late_handler_is_cancelled_and_the_caller_told(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair
        cancelled = asyncio.Event()

        async def handler(_: Request) -> Reply:
            try:
                await asyncio.sleep(60)
            finally:
                cancelled.set()
            raise AssertionError

        there.serve("suite/late", handler)
        await self.reach(there, here)
        with pytest.raises((DeadlineError, RemoteError)):
            await here.call("suite/late", timeout_s=0.3)
        await asyncio.wait_for(cancelled.wait(), TIMEOUT_S)

    async def test_too_many_calls_are_refused_not_queued(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair
        release = asyncio.Event()

        async def handler(_: Request) -> Reply:
            await release.wait()
            return Reply(payload=b"", encoding="")

        there.serve("suite/busy", handler, depth=2)
        await self.reach(there, here)
        calls = [
            asyncio.create_task(here.call("suite/busy", timeout_s=TIMEOUT_S)) for _ in range(5)
        ]
        await eventually(lambda: sum(call.done() for call in calls) == 3)
        release.set()
        outcomes = await asyncio.gather(*calls, return_exceptions=True)
        refused = [outcome for outcome in outcomes if isinstance(outcome, RemoteError)]
        assert [error.kind for error in refused] == ["BusyError"] * 3

    async def test_query_reaches_everyone(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair

        async def answer(request: Request) -> Reply:
            return Reply(payload=request.key.encode(), encoding="text/plain")

        async def refuse(_: Request) -> Reply:
            raise CommandRefusedError("not me")

        there.serve("suite/all/a", answer)
        here.serve("suite/all/b", answer)
        there.serve("suite/all/c", refuse)
        await self.reach(there, here)
        replies = [reply async for reply in here.query("suite/all/*", timeout_s=TIMEOUT_S)]
        assert sorted((reply.key, reply.payload) for reply in replies) == [
            ("suite/all/a", b"suite/all/a"),
            ("suite/all/b", b"suite/all/b"),
        ]

    async def test_presence_shows_history_arrival_and_departure(
        self, pair: tuple[Bus, Bus]
    ) -> None:
        here, there = pair
        early = there.declare_presence("@vertebra/suite/early")
        await self.reach(there, here)
        async with here.presence("@vertebra/suite/*") as presence, asyncio.timeout(TIMEOUT_S):
            assert (await anext(presence)).key == "@vertebra/suite/early"
            late = there.declare_presence("@vertebra/suite/late")
            event = await anext(presence)
            assert (event.key, event.present) == ("@vertebra/suite/late", True)
            early.close()
            early.close()
            event = await anext(presence)
            assert (event.key, event.present) == ("@vertebra/suite/early", False)
            late.close()

    async def test_control_keys_are_hidden_from_wildcards(self, pair: tuple[Bus, Bus]) -> None:
        here, there = pair
        async with there.subscribe("**", Delivery.queue(10)) as subscription:
            await self.reach(there, here)
            here.publisher("@vertebra/hidden", encoding="").put(b"hidden")
            here.publisher("suite/visible", encoding="").put(b"visible")
            (sample,) = await take(subscription, 1)
        assert sample.payload == b"visible"

    @pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a b", "a#", "a?", "a/*", "a/$b"])
    async def test_bad_keys_are_refused_at_the_edge(self, pair: tuple[Bus, Bus], key: str) -> None:
        here, _ = pair
        with pytest.raises(NameMappingError):
            here.publisher(key, encoding="")
        with pytest.raises(NameMappingError):
            await here.call(key, timeout_s=1.0)

    async def test_closed_bus_refuses_everything(self, pair: tuple[Bus, Bus]) -> None:
        here, _ = pair
        publisher = here.publisher("suite/closed", encoding="")
        subscription = here.subscribe("suite/closed", Delivery.latest())
        await here.close()
        await here.close()
        assert [sample async for sample in subscription] == []
        with pytest.raises(NotConnectedError):
            publisher.put(b"")
        with pytest.raises(NotConnectedError):
            here.subscribe("suite/closed", Delivery.latest())
        with pytest.raises(NotConnectedError):
            await here.call("suite/closed", timeout_s=1.0)
        assert not here.info().connected
