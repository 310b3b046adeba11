"""The base: how it drives, where it cannot go, and what its laser sees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError
from vertebra_simulator.base import (
    COMMAND_HOLDS_S,
    MAX_ANGULAR_RAD_S,
    MAX_LINEAR_M_S,
    MAX_LINEAR_M_S2,
    RADIUS_M,
    STEP_S,
    STILL,
    TRACK_M,
    WHEEL_RADIUS_M,
    Base,
    Pose,
    Velocity,
    moved,
    turn_of,
)
from vertebra_simulator.floorplan import BEAMS, LASER_MAX_M, ROOM, FloorPlan, Pillar, Point

EMPTY = FloorPlan(Point(-2.0, -2.5), Point(4.0, 2.5))
WIDE = FloorPlan(Point(-500.0, -500.0), Point(500.0, 500.0))
SPEEDS = st.floats(-2.0, 2.0)


def hold(base: Base, velocity: Velocity, duration_s: float) -> None:
    """Drive so for a while, commanded again and again as an operator would."""
    until_s = base.time_s + duration_s
    while base.time_s < until_s - STEP_S / 2:
        base.drive(velocity)
        base.advance_to(base.time_s + 0.1)


def beam(scan: np.ndarray[tuple[int], np.dtype[np.float32]], degrees: float) -> float:
    """Return what the beam sees that looks so far to the left."""
    return float(scan[round((degrees + 180) * BEAMS / 360) % BEAMS])


def test_it_goes_straight_ahead_and_stands_still_where_it_was() -> None:
    base = Base(WIDE)
    hold(base, Velocity(0.5), 2.0)
    base.advance_to(10.0)
    assert base.velocity == STILL
    # The last command came after 1.9 s. Braking takes the way that speeding up has cost.
    assert base.pose.x_m == pytest.approx(0.5 * (1.9 + COMMAND_HOLDS_S), abs=0.02)
    assert (base.pose.y_m, base.pose.heading_rad) == (0.0, 0.0)
    assert base.time_s == pytest.approx(10.0)


def test_it_gets_faster_and_slower_no_more_than_it_can() -> None:
    base = Base(WIDE)
    last = base.velocity
    for velocity in (Velocity(9.0, 9.0), Velocity(-9.0, -9.0), STILL):
        for _ in range(300):
            base.drive(velocity)
            base.advance_to(base.time_s + STEP_S)
            assert (
                abs(base.velocity.linear_m_s - last.linear_m_s) <= MAX_LINEAR_M_S2 * STEP_S + 1e-9
            )
            last = base.velocity
        held = velocity.held()
        assert base.velocity == pytest.approx(held)
        assert abs(held.linear_m_s) <= MAX_LINEAR_M_S
        assert abs(held.angular_rad_s) <= MAX_ANGULAR_RAD_S


def test_a_command_that_is_not_repeated_ends() -> None:
    base = Base(WIDE)
    base.drive(Velocity(MAX_LINEAR_M_S))
    base.advance_to(COMMAND_HOLDS_S)
    assert base.velocity.linear_m_s > 0.3
    base.advance_to(2.0)
    assert base.velocity == STILL


def test_what_is_no_number_stops_it() -> None:
    base = Base(WIDE)
    hold(base, Velocity(0.5), 1.0)
    with pytest.raises(CommandRefusedError, match="no velocity"):
        base.drive(Velocity(math.nan))
    base.advance_to(base.time_s + 1.0)
    assert base.velocity == STILL


@given(SPEEDS, SPEEDS, st.lists(st.floats(0.001, 0.3), max_size=20))
def test_it_makes_no_difference_how_often_somebody_looks(
    linear: float, angular: float, looks: list[float]
) -> None:
    often, once = Base(ROOM), Base(ROOM)
    for base in (often, once):
        base.drive(Velocity(linear, angular))
    time_s = 0.0
    for look in looks:
        time_s += look
        often.advance_to(time_s)
    once.advance_to(time_s)
    assert often.pose == once.pose
    assert often.velocity == once.velocity


@example(1.0, 5e-324, 0.0)  # half of it is nothing
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-6, 6))
def test_an_arc_is_as_long_as_it_takes_and_its_radius_stays(
    linear: float, angular: float, heading: float
) -> None:
    pose = Pose(1.0, 2.0, heading)
    end = moved(pose, Velocity(linear, angular), 1.0)
    assert turn_of(end.heading_rad - heading - angular) == pytest.approx(0, abs=1e-9)
    if abs(angular) > 1e-3:
        radius = linear / angular
        middle = np.array(pose.place) + radius * np.array([-math.sin(heading), math.cos(heading)])
        assert math.dist(middle, end.place) == pytest.approx(abs(radius))
    else:
        assert math.dist(pose.place, end.place) == pytest.approx(abs(linear))


def test_its_wheels_roll() -> None:
    base = Base(WIDE)
    hold(base, Velocity(0.4), 3.0)
    hold(base, STILL, 2.0)
    assert base.wheels_rad[0] == base.wheels_rad[1]
    assert base.wheels_rad[0] * WHEEL_RADIUS_M == pytest.approx(base.pose.x_m)
    turning = Base(WIDE)
    hold(turning, Velocity(0.0, 1.0), 2.0)
    left, right = turning.wheels_rad
    assert left == -right
    assert 2 * right * WHEEL_RADIUS_M / TRACK_M == pytest.approx(turning.pose.heading_rad)


@given(st.lists(st.tuples(SPEEDS, SPEEDS, st.floats(0.1, 8.0)), max_size=8))
def test_it_drives_through_nothing(commands: list[tuple[float, float, float]]) -> None:
    base = Base(ROOM)
    for linear, angular, duration_s in commands:
        hold(base, Velocity(linear, angular), duration_s)
        assert ROOM.obstacle(base.pose.place, RADIUS_M) == ""


def test_it_stands_at_the_wall_says_so_and_can_leave_it() -> None:
    base = Base(EMPTY)
    hold(base, Velocity(MAX_LINEAR_M_S), 10.0)
    assert base.stuck == "a wall"
    assert base.pose.x_m == pytest.approx(4.0 - RADIUS_M, abs=0.01)
    assert base.velocity == STILL
    hold(base, Velocity(-0.5), 2.0)
    assert base.stuck == ""
    assert base.pose.x_m < 3.2


def test_a_pillar_is_an_obstacle() -> None:
    base = Base(replace(EMPTY, pillars=(Pillar(Point(1.0, 0.0), 0.2),)))
    hold(base, Velocity(0.5), 5.0)
    assert base.stuck == "a pillar"
    assert base.pose.x_m == pytest.approx(0.8 - RADIUS_M, abs=0.01)


def test_the_laser_measures_the_room() -> None:
    plan = replace(EMPTY, pillars=(Pillar(Point(1.5, 0.0), 0.2),))
    scan = plan.scan(Point(0.0, 0.0), 0.0)
    assert scan.dtype == np.float32
    assert scan.shape == (BEAMS,)
    assert beam(scan, 0) == pytest.approx(1.3)
    assert beam(scan, 90) == pytest.approx(2.5)
    assert beam(scan, -90) == pytest.approx(2.5)
    assert beam(scan, 180) == pytest.approx(2.0)
    assert beam(scan, 45) == pytest.approx(2.5 * math.sqrt(2))
    turned = plan.scan(Point(0.0, 0.0), math.radians(90))
    assert beam(turned, -90) == pytest.approx(1.3)
    assert beam(turned, 0) == pytest.approx(2.5)


@given(st.floats(-1.9, 3.9), st.floats(-2.4, 2.4), st.floats(-math.pi, math.pi))
def test_every_beam_ends_on_something(x: float, y: float, heading: float) -> None:
    place = Point(x, y)
    if ROOM.obstacle(place, 0.01):
        return
    for index, range_m in enumerate(ROOM.scan(place, heading).tolist()):
        angle = heading - math.pi + index * 2 * math.pi / BEAMS
        end = Point(x + range_m * math.cos(angle), y + range_m * math.sin(angle))
        assert ROOM.obstacle(end, 1e-4)
        middle = Point(x + range_m / 2 * math.cos(angle), y + range_m / 2 * math.sin(angle))
        assert range_m < 0.02 or not ROOM.obstacle(middle, 0.0)


def test_what_is_too_far_is_infinitely_far() -> None:
    scan = WIDE.scan(Point(499.0, 0.0), 0.0)
    assert beam(scan, 0) == pytest.approx(1.0)
    assert beam(scan, 180) == math.inf
    assert not np.any((scan > LASER_MAX_M) & np.isfinite(scan))
