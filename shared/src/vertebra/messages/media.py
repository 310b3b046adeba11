"""Camera images and sound."""

from __future__ import annotations

from typing import Final, Literal

from vertebra.messages.array import Array
from vertebra.messages.message import Message

PixelFormat = Literal[
    "mono8", "mono16", "rgb8", "bgr8", "rgba8", "bgra8", "depth32f",
    "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8",
]  # fmt: skip
"""Names of pixel layouts, as ROS `Image.encoding` has them; `depth32f` is metres in float32."""

PIXELS: Final[dict[str, tuple[str, int]]] = {
    "mono8": ("|u1", 1),
    "mono16": ("<u2", 1),
    "rgb8": ("|u1", 3),
    "bgr8": ("|u1", 3),
    "rgba8": ("|u1", 4),
    "bgra8": ("|u1", 4),
    "depth32f": ("<f4", 1),
    "bayer_rggb8": ("|u1", 1),
    "bayer_bggr8": ("|u1", 1),
    "bayer_grbg8": ("|u1", 1),
    "bayer_gbrg8": ("|u1", 1),
}
"""Item type and channels of each pixel format."""


class Image(Message, frozen=True, kw_only=True):
    """An uncompressed camera image.

    Attributes:
        pixels: Shape (height, width) for one channel, (height, width, channels) otherwise.
        pixel_format: Layout of a pixel; see `PIXELS`.
        frame_id: Coordinate frame of the camera.
    """

    pixels: Array
    pixel_format: PixelFormat
    frame_id: str = ""

    def __post_init__(self) -> None:
        dtype, channels = PIXELS[self.pixel_format]
        shape = self.pixels.shape
        fits = len(shape) == 2 if channels == 1 else len(shape) == 3 and shape[2] == channels
        if self.pixels.dtype != dtype or not fits:
            wanted = "(height, width)" if channels == 1 else f"(height, width, {channels})"
            raise ValueError(
                f"{self.pixel_format} pixels are {dtype!r} of shape {wanted}, "
                f"not {self.pixels.dtype!r} of shape {shape}"
            )

    @property
    def height(self) -> int:
        """Rows."""
        return self.pixels.shape[0]

    @property
    def width(self) -> int:
        """Columns."""
        return self.pixels.shape[1]


class CompressedImage(Message, frozen=True, kw_only=True):
    """A compressed camera image, as it came from its encoder.

    Attributes:
        data: The bytes of the file, type `|u1`.
        media_type: For example `image/jpeg`.
        frame_id: Coordinate frame of the camera.
    """

    data: Array
    media_type: str
    frame_id: str = ""


class AudioChunk(Message, frozen=True, kw_only=True):
    """A piece of sound.

    Attributes:
        samples: Shape (instants, channels), type `<i2` (full scale 32767) or `<f4` (full scale 1).
        rate_hz: Instants per second.
    """

    samples: Array
    rate_hz: int

    def __post_init__(self) -> None:
        if len(self.samples.shape) != 2 or self.samples.dtype not in ("<i2", "<f4"):
            raise ValueError(
                "samples are '<i2' or '<f4' of shape (instants, channels), "
                f"not {self.samples.dtype!r} of shape {self.samples.shape}"
            )
