"""Messages to payload bytes and back: the frame, built-in encodings, and plugins for more."""

from vertebra.codec.builtin import to_json_value
from vertebra.codec.frame import ENCODING, Frame, FrameCodec, encoding_of
from vertebra.codec.registry import Codec, CodecRegistry
from vertebra.codec.values import ValueCodec, ValueCodecs

__all__ = [
    "ENCODING",
    "Codec",
    "CodecRegistry",
    "Frame",
    "FrameCodec",
    "ValueCodec",
    "ValueCodecs",
    "encoding_of",
    "to_json_value",
]
