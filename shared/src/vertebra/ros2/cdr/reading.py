"""How each kind of field is read: a function of where the bytes are."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from typing import Any, Final

from vertebra.messages import Array
from vertebra.ros2.cdr.parts import BASES, HEADER_BYTES, PADDING_BYTES, Fault

_ORDERS: Final[dict[str, Any]] = {"<": "little", ">": "big"}


class Source:
    """Bytes that are read, from where."""

    __slots__ = ("order", "position", "view")

    def __init__(self, view: memoryview, order: str) -> None:
        self.view = view
        self.order = order
        self.position = 0

    def take(self, size: int, alignment: int) -> int:
        """Return where the next `size` bytes are, aligned, and go behind them."""
        start = (self.position + alignment - 1) & -alignment
        self.position = start + size
        if self.position > len(self.view):
            raise Fault(
                f"{size} bytes are missing at byte {start} of {len(self.view)}: this CDR is cut"
            )
        return start

    def count(self, least_bytes: int) -> int:
        """Return a length, if that many items of `least_bytes` can follow."""
        start = self.take(4, 4)
        count = int.from_bytes(self.view[start : start + 4], _ORDERS[self.order])
        if count * least_bytes > len(self.view) - self.position:
            raise Fault(
                f"a length of {count} at byte {start} is more than the "
                f"{len(self.view) - self.position} bytes behind it can hold"
            )
        return count

    def end(self) -> None:
        """Check that nothing but padding is left."""
        left = len(self.view) - self.position
        if left > PADDING_BYTES:
            raise Fault(f"{left} bytes follow the message")


Read = Callable[[Source], Any]


def source_of(payload: memoryview) -> Source:
    """Return what is behind the header of a payload."""
    return Source(payload[HEADER_BYTES:], "<" if payload[1] else ">")


def read_whole(read: Read, payload: memoryview) -> dict[str, Any]:
    """Return the record in a payload; raise `Fault`."""
    source = source_of(payload)
    record: dict[str, Any] = read(source)
    source.end()
    return record


def record_reader(fields: tuple[tuple[str, Read], ...]) -> Read:
    """Read fields, each by its own reader."""

    def read_record(source: Source) -> dict[str, Any]:
        record = {}
        name = ""
        try:
            for name, read in fields:
                record[name] = read(source)
        except Fault as fault:
            raise fault.inside(name) from None
        return record

    return read_record


def count_of(source: Source, fixed: int | None, most: int | None, least_bytes: int) -> int:
    """Return how many items there are: `fixed`, or what the bytes say, `most` at most."""
    if fixed is not None:
        return fixed
    count = source.count(least_bytes)
    if most is not None and count > most:
        raise Fault(f"{count} items where at most {most} may be")
    return count


def scalar_reader(base: str) -> Read:
    """Read a primitive of fixed size."""
    letter, _ = BASES[base]
    size = struct.calcsize(letter)
    little, big = struct.Struct(f"<{letter}"), struct.Struct(f">{letter}")
    if base == "bool":
        return _read_bool

    def read_scalar(source: Source) -> Any:
        start = source.take(size, size)
        return (little if source.order == "<" else big).unpack_from(source.view, start)[0]

    return read_scalar


def _read_bool(source: Source) -> bool:
    start = source.take(1, 1)
    value = source.view[start]
    if value > 1:
        raise Fault(f"{value} at byte {start} is no bool")
    return bool(value)


def text_reader(max_text: int) -> Read:
    """Read a length and UTF-8 with a NUL."""

    def read_text(source: Source) -> str:
        count = source.count(1)
        if not count:  # some writers leave out the NUL of an empty text
            return ""
        start = source.take(count, 1)
        if source.view[start + count - 1]:
            raise Fault(f"the text at byte {start} does not end with NUL")
        if max_text and count - 1 > max_text:
            raise Fault(f"{count - 1} characters where at most {max_text} may be")
        try:
            return str(source.view[start : start + count - 1], "utf-8")
        except UnicodeDecodeError as error:
            raise Fault(f"the text at byte {start} is not UTF-8: {error.reason}") from None

    return read_text


def wide_text_reader(max_text: int) -> Read:
    """Read a length in UTF-16 units and the units, 4 bytes each and without NUL, as all rmw do."""

    def read_text(source: Source) -> str:
        count = source.count(4)
        start = source.take(4 * count, 4) if count else source.position
        if max_text and count > max_text:
            raise Fault(f"{count} characters where at most {max_text} may be")
        units = struct.unpack_from(f"{source.order}{count}I", source.view, start)
        try:
            return struct.pack(f"<{count}H", *units).decode("utf-16-le")
        except (struct.error, UnicodeDecodeError):
            raise Fault(f"the text at byte {start} is not UTF-16") from None

    return read_text


def array_reader(base: str, fixed: int | None, most: int | None) -> Read:
    """Read primitives of fixed size, where they are."""
    letter, dtype = BASES[base]
    size = struct.calcsize(letter)

    def read_array(source: Source) -> Array:
        count = count_of(source, fixed, most, size)
        # No items, no padding before them.
        start = source.take(count * size, size) if count else source.position
        view = source.view[start : start + count * size]
        if source.order == ">" and size > 1:
            items = array(letter, bytes(view))
            items.byteswap()
            return Array(items, dtype, (count,))
        return Array(view, dtype, (count,))

    return read_array
