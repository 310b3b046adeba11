"""`Array`: typed, shaped bytes that any library can look at without a copy."""

from __future__ import annotations

import math
import re
import sys
from functools import lru_cache
from typing import Any, Final, Self

from typing_extensions import Buffer

from vertebra.errors import EncodeError

MAX_AXES: Final = 64
"""As many as NumPy knows; also bounds what it costs to check the shape of a foreign array."""
_DTYPE: Final = re.compile(r"([<>|])([biufcmMSUV])([0-9]{1,9})(\[[A-Za-z0-9]+\])?")
_NATIVE: Final = "<" if sys.byteorder == "little" else ">"
_FORMAT_KINDS: Final = {
    **dict.fromkeys("bhilqn", "i"),
    **dict.fromkeys("BHILQN", "u"),
    **dict.fromkeys("efd", "f"),
}
_CAST_FORMATS: Final = {
    "i1": "b", "i2": "h", "i4": "i", "i8": "q",
    "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
    "f4": "f", "f8": "d", "b1": "?",
}  # fmt: skip


@lru_cache(maxsize=256)
def item_bytes(dtype: str) -> int:
    """Return the bytes of one item of a NumPy type string such as `<f8` or `|u1`.

    Raises:
        ValueError: `dtype` is no fixed-size type; Python objects (`O`) never are.
    """
    match = _DTYPE.fullmatch(dtype)
    if match is None:
        raise ValueError(f"{dtype!r} is not a fixed-size array type such as '<f8' or '|u1'")
    return int(match[3]) * (4 if match[2] == "U" else 1)


class Array:
    """A C-contiguous array: type, shape, and its bytes as a `memoryview`.

    `numpy.asarray(array)` (or anything else that reads `__array_interface__`) sees the bytes in
    place. An array that was decoded is a read-only view into the payload it came in and keeps
    that payload alive.

    Attributes:
        data: The bytes, one-dimensional, format `B`.
        dtype: NumPy type string, for example `|u1`, `<f4`, `<M8[ns]`.
        shape: Items along each axis; `()` is a scalar.
    """

    __slots__ = ("data", "dtype", "shape")

    data: memoryview
    dtype: str
    shape: tuple[int, ...]

    def __init__(self, data: Buffer, dtype: str, shape: tuple[int, ...]) -> None:
        view = memoryview(data)
        if view.format != "B" or view.ndim != 1:
            view = view.cast("B")
        if len(shape) > MAX_AXES:
            raise ValueError(f"an array has at most {MAX_AXES} axes, not {len(shape)}")
        if min(shape, default=0) < 0:
            raise ValueError(f"an array has no axis of length {min(shape)}")
        expected = item_bytes(dtype) * math.prod(shape)
        if view.nbytes != expected:
            raise ValueError(
                f"an array of type {dtype!r} and shape {shape} has {expected} bytes, "
                f"not {view.nbytes}"
            )
        self.data = view
        self.dtype = dtype
        self.shape = shape

    @classmethod
    def of(cls, value: Buffer) -> Self:
        """Look at any buffer (bytes, `array.array`, a NumPy array) as an `Array`.

        Nothing is copied unless `value` is not C-contiguous.

        Raises:
            EncodeError: The item type of `value` has no plain machine form.
        """
        view = memoryview(value)
        letter = view.format.lstrip("@=")
        if letter == "?":
            dtype = "|b1"
        elif letter in _FORMAT_KINDS:
            order = "|" if view.itemsize == 1 else _NATIVE
            dtype = f"{order}{_FORMAT_KINDS[letter]}{view.itemsize}"
        else:
            raise EncodeError(
                f"an array of item format {view.format!r} has no plain machine form; "
                "convert it first, or install the codec plugin of its library"
            )
        shape = tuple(view.shape) if view.shape is not None else ()
        if not view.c_contiguous:
            view = memoryview(view.tobytes())
        return cls(view.cast("B") if view.nbytes else b"", dtype, shape)

    @property
    def nbytes(self) -> int:
        """The length of `data` in bytes."""
        return self.data.nbytes

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return {"version": 3, "typestr": self.dtype, "shape": self.shape, "data": self.data}

    def tolist(self) -> Any:
        """Return the items as nested Python lists.

        Raises:
            EncodeError: The item type has no Python form without a library.
        """
        kind = self.dtype[1:]
        if kind not in _CAST_FORMATS or self.dtype[0] not in ("|", _NATIVE):
            raise EncodeError(f"items of type {self.dtype!r} need NumPy: use numpy.asarray(array)")
        if not self.nbytes:
            return _empty_lists(self.shape)
        items: memoryview[Any] = self.data.cast(_CAST_FORMATS[kind])  # type: ignore[call-overload]
        if len(self.shape) == 1:
            return items.tolist()
        return self.data.cast(_CAST_FORMATS[kind], self.shape).tolist() if self.shape else items[0]  # type: ignore[call-overload]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Array):
            return NotImplemented
        return (self.dtype, self.shape) == (other.dtype, other.shape) and self.data == other.data

    def __hash__(self) -> int:
        return hash((self.dtype, self.shape))

    def __repr__(self) -> str:
        return f"Array({self.dtype!r}, shape={self.shape})"


def _empty_lists(shape: tuple[int, ...]) -> list[Any]:
    return [] if not shape or not shape[0] else [_empty_lists(shape[1:]) for _ in range(shape[0])]
