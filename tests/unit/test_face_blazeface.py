"""Anchors and decoding of BlazeFace, without its model."""

from __future__ import annotations

import numpy as np
import pytest

from vertebra.errors import ConfigError
from vertebra_face_tracking.blazeface import NETWORKS, BlazeFace, anchors, decode
from vertebra_face_tracking.model import Tensor

FULL = NETWORKS["blazeface-full-range"]
SHORT = NETWORKS["blazeface-short-range"]


def test_the_full_range_network_has_one_anchor_on_each_point_of_one_grid() -> None:
    points = anchors(FULL)

    assert points.shape == (2304, 2)
    assert points[0].tolist() == [2, 2]
    assert points[1].tolist() == [6, 2]  # row by row
    assert points[-1].tolist() == [190, 190]


def test_the_short_range_network_has_two_grids() -> None:
    points = anchors(SHORT)

    assert points.shape == (896, 2)
    assert points[:3].tolist() == [[4, 4], [4, 4], [12, 4]]
    assert points[512:519].tolist() == [[8, 8]] * 6 + [[24, 8]]
    assert points[-1].tolist() == [120, 120]


def outputs(count: int) -> tuple[Tensor, Tensor]:
    """Return what a network says that sees no face."""
    return np.zeros((count, 16), np.float32), np.full(count, -200, np.float32)


def test_a_face_is_decoded_relative_to_its_anchor() -> None:
    regressors, logits = outputs(2304)
    regressors[49] = [1, 2, 20, 30, *range(3, 15)]  # centre, size, six points
    logits[49] = 2

    faces, scores = decode(regressors, logits, anchors(FULL), min_score=0.5)

    (face,) = faces
    x, y = anchors(FULL)[49]
    assert face[0].tolist() == [x + 1 - 10, y + 2 - 15]
    assert face[1].tolist() == [20, 30]
    assert face[2].tolist() == [x + 3, y + 4]
    assert face[7].tolist() == [x + 13, y + 14]
    assert scores.tolist() == pytest.approx([1 / (1 + np.exp(-2))])


def test_anchors_on_the_same_face_are_merged_by_their_scores() -> None:
    regressors, logits = outputs(2304)
    regressors[100, 2:4] = regressors[101, 2:4] = 40
    logits[100], logits[101] = 1, 3

    faces, scores = decode(regressors, logits, anchors(FULL), min_score=0.5)

    weights = 1 / (1 + np.exp([-1.0, -3.0]))
    expected_x = np.average(anchors(FULL)[100:102, 0] - 20, weights=weights)
    assert len(faces) == 1
    assert faces[0, 0, 0] == pytest.approx(expected_x)
    assert scores.tolist() == pytest.approx([weights[1]])


def test_what_is_no_rectangle_is_left_out() -> None:
    regressors, logits = outputs(2304)
    logits[:4] = 10
    regressors[:4, 2:4] = 40
    regressors[0, 2] = -40
    regressors[1, 3] = 0
    regressors[2, 7] = np.nan
    regressors[3, 0] = np.inf

    faces, scores = decode(regressors, logits, anchors(FULL), min_score=0.5)

    assert len(faces) == len(scores) == 0


def test_extreme_logits_are_certainties_and_raise_no_warning() -> None:
    regressors, logits = outputs(896)
    regressors[7, 2:4] = 40
    logits[7] = 1e30

    _, scores = decode(regressors, logits, anchors(SHORT), min_score=0.5)

    assert scores.tolist() == [1.0]


def test_a_file_that_is_no_model_is_a_clear_error() -> None:
    with pytest.raises(ConfigError, match="'blazeface-full-range' is not a TensorFlow Lite model"):
        BlazeFace("blazeface-full-range", b"not a model" * 100, version="", min_score=0.5)
