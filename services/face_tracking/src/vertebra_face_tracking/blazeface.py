"""Backend `blazeface`: MediaPipe's BlazeFace networks, run by LiteRT.

The network looks at a square image. Each of its anchors (points on one or more grids) says how
sure it is that a face is there, and gives the face's centre, size and six landmarks in pixels
relative to itself. Facts from MediaPipe's public graph `face_detection.pbtxt`; the code is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from vertebra.errors import ConfigError
from vertebra.messages import Box
from vertebra_face_tracking.backend import Detection, DetectorOptions, RgbImage
from vertebra_face_tracking.geometry import Floats, Letterbox, require_pixels, weighted_nms
from vertebra_face_tracking.model import LiteRtModel, Tensor
from vertebra_face_tracking.models import load_model, read_manifest

LANDMARKS: Final = ("right_eye", "left_eye", "nose_tip", "mouth_centre", "right_ear", "left_ear")
POINTS: Final = 2 + len(LANDMARKS)
"""What an anchor gives: centre, size, landmarks; each is a pair."""
MERGE_IOU: Final = 0.3


@dataclass(frozen=True, slots=True)
class Network:
    """The form of one network.

    Attributes:
        side: Pixels along each side of the square that it sees.
        grids: Per grid of anchors: pixels between its points, and anchors on each point.
    """

    side: int
    grids: tuple[tuple[int, int], ...]


NETWORKS: Final = {
    "blazeface-full-range": Network(side=192, grids=((4, 1),)),
    "blazeface-short-range": Network(side=128, grids=((8, 2), (16, 6))),
}
DEFAULT_MODEL: Final = "blazeface-full-range"
"""Finds faces half as large as the short-range network does; see the README."""


def anchors(network: Network) -> Floats:
    """Return the anchor points in pixels of the square, shape (anchors, 2), row by row."""
    points = []
    for stride, per_point in network.grids:
        along = (np.arange(network.side // stride) + 0.5) * stride
        grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        points.append(np.repeat(grid, per_point, axis=0))
    return np.concatenate(points)


def decode(
    regressors: Tensor, logits: Tensor, anchor_points: Floats, *, min_score: float
) -> tuple[Floats, Floats]:
    """Turn the network's outputs into faces in pixels of the square.

    Args:
        regressors: Shape (anchors, 16).
        logits: Shape (anchors,).
        anchor_points: What `anchors` returned.
        min_score: Anchors less sure than this are left out.

    Returns:
        Points (faces, 8, 2): upper left corner, size, landmarks; and scores (faces,), surest first.
    """
    scores = 1 / (1 + np.exp(-np.clip(logits.astype(np.float64), -100, 100)))
    points = regressors.astype(np.float64).reshape(-1, POINTS, 2)
    sane = np.isfinite(points).all(axis=(1, 2)) & (points[:, 1] > 0).all(axis=1)
    chosen = (scores >= min_score) & sane
    points, scores = points[chosen], scores[chosen]
    points[:, 0] += anchor_points[chosen] - points[:, 1] / 2
    points[:, 2:] += anchor_points[chosen][:, None]
    flat = points.reshape(-1, POINTS * 2)
    merged, kept = weighted_nms(flat[:, :4], flat, scores, min_iou=MERGE_IOU)
    return merged.reshape(-1, POINTS, 2), kept


class BlazeFace:
    """Detector with six landmarks per face."""

    def __init__(self, model: str, content: bytes, *, version: str, min_score: float) -> None:
        network = NETWORKS[model]
        self.name = model
        self.version = version
        self._anchors = anchors(network)
        self._side = network.side
        self._min_score = min_score
        count = len(self._anchors)
        self._model = LiteRtModel(
            content,
            name=model,
            input_shape=(1, network.side, network.side, 3),
            output_shapes=((1, count, 2 * POINTS), (1, count, 1)),
        )

    def detect(self, image: RgbImage) -> list[Detection]:
        """Return all faces, surest first."""
        require_pixels(image)
        height, width = image.shape[:2]
        letterbox = Letterbox.fit(width=width, height=height, side=self._side)
        square = letterbox.render(image).astype(np.float32) / 127.5 - 1
        regressors, logits = self._model.run(square[None])
        faces, scores = decode(
            regressors[0], logits[0, :, 0], self._anchors, min_score=self._min_score
        )
        return [_detection(letterbox, *face) for face in zip(faces, scores, strict=True)]


def _detection(letterbox: Letterbox, face: Floats, score: float) -> Detection:
    x, y = letterbox.to_image(face[0]).tolist()
    width, height = (face[1] / np.array(letterbox.scale)).tolist()
    points = letterbox.to_image(face[2:]).tolist()
    return Detection(
        box=Box(x=x, y=y, width=width, height=height),
        score=float(score),
        landmarks={name: (px, py) for name, (px, py) in zip(LANDMARKS, points, strict=True)},
    )


def open_blazeface(options: DetectorOptions) -> BlazeFace:
    """Open the backend with a model that was fetched before.

    Raises:
        ModelMissingError: The model must be fetched first.
        ConfigError: There is no such model.
    """
    model = options.model or DEFAULT_MODEL
    if model not in NETWORKS:
        known = ", ".join(sorted(NETWORKS))
        raise ConfigError(f"backend 'blazeface' has no model {model!r}; it has: {known}")
    manifest = read_manifest()
    content = load_model(model, options.models_directory, manifest)
    origin = manifest.model(model).wheel
    return BlazeFace(model, content, version=origin, min_score=options.min_score)
