"""The server of an action on any driver: its three services and two topics.

States are told as rclpy and rclcpp tell them, and `CancelGoal` means what rcl_action reads in it.
What a goal asks for is done elsewhere, by a `Work`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import Any, Generic, Protocol, TypeVar

from vertebra.errors import CodecError
from vertebra.goals import Ended, Goal, Goals
from vertebra.ros2.actions import (
    CANCEL_TYPE,
    REJECTED,
    STATES,
    STATUS_TYPE,
    goal_id_of,
    info_of,
    ns_of,
    part_of,
    stamp_of,
    status_of,
    to_cancel,
    uuid_of,
)
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.driver import Transport
from vertebra.ros2.qos import LATCHED, Qos

Record = Mapping[str, Any]


class ServerGoal(Goal):
    """A goal of a ROS client.

    Attributes:
        has_ended: Set when it has.
        reply: What is answered then to those who ask for the result.
    """

    def __init__(self, goal_id: str, accepted_ns: int) -> None:
        super().__init__(goal_id, accepted_ns)
        self.has_ended = asyncio.Event()
        self.reply = b""


G = TypeVar("G", bound=ServerGoal)


class Work(Protocol[G]):
    """Does what the goals of an action ask for."""

    async def accept(self, goal_id: str, wanted: Record) -> G | None:
        """Return the goal if it is accepted, None if not; `begin` follows."""
        ...

    def begin(self, goal: G) -> None:
        """Start to work on a goal, which ends with `ActionServer.end`."""
        ...

    async def cancel(self, goal: G) -> bool:
        """Tell a goal to end; say whether it will."""
        ...

    def refuse(self, error: CodecError) -> None:
        """Note a request that could not be read, and so gets no answer."""
        ...


class ActionServer(Generic[G]):
    """Offers an action.

    Attributes:
        goals: Those that go on, and those whose result may still be asked for.
    """

    def __init__(
        self, transport: Transport, cdr: Cdr, name: str, type_name: str, work: Work[G]
    ) -> None:
        self.goals: Goals[G] = Goals()
        self._cdr = cdr
        self._type = type_name
        self._work = work
        self._asking: set[str] = set()
        self._feedback = transport.writer(
            part_of(name, "feedback"), f"{type_name}_FeedbackMessage", Qos()
        )
        self._status = transport.writer(part_of(name, "status"), STATUS_TYPE, LATCHED)
        self._servers = [
            transport.server(part_of(name, "send_goal"), f"{type_name}_SendGoal", self._send_goal),
            transport.server(
                part_of(name, "get_result"), f"{type_name}_GetResult", self._get_result
            ),
            transport.server(part_of(name, "cancel_goal"), CANCEL_TYPE, self._cancel_goal),
        ]

    @property
    def deciding(self) -> bool:
        """Whether there are goals of which it is not known yet if they are accepted."""
        return bool(self._asking)

    def tell(self, goal: G, feedback: Record) -> None:
        """Tell how a goal goes; raise `EncodeError` or `TransportError`."""
        record = {"goal_id": uuid_of(goal.id), "feedback": feedback}
        self._feedback.write(self._cdr.encode(record, f"{self._type}_FeedbackMessage"))

    def end(self, goal: G, state: Ended, result: Record) -> None:
        """Let a goal end; raise `EncodeError` if this is no result, and then it goes on."""
        record = {"status": STATES.index(state), "result": result}
        goal.reply = self._cdr.encode(record, f"{self._type}_GetResult_Response")
        goal.end(state, time.time_ns())
        self._tell_states()
        goal.has_ended.set()

    async def _send_goal(self, payload: bytes) -> bytes | None:
        """Answer whether a goal is accepted."""
        request = self._decode(payload, f"{self._type}_SendGoal_Request")
        if request is None:
            return None
        goal_id = goal_id_of(request["goal_id"])
        goal = None
        if goal_id not in self.goals and goal_id not in self._asking:
            self._asking.add(goal_id)
            try:
                goal = await self._work.accept(goal_id, request["goal"])
            finally:
                self._asking.discard(goal_id)
        if goal is not None:
            self.goals.forget_old(goal.accepted_ns)
            self.goals.add(goal)
            goal.advance("execute", goal.accepted_ns)
            self._tell_states()
            self._work.begin(goal)
        accepted = {
            "accepted": goal is not None,
            "stamp": stamp_of(goal.accepted_ns if goal else 0),
        }
        return self._cdr.encode(accepted, f"{self._type}_SendGoal_Response")

    async def _get_result(self, payload: bytes) -> bytes | None:
        """Answer when the goal has ended, at once if it is not known."""
        request = self._decode(payload, f"{self._type}_GetResult_Request")
        if request is None:
            return None
        goal = self.goals.get(goal_id_of(request["goal_id"]))
        if goal is None:
            return self._cdr.encode({"status": 0}, f"{self._type}_GetResult_Response")
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
        code, wanted = to_cancel(self.goals, goal_id_of(info["goal_id"]), ns_of(info["stamp"]))
        agreed = await asyncio.gather(*map(self.cancel, wanted))
        cancelling = [goal for goal, agrees in zip(wanted, agreed, strict=True) if agrees]
        if wanted and not cancelling:
            code = REJECTED
        if cancelling:
            self._tell_states()
        answer = {"return_code": code, "goals_canceling": [info_of(goal) for goal in cancelling]}
        return self._cdr.encode(answer, f"{CANCEL_TYPE}_Response")

    async def cancel(self, goal: G) -> bool:
        """Tell a goal to end; say whether it will."""
        agrees = await self._work.cancel(goal)
        if agrees and goal.cancelable:  # it may have ended meanwhile
            goal.advance("cancel", time.time_ns())
        return agrees

    def _decode(self, payload: bytes, type_name: str) -> dict[str, Any] | None:
        try:
            return self._cdr.decode(payload, type_name)
        except CodecError as error:
            self._work.refuse(error)
            return None

    def _tell_states(self) -> None:
        self._status.write(self._cdr.encode(status_of(self.goals), STATUS_TYPE))

    def close_services(self) -> None:
        """Take no more requests; goals that go on can still end."""
        for server in self._servers:
            server.close()

    def close(self) -> None:
        """End it."""
        self.close_services()
        self._feedback.close()
        self._status.close()
