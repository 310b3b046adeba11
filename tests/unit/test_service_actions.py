"""Actions that a service serves: goals, feedback, results, cancelling, and what goes wrong."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from pydantic_settings import SettingsConfigDict

from vertebra.bus import Closeable, Delivery, MemoryBus, MemoryNetwork, Reply, Request
from vertebra.codec import CodecRegistry
from vertebra.errors import CommandRefusedError, DecodeError, NotConnectedError, RemoteError
from vertebra.goals import MAX_ENDED
from vertebra.messages import Native
from vertebra.service import (
    Context,
    Feedback,
    MessageReader,
    ServiceSettings,
    actions,
    run_service,
    serve_action,
)


class CounterSettings(ServiceSettings):
    """What these tests need."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_COUNTER_")


class Count(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A goal: count up to `order`, and then wait to be let go."""

    order: int
    then: str = ""


class Counted(msgspec.Struct, frozen=True):
    numbers: list[int]


async def count(goal: Count, feedback: Feedback) -> Counted:
    numbers: list[int] = []
    for number in range(goal.order):
        numbers.append(number)
        feedback(Counted(numbers))
    if goal.then == "fail":
        raise NotConnectedError("the abacus is lost")
    if goal.then == "break":
        raise ZeroDivisionError("a bug")
    try:
        if goal.then:
            await asyncio.get_running_loop().create_future()
    except asyncio.CancelledError:
        if goal.then == "forever":
            raise
    return Counted(numbers)


def few(goal: Count) -> None:
    if goal.order > 5:
        raise CommandRefusedError(f"{goal.order} is too many")


class Caller:
    """The other side of the action `lab/count`."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.bus = MemoryBus(network)

    async def call(self, name: str, document: object, timeout_s: float = 5) -> Any:
        payload = document if isinstance(document, bytes) else json.dumps(document).encode()
        reply = await self.bus.call(f"lab/count/{name}", payload, timeout_s=timeout_s)
        assert reply.encoding == "application/json"
        return json.loads(reply.payload)


@asynccontextmanager
async def counting(**how: Any) -> AsyncIterator[tuple[Caller, asyncio.Task[None]]]:
    network = MemoryNetwork()
    started = asyncio.Event()

    async def serve(context: Context[CounterSettings]) -> None:
        serve_action(context, "lab/count", count, Count, **how)
        context.ready()
        started.set()
        await asyncio.get_running_loop().create_future()

    service = asyncio.create_task(
        run_service("counter", CounterSettings(), serve, bus=MemoryBus(network))
    )
    caller = Caller(network)
    try:
        async with asyncio.timeout(5):
            await started.wait()
        yield caller, service
    finally:
        service.cancel()
        await asyncio.wait([service])
        await caller.bus.close()


@pytest.fixture(autouse=True)
def beats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))


async def test_goal_is_followed_to_its_result() -> None:
    async with counting() as (caller, _):
        told = caller.bus.subscribe("lab/count/feedback", Delivery.queue(8))
        started = await caller.call("goal", {"order": 2})
        ended = await caller.call("result", started)
        again = await caller.call("result", started)
        reader = MessageReader(told, CodecRegistry(), Native)
        seen = [reader.read(sample).message.value for sample in iter(told.take, None)]
    assert ended == again == {"status": "succeeded", "result": {"numbers": [0, 1]}}
    goal_id = started["goal_id"]
    assert len(bytes.fromhex(goal_id)) == 16
    assert seen == [
        {"goal_id": goal_id, "feedback": {"numbers": [0]}},
        {"goal_id": goal_id, "feedback": {"numbers": [0, 1]}},
    ]


async def test_cancelled_goal_ends_and_others_go_on() -> None:
    async with counting() as (caller, _):
        one = await caller.call("goal", {"order": 0, "then": "forever"})
        other = await caller.call("goal", {"order": 0, "then": "forever"})
        assert await caller.call("cancel", one) == {"cancelling": [one["goal_id"]]}
        assert await caller.call("result", one) == {"status": "canceled", "result": {}}
        with pytest.raises((RemoteError, TimeoutError)):
            await caller.call("result", other, timeout_s=0.05)
        with pytest.raises(RemoteError, match="has ended already: canceled"):
            await caller.call("cancel", one)


async def test_all_goals_are_cancelled_at_once() -> None:
    async with counting() as (caller, _):
        goals = [await caller.call("goal", {"order": 1, "then": "forever"}) for _ in range(3)]
        cancelled = await caller.call("cancel", {})
        assert cancelled == {"cancelling": [goal["goal_id"] for goal in goals]}
        ended = [await caller.call("result", goal) for goal in goals]
        assert await caller.call("cancel", b"") == {"cancelling": []}
    assert [end["status"] for end in ended] == ["canceled"] * 3


async def test_goal_that_is_cancelled_before_its_first_step_ends() -> None:
    async with counting() as (caller, _):
        started, cancelled = await asyncio.gather(
            caller.call("goal", {"order": 0, "then": "forever"}), caller.call("cancel", {})
        )
        await caller.call("cancel", {})
        assert cancelled["cancelling"] in ([], [started["goal_id"]])
        assert (await caller.call("result", started))["status"] == "canceled"


async def test_cancelled_goal_may_have_a_result() -> None:
    async with counting() as (caller, _):
        started = await caller.call("goal", {"order": 2, "then": "until cancelled"})
        await caller.call("cancel", started)
        ended = await caller.call("result", started)
    assert ended == {"status": "canceled", "result": {"numbers": [0, 1]}}


