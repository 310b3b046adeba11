"""Actions both ways: of ROS nodes on the backbone, and of the fleet on ROS."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from pydantic_settings import SettingsConfigDict

from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.messages import Native
from vertebra.service import Context, Feedback, ServiceSettings, run_service, serve_action
from vertebra_ros2 import actions

from .ros2_lab import DOMAINS, Lab, adapter, drain, first, lab_with, peer

pytestmark = pytest.mark.live

OFFERED = """
actions:
  - {ros: /fleet_count, key: fleet/count, type: example_interfaces/action/Fibonacci,
     direction: outbound, timeout_s: 2}
"""
INBOUND = "actions: [{ros: /fibonacci, key: robot/count}]"
REOFFERED = """
actions:
  - {ros: /fibonacci, key: robot/count}
  - {ros: /fleet_count, key: robot/count, type: example_interfaces/action/Fibonacci,
     direction: outbound}
"""
EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 2, 3, 4, 5, 6


class CounterSettings(ServiceSettings):
    """What these tests need."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_COUNTER_")


class Fibonacci(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    order: int


async def fibonacci(goal: Fibonacci, feedback: Feedback) -> dict[str, Any]:
    """Count as the example of rclpy does; a cancelled goal has what was reached as its result."""
    numbers = [0, 1]
    try:
        while len(numbers) <= goal.order:
            numbers.append(min(numbers[-1] + numbers[-2], 2**31 - 1))
            feedback({"sequence": numbers})
            await asyncio.sleep(0.02)
    except asyncio.CancelledError:
        await asyncio.sleep(0.2)  # nothing stops at once
    return {"sequence": numbers}


async def failing(goal: Fibonacci, feedback: Feedback) -> None:
    feedback({"sequence": [goal.order]})
    raise CommandRefusedError("the abacus is lost")


async def wrong(_: Fibonacci, feedback: Feedback) -> dict[str, Any]:
    feedback({"no such field": 1})
    return {"sequence": "no numbers"}


def positive(goal: Fibonacci) -> None:
    if goal.order < 0:
        raise CommandRefusedError(f"an order is positive, not {goal.order}")


@asynccontextmanager
async def counter(
    lab: Lab, run: Callable[[Fibonacci, Feedback], Awaitable[object]] = fibonacci
) -> AsyncIterator[None]:
    """Run the fleet service that offers the action."""
    started = asyncio.Event()

    async def serve(context: Context[CounterSettings]) -> None:
        serve_action(context, "fleet/count", run, Fibonacci, accept=positive)
        context.ready()
        started.set()
        await asyncio.get_running_loop().create_future()

    bus = MemoryBus(lab.bus.network)
    service = asyncio.create_task(run_service("counter", CounterSettings(), serve, bus=bus))
    await started.wait()
    try:
        yield
    finally:
        service.cancel()
        await asyncio.wait([service])


async def test_ros_client_has_its_goal_reached_by_the_fleet(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "5") as client,
    ):
        _, accepted, stamp_s, goal_id = await client.until("accepted")
        feedback = await client.until("feedback")
        ended = await client.until("result")
        await client.until("status", [EXECUTING])
        await client.until("status", [SUCCEEDED])
    assert accepted is True
    assert abs(stamp_s - time.time()) < 30
    assert feedback == ["feedback", goal_id, [0, 1, 1]]
    assert ended == ["result", SUCCEEDED, [0, 1, 1, 2, 3, 5]]


@pytest.mark.parametrize("meant", ["cancel", "cancel_all"])
async def test_ros_client_cancels_its_goal(tmp_path: Path, meant: str) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "100000", meant) as client,
    ):
        assert await client.until("cancel") == ["cancel", 0, [True]]
        _, status, numbers = await client.until("result")
        await client.until("status", [CANCELING])
        await client.until("status", [CANCELED])
    assert (status, numbers[:3]) == (CANCELED, [0, 1, 1])


async def test_goal_that_has_ended_is_not_cancelled_and_keeps_its_result(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "2", "late") as client,
    ):
        ended = await client.until("result")
        assert await client.until("cancel") == ["cancel", 3, 0]
        assert await client.until("result") == ended == ["result", SUCCEEDED, [0, 1, 1]]


