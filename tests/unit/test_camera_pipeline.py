"""Sources, sizes and rates of the camera service."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vertebra_camera.pipeline import (
    Device,
    Files,
    Pace,
    Relay,
    Source,
    Stream,
    parse_source,
    target_size,
)
from vertebra_camera.settings import CameraSettings


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("/dev/video0", Device("/dev/video0")),
        ("rtsp://camera.lab:8554/left", Stream("rtsp://camera.lab:8554/left")),
        ("https://camera.lab/stream", Stream("https://camera.lab/stream")),
        ("pictures", Files(Path("pictures"))),
        ("/data/a film.mp4", Files(Path("/data/a film.mp4"))),
        ("key:vizzy/camera/left", Relay("vizzy/camera/left")),
    ],
)
def test_sources_are_told_apart(text: str, source: Source) -> None:
    assert parse_source(text) == source


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "a source is a device"),
        ("ftp://host/film.mp4", "use one of rtsp"),
        ("rtsp://user:secret@host/", "credentials_file"),
        ("rtsp://user@host/", "credentials_file"),
        ("rtsp:///path", "names no host"),
        ("key:", "not empty"),
        ("key:vizzy/**", "not allowed in a key"),
    ],
)
def test_what_is_no_source_is_refused_with_a_remedy(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_source(text)


def test_a_password_is_quoted_into_the_url() -> None:
    stream = Stream("rtsp://host:554/a?b=c")
    assert stream.with_credentials("me:p@ss:/?") == "rtsp://me:p%40ss%3A%2F%3F@host:554/a?b=c"


def test_settings_refuse_a_camera_that_feeds_itself() -> None:
    with pytest.raises(ValidationError, match="choose another key"):
        CameraSettings(source="key:lab/camera/front")
    CameraSettings(source="key:lab/camera/back")


@pytest.mark.parametrize(
    ("wanted", "size"),
    [((0, 0), (640, 480)), ((320, 0), (320, 240)), ((0, 120), (160, 120)), ((7, 9), (7, 9))],
)
def test_target_size(wanted: tuple[int, int], size: tuple[int, int]) -> None:
    assert target_size(640, 480, wanted) == size


def test_target_size_is_never_0() -> None:
    assert target_size(10_000, 1, (10, 0)) == (10, 1)


@given(
    st.floats(1, 200),
    st.floats(1, 200),
    st.lists(st.floats(-0.002, 0.002), min_size=200, max_size=400),
)
def test_pace_never_exceeds_its_rate_and_follows_a_slower_source(
    source_hz: float, max_rate_hz: float, jitters: list[float]
) -> None:
    pace = Pace(max_rate_hz)
    times = sorted(index / source_hz + jitter for index, jitter in enumerate(jitters))
    passed = [time_s for time_s in times if pace.allows(time_s)]
    seconds = times[-1] - times[0]
    assert len(passed) <= seconds * max_rate_hz + 2
    if source_hz * 1.05 < max_rate_hz and 0.4 / max_rate_hz > 0.005:
        assert passed == times
    if source_hz >= 4 * max_rate_hz:
        assert len(passed) >= 0.75 * seconds * max_rate_hz - 1


def test_pace_passes_every_second_image_of_a_source_that_is_twice_as_fast() -> None:
    pace = Pace(15)
    passed = [index for index in range(30) if pace.allows(index / 30 + 0.001 * (index % 3))]
    assert passed == list(range(0, 30, 2))


def test_pace_does_not_make_up_for_a_pause() -> None:
    pace = Pace(10)
    assert pace.allows(0)
    assert pace.allows(100)
    assert not pace.allows(100.01)
