"""What is in a `.msg`, `.srv`, `.action` or `.idl`: the fields of types.

A `.msg` is read here line by line; for `.idl`, rosbags knows the grammar.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final, Literal

from msgspec import Struct
from rosbags.typesys import TypesysError, get_types_from_idl

from vertebra.errors import ConfigError

PRIMITIVES: Final = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17, "wstring": 18,
}  # fmt: skip
"""Every primitive type and its number in a type description."""

_FIELD: Final = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(<=(?P<text>\d+))?(?P<many>\[(?P<most><=)?(?P<count>\d*)\])?"
    r"\s+(?P<name>[A-Za-z][A-Za-z0-9_]*)(\s+(?P<default>[^=\s].*))?"
)
_CONSTANT: Final = re.compile(r"[A-Za-z0-9]+(<=\d+)?\s+[A-Za-z][A-Za-z0-9_]*\s*=.*")
_QUOTED: Final = re.compile(r"\"(?:[^\"\\]|\\.)*\"|'(?:[^'\\]|\\.)*'")
_SECTION: Final = re.compile(r"^---.*$", re.MULTILINE)
_ALIASES: Final = {"char": "uint8", "float": "float32", "double": "float64", "octet": "byte"}
_COMMENT: Final = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_DIRECTIVE: Final = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_NOT_OF_ROS: Final = re.compile(
    r"\b((enum|bitmask|bitset|union)\s+\w+\s*(\{|switch)|(map|fixed)\s*<|wchar\s+\w"
    r"|sequence\s*<\s*sequence\b)"
)
"""What IDL has and messages of ROS 2 do not."""


class Field(Struct, frozen=True):
    """One member of a type.

    Attributes:
        name: What it is called.
        type: A primitive (see `PRIMITIVES`) or the full name of another type.
        plural: How many there are: one, exactly `count`, at most `count`, or any number.
        count: Of an array or a bounded sequence.
        max_text: Most characters of a bounded string; 0 for any number.
    """

    name: str
    type: str
    plural: Literal["one", "array", "bounded", "sequence"] = "one"
    count: int = 0
    max_text: int = 0

    def __str__(self) -> str:
        bound = f"<={self.max_text}" if self.max_text else ""
        many = {
            "one": "",
            "array": f"[{self.count}]",
            "bounded": f"[<={self.count}]",
            "sequence": "[]",
        }[self.plural]
        return f"{self.type}{bound}{many} {self.name}"


Definition = tuple[Field, ...]


def read_text(package: str, text: str, where: str, parts: int) -> list[Definition]:
    """Return the parts of a `.msg`, `.srv` or `.action` of a package.

    Raises:
        ConfigError: A line is wrong, or there are more or fewer parts.
    """
    texts = _SECTION.split(text)
    if len(texts) != parts:
        kind = ("msg", "srv", "action")[parts - 1]
        raise ConfigError(f"{where}: a .{kind} has {parts} parts, not {len(texts)}")
    line = 1
    definitions = []
    for part in texts:
        definitions.append(_parse(package, part, where, line))
        line += part.count("\n") + (not part.endswith("\n"))
    return definitions


def read_idl(text: str, where: str) -> dict[str, Definition]:
    """Return the structs in an `.idl`.

    Raises:
        ConfigError: It cannot be read, or has what no message of ROS 2 has.
    """
    bare = _COMMENT.sub(_lines_of, _QUOTED.sub('""', text))
    found = _NOT_OF_ROS.search(bare)
    if found:
        line = bare.count("\n", 0, found.start()) + 1
        raise ConfigError(f"{where}:{line}: messages of ROS 2 have no {found[0].split()[0]!r} here")
    try:
        # Types are found by name, wherever they are defined: what is included is of no interest.
        types = get_types_from_idl(_DIRECTIVE.sub("", text))
    except TypesysError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{where}: this IDL cannot be read: {reason[:200]}") from error
    return {name: definition_of(members, where) for name, (_, members) in types.items()}


def _lines_of(match: re.Match[str]) -> str:
    return "\n" * match[0].count("\n")


def definition_of(members: Any, where: str) -> Definition:
    """Return the fields in rosbags' form: (name, (kind, description)) with kinds as numbers."""
    fields = tuple(_of_rosbags(name, description) for name, description in members)
    for field in fields:
        if "/" not in field.type and field.type not in PRIMITIVES:
            raise ConfigError(f"{where}: {field} is of no type of ROS 2")
    return fields


def _parse(package: str, text: str, where: str, first_line: int) -> Definition:
    fields: list[Field] = []
    for number, line in enumerate(text.splitlines(), first_line):
        bare = _QUOTED.sub("''", line).partition("#")[0].strip()
        if not bare or _CONSTANT.fullmatch(bare):
            continue
        match = _FIELD.fullmatch(bare)
        if match is None:
            raise ConfigError(f"{where}:{number}: {line.strip()!r} is no field of a ROS type")
        if match["name"] in {field.name for field in fields}:
            raise ConfigError(f"{where}:{number}: there are two fields {match['name']!r}")
        fields.append(_field(package, match.groupdict()))
    return tuple(fields)


def _field(package: str, parts: Mapping[str, str | None]) -> Field:
    written = str(parts["type"])
    written = _ALIASES.get(written, written)
    if written in PRIMITIVES:
        full = written
    elif written == "Header":
        full = "std_msgs/msg/Header"
    else:
        *folder, leaf = written.split("/")
        full = f"{folder[0] if folder else package}/msg/{leaf}"
    count = int(parts["count"] or 0)
    plural: Literal["one", "array", "bounded", "sequence"] = "one"
    if parts["many"]:
        plural = "bounded" if parts["most"] else "array" if parts["count"] else "sequence"
    return Field(str(parts["name"]), full, plural, count, int(parts["text"] or 0))


def _of_rosbags(name: str, description: Any) -> Field:
    kind, inner = description
    plural: Literal["one", "array", "bounded", "sequence"] = "one"
    count = 0
    if kind in (3, 4):
        (kind, inner), count = inner
        plural = "array" if description[0] == 3 else "bounded" if count else "sequence"
    if kind == 2:
        return Field(name, inner, plural, count)
    primitive, max_text = inner
    return Field(name, _ALIASES.get(primitive, primitive), plural, count, max_text)
