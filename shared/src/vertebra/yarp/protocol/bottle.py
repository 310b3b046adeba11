"""Bottles in binary: YARP's nested, dynamically typed lists.

    bottle   := i32 (256 + S) . i32 count . element*
    element  := [i32 tag, only where S is 0] . value

S is the tag that all elements share, if it is a scalar one. A nested list keeps its header in its
tag; a dict repeats it. All numbers are little-endian. A bottle says where it ends, which is the
only thing that delimits the reply of a YARP rpc.

| wire    | Python            | wire      | Python                              |
|---------|-------------------|-----------|-------------------------------------|
| int32   | int               | float32   | Float32                             |
| int64   | Int64             | float64   | float                               |
| int16   | Int16             | vocab32   | Vocab; code 0 is False, '1' is True |
| int8    | Int8              | vocab64   | Vocab64 (YARP 4)                    |
| string  | str               | list      | list                                |
| blob    | bytes             | dict      | Dict                                |

Strings are UTF-8; other bytes survive a round trip as surrogate escapes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeAlias

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.protocol.dialect import (
    BLOB,
    DICT,
    INT8,
    INT16,
    INT32,
    INT64,
    LIST,
    STRING,
    VOCAB32,
    Dialect,
)

Buffer: TypeAlias = bytes | bytearray | memoryview
Value: TypeAlias = int | float | str | bytes | Sequence["Value"]

_UNIT_MASK: Final = 0xFF

_I32: Final = struct.Struct("<i")


class Int8(int):
    """An integer that YARP sends in one byte."""

    __slots__ = ()


class Int16(int):
    """An integer that YARP sends in two bytes."""

    __slots__ = ()


class Int64(int):
    """An integer that YARP sends in eight bytes, however small it is."""

    __slots__ = ()


class Float32(float):
    """A number that YARP sends in single precision."""

    __slots__ = ()


class Vocab(str):
    """A short word that YARP sends as one integer: four bytes, in YARP 4 up to eight."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({super().__repr__()})"

    @property
    def code(self) -> int:
        """The word as the integer that YARP makes of it, first letter in the lowest byte."""
        raw = _text_bytes(self)
        return int.from_bytes(raw.ljust(4 if len(raw) <= 4 else 8, b"\0"), "little", signed=True)

    @classmethod
    def from_code(cls, code: int) -> Vocab:
        """Return the word that `code` stands for, as the int32 fields of YARP's structs hold it."""
        raw = code.to_bytes(4 if _is_int32(code) else 8, "little", signed=True)
        return cls(_text(raw.rstrip(b"\0")))


class Vocab64(Vocab):
    """A word that YARP 4 sends in eight bytes, however short it is."""

    __slots__ = ()


class Dict(list[Value]):
    """A YARP dict (a Property inside a bottle): lists of a key and its values, in order."""

    __slots__ = ()


class Incomplete(DecodeError):  # noqa: N818 -- a state of a stream rather than a fault
    """The bytes are sound so far, but the bottle goes on.

    Attributes:
        missing_bytes: How many more are needed at the least.
    """

    def __init__(self, offset: int, missing_bytes: int) -> None:
        super().__init__(
            f"bottle is cut short: the item at byte {offset} needs {missing_bytes} bytes more"
        )
        self.missing_bytes = missing_bytes


@dataclass(frozen=True, slots=True)
class Limits:
    """What a decoder accepts before it allocates anything.

    Attributes:
        max_bytes: Of a whole bottle.
        max_elements: Of a whole bottle, at all depths together.
        max_depth: Of lists within lists.
    """

    max_bytes: int = 64 * 1024 * 1024
    max_elements: int = 1_000_000
    max_depth: int = 64


DEFAULT_LIMITS: Final = Limits()


def encode(values: Sequence[Value], dialect: Dialect = Dialect.V3) -> bytes:
    """Return the bottle of `values` in binary.

    Raises:
        EncodeError: A value has no form in this dialect or does not fit its type.
    """
    return _with_header(values, dialect, 0)


