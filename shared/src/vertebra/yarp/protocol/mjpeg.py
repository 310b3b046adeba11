"""The carrier mjpeg: images as JPEGs, each a part of one HTTP response without end.

    reader -> GET /?action=stream HTTP/1.1 . headers . empty line
    writer -> HTTP/1.0 200 OK . headers . empty line . --boundarydonotcross
              Content-Type, Content-Length . empty line . JPEG . --boundarydonotcross, and so on

The reader dials: a browser, or a YARP port that was told to `[add] "mjpeg://camera"`. The envelope
travels as a comment in the JPEG. What turns pixels into JPEGs comes from outside (`JpegCodec`).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib.metadata import entry_points
from typing import Final, Protocol

from vertebra.yarp.protocol.wire import Buffer, decoded, line_bytes

JPEG_PLUGINS: Final = "vertebra.yarp.jpeg"
"""Group of entry points; each is a class whose instances are a `JpegCodec`."""

_BOUNDARY: Final = b"--boundarydonotcross\r\n"
STREAM_HEAD: Final = (
    b"HTTP/1.0 200 OK\r\n"
    b"Connection: close\r\n"
    b"Server: yarp/mjpeg_carrier/0.1\r\n"
    b"Cache-Control: no-store, no-cache, must-revalidate, pre-check=0, post-check=0, max-age=0\r\n"
    b"Pragma: no-cache\r\n"
    b"Expires: Mon, 3 Jan 2000 12:34:56 GMT\r\n"
    b"Content-Type: multipart/x-mixed-replace;boundary=boundarydonotcross\r\n"
    b"\r\n" + _BOUNDARY
)
NO_CODEC: Final = (
    b"HTTP/1.0 503 Service Unavailable\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n"
    b"This YARP port cannot make JPEGs: install vertebra-pillow beside it.\r\n"
)

_START: Final = b"\xff\xd8"
_JFIF: Final = 0xE0
_COMMENT: Final = 0xFE
_PIXELS: Final = 0xDA
_MAX_COMMENT_BYTES: Final = 0xFFFF - 3  # beside the length itself and the NUL


class JpegCodec(Protocol):
    """Turns images into JPEGs and back; called in threads."""

    def encode(self, payload: Buffer) -> bytes:
        """Return a serialised yarp/image as a JPEG.

        Raises:
            CodecError: It is no image, or one of pixels that JPEG does not know.
        """
        ...

    def decode(self, jpeg: Buffer) -> bytes:
        """Return a JPEG as a serialised yarp/image.

        Raises:
            DecodeError: It is damaged.
        """
        ...


@cache
def installed_jpeg() -> JpegCodec | None:
    """Return the JPEG codec of the first plugin that has one, None where none is installed."""
    for found in sorted(entry_points(group=JPEG_PLUGINS), key=lambda each: each.name):
        codec: JpegCodec = found.load()()
        return codec
    return None


def part(jpeg: bytes, envelope: str) -> list[Buffer]:
    """Return a JPEG as the next part of the stream.

    Raises:
        EncodeError: The envelope holds control characters.
    """
    begin, comment, rest = _with_comment(jpeg, envelope)
    size = len(begin) + len(comment) + len(rest)
    head = f"Content-Type: image/jpeg\r\nContent-Length: {size}\r\n\r\n".encode()
    return [b"".join((head, begin, comment)), rest, b"\r\n" + _BOUNDARY]


def _with_comment(jpeg: bytes, text: str) -> tuple[Buffer, bytes, Buffer]:
    raw = line_bytes(text, "envelope")[:_MAX_COMMENT_BYTES]
    view = memoryview(jpeg)
    if not raw:
        return b"", b"", view
    first = next(_segments(jpeg), None)
    end = first[2] if first is not None and first[0] == _JFIF else len(_START)
    segment = bytes((0xFF, _COMMENT)) + (len(raw) + 3).to_bytes(2, "big") + raw + b"\0"
    return view[:end], segment, view[end:]


def comment_of(jpeg: Buffer) -> str:
    """Return the first comment of a JPEG, empty where there is none."""
    for kind, begin, end in _segments(jpeg):
        if kind == _COMMENT:
            return decoded(bytes(jpeg[begin:end]).partition(b"\0")[0])
    return ""


def _segments(jpeg: Buffer) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of what comes before the pixels, as far as it is whole."""
    position = len(_START)
    while position + 4 <= len(jpeg) and jpeg[position] == 0xFF and jpeg[position + 1] != _PIXELS:
        end = position + 2 + int.from_bytes(jpeg[position + 2 : position + 4], "big")
        if end > len(jpeg) or end < position + 4:
            return
        yield jpeg[position + 1], position + 4, end
        position = end
