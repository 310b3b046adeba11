"""Goals that ROS clients have sent to us, in the records of ROS; no I/O."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from vertebra.ros2.actions import (
    GOAL_TERMINATED,
    NO_GOAL,
    STATES,
    UNKNOWN_GOAL,
    stamp_of,
    uuid_of,
)
from vertebra.service.goals import Goal, Goals

G = TypeVar("G", bound=Goal)


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
