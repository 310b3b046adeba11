"""Rows of numbers: vectors, quaternions, matrices."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.objects.parts import (
    TWO_I32,
    YarpObject,
    damage,
    filled,
    floats,
    pack,
    read_floats,
    vector,
)
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import INT8, INT16, INT32, INT64, LIST, Dialect


@dataclass(frozen=True, slots=True)
class Vector(YarpObject):
    """A row of float64. The C++ reader refuses an empty one."""

    values: array[float]

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return the vector of any numbers."""
        return cls(array("d", values))

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the vector in binary."""
        return floats(self.values, dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the vector in `payload`.

        Raises:
            DecodeError: It holds none, or one of the other dialect.
        """
        return cls(read_floats("vector", payload, dialect))


@dataclass(frozen=True, slots=True)
class VectorOf(YarpObject):
    """A row of numbers of one type, that of its array: one of `bhiqfd`.

    C++ knows int32 and float64 in YARP 3, and int8, int16, float32 as well in YARP 4; bottles
    have them all in both.
    """

    values: array[float]

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the vector in binary.

        Raises:
            EncodeError: YARP has no vectors of this type.
        """
        code = self.values.typecode
        for tag, known in _codes(dialect).items():
            if known == code:
                return vector(tag, code, self.values)
        raise EncodeError(f"YARP has no vector of {code!r}, only of {', '.join('bhiqfd')}")

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the vector in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if not is_vector(payload, dialect):
            raise damage("vector", f"it begins with {bytes(payload[:4]).hex()}, in {dialect}")
        tag, count = TWO_I32.unpack_from(payload)
        values: array[float] = array(_codes(dialect)[tag - LIST])
        if count < 0 or len(payload) != 8 + values.itemsize * count:
            raise damage(
                "vector", f"{count} numbers were announced, {len(payload) - 8} bytes follow"
            )
        return cls(filled(values, memoryview(payload)[8:]))


def _codes(dialect: Dialect) -> dict[int, str]:
    """Return the types of numbers by tag."""
    return {
        INT8: "b",
        INT16: "h",
        INT32: "i",
        INT64: "q",
        dialect.float32: "f",
        dialect.float64: "d",
    }


def is_vector(payload: Buffer, dialect: Dialect = Dialect.V3) -> bool:
    """Say whether a payload begins like a vector of any type."""
    if len(payload) < TWO_I32.size:
        return False
    return TWO_I32.unpack_from(payload)[0] - LIST in _codes(dialect)


@dataclass(frozen=True, slots=True)
class Quaternion(YarpObject):
    """A rotation; YARP sends it as a vector of four."""

    w: float
    x: float
    y: float
    z: float

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the quaternion in binary."""
        return floats(array("d", (self.w, self.x, self.y, self.z)), dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the quaternion in `payload`.

        Raises:
            DecodeError: It is no vector of four.
        """
        values = read_floats("quaternion", payload, dialect)
        if len(values) != 4:
            raise damage("quaternion", f"{len(values)} numbers instead of 4")
        return cls(*values)


_MATRIX: Final = struct.Struct("<6i")


@dataclass(frozen=True, slots=True)
class Matrix(YarpObject):
    """A matrix of float64, row by row."""

    rows: int
    columns: int
    values: array[float]

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the matrix in binary.

        Raises:
            EncodeError: There are not rows x columns values.
        """
        if len(self.values) != self.rows * self.columns:
            raise EncodeError(
                f"a matrix of {self.rows} x {self.columns} cannot have {len(self.values)} values"
            )
        header = pack("matrix", _MATRIX, LIST, 3, INT32, self.rows, INT32, self.columns)
        return header + floats(self.values, dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the matrix in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _MATRIX.size:
            raise damage("matrix", f"{len(payload)} bytes are too few")
        *tags, rows, row_tag, columns = _MATRIX.unpack_from(payload)
        if (*tags, row_tag) != (LIST, 3, INT32, INT32) or rows < 0 or columns < 0:
            raise damage("matrix", "it does not begin with two sizes")
        values = read_floats("matrix", memoryview(payload)[_MATRIX.size :], dialect)
        if len(values) != rows * columns:
            raise damage("matrix", f"{len(values)} values instead of {rows} x {columns}")
        return cls(rows, columns, values)
