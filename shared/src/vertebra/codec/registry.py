"""Codecs by encoding: built in, and from the plugins that are installed."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import Final, Protocol, Self

from typing_extensions import Buffer

from vertebra.codec import values
from vertebra.codec.builtin import JpegCodec, JsonCodec, RawCodec, TextCodec
from vertebra.codec.frame import ENCODING, Frame, FrameCodec, encoding_of
from vertebra.codec.values import ValueCodecs, list_entry_points
from vertebra.errors import CodecNotFoundError, ConfigError
from vertebra.messages import Header, Message

GROUP: Final = "vertebra.codecs"


class Codec(Protocol):
    """Messages to payload bytes and back, for one encoding.

    A plugin lists it as an entry point of the group `vertebra.codecs` whose name is the encoding
    with dots for slashes (`image.png`).
    """

    @property
    def encoding(self) -> str:
        """The media type, without schema."""
        ...

    def encode(self, message: Message, header: Header) -> bytes | Frame:
        """Return the payload; raise `EncodeError` if this message has no form in it."""
        ...

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the message in untrusted bytes; raise `DecodeError`.

        An encoding without a header of its own gives an empty one: `captured_ns` 0 is unknown.
        """
        ...


class CodecRegistry:
    """Finds the codec of an encoding and loads it on first use.

    Args:
        codecs: Entry points of the group `vertebra.codecs`.
        value_codecs: Entry points of the group `vertebra.values`.
    """

    def __init__(
        self, codecs: Iterable[EntryPoint] = (), value_codecs: Iterable[EntryPoint] = ()
    ) -> None:
        builtin: list[Codec] = [
            FrameCodec(values=ValueCodecs(value_codecs)),
            JsonCodec(),
            TextCodec(),
            RawCodec(),
            JpegCodec(),
        ]
        self._loaded = {codec.encoding: codec for codec in builtin}
        self._listed = {
            name.replace(".", "/", 1): entry_point
            for name, entry_point in list_entry_points(codecs).items()
        }
        if taken := self._listed.keys() & self._loaded.keys():
            raise ConfigError(f"a plugin claims the built-in encoding {min(taken)!r}; uninstall it")

    @classmethod
    def installed(cls) -> Self:
        """Return a registry of everything that is installed in this environment."""
        return cls(entry_points(group=GROUP), entry_points(group=values.GROUP))

    @property
    def encodings(self) -> tuple[str, ...]:
        """Every encoding that can be read and written here, sorted."""
        return tuple(sorted(self._loaded.keys() | self._listed.keys()))

    def encode(
        self, message: Message, header: Header, encoding: str = ENCODING
    ) -> tuple[bytes | Frame, str]:
        """Return the payload of `message` and its full encoding, schema included.

        Raises:
            CodecNotFoundError: Nothing installed writes `encoding`.
            EncodeError: The message has no form in `encoding`.
        """
        codec = self._get(encoding)
        full = encoding_of(message) if codec.encoding == ENCODING else codec.encoding
        return codec.encode(message, header), full

    def decode(self, payload: Buffer, encoding: str) -> tuple[Message, Header]:
        """Return the message in a payload of the given encoding, and its header.

        Raises:
            CodecNotFoundError: Nothing installed reads `encoding` or its schema.
            DecodeError: The payload is damaged or foreign.
        """
        return self._get(encoding).decode(payload)

    def _get(self, encoding: str) -> Codec:
        name = encoding.partition(";")[0].strip()
        if name not in self._loaded:
            if name not in self._listed:
                raise CodecNotFoundError(
                    f"nothing here reads {encoding!r}; installed: {', '.join(self.encodings)}"
                )
            self._loaded[name] = self._listed[name].load()()
        return self._loaded[name]
