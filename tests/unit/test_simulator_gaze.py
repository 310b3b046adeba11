"""The simulated gaze controller: head and eyes turn to what they shall look at."""

from __future__ import annotations

import math
from array import array

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError
from vertebra.yarp import Value, from_text
from vertebra.yarp.objects import Sound
from vertebra_simulator.body import Body
from vertebra_simulator.face import EXPRESSIONS, PARTS, Face
from vertebra_simulator.gaze import GazeController
from vertebra_simulator.geometry import camera_rotation
from vertebra_simulator.scene import Camera
from vertebra_simulator.sound import CHUNK, MAX_WAITING, RATE_HZ, Room

CAMERA = Camera()


def settled(act: str, *, point: list[float] | None = None) -> tuple[Body, GazeController]:
    body = Body()
    gaze = GazeController(body, CAMERA)
    if point is not None:
        gaze.look_at(point)
    else:
        gaze.look(from_text(act))
    body.advance_to(60)
    return body, gaze


@given(st.floats(-60, 60), st.floats(-40, 35), st.floats(0, 40))
def test_eyes_look_where_they_are_told(azimuth: float, elevation: float, vergence: float) -> None:
    _, gaze = settled(f"abs {azimuth:.6f} {elevation:.6f} {vergence:.6f}")
    assert np.allclose(gaze.angles, [azimuth, elevation, vergence], atol=1e-3)


@given(st.floats(0.5, 3), st.floats(-0.7, 0.7), st.floats(-0.4, 0.4))
def test_point_that_is_looked_at_is_in_the_middle_of_the_picture(
    x: float, y: float, z: float
) -> None:
    body, gaze = settled("", point=[x, y, z])
    assert np.allclose(gaze.point, [x, y, z], rtol=1e-3, atol=1e-3)
    # The left eye is half the vergence off the middle: all axes of this head meet in one point.
    pixel = CAMERA.project(camera_rotation(body.positions), np.array([x, y, z]))
    assert pixel is not None
    off = CAMERA.focal_px * math.tan(math.radians(body.positions[5]) / 2)
    assert pixel[0] == pytest.approx(CAMERA.width / 2 - off, abs=0.5)
    assert pixel[1] == pytest.approx(CAMERA.height / 2, abs=0.5)


def test_relative_angles_add_up() -> None:
    body, gaze = settled("abs 10 5 0")
    gaze.look(from_text("rel -4 1 3"))
    body.advance_to(120)
    assert np.allclose(gaze.angles, [6, 6, 3], atol=1e-3)


def test_pixel_that_is_looked_at_comes_to_the_middle() -> None:
    body = Body()
    gaze = GazeController(body, CAMERA)
    seen = camera_rotation(body.positions) @ CAMERA.rays @ np.array([200.0, 90.0, 1.0])
    gaze.look_at_pixel(from_text("left 200 90 1.0"))
    body.advance_to(60)
    assert np.allclose(gaze.point, seen, atol=1e-3)


def test_out_of_reach_is_as_far_as_it_goes() -> None:
    body, _ = settled("abs 170 0 0")
    assert body.positions[2] == -50


@pytest.mark.parametrize("text", ["abs 1 2", "up 1 2 3", "abs a b c", "abs 1 2 nan", ""])
def test_what_is_no_direction_is_refused(text: str) -> None:
    with pytest.raises(CommandRefusedError):
        settled(text)


@pytest.mark.parametrize("point", [[0.0, 0.0, 0.0], [1.0], [math.nan, 0.0, 0.0]])
def test_what_is_no_point_is_refused(point: list[float]) -> None:
    with pytest.raises(CommandRefusedError):
        settled("", point=point)


@pytest.mark.parametrize("text", ["right 1 2 3", "left 1 2", "left 1 2 nan"])
def test_what_is_no_pixel_is_refused(text: str) -> None:
    with pytest.raises(CommandRefusedError):
        GazeController(Body(), CAMERA).look_at_pixel(from_text(text))


def test_rpc() -> None:
    body, gaze = settled("abs 10 0 0")

    def ask(text: str) -> list[Value]:
        return gaze.answer(from_text(text))

    assert ask("[get] [done]") == ["ack", 1]
    gaze.look(from_text("abs -10 0 0"))
    assert ask("[get] [done]") == ["ack", 0]
    assert ask("[stop]") == ["ack"]
    body.advance_to(70)
    assert ask("[get] [done]") == ["ack", 1]
    assert gaze.angles[0] > 9
    assert ask("[get] [rich]") == ["nack"]


def test_every_expression_looks_different() -> None:
    face = Face()
    looks = set()
    for name in EXPRESSIONS:
        assert face.answer(["set", "all", name]) == ["ok"]
        looks.add(face.render())
    assert len(looks) == len(EXPRESSIONS)
    assert face.answer(["set", "mou", "hap"]) == ["ok"]
    assert face.shown == {**dict.fromkeys(PARTS, "ta2"), "mou": "hap"}


@pytest.mark.parametrize(
    "request_", [["set", "all"], ["set", "nose", "hap"], ["get", "all"], [], ["set", "all", 3]]
)
def test_what_the_face_does_not_know_fails(request_: list[Value]) -> None:
    assert Face().answer(request_) == ["fail"]


def test_speaker_refuses_to_talk_for_ever() -> None:
    room = Room()
    room.play(Sound(RATE_HZ, 1, array("h", [5] * MAX_WAITING)))
    with pytest.raises(CommandRefusedError, match=r"20\.0 s to say"):
        room.play(Sound(RATE_HZ, 1, array("h", [5] * CHUNK)))
    room.hear()
    room.play(Sound(RATE_HZ, 2, array("h", [7] * CHUNK + [9] * CHUNK)))
    for _ in range(MAX_WAITING // CHUNK - 1):
        assert set(room.hear().samples) == {5}
    assert set(room.hear().samples) == {7}, "the first channel"
    assert set(room.hear().samples) == {0}
