"""Frame version 1: one message as one byte string; specified in FRAME.md beside this file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, TypeVar

import msgspec
from typing_extensions import Buffer

from vertebra.codec.values import ValueCodecs, check_plain
from vertebra.errors import CodecError, CodecNotFoundError, DecodeError, EncodeError
from vertebra.messages import MESSAGES, Array, Foreign, Header, Message, Native

ENCODING: Final = "application/vnd.vertebra.frame"
MAGIC: Final = b"VTB\x01"
ALIGNMENT: Final = 64
MAX_HEADER_BYTES: Final = 16 << 20
MAX_BUFFERS: Final = 4096
_PREFIX_BYTES: Final = 8
_ARRAY: Final = 1
_FOREIGN: Final = 2
_PADDING: Final = bytes(ALIGNMENT)
T = TypeVar("T")


class _FrameHeader(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    schema: str
    captured_ns: int = 0
    sequence: int = 0
    origin: str = ""
    hops: int = 0
    fields: msgspec.Raw
    buffers: list[int] = msgspec.field(default_factory=list)


_HEADER_DECODER: Final = msgspec.msgpack.Decoder(_FrameHeader)
_ARRAY_DECODER: Final = msgspec.msgpack.Decoder(tuple[int, str, tuple[int, ...]])


class _Packer:
    """Turns what a message holds beside plain values into extensions.

    This and `_Unpacker` are no functions inside functions: one that refers to itself is a reference
    cycle, which would keep each image until the garbage collector comes by.
    """

    def __init__(self, values: ValueCodecs) -> None:
        self.buffers: list[memoryview] = []
        self._values = values

    def pack(self, value: Any) -> msgspec.msgpack.Ext:
        if isinstance(value, Array):
            self.buffers.append(value.data)
            reference = (len(self.buffers) - 1, value.dtype, value.shape)
            return msgspec.msgpack.Ext(_ARRAY, msgspec.msgpack.encode(reference))
        foreign = value if isinstance(value, Foreign) else self._values.pack(value)
        body = msgspec.msgpack.encode((foreign.tag, foreign.plain), enc_hook=self.pack)
        return msgspec.msgpack.Ext(_FOREIGN, body)


class _Unpacker:
    """Turns extensions back into what they were; each buffer may be used once."""

    def __init__(self, values: ValueCodecs, buffers: list[memoryview]) -> None:
        self.unused = set(range(len(buffers)))
        self._values = values
        self._buffers = buffers

    def unpack(self, code: int, body: memoryview) -> Any:
        if code == _ARRAY:
            index, dtype, shape = _ARRAY_DECODER.decode(body)
            if index not in self.unused:
                raise ValueError(f"buffer {index} does not exist or is used twice")
            self.unused.remove(index)
            return Array(self._buffers[index], dtype, shape)
        if code == _FOREIGN:
            tag, plain = msgspec.msgpack.decode(body, type=tuple[str, Any], ext_hook=self.unpack)
            return self._values.unpack(Foreign(tag=tag, plain=plain))
        raise ValueError(f"unknown extension type {code}")


class Frame(msgspec.Struct, frozen=True):
    """An encoded message whose buffers are not gathered yet: `bytes(frame)` copies each once.

    Attributes:
        head: Magic, header length and header.
        buffers: The large buffers, in order, still where the message has them.
        nbytes: Length of the whole frame.
    """

    head: bytes
    buffers: tuple[memoryview, ...]
    nbytes: int

    def parts(self) -> Iterator[bytes | memoryview]:
        """Yield the pieces, paddings included, whose concatenation is the frame."""
        yield self.head
        position = len(self.head)
        for buffer in self.buffers:
            if gap := -position % ALIGNMENT:
                yield _PADDING[:gap]
            yield buffer
            position += gap + buffer.nbytes

    def __bytes__(self) -> bytes:
        return b"".join(self.parts()) if self.buffers else self.head


class FrameCodec:
    """Encodes and decodes frames of a set of message types.

    Args:
        messages: The types it knows; a frame of another schema is refused.
        values: Codecs for values of libraries inside `Native`.
        max_bytes: Longest frame that `decode` accepts.
    """

    encoding = ENCODING

    def __init__(
        self,
        messages: Iterable[type[Message]] = MESSAGES,
        *,
        values: ValueCodecs | None = None,
        max_bytes: int = 1 << 30,
    ) -> None:
        self._types = {message.schema(): message for message in messages}
        self._values = values or ValueCodecs(())
        self._max_bytes = max_bytes

    def encode(self, message: Message, header: Header) -> Frame:
        """Return the frame of `message`; its large buffers are referred to, not copied.

        Raises:
            EncodeError: A value inside the message has no form in a frame.
        """
        packer = _Packer(self._values)
        buffers = packer.buffers
        try:
            if isinstance(message, Native):
                check_plain(message.value)
            fields = msgspec.msgpack.encode(message, enc_hook=packer.pack)
            head = msgspec.msgpack.encode(
                _FrameHeader(
                    schema=message.schema(),
                    captured_ns=header.captured_ns,
                    sequence=header.sequence,
                    origin=header.origin,
                    hops=header.hops,
                    fields=msgspec.Raw(fields),
                    buffers=[buffer.nbytes for buffer in buffers],
                )
            )
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            if isinstance(error, CodecError):
                raise
            raise EncodeError(f"{type(message).__name__} has no frame: {error}") from error
        if len(head) > MAX_HEADER_BYTES:
            raise EncodeError(
                f"the header of this {type(message).__name__} would have {len(head)} bytes, the "
                f"limit is {MAX_HEADER_BYTES}; put large data into arrays"
            )
        if len(buffers) > MAX_BUFFERS:
            raise EncodeError(f"{len(buffers)} arrays in one message, the limit is {MAX_BUFFERS}")
        position = _PREFIX_BYTES + len(head)
        for buffer in buffers:
            position += -position % ALIGNMENT + buffer.nbytes
        prefix = MAGIC + len(head).to_bytes(4, "little")
        return Frame(prefix + head, tuple(buffers), position)

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the message in a frame and its header.

        Arrays of the message are views into `payload`, which they keep alive.

        Raises:
            DecodeError: The frame is damaged, oversized, or its fields do not fit the schema.
            CodecNotFoundError: The frame is sound but its schema or major version is unknown here.
        """
        view = memoryview(payload).cast("B").toreadonly()
        header, buffers = self._split(view)
        message_type = self._types.get(header.schema)
        if message_type is None:
            raise CodecNotFoundError(self._unknown(header.schema))
        unpacker = _Unpacker(self._values, buffers)
        message = _guarded(
            f"the fields of this {header.schema}",
            lambda: msgspec.msgpack.decode(
                header.fields, type=message_type, ext_hook=unpacker.unpack
            ),
        )
        if unpacker.unused:  # a later minor version may have arrays in fields that are unknown here
            unpacker = _Unpacker(self._values, buffers)
            _guarded(
                f"the fields of this {header.schema}",
                lambda: msgspec.msgpack.decode(header.fields, ext_hook=unpacker.unpack),
            )
        if unpacker.unused:
            raise DecodeError(
                f"buffer {min(unpacker.unused)} of {len(buffers)} is not used by any array"
            )
        return message, Header(
            captured_ns=header.captured_ns,
            sequence=header.sequence,
            origin=header.origin,
            hops=header.hops,
        )

    def _split(self, view: memoryview) -> tuple[_FrameHeader, list[memoryview]]:
        total = view.nbytes
        if total > self._max_bytes:
            raise DecodeError(f"a frame of {total} bytes exceeds the limit of {self._max_bytes}")
        if bytes(view[:4]) != MAGIC:
            found = bytes(view[:4]).hex(" ") or "nothing"
            raise DecodeError(f"a frame begins with {MAGIC.hex(' ')}, found {found}")
        if total < _PREFIX_BYTES:
            raise DecodeError(f"a frame has at least {_PREFIX_BYTES} bytes, found {total}")
        length = int.from_bytes(view[4:8], "little")
        if length > min(MAX_HEADER_BYTES, total - _PREFIX_BYTES):
            raise DecodeError(
                f"the header claims {length} bytes at offset 8, the frame has {total} bytes in all "
                f"and the limit is {MAX_HEADER_BYTES}"
            )
        position = _PREFIX_BYTES + length
        header = _guarded(
            "the header",
            lambda: _HEADER_DECODER.decode(view[_PREFIX_BYTES:position]),
        )
        if len(header.buffers) > MAX_BUFFERS:
            raise DecodeError(f"{len(header.buffers)} buffers, the limit is {MAX_BUFFERS}")
        buffers = []
        for index, nbytes in enumerate(header.buffers):
            start = position + -position % ALIGNMENT
            if nbytes < 0 or start + nbytes > total:
                raise DecodeError(
                    f"buffer {index} claims {nbytes} bytes at offset {start}, "
                    f"the frame ends at {total}"
                )
            if view[position:start] != _PADDING[: start - position]:
                raise DecodeError(f"the padding before buffer {index} is not zero")
            position = start + nbytes
            buffers.append(view[start:position])
        if position != total:
            raise DecodeError(f"the frame ends at {position}, but {total} bytes were given")
        return header, buffers

    def _unknown(self, schema: str) -> str:
        stem = schema.rpartition("/")[0]
        known = [name for name in self._types if name.rpartition("/")[0] == stem]
        if known:
            return f"schema {schema!r} is not known here, only {known[0]!r}: update this service"
        return f"schema {schema!r} is not known here"


def encoding_of(message: Message | type[Message]) -> str:
    """Return the Zenoh encoding of the frame of a message or message type."""
    return f"{ENCODING};{message.schema().removeprefix('vertebra/')}"


def _guarded(what: str, decode: Callable[[], T]) -> T:
    """Run a decoder over untrusted bytes; whatever it objects to is a `DecodeError`."""
    try:
        return decode()
    except CodecError:
        raise
    except (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise DecodeError(f"{what} cannot be read: {error}") from error
