"""The control board of the head: what its YARP ports `rpc:i` and `command:i` understand.

The protocol is that of `controlBoard_nws_yarp` in YARP 3.12: bottles of vocabs (strings do as
well), `[is] <what> value... [tsta] count time [ok]` as answers to `[get]`, `[ok]` to `[set]`,
`[fail]` for what cannot be done and `[nak]` for what is no request at all.

Where real boards differ from each other, this one is so:

- A position beyond the limits is clamped, as firmware does; `[get] [pos]` tells where it goes.
- A command that the present control mode does not allow fails; so do the modes `torq`, `ipwm` and
  `icur`, compliance, calibration, and setting encoders or limits.
- There are no motors behind the joints: torques, currents and duty cycles read 0.
"""

from __future__ import annotations

import logging
from array import array
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from vertebra.errors import CommandRefusedError
from vertebra.yarp import Value, Vocab
from vertebra.yarp.objects import JointData, JointModes, JointValues
from vertebra_simulator.body import Body, Joint, Mode

log = logging.getLogger(__name__)

OK: Final = Vocab("ok")
FAIL: Final = Vocab("fail")
NAK: Final = Vocab("nak")
_IS: Final = Vocab("is")
_STIFF: Final = Vocab("stif")
_REVOLUTE: Final = Vocab("atrv").code
_MODES: Final = {mode.value: mode for mode in Mode} | {"fidl": Mode.IDLE}

Reading = Callable[[Joint], float]
Command = Callable[[Joint, float], None]

_READINGS: Final[dict[str, Reading]] = {
    "enc": lambda joint: joint.motion.position,
    "esp": lambda joint: joint.motion.velocity,
    "eac": lambda joint: joint.motion.acceleration,
    "pos": lambda joint: joint.target,
    "vel": lambda joint: joint.speed,
    "acc": lambda joint: joint.acceleration,
    "vmo": lambda joint: joint.velocity_target,
    "dpo": lambda joint: joint.direct_target,
    "mnc": lambda joint: joint.motion.position,
    "acu": lambda _: 0.0,
    "tmp": lambda _: 37.0,
}
_COMMANDS: Final[dict[str, Command]] = {
    "pos": Joint.move,
    "rel": lambda joint, way: joint.move(joint.motion.position + way),
    "vel": Joint.set_speed,
    "acc": Joint.set_acceleration,
}
_STREAMED: Final[dict[str, Command]] = {"dpo": Joint.follow, "vmo": Joint.run}


