"""Golden CDR of ROS 2: one record of each type, and the bytes that ROS itself made of it.

    ros2/cdr.json       of each type the bytes of `record_of(type)`, in hexadecimal
    ros2/hashes.json    of each message, service and action its RIHS01 hash, as rosidl wrote it

The bytes of `by_ros` are those of rclpy (ROS 2 Jazzy, rmw_cyclonedds_cpp), and without padding;
those of `by_reference`, of packages that were not built there, are of the slow and obvious
serialiser below, which makes the same bytes as ROS for all the others. To write a type that is new:

    python tests/conformance/golden_ros2.py [--update]      with a sourced ROS 2 for `by_ros`
"""

from __future__ import annotations

import importlib
import itertools
import json
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import Field

FOLDER: Final = Path(__file__).parent / "ros2"
LETTERS: Final = {
    "int8": "b", "uint8": "B", "byte": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d", "bool": "?",
}  # fmt: skip

NOTHING: Final = "structure_needs_at_least_one_member"
"""The member of a type without members: nobody can set it."""


def record_of(types: Types, name: str) -> dict[str, Any]:
    """Return a record in which no two neighbours are the same; many numbers are a list.

    A sequence has three items, one within others has one.
    """
    return _record(types, name, itertools.count(1), 3)


def _record(types: Types, name: str, numbers: Iterator[int], most: int) -> dict[str, Any]:
    return {field.name: _value(types, field, numbers, most) for field in types.definition(name)}


def _value(types: Types, field: Field, numbers: Iterator[int], most: int) -> Any:
    if field.plural == "one":
        return _one(types, field, numbers, most)
    bound = field.count if field.plural == "bounded" else most
    count = field.count if field.plural == "array" else min(most, bound)
    return [_one(types, field, numbers, 1) for _ in range(count)]


def _one(types: Types, field: Field, numbers: Iterator[int], most: int) -> Any:
    if field.type not in (*LETTERS, "string", "wstring"):
        return _record(types, field.type, numbers, most)
    if field.name == NOTHING:
        return 0
    number = next(numbers)
    if field.type in ("string", "wstring"):
        text = f"{number}é{'x' * (number % 5)}"
        return text[: field.max_text] if field.max_text else text
    if field.type == "bool":
        return number % 2 == 1
    if field.type.startswith("float"):
        return number * -1.25
    size = struct.calcsize(LETTERS[field.type])
    value = int.from_bytes(bytes((number + 17 * place) % 256 for place in range(size)), "little")
    if field.type.startswith("int") and value >= 1 << (8 * size - 1):
        value -= 1 << (8 * size)
    return value


def reference(types: Types, name: str, record: dict[str, Any], order: str = "<") -> bytes:
    """Return the CDR of a record, header and all, without padding at its end."""
    out = bytearray()

    def align(size: int) -> None:
        out.extend(bytes(-len(out) % size))

    def put(kind: str, value: Any) -> None:
        if kind in LETTERS:
            align(struct.calcsize(LETTERS[kind]))
            out.extend(struct.pack(order + LETTERS[kind], value))
        elif kind == "string":
            data = value.encode() + b"\0"
            put("uint32", len(data))
            out.extend(data)
        elif kind == "wstring":
            units = [unit for (unit,) in struct.iter_unpack("<H", value.encode("utf-16-le"))]
            for number in (len(units), *units):
                put("uint32", number)
        else:
            put_record(kind, value)

    def put_record(kind: str, value: dict[str, Any]) -> None:
        for field in types.definition(kind):
            items = [value[field.name]] if field.plural == "one" else value[field.name]
            if field.plural in ("bounded", "sequence"):
                put("uint32", len(items))
            for item in items:
                put(field.type, item)

    put_record(name, record)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + bytes(out)


def by_ros(name: str, record: dict[str, Any]) -> bytes | None:
    """Return what rclpy makes of a record; None if there is no such type."""
    try:
        from rclpy.serialization import serialize_message  # only to write goldens
    except ImportError:
        return None
    kind = _ros_class(name)
    return None if kind is None else bytes(serialize_message(_message(kind, record)))


def _ros_class(name: str) -> Any:
    package, folder, leaf = name.split("/")
    try:
        found: Any = importlib.import_module(f"{package}.{folder}")
    except ImportError:
        return None
    if hasattr(found, leaf):
        return getattr(found, leaf)
    whole, _, part = leaf.rpartition("_")
    parts = {"SendGoal": "_send_goal", "GetResult": "_get_result"}
    action, _, service = whole.rpartition("_")
    if action and service in parts:  # the parts of actions are in a class of their own
        return getattr(getattr(getattr(found, action).Impl, f"{service}Service"), part)
    if part == "FeedbackMessage":
        return getattr(found, whole).Impl.FeedbackMessage
    return getattr(getattr(found, whole), part)


def _message(kind: Any, record: dict[str, Any]) -> Any:
    message = kind()
    for name, value in record.items():
        if name != NOTHING:
            setattr(message, name, _ros_value(kind, name, value))
    return message


def _ros_value(kind: Any, name: str, value: Any) -> Any:
    written = kind.get_fields_and_field_types()[name]
    inner = written.removeprefix("sequence<").partition("[")[0].partition(",")[0].rstrip(">")
    if inner == "octet":
        return [bytes([item]) for item in value] if isinstance(value, list) else bytes([value])
    if "/" in inner:
        package, leaf = inner.split("/")
        made = [
            _message(_inner_class(kind, package, leaf), item)
            for item in (value if isinstance(value, list) else [value])
        ]
        return made if isinstance(value, list) else made[0]
    return value


def _inner_class(kind: Any, package: str, leaf: str) -> Any:
    for folder in (kind.__module__.split(".")[1], "msg"):
        try:
            found = _ros_class(f"{package}/{folder}/{leaf}")
        except AttributeError:
            continue
        if found is not None:
            return found
    raise LookupError(f"{package}/{leaf}")


def is_made(name: str) -> bool:
    """Say whether there are messages of a type: a service or an action is only its parts."""
    kind, leaf = name.split("/")[1:]
    parts = ("_Request", "_Response", "_Goal", "_Result", "_Feedback", "_FeedbackMessage")
    return kind == "msg" or leaf.endswith(parts)


def main() -> None:
    types = Types.standard()
    path = FOLDER / "cdr.json"
    known = json.loads(path.read_text()) if path.exists() else {"by_ros": {}, "by_reference": {}}
    held = known["by_ros"].keys() | known["by_reference"].keys()
    for name in sorted(filter(is_made, types)):
        if name in held and "--update" not in sys.argv:
            continue
        record = record_of(types, name)
        ours = reference(types, name, record)
        made = by_ros(name, record)
        sys.stdout.write(f"{name}: {'reference' if made is None else 'ROS'}\n")
        if made is None:
            known["by_reference"][name] = ours.hex()
        else:
            known["by_ros"][name] = (
                made[: len(ours)].hex() if not any(made[len(ours) :]) else made.hex()
            )
    FOLDER.mkdir(exist_ok=True)
    path.write_text(json.dumps(known, indent=0, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
