"""PNG, WebP and Pillow images through the suite of all codec plugins."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import strategies as st
from PIL import Image as Pillow

from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import PIXELS, Array, Header, Image, Message, PixelFormat, Text
from vertebra.testing.codec_suite import CodecSuite, ValueCodecSuite
from vertebra_pillow.files import MAX_PIXELS, PngCodec, WebpCodec
from vertebra_pillow.values import ImageCodec

GOLDENS = Path(__file__).parent / "goldens"


def image(pixel_format: PixelFormat, width: int, height: int, data: bytes | None = None) -> Image:
    dtype, channels = PIXELS[pixel_format]
    count = width * height * channels * int(dtype[2:])
    shape = (height, width) if channels == 1 else (height, width, channels)
    data = bytes(17 * index % 251 for index in range(count)) if data is None else data
    return Image(pixels=Array(data, dtype, shape), pixel_format=pixel_format)


@st.composite
def images(draw: st.DrawFn, pixel_formats: Sequence[PixelFormat]) -> Image:
    pixel_format = draw(st.sampled_from(pixel_formats))
    width, height = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    dtype, channels = PIXELS[pixel_format]
    count = width * height * channels * int(dtype[2:])
    return image(pixel_format, width, height, draw(st.binary(min_size=count, max_size=count)))


def file(picture: Pillow.Image, picture_format: str, **options: Any) -> bytes:
    written = io.BytesIO()
    picture.save(written, picture_format, **options)
    return written.getvalue()


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(
    width: int, height: int, depth: int, color: int, rows: bytes, *, interlaced: bool = False
) -> bytes:
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlaced))
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def two_colors() -> Pillow.Image:
    picture = Pillow.new("P", (2, 1))
    picture.putpalette([255, 0, 0, 0, 0, 255])
    picture.putdata([0, 1])
    return picture


# 3 x 2 pixels 0 to 5: the passes hold the pixels 0, then 2, then 1, then 3 4 5.
INTERLACED = png(3, 2, 8, 0, b"\0\0\0\2\0\1\0\3\4\5", interlaced=True)
WIDE_WEBP = (
    b"RIFF" + struct.pack("<I", 22) + b"WEBPVP8X" + struct.pack("<IB3x", 10, 0) + b"\xff" * 6
)


class TestPng(CodecSuite):
    encoding = "image/png"
    release = "0.1.0"
    folder = GOLDENS / "image.png"
    messages: ClassVar[Mapping[str, Message]] = {
        "mono8": image("mono8", 5, 3),
        "mono16": image("mono16", 3, 2),
        "rgb8": image("rgb8", 3, 2),
        "rgba8": image("rgba8", 2, 2),
    }
    refused: ClassVar[Sequence[tuple[Message, str]]] = [
        (Text(text="x"), "carries Image, not Text; use a frame"),
        (image("depth32f", 2, 2), "not depth32f; convert the image, or use a frame"),
        (image("bayer_rggb8", 2, 2), "not bayer_rggb8"),
        (image("rgb8", 0, 2), "without pixels"),
    ]
    foreign: ClassVar[Sequence[tuple[bytes, Message | str]]] = [
        (b"", "a PNG begins with"),
        (file(Pillow.new("RGB", (2, 2)), "WEBP"), "a PNG begins with"),
        (b"\x89PNG\r\n\x1a\n" + chunk(b"IEND", b""), "a PNG goes from IHDR to IEND"),
        (file(two_colors(), "PNG"), image("rgb8", 2, 1, b"\xff\0\0\0\0\xff")),
        (
            file(two_colors(), "PNG", transparency=1),
            image("rgba8", 2, 1, b"\xff\0\0\xff\0\0\xff\0"),
        ),
        (
            file(Pillow.new("RGB", (1, 1), (1, 2, 3)), "PNG", transparency=(1, 2, 3)),
            image("rgba8", 1, 1, b"\1\2\3\0"),
        ),
        (file(Pillow.new("1", (9, 1), 1), "PNG"), image("mono8", 9, 1, b"\xff" * 9)),
        (file(Pillow.new("LA", (1, 1), (7, 9)), "PNG"), image("rgba8", 1, 1, b"\7\7\7\x09")),
        (png(1, 1, 16, 2, bytes(7)), "16 bits for each colour"),
        (png(1, 1, 16, 6, bytes(9)), "16 bits for each colour"),
        (png(1, 1, 16, 0, b"\0\1\2"), image("mono16", 1, 1, b"\2\1")),
        (png(0, 1, 8, 0, b"\0"), "0 x 1 pixels"),
        (png(2, 2, 8, 0, b"\0\1\2"), "has 3 bytes of rows instead of 6"),
        (png(2, 2, 8, 0, b"\0\1\2\0\3\4\5"), image("mono8", 2, 2, b"\1\2\3\4")),
        (INTERLACED, image("mono8", 3, 2, bytes(range(6)))),
        (png(3, 2, 8, 0, b"\0\0\0\2\0\1", interlaced=True), "6 bytes of rows instead of 10"),
        (png(1, 1, 8, 5, b"\0\1"), "no whole image/png"),
        (png(50_000, 50_000, 8, 0, b""), "claims 50000 x 50000 pixels"),
        (png(MAX_PIXELS + 1, 1, 8, 0, b""), "at most 67108864"),
        (
            file(
                Pillow.new("L", (2, 2)),
                "PNG",
                save_all=True,
                append_images=[Pillow.new("L", (2, 2), 9)],
            ),
            "is a film",
        ),
    ]

    def any_message(self) -> st.SearchStrategy[Message]:
        return images(["mono8", "mono16", "rgb8", "rgba8"])


class TestWebp(CodecSuite):
    encoding = "image/webp"
    release = "0.1.0"
    folder = GOLDENS / "image.webp"
    messages: ClassVar[Mapping[str, Message]] = {
        "rgb8": image("rgb8", 5, 3),
        "rgba8": image("rgba8", 2, 2, bytes(range(16))),
    }
    refused: ClassVar[Sequence[tuple[Message, str]]] = [
        (image("mono8", 2, 2), "not mono8; convert the image"),
        (image("rgb8", 16384, 1), "cannot hold 16384 x 1 pixels"),
    ]
    foreign: ClassVar[Sequence[tuple[bytes, Message | str]]] = [
        (b"", "no whole image/webp"),
        (b"RIFF\4\0\0\0WEBP", "no whole image/webp"),
        (WIDE_WEBP, "claims 16777216 x 16777216 pixels"),
        (
            file(
                Pillow.new("RGB", (2, 2)),
                "WEBP",
                save_all=True,
                append_images=[Pillow.new("RGB", (2, 2), "red")],
            ),
            "is a film",
        ),
    ]

    def any_message(self) -> st.SearchStrategy[Message]:
        # A picture without any transparency is written without it.
        return images(["rgb8", "rgba8"]).filter(
            lambda message: (
                message.pixel_format == "rgb8" or bytes(message.pixels.data)[3::4].count(255) == 0
            )
        )


@pytest.mark.parametrize("codec", [PngCodec(), WebpCodec()])
@pytest.mark.parametrize(("given", "read"), [("bgr8", "rgb8"), ("bgra8", "rgba8")])
def test_reversed_colours_become_the_usual_ones(
    codec: PngCodec | WebpCodec, given: PixelFormat, read: PixelFormat
) -> None:
    data = bytes([1, 2, 3, 4]) if given == "bgra8" else bytes([1, 2, 3])
    message, _ = codec.decode(codec.encode(image(given, 1, 1, data), Header()))
    assert message == image(read, 1, 1, bytes([3, 2, 1, *data[3:]]))


def test_lossy_webp_of_others_is_read() -> None:
    payload = file(Pillow.new("RGB", (40, 30), (200, 100, 50)), "WEBP", quality=80)
    assert payload[12:16] == b"VP8 "
    message, _ = WebpCodec().decode(payload)
    assert isinstance(message, Image)
    assert (message.width, message.height, message.pixel_format) == (40, 30, "rgb8")
    assert message.pixels.data[0] == pytest.approx(200, abs=4)


def test_a_bomb_is_refused_before_pillow_sees_it() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bomb = png(20_000, 20_000, 1, 0, bytes(20_000 * 2501))
        assert len(bomb) < 60_000
        with pytest.raises(DecodeError, match="claims 20000 x 20000 pixels"):
            PngCodec().decode(bomb)


def palette_image(mode: str, palette_mode: str) -> Pillow.Image:
    picture = Pillow.new(mode, (3, 2))
    channels = len(palette_mode)
    picture.putpalette(bytes(range(4 * channels)), palette_mode)
    return picture


def filled(mode: str, size: tuple[int, int] = (5, 3)) -> Pillow.Image:
    empty = Pillow.new(mode, size)
    data = bytes(29 * index % 253 for index in range(len(empty.tobytes())))
    if mode == "1":
        data = bytes(byte & 0xF8 for byte in data)  # 5 pixels in a row
    return Pillow.frombytes(mode, size, data)


def transparent(mode: str, transparency: object) -> Pillow.Image:
    picture = filled(mode) if mode != "P" else palette_image("P", "RGB")
    picture.info["transparency"] = transparency
    return picture


MODES = ["1", "L", "LA", "La", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "LAB", "HSV",
         "I;16", "I;16B", "I", "F"]  # fmt: skip


class TestPillowImages(ValueCodecSuite):
    tag = "PIL.Image.Image"
    release = "0.1.0"
    folder = GOLDENS / "PIL.Image.Image"
    values: ClassVar[Mapping[str, Any]] = {
        **{mode.replace(";", "-"): filled(mode) for mode in MODES},
        "P": palette_image("P", "RGB"),
        "P-alpha": palette_image("P", "RGBA"),
        "PA": palette_image("PA", "RGB"),
        "transparent-L": transparent("L", 5),
        "transparent-RGB": transparent("RGB", (1, 2, 3)),
        "transparent-P": transparent("P", b"\0\xff"),
        "empty": Pillow.new("RGB", (0, 3)),
        "opened": Pillow.open(io.BytesIO(file(filled("RGB"), "PNG"))),
    }
    refused: ClassVar[Sequence[tuple[Any, str]]] = [
        (Pillow.new("I;16L", (1, 1)), "mode 'I;16L' cannot be sent; convert"),
        (
            Pillow.open(
                io.BytesIO(
                    file(
                        Pillow.new("L", (2, 2)),
                        "GIF",
                        save_all=True,
                        append_images=[Pillow.new("L", (2, 2), 9)],
                    )
                )
            ),
            r"image.copy\(\)",
        ),
        (Pillow.open(io.BytesIO(file(filled("RGB", (50, 50)), "PNG")[:200])), "cannot be read"),
    ]
    hostile: ClassVar[Sequence[Any]] = [
        {"mode": "RGB", "size": [1, 1]},
        {"mode": "RGB", "size": [1, 1], "pixels": b"abc"},
        {"mode": "nope", "size": [1, 1], "pixels": Array(b"a", "|u1", (1, 1))},
        {"mode": "L", "size": [1, 2], "pixels": Array(b"a", "|u1", (1, 1))},
        {"mode": "L", "size": [1], "pixels": Array(b"a", "|u1", (1, 1))},
        {"mode": "L", "size": [1, 1], "pixels": Array(b"a", "|i1", (1, 1))},
        {"mode": "L", "size": [-1, -1], "pixels": Array(b"a", "|u1", (1, 1))},
        {"mode": "L", "size": [2**40, 0], "pixels": Array(b"", "|u1", (0, 2**40))},
        *(
            {"mode": mode, "size": [1, 1], "pixels": Array(b"a", "|u1", (1, 1)), **extra}
            for mode, extra in (
                ("L", {"palette": b"abc", "palette_mode": "RGB"}),
                ("P", {"palette": b"abc"}),
                ("P", {"palette": b"abc", "palette_mode": "CMYK"}),
                ("P", {"palette": b"abcd", "palette_mode": "RGB"}),
                ("P", {"palette": bytes(771), "palette_mode": "RGB"}),
                ("P", {"palette": [1, 2, 3], "palette_mode": "RGB"}),
                ("P", {"palette": b"abc", "palette_mode": ["RGB"]}),
                ("L", {"transparency": "red"}),
                ("L", {"transparency": True}),
                ("L", {"transparency": [1, 2]}),
                ("L", {"unknown": 1}),
            )
        ),
    ]

    def same(self, value: Any, other: Any) -> bool:
        return (
            isinstance(value, Pillow.Image)
            and value.mode == other.mode
            and value.size == other.size
            and value.tobytes() == other.tobytes()
            and value.getpalette("RGBA") == other.getpalette("RGBA")
            and value.info.get("transparency") == other.info.get("transparency")
        )

    def any_value(self) -> st.SearchStrategy[Any]:
        def of(mode: str, width: int, height: int) -> Pillow.Image:
            return filled(mode, (8 * width if mode == "1" else width, height))

        return st.builds(of, st.sampled_from(MODES), st.integers(1, 20), st.integers(1, 20))

    def touch(self, value: Any) -> None:
        if isinstance(value, Pillow.Image):
            value.tobytes()
            value.getpalette()
            if value.mode in ("P", "PA", "L", "RGB"):
                value.convert("RGBA")


def test_a_packed_image_is_a_value_of_its_own() -> None:
    original = filled("RGB")
    copy = ImageCodec().unpack(ImageCodec().pack(original))
    copy.putpixel((0, 0), (9, 9, 9))
    assert original.getpixel((0, 0)) != (9, 9, 9)


def test_a_film_may_be_sent_frame_by_frame() -> None:
    film = Pillow.open(
        io.BytesIO(
            file(
                Pillow.new("L", (2, 2)),
                "GIF",
                save_all=True,
                append_images=[Pillow.new("L", (2, 2), 9)],
            )
        )
    )
    with pytest.raises(EncodeError):
        ImageCodec().pack(film)
    film.seek(1)
    assert ImageCodec().pack(film.copy())["size"] == [2, 2]
