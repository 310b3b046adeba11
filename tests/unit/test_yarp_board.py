"""Commands to control boards are held to the limits that the robot told."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.messages import JointCommand
from vertebra.yarp import Vocab
from vertebra.yarp.objects import JointData, JointModes, JointValues
from vertebra_yarp import board
from vertebra_yarp.board import Direct, Joint, Modes, Move, MoveBy, Speeds, Velocity

JOINTS = (
    Joint(name="pan", min_deg=-50.0, max_deg=50.0, max_velocity_deg_s=100.0),
    Joint(name="tilt", min_deg=-30.0, max_deg=22.0, max_velocity_deg_s=None),
)
HERE = {"pan": 10.0, "tilt": 0.0}
ANY = st.floats(allow_nan=True, allow_infinity=True)


@given(ANY)
def test_no_position_beyond_the_limits_passes(target: float) -> None:
    within = -50.0 <= target <= 50.0
    move = Move(positions_deg={"pan": target})
    if within:
        assert board.check_move(move, JOINTS) is move
    else:
        with pytest.raises(CommandRefusedError, match=r"pan = .* limits, -50 to 50 deg"):
            board.check_move(move, JOINTS)


@given(ANY)
def test_no_velocity_beyond_the_limits_passes(velocity: float) -> None:
    command = Velocity(velocities_deg_s={"pan": velocity})
    if abs(velocity) <= 100.0:
        assert board.check_velocity(command, JOINTS) is command
    else:
        with pytest.raises(CommandRefusedError, match=r"pan = .* limits, -100 to 100 deg/s"):
            board.check_velocity(command, JOINTS)


@given(ANY)
def test_no_speed_beyond_the_limits_passes(speed: float) -> None:
    move = Move(positions_deg={"pan": 0.0}, velocity_deg_s=speed)
    speeds = Speeds(speeds_deg_s={"pan": speed})
    if 0.0 < speed <= 100.0:
        board.check_move(move, JOINTS)
        board.check_speeds(speeds, JOINTS)
    else:
        with pytest.raises(CommandRefusedError, match=r"pan at .* above 0 to 100 deg/s"):
            board.check_move(move, JOINTS)
        with pytest.raises(CommandRefusedError, match=r"pan at .* above 0 to 100 deg/s"):
            board.check_speeds(speeds, JOINTS)


@given(ANY)
def test_direct_targets_are_within_the_limits_and_near(target: float) -> None:
    command = Direct(positions_deg={"pan": target})
    if abs(target - HERE["pan"]) <= board.MAX_STEP_DEG:
        assert board.check_direct(command, JOINTS, HERE) is command
    else:
        with pytest.raises(CommandRefusedError, match=r"limits|more than 10 deg at once"):
            board.check_direct(command, JOINTS, HERE)


@given(ANY)
def test_velocity_commands_end(for_s: float) -> None:
    command = Velocity(velocities_deg_s={"pan": 1.0}, for_s=for_s)
    if 0.0 < for_s <= board.MAX_RUN_S:
        board.check_velocity(command, JOINTS)
    else:
        with pytest.raises(CommandRefusedError, match=r"for_s = .* above 0 to 5 s"):
            board.check_velocity(command, JOINTS)


@given(st.floats(-200, 200))
def test_relative_moves_become_absolute_ones_within_the_limits(change: float) -> None:
    relative = MoveBy(changes_deg={"pan": change}, velocity_deg_s=20.0, wait=False)
    if -50.0 <= 10.0 + change <= 50.0:
        move = board.absolute(relative, JOINTS, HERE)
        assert move == Move(positions_deg={"pan": 10.0 + change}, velocity_deg_s=20.0, wait=False)
    else:
        with pytest.raises(CommandRefusedError, match="-50 to 50 deg"):
            board.absolute(relative, JOINTS, HERE)


def test_robot_that_tells_no_top_speed_sets_none() -> None:
    board.check_velocity(Velocity(velocities_deg_s={"tilt": 1e6}), JOINTS)
    for speed in (math.inf, math.nan):
        with pytest.raises(CommandRefusedError):
            board.check_velocity(Velocity(velocities_deg_s={"tilt": speed}), JOINTS)


@pytest.mark.parametrize(
    "check",
    [
        lambda names: board.check_move(Move(positions_deg=names), JOINTS),
        lambda names: board.absolute(MoveBy(changes_deg=names), JOINTS, HERE),
        lambda names: board.check_velocity(Velocity(velocities_deg_s=names), JOINTS),
        lambda names: board.check_direct(Direct(positions_deg=names), JOINTS, HERE),
    ],
)
def test_unknown_and_missing_joints_are_named(check: Callable[[dict[str, float]], object]) -> None:
    with pytest.raises(CommandRefusedError, match="no joint 'nose'; this part has pan, tilt"):
        check({"nose": 0.0})
    with pytest.raises(CommandRefusedError, match="no joint is named; this part has pan, tilt"):
        check({})


def test_modes_are_ours_on_one_side_and_theirs_on_the_other() -> None:
    command = Modes(modes={"tilt": "direct", "pan": "velocity"})
    assert board.check_modes(command, JOINTS) == ["posd", "vel"]
    with pytest.raises(CommandRefusedError, match=r"pan = 'torque': the modes are position, "):
        board.check_modes(Modes(modes={"pan": "torque"}), JOINTS)
    assert [board.mode_name(word) for word in ("pos", "hwfa", "torq", "new")] == [
        "position",
        "fault",
        "torque",
        "new",
    ]


@pytest.mark.parametrize(
    "text", ['{"positions_deg": 3}', "[", '{"position": {}}', '{"wait": 1}', "7"]
)
def test_what_is_no_command_is_told_what_one_is(text: str) -> None:
    with pytest.raises(CommandRefusedError, match="positions_deg, velocity_deg_s, wait"):
        board.read(text.encode(), Move)


def test_nothing_is_a_question() -> None:
    assert board.read(b"", Modes) == Modes()
    assert board.read(b"{}", Speeds) == Speeds()


def test_streamed_commands() -> None:
    def streamed(**fields: object) -> object:
        return board.streamed(JointCommand(names=("pan",), **fields))  # type: ignore[arg-type]

    assert streamed(positions_deg=(3.0,)) == Move(positions_deg={"pan": 3.0}, wait=False)
    assert streamed(positions_deg=(3.0,), mode="direct") == Direct(positions_deg={"pan": 3.0})
    assert streamed(velocities_deg_s=(3.0,)) == Velocity(velocities_deg_s={"pan": 3.0})


def test_joints_are_as_the_robot_tells() -> None:
    joint = board.joint_of(0, [Vocab("pan")], [-1, 2.5], [-40.0, 30.0])
    assert joint == Joint(name="pan", min_deg=-1.0, max_deg=2.5, max_velocity_deg_s=40.0)
    assert board.joint_of(3, [], [0.0, 0.0], [0.0, 0.0]).name == "joint_3"
    assert board.joint_of(3, [], [0.0, 0.0], []).max_velocity_deg_s is None
    with pytest.raises(RemoteError, match="no limits of joint 3"):
        board.joint_of(3, [], [1.0], [])


def test_description_is_json_with_nulls_for_what_is_not_known() -> None:
    pan, tilt = json.loads(json.dumps(board.describe(JOINTS)))["joints"]
    assert (pan["min_velocity_deg_s"], pan["max_velocity_deg_s"]) == (-100.0, 100.0)
    assert (tilt["min_velocity_deg_s"], tilt["max_velocity_deg_s"]) == (None, None)


def test_state_leaves_out_what_is_not_measured() -> None:
    data = JointData(
        joint_position=JointValues(array("d", [1.0, 2.0]), ok=True),
        joint_velocity=JointValues(array("d", [3.0, 4.0]), ok=True),
        torque=JointValues(array("d", [0.0, 0.0]), ok=False),
        control_mode=JointModes((Vocab("pos"), Vocab("vel")), ok=True),
    )
    state = board.state_of(data, JOINTS)
    assert (state.names, state.positions_deg) == (("pan", "tilt"), (1.0, 2.0))
    assert (state.velocities_deg_s, state.efforts_nm) == ((3.0, 4.0), ())
    with pytest.raises(ValueError, match="2 values for 1 joints"):
        board.state_of(data, JOINTS[:1])
