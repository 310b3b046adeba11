"""How each kind of field is written: a function of where the bytes go, and a value."""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from typing import Any, Final

from typing_extensions import Buffer

from vertebra.messages import Array
from vertebra.ros2.cdr.parts import BASES, HEADER, Fault
from vertebra.ros2.interface_files import Field

_LARGE_BYTES: Final = 1024
_MISSING: Final = object()
_UNFIT: Final = (struct.error, TypeError, ValueError, OverflowError)


class Sink:
    """Bytes that are written: small ones together, large ones where they are."""

    __slots__ = ("parts", "position", "small")

    def __init__(self) -> None:
        self.parts: list[Buffer] = []
        self.small = bytearray(HEADER)
        self.position = 0

    def align(self, alignment: int) -> None:
        """Go on at the next multiple of `alignment`."""
        gap = -self.position % alignment
        if gap:
            self.small += bytes(gap)
            self.position += gap

    def put(self, data: Buffer, size: int) -> None:
        """Write `size` bytes; large ones are not copied."""
        if size < _LARGE_BYTES:
            self.small += data
        else:
            self.parts += (self.small, data)
            self.small = bytearray()
        self.position += size

    def whole(self) -> bytes:
        """Return everything, a multiple of 4 bytes."""
        self.align(4)
        return b"".join((*self.parts, self.small))


Write = Callable[[Sink, Any], None]


def record_writer(fields: Mapping[str, tuple[Write, Any]]) -> Write:
    """Write fields, each by its own writer, or its default."""

    def write_record(sink: Sink, record: Mapping[str, Any]) -> None:
        if not isinstance(record, Mapping):
            raise Fault(f"is a map of {', '.join(fields)}, not {type(record).__name__}")
        name = ""
        known = 0
        try:
            for name, (write, default) in fields.items():
                value = record.get(name, _MISSING)
                if value is _MISSING:
                    value = default
                else:
                    known += 1
                write(sink, value)
        except Fault as fault:
            raise fault.inside(name) from None
        except _UNFIT as error:
            raise Fault(str(error)).inside(name) from error
        if known != len(record):
            unknown = next(name for name in record if name not in fields)
            raise Fault(f"there is no field {unknown!r}; known: {', '.join(fields)}")

    return write_record


def default_of(field: Field) -> Any:
    """Return what a field has that is not given."""
    if field.plural != "one":
        return ()
    if field.type in BASES:
        return 0.0 if field.type.startswith("float") else False if field.type == "bool" else 0
    return "" if field.type in ("string", "wstring") else {}


def check_bound(count: int, most: int | None) -> None:
    """Raise `Fault` if there are more items than may be."""
    if most is not None and count > most:
        raise Fault(f"has at most {most} items, not {count}")


def scalar_writer(base: str) -> Write:
    """Write a primitive of fixed size."""
    letter, _ = BASES[base]
    form = struct.Struct(f"<{letter}")
    size = form.size
    wanted: tuple[type, ...] = (int,) if letter in "bBhHiIqQ" else (int, float)
    if base == "bool":
        wanted = (bool,)

    def write_scalar(sink: Sink, value: Any) -> None:
        if not isinstance(value, wanted) or (wanted != (bool,) and value.__class__ is bool):
            raise Fault(f"is {base}, not {value!r}")
        sink.align(size)
        sink.put(form.pack(value), size)

    return write_scalar


def text_writer(max_text: int, *, wide: bool) -> Write:
    """Write a length and UTF-8 with a NUL; wide text as units of UTF-16, 4 bytes each."""

    def write_text(sink: Sink, value: Any) -> None:
        if not isinstance(value, str):
            raise Fault(f"is text, not {value!r}")
        if wide:
            units = struct.iter_unpack("<H", value.encode("utf-16-le"))
            data = b"".join(unit.to_bytes(4, "little") for (unit,) in units)
            count = characters = len(data) // 4
        else:
            data = value.encode() + b"\0"
            count, characters = len(data), len(data) - 1
        if max_text and characters > max_text:
            raise Fault(f"has at most {max_text} characters, not {characters}")
        sink.align(4)
        sink.put(count.to_bytes(4, "little"), 4)
        sink.put(data, len(data))

    return write_text


def array_writer(base: str, fixed: int | None, most: int | None) -> Write:
    """Write primitives of fixed size, side by side."""
    letter, dtype = BASES[base]
    size = struct.calcsize(letter)

    def write_array(sink: Sink, value: Any) -> None:
        data = _array_bytes(value, letter, dtype)
        count = data.nbytes // size
        if fixed is None:
            check_bound(count, most)
            sink.align(4)
            sink.put(count.to_bytes(4, "little"), 4)
        elif not count:
            count, data = fixed, memoryview(bytes(fixed * size))
        elif count != fixed:
            raise Fault(f"has {fixed} items, not {count}")
        if count:
            sink.align(size)
            sink.put(data, data.nbytes)

    return write_array


def _array_bytes(value: Any, letter: str, dtype: str) -> memoryview:
    """Return the little-endian bytes of an `Array`, a byte string or a list of numbers."""
    if isinstance(value, Array):
        if value.dtype != dtype:
            raise Fault(f"is an array of {dtype!r}, not of {value.dtype!r}")
        return value.data
    if isinstance(value, bytes | bytearray | memoryview) and dtype == "|u1":
        return memoryview(value).cast("B")
    if not isinstance(value, list | tuple):
        raise Fault(f"is a list of numbers, not {type(value).__name__}")
    if letter == "?":
        if not all(isinstance(item, bool) for item in value):
            raise Fault("is a list of true and false")
        return memoryview(bytes(value))
    items = array(letter, value)
    if sys.byteorder == "big":
        items.byteswap()
    return memoryview(items).cast("B")
