"""What may be asked of a control board, in JSON, and what is checked before it leaves; no I/O."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, TypeVar

import msgspec
from msgspec import Struct

from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.messages import JointCommand, JointState
from vertebra.yarp import Value
from vertebra.yarp.objects import JointData, JointValues
from vertebra_yarp.words import REFUSED, number

MAX_RUN_S: Final = 5.0
"""Longest time for which one velocity command holds."""
MAX_STEP_DEG: Final = 10.0
"""Farthest that a position-direct target may be from where its joint is."""

MODES: Final = {
    "position": "pos",
    "direct": "posd",
    "velocity": "vel",
    "mixed": "mix",
    "idle": "idl",
}
"""Control modes that can be set, and YARP's words; those of force need a loop of their own."""
_MODE_NAMES: Final = {word: name for name, word in MODES.items()} | {
    "torq": "torque",
    "icur": "current",
    "ipwm": "pwm",
    "hwfa": "fault",
    "cal": "calibrating",
}


class Joint(Struct, frozen=True, kw_only=True):
    """A joint as the robot describes it.

    Attributes:
        name: As the robot calls it.
        min_deg: Lower end of its range.
        max_deg: Upper end.
        max_velocity_deg_s: Fastest it may be asked to go, None if the robot does not say.
    """

    name: str
    min_deg: float
    max_deg: float
    max_velocity_deg_s: float | None


