"""Pictures: a header of 60 bytes, then rows that are padded to a multiple of 8 bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.objects.parts import YarpObject, damage, pack
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import BLOB, INT32, LIST, VOCAB32, Dialect

PIXEL_BYTES: Final = {
    "mono": 1,
    "mo16": 2,
    "rgb": 3,
    "rgba": 4,
    "bgra": 4,
    "int": 4,
    "hsv": 3,
    "bgr": 3,
    "sign": 1,
    "rgb-": 3,
    "rgbi": 12,
    "dec": 4,
    "rgb.": 12,
    "hsv.": 12,
    "grbg": 1,
    "bggr": 1,
    "gbrg": 1,
    "rggb": 1,
    "gr16": 2,
    "bg16": 2,
    "gb16": 2,
    "rg16": 2,
    "yuva": 1,
    "yuvb": 1,
    "yuvc": 1,
    "yuvd": 1,
}
"""Bytes of one pixel, by pixel code."""

_UNSENDABLE_PIXELS: Final = frozenset({"rgb-", "hsv."})
"""The C++ library crashes when it allocates an image of these."""

DEFAULT_QUANTUM: Final = 8

_IMAGE: Final = struct.Struct("<ii i4s i4s ii ii HH ii ii")
_MAT: Final = b"mat\0"
_IMAGE_FRAME: Final = (LIST, 4, VOCAB32, _MAT, VOCAB32, LIST + INT32, 5, BLOB)


def row_bytes(width: int, pixel_bytes: int, quantum: int) -> int:
    """Return the length of a row whose end is padded to a multiple of `quantum` bytes."""
    size = width * pixel_bytes
    return size + -size % quantum if quantum > 1 else size


@dataclass(frozen=True, slots=True)
class Image(YarpObject):
    """A picture with padded rows.

    Attributes:
        pixel_code: One of `PIXEL_BYTES`, or empty for an image without pixels.
        width: Pixels of a row.
        height: Number of rows.
        pixels: The rows one after the other, each `row_bytes` long.
        quantum: Each row is padded to a multiple of so many bytes.
    """

    pixel_code: str
    width: int
    height: int
    pixels: Buffer
    quantum: int = DEFAULT_QUANTUM

    @classmethod
    def from_packed(cls, pixel_code: str, width: int, height: int, pixels: Buffer) -> Self:
        """Return the image of rows without padding, without copying them.

        The quantum is YARP's usual 8 where rows happen to be such multiples, else 1.
        """
        quantum = 1 if width * PIXEL_BYTES.get(pixel_code, 0) % DEFAULT_QUANTUM else DEFAULT_QUANTUM
        return cls(pixel_code, width, height, pixels, quantum)

    @property
    def row_bytes(self) -> int:
        """The length of a row, padding included."""
        return row_bytes(self.width, PIXEL_BYTES.get(self.pixel_code, 0), self.quantum)

    def packed_pixels(self) -> Buffer:
        """Return the rows without their padding; copied only where there is some."""
        padded, size = self.row_bytes, self.width * PIXEL_BYTES.get(self.pixel_code, 0)
        if padded == size:
            return self.pixels
        pixels = memoryview(self.pixels)
        return b"".join([pixels[begin : begin + size] for begin in range(0, len(pixels), padded)])

    def encode_parts(self, dialect: Dialect = Dialect.V3) -> list[Buffer]:  # noqa: ARG002 -- like the others
        """Return header and pixels, to be sent one after the other; the pixels are not copied.

        The bytes are the same in both dialects. The word of the quantum has no flags in its upper
        half: YARP 3 does not miss them and YARP 4 would take them for part of the number.

        Raises:
            EncodeError: The size of `pixels` is not what the other fields say, or the pixel code
                is unknown or one that crashes the C++ library.
        """
        depth = PIXEL_BYTES.get(self.pixel_code, 0)
        if self.pixel_code in _UNSENDABLE_PIXELS or (self.pixel_code and not depth):
            raise EncodeError(
                f"images of pixel code {self.pixel_code!r} cannot be sent: "
                f"use one of {', '.join(sorted(PIXEL_BYTES.keys() - _UNSENDABLE_PIXELS))}"
            )
        size = self.row_bytes * self.height
        given = memoryview(self.pixels).nbytes
        if self.width < 0 or self.height < 0 or given != size:
            raise EncodeError(
                f"{self.width} x {self.height} {self.pixel_code!r} pixels with rows of "
                f"{self.row_bytes} bytes are {size} bytes, not {given}"
            )
        code = self.pixel_code.encode("ascii")
        header = pack(
            "image", _IMAGE, LIST, 4, VOCAB32, _MAT, VOCAB32, code, LIST + INT32, 5, depth, size,
            self.quantum, 0, self.width, self.height, BLOB, size,
        )  # fmt: skip
        return [header, self.pixels]

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:  # noqa: ARG003
        """Return the image in `payload`; its pixels are a view of that buffer.

        Raises:
            DecodeError: It holds none, or one of unknown pixel code or of contradictory sizes.
        """
        if len(payload) < _IMAGE.size:
            raise damage(
                "image", f"{len(payload)} bytes are fewer than its header of {_IMAGE.size}"
            )
        (
            list_tag, fields_, mat_tag, mat, code_tag, code, sizes_tag, sizes,
            depth, size, quantum, _top_is_low, width, height, blob_tag, blob_size,
        ) = _IMAGE.unpack_from(payload)  # fmt: skip
        if (list_tag, fields_, mat_tag, mat, code_tag, sizes_tag, sizes, blob_tag) != _IMAGE_FRAME:
            raise damage("image", "its header has another form")
        pixel_code = code.rstrip(b"\0").decode("latin-1")
        if pixel_code and pixel_code not in PIXEL_BYTES:
            raise damage("image", f"unknown pixel code {pixel_code!r}")
        if depth != PIXEL_BYTES.get(pixel_code, 0):
            raise damage("image", f"{depth} bytes per pixel of code {pixel_code!r}")
        pixels = memoryview(payload)[_IMAGE.size :]
        expected = row_bytes(width, depth, quantum) * height
        if width < 0 or height < 0 or not size == blob_size == expected == len(pixels):
            raise damage(
                "image",
                f"{width} x {height} {pixel_code!r} pixels with rows padded to {quantum} are "
                f"{expected} bytes; it announces {size} and {blob_size}, and has {len(pixels)}",
            )
        return cls(pixel_code, width, height, pixels, quantum)
