"""CDR, the bytes of ROS 2 messages, to plain records and back.

A record is a dict of a type's fields. Numbers, text and booleans stand for themselves, another
type is a record, many numbers are an `Array` that looks at the payload in place, many of anything
else are a list. Written are XCDR1, little endian, as every ROS node does; read is big endian, too.

A type is compiled once into one function for each direction. Large arrays are neither looped over
nor copied, but for the one copy that puts an encoded message together. All lengths are checked
before anything is made of them; damaged bytes are a `DecodeError` that names the field.
"""

from __future__ import annotations

import contextlib
import struct
import sys
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self

from typing_extensions import Buffer

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import PRIMITIVES, Field

HEADER: Final = b"\x00\x01\x00\x00"
"""XCDR1, little endian."""
HEADER_BYTES: Final = 4
PADDING_BYTES: Final = 3
"""DDS samples are whole multiples of 4 bytes."""

_UNIT_BYTES: Final = (2, 4)
"""So long is a unit of wide text: Fast CDR, behind Fast DDS and rmw_zenoh, writes 2 bytes,
rmw_cyclonedds 4. Both are read, though nothing but the length of a message tells them apart; the
former is written."""
_LARGE_BYTES: Final = 1024
_MISSING: Final = object()
_BASES: Final[dict[str, tuple[str, str]]] = {
    "bool": ("?", "|b1"), "byte": ("B", "|u1"), "int8": ("b", "|i1"), "uint8": ("B", "|u1"),
    "int16": ("h", "<i2"), "uint16": ("H", "<u2"), "int32": ("i", "<i4"), "uint32": ("I", "<u4"),
    "int64": ("q", "<i8"), "uint64": ("Q", "<u8"), "float32": ("f", "<f4"), "float64": ("d", "<f8"),
}  # fmt: skip
"""struct's letter and NumPy's type string of each primitive of fixed size."""


