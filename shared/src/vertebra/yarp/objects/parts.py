"""What all objects share: numbers in arrays, headers, and how damage is told."""

from __future__ import annotations

import struct
import sys
from array import array
from typing import Final, TypeVar

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.protocol.bottle import Buffer, Value
from vertebra.yarp.protocol.dialect import LIST, Dialect

_N = TypeVar("_N", int, float)

I32: Final = struct.Struct("<i")
TWO_I32: Final = struct.Struct("<ii")


class YarpObject:
    """What a YARP port can send: an object with a form in each dialect."""

    __slots__ = ()

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the object in binary; raise EncodeError if it has no such form."""
        return b"".join(self.encode_parts(dialect))

    def encode_parts(self, dialect: Dialect = Dialect.V3) -> list[Buffer]:
        """Return what `encode` returns in pieces, to be sent one after the other."""
        return [self.encode(dialect)]


def damage(what: str, reason: str) -> DecodeError:
    """Return the error to raise where bytes are not the object that they should be."""
    return DecodeError(f"not a YARP {what}: {reason}")


def filled(numbers: array[_N], raw: Buffer) -> array[_N]:
    """Append the numbers that `raw` holds in little-endian, and return all."""
    numbers.frombytes(raw)
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def as_bytes(numbers: array[_N]) -> bytes:
    """Return the numbers in little-endian."""
    if sys.byteorder == "big":
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()


def of_type(code: str, numbers: array[_N]) -> array[_N]:
    """Return the numbers in the type that the wire has; an array of another one is converted."""
    if numbers.typecode == code:
        return numbers
    try:
        return array(code, numbers)
    except (TypeError, OverflowError) as error:
        raise EncodeError(
            f"an array of {numbers.typecode!r} is none of {code!r}: {error}"
        ) from None


def vector(tag: int, code: str, numbers: array[_N]) -> bytes:
    """Return a list of numbers as YARP's vectors write it: with their tag even if it is empty."""
    return TWO_I32.pack(LIST + tag, len(numbers)) + as_bytes(of_type(code, numbers))


def floats(values: array[float], dialect: Dialect) -> bytes:
    """Return numbers as a list of float64."""
    return vector(dialect.float64, "d", values)


def pack(what: str, layout: struct.Struct, *values: object) -> bytes:
    """Return a header, or raise EncodeError where a value does not fit it."""
    try:
        return layout.pack(*values)
    except struct.error as error:
        raise EncodeError(f"the header of this YARP {what} cannot be written: {error}") from None


def read_floats(what: str, payload: Buffer, dialect: Dialect) -> array[float]:
    """Return the numbers of a payload that is one list of float64 and nothing else."""
    if len(payload) < 8:
        raise damage(what, f"{len(payload)} bytes are too few")
    tag, count = TWO_I32.unpack_from(payload)
    if tag != LIST + dialect.float64:
        raise damage(
            what, f"it begins with {tag:#x}, not {LIST + dialect.float64:#x} as in {dialect}"
        )
    if count < 0 or len(payload) != 8 + 8 * count:
        raise damage(what, f"{count} float64 were announced, {len(payload) - 8} bytes follow")
    return filled(array("d"), memoryview(payload)[8:])


def number_list(what: str, name: str, numbers: Value) -> array[float]:
    """Return the numbers of a list in a bottle, or raise DecodeError."""
    if isinstance(numbers, list):
        try:
            return array("d", numbers)
        except TypeError:  # something in it is no number
            pass
    raise damage(what, f"{name} is no list of numbers")