class Command(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A call to a robot part."""


class Move(Command, frozen=True, kw_only=True):
    """A position move, as the call `<part>/move` takes it.

    Attributes:
        positions_deg: Targets by joint name; joints that are not named keep theirs.
        velocity_deg_s: Speed of these joints; None keeps what is set.
        wait: Answer when the joints have arrived, not when they have started.
    """

    positions_deg: dict[str, float]
    velocity_deg_s: float | None = None
    wait: bool = True


class MoveBy(Command, frozen=True, kw_only=True):
    """A relative position move, as the call `<part>/move_by` takes it; else like `Move`."""

    changes_deg: dict[str, float]
    velocity_deg_s: float | None = None
    wait: bool = True


class Velocity(Command, frozen=True, kw_only=True):
    """A velocity command, as the call `<part>/velocity` takes it.

    Attributes:
        velocities_deg_s: By joint name; a joint that ran and is not named any more stops.
        for_s: The joints stop after this time unless a new command comes before.
    """

    velocities_deg_s: dict[str, float]
    for_s: float = 0.5


class Direct(Command, frozen=True, kw_only=True):
    """A position-direct command, as the call `<part>/direct` takes it.

    Attributes:
        positions_deg: Where the joints shall be at once, at most `MAX_STEP_DEG` from here.
    """

    positions_deg: dict[str, float]


class Modes(Command, frozen=True, kw_only=True):
    """Control modes to set by joint name, as the call `<part>/modes` takes them; or none."""

    modes: dict[str, str] = {}


class Speeds(Command, frozen=True, kw_only=True):
    """Speeds of position moves to set, as the call `<part>/speeds` takes them; or none."""

    speeds_deg_s: dict[str, float] = {}


C = TypeVar("C", bound=Command)


def read(payload: bytes, command: type[C]) -> C:
    """Return the command in JSON text; raise `CommandRefusedError`."""
    try:
        return msgspec.json.decode(payload or b"{}", type=command)
    except msgspec.DecodeError as error:
        fields = ", ".join(command.__struct_fields__)
        raise CommandRefusedError(f"this call takes a JSON object of {fields}: {error}") from error


def joint_of(index: int, name: list[Value], limits: list[Value], speeds: list[Value]) -> Joint:
    """Return the joint that three answers describe."""
    if len(limits) < 2:
        raise RemoteError(REFUSED, f"the robot told no limits of joint {index}: {limits!r}")
    low, high = map(number, limits[:2])
    fastest = max((abs(number(value)) for value in speeds[:2]), default=0.0)
    return Joint(
        name=str(name[0]) if name and name[0] else f"joint_{index}",
        min_deg=low,
        max_deg=high,
        max_velocity_deg_s=fastest or None,
    )


def indices_of(names: Iterable[str], joints: Sequence[Joint]) -> list[int]:
    """Return the numbers of named joints; raise `CommandRefusedError` for none or unknown ones."""
    numbers = {joint.name: index for index, joint in enumerate(joints)}
    wanted = [*names]
    for name in wanted:
        if name not in numbers:
            raise CommandRefusedError(f"no joint {name!r}; this part has {', '.join(numbers)}")
    if not wanted:
        raise CommandRefusedError(f"no joint is named; this part has {', '.join(numbers)}")
    return [numbers[name] for name in wanted]


def check_move(move: Move, joints: Sequence[Joint]) -> Move:
    """Return `move` if these joints can do it; raise `CommandRefusedError`."""
    for index in indices_of(move.positions_deg, joints):
        joint = joints[index]
        _check_position(joint, move.positions_deg[joint.name])
        if move.velocity_deg_s is not None:
            _check_speed(joint, move.velocity_deg_s)
    return move


def absolute(move: MoveBy, joints: Sequence[Joint], positions: Mapping[str, float]) -> Move:
    """Return the move to where a relative one leads from `positions`.

    The robot gets the absolute one: what was checked is what it does, wherever the joints are by
    then.
    """
    indices_of(move.changes_deg, joints)
    targets = {name: positions[name] + change for name, change in move.changes_deg.items()}
    return check_move(
        Move(positions_deg=targets, velocity_deg_s=move.velocity_deg_s, wait=move.wait), joints
    )


def check_velocity(command: Velocity, joints: Sequence[Joint]) -> Velocity:
    """Return `command` if these joints can do it; raise `CommandRefusedError`."""
    for index in indices_of(command.velocities_deg_s, joints):
        joint = joints[index]
        value = command.velocities_deg_s[joint.name]
        fastest = joint.max_velocity_deg_s or math.inf
        if not math.isfinite(value) or abs(value) > fastest:
            raise CommandRefusedError(
                f"{joint.name} = {value:g} deg/s is outside its limits, "
                f"{-fastest:g} to {fastest:g} deg/s"
            )
    if not 0.0 < command.for_s <= MAX_RUN_S:
        raise CommandRefusedError(
            f"for_s = {command.for_s:g} s is outside its limits, above 0 to {MAX_RUN_S:g} s; "
            "send the command again before it ends"
        )
    return command


def check_direct(
    command: Direct, joints: Sequence[Joint], positions: Mapping[str, float]
) -> Direct:
    """Return `command` if these joints can do it from `positions`; raise `CommandRefusedError`.

    Nothing plans a way to a direct target: the joint goes there as fast as its motor can. A step
    that is too long is a mistake, or belongs to a move.
    """
    for index in indices_of(command.positions_deg, joints):
        joint = joints[index]
        target = command.positions_deg[joint.name]
        _check_position(joint, target)
        if abs(target - positions[joint.name]) > MAX_STEP_DEG:
            raise CommandRefusedError(
                f"{joint.name} = {target:g} deg is {abs(target - positions[joint.name]):g} deg "
                f"away, more than {MAX_STEP_DEG:g} deg at once; come nearer with a move"
            )
    return command


def check_modes(command: Modes, joints: Sequence[Joint]) -> list[str]:
    """Return YARP's words for the modes; raise `CommandRefusedError`."""
    indices_of(command.modes, joints)
    for name, mode in command.modes.items():
        if mode not in MODES:
            raise CommandRefusedError(f"{name} = {mode!r}: the modes are {', '.join(MODES)}")
    return [MODES[mode] for mode in command.modes.values()]


def check_speeds(command: Speeds, joints: Sequence[Joint]) -> Speeds:
    """Return `command` if these joints can do it; raise `CommandRefusedError`."""
    for index in indices_of(command.speeds_deg_s, joints):
        _check_speed(joints[index], command.speeds_deg_s[joints[index].name])
    return command


def streamed(command: JointCommand) -> Move | Velocity | Direct:
    """Return what a message on `<part>/command` asks for, before it is checked."""
    if command.velocities_deg_s:
        velocities = dict(zip(command.names, command.velocities_deg_s, strict=True))
        return Velocity(velocities_deg_s=velocities)
    positions = dict(zip(command.names, command.positions_deg, strict=True))
    if command.mode == "direct":
        return Direct(positions_deg=positions)
    return Move(positions_deg=positions, wait=False)


def by_name(joints: Sequence[Joint], values: Sequence[float]) -> dict[str, float]:
    """Return numbers by joint name, rounded to what an encoder can tell."""
    return {joint.name: round(value, 4) for joint, value in zip(joints, values, strict=True)}


def mode_name(word: str) -> str:
    """Return our name of a control mode; a word that is none of ours stays as it is."""
    return _MODE_NAMES.get(word, word)


def describe(joints: Sequence[Joint]) -> Mapping[str, Any]:
    """Return the answer of `<part>/limits`."""
    return {
        "joints": [
            {
                **msgspec.to_builtins(joint),
                "min_velocity_deg_s": joint.max_velocity_deg_s and -joint.max_velocity_deg_s,
            }
            for joint in joints
        ]
    }


def state_of(data: JointData, joints: Sequence[Joint]) -> JointState:
    """Return what `stateExt:o` tells; what the robot does not measure is left out.

    Raises:
        ValueError: It tells of another number of joints.
    """

    def measured(values: JointValues) -> tuple[float, ...]:
        return tuple(values.values) if values.ok else ()

    return JointState(
        names=tuple(joint.name for joint in joints),
        positions_deg=measured(data.joint_position),
        velocities_deg_s=measured(data.joint_velocity),
        efforts_nm=measured(data.torque),
    )


def _check_position(joint: Joint, target: float) -> None:
    if not math.isfinite(target) or not joint.min_deg <= target <= joint.max_deg:
        raise CommandRefusedError(
            f"{joint.name} = {target:g} deg is outside its limits, "
            f"{joint.min_deg:g} to {joint.max_deg:g} deg"
        )


def _check_speed(joint: Joint, speed: float) -> None:
    fastest = joint.max_velocity_deg_s or math.inf
    if not 0.0 < speed <= fastest or not math.isfinite(speed):
        raise CommandRefusedError(
            f"{joint.name} at {speed:g} deg/s is outside its limits, above 0 to {fastest:g} deg/s"
        )
