"""Messages that are not tied to one kind of device."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import field

from vertebra.messages.array import Array
from vertebra.messages.message import Message


class Text(Message, frozen=True, kw_only=True):
    """Words, for example to be spoken or just heard; `language` is a BCP 47 tag such as `en`."""

    text: str
    language: str = ""


class Bottle(Message, frozen=True, kw_only=True):
    """A YARP bottle that has no message type of its own.

    Plain values stand for themselves: int (int32, or int64 if it does not fit), float (float64),
    str, bool, bytes (blob) and lists of these. All else is a map with one entry that names the
    YARP type: `{"vocab": "set"}`, `{"int8": 1}`, `{"int16": 1}`, `{"int64": 1}`,
    `{"float32": 1.5}`, `{"dict": [["key", value], ...]}`.
    """

    values: list[Any]


class Tensor(Message, frozen=True, kw_only=True):
    """An array of any type and shape, with optional names for its axes."""

    array: Array
    axes: tuple[str, ...] = ()


class Native(Message, frozen=True, kw_only=True):
    """Any nesting of None, bool, int, float, str, bytes, list, dict and `Array`.

    A tuple comes back as a list; a date, a set or a data class has no frame and is refused.
    Values of a library (a NumPy array, a data frame) go in as they are and come out the same where
    the codec plugin of that library is installed, as `Foreign` elsewhere.
    """

    value: Any


class Foreign:
    """A library's value whose codec plugin is not installed here; it can be sent on unchanged.

    It is no msgspec Struct, because those are written as maps before a codec can see them.

    Attributes:
        tag: Names the plugin and type, for example `numpy.ndarray`.
        plain: The packed form, as the plugin made it.
    """

    __slots__ = ("plain", "tag")

    tag: str
    plain: Any

    def __init__(self, *, tag: str, plain: Any) -> None:
        self.tag = tag
        self.plain = plain

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Foreign):
            return NotImplemented
        return (self.tag, self.plain) == (other.tag, other.plain)

    def __hash__(self) -> int:
        return hash(self.tag)

    def __repr__(self) -> str:
        return f"Foreign(tag={self.tag!r}, plain={self.plain!r})"


class Status(Message, frozen=True, kw_only=True):
    """How a service, a route or a robot is doing.

    Attributes:
        level: `ok`, `warning` (works, but look at it) or `error` (does not do its work).
        text: One sentence: what is wrong and what mends it.
        values: Counters and measurements by name, units at the end of the names.
    """

    level: Literal["ok", "warning", "error"]
    text: str = ""
    values: dict[str, float | int | str] = field(default_factory=dict)