def decode(
    payload: Buffer, dialect: Dialect = Dialect.V3, *, limits: Limits = DEFAULT_LIMITS
) -> list[Value]:
    """Return the values of a payload that is one bottle and nothing else.

    Raises:
        DecodeError: The payload is damaged, cut short, too long or beyond the limits.
    """
    values, end = decode_prefix(payload, 0, dialect, limits=limits)
    if end != len(payload):
        raise DecodeError(
            f"bottle ends at byte {end}, but {len(payload) - end} bytes follow: "
            f"it is no bottle, or its sender does not speak {dialect}"
        )
    return values


def decode_prefix(
    payload: Buffer, offset: int, dialect: Dialect = Dialect.V3, *, limits: Limits = DEFAULT_LIMITS
) -> tuple[list[Value], int]:
    """Return the values of the bottle that begins at `offset`, and where it ends.

    Raises:
        Incomplete: The bottle goes on after the end of `payload`.
        DecodeError: This is no bottle, or one beyond the limits.
    """
    reader = _Reader(payload, offset, dialect, limits)
    return reader.bottle(0), reader.offset


# --- writing ---------------------------------------------------------------------------------


def _is_int32(value: int) -> bool:
    return -(2**31) <= value < 2**31


def _text(raw: Buffer) -> str:
    return str(raw, "utf-8", "surrogateescape")


def _text_bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _with_header(values: Sequence[Value], dialect: Dialect, depth: int) -> bytes:
    shared_tag, body = _body(values, dialect, depth)
    return _I32.pack(LIST + shared_tag) + body


def _body(values: Sequence[Value], dialect: Dialect, depth: int) -> tuple[int, bytes]:
    """Return the tag that all values share, or 0, and `count . elements`."""
    if depth > DEFAULT_LIMITS.max_depth:
        raise EncodeError(f"lists nest deeper than {DEFAULT_LIMITS.max_depth} levels")
    count = len(values)
    kinds = set(map(type, values))
    if kinds == {float}:
        return dialect.float64, struct.pack(f"<i{count}d", count, *values)
    if kinds == {int}:
        with suppress(struct.error):  # not all of them are int32
            return INT32, struct.pack(f"<i{count}i", count, *values)
    elements = [_element(value, dialect, depth) for value in values]
    tags = {tag for tag, _ in elements}
    shared_tag = tags.pop() if len(tags) == 1 else 0
    if 0 < shared_tag < LIST:
        return shared_tag, _I32.pack(count) + b"".join([body for _, body in elements])
    pack = _I32.pack
    return 0, pack(count) + b"".join([pack(tag) + body for tag, body in elements])


_Writer: TypeAlias = Callable[..., tuple[int, bytes]]


def _element(value: Value, dialect: Dialect, depth: int) -> tuple[int, bytes]:
    write = _WRITERS.get(type(value)) or _writer_for(value)
    try:
        return write(value, dialect, depth)
    except (struct.error, OverflowError, UnicodeEncodeError) as error:
        shown = f"{value!r:.80}"
        raise EncodeError(f"{shown} does not fit a YARP {type(value).__name__}: {error}") from None


def _writer_for(value: object) -> _Writer:
    for base in type(value).__mro__:
        if base in _WRITERS:
            return _WRITERS[base]
    raise EncodeError(
        f"a bottle cannot hold a {type(value).__name__}: "
        "use int, float, str, bytes, bool, list or a type of vertebra.yarp.protocol.bottle"
    )


def _write_int(value: int, _dialect: Dialect, _depth: int) -> tuple[int, bytes]:
    if _is_int32(value):
        return INT32, _I32.pack(value)
    return INT64, struct.pack("<q", value)


def _write_bool(value: bool, _dialect: Dialect, _depth: int) -> tuple[int, bytes]:  # noqa: FBT001
    return VOCAB32, b"1\0\0\0" if value else bytes(4)