async def test_unknown_goal_is_told_as_such(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "2", "unknown") as client,
    ):
        assert await client.until("cancel") == ["cancel", 2, 0]
        assert await client.until("result") == ["result", 0, []]


async def test_goal_is_accepted_once(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "2", "twice") as client,
    ):
        assert (await client.until("accepted"))[1] is True
        assert await client.until("accepted") == ["accepted", False, 0]
        assert (await client.until("result"))[1] == SUCCEEDED


async def test_goal_that_the_fleet_refuses_is_not_accepted(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab),
        peer(lab, "act", "fleet_count", "-1") as client,
    ):
        assert (await client.until("accepted"))[1:3] == [False, 0]
        assert await client.until("result") == ["result", 0, []]
        text = await lab.told(lambda text: "refused a goal" in text)
    assert "an order is positive, not -1" in text


async def test_goal_for_nobody_is_not_accepted(tmp_path: Path) -> None:
    async with lab_with(tmp_path, OFFERED) as lab:
        async with peer(lab, "act", "fleet_count", "1") as client:
            assert (await client.until("accepted"))[1] is False
            await lab.told(lambda text: "refused a goal: nobody serves 'fleet/count/goal'" in text)
        async with counter(lab), peer(lab, "act", "fleet_count", "1") as client:
            assert (await client.until("accepted"))[1] is True
            await lab.told(lambda text: "refused a goal" not in text)


@pytest.mark.parametrize(
    ("run", "reason"),
    [(failing, "the abacus is lost"), (wrong, "GetResult_Response.result.sequence")],
)
async def test_goal_that_fails_is_aborted(tmp_path: Path, run: Any, reason: str) -> None:
    async with (
        lab_with(tmp_path, OFFERED) as lab,
        counter(lab, run),
        peer(lab, "act", "fleet_count", "1") as client,
    ):
        assert await client.until("result") == ["result", ABORTED, []]
        await lab.told(lambda text: reason in text)


async def test_goal_of_a_service_that_goes_away_is_aborted(tmp_path: Path) -> None:
    async with lab_with(tmp_path, OFFERED) as lab:
        async with counter(lab):
            client_of = peer(lab, "act", "fleet_count", "100000")
            client = await client_of.__aenter__()
            await client.until("feedback")
        assert (await client.until("result"))[1] == ABORTED
        await client_of.__aexit__(None, None, None)


async def test_goals_of_an_adapter_that_stops_are_cancelled(tmp_path: Path) -> None:
    ended: list[str] = []

    async def endless(_: Fibonacci, feedback: Feedback) -> None:
        try:
            while True:
                feedback({"sequence": [1]})
                await asyncio.sleep(0.02)
        except asyncio.CancelledError:
            ended.append("cancelled")
            raise

    network = MemoryNetwork()
    file = tmp_path / "routes.yaml"
    file.write_text(OFFERED)
    async with (
        adapter(network, next(DOMAINS), file) as lab,
        counter(lab, endless),
        peer(lab, "act", "fleet_count", "1") as client,
    ):
        await client.until("feedback")
        lab.service.cancel()
        await asyncio.wait([lab.service])
        await asyncio.sleep(0.05)
        assert ended == ["cancelled"]


async def test_action_of_a_ros_node_is_offered_again(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, REOFFERED) as lab,
        peer(lab, "count_up") as server,
    ):
        await server.until("ready")
        await lab.told(lambda text: "nobody offers" not in text)
        async with peer(lab, "act", "fleet_count", "6") as client:
            goal_id = (await client.until("accepted"))[3]
            assert (await client.until("feedback"))[1] == goal_id
            assert await client.until("result") == ["result", SUCCEEDED, [0, 1, 1, 2, 3, 5, 8]]
        async with peer(lab, "act", "fleet_count", "100000", "cancel") as client:
            assert await client.until("cancel") == ["cancel", 0, [True]]
            assert (await client.until("result"))[1] == CANCELED
            await server.until("cancelled")


async def test_replies_reach_clients_that_ask_at_once(tmp_path: Path) -> None:
    """A client asks as soon as it sees us; we hold the reply until we see its reader, too."""
    async with lab_with(tmp_path, OFFERED) as lab, counter(lab):
        for _ in range(5):
            async with peer(lab, "act", "fleet_count", "1") as client:
                assert (await client.until("accepted"))[1] is True
                assert (await client.until("result"))[1] == SUCCEEDED