class _Fault(Exception):  # noqa: N818  - becomes a DecodeError or an EncodeError
    """What is wrong, and in which field: the innermost first."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.path: list[str] = []

    def inside(self, name: str) -> Self:
        """Note what the fault is part of."""
        self.path.append(name)
        return self

    def told(self, type_name: str) -> str:
        """Return it in words."""
        path = "".join(part if part[0] == "[" else f".{part}" for part in reversed(self.path))
        return f"{type_name}{path}: {self}"


class _Source:
    """Bytes that are read, from where."""

    __slots__ = ("order", "position", "unit_bytes", "view")

    def __init__(self, view: memoryview, order: str, unit_bytes: int) -> None:
        self.view = view
        self.order = order
        self.unit_bytes = unit_bytes
        self.position = 0

    def take(self, size: int, alignment: int) -> int:
        """Return where the next `size` bytes are, aligned, and go behind them."""
        start = (self.position + alignment - 1) & -alignment
        self.position = start + size
        if self.position > len(self.view):
            raise _Fault(
                f"{size} bytes are missing at byte {start} of {len(self.view)}: this CDR is cut"
            )
        return start

    def count(self, least_bytes: int) -> int:
        """Return a length, if that many items of `least_bytes` can follow."""
        start = self.take(4, 4)
        count = int.from_bytes(self.view[start : start + 4], _ORDERS[self.order])
        if count * least_bytes > len(self.view) - self.position:
            raise _Fault(
                f"a length of {count} at byte {start} is more than the "
                f"{len(self.view) - self.position} bytes behind it can hold"
            )
        return count

    def end(self) -> None:
        """Check that nothing but padding is left."""
        left = len(self.view) - self.position
        if left > PADDING_BYTES:
            raise _Fault(f"{left} bytes follow the message")


class _Sink:
    """Bytes that are written: small ones together, large ones where they are."""

    __slots__ = ("parts", "position", "small")

    def __init__(self) -> None:
        self.parts: list[Buffer] = []
        self.small = bytearray(HEADER)
        self.position = 0

    def align(self, alignment: int) -> None:
        gap = -self.position % alignment
        if gap:
            self.small += bytes(gap)
            self.position += gap

    def put(self, data: Buffer, size: int) -> None:
        if size < _LARGE_BYTES:
            self.small += data
        else:
            self.parts += (self.small, data)
            self.small = bytearray()
        self.position += size

    def whole(self) -> bytes:
        self.align(4)
        return b"".join((*self.parts, self.small))


_ORDERS: Final[dict[str, Any]] = {"<": "little", ">": "big"}
_Read = Callable[[_Source], Any]
_Write = Callable[[_Sink, Any], None]
_UNFIT: Final = (struct.error, TypeError, ValueError, OverflowError)


class Cdr:
    """Reads and writes the messages of some types."""

    def __init__(self, types: Types) -> None:
        self._types = types
        self._readers: dict[str, _Read] = {}
        self._writers: dict[str, _Write] = {}
        self._least: dict[str, int] = {}

    def decode(self, payload: Buffer, type_name: str) -> dict[str, Any]:
        """Return the record in a payload; its arrays look at the payload.

        Raises:
            DecodeError: The payload is damaged, or of another type.
            CodecNotFoundError: The type is not known.
        """
        read = self._reader(type_name)
        view = memoryview(payload).cast("B").toreadonly()
        if len(view) < HEADER_BYTES or view[0] or view[1] > 1:
            raise DecodeError(
                f"{type_name}: {bytes(view[:4]).hex(' ') or 'nothing'} is no header of XCDR1"
            )
        try:
            return _read_whole(read, view, _UNIT_BYTES[0])
        except _Fault as fault:
            if self._has_wide_text(type_name):
                with contextlib.suppress(_Fault):
                    return _read_whole(read, view, _UNIT_BYTES[1])
            raise DecodeError(fault.told(type_name)) from None

    def _has_wide_text(self, type_name: str) -> bool:
        return type_name == "wstring" or any(
            self._has_wide_text(field.type)
            for field in self._types.definition(type_name)
            if field.type == "wstring" or field.type not in PRIMITIVES
        )

    def encode(self, record: Mapping[str, Any], type_name: str) -> bytes:
        """Return the payload of a record; fields that it does not have are zero or empty.

        Raises:
            EncodeError: A field is unknown, or its value does not fit.
            CodecNotFoundError: The type is not known.
        """
        write = self._writer(type_name)
        sink = _Sink()
        try:
            write(sink, record)
        except _Fault as fault:
            raise EncodeError(fault.told(type_name)) from None
        return sink.whole()

    def _reader(self, type_name: str) -> _Read:
        read = self._readers.get(type_name)
        if read is None:
            fields = tuple(
                (field.name, self._read_field(field)) for field in self._types.definition(type_name)
            )
            read = self._readers[type_name] = _record_reader(fields)
        return read

    def _writer(self, type_name: str) -> _Write:
        write = self._writers.get(type_name)
        if write is None:
            fields = {
                field.name: (self._write_field(field), _default(field))
                for field in self._types.definition(type_name)
            }
            write = self._writers[type_name] = _record_writer(fields)
        return write

    def _least_bytes(self, type_name: str) -> int:
        """Return how many bytes a value of a type has at least, padding aside."""
        if type_name in _BASES:
            return struct.calcsize(_BASES[type_name][0])
        if type_name in ("string", "wstring"):
            return 4
        if type_name not in self._least:
            self._least[type_name] = sum(
                4 if field.plural in ("sequence", "bounded")
                else max(field.count, field.plural == "one") * self._least_bytes(field.type)
                for field in self._types.definition(type_name)
            )  # fmt: skip
        return self._least[type_name]

    def _read_field(self, field: Field) -> _Read:
        if field.plural == "one":
            return self._read_one(field)
        fixed = field.count if field.plural == "array" else None
        most = field.count if field.plural == "bounded" else None
        least_bytes = self._least_bytes(field.type)
        if field.type in _BASES:
            return _array_reader(field.type, fixed, most)
        read = self._read_one(field)

        def read_list(source: _Source) -> list[Any]:
            count = _count(source, fixed, most, least_bytes)
            items = []
            for index in range(count):
                try:
                    items.append(read(source))
                except _Fault as fault:
                    raise fault.inside(f"[{index}]") from None
            return items

        return read_list

    def _read_one(self, field: Field) -> _Read:
        if field.type in _BASES:
            return _scalar_reader(field.type)
        if field.type == "string":
            return _text_reader(field.max_text)
        if field.type == "wstring":
            return _wide_text_reader(field.max_text)
        return self._reader(field.type)

    def _write_field(self, field: Field) -> _Write:
        if field.plural == "one":
            return self._write_one(field)
        fixed = field.count if field.plural == "array" else None
        most = field.count if field.plural == "bounded" else None
        if field.type in _BASES:
            return _array_writer(field.type, fixed, most)
        write = self._write_one(field)

        def write_list(sink: _Sink, items: Sequence[Any]) -> None:
            if not isinstance(items, list | tuple):
                raise _Fault(f"is a list, not {type(items).__name__}")
            if fixed is None:
                _check_bound(len(items), most)
                sink.align(4)
                sink.put(len(items).to_bytes(4, "little"), 4)
            elif not items:
                items = [_default(Field("", field.type))] * fixed
            elif len(items) != fixed:
                raise _Fault(f"has {fixed} items, not {len(items)}")
            for index, item in enumerate(items):
                try:
                    write(sink, item)
                except _Fault as fault:
                    raise fault.inside(f"[{index}]") from None

        return write_list

    def _write_one(self, field: Field) -> _Write:
        if field.type in _BASES:
            return _scalar_writer(field.type)
        if field.type in ("string", "wstring"):
            return _text_writer(field.max_text, wide=field.type == "wstring")
        return self._writer(field.type)


def _read_whole(read: _Read, payload: memoryview, unit_bytes: int) -> dict[str, Any]:
    source = _Source(payload[HEADER_BYTES:], "<" if payload[1] else ">", unit_bytes)
    record: dict[str, Any] = read(source)
    source.end()
    return record


def _record_reader(fields: tuple[tuple[str, _Read], ...]) -> _Read:
    def read_record(source: _Source) -> dict[str, Any]:
        record = {}
        name = ""
        try:
            for name, read in fields:
                record[name] = read(source)
        except _Fault as fault:
            raise fault.inside(name) from None
        return record

    return read_record


def _record_writer(fields: Mapping[str, tuple[_Write, Any]]) -> _Write:
    def write_record(sink: _Sink, record: Mapping[str, Any]) -> None:
        if not isinstance(record, Mapping):
            raise _Fault(f"is a map of {', '.join(fields)}, not {type(record).__name__}")
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
        except _Fault as fault:
            raise fault.inside(name) from None
        except _UNFIT as error:
            raise _Fault(str(error)).inside(name) from error
        if known != len(record):
            unknown = next(name for name in record if name not in fields)
            raise _Fault(f"there is no field {unknown!r}; known: {', '.join(fields)}")

    return write_record


def _default(field: Field) -> Any:
    if field.plural != "one":
        return ()
    if field.type in _BASES:
        return 0.0 if field.type.startswith("float") else False if field.type == "bool" else 0
    return "" if field.type in ("string", "wstring") else {}


def _count(source: _Source, fixed: int | None, most: int | None, least_bytes: int) -> int:
    if fixed is not None:
        return fixed
    count = source.count(least_bytes)
    if most is not None and count > most:
        raise _Fault(f"{count} items where at most {most} may be")
    return count


def _check_bound(count: int, most: int | None) -> None:
    if most is not None and count > most:
        raise _Fault(f"has at most {most} items, not {count}")


def _scalar_reader(base: str) -> _Read:
    letter, _ = _BASES[base]
    size = struct.calcsize(letter)
    little, big = struct.Struct(f"<{letter}"), struct.Struct(f">{letter}")
    if base == "bool":
        return _read_bool

    def read_scalar(source: _Source) -> Any:
        start = source.take(size, size)
        return (little if source.order == "<" else big).unpack_from(source.view, start)[0]

    return read_scalar


def _read_bool(source: _Source) -> bool:
    start = source.take(1, 1)
    value = source.view[start]
    if value > 1:
        raise _Fault(f"{value} at byte {start} is no bool")
    return bool(value)


def _scalar_writer(base: str) -> _Write:
    letter, _ = _BASES[base]
    form = struct.Struct(f"<{letter}")
    size = form.size
    wanted: tuple[type, ...] = (int,) if letter in "bBhHiIqQ" else (int, float)
    if base == "bool":
        wanted = (bool,)

    def write_scalar(sink: _Sink, value: Any) -> None:
        if not isinstance(value, wanted) or (wanted != (bool,) and value.__class__ is bool):
            raise _Fault(f"is {base}, not {value!r}")
        sink.align(size)
        sink.put(form.pack(value), size)

    return write_scalar


def _text_reader(max_text: int) -> _Read:
    def read_text(source: _Source) -> str:
        count = source.count(1)
        if not count:  # some writers leave out the NUL of an empty text
            return ""
        start = source.take(count, 1)
        if source.view[start + count - 1]:
            raise _Fault(f"the text at byte {start} does not end with NUL")
        if max_text and count - 1 > max_text:
            raise _Fault(f"{count - 1} characters where at most {max_text} may be")
        try:
            return str(source.view[start : start + count - 1], "utf-8")
        except UnicodeDecodeError as error:
            raise _Fault(f"the text at byte {start} is not UTF-8: {error.reason}") from None

    return read_text


def _wide_text_reader(max_text: int) -> _Read:
    """Read a length in UTF-16 units and the units, without NUL; see `_UNIT_BYTES`."""

    def read_text(source: _Source) -> str:
        size = source.unit_bytes
        count = source.count(size)
        start = source.take(size * count, 1)
        if max_text and count > max_text:
            raise _Fault(f"{count} characters where at most {max_text} may be")
        letter = "I" if size == struct.calcsize("I") else "H"
        units = struct.unpack_from(f"{source.order}{count}{letter}", source.view, start)
        try:
            return struct.pack(f"<{count}H", *units).decode("utf-16-le")
        except (struct.error, UnicodeDecodeError):
            raise _Fault(f"the text at byte {start} is not UTF-16") from None

    return read_text


def _text_writer(max_text: int, *, wide: bool) -> _Write:
    def write_text(sink: _Sink, value: Any) -> None:
        if not isinstance(value, str):
            raise _Fault(f"is text, not {value!r}")
        data = value.encode("utf-16-le") if wide else value.encode() + b"\0"
        count = len(data) // 2 if wide else len(data)
        if max_text and (count if wide else count - 1) > max_text:
            raise _Fault(f"has at most {max_text} characters, not {count}")
        sink.align(4)
        sink.put(count.to_bytes(4, "little"), 4)
        sink.put(data, len(data))

    return write_text


def _array_reader(base: str, fixed: int | None, most: int | None) -> _Read:
    letter, dtype = _BASES[base]
    size = struct.calcsize(letter)

    def read_array(source: _Source) -> Array:
        count = _count(source, fixed, most, size)
        # No items, no padding before them.
        start = source.take(count * size, size) if count else source.position
        view = source.view[start : start + count * size]
        if source.order == ">" and size > 1:
            items = array(letter, bytes(view))
            items.byteswap()
            return Array(items, dtype, (count,))
        return Array(view, dtype, (count,))

    return read_array


def _array_writer(base: str, fixed: int | None, most: int | None) -> _Write:
    letter, dtype = _BASES[base]
    size = struct.calcsize(letter)

    def write_array(sink: _Sink, value: Any) -> None:
        data = _array_bytes(value, letter, dtype)
        count = data.nbytes // size
        if fixed is None:
            _check_bound(count, most)
            sink.align(4)
            sink.put(count.to_bytes(4, "little"), 4)
        elif not count:
            count, data = fixed, memoryview(bytes(fixed * size))
        elif count != fixed:
            raise _Fault(f"has {fixed} items, not {count}")
        if count:
            sink.align(size)
            sink.put(data, data.nbytes)

    return write_array


def _array_bytes(value: Any, letter: str, dtype: str) -> memoryview:
    """Return the little-endian bytes of an `Array`, a byte string or a list of numbers."""
    if isinstance(value, Array):
        if value.dtype != dtype:
            raise _Fault(f"is an array of {dtype!r}, not of {value.dtype!r}")
        return value.data
    if isinstance(value, bytes | bytearray | memoryview) and dtype == "|u1":
        return memoryview(value).cast("B")
    if not isinstance(value, list | tuple):
        raise _Fault(f"is a list of numbers, not {type(value).__name__}")
    if letter == "?":
        if not all(isinstance(item, bool) for item in value):
            raise _Fault("is a list of true and false")
        return memoryview(bytes(value))
    items = array(letter, value)
    if sys.byteorder == "big":
        items.byteswap()
    return memoryview(items).cast("B")
