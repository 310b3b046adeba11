"""Telling by the bytes of a payload which dialect its sender speaks.

The tags 128 (float32 of YARP 3), 20 and 18 (float64 and vocab64 of YARP 4) tell at once. Tag 10 is
eight bytes long in YARP 3 and four in YARP 4, so that a payload ends where it should in only one
of them. Most others, such as images and bottles of integers and strings, are the same in both.
"""

from __future__ import annotations

import struct
from typing import Final

from vertebra.yarp.protocol.bottle import DEFAULT_LIMITS, Buffer
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

_I32: Final = struct.Struct("<i")
_IMAGE: Final = struct.pack("<4i", LIST, 4, VOCAB32, int.from_bytes(b"mat\0", "little"))
_SOUND: Final = struct.Struct("<ii i4xi4xi4xi4xi")
_SOUND_FORM: Final = (INT32, INT32, INT32, INT32, LIST + INT16)
_SOUND_FIELDS: Final = {5: Dialect.V3, 6: Dialect.V4}
_CLOUD: Final = struct.Struct("<12x?i")
_UNIT_MASK: Final = 0xFF

_SIZES: Final[dict[Dialect, dict[int | None, int]]] = {
    dialect: {
        INT8: 1,
        INT16: 2,
        INT32: 4,
        INT64: 8,
        VOCAB32: 4,
        dialect.vocab64: 8,
        dialect.float32: 4,
        dialect.float64: 8,
    }
    for dialect in Dialect
}


def dialect_of(payload: Buffer) -> Dialect | None:
    """Return the dialect of a payload, None if it is the same in both, or in neither."""
    if len(payload) < 8 or bytes(payload[:16]) == _IMAGE:
        return None
    tag, count = struct.unpack_from("<ii", payload)
    if tag & ~_UNIT_MASK != LIST:
        return _dialect_of_cloud(payload)
    if tag == LIST and count in _SOUND_FIELDS and len(payload) >= _SOUND.size:
        _, _, *form = _SOUND.unpack_from(payload)
        if tuple(form) == _SOUND_FORM:
            return _SOUND_FIELDS[count]
    fitting = [dialect for dialect in Dialect if _fits(payload, dialect)]
    return fitting[0] if len(fitting) == 1 else None


def _dialect_of_cloud(payload: Buffer) -> Dialect | None:
    if len(payload) < _CLOUD.size:
        return None
    _, tag = _CLOUD.unpack_from(payload)
    return next((dialect for dialect in Dialect if tag == LIST + dialect.float64), None)


def _fits(payload: Buffer, dialect: Dialect) -> bool:
    """Say whether the payload, read as a bottle of this dialect, ends where it should."""
    walk = _Walk(payload, _SIZES[dialect])
    try:
        walk.value(walk.word(), 0)
    except (struct.error, _NoBottleError):
        return False
    return walk.offset == len(payload)


class _NoBottleError(Exception):
    """These bytes are none."""


class _Walk:
    """Steps over the values of a bottle without making them."""

    __slots__ = ("_payload", "_sizes", "offset")

    def __init__(self, payload: Buffer, sizes: dict[int | None, int]) -> None:
        self._payload = payload
        self._sizes = sizes
        self.offset = 0

    def word(self) -> int:
        value: int = _I32.unpack_from(self._payload, self.offset)[0]
        self.offset += 4
        return value

    def value(self, tag: int, depth: int) -> None:
        size = self._sizes.get(tag)
        if size is not None:
            self.offset += size
        elif tag in (STRING, BLOB):
            length = self._length()  # moves the offset itself
            self.offset += length
        elif tag & ~(_UNIT_MASK | DICT) == LIST and depth <= DEFAULT_LIMITS.max_depth:
            self._items((self.word() if tag & DICT else tag) & _UNIT_MASK, depth + 1)
        else:
            raise _NoBottleError

    def _items(self, shared_tag: int, depth: int) -> None:
        count = self._length()
        size = self._sizes.get(shared_tag)
        if size is not None:
            self.offset += count * size
        elif shared_tag in (0, STRING, BLOB):
            for _ in range(count):  # each takes four bytes at least: the payload's end ends it
                self.value(shared_tag or self.word(), depth)
        else:
            raise _NoBottleError

    def _length(self) -> int:
        length = self.word()
        if length < 0:
            raise _NoBottleError
        return length
