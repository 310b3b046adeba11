"""Goals of ROS clients: what `CancelGoal` means, and how states are told."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.goals import Goal, Goals, State
from vertebra.ros2.actions import (
    GOAL_TERMINATED,
    NO_GOAL,
    STATES,
    UNKNOWN_GOAL,
    goal_id_of,
    info_of,
    ns_of,
    part_of,
    stamp_of,
    state_of,
    status_of,
    to_cancel,
    uuid_of,
)
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types

SECOND = 10**9
TYPES = Types.standard()


def name(number: int) -> str:
    return f"{number:032x}"


def goals(*states: State) -> Goals[Goal]:
    """Return goals with the names 1, 2, ... accepted in second 1, 2, ..."""
    found: Goals[Goal] = Goals()
    for number, state in enumerate(states, 1):
        goal = Goal(name(number), number * SECOND)
        goal.state = state
        found.add(goal)
    return found


@pytest.mark.parametrize(
    ("goal", "stamp_s", "code", "meant"),
    [
        (2, 0, 0, [2]),  # that goal
        (4, 0, GOAL_TERMINATED, []),  # it has ended
        (3, 0, GOAL_TERMINATED, []),  # it is being cancelled: rcl_action says the same
        (9, 0, UNKNOWN_GOAL, []),
        (0, 0, 0, [1, 2, 5]),  # all
        (0, 2, 0, [1, 2]),  # all up to then
        (5, 1, 0, [1, 5]),  # all up to then, and that goal
        (9, 1, 0, [1]),
        (4, 6, 0, [1, 2, 5]),
    ],
)
def test_what_a_request_to_cancel_means(
    goal: int, stamp_s: int, code: int, meant: list[int]
) -> None:
    known = goals("accepted", "executing", "canceling", "succeeded", "executing")
    said, found = to_cancel(known, name(goal), stamp_s * SECOND)
    assert (said, [one.id for one in found]) == (code, [name(number) for number in meant])


def test_nothing_to_cancel_is_no_error() -> None:
    assert to_cancel(goals("succeeded"), NO_GOAL, 0) == (0, [])


def test_states_have_the_numbers_of_ros() -> None:
    every: list[State] = [
        "accepted", "executing", "canceling", "succeeded", "canceled", "aborted",
    ]  # fmt: skip
    told = status_of(goals(*every))["status_list"]
    assert [one["status"] for one in told] == [1, 2, 3, 4, 5, 6]
    assert told[1]["goal_info"] == {
        "goal_id": {"uuid": [0] * 15 + [2]},
        "stamp": {"sec": 2, "nanosec": 0},
    }
    assert [state_of(number) for number in range(7)] == list(STATES)
    assert state_of(-1) == "-1"


@given(st.binary(min_size=16, max_size=16), st.integers(0, 2**31 * SECOND - 1))
def test_identity_and_time_survive_the_bytes(identity: bytes, time_ns: int) -> None:
    goal = Goal(identity.hex(), time_ns)
    cdr = Cdr(TYPES)
    kind = "action_msgs/msg/GoalInfo"
    record = cdr.decode(cdr.encode(info_of(goal), kind), kind)
    assert goal_id_of(record["goal_id"]) == goal_id_of(uuid_of(goal.id)) == goal.id
    assert ns_of(record["stamp"]) == ns_of(stamp_of(time_ns)) == time_ns


def test_parts_have_the_names_of_ros() -> None:
    assert part_of("/lab/count", "send_goal") == "/lab/count/_action/send_goal"
