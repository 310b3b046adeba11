"""Gaze controllers, faces and speakers: what is said to them, and what is refused before."""

from __future__ import annotations

import math
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import CommandRefusedError, ConfigError, RemoteError
from vertebra.messages import Array, AudioChunk, Imu
from vertebra.service.routes import parse_routes
from vertebra.yarp import from_text, to_text
from vertebra.yarp.objects import Measurement, SensorData, Vector
from vertebra_yarp import gaze, mapping
from vertebra_yarp.devices import Express, say, sounds
from vertebra_yarp.gaze import Cer, IKin, Look, LookAt, LookAtPixel
from vertebra_yarp.routes import KINDS, FaceRoute, GazeRoute


@pytest.mark.parametrize(
    ("words", "target", "leaf", "text"),
    [
        (IKin(), LookAt(point_m=(-0.5, 0.1, 0.25)), "xd:i", "-0.5 0.1 0.25"),
        (IKin(), Look(azimuth_deg=-20, elevation_deg=5), "angles:i", "abs -20.0 5.0 0.0"),
        (IKin(), Look(vergence_deg=2, relative=True), "angles:i", "rel 0.0 0.0 2.0"),
        (IKin(), LookAtPixel(u_px=160, v_px=120), "mono:i", "left 160.0 120.0 1.0"),
        (
            Cer(),
            LookAt(point_m=(1.0, 0.5, 0.25)),
            "target:i",
            "(target-type cartesian) (target-location (1.0 0.5 0.25))",
        ),
        (
            Cer(),
            Look(azimuth_deg=20.0, elevation_deg=-10.0),
            "target:i",
            "(target-type angular) (target-location (-20.0 -10.0))",
        ),
        (
            Cer(),
            LookAtPixel(u_px=1.0, v_px=2.0, camera="right", distance_m=3.0),
            "target:i",
            "(target-type image) (target-location (1.0 2.0 3.0)) (image right)",
        ),
    ],
)
def test_targets(words: IKin | Cer, target: gaze.Target, leaf: str, text: str) -> None:
    port, values = words.target(target)
    assert port == leaf
    floats = [float(value) if isinstance(value, int) else value for value in values]
    assert floats == from_text(text)


@pytest.mark.parametrize("target", [Look(relative=True), Look(vergence_deg=3)])
def test_what_r1_cannot_do_is_refused(target: Look) -> None:
    with pytest.raises(CommandRefusedError, match="absolute angles, without vergence"):
        Cer().target(target)


@given(st.sampled_from([math.nan, math.inf, -math.inf]))
def test_no_target_but_numbers_passes(value: float) -> None:
    for target in (LookAt(point_m=(0.0, value, 0.0)), Look(azimuth_deg=value)):
        with pytest.raises(CommandRefusedError, match=r"no place to look at"):
            gaze.check(target)


def test_answers_of_gaze_controllers() -> None:
    assert gaze.is_done(from_text("[ack] 1"), IKin.done)
    assert not gaze.is_done(from_text("[ack] 0"), IKin.done)
    assert gaze.acknowledged(from_text("[ack]"), IKin.stop) == []
    for text in ("[nack]", "", "[ack]", "[ack] 1 2"):
        with pytest.raises(RemoteError):
            gaze.is_done(from_text(text), IKin.done)