def _write_vocab(value: Vocab, dialect: Dialect, depth: int) -> tuple[int, bytes]:
    raw = _text_bytes(value)
    if len(raw) > 4:
        return _write_vocab64(value, dialect, depth)
    return VOCAB32, raw.ljust(4, b"\0")


def _write_vocab64(value: Vocab, dialect: Dialect, _depth: int) -> tuple[int, bytes]:
    raw = _text_bytes(value)
    if dialect.vocab64 is None:
        raise EncodeError(f"{value!r} is a vocab of 8 bytes; YARP 3 has only 4: send a str")
    if len(raw) > 8:
        raise EncodeError(f"{value!r} has {len(raw)} bytes; a vocab has at most 8: send a str")
    return dialect.vocab64, raw.ljust(8, b"\0")


def _write_blob(value: bytes, _dialect: Dialect, _depth: int) -> tuple[int, bytes]:
    return BLOB, _I32.pack(len(value)) + value


def _write_str(value: str, _dialect: Dialect, _depth: int) -> tuple[int, bytes]:
    raw = _text_bytes(value)
    return STRING, _I32.pack(len(raw)) + raw


def _write_list(value: Sequence[Value], dialect: Dialect, depth: int) -> tuple[int, bytes]:
    shared_tag, body = _body(value, dialect, depth + 1)
    return LIST + shared_tag, body


_WRITERS: Final[dict[type, _Writer]] = {
    int: _write_int,
    float: lambda value, dialect, _depth: (dialect.float64, struct.pack("<d", value)),
    str: _write_str,
    bytes: _write_blob,
    bool: _write_bool,
    list: _write_list,
    tuple: _write_list,
    Vocab: _write_vocab,
    Vocab64: _write_vocab64,
    Dict: lambda value, dialect, depth: (LIST | DICT, _with_header(value, dialect, depth + 1)),
    Int8: lambda value, _dialect, _depth: (INT8, struct.pack("<b", value)),
    Int16: lambda value, _dialect, _depth: (INT16, struct.pack("<h", value)),
    Int64: lambda value, _dialect, _depth: (INT64, struct.pack("<q", value)),
    Float32: lambda value, dialect, _depth: (dialect.float32, struct.pack("<f", value)),
}


# --- reading ---------------------------------------------------------------------------------


@lru_cache(maxsize=1024)
def _vocab32(raw: bytes) -> bool | Vocab:
    """Return the word, or the boolean that YARP spells as one."""
    if raw == b"\0\0\0\0":
        return False
    if raw == b"1\0\0\0":
        return True
    return Vocab(_text(raw.rstrip(b"\0")))


def _vocab64(raw: bytes) -> Vocab64:
    return Vocab64(_text(raw.rstrip(b"\0")))


@dataclass(frozen=True, slots=True)
class _Scalar:
    """A type of fixed size: its struct code and what carries its value (None: as struct has it)."""

    code: str
    carrier: Callable[..., Value] | None
    one: struct.Struct


def _scalars(dialect: Dialect) -> dict[int, _Scalar]:
    """Return the types of fixed size by tag."""
    types: dict[int | None, tuple[str, Callable[..., Value] | None]] = {
        INT8: ("b", Int8),
        INT16: ("h", Int16),
        INT32: ("i", None),
        INT64: ("q", Int64),
        VOCAB32: ("4s", _vocab32),
        dialect.vocab64: ("8s", _vocab64),
        dialect.float32: ("f", Float32),
        dialect.float64: ("d", None),
    }
    return {
        tag: _Scalar(code, carrier, struct.Struct(f"<{code}"))
        for tag, (code, carrier) in types.items()
        if tag is not None
    }


_SCALARS: Final = {dialect: _scalars(dialect) for dialect in Dialect}