@pytest.mark.parametrize(
    ("then", "reason"),
    [("fail", "the abacus is lost"), ("break", "ZeroDivisionError: a bug")],
)
async def test_failed_goal_is_aborted_with_the_reason(then: str, reason: str) -> None:
    async with counting() as (caller, service):
        started = await caller.call("goal", {"order": 1, "then": then})
        ended = await caller.call("result", started)
        assert not service.done()
    assert ended == {"status": "aborted", "result": {}, "reason": reason}


@pytest.mark.parametrize(
    ("name", "document", "told"),
    [
        ("goal", {"order": 6}, "6 is too many"),
        ("goal", {"order": "six"}, r"Expected `int`, got `str` - at `\$.order`"),
        ("goal", {"ordr": 6}, "unknown field `ordr`"),
        ("goal", b"{", "this is no goal of lab/count"),
        ("result", {}, "say which goal"),
        ("result", {"goal_id": "5"}, "'5' is no goal_id"),
        ("result", {"goal_id": 5}, "5 is no goal_id"),
        ("result", {"goal_id": "0" * 32}, f"lab/count does not know the goal {'0' * 32}"),
        ("cancel", {"goal_id": "0" * 32}, f"lab/count does not know the goal {'0' * 32}"),
        ("cancel", b"[]", "this is no JSON object"),
    ],
)
async def test_mistake_is_refused(name: str, document: object, told: str) -> None:
    async with counting(accept=few) as (caller, _):
        with pytest.raises(RemoteError, match=told) as caught:
            await caller.call(name, document)
    assert caught.value.kind == "CommandRefusedError"


async def test_too_many_goals_at_once_are_refused() -> None:
    async with counting(max_active=1) as (caller, _):
        started = await caller.call("goal", {"order": 0, "then": "forever"})
        with pytest.raises(RemoteError, match="lab/count is busy") as caught:
            await caller.call("goal", {"order": 0})
        assert caught.value.kind == "BusyError"
        await caller.call("cancel", started)
        await caller.call("result", started)
        await caller.call("goal", {"order": 0})


async def test_old_results_are_forgotten() -> None:
    async with counting() as (caller, _):
        first = await caller.call("goal", {"order": 0})
        for _ in range(MAX_ENDED + 1):
            started = await caller.call("goal", {"order": 0})
            await caller.call("result", started)
        with pytest.raises(RemoteError, match="does not know the goal"):
            await caller.call("result", first)


async def test_service_that_stops_ends_its_goals() -> None:
    async with counting() as (caller, service):
        await caller.call("goal", {"order": 0, "then": "forever"})
        service.cancel()
        await asyncio.wait([service], timeout=2)
        assert service.cancelled()


class Elsewhere:
    """The call `lab/count/result` of a service that answers, waits, comes and goes as told."""

    def __init__(self) -> None:
        self.bus = MemoryBus(MemoryNetwork())
        self.served: Closeable | None = None
        self.asked = 0
        self.ended = asyncio.Event()

    def come(self, answer: bytes = b'{"status": "succeeded", "result": {"numbers": [1]}}') -> None:
        async def result(request: Request) -> Reply:
            assert json.loads(request.payload) == {"goal_id": GOAL}
            self.asked += 1
            await self.ended.wait()
            return Reply(payload=answer, encoding="application/json")

        self.served = self.bus.serve("lab/count/result", result)

    def go(self) -> None:
        assert self.served is not None
        self.served.close()

    async def outcome(self) -> actions.Outcome:
        async with asyncio.timeout(5):
            return await actions.outcome_of(self.bus, "lab/count", GOAL)


GOAL = "7" * 32
REACHED = actions.Outcome(status="succeeded", result={"numbers": [1]})


@pytest.fixture
async def elsewhere(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Elsewhere]:
    monkeypatch.setattr(actions, "ASK_AGAIN_S", 0.05)
    monkeypatch.setattr(actions, "LOOK_AGAIN_S", 0.02)
    monkeypatch.setattr(actions, "GONE_AFTER_S", 0.3)
    other = Elsewhere()
    yield other
    await other.bus.close()


async def test_outcome_is_waited_for_longer_than_a_call(elsewhere: Elsewhere) -> None:
    elsewhere.come()
    waiting = asyncio.create_task(elsewhere.outcome())
    await asyncio.sleep(0.4)
    assert elsewhere.asked > 2
    elsewhere.ended.set()
    assert await waiting == REACHED


async def test_service_may_be_away_for_a_moment(elsewhere: Elsewhere) -> None:
    elsewhere.come()
    waiting = asyncio.create_task(elsewhere.outcome())
    await asyncio.sleep(0.1)
    elsewhere.go()
    await asyncio.sleep(0.1)
    elsewhere.ended.set()
    elsewhere.come()
    assert await waiting == REACHED


async def test_outcome_of_a_service_that_went_away_is_not_waited_for(
    elsewhere: Elsewhere,
) -> None:
    with pytest.raises(NotConnectedError, match="nobody serves 'lab/count/result'"):
        await elsewhere.outcome()


@pytest.mark.parametrize(
    "answer", [b"{}", b"[]", b'{"status": "executing", "result": {}}', b'{"status": "aborted"}']
)
async def test_answer_that_is_no_outcome_is_refused(elsewhere: Elsewhere, answer: bytes) -> None:
    elsewhere.ended.set()
    elsewhere.come(answer)
    with pytest.raises(DecodeError, match="lab/count/result answered no outcome"):
        await elsewhere.outcome()


async def test_outcome_of_a_goal_that_a_new_service_does_not_know_is_an_error() -> None:
    async with counting() as (caller, _):
        with pytest.raises(RemoteError, match="lab/count does not know the goal"):
            await actions.outcome_of(caller.bus, "lab/count", GOAL)
