"""Parameters of ROS nodes as plain values, and back; no I/O.

A `ParameterValue` has ten fields, of which its type says which one counts. A plain value is that
field alone: a boolean, a number, text, or a list of one of them; None is not set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from vertebra.errors import EncodeError
from vertebra.messages import Array

SERVICES: Final = {
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}
"""The services by which every ROS node is asked for its parameters, and their types."""
EVENTS: Final = "/parameter_events"
EVENT_TYPE: Final = "rcl_interfaces/msg/ParameterEvent"

KINDS: Final = (
    "not set", "boolean", "integer", "double", "string",
    "byte array", "boolean array", "integer array", "double array", "string array",
)  # fmt: skip
"""`ParameterType`, in the words of `ros2 param`."""
NOT_SET: Final = 0
_DOUBLE: Final = 3
_BYTES: Final = 5
_DOUBLES: Final = 8
_FIELDS: Final = (
    "", "bool_value", "integer_value", "double_value", "string_value",
    "byte_array_value", "bool_array_value", "integer_array_value", "double_array_value",
    "string_array_value",
)  # fmt: skip
_SCALARS: Final[dict[type, int]] = {bool: 1, int: 2, float: _DOUBLE, str: 4}
_LISTS: Final[dict[type, int]] = {bool: 6, int: 7, float: _DOUBLES, str: 9}
_WIDENED: Final[dict[tuple[int, int], Callable[[Any], Any]]] = {
    (2, _DOUBLE): float,
    (7, _DOUBLES): lambda items: [*map(float, items)],
    (7, _BYTES): list,
}
"""What a value of one kind is as another one, where nothing is lost."""


def plain_of(value: Mapping[str, Any]) -> Any:
    """Return the plain value of a `ParameterValue`; None if it is not set."""
    kind = value["type"]
    if not 0 < kind < len(_FIELDS):
        return None
    plain = value[_FIELDS[kind]]
    return plain.tolist() if isinstance(plain, Array) else plain


def kind_of(plain: Any) -> int:
    """Return the kind of parameter that a plain value makes; raise `EncodeError`."""
    if plain is None:
        return NOT_SET
    if not isinstance(plain, list):
        kind = _SCALARS.get(type(plain))
    elif {type(item) for item in plain} == {int, float}:
        kind = _DOUBLES
    else:
        kinds = {_LISTS.get(type(item)) for item in plain}
        kind = kinds.pop() if len(kinds) == 1 else None
    if kind is None:
        raise EncodeError(
            f"{plain!r} is no value of a parameter: they are booleans, numbers, text, and lists "
            "of one of them"
        )
    return kind


def value_of(plain: Any, kind: int = NOT_SET) -> dict[str, Any]:
    """Return the `ParameterValue` of a plain value, of the kind that the parameter has so far.

    Raises:
        EncodeError: It has no kind, or not that one.
    """
    is_empty = plain == [] and "array" in KINDS[kind]
    given = kind if is_empty else kind_of(plain)
    wanted = kind or given
    if given == _DOUBLES:
        plain = [*map(float, plain)]
    if NOT_SET != given != wanted:
        widen = _WIDENED.get((given, wanted))
        if widen is None:
            raise EncodeError(f"{plain!r} is {KINDS[given]}, the parameter is {KINDS[wanted]}")
        plain, given = widen(plain), wanted
    return {"type": given} | ({_FIELDS[given]: plain} if given else {})
