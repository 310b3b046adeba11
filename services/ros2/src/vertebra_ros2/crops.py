"""Faces cut out of the images that they were found in."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from vertebra.errors import EncodeError
from vertebra.messages import Array, Box, Image

SIDE: Final = 128
"""Pixels along each side of a cropped face, as ROS4HRI has it by default."""
KEPT: Final = 8
"""So many images wait for the faces that are found in them."""
_CHANNELS: Final = {
    "mono8": (0, 0, 0),
    "rgb8": (2, 1, 0), "bgr8": (0, 1, 2), "rgba8": (2, 1, 0), "bgra8": (0, 1, 2),
}  # fmt: skip
"""Where blue, green and red are: `libhri` takes cropped faces for BGR, whatever they say."""


class Crops:
    """The newest images of a camera, by when they were taken."""

    def __init__(self) -> None:
        self._images: OrderedDict[int, Image] = OrderedDict()

    def keep(self, image: Image, captured_ns: int) -> None:
        """Keep an image until the faces in it come.

        Raises:
            EncodeError: It has no colours of 8 bits.
        """
        if image.pixel_format not in _CHANNELS:
            raise EncodeError(
                f"faces are not cropped out of {image.pixel_format} images, "
                f"only of {', '.join(_CHANNELS)}"
            )
        self._images[captured_ns] = image
        while len(self._images) > KEPT:
            self._images.popitem(last=False)

    def of(self, captured_ns: int) -> Callable[[Box, str], Image] | None:
        """Return what cuts out of the image of this moment; None if it is not here."""
        image = self._images.get(captured_ns)
        if image is None:
            return None
        return lambda box, frame_id: cropped(image, box, frame_id)


def cropped(image: Image, box: Box, frame_id: str) -> Image:
    """Return the part of a box that is in the image, scaled into a black square; `bgr8`.

    Raises:
        EncodeError: The box is nowhere.
    """
    corners = (box.x, box.y, box.x + box.width, box.y + box.height)
    if not all(map(math.isfinite, corners)):
        raise EncodeError(f"a face is nowhere: {box}")
    left, top, right, bottom = (max(round(corner), 0) for corner in corners)
    pixels = np.asarray(image.pixels).reshape(image.height, image.width, -1)
    part = pixels[top:bottom, left:right, _CHANNELS[image.pixel_format]]
    square = np.zeros((SIDE, SIDE, 3), np.uint8)
    height, width = part.shape[:2]
    if height and width:
        scale = SIDE / max(height, width)
        scaled = _scaled(part, max(round(height * scale), 1), max(round(width * scale), 1))
        y, x = (SIDE - scaled.shape[0]) // 2, (SIDE - scaled.shape[1]) // 2
        square[y : y + scaled.shape[0], x : x + scaled.shape[1]] = scaled
    return Image(pixels=Array.of(square.data), pixel_format="bgr8", frame_id=frame_id)


def _scaled(pixels: np.ndarray[Any, Any], height: int, width: int) -> np.ndarray[Any, Any]:
    """Scale an image; each new pixel is blended of the four around its place."""
    above, below, down = _places(pixels.shape[0], height)
    rows = pixels[above] * (1 - down)[:, None, None] + pixels[below] * down[:, None, None]
    left, right, along = _places(pixels.shape[1], width)
    blended = rows[:, left] * (1 - along)[None, :, None] + rows[:, right] * along[None, :, None]
    return np.asarray(blended + 0.5, np.uint8)


def _places(old: int, new: int) -> tuple[Any, Any, Any]:
    places = np.clip((np.arange(new) + 0.5) * (old / new) - 0.5, 0, old - 1)
    before = places.astype(int)
    return before, np.minimum(before + 1, old - 1), places - before
