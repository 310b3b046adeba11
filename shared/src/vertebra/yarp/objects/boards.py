"""What goes to and comes from a control board: commands, and the state of its joints."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.objects.parts import (
    I32,
    TWO_I32,
    YarpObject,
    damage,
    floats,
    number_list,
    vector,
)
from vertebra.yarp.objects.vectors import Vector
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Buffer, Value, Vocab
from vertebra.yarp.protocol.dialect import INT32, LIST, VOCAB32, Dialect


@dataclass(frozen=True, slots=True)
class Pair(YarpObject):
    """A streamed command: what to do, as a bottle such as `[dpo] 3`, and the numbers for it."""

    head: list[Value]
    body: Vector

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the pair in binary.

        Raises:
            EncodeError: The head has no form in this dialect.
        """
        head = bottle.encode(self.head, dialect)
        return TWO_I32.pack(LIST, 2) + head + self.body.encode(dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the pair in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if bytes(payload[:8]) != TWO_I32.pack(LIST, 2):
            raise damage("pair", "it is no list of two")
        head, end = bottle.decode_prefix(payload, 8, dialect)
        return cls(head, Vector.decode(memoryview(payload)[end:], dialect))


@dataclass(frozen=True, slots=True)
class JointValues:
    """One number for each joint; `ok` tells whether the robot could measure them."""

    values: array[float] = field(default_factory=lambda: array("d"))
    ok: bool = False


@dataclass(frozen=True, slots=True)
class JointModes:
    """One word for each joint, such as `pos`; `ok` tells whether the robot could tell."""

    words: tuple[Vocab, ...] = ()
    ok: bool = False


_FLAGS: Final = {True: b"ok\0\0", False: b"fail"}


@dataclass(frozen=True, slots=True, kw_only=True)
class JointData(YarpObject):
    """What a control board streams on `stateExt:o`; the fields are in the order of the wire.

    Positions are in degrees, speeds in degrees per second, and so on. Only YARP 4 carries
    temperatures; it sends them and the duty cycle in single precision.
    """

    joint_position: JointValues = JointValues()
    joint_velocity: JointValues = JointValues()
    joint_acceleration: JointValues = JointValues()
    motor_position: JointValues = JointValues()
    motor_velocity: JointValues = JointValues()
    motor_acceleration: JointValues = JointValues()
    torque: JointValues = JointValues()
    pwm_dutycycle: JointValues = JointValues()
    current: JointValues = JointValues()
    control_mode: JointModes = JointModes()
    interaction_mode: JointModes = JointModes()
    temperature: JointValues = JointValues()

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the state in binary.

        Raises:
            EncodeError: A mode has more than four letters.
        """
        parts = [TWO_I32.pack(LIST, 2 * len(_JOINT_FIELDS[dialect]))]
        for name in _JOINT_FIELDS[dialect]:
            item: JointValues | JointModes = getattr(self, name)
            if isinstance(item, JointModes):
                parts.append(_modes(item.words))
            elif dialect is Dialect.V4 and name in _SINGLE_PRECISION:
                parts.append(vector(dialect.float32, "f", item.values))
            else:
                parts.append(floats(item.values, dialect))
            parts.append(I32.pack(VOCAB32) + _FLAGS[item.ok])
        return b"".join(parts)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the state in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        names = _JOINT_FIELDS[dialect]
        values = bottle.decode(payload, dialect)
        if len(values) != 2 * len(names):
            raise damage(
                "jointData", f"{len(values)} fields instead of {2 * len(names)} ({dialect})"
            )
        items: dict[str, Any] = {
            name: _joint_item(name, numbers, flag)
            for name, numbers, flag in zip(names, values[::2], values[1::2], strict=True)
        }
        return cls(**items)


_MODES: Final = ("control_mode", "interaction_mode")
_SINGLE_PRECISION: Final = ("pwm_dutycycle", "temperature")
_ALL_JOINT_FIELDS: Final = tuple(JointData.__dataclass_fields__)
_JOINT_FIELDS: Final = {Dialect.V3: _ALL_JOINT_FIELDS[:-1], Dialect.V4: _ALL_JOINT_FIELDS}


def _modes(words: Sequence[Vocab]) -> bytes:
    try:
        return vector(INT32, "i", array("i", [word.code for word in words]))
    except OverflowError:
        raise EncodeError(f"modes have at most four letters: {words!r}") from None


def _joint_item(name: str, numbers: Value, flag: Value) -> JointValues | JointModes:
    if flag not in ("ok", "fail"):
        raise damage("jointData", f"the flag of {name} is {flag!r}, neither ok nor fail")
    if name not in _MODES:
        return JointValues(number_list("jointData", name, numbers), flag == "ok")
    if not isinstance(numbers, list) or any(type(code) is not int for code in numbers):
        raise damage("jointData", f"{name} is no list of int32")
    return JointModes(tuple(map(Vocab.from_code, numbers)), flag == "ok")
