"""Backend `haar`: the frontal-face cascade that OpenCV brings along; needs no model at all.

It misses faces that are turned or tilted by more than about 35 degrees, and takes some things for
faces that are none. Use it where no model can be had.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from vertebra.errors import ConfigError
from vertebra.messages import Box
from vertebra_face_tracking.backend import Detection, DetectorOptions, RgbImage
from vertebra_face_tracking.geometry import Floats, require_pixels, weighted_nms

CASCADE: Final = "haarcascade_frontalface_default.xml"
SCORE: Final = 0.8
"""The cascade says yes or no. Of its boxes on 26 portraits, 21 of 24 were faces."""
MAX_SIDE: Final = 480
"""Larger images are shrunk to this first: the time grows with the pixels."""
MIN_NEIGHBOURS: Final = 6
"""Of 189 views of one portrait, 6 finds the face in all and 3 false ones; 3 finds many more."""
SMALLEST_FACE: Final = 0.08
"""Of the shorter side; smaller boxes are mostly texture."""


class Haar:
    """Detector without landmarks and without real scores."""

    name = "haar-frontalface"
    version = f"opencv-{cv2.__version__}"

    def __init__(self, *, min_score: float) -> None:
        self._cascade = cv2.CascadeClassifier(str(Path(cv2.__file__).with_name("data") / CASCADE))
        if self._cascade.empty():
            raise ConfigError(
                f"OpenCV {cv2.__version__} brought no {CASCADE}: "
                "install opencv-python-headless>=4.14,<5"
            )
        self._min_score = min_score

    def detect(self, image: RgbImage) -> list[Detection]:
        """Return all faces; each has the score `SCORE`."""
        require_pixels(image)
        if self._min_score > SCORE:
            return []
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        scale = min(1.0, MAX_SIDE / max(grey.shape))
        if scale < 1:
            grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        smallest = max(20, round(SMALLEST_FACE * min(grey.shape)))
        found = self._cascade.detectMultiScale(
            grey, scaleFactor=1.1, minNeighbors=MIN_NEIGHBOURS, minSize=(smallest, smallest)
        )
        boxes: Floats = np.asarray(found, np.float64).reshape(-1, 4) / scale
        scores = np.full(len(boxes), SCORE)
        merged, _ = weighted_nms(boxes, boxes, scores, min_iou=0.3)
        return [
            Detection(box=Box(x=x, y=y, width=width, height=height), score=SCORE)
            for x, y, width, height in merged.tolist()
        ]


def open_haar(options: DetectorOptions) -> Haar:
    """Open the backend.

    Raises:
        ConfigError: A model was asked for, or OpenCV came without its cascades.
    """
    if options.model:
        raise ConfigError(f"backend 'haar' has no models: leave model empty, not {options.model!r}")
    return Haar(min_score=options.min_score)
