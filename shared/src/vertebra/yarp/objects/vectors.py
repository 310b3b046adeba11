"""Rows of numbers: vectors, quaternions, matrices."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.bottle import Buffer
from vertebra.yarp.dialect import INT32, LIST, Dialect
from vertebra.yarp.objects.parts import YarpObject, damage, floats, pack, read_floats


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
