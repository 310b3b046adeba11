"""How the base finds its way, and when it says that it cannot."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from vertebra_simulator.base import RADIUS_M, STILL, Base, Pose, Velocity, turn_of
from vertebra_simulator.floorplan import ROOM, FloorPlan, Pillar, Point
from vertebra_simulator.navigator import (
    ARRIVED_M,
    ARRIVED_RAD,
    GIVES_UP_AFTER_S,
    Failure,
    Navigation,
    Outlook,
)

CROWDED = replace(
    ROOM,
    pillars=(
        Pillar(Point(1.0, 0.0), 0.3), Pillar(Point(2.2, 1.2), 0.2), Pillar(Point(2.2, -1.1), 0.4),
    )
)  # fmt: skip
ROOMS = st.sampled_from([ROOM, CROWDED])
POSES = st.builds(Pose, st.floats(-1.75, 3.75), st.floats(-2.25, 2.25), st.floats(-3.2, 3.2))
TICK_S = 0.05


def navigate(base: Base, plan: FloorPlan, goal: Pose, within_s: float = 60.0) -> Outlook:
    """Drive there, looking 20 times in a second, as the simulator does."""
    navigation = Navigation(plan, goal)
    for _ in range(round(within_s / TICK_S)):
        outlook = navigation.look(base)
        if outlook.arrived or outlook.problem:
            return outlook
        base.drive(outlook.velocity)
        base.advance_to(base.time_s + TICK_S)
        assert not base.stuck
    raise AssertionError(f"not at {goal} after {within_s} s, but at {base.pose}")


@settings(max_examples=60, deadline=None)
@example(ROOM, Pose(), Pose(3.0, 0.3))
@example(ROOM, Pose(0.0, 0.3), Pose(3.0, 0.3, 3.1))
@example(CROWDED, Pose(), Pose(3.7, 0.0, 1.0))
@given(ROOMS, POSES, POSES)
def test_it_arrives_turned_as_asked_and_touches_nothing(
    plan: FloorPlan, start: Pose, goal: Pose
) -> None:
    assume(not plan.obstacle(start.place, RADIUS_M))
    assume(not plan.obstacle(goal.place, RADIUS_M))
    base = Base(plan)
    base.pose = start
    outlook = navigate(base, plan, goal)
    assert outlook.arrived
    assert math.dist(base.pose.place, goal.place) < 2 * ARRIVED_M
    assert abs(turn_of(base.pose.heading_rad - goal.heading_rad)) < 2 * ARRIVED_RAD
    base.advance_to(base.time_s + 2.0)
    assert base.velocity == STILL


@given(ROOMS, POSES, POSES)
def test_a_way_keeps_its_distance_and_is_no_detour(
    plan: FloorPlan, here: Pose, there: Pose
) -> None:
    start, goal = here.place, there.place
    clear_m = RADIUS_M + 0.05
    assume(not plan.obstacle(start, clear_m))
    assume(not plan.obstacle(goal, clear_m))
    way = plan.way(start, goal, clear_m)
    assert (way[0], way[-1]) == (start, goal)
    for one, other in itertools.pairwise(way):
        for part in range(21):
            share = part / 20
            between = Point(one.x + share * (other.x - one.x), one.y + share * (other.y - one.y))
            assert not plan.obstacle(between, clear_m - 1e-5)
    length_m = sum(map(math.dist, way, way[1:]))
    assert length_m <= math.dist(start, goal) + math.pi * 0.8 * len(plan.pillars)


def test_the_shorter_side_is_taken() -> None:
    plan = replace(ROOM, pillars=(Pillar(Point(1.5, 0.3), 0.2),))
    ys = [place.y for place in plan.way(Point(0.0, 0.0), Point(3.0, 0.0), 0.4)]
    assert min(ys) < -0.05
    assert max(ys) == 0.0


@pytest.mark.parametrize(
    ("goal", "obstacle"),
    [
        (Pose(1.5, 0.3), "a pillar"), (Pose(1.5, 0.7), "a pillar"), (Pose(3.9, 0.0), "a wall"),
        (Pose(40.0, 0.0), "a wall"), (Pose(math.nan, 0.0), "a wall"),
    ],
)  # fmt: skip
def test_a_goal_that_is_taken_is_given_up_at_once(goal: Pose, obstacle: str) -> None:
    base = Base(ROOM)
    outlook = navigate(base, ROOM, goal)
    assert outlook.failure is Failure.GOAL_OCCUPIED
    assert outlook.problem == f"{obstacle} is where it should go"
    assert base.pose == Pose()


def test_a_gap_that_is_too_narrow_has_no_way() -> None:
    fence = tuple(Pillar(Point(1.5, -2.4 + 0.4 * number), 0.15) for number in range(13))
    plan = replace(ROOM, pillars=fence)
    assert navigate(Base(plan), plan, Pose(3.0, 0.0)).problem == "no way leads there"


def test_it_gives_up_when_it_comes_no_nearer() -> None:
    base = Base(ROOM)
    navigation = Navigation(ROOM, Pose(3.0, -1.0))
    while not (outlook := navigation.look(base)).problem:
        base.advance_to(base.time_s + TICK_S)  # nobody turns its wheels
        assert base.time_s < GIVES_UP_AFTER_S + 1
    assert outlook.failure is Failure.NO_PROGRESS
    assert outlook.problem == "it came no nearer in 10 s"
    assert base.time_s >= GIVES_UP_AFTER_S


def test_it_goes_on_from_where_it_was_pushed() -> None:
    base = Base(ROOM)
    navigation = Navigation(ROOM, Pose(3.0, -1.0, 1.0))
    for _ in range(40):
        base.drive(navigation.look(base).velocity)
        base.advance_to(base.time_s + TICK_S)
    base.pose = Pose(-1.0, 1.0, 2.0)
    assert navigate(base, ROOM, navigation.goal).arrived


def test_what_is_left_of_the_way_gets_less() -> None:
    base = Base(ROOM)
    navigation = Navigation(ROOM, Pose(3.0, 0.5))
    looks = []
    while not (outlook := navigation.look(base)).arrived:
        looks.append(outlook)
        base.drive(outlook.velocity)
        base.advance_to(base.time_s + TICK_S)
    distances = [look.distance_m for look in looks]
    assert distances[0] > 3.0
    assert all(later <= earlier + 0.01 for earlier, later in itertools.pairwise(distances))
    assert looks[0].remaining_s == pytest.approx(base.time_s, rel=0.6)


def test_arriving_takes_standing_still() -> None:
    base = Base(ROOM)
    base.drive(Velocity(0.0, 1.0))
    base.advance_to(0.4)
    navigation = Navigation(ROOM, base.pose)
    assert base.velocity.angular_rad_s > 0.5
    assert not navigation.look(base).arrived
