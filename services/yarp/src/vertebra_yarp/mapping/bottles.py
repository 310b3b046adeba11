"""Values of bottles as plain values, and messages that YARP has no object for as named fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from vertebra import messages
from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array, Bottle, Message, Native, Text
from vertebra.yarp import Dict, Float32, Int8, Int16, Int64, Value, Vocab, Vocab64

_NAMED: Final[dict[str, type[Int8 | Int16 | Int64 | Float32 | Vocab | Vocab64]]] = {
    "int8": Int8,
    "int16": Int16,
    "int64": Int64,
    "float32": Float32,
    "vocab": Vocab,
    "vocab64": Vocab64,
}
_SCHEMA: Final = "schema"
_ARRAY: Final = ("dtype", "shape", "data")
_MESSAGES: Final[dict[str, type[Message]]] = {
    kind.schema(): kind
    for kind in vars(messages).values()
    if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
}


# --- bottles as they are ---------------------------------------------------------------------


def plain_of(values: Sequence[Value]) -> list[Any]:
    """Return bottle values as the plain values of a `Bottle` message; nothing is lost."""
    return [_plain(value) for value in values]


def _plain(value: Value) -> Any:
    for name, kind in _NAMED.items():
        if type(value) is kind:
            base = str if isinstance(value, str) else float if isinstance(value, float) else int
            return {name: base(value)}
    if isinstance(value, Dict):
        return {"dict": plain_of(value)}
    if isinstance(value, list):
        return plain_of(value)
    return value


def values_of(plain: Sequence[Any]) -> list[Value]:
    """Return the bottle values that `plain_of` made, or that a person wrote in that form.

    Raises:
        EncodeError: Something has no place in a bottle.
    """
    return [_value(item) for item in plain]


def _value(item: Any) -> Value:
    if isinstance(item, list | tuple):
        return values_of(item)
    if isinstance(item, dict):
        if len(item) == 1:
            ((name, value),) = item.items()
            if name == "dict" and isinstance(value, list | tuple):
                return Dict(values_of(value))
            kind = _NAMED.get(name)
            fits = str if kind in (Vocab, Vocab64) else int | float
            if kind is not None and isinstance(value, fits):
                return kind(value)
        raise EncodeError(
            f"{item!r} is no bottle value; a map has one entry: dict, {', '.join(_NAMED)}"
        )
    if item is None:
        raise EncodeError("None has no place in a bottle")
    if isinstance(item, bool | int | float | str | bytes):
        return item
    raise EncodeError(f"a {type(item).__name__} has no place in a bottle")


def bottle(values: list[Value]) -> Message:
    """Return a bottle as it is."""
    return Bottle(values=plain_of(values))


def from_bottle(message: Bottle) -> list[Value]:
    """Return the values of a bottle."""
    return values_of(message.values)


def text(values: list[Value]) -> Message:
    """Return the words of a bottle: one string, or two where the second is the language."""
    if not 1 <= len(values) <= 2 or any(type(value) is not str for value in values):
        raise DecodeError(
            f"a bottle with one string was expected (and its language), it holds {len(values)} "
            "values"
        )
    return Text(text=str(values[0]), language="".join(map(str, values[1:])))


def from_text(message: Text) -> list[Value]:
    """Return words as one string, or two where the language is known."""
    return [message.text, message.language] if message.language else [message.text]


# --- named fields: a YARP Property -----------------------------------------------------------


def native(values: list[Value]) -> Message:
    """Return a Property, a list of keys and values, as a dict."""
    return Native(value=_dict(values))


def from_native(message: Native) -> list[Value]:
    """Return a dict as a Property."""
    value = message.value
    if not isinstance(value, dict):
        raise EncodeError(
            f"a Native goes to YARP as a Property, so it holds a dict, not a "
            f"{type(value).__name__}; put it below a key"
        )
    schema = value.get(_SCHEMA)
    if isinstance(schema, str) and schema in _MESSAGES:
        raise EncodeError(f"{schema!r} would make another message of this Native")
    return _pairs(value)


def from_fields(message: Message) -> list[Value]:
    """Return a message for which YARP has no object, as a Property of its fields."""
    return [[_SCHEMA, message.schema()], *_pairs(_present(message))]


def is_fields(values: Sequence[Value]) -> bool:
    """Say whether `from_fields` made this bottle."""
    first = values[0] if values else None
    return isinstance(first, list) and len(first) == 2 and first[0] == _SCHEMA and (
        isinstance(first[1], str) and first[1] in _MESSAGES
    )  # fmt: skip


def fields(values: list[Value]) -> Message:
    """Return the message of which `from_fields` made these values."""
    named = _dict(values)
    kind = _MESSAGES[named.pop(_SCHEMA)]
    try:
        return msgspec.convert(named, kind, dec_hook=lambda _, given: given)
    except (msgspec.ValidationError, ValueError) as error:
        raise DecodeError(f"these are no fields of {kind.schema()}: {error}") from error


def _present(struct: msgspec.Struct) -> dict[str, Any]:
    named = msgspec.structs.asdict(struct)
    return {name: value for name, value in named.items() if value is not None}


def _pairs(named: dict[str, Any]) -> list[Value]:
    return [[_key(name), _packed(value)] for name, value in named.items()]


def _key(name: object) -> str:
    if isinstance(name, str):
        return name
    raise EncodeError(f"the keys of a Property are strings, not {name!r}")


def _packed(value: Any) -> Value:
    if isinstance(value, Array):
        parts: list[Value] = [value.dtype, [*value.shape], bytes(value.data)]
        return Dict([[name, part] for name, part in zip(_ARRAY, parts, strict=True)])
    if isinstance(value, msgspec.Struct):
        return Dict(_pairs(_present(value)))
    if isinstance(value, dict):
        if set(value) == set(_ARRAY):
            raise EncodeError(f"a dict with the keys {', '.join(_ARRAY)} would become an Array")
        return Dict(_pairs(value))
    if isinstance(value, list | tuple):
        return [*map(_packed, value)]
    if isinstance(value, bool | int | float | str | bytes):
        return value
    what = "None" if value is None else f"a {type(value).__name__}"
    raise EncodeError(f"{what} has no place in a bottle; leave it out or send a number or text")


def _dict(pairs: Sequence[Value]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or type(pair[0]) is not str:
            raise DecodeError(
                f"no Property: {pair!r:.80} is not a key and a value; use type Bottle"
            )
        if pair[0] in named:
            raise DecodeError(f"no Property: the key {pair[0]!r} comes twice; use type Bottle")
        named[pair[0]] = _unpacked(pair[1])
    return named


def _unpacked(value: Value) -> Any:
    if isinstance(value, Dict):
        named = _dict(value)
        return _array(named) if set(named) == set(_ARRAY) else named
    if isinstance(value, list):
        return [*map(_unpacked, value)]
    if type(value) in (bool, int, float, str, bytes):
        return value
    if isinstance(value, Int64) and not -(2**31) <= value < 2**31:
        return int(value)
    raise DecodeError(
        f"the {type(value).__name__} {value!r:.80} has no plain form; use type Bottle"
    )


def _array(named: dict[str, Any]) -> Array:
    try:
        return Array(named["data"], named["dtype"], tuple(named["shape"]))
    except (TypeError, ValueError) as error:
        raise DecodeError(f"{named!r:.80} is no array: {error}") from error
