"""Pillow images in their packed form.

A map: `mode`; `size` (width, height); `pixels`, an `Array` of shape (height, width) or (height,
width, channels), of packed rows for mode `1`; `palette` and `palette_mode` for modes `P` and `PA`;
`transparency` (a number, numbers or bytes) for images that declare a colour transparent.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from PIL import Image as Pillow

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array

# Item type and channels by mode.
_MODES: Final = {
    "1": ("|u1", 1),
    "L": ("|u1", 1),
    "LA": ("|u1", 2),
    "La": ("|u1", 2),
    "P": ("|u1", 1),
    "PA": ("|u1", 2),
    "RGB": ("|u1", 3),
    "RGBA": ("|u1", 4),
    "RGBa": ("|u1", 4),
    "RGBX": ("|u1", 4),
    "CMYK": ("|u1", 4),
    "YCbCr": ("|u1", 3),
    "LAB": ("|u1", 3),
    "HSV": ("|u1", 3),
    "I;16": ("<u2", 1),
    "I;16B": (">u2", 1),
    "I": ("<i4", 1),
    "F": ("<f4", 1),
}
_WITH_PALETTE: Final = ("P", "PA")
_PALETTE_CHANNELS: Final = {"RGB": 3, "RGBA": 4}


class ImageCodec:
    """`PIL.Image.Image`, images that were opened from files included."""

    def pack(self, value: Pillow.Image) -> dict[str, Any]:
        """Return the image in its packed form.

        Raises:
            EncodeError: It is a film, its mode has no plain form, or its file cannot be read.
        """
        if getattr(value, "n_frames", 1) != 1:
            raise EncodeError("this image is a film; send image.copy() of the frame that is meant")
        if value.mode not in _MODES:
            raise EncodeError(
                f"images of mode {value.mode!r} cannot be sent; "
                f"convert it to one of {', '.join(_MODES)}"
            )
        try:
            pixels = value.tobytes()
        except (OSError, SyntaxError, ValueError) as error:
            raise EncodeError(f"the file of this image cannot be read: {error}") from error
        dtype, shape = _layout(value.mode, value.size)
        packed: dict[str, Any] = {
            "mode": value.mode,
            "size": list(value.size),
            "pixels": Array(pixels, dtype, shape),
        }
        if value.mode in _WITH_PALETTE and value.palette is not None:
            packed["palette_mode"] = value.palette.mode
            packed["palette"] = value.palette.tobytes()
        if "transparency" in value.info:
            packed["transparency"] = value.info["transparency"]
        return packed

    def unpack(self, plain: Any) -> Pillow.Image:
        """Return the image; raise `DecodeError` if `plain` is not what `pack` makes."""
        match plain:
            case {
                "mode": str() as mode,
                "size": [int() as width, int() as height],
                "pixels": Array() as pixels,
                **extra,
            } if mode in _MODES and extra.keys() <= {"palette", "palette_mode", "transparency"}:
                if (pixels.dtype, pixels.shape) != _layout(mode, (width, height)):
                    raise DecodeError(f"{pixels!r} is no {mode} image of {width} x {height}")
                try:
                    return _image(mode, (width, height), pixels, extra)
                except (TypeError, ValueError, OverflowError, MemoryError) as error:
                    raise DecodeError(f"this is no packed Pillow image: {error}") from error
        raise DecodeError(f"this is no packed Pillow image: {plain!r:.100}")


def _layout(mode: str, size: tuple[int, int]) -> tuple[str, tuple[int, ...]]:
    width, height = size
    dtype, channels = _MODES[mode]
    if mode == "1":
        return dtype, (height, (width + 7) // 8)
    return dtype, (height, width, channels) if channels > 1 else (height, width)


def _image(
    mode: str, size: tuple[int, int], pixels: Array, extra: Mapping[Any, Any]
) -> Pillow.Image:
    empty = 0 in size
    image = Pillow.new(mode, size) if empty else Pillow.frombytes(mode, size, bytes(pixels.data))
    if "palette" in extra or "palette_mode" in extra:
        palette = extra.get("palette")
        palette_mode = str(extra.get("palette_mode"))
        channels = _PALETTE_CHANNELS.get(palette_mode)
        if mode not in _WITH_PALETTE or channels is None or not isinstance(palette, bytes):
            raise ValueError(f"a {mode} image has no palette of mode {palette_mode!r}")
        if len(palette) % channels or len(palette) > 256 * channels:
            raise ValueError(f"{len(palette)} bytes are no palette of mode {palette_mode}")
        image.putpalette(palette, palette_mode)
    if "transparency" in extra:
        image.info["transparency"] = _transparency(extra["transparency"])
    return image


def _transparency(value: Any) -> int | bytes | tuple[int, ...]:
    match value:
        case bool():
            pass
        case int() | bytes():
            return value
        case [int() as red, int() as green, int() as blue]:
            return (red, green, blue)
    raise ValueError(f"no colour is {value!r:.100}")
