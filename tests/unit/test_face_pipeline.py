"""Every pixel format becomes RGB, and a failed detector is never an empty result."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vertebra.errors import DecodeError
from vertebra.messages import PIXELS, Array, Box, Image, PixelFormat
from vertebra_face_tracking.backend import Detection, DetectorError, RgbImage
from vertebra_face_tracking.pipeline import find_faces, to_rgb
from vertebra_face_tracking.tracker import Tracker

COLOURS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (10, 200, 90)]
YUV = {"uyvy", "yuv422", "yuyv", "yuv422_yuy2"}
COLOURLESS = {name for name in PIXELS if name[0].isdigit()} - {"8UC1", "8UC3"} | {"depth32f"}
NOW_NS = 1_700_000_000_000_000_000


def image_of(pixels: NDArray[Any], pixel_format: PixelFormat) -> Image:
    array = Array(pixels.tobytes(), pixels.dtype.str, pixels.shape)
    return Image(pixels=array, pixel_format=pixel_format)


def plain(colour: tuple[int, ...], height: int = 8, width: int = 10) -> NDArray[np.uint8]:
    return np.full((height, width, len(colour)), colour, np.uint8)


@pytest.mark.parametrize("colour", COLOURS)
def test_colour_formats_keep_their_colours(colour: tuple[int, int, int]) -> None:
    red, green, blue = colour
    expected = plain(colour)

    for pixel_format, order in {
        "rgb8": (red, green, blue),
        "bgr8": (blue, green, red),
        "rgba8": (red, green, blue, 7),
        "bgra8": (blue, green, red, 7),
    }.items():
        converted = to_rgb(image_of(plain(order), pixel_format))  # type: ignore[arg-type]
        np.testing.assert_array_equal(converted, expected)


@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_bayer_mosaics_keep_their_colours(colour: tuple[int, int, int], pattern: str) -> None:
    values = dict(zip("rgb", colour, strict=True))
    mosaic = np.zeros((8, 10), np.uint8)
    for index, letter in enumerate(pattern):
        mosaic[index // 2 :: 2, index % 2 :: 2] = values[letter]

    converted = to_rgb(image_of(mosaic, f"bayer_{pattern}8"))  # type: ignore[arg-type]

    np.testing.assert_array_equal(converted, plain(colour))


def test_grey_becomes_three_equal_channels() -> None:
    grey = np.arange(80, dtype=np.uint8).reshape(8, 10)

    np.testing.assert_array_equal(to_rgb(image_of(grey, "mono8")), np.dstack([grey] * 3))


def test_sixteen_bits_are_stretched_to_the_range_they_use() -> None:
    grey = np.array([[100, 1123], [612, 100]], np.uint16)  # a 10-bit camera

    converted = to_rgb(image_of(grey, "mono16"))

    np.testing.assert_array_equal(converted[..., 0], [[0, 255], [127, 0]])
    assert converted.shape == (2, 2, 3)
    np.testing.assert_array_equal(to_rgb(image_of(grey[:1, :1], "mono16")), [[[0, 0, 0]]])


def test_rgb_is_not_copied() -> None:
    image = image_of(plain((1, 2, 3)), "rgb8")

    assert np.shares_memory(to_rgb(image), np.asarray(image.pixels))


@pytest.mark.parametrize("pixel_format", sorted(PIXELS))
@pytest.mark.parametrize(("height", "width"), [(0, 0), (0, 5), (5, 0)])
def test_an_image_without_pixels_is_refused_with_its_size(
    pixel_format: PixelFormat, height: int, width: int
) -> None:
    dtype, channels = PIXELS[pixel_format]
    shape = (height, width) if channels == 1 else (height, width, channels)
    empty = Image(pixels=Array(b"", dtype, shape), pixel_format=pixel_format)

    with pytest.raises(DecodeError, match=f"no pixels: it is {width} x {height}"):
        to_rgb(empty)


@pytest.mark.parametrize("pixel_format", sorted(set(PIXELS) - COLOURLESS - YUV))
def test_an_image_of_one_pixel_is_an_image(pixel_format: PixelFormat) -> None:
    dtype, channels = PIXELS[pixel_format]
    pixel = np.full((1, 1) if channels == 1 else (1, 1, channels), 9, dtype)

    assert to_rgb(image_of(pixel, pixel_format)).shape == (1, 1, 3)


@pytest.mark.parametrize("pixel_format", sorted(COLOURLESS))
def test_numbers_that_are_no_colours_are_refused(pixel_format: PixelFormat) -> None:
    dtype, channels = PIXELS[pixel_format]
    pixels = np.ones((4, 4) if channels == 1 else (4, 4, channels), dtype)
    with pytest.raises(DecodeError, match=f"a {pixel_format} image .* use the colour image"):
        to_rgb(image_of(pixels, pixel_format))


@pytest.mark.parametrize("pixel_format", sorted(YUV))
def test_two_pixels_share_a_colour(pixel_format: PixelFormat) -> None:
    bytes_of_two = (
        [128, 100, 128, 200] if pixel_format in ("uyvy", "yuv422") else [100, 128, 200, 128]
    )
    pixels = np.tile(np.array(bytes_of_two, np.uint8).reshape(2, 2), (2, 2, 1))
    rgb = to_rgb(image_of(pixels, pixel_format)).astype(int)
    assert rgb.shape == (2, 4, 3)
    assert (rgb.max(axis=-1) - rgb.min(axis=-1)).max() <= 2  # grey
    assert (rgb[:, 0] < rgb[:, 1]).all()


def test_colours_of_16_bits_show_their_upper_half() -> None:
    pixels = np.full((4, 4, 3), (0x0AFF, 0x14FF, 0x1EFF), "<u2")
    assert (to_rgb(image_of(pixels, "bgr16")) == (0x1E, 0x14, 0x0A)).all()


class Stub:
    """A detector that says what it is told to."""

    name = "stub"
    version = "1"

    def __init__(self, *answers: list[Detection] | Exception) -> None:
        self._answers = list(answers)

    def detect(self, image: RgbImage) -> list[Detection]:
        answer = self._answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


FACE = Detection(
    box=Box(x=1, y=2, width=3, height=4), score=0.9, landmarks={"nose_tip": (2.5, 4.0)}
)


def test_faces_are_told_with_all_that_is_known() -> None:
    tracker = Tracker(count(1), keep_s=1)
    image = image_of(plain((1, 2, 3), height=8, width=10), "rgb8")
    stub = Stub([FACE], [FACE])

    find_faces(image, NOW_NS, stub, tracker)
    found = find_faces(image, NOW_NS + 50_000_000, stub, tracker)

    (face,) = found.faces
    assert (face.track_id, face.box, face.score, face.age_s) == (1, FACE.box, 0.9, 0.05)
    assert face.landmarks == {"nose_tip": (2.5, 4.0)}
    assert (found.image_width, found.image_height, found.backend) == (10, 8, "stub (1)")


def test_a_detector_that_fails_is_an_error_and_the_next_image_is_followed() -> None:
    tracker = Tracker(count(1), keep_s=1)
    image = image_of(plain((1, 2, 3)), "rgb8")
    stub = Stub([FACE], RuntimeError("out of memory"), [FACE])

    before = find_faces(image, NOW_NS, stub, tracker)
    with pytest.raises(DetectorError, match=r"stub failed: RuntimeError\('out of memory'\)"):
        find_faces(image, NOW_NS + 50_000_000, stub, tracker)
    after = find_faces(image, NOW_NS + 100_000_000, stub, tracker)

    assert before.faces[0].track_id == after.faces[0].track_id


def test_an_error_raised_on_purpose_stays_what_it_is() -> None:
    stub = Stub(DecodeError("too wide"))

    with pytest.raises(DecodeError, match="too wide"):
        find_faces(image_of(plain((1, 2, 3)), "rgb8"), NOW_NS, stub, Tracker(count(1), keep_s=1))
