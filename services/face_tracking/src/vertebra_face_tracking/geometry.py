"""Rectangles and points in pixels: letterboxing, overlap, and merging of overlapping boxes.

Boxes are rows `x, y, width, height`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from vertebra.errors import DecodeError
from vertebra_face_tracking.backend import RgbImage

Floats = NDArray[np.float64]


def require_pixels(image: RgbImage) -> None:
    """Refuse anything but a colour image with at least one pixel.

    Raises:
        DecodeError: The shape is not (height, width, 3), or a side is 0.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise DecodeError(
            f"a detector takes uint8 pixels of shape (height, width, 3), "
            f"not {image.dtype} of shape {image.shape}"
        )
    if image.size == 0:
        height, width = image.shape[:2]
        raise DecodeError(f"the image has no pixels: it is {width} x {height}")


@dataclass(frozen=True, slots=True)
class Letterbox:
    """An image scaled into the middle of a square, its aspect kept, the rest black.

    Attributes:
        side: Pixels along each side of the square.
        width: Columns that the scaled image takes.
        height: Rows that it takes.
        scale: Square pixels per image pixel, along x and y (they differ by rounding).
        offset: Upper left corner of the scaled image in the square.
    """

    side: int
    width: int
    height: int
    scale: tuple[float, float]
    offset: tuple[int, int]

    @classmethod
    def fit(cls, *, width: int, height: int, side: int) -> Self:
        """Fit an image of `width` x `height` pixels into a square of `side` pixels."""
        scale = side / max(width, height)
        scaled_width = max(1, round(width * scale))
        scaled_height = max(1, round(height * scale))
        return cls(
            side=side,
            width=scaled_width,
            height=scaled_height,
            scale=(scaled_width / width, scaled_height / height),
            offset=((side - scaled_width) // 2, (side - scaled_height) // 2),
        )

    def render(self, image: RgbImage) -> RgbImage:
        """Return the square, shape (side, side, 3)."""
        shrinks = self.scale[0] < 1
        scaled = cv2.resize(
            image,
            (self.width, self.height),
            # Averaging keeps small faces that plain interpolation would undersample.
            interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR,
        )
        square = np.zeros((self.side, self.side, 3), np.uint8)
        x, y = self.offset
        square[y : y + self.height, x : x + self.width] = scaled
        return square

    def to_square(self, points: Floats) -> Floats:
        """Map points (..., 2) of the image to points of the square."""
        return points * np.array(self.scale, np.float64) + np.array(self.offset, np.float64)

    def to_image(self, points: Floats) -> Floats:
        """Map points (..., 2) of the square to points of the image."""
        return (points - np.array(self.offset, np.float64)) / np.array(self.scale, np.float64)


def iou(a: Floats, b: Floats) -> Floats:
    """Return intersection over union of every box of `a` (N, 4) with every box of `b` (M, 4)."""
    upper_left = np.maximum(a[:, None, :2], b[None, :, :2])
    lower_right = np.minimum((a[:, :2] + a[:, 2:])[:, None], (b[:, :2] + b[:, 2:])[None])
    shared: Floats = np.clip(lower_right - upper_left, 0, None).prod(axis=2)
    union = a[:, 2:].prod(axis=1)[:, None] + b[:, 2:].prod(axis=1)[None] - shared
    shares: Floats = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
    return shares


def weighted_nms(
    boxes: Floats, values: Floats, scores: Floats, *, min_iou: float
) -> tuple[Floats, Floats]:
    """Merge boxes that lie on the same thing.

    The surest box takes all that overlap it by more than `min_iou`; their `values` (N, K) are
    averaged with their scores as weights, its score is kept. Then the surest of the rest, and so
    on.

    Returns:
        The merged values (M, K) and their scores (M,), surest first.
    """
    order = np.argsort(-scores, kind="stable")
    boxes, values, scores = boxes[order], values[order], scores[order]
    merged: list[Floats] = []
    kept: list[float] = []
    while len(scores):
        same = iou(boxes[:1], boxes)[0] > min_iou
        same[0] = True
        merged.append(np.average(values[same], axis=0, weights=scores[same]))
        kept.append(scores[0])
        boxes, values, scores = boxes[~same], values[~same], scores[~same]
    return np.array(merged).reshape(len(merged), values.shape[1]), np.array(kept)
