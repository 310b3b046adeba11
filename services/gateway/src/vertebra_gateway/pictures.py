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
}
"""Mode of the picture and raw mode of the bytes, as Pillow names them."""
_BAYER_COLORS: Final = {
    "bayer_rggb8": "rggb",
    "bayer_bggr8": "bggr",
    "bayer_grbg8": "grbg",
    "bayer_gbrg8": "gbrg",
}


def to_jpeg(message: Message, quality: int) -> bytes:
    """Return the JPEG file that shows an image; one that is a JPEG already is left as it is.

    Distances and 16-bit images are scaled to the range they use; Bayer images come out at half
    their size.

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
    size = (image.width, image.height)
    modes = _RAW_MODES.get(image.pixel_format)
    if modes is not None:
        mode, raw_mode = modes
        pixels: Any = image.pixels.data  # Pillow reads any buffer; its types say less
        return PIL.Image.frombuffer(mode, size, pixels, "raw", raw_mode, 0, 1)
    values = np.asarray(image.pixels)
    colors = _BAYER_COLORS.get(image.pixel_format)
    if colors is not None:
        return _half_size(values, colors)
    return _scaled(values)


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
