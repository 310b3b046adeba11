"""Images of YARP as JPEGs, for the carrier mjpeg."""

from __future__ import annotations

import io
from typing import Any, Final

from PIL import Image as Pillow
from typing_extensions import Buffer

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.objects import Image
from vertebra_pillow.files import MAX_PIXELS

# What Pillow calls the pixels: the mode that a JPEG can hold, and how the bytes lie.
_RAW: Final = {
    "mono": ("L", "L"),
    "mo16": ("L", "L;16"),
    "rgb": ("RGB", "RGB"),
    "bgr": ("RGB", "BGR"),
    "rgba": ("RGB", "RGBX"),
    "bgra": ("RGB", "BGRX"),
}
_CODES: Final = {"L": "mono", "RGB": "rgb"}


class YarpJpeg:
    """A `vertebra.yarp.JpegCodec`; transparency and the lower half of 16 bits are left out."""

    def encode(self, payload: Buffer) -> bytes:
        """Return a serialised yarp/image as a JPEG, of the quality that YARP chooses.

        Raises:
            CodecError: It is no image, or one of pixels that JPEG does not know.
        """
        image = Image.decode(memoryview(payload).cast("B"))
        if image.pixel_code not in _RAW:
            raise EncodeError(
                f"a JPEG holds {', '.join(_RAW)}, not {image.pixel_code!r}; read it by tcp instead"
            )
        mode, raw = _RAW[image.pixel_code]
        size = (image.width, image.height)
        file = io.BytesIO()
        try:
            pixels: Any = image.pixels  # every buffer will do, whatever the stubs say
            picture = Pillow.frombuffer(mode, size, pixels, "raw", raw, image.row_bytes, 1)
            picture.save(file, "JPEG")
        except (OSError, ValueError) as error:
            raise EncodeError(f"no JPEG of {size[0]} x {size[1]} pixels: {error}") from error
        return file.getvalue()

    def decode(self, jpeg: Buffer) -> bytes:
        """Return a JPEG as a serialised yarp/image of pixels `rgb` or `mono`.

        Raises:
            DecodeError: It is damaged, or too large.
        """
        data = bytes(memoryview(jpeg).cast("B"))
        try:
            return self._read(data)
        except DecodeError:
            raise
        # Pillow has no error of its own: its decoders raise whatever went wrong inside them.
        except Exception as error:
            raise DecodeError(f"{len(data)} bytes are no whole JPEG: {error}") from error

    def _read(self, data: bytes) -> bytes:
        with Pillow.open(io.BytesIO(data), formats=("JPEG",)) as picture:
            width, height = picture.size
            if width * height > MAX_PIXELS:
                raise DecodeError(f"a JPEG of {width} x {height} pixels; {MAX_PIXELS} can be")
            simple = picture if picture.mode in _CODES else picture.convert("RGB")
            pixels = simple.tobytes()
        return Image.from_packed(_CODES[simple.mode], width, height, pixels).encode()
