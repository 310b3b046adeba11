"""Faces, expressions and head poses as ROS4HRI has them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from vertebra.errors import ConfigError, EncodeError
from vertebra.messages import Array, Box, Expression, Face, Faces, HeadPose, Image, PixelFormat
from vertebra.ros2 import humans
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.service.routes import parse_routes
from vertebra_ros2.crops import KEPT, SIDE, Crops, cropped
from vertebra_ros2.routes import KINDS, Humans

CDR = Cdr(Types.standard())
HEADER = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"}
FACE = Face(
    track_id=12,
    box=Box(x=-10.0, y=30.0, width=50.0, height=80.0),
    score=0.5,
    landmarks={"right_eye": (5.0, 50.0), "left_eye": (25.0, 50.0), "third_eye": (1.0, 1.0)},
)
FACES = Faces(faces=(FACE,), image_width=200, image_height=100)


def there(record: Any, type_name: str) -> dict[str, Any]:
    """Return what arrives of a record."""
    return CDR.decode(CDR.encode(record, type_name), type_name)


def test_names_are_those_of_ros4hri() -> None:
    assert humans.topic(12, "roi") == "/humans/faces/f00012/roi"
    assert there(humans.tracked([12, 345678], HEADER), humans.TRACKED_TYPE)["ids"] == [
        "f00012",
        "f345678",
    ]


def test_region_is_a_share_of_the_image_and_within_it() -> None:
    record = there(humans.roi(FACE, FACES, HEADER), humans.PARTS["roi"])
    assert record["header"] == HEADER
    corners = [record[name] for name in ("xmin", "ymin", "xmax", "ymax", "c")]
    assert corners == pytest.approx([0.0, 0.3, 0.2, 1.0, 0.5])


def test_region_of_an_image_without_size_is_nowhere() -> None:
    nowhere = Faces(faces=(FACE,), image_width=0, image_height=0)
    record = there(humans.roi(FACE, nowhere, HEADER), humans.PARTS["roi"])
    assert [record[name] for name in ("xmin", "ymin", "xmax", "ymax")] == [0.0] * 4


def test_landmarks_are_in_their_places() -> None:
    record = there(humans.landmarks(FACE, FACES, HEADER), humans.PARTS["landmarks"])
    known = {
        index: (point["x"], point["y"], point["c"])
        for index, point in enumerate(record["landmarks"])
        if point["c"]
    }
    assert known.keys() == {68, 69}
    assert known[68] == pytest.approx((0.025, 0.5, 0.5))
    assert (record["width"], record["height"]) == (200, 100)


@pytest.mark.parametrize(
    ("labels", "word", "confidence"),
    [
        ({"happy": 0.75, "sad": 0.25}, "happy", 0.75),
        ({"Fear": 0.5, "neutral": 0.25}, "scared", 0.5),
        ({"contempt": 0.75, "anger": 0.125}, "angry", 0.125),  # ROS4HRI has no contempt
        ({"contempt": 1.0}, "", 0.0),
        ({}, "", 0.0),
    ],
)
def test_expression_is_the_likeliest_that_ros4hri_knows(
    labels: dict[str, float], word: str, confidence: float
) -> None:
    seen = Expression(track_id=1, labels=labels)
    record = there(humans.expression(seen, HEADER), humans.PARTS["expression"])
    assert (record["expression"], record["confidence"]) == (word, confidence)
    assert (record["valence"], record["arousal"]) == (0.0, 0.0)


def test_action_units_are_at_their_numbers() -> None:
    units = {"AU1": 0.25, "au_06": 0.5, "AU12": 1.0, "AU99": 1.0, "smile": 1.0, "AU123": 1.0}
    seen = Expression(track_id=1, labels={}, action_units=units)
    record = there(humans.action_units(seen, HEADER), humans.PARTS["facs"])
    intensity = record["intensity"].tolist()
    assert {index: value for index, value in enumerate(intensity) if value} == {
        1: 0.25,
        6: 0.5,
        12: 1.0,
    }
    assert sum(record["confidence"].tolist()) == 3.0


def axes(quaternion: tuple[float, float, float, float]) -> np.ndarray[Any, Any]:
    """Return the axes of a turned frame, as rows."""
    x, y, z, w = quaternion
    columns = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return columns.T


HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("yaw", "pitch", "roll", "forward", "scalp"),
    [  # in the camera's frame: x is right, y down, z away from it
        (0, 0, 0, (0, 0, -1), (0, -1, 0)),
        (90, 0, 0, (1, 0, 0), (0, -1, 0)),  # looks to the image's right
        (0, 45, 0, (0, -HALF, -HALF), (0, -HALF, HALF)),  # looks up
        (0, 0, 90, (0, 0, -1), (1, 0, 0)),  # the top of the head is at the image's right
        (90, 45, 0, (HALF, -HALF, 0), (-HALF, -HALF, 0)),
    ],
)
def test_head_is_turned_as_the_camera_sees_it(
    yaw: float, pitch: float, roll: float, forward: tuple[float, ...], scalp: tuple[float, ...]
) -> None:
    pose = HeadPose(track_id=1, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    x, y, z = axes(humans.orientation(pose))
    assert x == pytest.approx(forward, abs=1e-9)
    assert z == pytest.approx(scalp, abs=1e-9)
    assert y == pytest.approx(np.cross(z, x), abs=1e-9)


def test_transforms_of_a_face_and_its_gaze() -> None:
    pose = HeadPose(track_id=12, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0)
    record = humans.transforms(FACE, pose, FACES, 90.0, HEADER)
    head, gaze = there(record, humans.TRANSFORMS_TYPE)["transforms"]
    assert (head["header"], head["child_frame_id"]) == (HEADER, "face_f00012")
    assert gaze["header"] == {"stamp": HEADER["stamp"], "frame_id": "face_f00012"}
    assert gaze["child_frame_id"] == "gaze_f00012"
    # 100 px of focal length; a face of 50 px is at 0.32 m, its eyes at x = 15, y = 50
    place = head["transform"]["translation"]
    assert [place[axis] for axis in "xyz"] == pytest.approx([-0.272, 0.0, 0.32])
    turned = gaze["transform"]["rotation"]
    x, y, z = axes((turned["x"], turned["y"], turned["z"], turned["w"]))
    # in the face's frame: x is forward, y to its left, z up
    assert x == pytest.approx((0, -1, 0))
    assert y == pytest.approx((0, 0, -1))
    assert z == pytest.approx((1, 0, 0))


def test_face_without_eyes_is_in_the_middle_of_its_box() -> None:
    face = Face(track_id=1, box=Box(x=80.0, y=30.0, width=40.0, height=40.0), score=1.0)
    x, y, z = humans.position_m(face, FACES, 90.0)
    assert (x, y) == pytest.approx((0.0, 0.0))
    assert z == pytest.approx(0.4)


def image(pixel_format: PixelFormat = "rgb8") -> Image:
    channels = {"mono8": 1, "rgb8": 3, "bgra8": 4}[pixel_format]
    ramp = np.arange(40 * 60 * channels, dtype=np.uint8).reshape(40, 60, channels)
    pixels = ramp[..., 0].copy() if channels == 1 else ramp
    return Image(pixels=Array.of(pixels.data), pixel_format=pixel_format)


@pytest.mark.parametrize("pixel_format", ["mono8", "rgb8", "bgra8"])
def test_crop_that_needs_no_scaling_is_the_pixels(pixel_format: PixelFormat) -> None:
    whole = np.zeros((200, 200, 3), np.uint8)
    whole[10:138, 20:148] = np.arange(128 * 128 * 3).reshape(128, 128, 3) % 251
    in_order = {"mono8": whole[..., 0], "rgb8": whole[..., ::-1],
                "bgra8": np.dstack([whole, whole[..., 0]])}[pixel_format]  # fmt: skip
    given = Image(pixels=Array.of(np.ascontiguousarray(in_order).data), pixel_format=pixel_format)
    crop = cropped(given, Box(x=20.0, y=10.0, width=128.0, height=128.0), "camera")
    expected = whole[10:138, 20:148]
    if pixel_format == "mono8":
        expected = np.repeat(expected[..., :1], 3, axis=-1)
    assert (crop.pixel_format, crop.frame_id) == ("bgr8", "camera")
    assert np.array_equal(np.asarray(crop.pixels), expected)


@pytest.mark.parametrize(
    ("box", "filled"),
    [
        (Box(x=0.0, y=0.0, width=10.0, height=20.0), (128, 64)),
        (Box(x=-5.0, y=-5.0, width=15.0, height=10.0), (64, 128)),  # half of it is in the image
        (Box(x=59.0, y=39.0, width=500.0, height=500.0), (128, 128)),
        (Box(x=100.0, y=0.0, width=10.0, height=10.0), (0, 0)),
        (Box(x=-50.0, y=-50.0, width=10.0, height=10.0), (0, 0)),
        (Box(x=0.0, y=0.0, width=0.0, height=0.0), (0, 0)),
    ],
)
def test_crop_is_scaled_into_a_black_square(box: Box, filled: tuple[int, int]) -> None:
    white = np.full((40, 60, 3), 255, np.uint8)
    crop = np.asarray(
        cropped(Image(pixels=Array.of(white.data), pixel_format="rgb8"), box, "").pixels
    )
    assert crop.shape == (SIDE, SIDE, 3)
    rows, columns = (crop == 255).all(axis=2).any(axis=1), (crop == 255).all(axis=2).any(axis=0)
    assert (rows.sum(), columns.sum()) == filled
    assert ((crop == 0) | (crop == 255)).all()


def test_crop_of_nowhere_is_refused() -> None:
    with pytest.raises(EncodeError, match="nowhere"):
        cropped(image(), Box(x=math.nan, y=0.0, width=1.0, height=1.0), "")


def test_few_images_are_kept_and_only_those_with_colours() -> None:
    crops = Crops()
    for moment in range(KEPT + 2):
        crops.keep(image(), moment)
    assert crops.of(0) is None
    assert crops.of(KEPT + 1) is not None
    depth = Image(pixels=Array(bytes(4), "<f4", (1, 1)), pixel_format="depth32f")
    with pytest.raises(EncodeError, match="not cropped out of depth32f images"):
        crops.keep(depth, 99)


def test_route() -> None:
    text = "humans: [{key: cam/faces, head_poses: cam/poses, field_of_view_deg: 60}]"
    assert parse_routes(text, "routes.yaml", KINDS) == (
        Humans(key="cam/faces", head_poses="cam/poses", field_of_view_deg=60.0),
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{key: a, head_poses: b}", "add 'field_of_view_deg"),
        ("{key: a, field_of_view_deg: 180}", "below 180 degrees, not 180"),
        ("{key: a, image: 'b//c'}", "b//c"),
        ("{key: ''}", "routes.yaml:2"),
        ("{key: a}\n  - {key: b}", "/humans/faces/tracked .* in line 2 already"),
    ],
)
def test_route_that_is_wrong_is_named(text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        parse_routes(f"humans:\n  - {text}", "routes.yaml", KINDS)
