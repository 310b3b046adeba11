"""Images and sounds."""

from __future__ import annotations

from array import array
from typing import Final

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import PIXELS, Array, AudioChunk, Image, Message, Native, PixelFormat
from vertebra.yarp import objects
from vertebra.yarp.objects.parts import filled

PIXEL_FORMATS: Final[dict[str, PixelFormat]] = {
    "mono": "mono8",
    "mo16": "mono16",
    "rgb": "rgb8",
    "bgr": "bgr8",
    "rgba": "rgba8",
    "bgra": "bgra8",
    "dec": "depth32f",
    "rggb": "bayer_rggb8",
    "bggr": "bayer_bggr8",
    "grbg": "bayer_grbg8",
    "gbrg": "bayer_gbrg8",
}
"""YARP's pixel codes and ours."""

OTHER_PIXELS: Final = {
    "int": ("<i4", 1),
    "hsv": ("|u1", 3),
    "sign": ("|i1", 1),
    "rgbi": ("<i4", 3),
    "rgb.": ("<f4", 3),
    "gr16": ("<u2", 1),
    "bg16": ("<u2", 1),
    "gb16": ("<u2", 1),
    "rg16": ("<u2", 1),
    "yuva": ("|u1", 1),
    "yuvb": ("|u1", 1),
    "yuvc": ("|u1", 1),
    "yuvd": ("|u1", 1),
}
"""Pixels that no `Image` knows: item type and channels; a `Native` has them as `pixels`."""

_PIXEL_CODES: Final = {ours: theirs for theirs, ours in PIXEL_FORMATS.items()}
_OTHER_IMAGE: Final = {"pixel_code", "pixels"}


def image(yarp: objects.Image) -> Message:
    """Return an image without the padding of its rows."""
    code = yarp.pixel_code
    if code in OTHER_PIXELS:
        pixels = _pixels(yarp, *OTHER_PIXELS[code])
        return Native(value={"pixel_code": code, "pixels": pixels})
    if code not in PIXEL_FORMATS:
        raise DecodeError(
            f"images of pixel code {code!r} have no message; "
            f"known: {', '.join([*PIXEL_FORMATS, *OTHER_PIXELS])}"
        )
    pixel_format = PIXEL_FORMATS[code]
    return Image(pixels=_pixels(yarp, *PIXELS[pixel_format]), pixel_format=pixel_format)


def _pixels(yarp: objects.Image, dtype: str, channels: int) -> Array:
    shape = (yarp.height, yarp.width) + ((channels,) if channels > 1 else ())
    return Array(yarp.packed_pixels(), dtype, shape)


def from_image(message: Image) -> objects.Image:
    """Return an image whose pixels are those of the message, not copied; raise `EncodeError`."""
    code = _PIXEL_CODES.get(message.pixel_format)
    if code is None:
        raise EncodeError(
            f"YARP has no {message.pixel_format} images; it has {', '.join(_PIXEL_CODES)}"
        )
    return objects.Image.from_packed(code, message.width, message.height, message.pixels.data)


def other_image(value: object) -> objects.Image | None:
    """Return what `image` made a `Native` of, None if this is something else."""
    if not isinstance(value, dict) or value.keys() != _OTHER_IMAGE:
        return None
    code, pixels = value["pixel_code"], value["pixels"]
    if code not in OTHER_PIXELS or not isinstance(pixels, Array):
        return None
    dtype, channels = OTHER_PIXELS[code]
    shape = pixels.shape
    if pixels.dtype != dtype or shape[2:] != ((channels,) if channels > 1 else ()):
        raise EncodeError(
            f"pixels of code {code!r} are {dtype!r} in {channels} channels, "
            f"not {pixels.dtype!r} of shape {shape}"
        )
    return objects.Image.from_packed(code, shape[1], shape[0], pixels.data)


def sound(yarp: objects.Sound) -> Message:
    """Return a sound with its channels side by side."""
    if yarp.bytes_per_sample != 2:
        raise DecodeError(
            f"a sound of {8 * yarp.bytes_per_sample} bits has no message, one of 16 bits has"
        )
    if yarp.has_markers:
        raise DecodeError("a sound with markers has no message; its sender can leave them out")
    samples = _transposed(yarp.samples, yarp.channels)
    shape = (len(samples) // yarp.channels, yarp.channels)
    return AudioChunk(samples=Array(samples, "<i2", shape), rate_hz=yarp.frequency_hz)


def from_sound(message: AudioChunk) -> objects.Sound:
    """Return a sound with its channels one after the other."""
    instants, channels = message.samples.shape
    if message.samples.dtype != "<i2":
        raise EncodeError("YARP carries sound in 16 bits, it would lose some of '<f4': send '<i2'")
    if not channels:
        raise EncodeError("a sound without channels has no form in YARP")
    samples = filled(array("h"), message.samples.data)
    return objects.Sound(message.rate_hz, channels, _transposed(samples, instants))


def _transposed(samples: array[int], rows: int) -> array[int]:
    """Return a table of so many rows column by column."""
    if not samples:
        return samples
    columns = len(samples) // rows
    turned = samples[:]
    # One slice for each row or each column, whichever are fewer.
    if rows <= columns:
        for row in range(rows):
            turned[row::rows] = samples[row * columns : (row + 1) * columns]
    else:
        for column in range(columns):
            turned[column * rows : (column + 1) * rows] = samples[column::columns]
    return turned
