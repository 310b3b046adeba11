"""Images to JPEG files."""

from __future__ import annotations

import io
from typing import Any, Final

import numpy as np
import PIL.Image

from vertebra.errors import EncodeError
from vertebra.messages import CompressedImage, Image, Message

_RAW_MODES: Final = {
    "mono8": ("L", "L"),
    "rgb8": ("RGB", "RGB"),
    "bgr8": ("RGB", "BGR"),
    "rgba8": ("RGB", "RGBX"),
    "bgra8": ("RGB", "BGRX"),
    "8UC3": ("RGB", "BGR"),
    "8UC4": ("RGB", "BGRX"),
}
"""Mode of the picture and raw mode of the bytes, as Pillow names them."""
_BAYER_COLORS: Final = {
    "bayer_rggb8": "rggb",
    "bayer_bggr8": "bggr",
    "bayer_grbg8": "grbg",
    "bayer_gbrg8": "gbrg",
}
_YUV_BYTES: Final = {
    "uyvy": (1, 0, 2), "yuv422": (1, 0, 2), "yuyv": (0, 1, 3), "yuv422_yuy2": (0, 1, 3),
}  # fmt: skip
"""Where brightness, blue and red of the first of two pixels are among the four bytes of both."""


def to_jpeg(message: Message, quality: int) -> bytes:
    """Return the JPEG file that shows an image; one that is a JPEG already is left as it is.

    Distances and other numbers are scaled to the range they use, and so are grey images of 16 bits;
    of colours of 16 bits the upper half is shown. Bayer images come out at half their size.

    Raises:
        EncodeError: The message is no image that a JPEG can show.
    """
    if isinstance(message, CompressedImage):
        if message.media_type != "image/jpeg":
            raise EncodeError(f"a {message.media_type} is not turned into a JPEG; ask for a frame")
        return bytes(message.data.data)
    if not isinstance(message, Image):
        raise EncodeError(f"{type(message).__name__} is no image; ask for form frame or json")
    if not message.width or not message.height or max(message.width, message.height) > 65535:
        raise EncodeError(f"a JPEG cannot have {message.width} x {message.height} pixels")
    file = io.BytesIO()
    try:
        _picture(message).save(file, "JPEG", quality=quality)
    except (OSError, ValueError, MemoryError) as error:
        raise EncodeError(f"this {message.pixel_format} image has no JPEG: {error}") from error
    return file.getvalue()


def _picture(image: Image) -> PIL.Image.Image:
    pixel_format: str = image.pixel_format
    values = np.asarray(image.pixels)
    if pixel_format.endswith("16") and pixel_format != "mono16":
        pixel_format, values = f"{pixel_format[:-2]}8", (values >> 8).astype(np.uint8)
    modes = _RAW_MODES.get(pixel_format)
    if modes is not None:
        mode, raw_mode = modes
        pixels: Any = values  # Pillow reads any buffer; its types say less
        size = (image.width, image.height)
        return PIL.Image.frombuffer(mode, size, pixels, "raw", raw_mode, 0, 1)
    if pixel_format in _BAYER_COLORS:
        return _half_size(values, _BAYER_COLORS[pixel_format])
    if pixel_format in _YUV_BYTES:
        return _of_yuv(values, *_YUV_BYTES[pixel_format])
    return _scaled(values if values.ndim == 2 else values[..., 0])


def _of_yuv(pixels: np.ndarray[Any, Any], y: int, u: int, v: int) -> PIL.Image.Image:
    if pixels.shape[1] % 2:
        raise EncodeError(f"an image of 4:2:2 has an even width, not {pixels.shape[1]}")
    pairs = pixels.reshape(pixels.shape[0], -1, 4)
    planes = np.empty((*pixels.shape[:2], 3), np.uint8)
    for first in (0, 1):
        planes[:, first::2, 0] = pairs[..., y + 2 * first]
        planes[:, first::2, 1] = pairs[..., u]
        planes[:, first::2, 2] = pairs[..., v]
    return PIL.Image.fromarray(planes, "YCbCr")


def _half_size(pixels: np.ndarray[Any, Any], colors: str) -> PIL.Image.Image:
    if min(pixels.shape) < 2:
        raise EncodeError(f"a Bayer image of shape {pixels.shape} has no whole cell")
    even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
    cell = {0: even[0::2, 0::2], 1: even[0::2, 1::2], 2: even[1::2, 0::2], 3: even[1::2, 1::2]}
    by_color = [cell[colors.index(color)] for color in "rgb"]
    return PIL.Image.fromarray(np.ascontiguousarray(np.stack(by_color, axis=-1)))


def _scaled(pixels: np.ndarray[Any, Any]) -> PIL.Image.Image:
    values = pixels.astype(np.float32)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    spread = max(float(high - low), 1e-9)
    shades = np.where(known, (values - low) / spread * 255.0, 0.0)
    return PIL.Image.fromarray(shades.astype(np.uint8))
