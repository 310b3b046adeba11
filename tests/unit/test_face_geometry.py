"""Letterboxing, overlap and merging, against slow and obvious references."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vertebra.errors import DecodeError
from vertebra_face_tracking.geometry import Floats, Letterbox, iou, require_pixels, weighted_nms

SIDES = st.integers(1, 5000)


@given(width=SIDES, height=SIDES, side=st.sampled_from([128, 192]))
def test_a_letterbox_fills_the_square_in_one_direction_and_is_centred(
    width: int, height: int, side: int
) -> None:
    box = Letterbox.fit(width=width, height=height, side=side)

    assert max(box.width, box.height) == side
    assert min(box.width, box.height) >= 1
    assert abs(2 * box.offset[0] + box.width - side) <= 1
    assert abs(2 * box.offset[1] + box.height - side) <= 1


@given(
    width=SIDES,
    height=SIDES,
    points=arrays(np.float64, (4, 2), elements=st.floats(-6000, 6000)),
)
def test_a_letterbox_is_invertible(width: int, height: int, points: Floats) -> None:
    box = Letterbox.fit(width=width, height=height, side=192)

    np.testing.assert_allclose(box.to_image(box.to_square(points)), points, atol=1e-6)


@given(width=SIDES, height=SIDES)
def test_a_letterbox_maps_the_corners_of_the_image_to_those_of_its_place(
    width: int, height: int
) -> None:
    box = Letterbox.fit(width=width, height=height, side=192)
    corners = box.to_square(np.array([[0, 0], [width, height]], np.float64))

    np.testing.assert_allclose(corners[0], box.offset)
    np.testing.assert_allclose(corners[1] - corners[0], (box.width, box.height))


@pytest.mark.parametrize(
    ("width", "height"), [(640, 480), (100, 300), (64, 48), (1, 900), (4000, 1)]
)
def test_what_is_rendered_lies_where_the_mapping_says(width: int, height: int) -> None:
    box = Letterbox.fit(width=width, height=height, side=128)
    square = box.render(np.full((height, width, 3), 255, np.uint8))

    x, y = box.offset
    assert (square[y : y + box.height, x : x + box.width] == 255).all()
    assert int(square.sum()) == box.width * box.height * 3 * 255  # and black elsewhere


@pytest.mark.parametrize("size", [(640, 480), (300, 900), (90, 70)])
def test_a_spot_is_rendered_where_its_centre_maps_to(size: tuple[int, int]) -> None:
    width, height = size
    centre = np.array([0.3 * width, 0.6 * height])
    radius = round(0.05 * max(size))
    image = np.zeros((height, width, 3), np.uint8)
    cv2.circle(image, centre.round().astype(int).tolist(), radius, (255, 255, 255), -1)

    square = Letterbox.fit(width=width, height=height, side=192).render(image)
    moments = cv2.moments(square[..., 0])
    found = np.array([moments["m10"], moments["m01"]]) / moments["m00"]

    expected = Letterbox.fit(width=width, height=height, side=192).to_square(centre)
    np.testing.assert_allclose(found, expected, atol=1)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((0, 480, 3), "480 x 0"),
        ((480, 0, 3), "0 x 480"),
        ((480, 640), "480, 640"),
        ((2, 2, 4), "4"),
    ],
)
def test_what_is_no_colour_image_is_refused_with_its_shape(
    shape: tuple[int, ...], words: str
) -> None:
    with pytest.raises(DecodeError, match=words):
        require_pixels(np.zeros(shape, np.uint8))


def test_other_items_than_bytes_are_refused() -> None:
    with pytest.raises(DecodeError, match="float32"):
        require_pixels(np.zeros((2, 2, 3), np.float32))


BOXES = st.lists(
    st.tuples(*[st.integers(0, 15)] * 2, *[st.integers(1, 15)] * 2), min_size=1, max_size=6
).map(lambda rows: np.array(rows, np.float64))


def counted_iou(a: Floats, b: Floats) -> float:
    """Count pixels, one by one."""
    first, second = (
        {
            (x, y)
            for x in range(int(r[0]), int(r[0] + r[2]))
            for y in range(int(r[1]), int(r[1] + r[3]))
        }
        for r in (a, b)
    )
    return len(first & second) / len(first | second)


@given(BOXES, BOXES)
def test_iou_is_what_counting_pixels_gives(a: Floats, b: Floats) -> None:
    slow = [[counted_iou(p, q) for q in b] for p in a]

    np.testing.assert_allclose(iou(a, b), slow)


def test_iou_of_boxes_without_area_is_zero() -> None:
    empty = np.zeros((1, 4))

    assert iou(empty, empty).tolist() == [[0.0]]


def slow_nms(rows: list[list[float]], scores: list[float], min_iou: float) -> list[list[float]]:
    left = sorted(range(len(rows)), key=lambda i: -scores[i])
    merged = []
    while left:
        best = np.array(rows[left[0]])
        group = [i for i in left if i == left[0] or counted_iou(best, np.array(rows[i])) > min_iou]
        left = [i for i in left if i not in group]
        weight = sum(scores[i] for i in group)
        merged.append(
            [sum(scores[i] * rows[i][k] for i in group) / weight for k in range(4)]
            + [scores[group[0]]]
        )
    return merged


@given(BOXES, st.data(), st.sampled_from([0.1, 0.3, 0.6]))
def test_weighted_nms_is_what_the_slow_reference_gives(
    boxes: Floats, data: st.DataObject, min_iou: float
) -> None:
    score = st.floats(0.5, 1)
    scores = data.draw(st.lists(score, min_size=len(boxes), max_size=len(boxes)))

    values, kept = weighted_nms(boxes, boxes, np.array(scores), min_iou=min_iou)

    expected = np.array(slow_nms(boxes.tolist(), scores, min_iou))
    np.testing.assert_allclose(np.column_stack([values, kept]), expected)


def test_weighted_nms_of_nothing_is_nothing() -> None:
    values, kept = weighted_nms(np.zeros((0, 4)), np.zeros((0, 16)), np.zeros(0), min_iou=0.3)

    assert values.shape == (0, 16)
    assert kept.shape == (0,)
