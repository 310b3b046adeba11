"""Camera images and sound."""

from __future__ import annotations

from typing import Final, Literal

from vertebra.messages.array import Array
from vertebra.messages.message import Message

PixelFormat = Literal[
    "mono8", "mono16", "depth32f",
    "rgb8", "bgr8", "rgba8", "bgra8", "rgb16", "bgr16", "rgba16", "bgra16",
    "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8",
    "bayer_rggb16", "bayer_bggr16", "bayer_grbg16", "bayer_gbrg16",
    "uyvy", "yuyv", "yuv422", "yuv422_yuy2",
    "8UC1", "8UC2", "8UC3", "8UC4", "8SC1", "8SC2", "8SC3", "8SC4",
    "16UC1", "16UC2", "16UC3", "16UC4", "16SC1", "16SC2", "16SC3", "16SC4",
    "32SC1", "32SC2", "32SC3", "32SC4", "32FC2", "32FC3", "32FC4",
    "64FC1", "64FC2", "64FC3", "64FC4",
]  # fmt: skip
"""Names of pixel layouts, as ROS `Image.encoding` has them; `depth32f` is metres in float32.

`8UC1` to `64FC4` are numbers that are no colours, such as distances in millimetres (`16UC1`).
`uyvy` (also called `yuv422`) and `yuyv` (`yuv422_yuy2`) have one colour for two pixels.
"""

_NUMBERS: Final = {
    "8U": "|u1", "8S": "|i1", "16U": "<u2", "16S": "<i2", "32S": "<i4", "32F": "<f4", "64F": "<f8",
}  # fmt: skip
PIXELS: Final[dict[str, tuple[str, int]]] = {
    "mono8": ("|u1", 1),
    "mono16": ("<u2", 1),
    "depth32f": ("<f4", 1),
    "rgb8": ("|u1", 3),
    "bgr8": ("|u1", 3),
    "rgba8": ("|u1", 4),
    "bgra8": ("|u1", 4),
    "rgb16": ("<u2", 3),
    "bgr16": ("<u2", 3),
    "rgba16": ("<u2", 4),
    "bgra16": ("<u2", 4),
    "bayer_rggb8": ("|u1", 1),
    "bayer_bggr8": ("|u1", 1),
    "bayer_grbg8": ("|u1", 1),
    "bayer_gbrg8": ("|u1", 1),
    "bayer_rggb16": ("<u2", 1),
    "bayer_bggr16": ("<u2", 1),
    "bayer_grbg16": ("<u2", 1),
    "bayer_gbrg16": ("<u2", 1),
    "uyvy": ("|u1", 2),
    "yuyv": ("|u1", 2),
    "yuv422": ("|u1", 2),
    "yuv422_yuy2": ("|u1", 2),
    **{
        f"{kind}C{count}": (dtype, count)
        for kind, dtype in _NUMBERS.items()
        for count in range(1, 5)
        if (kind, count) != ("32F", 1)  # depth32f
    },
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
        format: What its encoder calls it, such as `rgb8; jpeg compressed bgr8` of ROS.
    """

    data: Array
    media_type: str
    frame_id: str = ""
    format: str = ""


class AudioChunk(Message, frozen=True, kw_only=True):
    """A piece of sound.

    Attributes:
        samples: Shape (instants, channels), type `<i2` (full scale 32767) or `<f4` (full scale 1).
        rate_hz: Instants per second.
        frame_id: Coordinate frame of the microphone.
    """

    samples: Array
    rate_hz: int
    frame_id: str = ""

    def __post_init__(self) -> None:
        if len(self.samples.shape) != 2 or self.samples.dtype not in ("<i2", "<f4"):
            raise ValueError(
                "samples are '<i2' or '<f4' of shape (instants, channels), "
                f"not {self.samples.dtype!r} of shape {self.samples.shape}"
            )
