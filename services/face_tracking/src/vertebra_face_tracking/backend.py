"""What a face detector is, and how one is found by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vertebra.errors import ConfigError, VertebraError
from vertebra.messages import Box

ENTRY_POINT_GROUP = "vertebra.face_detectors"

RgbImage = NDArray[np.uint8]
"""An image of shape (height, width, 3), channels red, green, blue."""


class DetectorError(VertebraError):
    """A detector failed on one image; it may do better on the next."""


@dataclass(frozen=True, slots=True)
class Detection:
    """One face in one image.

    Attributes:
        box: Pixels of the image; may reach over its edge.
        score: 0 to 1, as sure as the detector is.
        landmarks: Named points in pixels; left and right are the person's own.
    """

    box: Box
    score: float
    landmarks: dict[str, tuple[float, float]] = field(default_factory=dict)


@runtime_checkable
class Detector(Protocol):
    """A face detector. It is used by one thread at a time."""

    @property
    def name(self) -> str:
        """The model in use, for example `blazeface-full-range`."""

    @property
    def version(self) -> str:
        """Where that model is from, for example `mediapipe-0.10.21`."""

    def detect(self, image: RgbImage) -> list[Detection]:
        """Return all faces, surest first; no two boxes overlap by an IoU above 0.3.

        Raises:
            DecodeError: `image` has no pixels.
        """


@dataclass(frozen=True, slots=True)
class DetectorOptions:
    """What every backend is opened with.

    Attributes:
        model: Name in the model manifest; empty for the backend's default.
        models_directory: Where fetched models lie.
        min_score: Faces below it are not reported.
    """

    model: str
    models_directory: Path
    min_score: float


def open_detector(name: str, options: DetectorOptions) -> Detector:
    """Open the backend that is installed under `name` in `vertebra.face_detectors`.

    Raises:
        ConfigError: No backend or more than one has this name, or it cannot be opened.
    """
    installed = entry_points(group=ENTRY_POINT_GROUP)
    found = installed.select(name=name)
    if len(found) != 1:
        rivals = ", ".join(sorted(point.value for point in found))
        known = ", ".join(sorted(installed.names)) or "none"
        raise ConfigError(
            f"face detector {name!r} is installed more than once: {rivals}; uninstall all but one"
            if found
            else f"there is no face detector {name!r}; installed are: {known}"
        )
    (point,) = found
    opener: Callable[[DetectorOptions], Detector] = point.load()
    return opener(options)