def test_faces_speak_icub_by_default_and_what_the_route_says_else() -> None:
    icub = FaceRoute(yarp="/icub/face/emotions/in", key="icub/face")
    assert to_text(say(icub, Express(expression="happy"))) == "set all hap"
    assert to_text(say(icub, Express(expression="sad", part="mouth"))) == "set mou sad"
    r1 = FaceRoute(yarp="/f", key="f", say="{expression}", expressions={"neutral": "rst"})
    assert to_text(say(r1, Express(expression="neutral"))) == "rst"
    with pytest.raises(CommandRefusedError, match="'happy'; known: neutral"):
        say(r1, Express(expression="happy"))
    with pytest.raises(CommandRefusedError, match="'ear'; known: all, mouth"):
        say(icub, Express(expression="sad", part="ear"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("faces:\n  - {yarp: /f, key: f, say: '{emotion}'}\n", "x:2: .*no text with"),
        ("faces:\n  - {yarp: /f, key: f, expressions: {}}\n", "x:2: .*has expressions"),
        ("faces:\n  - {yarp: /f, key: f, parts: {mouth: mou}}\n", "x:2: .*named all"),
        ("gazes:\n  - {yarp: /g, key: g, controller: magic}\n", "x:2: .*magic"),
        ("speakers:\n  - {yarp: /s, key: s, volume: 3}\n", "x:2: .*volume"),
    ],
)
def test_faults_in_routes_are_named_with_their_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_routes(text, "x", KINDS)


def test_routes_of_devices_can_be_compared_and_kept_in_sets() -> None:
    text = "gazes:\n  - {yarp: /g, key: g}\nfaces:\n  - {yarp: /f, key: f}\n"
    assert {*parse_routes(text, "x", KINDS)} == {*parse_routes(text, "y", KINDS)}
    other = parse_routes(text.replace("key: f", "key: f, say: '{expression}'"), "z", KINDS)
    assert len({*parse_routes(text, "x", KINDS)} | {*other}) == 3
    assert GazeRoute(yarp="/g", key="g") in {*other}


def chunk(samples: list[int], channels: int, rate_hz: int = 1000) -> AudioChunk:
    shape = (len(samples) // channels, channels)
    return AudioChunk(samples=Array(array("h", samples), "<i2", shape), rate_hz=rate_hz)


@given(st.lists(st.integers(-32768, 32767), min_size=1, max_size=3000), st.integers(1, 3))
def test_sounds_come_in_pieces_that_make_the_whole(samples: list[int], channels: int) -> None:
    samples = samples * channels
    pieces = sounds(chunk(samples, channels))
    played: list[int] = []
    for piece in pieces:
        assert (piece.frequency_hz, piece.channels) == (1000, channels)
        count = len(piece.samples) // channels
        assert count <= 500
        planes = [piece.samples[c * count : (c + 1) * count] for c in range(channels)]
        played += [sample for instant in zip(*planes, strict=True) for sample in instant]
    assert played == samples


def test_what_no_speaker_plays_is_refused() -> None:
    floats = AudioChunk(samples=Array(bytes(8), "<f4", (2, 1)), rate_hz=1000)
    with pytest.raises(CommandRefusedError, match="16-bit"):
        sounds(floats)
    with pytest.raises(CommandRefusedError, match="at least one"):
        sounds(chunk([], 1))
    with pytest.raises(CommandRefusedError, match=r"31 s of sound is longer than 30 s"):
        sounds(chunk([0] * 31_000, 1))


def test_imu_of_a_multi_analog_sensors_server() -> None:
    def measured(*values: float) -> tuple[Measurement]:
        return (Measurement(array("d", values), 1.0),)

    data = SensorData(
        gyroscopes=measured(1, 2, 3),
        magnetometers=measured(24e-6, 0, 0),
        orientations=measured(0, 0, 90),
    )
    imu = mapping.to_message(data.encode(), "Imu")
    assert isinstance(imu, Imu)
    told = (imu.angular_velocity_deg_s, imu.linear_acceleration_m_s2)
    assert told == ((1.0, 2.0, 3.0), None)
    assert [*(imu.magnetic_field_ut or ())] == pytest.approx([24, 0, 0])
    half = math.sqrt(0.5)
    assert [*(imu.orientation_xyzw or ())] == pytest.approx([0, 0, half, half])
    for bad in (SensorData(skin_patches=measured(1)), SensorData(gyroscopes=measured(1, 2))):
        with pytest.raises(ValueError, match=r"none of these|3 numbers"):
            mapping.to_message(bad.encode(), "Imu")
    assert isinstance(mapping.to_message(Vector.of([0.0] * 12).encode(), "Imu"), Imu)
