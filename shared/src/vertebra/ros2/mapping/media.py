"""Images, sound and text."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from msgspec import Struct

from vertebra.errors import DecodeError
from vertebra.messages import (
    PIXELS,
    Array,
    AudioChunk,
    CompressedImage,
    Image,
    PixelFormat,
    Text,
    item_bytes,
)
from vertebra.ros2.mapping.parts import Record, frame_id, header

DEPTH: Final = "32FC1"
"""`Image.encoding` of distances in metres, our `depth32f`; all others have the same name here."""
COMPRESSED_DEPTH: Final = "application/vnd.ros.compressed-depth"
"""What compressed_depth_image_transport sends: a header of 12 bytes, and a PNG or RVL."""

_FILES: Final = (
    (b"\xff\xd8\xff", "image/jpeg"),
    (b"\x89PNG\r\n\x1a\n", "image/png"),
    (b"RIFF", "image/webp"),
    (b"II*\0", "image/tiff"),
    (b"MM\0*", "image/tiff"),
    (b"GIF8", "image/gif"),
    (b"BM", "image/bmp"),
)
"""How files begin."""
_STREAMS: Final = {
    "h264": "video/h264", "h265": "video/h265", "hevc": "video/h265", "av1": "video/av1",
    "vp8": "video/vp8", "vp9": "video/vp9",
    "jpeg": "image/jpeg", "jpg": "image/jpeg", "png": "image/png", "webp": "image/webp",
    "tiff": "image/tiff",
}  # fmt: skip
"""What words in `CompressedImage.format` mean, where the data does not say it itself."""
_SAMPLES: Final[dict[str, str]] = {"S16LE": "<i2", "F32LE": "<f4"}
_PORTAUDIO: Final = {1: ("float32_data", "<f4"), 8: ("int16_data", "<i2")}
"""Where the samples of a `paFloat32` and a `paInt16` are."""


class Sound(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the bytes of an `AudioData` are, which does not say it itself.

    Attributes:
        rate_hz: Instants per second.
        channels: Interleaved samples of one instant.
        format: Of one sample, as GStreamer calls it.
    """

    rate_hz: int
    channels: int = 1
    format: Literal["S16LE", "F32LE"] = "S16LE"


def text(record: Record) -> Text:
    """Read a `String`."""
    return Text(text=record["data"])


def of_text(message: Text, _: int) -> Record:
    """Make a `String`."""
    return {"data": message.text}


def image(record: Record) -> Image | None:
    """Read an `Image`; its pixels stay where they are unless rows or bytes have to move."""
    pixel_format = _pixel_format(record["encoding"])
    if pixel_format is None:
        return None
    dtype, channels = PIXELS[pixel_format]
    height, width, step = record["height"], record["width"], record["step"]
    size = item_bytes(dtype)
    row_bytes = width * channels * size
    data: memoryview = record["data"].data
    if step < row_bytes or data.nbytes != height * step:
        raise DecodeError(
            f"{data.nbytes} bytes are no {width} x {height} image of {pixel_format} "
            f"with rows of {step} bytes"
        )
    if step != row_bytes and data.nbytes:
        rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, :row_bytes]
        data = np.ascontiguousarray(rows).reshape(-1).data
    if record["is_bigendian"] and size > 1 and data.nbytes:
        data = np.frombuffer(data, f"u{size}").byteswap().view(np.uint8).data
    shape = (height, width) + ((channels,) if channels > 1 else ())
    return Image(
        pixels=Array(data, dtype, shape), pixel_format=pixel_format, frame_id=frame_id(record)
    )


def _pixel_format(encoding: str) -> PixelFormat | None:
    if encoding == DEPTH:
        return "depth32f"
    return encoding if encoding in PIXELS and encoding != "depth32f" else None  # type: ignore[return-value]


def of_image(message: Image, stamp_ns: int) -> Record:
    """Make an `Image`."""
    pixels = message.pixels
    return {
        "header": header(message.frame_id, stamp_ns),
        "height": message.height,
        "width": message.width,
        "encoding": DEPTH if message.pixel_format == "depth32f" else message.pixel_format,
        "is_bigendian": 0,
        "step": pixels.nbytes // message.height if message.height else 0,
        "data": pixels.data,
    }


