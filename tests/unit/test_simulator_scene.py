"""What the simulated camera sees and what the IMU feels fit to how the head is turned."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from vertebra_simulator.body import HEAD
from vertebra_simulator.geometry import camera_rotation, head_rotation, inertial
from vertebra_simulator.scene import Camera, Person, Scene, person_at

REST = (0.0,) * 6
CAMERA = Camera()
Pixels = NDArray[np.float64]

positions = st.tuples(*(st.floats(spec.min_deg, spec.max_deg) for spec in HEAD))
velocities = st.tuples(*(st.floats(-100, 100) for _ in HEAD))
times = st.floats(0, 600)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(CAMERA)


def picture(scene: Scene, joints: Sequence[float], time_s: float) -> Pixels:
    image = scene.render(camera_rotation(joints), time_s)
    return np.asarray(image.convert("L"), np.float64)


def face(joints: Sequence[float], time_s: float) -> tuple[float, float]:
    """Return where the face must be."""
    pixel = CAMERA.project(camera_rotation(joints), person_at(time_s).face)
    assert pixel is not None
    return pixel


def best_match(image: Pixels, template: Pixels, *, near: tuple[int, int]) -> tuple[float, float]:
    """Return where `template` is in `image`, to a part of a pixel, within 6 pixels of `near`."""
    height, width = template.shape
    x0, y0 = near
    offsets = range(-6, 7)
    errors = np.array(
        [
            [
                np.abs(
                    image[y0 + dy : y0 + dy + height, x0 + dx : x0 + dx + width] - template
                ).sum()
                for dx in offsets
            ]
            for dy in offsets
        ]
    )
    row, column = np.unravel_index(errors.argmin(), errors.shape)

    def vertex(before: float, at: float, after: float) -> float:
        return (before - after) / (2 * (before - 2 * at + after))

    down = vertex(*errors[row - 1 : row + 2, column])
    across = vertex(*errors[row, column - 1 : column + 2])
    return x0 + offsets[column] + across, y0 + offsets[row] + down


@pytest.mark.parametrize(
    "joints",
    [
        (0, 0, -5, 0, 0, 0),  # turned to the right: the face moves to the left
        (0, 0, 8, 0, 0, 0),
        (0, 0, 0, 0, -6, 0),
        (0, 0, 0, 0, 0, 10),  # the left eye turns to the right by half of it
        (4, 0, 0, 0, 0, 0),
        (0, 0, 0, -3, 0, 0),
        (0, 0, -2.37, 1.81, 0, 0),
    ],
    ids=str,
)
def test_the_face_moves_by_the_pixels_of_a_pinhole(scene: Scene, joints: Sequence[float]) -> None:
    time_s = 0.0
    x, y = face(REST, time_s)
    left, top, size = round(x) - 14, round(y) - 14, 28
    template = picture(scene, REST, time_s)[top : top + size, left : left + size]
    x_after, y_after = face(joints, time_s)
    expected = (left + x_after - x, top + y_after - y)
    found = best_match(
        picture(scene, joints, time_s), template, near=(round(expected[0]), round(expected[1]))
    )
    assert found == pytest.approx(expected, abs=0.6)


def test_signs_of_the_joints() -> None:
    x, y = face(REST, 0.0)
    assert face((0, 0, -5, 0, 0, 0), 0)[0] < x - 20  # right
    assert face((0, 0, 0, 0, -5, 0), 0)[0] < x - 20
    assert face((0, 0, 0, 0, 0, 10), 0)[0] < x - 20
    assert face((5, 0, 0, 0, 0, 0), 0)[1] > y + 20  # up
    assert face((0, 0, 0, 5, 0, 0), 0)[1] > y + 20
    camera = camera_rotation((0, 10, 0, 0, 0, 0))  # to the right shoulder
    assert camera[2, 1] > 0  # its left side is up


def test_a_turn_shifts_the_middle_of_the_image_by_the_focal_length() -> None:
    pixel = CAMERA.project(camera_rotation((0, 0, -10, 0, 0, 0)), np.array([1.0, 0, 0]))
    assert pixel == pytest.approx((160 - CAMERA.focal_px * math.tan(math.radians(10)), 120))
    assert CAMERA.focal_px == pytest.approx(277.128, abs=0.001)
    behind = CAMERA.project(camera_rotation((0, 0, 50, 0, 30, 0)), np.array([0, -1.0, 0]))
    assert behind is None


@given(times)
def test_from_the_rest_pose_the_whole_face_is_always_in_view_and_large_enough(
    time_s: float,
) -> None:
    person = person_at(time_s)
    x, y = face(REST, time_s)
    half = CAMERA.focal_px * 0.08 / person.distance_m  # a face is about 16 cm wide
    assert 2 * half >= 48
    assert half < x < CAMERA.width - half
    assert 1.3 * half < y < CAMERA.height - 1.3 * half


@given(times)
def test_the_person_moves_smoothly(time_s: float) -> None:
    before, after = face(REST, time_s), face(REST, time_s + 1 / 30)
    assert math.dist(before, after) < 3


def test_the_person_moves_from_side_to_side() -> None:
    across = [face(REST, time_s)[0] for time_s in range(60)]
    assert min(across) < 100
    assert max(across) > 220


@given(positions, times)
@settings(max_examples=60, deadline=None)
def test_every_pose_and_time_gives_an_image_without_holes(
    joints: Sequence[float], time_s: float
) -> None:
    image = SCENE.render(camera_rotation(joints), time_s)
    assert (image.mode, image.size) == ("RGB", (320, 240))
    shade = np.all(np.asarray(image) == (120, 112, 98), axis=2)
    assert shade.mean() < 0.02  # at most the seams between walls


SCENE = Scene(CAMERA)


def test_the_same_pose_and_time_give_the_same_image(scene: Scene) -> None:
    once = picture(scene, REST, 3.0)
    other = picture(scene, (0, 0, 20, 0, 0, 0), 3.0)
    again = picture(scene, REST, 3.0)
    assert np.array_equal(once, again)
    assert np.array_equal(once, picture(Scene(CAMERA), REST, 3.0))
    assert not np.array_equal(once, other)


def test_landmarks_turn_with_the_head(scene: Scene) -> None:
    """The edge of the window is where it must be on the wall ahead."""
    corner = np.array([2.5, 1.9, 0.9])  # top left outside corner of the window's frame
    for yaw in (12.0, 20.0):
        joints = (0, 0, yaw, 0, 0, 0)
        pixel = CAMERA.project(camera_rotation(joints), corner)
        assert pixel is not None
        x, y = round(pixel[0]), round(pixel[1])
        image = picture(scene, joints, 4.0)
        assert image[y + 4, x + 4] > image[y - 4, x - 4] + 20


def test_other_sizes_show_the_same(scene: Scene) -> None:
    large = Scene(Camera(640, 480)).render(camera_rotation(REST), 0)
    small = np.asarray(large.resize((320, 240), Image.Resampling.BOX).convert("L"), np.float64)
    assert np.abs(small - picture(scene, REST, 0)).mean() < 4


def test_a_person_is_where_its_direction_points() -> None:
    assert Person(90, 0, 2).face == pytest.approx((0, 2, 0))
    assert Person(0, 90, 2).face == pytest.approx((0, 0, 2))


def test_the_imu_at_rest_feels_gravity() -> None:
    assert inertial(REST, REST) == pytest.approx([0, 0, 0, 0, 0, 9.81, 0, 0, 0, 24, 0, -38])


@pytest.mark.parametrize(
    ("joints", "expected"),
    [
        ((0, 0, 30, 0, 0, 0), (0, 0, 30)),
        ((20, 0, 0, 0, 0, 0), (0, -20, 0)),  # up; a positive pitch is down
        ((0, 15, 0, 0, 0, 0), (15, 0, 0)),
        ((0, 0, 0, 20, 20, 20), (0, 0, 0)),  # the eyes do not turn it
    ],
)
def test_the_imu_tells_how_the_head_is_turned(
    joints: Sequence[float], expected: tuple[float, ...]
) -> None:
    felt = inertial(joints, REST)
    assert felt[:3] == pytest.approx(expected)
    assert math.hypot(*felt[3:6]) == pytest.approx(9.81)
    assert math.hypot(*felt[9:12]) == pytest.approx(math.hypot(24, 38))


@given(positions, velocities)
def test_the_gyroscope_is_the_derivative_of_the_orientation(
    joints: Sequence[float], speeds: Sequence[float]
) -> None:
    step_s = 1e-6
    moved = [position + step_s * speed for position, speed in zip(joints, speeds, strict=True)]
    before = head_rotation(joints)
    turned = before.T @ (head_rotation(moved) - before) / step_s
    expected = np.degrees([turned[2, 1], turned[0, 2], turned[1, 0]])
    assert inertial(joints, speeds)[6:9] == pytest.approx(list(expected), abs=0.01)
