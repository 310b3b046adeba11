"""NumPy arrays and scalars in their packed form.

An array is packed as an `Array` of its type, shape and bytes in C order. Where that does not tell
everything it is a map: `array` is that `Array`; `order` is `F` if it holds the transposed of the
value, which has its first axis contiguous; `fields` lists the fields of a structured type, whose
items are raw bytes (`|V16`) in `array`. A field is a map of `name`, `offset`, and `type` (a type
string) or `itemsize` and `fields`; `shape` if the field is an array itself, `title` if it has one.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array

_MAX_CODE_POINT: Final = 0x10FFFF
_MAX_FIELD_DEPTH: Final = 32
_REMEDIES: Final = {
    "O": "Python objects never travel: convert the items to numbers or texts of one type, or send "
    "`array.tolist()`",
    "T": "texts of variable length have no fixed form: send `array.astype('U')`",
    "f": "extended precision differs from machine to machine: send `array.astype('f8')`",
    "c": "extended precision differs from machine to machine: send `array.astype('c16')`",
}


class ArrayCodec:
    """`numpy.ndarray`; what is decoded is a read-only view into the payload it came in."""

    def pack(self, value: NDArray[Any]) -> Array | dict[str, Any]:
        """Return the array in its packed form; copied only if it is contiguous in no order.

        Raises:
            EncodeError: Its items or its subclass have no plain form.
        """
        if type(value) not in (np.ndarray, np.memmap):
            raise EncodeError(
                f"a {type(value).__qualname__} is more than its numbers; send numpy.asarray(value) "
                "and, where it matters, the rest (a mask, a unit) beside it"
            )
        extra: dict[str, Any] = {}
        if value.flags.f_contiguous and not value.flags.c_contiguous:
            value = value.T
            extra["order"] = "F"
        dtype = value.dtype
        if dtype.names is not None:
            extra["fields"] = _fields(dtype)
        else:
            _check(dtype)
        text = f"|V{dtype.itemsize}" if dtype.names is not None else dtype.str
        array = Array(_bytes_of(value), text, value.shape)
        return {"array": array, **extra} if extra else array

    def unpack(self, plain: Any) -> NDArray[Any]:
        """Return the array; raise `DecodeError` if `plain` is not what `pack` makes."""
        match plain:
            case Array():
                return _array(plain, None)
            case {"array": Array() as array, **extra} if extra.keys() <= {"order", "fields"}:
                value = _array(array, extra.get("fields"))
                match extra.get("order", "C"):
                    case "C":
                        return value
                    case "F":
                        return value.T
        raise DecodeError(f"this is no packed NumPy array: {plain!r:.100}")


class ScalarCodec:
    """`numpy.generic`: every NumPy scalar, packed as an array without axes."""

    def __init__(self) -> None:
        self._arrays = ArrayCodec()

    def pack(self, value: np.generic) -> Array | dict[str, Any]:
        """Return the scalar in its packed form; raise `EncodeError` if its type has none."""
        return self._arrays.pack(np.asarray(value))

    def unpack(self, plain: Any) -> Any:
        """Return the scalar; raise `DecodeError` if `plain` is not what `pack` makes."""
        array = self._arrays.unpack(plain)
        if array.shape != ():
            raise DecodeError(f"a NumPy scalar has no axes, this has the shape {array.shape}")
        return array[()]


def _check(dtype: np.dtype[Any]) -> None:
    extended = dtype.kind in "fc" and dtype.itemsize > (8 if dtype.kind == "f" else 16)
    if dtype.kind in "OT" or extended:
        raise EncodeError(f"items of type {dtype} cannot be sent; {_REMEDIES[dtype.kind]}")


def _bytes_of(value: NDArray[Any]) -> memoryview:
    if value.nbytes == 0:
        return memoryview(b"")
    return np.ascontiguousarray(value).reshape(-1).view(np.uint8).data


def _fields(dtype: np.dtype[Any]) -> list[dict[str, Any]]:
    assert dtype.names is not None  # noqa: S101 -- the caller has looked
    assert dtype.fields is not None  # noqa: S101
    packed = []
    for name in dtype.names:
        field, offset, *title = dtype.fields[name]
        entry: dict[str, Any] = {"name": name, "offset": offset}
        if title:
            if not isinstance(title[0], str):
                raise EncodeError(f"field {name!r} has the title {title[0]!r}; use a text")
            entry["title"] = title[0]
        if field.shape:
            entry["shape"] = list(field.shape)
            field = field.base
        if field.names is None:
            _check(field)
            entry["type"] = field.str
        else:
            entry["itemsize"] = field.itemsize
            entry["fields"] = _fields(field)
        packed.append(entry)
    return packed


def _array(array: Array, fields: Any) -> NDArray[Any]:
    try:
        if fields is None:
            dtype = np.dtype(array.dtype)
        else:
            dtype = _structured(fields, int(array.dtype.removeprefix("|V")), 0)
        if array.nbytes == 0:  # frombuffer refuses an empty buffer
            value = np.empty(array.shape, dtype)
            value.flags.writeable = False
        else:
            value = np.frombuffer(array.data, dtype).reshape(array.shape)
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError, MemoryError) as error:
        raise DecodeError(
            f"{array!r} with fields {fields!r:.100} is no NumPy array: {error}"
        ) from error
    _check_texts(value)
    return value


def _structured(fields: Any, itemsize: int, depth: int) -> np.dtype[Any]:
    if depth > _MAX_FIELD_DEPTH:
        raise ValueError(f"fields nest deeper than {_MAX_FIELD_DEPTH} levels")
    formats: list[Any] = []
    for field in fields:
        if not isinstance(field.get("title", ""), str):
            raise TypeError(f"a title is a text, not {field['title']!r:.100}")
        if "fields" in field:
            inner = _structured(field["fields"], field["itemsize"], depth + 1)
        else:
            inner = np.dtype(Array(b"", field["type"], (0,)).dtype)
        formats.append((inner, tuple(field["shape"])) if "shape" in field else inner)
    return np.dtype(
        {
            "names": [field["name"] for field in fields],
            "formats": formats,
            "offsets": [field["offset"] for field in fields],
            "titles": [field.get("title") for field in fields],
            "itemsize": itemsize,
        }
    )


def _check_texts(value: NDArray[Any]) -> None:
    """Refuse texts with characters that do not exist, at which NumPy fails only when it is read."""
    if value.dtype.names is not None:
        for name in value.dtype.names:
            _check_texts(value[name])
    elif value.dtype.kind == "U" and value.size and value.dtype.itemsize:
        codes = np.ascontiguousarray(value).reshape(-1).view(value.dtype.byteorder + "u4")
        if codes.max() > _MAX_CODE_POINT:
            raise DecodeError(f"a text holds the character {codes.max():#x}, which does not exist")