def compressed(record: Record) -> CompressedImage:
    """Read a `CompressedImage` of any format."""
    data: Array = record["data"]
    return CompressedImage(
        data=data,
        media_type=_media_type(record["format"].lower(), bytes(data.data[:12])),
        frame_id=frame_id(record),
        format=record["format"],
    )


def _media_type(words: str, beginning: bytes) -> str:
    if "compresseddepth" in words:
        return COMPRESSED_DEPTH
    by_data = (media_type for magic, media_type in _FILES if beginning.startswith(magic))
    by_words = (media_type for word, media_type in _STREAMS.items() if word in words)
    return next(by_data, None) or next(by_words, "application/octet-stream")


def of_compressed(message: CompressedImage, stamp_ns: int) -> Record:
    """Make a `CompressedImage`."""
    return {
        "header": header(message.frame_id, stamp_ns),
        "format": message.format or message.media_type.removeprefix("image/"),
        "data": message.data,
    }


def audio_data(record: Record, sound: Sound | None) -> AudioChunk | None:
    """Read an `AudioData` or `AudioDataStamped` of ros-drivers, if somebody says what it is."""
    data = record.get("audio", record).get("data")
    if sound is None or data is None:
        return None
    frame = frame_id(record) if "header" in record else ""
    return _chunk(data, _SAMPLES[sound.format], sound.channels, sound.rate_hz, frame)


def _chunk(data: Array, dtype: str, channels: int, rate_hz: int, frame: str) -> AudioChunk:
    bytes_each = channels * item_bytes(dtype)
    if bytes_each < 1 or data.nbytes % bytes_each:
        raise DecodeError(f"{data.nbytes} bytes are no samples {dtype!r} of {channels} channels")
    shape = (data.nbytes // bytes_each, channels)
    return AudioChunk(samples=Array(data.data, dtype, shape), rate_hz=rate_hz, frame_id=frame)


def of_audio_data(message: AudioChunk, _: int = 0) -> Record:
    """Make an `AudioData`."""
    return {"data": message.samples.data}


def of_audio_data_stamped(message: AudioChunk, stamp_ns: int) -> Record:
    """Make an `AudioDataStamped`."""
    return {"header": header(message.frame_id, stamp_ns), "audio": of_audio_data(message)}


def of_audio_info(message: AudioChunk, _: int) -> Record:
    """Make the `AudioInfo` that says what the `AudioData` of the same message are."""
    samples = message.samples
    channels = samples.shape[1]
    name = next(name for name, dtype in _SAMPLES.items() if dtype == samples.dtype)
    return {
        "channels": channels,
        "sample_rate": message.rate_hz,
        "sample_format": name,
        "bitrate": 8 * item_bytes(samples.dtype) * channels * message.rate_hz,
        "coding_format": "wave",
    }


def audio(record: Record, frame: str = "") -> AudioChunk | None:
    """Read an `Audio` of mgonzs13's package; only 16 bits and floats have a message."""
    info = record["info"]
    if info["format"] not in _PORTAUDIO:
        return None
    field, dtype = _PORTAUDIO[info["format"]]
    return _chunk(record["audio_data"][field], dtype, info["channels"], info["rate"], frame)


def of_audio(message: AudioChunk, _: int = 0) -> Record:
    """Make an `Audio`."""
    samples = message.samples
    form = next(form for form, (_, dtype) in _PORTAUDIO.items() if dtype == samples.dtype)
    field, dtype = _PORTAUDIO[form]
    instants, channels = samples.shape
    return {
        "audio_data": {field: Array(samples.data, dtype, (instants * channels,))},
        "info": {
            "format": form,
            "channels": channels,
            "rate": message.rate_hz,
            "chunk": instants,
        },
    }


def audio_stamped(record: Record) -> AudioChunk | None:
    """Read an `AudioStamped`."""
    return audio(record["audio"], frame_id(record))


def of_audio_stamped(message: AudioChunk, stamp_ns: int) -> Record:
    """Make an `AudioStamped`."""
    return {"header": header(message.frame_id, stamp_ns), "audio": of_audio(message)}
