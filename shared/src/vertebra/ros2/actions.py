"""Actions as ROS 2 has them: their parts, identities of goals, states as numbers; no I/O.

An action `/a` is three services and two topics of its server below `/a/_action/`. Its goals have
identities of 16 bytes, which are hexadecimal text here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal, TypeVar

from vertebra.goals import Goal, Goals
from vertebra.messages import Array

G = TypeVar("G", bound=Goal)

Part = Literal["send_goal", "get_result", "cancel_goal", "feedback", "status"]
CANCEL_TYPE: Final = "action_msgs/srv/CancelGoal"
STATUS_TYPE: Final = "action_msgs/msg/GoalStatusArray"
NO_GOAL: Final = "0" * 32
"""The identity that means none: in a request to cancel, all."""
STATES: Final = (
    "unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted",
)  # fmt: skip
"""`GoalStatus`, in words."""
REJECTED: Final = 1
UNKNOWN_GOAL: Final = 2
GOAL_TERMINATED: Final = 3
CANCEL_REFUSALS: Final = {
    REJECTED: "the action server refuses to cancel",
    UNKNOWN_GOAL: "the action server does not know this goal",
    GOAL_TERMINATED: "this goal has ended already",
}
"""The return codes of `CancelGoal` that are errors, in words."""


def part_of(action: str, part: Part) -> str:
    """Return the ROS name of a part of an action."""
    return f"{action}/_action/{part}"


def uuid_of(goal_id: str) -> dict[str, Any]:
    """Return the record of a goal's identity."""
    return {"uuid": list(bytes.fromhex(goal_id))}


def goal_id_of(record: Mapping[str, Any]) -> str:
    """Return a goal's identity from its record, or from the JSON of that."""
    uuid = record["uuid"]
    return bytes(uuid.data if isinstance(uuid, Array) else uuid).hex()


def state_of(number: int) -> str:
    """Return the word of a `GoalStatus`."""
    return STATES[number] if 0 <= number < len(STATES) else str(number)


def stamp_of(time_ns: int) -> dict[str, int]:
    """Return the record of a time."""
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def ns_of(stamp: Mapping[str, int]) -> int:
    """Return the time in a record."""
    return stamp["sec"] * 10**9 + stamp["nanosec"]


def info_of(goal: Goal) -> dict[str, Any]:
    """Return the `GoalInfo` of a goal."""
    return {"goal_id": uuid_of(goal.id), "stamp": stamp_of(goal.accepted_ns)}


def status_of(goals: Iterable[Goal]) -> dict[str, Any]:
    """Return the `GoalStatusArray` of goals."""
    return {
        "status_list": [
            {"goal_info": info_of(goal), "status": STATES.index(goal.state)} for goal in goals
        ]
    }


def to_cancel(goals: Goals[G], goal_id: str, stamp_ns: int) -> tuple[int, list[G]]:
    """Return the code and the goals that a request to cancel means, as rcl_action reads it.

    A goal without a time is that goal. A time is all goals that were accepted until then, and the
    goal if one is named. Neither is all.
    """
    if goal_id != NO_GOAL and not stamp_ns:
        goal = goals.get(goal_id)
        if goal is None:
            return UNKNOWN_GOAL, []
        if not goal.cancelable:
            return GOAL_TERMINATED, []
        return 0, [goal]
    return 0, goals.cancelable(stamp_ns or None, goal_id)