class ControlBoard:
    """Answers requests about a body and gives it commands."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._stamps = 0

    def answer(self, request: Sequence[Value], now_s: float) -> list[Value]:
        """Return the answer to a request that came on `rpc:i`; `now_s` is told as its time."""
        if len(request) < 2:
            return [NAK]
        try:
            match _word(request[0]):
                case "get":
                    return self._get(request, now_s)
                case "set":
                    self._set(_word(request[1]), request[2:])
                    return [OK]
        except CommandRefusedError as error:
            log.debug("refused %r: %s", request, error)
        return [FAIL]

    def command(self, head: Sequence[Value], body: Sequence[float]) -> None:
        """Carry out a command that came on `command:i`.

        Raises:
            CommandRefusedError: It is unknown, or does not fit the joints or their control mode.
        """
        what, rest = (_word(head[0]), head[1:]) if head else ("", head)
        if what == "poss":
            _apply(Joint.move, self._body.joints, body)
        elif what in _STREAMED:
            _apply(_STREAMED[what], [self._joint(rest)], body)
        elif what[:-1] in _STREAMED and what.endswith("s"):
            _apply(_STREAMED[what[:-1]], self._body.joints, body)
        elif what[:-1] in _STREAMED and what.endswith("g"):
            _apply(_STREAMED[what[:-1]], self._group(rest), body)
        else:
            raise CommandRefusedError(f"unknown streamed command {list(head)!r}")

    def state(self) -> JointData:
        """Return what streams on `stateExt:o`."""
        joints = self._body.joints
        positions, velocities, accelerations = (
            JointValues(array("d", values), ok=True)
            for values in (self._body.positions, self._body.velocities, self._body.accelerations)
        )
        unmeasured = JointValues(array("d", bytes(8 * len(joints))), ok=False)
        return JointData(
            joint_position=positions,
            joint_velocity=velocities,
            joint_acceleration=accelerations,
            motor_position=positions,
            motor_velocity=velocities,
            motor_acceleration=accelerations,
            torque=unmeasured,
            pwm_dutycycle=unmeasured,
            current=unmeasured,
            control_mode=JointModes(tuple(Vocab(joint.mode.value) for joint in joints), ok=True),
            interaction_mode=JointModes((_STIFF,) * len(joints), ok=True),
        )

    # --- [get] -------------------------------------------------------------------------------

    def _get(self, request: Sequence[Value], now_s: float) -> list[Value]:
        what, rest = _word(request[1]), request[2:]
        if what == "prot":
            return [Vocab("prot"), 1, 9, 0, OK]
        if what == "ipwm":
            return [_IS, request[1], *self._unmeasured(rest, ("ref", "pwm")), OK]
        if what == "icmd":
            values = [_IS, *self._control_modes(rest)]
        elif what == "intm":
            values = self._interaction_modes(rest)
        elif what == "torq":
            values = [_IS, request[1], *self._unmeasured(rest, ("ref", "trq"))]
        else:
            values = [_IS, request[1], *self._reading(what, rest)]
        count, self._stamps = self._stamps, self._stamps + 1
        return [*values, Vocab("tsta"), count, now_s, OK]

    def _reading(self, what: str, rest: Sequence[Value]) -> list[Value]:
        joints = self._body.joints
        match what:
            case "axes" | "mnum":
                return [len(joints)]
            case "name":
                return [self._joint(rest).spec.name]
            case "type":
                self._joint(rest)
                return [_REVOLUTE]
            case "llim":
                spec = self._joint(rest).spec
                return [spec.min_deg, spec.max_deg]
            case "vlim":
                return [0.0, self._joint(rest).spec.max_speed_deg_s]
            case "don":
                return [int(self._joint(rest).move_done)]
            case "dons":
                return [int(all(joint.move_done for joint in joints))]
            case "dong":
                return [int(all(joint.move_done for joint in self._group(rest)))]
            case "asta":
                return [[int(joint.mode is not Mode.IDLE) for joint in joints]]
        if what in _READINGS:
            return [_READINGS[what](self._joint(rest))]
        read = _READINGS.get(what[:-1])
        if read is not None and what.endswith("s"):
            return [[read(joint) for joint in joints]]
        if read is not None and what.endswith("g"):
            return [[read(joint) for joint in self._group(rest)]]
        raise CommandRefusedError(f"there is no {what!r} to get")

    def _control_modes(self, rest: Sequence[Value]) -> list[Value]:
        match rest:
            case [what, *which] if _word(what) == "cmod":
                joint = self._joint(which)
                return [which[0], Vocab(joint.mode.value)]
            case [what] if _word(what) == "cmds":
                return [what, [Vocab(joint.mode.value) for joint in self._body.joints]]
            case [what, *which] if _word(what) == "cmog":
                return [what, [Vocab(joint.mode.value) for joint in self._group(which)]]
        raise CommandRefusedError("a control mode is asked for by cmod, cmds or cmog")

    def _interaction_modes(self, rest: Sequence[Value]) -> list[Value]:
        match rest:
            case [what, *which] if _word(what) == "mode":
                self._joint(which)
                return [_STIFF]
            case [what] if _word(what) == "mods":
                return [[_STIFF] * len(self._body.joints)]
        raise CommandRefusedError("an interaction mode is asked for by mode or mods")

    def _unmeasured(self, rest: Sequence[Value], known: Iterable[str]) -> list[Value]:
        """Return 0 for one joint, or a list of them where the word ends in `s`."""
        what = _word(rest[0]) if rest else ""
        if what in known:
            self._joint(rest[1:])
            return [0.0]
        if what.removesuffix("s") in known:
            return [[0.0] * len(self._body.joints)]
        raise CommandRefusedError(f"there is no {what!r} to get")

    # --- [set] -------------------------------------------------------------------------------

    def _set(self, what: str, rest: Sequence[Value]) -> None:
        joints = self._body.joints
        match what:
            case "vmos":
                _apply(Joint.run, joints, _numbers(rest))
            case "sto":
                self._joint(rest).stop()
            case "stos":
                for joint in joints:
                    joint.stop()
            case "stog":
                for joint in self._group(rest):
                    joint.stop()
            case "aen":
                joint = self._joint(rest)
                if joint.mode is Mode.IDLE:
                    joint.set_mode(Mode.POSITION)
            case "adi":
                self._joint(rest).set_mode(Mode.IDLE)
            case "icmd":
                self._set_control_modes(rest)
            case "intm":
                self._set_interaction_modes(rest)
            case _ if what in _COMMANDS:
                _apply(_COMMANDS[what], [self._joint(rest)], [_number(value) for value in rest[1:]])
            case _ if what[:-1] in _COMMANDS and what.endswith("s"):
                _apply(_COMMANDS[what[:-1]], joints, _numbers(rest))
            case _ if what[:-1] in _COMMANDS and what.endswith("g"):
                _apply(_COMMANDS[what[:-1]], self._group(rest[:2]), _numbers(rest[2:]))
            case _:
                raise CommandRefusedError(f"{what!r} cannot be set")

    def _set_control_modes(self, rest: Sequence[Value]) -> None:
        match rest:
            case [what, which, mode] if _word(what) == "cmod":
                _set_modes([self._joint([which])], [mode])
            case [what, list() as modes] if _word(what) == "cmds":
                _set_modes(self._body.joints, modes)
            case [what, count, list() as which, list() as modes] if _word(what) == "cmog":
                _set_modes(self._group([count, which]), modes)
            case _:
                raise CommandRefusedError("control modes are set by cmod, cmds or cmog")

    def _set_interaction_modes(self, rest: Sequence[Value]) -> None:
        match rest:
            case [what, which, mode] if _word(what) == "mode":
                self._joint([which])
                wanted: Sequence[Value] = [mode]
            case [what, list() as modes] if _word(what) == "mods":
                wanted = modes
                _check_count(len(self._body.joints), len(modes))
            case _:
                raise CommandRefusedError("interaction modes are set by mode or mods")
        if any(_word(mode) != _STIFF for mode in wanted):
            raise CommandRefusedError("this head is always stiff")

    # --- joints ------------------------------------------------------------------------------

    def _joint(self, rest: Sequence[Value]) -> Joint:
        """Return the joint whose number comes first in `rest`."""
        joints = self._body.joints
        number = rest[0] if rest else None
        if isinstance(number, bool) or not isinstance(number, int):
            raise CommandRefusedError(f"a joint number was expected, not {number!r}")
        if number not in range(len(joints)):
            raise CommandRefusedError(f"there is no joint {number}, only 0 to {len(joints) - 1}")
        return joints[number]

    def _group(self, rest: Sequence[Value]) -> list[Joint]:
        """Return the joints of `count (numbers)`."""
        match rest:
            case [int() as count, list() as numbers]:
                _check_count(count, len(numbers))
                return [self._joint([number]) for number in numbers]
        raise CommandRefusedError(f"a count and a list of joints was expected, not {rest!r}")


def _word(value: Value) -> str:
    """Return a vocab, or what YARP makes of a string: its first four characters."""
    if not isinstance(value, str):
        raise CommandRefusedError(f"a vocab was expected, not {value!r}")
    return value[:4]


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CommandRefusedError(f"a number was expected, not {value!r}")
    return float(value)


def _numbers(rest: Sequence[Value]) -> list[float]:
    match rest:
        case [list() as values]:
            return [_number(value) for value in values]
    raise CommandRefusedError(f"one list of numbers was expected, not {rest!r}")


def _apply(command: Command, joints: Sequence[Joint], values: Sequence[float]) -> None:
    _check_count(len(joints), len(values))
    for joint, value in zip(joints, values, strict=True):
        command(joint, value)


def _set_modes(joints: Sequence[Joint], modes: Sequence[Value]) -> None:
    _check_count(len(joints), len(modes))
    wanted = [_MODES.get(_word(mode)) for mode in modes]
    for joint, mode in zip(joints, wanted, strict=True):
        if mode is None:
            raise CommandRefusedError(f"no such control mode here; known: {', '.join(_MODES)}")
        joint.set_mode(mode)


def _check_count(joints: int, values: int) -> None:
    if joints != values:
        raise CommandRefusedError(f"{values} values for {joints} joints")
