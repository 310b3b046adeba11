"""Actions of the fleet offered to ROS: our node is their action server.

Each goal of a ROS client is a goal at the key of the route, which has an identity of its own there.
States are told as rclpy and rclcpp tell them, and `CancelGoal` means what rcl_action reads in it.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from typing import Any, Final

import msgspec

from vertebra.bus import Delivery
from vertebra.errors import (
    CodecError,
    TransportError,
    VertebraError,
)
from vertebra.messages import Native
from vertebra.ros2.actions import (
    CANCEL_TYPE,
    REJECTED,
    STATES,
    STATUS_TYPE,
    goal_id_of,
    ns_of,
    part_of,
    stamp_of,
    uuid_of,
)
from vertebra.ros2.graph import OTHER_MIDDLEWARE
from vertebra.ros2.qos import LATCHED, Qos
from vertebra.service import MessageReader
from vertebra.service.actions import JSON, Outcome, needed_goal, outcome_of
from vertebra.service.goals import Goal, Goals
from vertebra_ros2.carried import Kit
from vertebra_ros2.goals import info_of, status_of, to_cancel
from vertebra_ros2.routes import Action
from vertebra_ros2.services import to_json

STOP_WITHIN_S: Final = 1.0
FEEDBACK_DEPTH: Final = 64


class _Sent(Goal):
    """A goal of a ROS client, and what it is on the backbone.

    Attributes:
        there: Its identity on the backbone.
        reply: What is answered to those who ask for the result, once it has ended.
    """

    def __init__(self, goal_id: str, accepted_ns: int, there: str) -> None:
        super().__init__(goal_id, accepted_ns)
        self.there = there
        self.has_ended = asyncio.Event()
        self.reply = b""

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
        self._goals: Goals[_Sent] = Goals()
        self._asking: set[str] = set()
        self._early: deque[Any] = deque(maxlen=FEEDBACK_DEPTH)
        kit.types.definition(f"{route.type}_Goal")  # an unknown type is a fault of the route
        name, transport = route.ros, kit.transport
        self._feedback = transport.writer(
            part_of(name, "feedback"), f"{route.type}_FeedbackMessage", Qos()
        )
        self._status = transport.writer(part_of(name, "status"), STATUS_TYPE, LATCHED)
        self._servers = [
            transport.server(part_of(name, "send_goal"), f"{route.type}_SendGoal", self._send_goal),
            transport.server(
                part_of(name, "get_result"), f"{route.type}_GetResult", self._get_result
            ),
            transport.server(part_of(name, "cancel_goal"), CANCEL_TYPE, self._cancel_goal),
        ]
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

    async def _send_goal(self, payload: bytes) -> bytes | None:
        """Answer whether a goal is accepted; why not is told in our status, not on ROS."""
        request = self._decode(payload, f"{self._route.type}_SendGoal_Request")
        if request is None:
            return None
        goal_id = goal_id_of(request["goal_id"])
        goal = None
        if goal_id not in self._goals and goal_id not in self._asking:
            self._asking.add(goal_id)
            try:
                goal = await self._send_on(goal_id, to_json(request["goal"]))
                self._problem = ""
            except VertebraError as error:
                self._kit.refused.inc()
                self._problem = f"refused a goal: {error}"
            finally:
                self._asking.discard(goal_id)
        if goal is not None:
            self._begin(goal)
        self.look()
        accepted = {
            "accepted": goal is not None,
            "stamp": stamp_of(goal.accepted_ns if goal else 0),
        }
        return self._kit.cdr.encode(accepted, f"{self._route.type}_SendGoal_Response")

    async def _send_on(self, goal_id: str, goal: bytes) -> _Sent:
        answer = await self._call("goal", goal, self._route.timeout_s)
        return _Sent(goal_id, time.time_ns(), needed_goal(answer))

    def _begin(self, goal: _Sent) -> None:
        self._goals.forget_old(goal.accepted_ns)
        self._goals.add(goal)
        goal.advance("execute", goal.accepted_ns)
        self._tell_states()
        for told in [told for told in self._early if told["goal_id"] == goal.there]:
            self._write_feedback(told)
        if not self._asking:
            self._early.clear()
        self._start(self._follow(goal))

    async def _get_result(self, payload: bytes) -> bytes | None:
        """Answer when the goal has ended, at once if it is not known."""
        request = self._decode(payload, f"{self._route.type}_GetResult_Request")
        if request is None:
            return None
        goal = self._goals.get(goal_id_of(request["goal_id"]))
        if goal is None:
            return self._kit.cdr.encode({"status": 0}, f"{self._route.type}_GetResult_Response")
        # A client forgets the states of goals of whose acceptance it has not heard. Who asks for
        # the result has heard of it: now the state can be told.
        self._tell_states()
        await goal.has_ended.wait()
        return goal.reply

    async def _cancel_goal(self, payload: bytes) -> bytes | None:
        """Answer which goals are being cancelled."""
        request = self._decode(payload, f"{CANCEL_TYPE}_Request")
        if request is None:
            return None
        info = request["goal_info"]
        code, wanted = to_cancel(self._goals, goal_id_of(info["goal_id"]), ns_of(info["stamp"]))
        agreed = await asyncio.gather(*map(self._cancel, wanted))
        cancelling = [goal for goal, agrees in zip(wanted, agreed, strict=True) if agrees]
        if wanted and not cancelling:
            code = REJECTED
        if cancelling:
            self._tell_states()
        answer = {"return_code": code, "goals_canceling": [info_of(goal) for goal in cancelling]}
        return self._kit.cdr.encode(answer, f"{CANCEL_TYPE}_Response")

    async def _cancel(self, goal: _Sent) -> bool:
        try:
            await self._call("cancel", goal.named, self._route.timeout_s)
        except TransportError as error:
            self._report(f"cancelling {goal.id}: {error}")
            return False
        if goal.cancelable:  # it may have ended meanwhile
            goal.advance("cancel", time.time_ns())
        return True

    def _decode(self, payload: bytes, type_name: str) -> dict[str, Any] | None:
        try:
            return self._kit.cdr.decode(payload, type_name)
        except CodecError as error:
            self._kit.refused.inc()
            self._report(f"a call got no answer: {error}")
            return None

    # --- what the backbone tells -------------------------------------------------------------

    async def _follow(self, goal: _Sent) -> None:
        """Wait for the end of a goal and keep the reply that tells of it."""
        kit, reply_type = self._kit, f"{self._route.type}_GetResult_Response"
        try:
            outcome = await outcome_of(kit.context.bus, self._route.key, goal.there)
            record = {"status": STATES.index(outcome.status), "result": outcome.result}
            goal.reply = kit.cdr.encode(record, reply_type)
        except VertebraError as error:
            kit.refused.inc()
            outcome = Outcome(status="aborted", result={}, reason=str(error))
            goal.reply = kit.cdr.encode({"status": STATES.index("aborted")}, reply_type)
        if outcome.reason:  # ROS has no place for it
            self._problem = f"goal {goal.id} was aborted: {outcome.reason}"
        goal.end(outcome.status, time.time_ns())
        self._tell_states()
        goal.has_ended.set()
        self.look()

    async def _carry_feedback(self) -> None:
        context, key = self._kit.context, f"{self._route.key}/feedback"
        async with context.bus.subscribe(key, Delivery.queue(FEEDBACK_DEPTH)) as subscription:
            async for received in MessageReader(subscription, context.codecs, Native):
                told = received.message.value
                if isinstance(told, dict) and told.keys() >= {"goal_id", "feedback"}:
                    self._write_feedback(told)

    def _write_feedback(self, told: dict[str, Any]) -> None:
        goal = next((one for one in self._goals if one.there == told["goal_id"]), None)
        if goal is None:
            if self._asking:  # it may be of a goal whose acceptance has not reached us yet
                self._early.append(told)
            return
        record = {"goal_id": uuid_of(goal.id), "feedback": told["feedback"]}
        try:
            type_name = f"{self._route.type}_FeedbackMessage"
            self._feedback.write(self._kit.cdr.encode(record, type_name))
        except (CodecError, TransportError) as error:
            self._kit.refused.inc()
            self._report(f"feedback: {error}")

    def _tell_states(self) -> None:
        self._status.write(self._kit.cdr.encode(status_of(self._goals), STATUS_TYPE))

    async def _call(self, name: str, payload: bytes, timeout_s: float) -> bytes:
        bus = self._kit.context.bus
        key = f"{self._route.key}/{name}"
        return (await bus.call(key, payload, encoding=JSON, timeout_s=timeout_s)).payload

    async def close(self) -> None:
        """End it; goals that go on are cancelled, for no ROS client could do that any more."""
        for server in self._servers:
            server.close()
        for task in self._tasks:
            task.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STOP_WITHIN_S):
                await asyncio.gather(*map(self._cancel, self._goals.cancelable()))
        self._feedback.close()
        self._status.close()
        self._report("")
