"""Codecs for the encodings that everybody's programs speak: JSON, text, raw bytes, JPEG."""

from __future__ import annotations

import math
from array import array
from typing import Any, Final, TypeVar

import msgspec
from typing_extensions import Buffer

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import (
    MESSAGES,
    Array,
    CompressedImage,
    Foreign,
    Header,
    Message,
    Native,
    Tensor,
    Text,
)

MAX_JSON_ITEMS: Final = 65536
"""More array items than this do not belong into JSON."""
M = TypeVar("M", bound=Message)
_LETTERS: Final = {
    "|b1": "B", "|i1": "b", "|u1": "B", "<i2": "h", "<u2": "H", "<i4": "i", "<u4": "I",
    "<i8": "q", "<u8": "Q", "<f4": "f", "<f8": "d",
}  # fmt: skip


class JsonCodec:
    """`application/json`: any JSON document is a `Native`; a message names its schema.

    A message is `{"schema": ..., "captured_ns": ..., "sequence": ..., "origin": ..., "hops": ...,
    "message": {...}}`. Arrays are `{"dtype", "shape", "items"}` with nested lists as items, byte
    strings are `{"bytes": [...]}`; there is no base64. Large arrays are refused.
    """

    encoding = "application/json"

    def __init__(self) -> None:
        self._types = {message.schema(): message for message in MESSAGES}

    def encode(self, message: Message, header: Header) -> bytes:
        """Return the JSON text; raise `EncodeError` for what JSON should not carry."""
        document = {
            "schema": message.schema(),
            **msgspec.to_builtins(header),
            "message": to_json_value(message),
        }
        return msgspec.json.encode(document)

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the message in a JSON text, a `Native` if the text names no schema."""
        try:
            value = msgspec.json.decode(payload)
            if not isinstance(value, dict) or "schema" not in value:
                return Native(value=value), Header()
            message_type = self._types.get(value["schema"])
            if message_type is None:
                raise DecodeError(f"schema {value['schema']!r} is not known here")
            message = msgspec.convert(
                value.get("message"), message_type, strict=False, dec_hook=_array_of_json
            )
            return message, msgspec.convert(value, Header)
        except (
            msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError,
        ) as error:  # fmt: skip
            if isinstance(error, DecodeError):
                raise
            raise DecodeError(f"this JSON cannot be read: {error}") from error


def to_json_value(message: Message) -> Any:
    """Return the fields of `message` as JSON values; raise `EncodeError` for large arrays."""
    try:
        plain = msgspec.to_builtins(
            message,
            builtin_types=(bytes, bytearray, memoryview),
            str_keys=True,
            enc_hook=_json_of,
        )
        return _without_bytes(plain)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        if isinstance(error, EncodeError):
            raise
        raise EncodeError(f"{type(message).__name__} has no JSON: {error}") from error


def _json_of(value: Any) -> Any:
    if isinstance(value, Foreign):
        return {"tag": value.tag, "plain": value.plain}
    if not isinstance(value, Array):
        raise EncodeError(
            f"a value of type {type(value).__qualname__} has no JSON; "
            "send it in a frame, or convert it to plain lists"
        )
    if math.prod(length or 1 for length in value.shape) > MAX_JSON_ITEMS:  # (10**9, 0) is long too
        raise EncodeError(
            f"an array of shape {value.shape} has more than {MAX_JSON_ITEMS} items; "
            "ask for the frame encoding instead of JSON"
        )
    return {"dtype": value.dtype, "shape": list(value.shape), "items": value.tolist()}


def _array_of_json(wanted: type, value: Any) -> Any:
    if wanted is not Array:
        raise DecodeError(f"no JSON form of {wanted.__name__}")
    return array_of_items(value)


def array_of_items(value: Any) -> Array:
    """Return the `Array` of its JSON form; raise `DecodeError`."""
    if not isinstance(value, dict) or not {"dtype", "shape", "items"} <= value.keys():
        raise DecodeError('an array in JSON is {"dtype": ..., "shape": ..., "items": ...}')
    letter = _LETTERS.get(value["dtype"])
    if letter is None:
        raise DecodeError(f"arrays of type {value['dtype']!r} have no JSON; use a frame")
    flat: list[Any] = []
    stack: list[Any] = [value["items"]]
    while stack:
        item = stack.pop()
        if isinstance(item, list):
            stack.extend(reversed(item))
        else:
            flat.append(item)
    return Array(array(letter, flat), value["dtype"], tuple(value["shape"]))


def _without_bytes(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_bytes(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_bytes(item) for item in value]
    if isinstance(value, bytes | bytearray | memoryview):
        if len(value) > MAX_JSON_ITEMS:
            raise EncodeError(
                f"{len(value)} bytes do not belong into JSON; ask for the frame encoding"
            )
        return {"bytes": list(value)}
    return value


class TextCodec:
    """`text/plain`, UTF-8, as `Text`."""

    encoding = "text/plain"

    def encode(self, message: Message, header: Header) -> bytes:  # noqa: ARG002  - text has none
        """Return the text of a `Text`."""
        return _expect(message, Text, self.encoding).text.encode()

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the text as a `Text`; raise `DecodeError` if it is not UTF-8."""
        try:
            return Text(text=str(memoryview(payload), "utf-8")), Header()
        except UnicodeDecodeError as error:
            raise DecodeError(f"this text is not UTF-8: {error}") from error


class RawCodec:
    """`application/octet-stream`, as a one-dimensional `Tensor` of type `|u1`."""

    encoding = "application/octet-stream"

    def encode(self, message: Message, header: Header) -> bytes:  # noqa: ARG002  - bytes have none
        """Return the bytes of a `Tensor`; its type and shape are not part of them."""
        return bytes(_expect(message, Tensor, self.encoding).array.data)

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the bytes, uncopied, as a `Tensor`."""
        view = memoryview(payload).cast("B")
        return Tensor(array=Array(view, "|u1", (view.nbytes,))), Header()


class JpegCodec:
    """`image/jpeg`, as a `CompressedImage` that nobody has decompressed."""

    encoding = "image/jpeg"

    def encode(self, message: Message, header: Header) -> bytes:  # noqa: ARG002  - JPEG has none
        """Return the JPEG file inside a `CompressedImage`."""
        image = _expect(message, CompressedImage, self.encoding)
        if image.media_type != self.encoding:
            raise EncodeError(f"this CompressedImage is {image.media_type!r}, not a JPEG")
        return bytes(image.data.data)

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the file as a `CompressedImage`; raise `DecodeError` if it is cut or no JPEG."""
        view = memoryview(payload).cast("B")
        if bytes(view[:2]) != b"\xff\xd8" or b"\xff\xd9" not in bytes(view[-64:]):
            raise DecodeError(
                f"{view.nbytes} bytes beginning {bytes(view[:4]).hex(' ')!r} are no whole JPEG"
            )
        data = Array(view, "|u1", (view.nbytes,))
        return CompressedImage(data=data, media_type=self.encoding), Header()


def _expect(message: Message, wanted: type[M], encoding: str) -> M:
    if not isinstance(message, wanted):
        raise EncodeError(
            f"{encoding} carries {wanted.__name__}, not {type(message).__name__}; use a frame"
        )
    return message
