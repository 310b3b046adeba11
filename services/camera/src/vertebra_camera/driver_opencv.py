"""OpenCV: opens sources, reads and resizes pictures, in threads that may block."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from vertebra.errors import EncodeError, VertebraError
from vertebra.messages import Array, Image
from vertebra_camera.pipeline import Device, Files, Pace, Stream, target_size

Pixels = NDArray[Any]

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we report, once

RETRY_S: Final = 2.0
NETWORK_TIMEOUT_S: Final = 5.0
_PICTURES: Final = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})
_FALLBACK_RATE_HZ: Final = 25.0


class CaptureError(VertebraError):
    """A source gives no pictures now; it is tried again."""


@dataclass(frozen=True, slots=True)
class Captured:
    """A picture as OpenCV has it: blue, green, red.

    Attributes:
        pixels: Shape (height, width, 3).
        captured_ns: When it was taken, or read from its file.
        part: The source, or the one of its files that holds it.
    """

    pixels: Pixels
    captured_ns: int
    part: str = "source"


@dataclass(frozen=True, slots=True)
class Trouble:
    """What went wrong; after a `CaptureError` the source goes on or is opened anew.

    Attributes:
        error: A bug if it is no `CaptureError`; the thread has ended then.
        part: The source, or one of its files.
    """

    error: Exception
    part: str = "source"


@dataclass(frozen=True, slots=True)
class Ended:
    """Files that are read once have been read."""


Event: TypeAlias = Captured | Trouble | Ended


class CaptureThread(threading.Thread):
    """Reads pictures from a source until it is stopped, and opens it anew when it fails.

    Args:
        source: Where the pictures come from.
        deliver: Gets what was read or what went wrong, in this thread.
        size: Width and height as in `target_size`.
        rate_hz: Pictures per second at the most; that of single pictures.
        loop: Begin files anew when they end.
        credentials: `user:password` of a stream, or empty.
    """

    def __init__(
        self,
        source: Device | Stream | Files,
        deliver: Callable[[Event], None],
        *,
        size: tuple[int, int],
        rate_hz: float,
        loop: bool,
        credentials: str = "",
    ) -> None:
        super().__init__(name="capture", daemon=True)  # OpenCV cannot be interrupted
        self._source = source
        self._deliver = deliver
        self._size = size
        self._rate_hz = rate_hz
        self._pace = Pace(rate_hz)
        self._due_s = 0.0
        self._loop = loop
        self._credentials = credentials
        self._stopping = threading.Event()

    def stop(self) -> None:
        """Let it end as soon as OpenCV comes back."""
        self._stopping.set()

    def run(self) -> None:
        """Read until stopped; called by `start`."""
        while not self._stopping.is_set():
            try:
                for captured in self._pictures():
                    if self._stopping.is_set():
                        return
                    self._deliver(captured)
            except CaptureError as error:
                self._deliver(Trouble(error))
                self._stopping.wait(RETRY_S)
            except Exception as error:  # noqa: BLE001 -- a bug ends the service, not only its thread
                self._deliver(Trouble(error))
                return
            else:
                if not self._loop:
                    self._deliver(Ended())
                    return

    def _pictures(self) -> Iterator[Captured]:
        match self._source:
            case Device(path):
                yield from self._live(path, path, cv2.CAP_V4L2)
            case Stream(url) as stream:
                address = stream.with_credentials(self._credentials) if self._credentials else url
                yield from self._live(address, url, cv2.CAP_FFMPEG)
            case Files(path) if path.is_dir():
                yield from self._files(
                    sorted(file for file in path.iterdir() if file.suffix.lower() in _PICTURES)
                )
            case Files(path) if path.suffix.lower() in _PICTURES:
                yield from self._files([path])
            case Files(path):
                yield from self._video(path)

    def _files(self, paths: list[Path]) -> Iterator[Captured]:
        seen = False
        for path in paths:
            if not self._take_turn(self._rate_hz):
                return
            pixels = cv2.imread(os.fspath(path), cv2.IMREAD_COLOR)
            if pixels is None:
                error = CaptureError(f"{path} is no picture that can be read")
                self._deliver(Trouble(error, part=path.name))
                continue
            seen = True
            yield Captured(self._resized(pixels), time.time_ns(), part=path.name)
        if not seen:
            raise CaptureError(
                f"there is no picture that can be read; known: {', '.join(sorted(_PICTURES))}"
            )

    def _video(self, path: Path) -> Iterator[Captured]:
        if not path.is_file():
            raise CaptureError(f"{path} does not exist")
        with _opened(str(path), str(path), cv2.CAP_FFMPEG) as video:
            rate_hz = video.get(cv2.CAP_PROP_FPS) or _FALLBACK_RATE_HZ
            seen = False
            while self._take_turn(rate_hz):
                if not video.grab():
                    break
                seen = True
                yield from self._retrieved(video, str(path), self._due_s)
            if not seen:
                raise CaptureError(f"{path} holds no picture that can be read")

    def _live(self, address: str, name: str, backend: int) -> Iterator[Captured]:
        with _opened(address, name, backend) as video:
            self._ask_for_size(video)
            while video.grab():
                yield from self._retrieved(video, name, time.monotonic())
        raise CaptureError(f"{name} has stopped")

    def _ask_for_size(self, video: cv2.VideoCapture) -> None:
        """Ask a device for the size; it may give another one."""
        width, height = self._size
        if width and height:
            video.set(cv2.CAP_PROP_FRAME_WIDTH, width)
            video.set(cv2.CAP_PROP_FRAME_HEIGHT, height)

    def _retrieved(self, video: cv2.VideoCapture, name: str, time_s: float) -> Iterator[Captured]:
        """Yield the picture that was just grabbed, unless `time_s` is too early for it."""
        captured_ns = time.time_ns()
        if self._pace.allows(time_s):
            found, pixels = video.retrieve()
            if not found:
                raise CaptureError(f"a picture of {name} cannot be decoded")
            yield Captured(self._resized(pixels), captured_ns)

    def _take_turn(self, rate_hz: float) -> bool:
        """Wait until the next picture of a file is due, without drift; False when stopped."""
        now_s = time.monotonic()
        self._due_s = max(self._due_s + 1 / rate_hz, now_s)
        return not self._stopping.wait(max(0.0, self._due_s - now_s))

    def _resized(self, pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        return resize(pixels, target_size(width, height, self._size))


@contextmanager
def _opened(address: str, name: str, backend: int) -> Iterator[cv2.VideoCapture]:
    """Open a video; `name` is what may be told about `address`."""
    timeout_ms = round(1000 * NETWORK_TIMEOUT_S)
    limits = (
        [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, timeout_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, timeout_ms]
        if backend == cv2.CAP_FFMPEG
        else []
    )
    video = cv2.VideoCapture(address, backend, limits)
    try:
        if not video.isOpened():
            raise CaptureError(f"{name} cannot be opened: is it there, and may we read it?")
        yield video
    finally:
        video.release()


def resize(pixels: Pixels, size: tuple[int, int], *, blend: bool = True) -> Pixels:
    """Return the picture in another size (width, height); the same array if it has that size."""
    height, width = pixels.shape[:2]
    if (width, height) == size:
        return pixels
    shrinks = size[0] * size[1] < width * height
    if not blend:
        return cv2.resize(pixels, size, interpolation=cv2.INTER_NEAREST)
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def resize_message(image: Image, wanted: tuple[int, int]) -> Image:
    """Return an image in the size that `target_size` says.

    Raises:
        EncodeError: It is a Bayer mosaic, which no other size can keep.
    """
    size = target_size(image.width, image.height, wanted)
    if size == (image.width, image.height):
        return image
    if image.pixel_format.startswith("bayer"):
        raise EncodeError(
            f"{image.pixel_format} images cannot be resized; leave width, height at 0"
        )
    # Distances are not blended: between two surfaces there is none.
    pixels = resize(np.asarray(image.pixels), size, blend=image.pixel_format != "depth32f")
    return msgspec.structs.replace(image, pixels=Array.of(np.ascontiguousarray(pixels).data))


def to_message(pixels: Pixels, frame_id: str) -> Image:
    """Return a picture of OpenCV as a message; nothing is copied."""
    data = np.ascontiguousarray(pixels).data
    return Image(pixels=Array.of(data), pixel_format="bgr8", frame_id=frame_id)
