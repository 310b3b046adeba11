"""Images of every pixel format come out as JPEGs that show the same."""

from __future__ import annotations

import io

import numpy as np
import PIL.Image
import pytest

from vertebra.errors import EncodeError
from vertebra.messages import PIXELS, Array, CompressedImage, Image, PixelFormat, Text
from vertebra_gateway.pictures import to_jpeg

RED, GREEN, BLUE = (200, 30, 40), (20, 180, 60), (10, 40, 220)


def decode(file: bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.asarray(PIL.Image.open(io.BytesIO(file)).convert("RGB"))


def image(pixels: np.ndarray[tuple[int, ...], np.dtype[np.generic]], name: PixelFormat) -> Image:
    array = Array(pixels.tobytes(), pixels.dtype.str, pixels.shape)
    return Image(pixels=array, pixel_format=name)


@pytest.mark.parametrize(
    ("name", "channels"), [("rgb8", "rgb"), ("bgr8", "bgr"), ("rgba8", "rgba"), ("bgra8", "bgra")]
)
@pytest.mark.parametrize("color", [RED, GREEN, BLUE])
def test_colors_stay(name: PixelFormat, channels: str, color: tuple[int, int, int]) -> None:
    by_name = dict(zip("rgba", (*color, 255), strict=True))
    pixel = np.array([by_name[channel] for channel in channels], dtype=np.uint8)
    shown = decode(to_jpeg(image(np.tile(pixel, (48, 64, 1)), name), 90))
    assert shown.shape == (48, 64, 3)
    assert np.abs(shown.astype(int) - color).max() <= 6


@pytest.mark.parametrize("name", ["bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"])
@pytest.mark.parametrize("color", [RED, GREEN, BLUE])
def test_bayer_colors_stay(name: PixelFormat, color: tuple[int, int, int]) -> None:
    by_name = dict(zip("rgb", color, strict=True))
    cell = [by_name[letter] for letter in name.removeprefix("bayer_").removesuffix("8")]
    pixels = np.tile(np.array(cell, dtype=np.uint8).reshape(2, 2), (24, 32))
    shown = decode(to_jpeg(image(pixels[:-1], name), 90))  # an odd row is left out
    assert shown.shape == (23, 32, 3)
    assert np.abs(shown.astype(int) - color).max() <= 6


def test_grey_stays_and_wide_values_are_scaled() -> None:
    ramp = np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (48, 1))
    assert np.abs(decode(to_jpeg(image(ramp, "mono8"), 95))[:, :, 0].astype(int) - ramp).max() <= 6
    wide = ramp.astype(np.uint16) * 10 + 500
    assert np.abs(decode(to_jpeg(image(wide, "mono16"), 95))[:, :, 0].astype(int) - ramp).max() <= 6
    metres = ramp.astype(np.float32) / 100
    metres[:, :8] = np.nan
    metres[:, 8:16] = np.inf
    shown = decode(to_jpeg(image(metres, "depth32f"), 95))[:, :, 0]
    assert shown[:, :14].max() <= 20
    assert shown[:, -4:].min() >= 230


def test_flat_and_unknown_distances_are_no_trouble() -> None:
    for value in (3.0, np.nan):
        flat = np.full((8, 8), value, dtype=np.float32)
        assert decode(to_jpeg(image(flat, "depth32f"), 80)).max() <= 3


def test_every_pixel_format_is_shown() -> None:
    for name, (dtype, channels) in PIXELS.items():
        shape = (8, 8) if channels == 1 else (8, 8, channels)
        shown = decode(to_jpeg(image(np.zeros(shape, dtype), name), 80))  # type: ignore[arg-type]
        assert shown.size > 0, name


def test_two_pixels_of_yuv_share_a_colour() -> None:
    red = (76, 85, 255)  # brightness, blue, red
    y, u, v = red
    for name, pair in {"yuyv": (y, u, y, v), "uyvy": (u, y, v, y)}.items():
        pixels = np.tile(np.array(pair, np.uint8).reshape(2, 2), (8, 4, 1))
        shown = decode(to_jpeg(image(pixels, name), 95))  # type: ignore[arg-type]
        assert np.abs(shown.astype(int) - (254, 0, 0)).max() <= 6, name
    with pytest.raises(EncodeError, match="even width, not 3"):
        to_jpeg(image(np.zeros((2, 3, 2), np.uint8), "uyvy"), 80)


def test_colours_of_16_bits_show_their_upper_half() -> None:
    pixels = np.full((8, 8, 3), (0xFF00, 0x8000, 0x0000), "<u2")
    shown = decode(to_jpeg(image(pixels, "rgb16"), 95))
    assert np.abs(shown.astype(int) - (255, 128, 0)).max() <= 6


def test_a_jpeg_is_left_as_it_is() -> None:
    file = to_jpeg(image(np.zeros((8, 8), np.uint8), "mono8"), 80)
    message = CompressedImage(data=Array.of(file), media_type="image/jpeg")
    assert to_jpeg(message, 10) == file


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (Text(text="x"), "Text is no image"),
        (CompressedImage(data=Array.of(b"x"), media_type="image/png"), "image/png"),
        (Image(pixels=Array(b"", "|u1", (0, 8)), pixel_format="mono8"), "8 x 0 pixels"),
        (
            Image(pixels=Array(bytes(70_000), "|u1", (1, 70_000)), pixel_format="mono8"),
            "70000 x 1 pixels",
        ),
        (Image(pixels=Array(b"x", "|u1", (1, 1)), pixel_format="bayer_rggb8"), "no whole cell"),
    ],
)
def test_what_has_no_jpeg_is_refused(message: Image, says: str) -> None:
    with pytest.raises(EncodeError, match=says):
        to_jpeg(message, 80)
