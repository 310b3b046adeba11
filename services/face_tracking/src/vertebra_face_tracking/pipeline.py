"""From an image to the faces in it; no I/O, no clock."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from vertebra.errors import DecodeError, VertebraError
from vertebra.messages import Face, Faces, Image
from vertebra_face_tracking.backend import Detector, DetectorError, RgbImage
from vertebra_face_tracking.tracker import TrackedFace, Tracker

_TO_RGB: Final = {
    "mono8": cv2.COLOR_GRAY2RGB,
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2RGB,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "8UC1": cv2.COLOR_GRAY2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
}


def find_faces(image: Image, captured_ns: int, detector: Detector, tracker: Tracker) -> Faces:
    """Return the faces in the next image of a camera, known ones under their ids.

    Raises:
        DecodeError: The image has no pixels or no colours.
        DetectorError: The detector failed; the tracker has not seen this image.
    """
    pixels = to_rgb(image)
    try:
        detections = detector.detect(pixels)
    except VertebraError:
        raise
    except Exception as error:  # a backend is anybody's code: its bug is no reason to stop
        raise DetectorError(f"detector {detector.name} failed: {error!r}") from error
    return Faces(
        faces=tuple(_face(tracked) for tracked in tracker.update(detections, captured_ns)),
        image_width=image.width,
        image_height=image.height,
        backend=f"{detector.name} ({detector.version})",
        frame_id=image.frame_id,
    )


def to_rgb(image: Image) -> RgbImage:
    """Return the pixels as a detector wants them; RGB images are not copied.

    Grey images of 16 bits are stretched to their own range, since few cameras use all bits.

    Raises:
        DecodeError: The image has no pixels or no colours.
    """
    pixels = np.asarray(image.pixels)
    if pixels.size == 0:
        raise DecodeError(f"the image has no pixels: it is {image.width} x {image.height}")
    pixel_format: str = image.pixel_format
    if pixel_format == "mono16":
        lowest, highest = int(pixels.min()), int(pixels.max())
        stretched = (pixels - lowest) * (255 / max(1, highest - lowest))
        return np.dstack([stretched.astype(np.uint8)] * 3)
    if pixel_format.endswith("16"):
        pixels, pixel_format = (pixels >> 8).astype(np.uint8), f"{pixel_format[:-2]}8"
    if pixel_format == "rgb8":
        return pixels
    if pixel_format not in _TO_RGB:
        raise DecodeError(
            f"a {image.pixel_format} image has no colours to find faces in; use the colour image"
        )
    return np.asarray(cv2.cvtColor(pixels, _TO_RGB[pixel_format]), np.uint8)


def _face(tracked: TrackedFace) -> Face:
    detection = tracked.detection
    return Face(
        track_id=tracked.track_id,
        box=detection.box,
        score=detection.score,
        landmarks=detection.landmarks,
        age_s=tracked.age_s,
    )
