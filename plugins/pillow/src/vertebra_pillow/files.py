"""PNG and WebP files as encodings of `Image`; both without loss.

What a file may cost is known from its first bytes before Pillow sees it: a small file that claims
a huge picture is refused.
"""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any, Final

from PIL import Image as Pillow
from typing_extensions import Buffer

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array, Header, Image, Message
from vertebra.messages.media import PIXELS

MAX_PIXELS: Final = 1 << 26
"""Larger pictures are refused; below the size at which Pillow itself begins to warn."""

# What Pillow calls the pixels of a message: its mode, and how the bytes lie.
_RAW: Final = {
    "mono8": ("L", "L"),
    "mono16": ("I;16", "I;16"),
    "rgb8": ("RGB", "RGB"),
    "bgr8": ("RGB", "BGR"),
    "rgba8": ("RGBA", "RGBA"),
    "bgra8": ("RGBA", "BGRA"),
}
_FORMATS: Final = {"L": "mono8", "I;16": "mono16", "RGB": "rgb8", "RGBA": "rgba8"}
# Modes that lose nothing when they become one of these.
_SIMPLER: Final = {"1": "L", "LA": "RGBA", "PA": "RGBA", "RGBX": "RGB"}

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
# Interlaced pictures are seven pictures: first column and row of each, and the steps between.
_PNG_PASSES: Final = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4),
                      (1, 0, 2, 2), (0, 1, 1, 2))  # fmt: skip


class _FileCodec:
    """What PNG and WebP have in common."""

    encoding: str
    _format: str
    _pixel_formats: tuple[str, ...]
    _options: dict[str, Any]

    def encode(self, message: Message, header: Header) -> bytes:  # noqa: ARG002 -- files have none
        """Return the file; `bgr8` and `bgra8` become `rgb8` and `rgba8`, `frame_id` stays behind.

        Raises:
            EncodeError: It is no `Image`, or the file format cannot hold its pixels.
        """
        if not isinstance(message, Image):
            raise EncodeError(
                f"{self.encoding} carries Image, not {type(message).__name__}; use a frame"
            )
        if message.pixel_format not in self._pixel_formats:
            raise EncodeError(
                f"{self.encoding} holds {', '.join(self._pixel_formats)}, not "
                f"{message.pixel_format}; convert the image, or use a frame"
            )
        if not message.pixels.nbytes:
            raise EncodeError(f"{self.encoding} cannot hold an image without pixels; use a frame")
        mode, raw = _RAW[message.pixel_format]
        size = (message.width, message.height)
        file = io.BytesIO()
        try:
            picture = Pillow.frombytes(mode, size, bytes(message.pixels.data), "raw", raw)
            picture.save(file, self._format, **self._options)
        except (OSError, ValueError) as error:
            raise EncodeError(
                f"{self.encoding} cannot hold {size[0]} x {size[1]} pixels: {error}"
            ) from error
        return file.getvalue()

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        """Return the picture as `mono8`, `mono16`, `rgb8` or `rgba8`; raise `DecodeError`."""
        data = bytes(memoryview(payload).cast("B"))
        try:
            return self._read(data), Header()
        except DecodeError:
            raise
        # Pillow has no error of its own: its decoders raise whatever went wrong inside them.
        except Exception as error:
            raise DecodeError(
                f"{len(data)} bytes beginning {data[:4].hex(' ')!r} are no whole {self.encoding}: "
                f"{error}"
            ) from error

    def _read(self, data: bytes) -> Image:
        width, height = self._size(data)
        if not 0 < width * height <= MAX_PIXELS:
            raise DecodeError(
                f"this {self.encoding} claims {width} x {height} pixels; "
                f"at least 1 and at most {MAX_PIXELS} are read"
            )
        with Pillow.open(io.BytesIO(data), formats=(self._format,)) as picture:
            if getattr(picture, "n_frames", 1) != 1:
                raise DecodeError(f"this {self.encoding} is a film; send its pictures singly")
            return _message(picture)

    def _size(self, data: bytes) -> tuple[int, int]:
        """Return the width and height that a file claims; raise if it cannot be whole."""
        raise NotImplementedError


