"""Actions of the fleet offered to ROS: our node is their action server.

Each goal of a ROS client is a goal at the key of the route, which has an identity of its own there.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from vertebra.bus import Delivery
from vertebra.errors import (
    CodecError,
    TransportError,
    VertebraError,
)
from vertebra.messages import Native
from vertebra.ros2.action_server import ActionServer, ServerGoal
from vertebra.ros2.actions import part_of
from vertebra.ros2.graph import OTHER_MIDDLEWARE
from vertebra.service import MessageReader
from vertebra.service.actions import JSON, Outcome, needed_goal, outcome_of
from vertebra_ros2.carried import Kit
from vertebra_ros2.routes import Action
from vertebra_ros2.services import to_json

STOP_WITHIN_S: Final = 1.0
FEEDBACK_DEPTH: Final = 64


class _Sent(ServerGoal):
    """A goal of a ROS client, and what it is on the backbone.

    Attributes:
        there: Its identity on the backbone.
    """

    def __init__(self, goal_id: str, accepted_ns: int, there: str) -> None:
        super().__init__(goal_id, accepted_ns)
        self.there = there

    @property
    def named(self) -> bytes:
        """What a call says that means this goal."""
        return msgspec.json.encode({"goal_id": self.there})


class OutboundAction:
    """A ROS action of ours, whose goals go to a key."""

    def __init__(self, kit: Kit, route: Action) -> None:
        self._kit = kit
        self._route = route
        self._problem = ""
        self._early: deque[Any] = deque(maxlen=FEEDBACK_DEPTH)
        kit.types.definition(f"{route.type}_Goal")  # an unknown type is a fault of the route
        self._server: ActionServer[_Sent] = ActionServer(
            kit.transport, kit.cdr, route.ros, route.type, self
        )
        self._tasks: set[asyncio.Task[None]] = set()
        self._start(self._carry_feedback())

    def look(self) -> None:
        """Tell of clients that cannot be answered, and what went wrong last."""
        clients = self._kit.transport.graph.writers(
            part_of(self._route.ros, "send_goal"), "request"
        )
        if any(not one.identity for one in clients):
            self._report(f"a client cannot be answered: {OTHER_MIDDLEWARE}")
        else:
            self._report(self._problem)

    def _report(self, problem: str) -> None:
        self._kit.report(f"action {self._route.ros}", problem)

    def _start(self, work: Any) -> None:
        task = self._kit.context.tasks.create_task(work, name=f"action {self._route.ros}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # --- what ROS clients ask ----------------------------------------------------------------

    async def accept(self, goal_id: str, wanted: Mapping[str, Any]) -> _Sent | None:
        """Send a goal on; why it is refused is told in our status, not on ROS."""
        try:
            answer = await self._call("goal", to_json(wanted), self._route.timeout_s)
            goal = _Sent(goal_id, time.time_ns(), needed_goal(answer))
        except VertebraError as error:
            self._kit.refused.inc()
            self._problem = f"refused a goal: {error}"
            goal = None
        else:
            self._problem = ""
        self.look()
        return goal

    def begin(self, goal: _Sent) -> None:
        """Follow a goal to its end; first what it has told before we knew of it."""
        for told in [told for told in self._early if told["goal_id"] == goal.there]:
            self._write_feedback(told)
        if not self._server.deciding:
            self._early.clear()
        self._start(self._follow(goal))

    async def cancel(self, goal: _Sent) -> bool:
        """Tell a goal to end; say whether it will."""
        try:
            await self._call("cancel", goal.named, self._route.timeout_s)
        except TransportError as error:
            self._report(f"cancelling {goal.id}: {error}")
            return False
        return True

    def refuse(self, error: CodecError) -> None:
        """Note a request that could not be read."""
        self._kit.refused.inc()
        self._report(f"a call got no answer: {error}")

    # --- what the backbone tells -------------------------------------------------------------

    async def _follow(self, goal: _Sent) -> None:
        """Wait for the end of a goal and tell of it."""
        try:
            outcome = await outcome_of(self._kit.context.bus, self._route.key, goal.there)
            self._server.end(goal, outcome.status, outcome.result)
        except VertebraError as error:
            self._kit.refused.inc()
            outcome = Outcome(status="aborted", result={}, reason=str(error))
            self._server.end(goal, outcome.status, outcome.result)
        if outcome.reason:  # ROS has no place for it
            self._problem = f"goal {goal.id} was aborted: {outcome.reason}"
        self.look()

    async def _carry_feedback(self) -> None:
        context, key = self._kit.context, f"{self._route.key}/feedback"
        async with context.bus.subscribe(key, Delivery.queue(FEEDBACK_DEPTH)) as subscription:
            async for received in MessageReader(subscription, context.codecs, Native):
                told = received.message.value
                if isinstance(told, dict) and told.keys() >= {"goal_id", "feedback"}:
                    self._write_feedback(told)

    def _write_feedback(self, told: dict[str, Any]) -> None:
        goal = next((one for one in self._server.goals if one.there == told["goal_id"]), None)
        if goal is None:
            if self._server.deciding:  # of a goal whose acceptance has not reached us yet?
                self._early.append(told)
            return
        try:
            self._server.tell(goal, told["feedback"])
        except (CodecError, TransportError) as error:
            self._kit.refused.inc()
            self._report(f"feedback: {error}")

    async def _call(self, name: str, payload: bytes, timeout_s: float) -> bytes:
        bus = self._kit.context.bus
        key = f"{self._route.key}/{name}"
        return (await bus.call(key, payload, encoding=JSON, timeout_s=timeout_s)).payload

    async def close(self) -> None:
        """End it; goals that go on are cancelled, for no ROS client could do that any more."""
        self._server.close_services()
        for task in self._tasks:
            task.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STOP_WITHIN_S):
                await asyncio.gather(*map(self._server.cancel, self._server.goals.cancelable()))
        self._server.close()
        self._report("")
