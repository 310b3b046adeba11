"""What to say to a YARP control board and what its answers mean; no I/O.

The words are those of `controlBoard_nws_yarp` in YARP 3 (vocabs over RPC): requests are
`[get] [llim] 0`, answers `[is] [llim] -30.0 22.0 [tsta] 7 1234.5 [ok]`, refusals `[fail]`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
from msgspec import Struct

from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.yarp import Value, Vocab, to_text

GET: Final = Vocab("get")
SET: Final = Vocab("set")
_STAMP_VALUES: Final = 3  # [tsta] count time

AXES: Final[list[Value]] = [GET, Vocab("axes")]
ENCODERS: Final[list[Value]] = [GET, Vocab("encs")]
MOTION_DONE: Final[list[Value]] = [GET, Vocab("dons")]
STOP: Final[list[Value]] = [SET, Vocab("stos")]
MODES: Final[list[Value]] = [GET, Vocab("icmd"), Vocab("cmds")]


class Joint(Struct, frozen=True, kw_only=True):
    """A joint as the robot describes it.

    Attributes:
        name: As the robot calls it.
        min_deg: Lower end of its range.
        max_deg: Upper end.
        max_velocity_deg_s: Fastest it may be asked to go, 0 if the robot does not say.
    """

    name: str
    min_deg: float
    max_deg: float
    max_velocity_deg_s: float


class Move(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A position move, as the call `<part>/move` takes it.

    Attributes:
        positions_deg: Targets by joint name; joints that are not named keep theirs.
        velocity_deg_s: Speed of these joints; None keeps what is set.
        wait: Answer when the joints have arrived, not when they have started.
    """

    positions_deg: dict[str, float]
    velocity_deg_s: float | None = None
    wait: bool = True


def joint_requests(joint: int) -> tuple[list[Value], list[Value], list[Value]]:
    """Return the requests for name, position limits and velocity limits of a joint."""
    return (
        [GET, Vocab("name"), joint],
        [GET, Vocab("llim"), joint],
        [GET, Vocab("vlim"), joint],
    )


def joint_of(index: int, name: list[Value], limits: list[Value], speeds: list[Value]) -> Joint:
    """Return the joint that three answers describe."""
    low, high = (_number(value) for value in limits[:2])
    fastest = max((abs(_number(value)) for value in speeds[:2]), default=0.0)
    return Joint(
        name=str(name[0]) if name and name[0] else f"joint_{index}",
        min_deg=low,
        max_deg=high,
        max_velocity_deg_s=fastest,
    )


def read_move(payload: bytes, joints: Sequence[Joint]) -> Move:
    """Return the move in JSON text if these joints can do it.

    Raises:
        CommandRefusedError: It is no move, or outside the limits of a joint.
    """
    try:
        move = msgspec.json.decode(payload, type=Move)
    except msgspec.DecodeError as error:
        raise CommandRefusedError(
            f'a move is {{"positions_deg": {{"<joint>": degrees}}, "velocity_deg_s": ..., '
            f'"wait": true}}: {error}'
        ) from error
    if not move.positions_deg:
        raise CommandRefusedError("positions_deg names no joint")
    by_name = {joint.name: joint for joint in joints}
    for name, target in move.positions_deg.items():
        joint = by_name.get(name)
        if joint is None:
            raise CommandRefusedError(f"no joint {name!r}; this part has {', '.join(by_name)}")
        if not math.isfinite(target) or not joint.min_deg <= target <= joint.max_deg:
            raise CommandRefusedError(
                f"{name} = {target:g} deg is outside its limits, "
                f"{joint.min_deg:g} to {joint.max_deg:g} deg"
            )
        speed = move.velocity_deg_s
        fastest = joint.max_velocity_deg_s or math.inf
        if speed is not None and not 0.0 < speed <= fastest:
            raise CommandRefusedError(
                f"velocity_deg_s = {speed:g} deg/s is outside the limits of {name}, "
                f"0 to {fastest:g} deg/s"
            )
    return move


def move_requests(move: Move, joints: Sequence[Joint], modes: Sequence[Value]) -> list[list[Value]]:
    """Return what makes these joints go: control modes where needed, speeds, targets."""
    order = [joint.name for joint in joints]
    indices = [order.index(name) for name in move.positions_deg]
    targets = [float(target) for target in move.positions_deg.values()]
    mode: list[list[Value]] = [
        [SET, Vocab("icmd"), Vocab("cmod"), index, Vocab("pos")]
        for index in indices
        if str(modes[index]) != "pos"
    ]
    speed: list[list[Value]] = []
    if move.velocity_deg_s is not None:
        speed = [[SET, Vocab("vel"), index, move.velocity_deg_s] for index in indices]
    return [*mode, *speed, [SET, Vocab("posg"), len(indices), list(indices), list(targets)]]


def answer_of(reply: list[Value], request: Sequence[Value]) -> list[Value]:
    """Return the values of an answer, without the words around them.

    Raises:
        RemoteError: The board refused, or said something that no board says.
    """
    said = to_text(reply) or "nothing"
    if not reply or str(reply[-1]) != "ok":
        raise RemoteError("RobotRefused", f"the robot answered {said} to {to_text(request)}")
    body = list(reply[:-1])
    if len(body) >= _STAMP_VALUES and str(body[-_STAMP_VALUES]) == "tsta":
        body = body[:-_STAMP_VALUES]
    if body and str(body[0]) == "is":
        body = body[2:]
    if len(body) == 1 and isinstance(body[0], list):
        return body[0]
    return body


def numbers_of(values: Sequence[Value], count: int) -> list[float]:
    """Return `count` numbers of an answer; raise `RemoteError` for anything else."""
    if len(values) != count:
        raise RemoteError("RobotRefused", f"the robot gave {len(values)} values for {count} joints")
    return [_number(value) for value in values]


def positions_of(joints: Sequence[Joint], degrees: Sequence[float]) -> dict[str, float]:
    """Return positions by joint name, rounded to what an encoder can tell."""
    return {joint.name: round(value, 4) for joint, value in zip(joints, degrees, strict=True)}


def describe(joints: Sequence[Joint]) -> Mapping[str, Any]:
    """Return the answer of `<part>/limits`."""
    return {"joints": [msgspec.to_builtins(joint) for joint in joints]}


def _number(value: Value) -> float:
    if isinstance(value, bool | int | float):
        return float(value)
    raise RemoteError("RobotRefused", f"the robot gave {value!r} where a number belongs")
