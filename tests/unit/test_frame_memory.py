"""A frame's buffers are let go with the message, not when the garbage collector comes by."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator

import pytest

from vertebra.codec import FrameCodec
from vertebra.messages import Array, Foreign, Header, Image, Message, Native, Tensor

PIXELS = Array(bytes(48), "|u1", (4, 4, 3))
MESSAGES = [
    Image(pixels=PIXELS, pixel_format="rgb8"),
    Tensor(array=PIXELS),
    Native(value=Foreign(tag="some.Table", plain={"column": PIXELS})),
]


@pytest.fixture(autouse=True)
def _no_garbage_collector() -> Iterator[None]:
    gc.disable()
    yield
    gc.enable()


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_neither_encoding_nor_decoding_holds_on_to_the_bytes(message: Message) -> None:
    codec = FrameCodec()
    frame = bytes(codec.encode(message, Header()))
    pixels, payload = sys.getrefcount(PIXELS.data), sys.getrefcount(frame)
    codec.encode(message, Header())
    codec.decode(frame)
    now = sys.getrefcount(PIXELS.data), sys.getrefcount(frame)
    assert now == (pixels, payload)
