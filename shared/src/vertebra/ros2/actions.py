"""Actions as ROS 2 has them: their parts, identities of goals, states as numbers; no I/O.

An action `/a` is three services and two topics of its server below `/a/_action/`. Its goals have
identities of 16 bytes, which are hexadecimal text here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

from vertebra.messages import Array

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
