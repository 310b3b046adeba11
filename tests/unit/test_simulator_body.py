"""The simulated joints keep their limits, their speeds and their word."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError
from vertebra_simulator.body import HEAD, Body, Joint, JointSpec, Mode

SPEC = HEAD[2]
TOLERANCE = 1e-6

specs = st.sampled_from(HEAD)
angles = st.floats(-200, 200)
pauses = st.floats(0, 1.5)
commands = st.one_of(
    st.tuples(st.just("move"), angles),
    st.tuples(st.just("follow"), angles),
    st.tuples(st.just("run"), angles),
    st.tuples(st.just("speed"), st.floats(0.5, 300)),
    st.tuples(st.just("acceleration"), st.floats(1, 3000)),
    st.tuples(st.just("stop"), st.just(0.0)),
)


def give(joint: Joint, command: tuple[str, float]) -> None:
    what, value = command
    if what == "stop":
        joint.stop()
    elif what == "speed":
        joint.set_speed(value)
    elif what == "acceleration":
        joint.set_acceleration(value)
    else:
        modes = {"move": Mode.POSITION, "follow": Mode.POSITION_DIRECT, "run": Mode.VELOCITY}
        joint.set_mode(modes[what])
        {"move": joint.move, "follow": joint.follow, "run": joint.run}[what](value)


def at(joint: Joint) -> tuple[float, ...]:
    return tuple(joint.motion)


def done(joint: Joint) -> bool:
    return joint.move_done


def moving(joint: Joint) -> bool:
    return joint.moving


def run(joint: Joint, seconds: float, step_s: float = 0.01) -> None:
    for _ in range(round(seconds / step_s)):
        joint.advance(step_s)


@given(specs, st.lists(st.tuples(commands, pauses), max_size=8), st.floats(0.001, 0.1))
def test_whatever_is_commanded_limits_speeds_and_accelerations_are_kept(
    spec: JointSpec, script: list[tuple[tuple[str, float], float]], step_s: float
) -> None:
    joint = Joint(spec)
    for command, pause_s in script:
        give(joint, command)
        for _ in range(int(pause_s / step_s)):
            before = joint.motion
            joint.advance(step_s)
            now = joint.motion
            assert spec.min_deg <= now.position <= spec.max_deg
            assert abs(now.velocity) <= spec.max_speed_deg_s + TOLERANCE
            assert abs(now.acceleration) <= spec.max_acceleration_deg_s2 + TOLERANCE
            assert abs(now.position - before.position) <= spec.max_speed_deg_s * step_s + TOLERANCE
            change = abs(now.velocity - before.velocity)
            assert change <= spec.max_acceleration_deg_s2 * step_s + TOLERANCE


@given(specs, st.lists(st.tuples(commands, pauses), max_size=4), angles)
def test_a_move_arrives_from_any_state_and_says_so(
    spec: JointSpec, script: list[tuple[tuple[str, float], float]], target: float
) -> None:
    joint = Joint(spec)
    for command, pause_s in script:
        give(joint, command)
        joint.advance(pause_s)
    joint.set_mode(Mode.POSITION)
    joint.set_speed(30)
    joint.set_acceleration(100)
    joint.move(target)
    for _ in range(2000):
        joint.advance(0.01)
        if done(joint):
            break
        assert joint.motion.position != joint.target or joint.motion.velocity != 0
    assert done(joint)
    assert at(joint) == (joint.target, 0, 0)
    assert joint.target == min(max(target, spec.min_deg), spec.max_deg)


@given(specs, angles, st.floats(0.0, 3.0), st.integers(1, 50))
def test_it_does_not_matter_how_often_one_looks(
    spec: JointSpec, target: float, seconds: float, looks: int
) -> None:
    seldom, often = Joint(spec), Joint(spec)
    for joint in (seldom, often):
        joint.move(target)
    seldom.advance(seconds)
    for _ in range(looks):
        often.advance(seconds / looks)
    assert often.motion.position == pytest.approx(seldom.motion.position, abs=1e-6)


def test_a_move_takes_the_time_of_its_trapezoid() -> None:
    joint = Joint(SPEC)
    joint.set_speed(20)
    joint.set_acceleration(100)
    joint.move(30)  # 0.2 s up, 0.2 s down, 4 degrees; the other 26 at 20 deg/s
    seconds = 26 / 20 + 0.4
    joint.advance(0.1)
    assert at(joint) == pytest.approx((0.5, 10, 100))
    joint.advance(0.4)
    assert at(joint) == pytest.approx((2 + 6, 20, 0))
    joint.advance(seconds - 0.5 - 0.001)
    assert not done(joint)
    joint.advance(0.002)
    assert done(joint)
    assert at(joint) == (30, 0, 0)


def test_a_short_move_never_reaches_the_speed() -> None:
    joint = Joint(SPEC)
    joint.set_acceleration(100)
    joint.move(1)
    joint.advance(0.1)
    assert joint.motion.velocity == pytest.approx(10)
    joint.advance(0.1)
    assert at(joint) == pytest.approx((1, 0, 0), abs=1e-9)


@given(st.floats(-100, 100), st.floats(0, 2))
def test_stop_decelerates_at_once_and_never_turns_back(velocity: float, seconds: float) -> None:
    joint = Joint(SPEC)
    joint.set_mode(Mode.VELOCITY)
    joint.run(velocity)
    joint.advance(seconds)
    begin = joint.motion
    joint.stop()
    previous = begin
    for _ in range(100):
        joint.advance(0.005)
        assert abs(joint.motion.velocity) <= abs(previous.velocity) + TOLERANCE
        assert (joint.motion.position - previous.position) * begin.velocity >= -TOLERANCE
        previous = joint.motion
    assert joint.motion.velocity == 0
    assert joint.target == joint.motion.position
    assert not moving(joint)
    expected = begin.velocity**2 / (2 * SPEC.max_acceleration_deg_s2)
    assert abs(joint.motion.position - begin.position) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("velocity", "end"), [(40.0, SPEC.max_deg), (-1e9, SPEC.min_deg)])
def test_velocity_mode_stops_at_the_limit(velocity: float, end: float) -> None:
    joint = Joint(SPEC)
    joint.set_mode(Mode.VELOCITY)
    joint.run(velocity)
    assert abs(joint.velocity_target) == min(abs(velocity), SPEC.max_speed_deg_s)
    joint.advance(0.3)
    assert joint.motion.velocity == pytest.approx(math.copysign(min(abs(velocity), 60), velocity))
    run(joint, 4)
    assert at(joint) == (end, 0, 0)
    joint.run(-velocity)
    joint.advance(0.05)
    assert joint.motion.velocity * velocity < 0


def test_a_lower_acceleration_set_in_the_middle_of_a_move_still_stops_before_the_limit() -> None:
    joint = Joint(SPEC)
    joint.set_speed(100)
    joint.set_acceleration(400)
    joint.move(SPEC.max_deg)
    joint.advance(0.5)
    joint.set_acceleration(1)
    joint.move(SPEC.max_deg - 5)
    positions = []
    for _ in range(400):
        joint.advance(0.01)
        positions.append(joint.motion.position)
    assert max(positions) <= SPEC.max_deg


def test_position_direct_follows_at_full_speed() -> None:
    joint = Joint(SPEC)
    joint.set_mode(Mode.POSITION_DIRECT)
    for count in range(50):
        joint.follow(0.2 * count)
        joint.advance(0.02)
    joint.advance(0.1)
    assert joint.motion.position == pytest.approx(0.2 * 49)
    joint.follow(1e9)
    joint.advance(5)
    assert joint.motion.position == joint.direct_target == SPEC.max_deg


def test_a_change_of_mode_brakes() -> None:
    joint = Joint(SPEC)
    joint.set_mode(Mode.VELOCITY)
    joint.run(50)
    joint.advance(0.5)
    joint.set_mode(Mode.VELOCITY)
    assert joint.velocity_target == 50
    joint.set_mode(Mode.IDLE)
    joint.advance(1)
    assert joint.motion.velocity == 0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(value: float) -> None:
    joint = Joint(SPEC)
    for command in (joint.move, joint.set_speed, joint.set_acceleration):
        with pytest.raises(CommandRefusedError):
            command(value)
    for nothing in (0.0, -1.0):
        with pytest.raises(CommandRefusedError, match="neck_yaw"):
            joint.set_speed(nothing)
    assert at(joint) == (0, 0, 0)
    assert not moving(joint)


def test_a_command_of_another_mode_is_refused() -> None:
    joint = Joint(SPEC)
    with pytest.raises(CommandRefusedError, match="'pos'; set 'vel' or 'mix' first"):
        joint.run(1)
    with pytest.raises(CommandRefusedError, match="set 'posd' first"):
        joint.follow(1)
    joint.set_mode(Mode.IDLE)
    with pytest.raises(CommandRefusedError, match="'idl'"):
        joint.move(1)
    joint.set_mode(Mode.MIXED)
    joint.run(1)
    joint.move(1)


def test_the_body_keeps_one_time_for_all_joints() -> None:
    body = Body()
    for joint in body.joints:
        joint.move(10)
    body.advance_to(100)
    body.advance_to(50)
    assert body.time_s == 100
    assert body.positions == [10] * 6
    assert body.velocities == body.accelerations == [0] * 6