async def test_goal_of_nobodys_knowledge_is_withdrawn(tmp_path: Path) -> None:
    async with lab_with(tmp_path, INBOUND) as lab, peer(lab, "count_up", "deaf") as server:
        await server.until("ready")
        await lab.told(lambda text: "action /fibonacci" not in text)
        with pytest.raises((RemoteError, TimeoutError)):
            await lab.call("robot/count/goal", {"order": 100000}, timeout_s=1)
        await server.until("cancelled")


async def test_goal_that_is_being_sent_is_withdrawn_when_the_adapter_stops(tmp_path: Path) -> None:
    async with lab_with(tmp_path, INBOUND) as lab, peer(lab, "count_up", "deaf") as server:
        await server.until("ready")
        feedback = lab.read("robot/count/feedback", Native)
        await lab.told(lambda text: "action /fibonacci" not in text)
        sending = asyncio.create_task(lab.call("robot/count/goal", {"order": 100000}))
        await first(feedback)
        lab.service.cancel()
        await asyncio.wait([lab.service])
        await server.until("cancelled")
        with pytest.raises(RemoteError, match="its service stops"):
            await sending


async def test_result_is_waited_for_again_and_kept(tmp_path: Path) -> None:
    async with lab_with(tmp_path, INBOUND) as lab:
        async with peer(lab, "count_up") as server:
            await server.until("ready")
            started = await lab.call("robot/count/goal", {"order": 20})
            with pytest.raises((RemoteError, TimeoutError)):
                await lab.call("robot/count/result", started, timeout_s=0.1)
            ended = await lab.call("robot/count/result", started)
        # The server is gone, as rclcpp's would have forgotten it 10 s after the goal ended.
        assert await lab.call("robot/count/result", started) == ended
    assert ended["status"] == "succeeded"
    assert len(ended["result"]["sequence"]) == 21


async def test_goals_of_a_server_that_restarts_are_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(actions, "ASK_AGAIN_S", 1.0)
    async with lab_with(tmp_path, INBOUND) as lab:
        async with peer(lab, "count_up") as server:
            await server.until("ready")
            started = await lab.call("robot/count/goal", {"order": 100000})
        async with peer(lab, "count_up") as server:
            await server.until("ready")
            with pytest.raises(RemoteError, match="if it was restarted, its goals are lost"):
                await lab.call("robot/count/result", started, timeout_s=8)


async def test_goal_of_a_server_that_went_away_has_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(actions, "ASK_AGAIN_S", 1.0)
    monkeypatch.setattr(actions, "GONE_AFTER_S", 0.5)
    async with lab_with(tmp_path, INBOUND) as lab:
        async with peer(lab, "count_up") as server:
            await server.until("ready")
            started = await lab.call("robot/count/goal", {"order": 100000})
        with pytest.raises(RemoteError, match="the action server of /fibonacci went away"):
            await lab.call("robot/count/result", started, timeout_s=8)


async def test_all_goals_are_cancelled_by_one_call(tmp_path: Path) -> None:
    async with lab_with(tmp_path, INBOUND) as lab, peer(lab, "count_up") as server:
        await server.until("ready")
        goals = [await lab.call("robot/count/goal", {"order": 100000}) for _ in range(3)]
        cancelled = await lab.call("robot/count/cancel", {})
        assert sorted(cancelled["cancelling"]) == sorted(goal["goal_id"] for goal in goals)
        for goal in goals:
            assert (await lab.call("robot/count/result", goal))["status"] == "canceled"


async def test_feedback_says_of_which_goal_it_is(tmp_path: Path) -> None:
    async with lab_with(tmp_path, INBOUND) as lab, peer(lab, "count_up") as server:
        await server.until("ready")
        reader = lab.read("robot/count/feedback", Native)
        goals = [await lab.call("robot/count/goal", {"order": 30}) for _ in range(2)]
        seen: set[str] = set()
        async with asyncio.timeout(5):
            while len(seen) < 2:
                received = await first(reader)
                assert isinstance(received.message, Native)
                seen.add(received.message.value["goal_id"])
        drain(reader)
    assert seen == {goal["goal_id"] for goal in goals}