class PngCodec(_FileCodec):
    """`image/png`: `mono8`, `mono16`, `rgb8`, `rgba8`."""

    encoding = "image/png"
    _format = "PNG"
    _pixel_formats = tuple(_RAW)
    _options = {"compress_level": 1}  # noqa: RUF012 -- a constant; streams cannot wait for level 6

    def _size(self, data: bytes) -> tuple[int, int]:
        header, compressed = _png_chunks(data)
        width, height, depth, color, _, _, interlace = struct.unpack(">IIBBBBB", header)
        if depth == 16 and color in (2, 6):
            raise DecodeError("16 bits for each colour would lose half of them here; use 8 bits")
        if width * height <= MAX_PIXELS:
            _check_rows(compressed, width, height, depth * _PNG_CHANNELS[color], interlace)
        return width, height


def _png_chunks(data: bytes) -> tuple[bytes, list[bytes]]:
    """Return the header and the compressed pixels; refuse what is damaged or not whole."""
    if not data.startswith(_PNG):
        raise DecodeError(f"a PNG begins with {_PNG!r}")
    chunks: list[tuple[bytes, bytes]] = []
    offset = len(_PNG)
    while not chunks or chunks[-1][0] != b"IEND":
        length, name = struct.unpack_from(">I4s", data, offset)
        content = data[offset + 8 : offset + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, offset + 8 + length)
        if zlib.crc32(name + content) != checksum:
            raise DecodeError(f"the part {name!r} at byte {offset} of this PNG is damaged")
        chunks.append((name, content))
        offset += 12 + length
    if offset != len(data) or chunks[0][0] != b"IHDR":
        raise DecodeError(f"a PNG goes from IHDR to IEND, this has {len(data) - offset} bytes more")
    return chunks[0][1], [content for name, content in chunks if name == b"IDAT"]


def _check_rows(
    compressed: list[bytes], width: int, height: int, pixel_bits: int, interlace: int
) -> None:
    """Refuse a PNG with too few rows: Pillow would make the others black."""
    passes = _PNG_PASSES if interlace else ((0, 0, 1, 1),)
    needed = 0
    for x, y, step_x, step_y in passes:
        columns, rows = -((x - width) // step_x), -((y - height) // step_y)
        needed += rows * (1 + (columns * pixel_bits + 7) // 8) if columns > 0 and rows > 0 else 0
    inflate = zlib.decompressobj()
    found = 0
    for part in compressed:
        rest = part
        while rest and found < needed:
            found += len(inflate.decompress(rest, 1 << 20))
            rest = inflate.unconsumed_tail
    if found < needed:
        raise DecodeError(f"this PNG has {found} bytes of rows instead of {needed}")


class WebpCodec(_FileCodec):
    """`image/webp`: `rgb8`, `rgba8`."""

    encoding = "image/webp"
    _format = "WEBP"
    _pixel_formats = ("rgb8", "bgr8", "rgba8", "bgra8")
    _options = {"lossless": True, "exact": True, "quality": 0, "method": 0}  # noqa: RUF012

    def _size(self, data: bytes) -> tuple[int, int]:
        riff, length, webp, chunk = struct.unpack_from("<4sI4s4s", data)
        if (riff, webp) != (b"RIFF", b"WEBP") or length + 8 != len(data):
            raise DecodeError(f"a WebP tells its length of {len(data)} bytes at its beginning")
        if chunk == b"VP8X":
            low, high = struct.unpack_from("<IH", data, 24)
            return (low & 0xFFFFFF) + 1, (low >> 24 | high << 8) + 1
        if chunk == b"VP8L":
            (bits,) = struct.unpack_from("<I", data, 21)
            return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        if chunk == b"VP8 ":
            width, height = struct.unpack_from("<HH", data, 26)
            return width & 0x3FFF, height & 0x3FFF
        raise DecodeError(f"a WebP does not begin with a chunk {chunk!r}")


def _message(picture: Pillow.Image) -> Image:
    if picture.mode == "P" or "transparency" in picture.info:
        transparent = "transparency" in picture.info
        picture = picture.convert("RGBA" if transparent else "RGB")
    elif picture.mode in _SIMPLER:
        picture = picture.convert(_SIMPLER[picture.mode])
    pixel_format = _FORMATS.get(picture.mode)
    if pixel_format is None:
        raise DecodeError(f"pictures of Pillow's mode {picture.mode!r} are not read")
    dtype, channels = PIXELS[pixel_format]
    shape = (picture.height, picture.width, *([channels] if channels > 1 else []))
    pixels = Array(picture.tobytes(), dtype, shape)
    return Image(pixels=pixels, pixel_format=pixel_format)  # type: ignore[arg-type]