class _Reader:
    """Reads one bottle; `offset` is where it stands."""

    __slots__ = ("_data", "_dialect", "_elements", "_limits", "_scalars", "_start", "offset")

    def __init__(self, data: Buffer, offset: int, dialect: Dialect, limits: Limits) -> None:
        self._data = data
        self._start = self.offset = offset
        self._dialect = dialect
        self._limits = limits
        self._elements = 0
        self._scalars = _SCALARS[dialect]

    def bottle(self, depth: int) -> list[Value]:
        """Read a bottle with its own header."""
        code = self._word()
        if code & ~_UNIT_MASK != LIST:
            raise DecodeError(
                f"no bottle begins at byte {self.offset - 4}: its first word is {code:#x}, "
                "not 0x100 to 0x1ff"
            )
        return self._items(code & _UNIT_MASK, depth)

    def _need(self, size: int) -> None:
        """Refuse what is too large; raise Incomplete if fewer than `size` bytes are left."""
        end = self.offset + size
        if end - self._start > self._limits.max_bytes:
            raise DecodeError(
                f"the item at byte {self.offset} announces {size} bytes: the limit of a whole "
                f"bottle is {self._limits.max_bytes}"
            )
        if end > len(self._data):
            raise Incomplete(self.offset, end - len(self._data))

    def _word(self) -> int:
        self._need(4)
        word: int = _I32.unpack_from(self._data, self.offset)[0]
        self.offset += 4
        return word

    def _length(self, what: str) -> int:
        length = self._word()
        if length < 0:
            raise DecodeError(f"the {what} before byte {self.offset} is negative: {length}")
        return length

    def _items(self, shared_tag: int, depth: int) -> list[Value]:
        """Read `count . elements` of a list whose elements all wear `shared_tag`, if not 0."""
        if depth > self._limits.max_depth:
            raise DecodeError(f"lists nest deeper than {self._limits.max_depth} levels")
        count = self._length("element count")
        self._elements += count
        if self._elements > self._limits.max_elements:
            raise DecodeError(
                f"the list at byte {self.offset} announces {count} elements: the limit of a whole "
                f"bottle is {self._limits.max_elements}"
            )
        if shared_tag == 0:
            self._need(5 * count)
            return [self._value(self._word(), depth) for _ in range(count)]
        scalar = self._scalars.get(shared_tag)
        if scalar is not None:
            return self._array(scalar, count)
        self._need(4 * count)
        return [self._value(shared_tag, depth) for _ in range(count)]

    def _array(self, scalar: _Scalar, count: int) -> list[Value]:
        size = scalar.one.size * count
        self._need(size)
        if scalar.code.endswith("s"):
            cells = scalar.one.iter_unpack(self._data[self.offset : self.offset + size])
            values = [cell[0] for cell in cells]
        else:
            values = list(struct.unpack_from(f"<{count}{scalar.code}", self._data, self.offset))
        self.offset += size
        return values if scalar.carrier is None else list(map(scalar.carrier, values))

    def _value(self, tag: int, depth: int) -> Value:
        scalar = self._scalars.get(tag)
        if scalar is not None:
            return self._single(scalar)
        if tag == STRING:
            return _text(self._block())
        if tag == BLOB:
            return bytes(self._block())
        if tag & ~(_UNIT_MASK | DICT) == LIST:
            if tag & DICT:
                return Dict(self.bottle(depth + 1))
            return self._items(tag & _UNIT_MASK, depth + 1)
        raise DecodeError(
            f"unknown type tag {tag} before byte {self.offset}: the bottle is damaged, or its "
            f"sender does not speak {self._dialect}"
        )

    def _single(self, scalar: _Scalar) -> Value:
        self._need(scalar.one.size)
        value: Value = scalar.one.unpack_from(self._data, self.offset)[0]
        self.offset += scalar.one.size
        return value if scalar.carrier is None else scalar.carrier(value)

    def _block(self) -> Buffer:
        size = self._length("length")
        self._need(size)
        begin = self.offset
        self.offset += size
        return self._data[begin : self.offset]
