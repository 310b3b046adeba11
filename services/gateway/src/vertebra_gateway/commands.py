"""What may be sent to a robot: inputs are held to their schema and to the robot's own limits."""

from __future__ import annotations

import math
from typing import Any, Final

import msgspec
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from msgspec import Struct

from vertebra.errors import DecodeError
from vertebra_gateway.problems import InputRefusedError
from vertebra_gateway.profile import LimitSource, Resource

_NO_INPUT: Final = {"type": "object", "maxProperties": 0}


class Limit(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What bounds a number; a bound that does not exist is None."""

    min: float | None = None
    max: float | None = None
    unit: str

    def holds(self, value: float) -> bool:
        """Say whether `value` lies within."""
        return (self.min is None or value >= self.min) and (self.max is None or value <= self.max)


Limits = dict[str, dict[str, Limit]]
"""By field of the input, then by joint."""


class _Joint(Struct):
    name: str


def read_limits(answer: bytes, source: LimitSource) -> Limits:
    """Return the limits in a robot's answer.

    Raises:
        DecodeError: The answer has not the form or not the numbers that the profile promises.
    """
    try:
        joints = msgspec.json.decode(answer, type=dict[str, list[dict[str, Any]]])["joints"]
        return {
            field: {
                msgspec.convert(joint, _Joint).name: Limit(
                    min=None if wanted.min is None else _number(joint, wanted.min),
                    max=None if wanted.max is None else _number(joint, wanted.max),
                    unit=wanted.unit,
                )
                for joint in joints
            }
            for field, wanted in source.fields.items()
        }
    except (KeyError, msgspec.MsgspecError) as error:
        raise DecodeError(
            f"the limits of {source.source} have not the form that the profile describes: {error}"
        ) from error


def _number(joint: dict[str, Any], name: str) -> float | None:
    value = msgspec.convert(joint[name], float | None)
    if value is not None and not math.isfinite(value):
        raise DecodeError(f"{name} of {joint['name']!r} is {value}")
    return value


class InputCheck:
    """Checks the input of one call before anything reaches the robot."""

    def __init__(self, resource: Resource) -> None:
        self._validator = Draft202012Validator(resource.input or _NO_INPUT)

    def check(self, body: Any, limits: Limits) -> None:
        """Raise `InputRefusedError` if `body` is outside the schema or the limits."""
        _check_finite(body, "")
        fault = best_match(self._validator.iter_errors(body))
        if fault is not None:
            path = "/".join(str(step) for step in fault.absolute_path)
            where = f"{path}: " if path else ""
            raise InputRefusedError(f"{where}{fault.message}", path=path)
        named: set[str] = set()
        for field, by_joint in limits.items():
            targets = body.get(field)
            if isinstance(targets, dict):
                named |= targets.keys()
                for joint, value in targets.items():
                    _check_joint(field, joint, value, by_joint)
        for field, by_joint in limits.items():
            value = body.get(field)
            if isinstance(value, int | float):
                for joint in sorted(named & by_joint.keys()) or sorted(by_joint):
                    _check_joint(field, joint, value, by_joint)


def _check_joint(field: str, joint: str, value: float, limits: dict[str, Limit]) -> None:
    limit = limits.get(joint)
    if limit is None:
        raise InputRefusedError(
            f"there is no joint {joint!r}; known: {', '.join(sorted(limits))}",
            joint=joint,
            known=sorted(limits),
        )
    if not limit.holds(value):
        bounds = [
            f"{name} {bound:g}"
            for name, bound in (("min", limit.min), ("max", limit.max))
            if bound is not None
        ]
        raise InputRefusedError(
            f"{field} of {joint} = {value:g} {limit.unit} is outside its limit "
            f"({', '.join(bounds)} {limit.unit}); nothing was sent to the robot",
            joint=joint,
            value=value,
            limit=msgspec.to_builtins(limit),
        )


def _check_finite(value: Any, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise InputRefusedError(f"{path or 'the input'} is {value}, not a number", path=path)
    if isinstance(value, dict):
        for key, item in value.items():
            _check_finite(item, f"{path}/{key}".lstrip("/"))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _check_finite(item, f"{path}/{index}".lstrip("/"))
