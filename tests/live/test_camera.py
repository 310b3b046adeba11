"""The camera service with real files, and with devices and streams that are not there."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError
from vertebra.messages import Array, Image, PixelFormat, Status
from vertebra.service import MessagePublisher, MessageReader, Received, run_service
from vertebra_camera import driver_opencv
from vertebra_camera.adapter import serve
from vertebra_camera.settings import CameraSettings

pytestmark = pytest.mark.live

KEY = "lab/camera/front"
CODECS = CodecRegistry()


@dataclass
class Rig:
    """A running camera, and a bus to talk to it."""

    bus: MemoryBus
    work: asyncio.Task[None]
    images: MessageReader[Image]

    async def take(self, count: int) -> list[Received[Image]]:
        taken: list[Received[Image]] = []
        async with asyncio.timeout(10):
            async for received in self.images:
                taken.append(received)
                if len(taken) == count:
                    return taken
        raise AssertionError

    async def status(self, fits: Callable[[Status], bool]) -> Status:
        async with (
            asyncio.timeout(15),
            self.bus.subscribe("@vertebra/services/camera/1/status", Delivery.latest()) as samples,
        ):
            async for received in MessageReader(samples, CODECS, Status):
                if fits(received.message):
                    return received.message
        raise AssertionError


@asynccontextmanager
async def running(**settings: Any) -> AsyncIterator[Rig]:
    network = MemoryNetwork()
    bus = MemoryBus(network)
    images = MessageReader(bus.subscribe(KEY, Delivery.queue(1000)), CODECS, Image)
    work = asyncio.create_task(
        run_service("camera", CameraSettings(**settings), serve, bus=MemoryBus(network))
    )
    try:
        yield Rig(bus, work, images)
    finally:
        work.cancel()
        await asyncio.wait([work], timeout=5)
        await bus.close()
    assert work.done()
    for _ in range(500):  # the thread ends by itself, when OpenCV comes back
        if not any(thread.name == "capture" for thread in threading.enumerate()):
            return
        await asyncio.sleep(0.01)


def shade(received: Received[Image]) -> int:
    """Return the grey of a picture that is all grey."""
    return int(np.asarray(received.message.pixels).mean().round())


def write_picture(path: Path, grey: int, size: tuple[int, int] = (64, 48)) -> None:
    assert cv2.imwrite(str(path), np.full((size[1], size[0], 3), grey, np.uint8))


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Ten pictures at 25 per second, from dark to light."""
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
    for index in range(10):
        writer.write(np.full((48, 64, 3), 20 * index + 10, np.uint8))
    writer.release()
    return path


async def test_picture_is_shown_again_and_again_at_the_rate(tmp_path: Path) -> None:
    path = tmp_path / "one.png"
    write_picture(path, 77)
    async with running(source=str(path), max_rate_hz=40, frame_id="left") as rig:
        taken = await rig.take(21)
    image, header = taken[-1].message, taken[-1].header
    assert (image.pixel_format, image.width, image.height) == ("bgr8", 64, 48)
    assert image.frame_id == "left"
    assert {shade(received) for received in taken} == {77}
    assert abs(header.captured_ns - time.time_ns()) < 5e9
    assert header.origin == f"camera:{path}"
    seconds = (header.captured_ns - taken[0].header.captured_ns) / 1e9
    assert 0.45 < seconds < 1.5  # never faster; slower where the machine is busy


async def test_folder_is_shown_once_in_order_and_resized(tmp_path: Path) -> None:
    for index, grey in enumerate((10, 100, 200)):
        write_picture(tmp_path / f"{index}.png", grey)
    (tmp_path / "1b.jpg").write_bytes(b"no picture")
    (tmp_path / "notes.txt").write_text("not looked at")
    async with running(source=str(tmp_path), loop=False, width=32, max_rate_hz=100) as rig:
        taken = await rig.take(3)
        status = await rig.status(lambda status: "1b.jpg" in status.text)
        assert status.level == "warning"
        assert status.values["camera_failures"] == 1
        assert status.values["camera_images"] == 3
        assert rig.images.subscription.take() is None
    assert [shade(received) for received in taken] == [10, 100, 200]
    assert {(received.message.width, received.message.height) for received in taken} == {(32, 24)}


async def test_film_plays_at_its_own_speed_and_begins_anew(film: Path) -> None:
    async with running(source=str(film)) as rig:
        taken = await rig.take(21)
    shades = [shade(received) for received in taken]
    expected = [20 * (index % 10) + 10 for index in range(21)]
    assert shades == pytest.approx(expected, abs=4)
    times_ns = [received.header.captured_ns for received in taken]
    assert 0.7 < (times_ns[-1] - times_ns[0]) / 1e9 < 2


async def test_film_is_thinned_out_not_slowed_down(film: Path) -> None:
    async with running(source=str(film), max_rate_hz=5, loop=False) as rig:
        taken = await rig.take(2)
    assert [shade(received) for received in taken] == pytest.approx([10, 110], abs=4)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.mp4", None, "missing.mp4 does not exist"),
        ("broken.mp4", b"no film at all" * 100, "cannot be opened"),
        ("broken.png", b"no picture", "no picture that can be read"),
    ],
)
async def test_file_that_cannot_be_read_is_reported(
    tmp_path: Path, name: str, content: bytes | None, reason: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    async with running(source=str(path)) as rig:
        status = await rig.status(lambda status: "source" in status.text)
    assert status.level == "error"
    assert reason in status.text


async def test_source_that_comes_late_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_opencv, "RETRY_S", 0.05)
    path = tmp_path / "late.png"
    async with running(source=str(path)) as rig:
        await rig.status(lambda status: "late.png" in status.text)
        draft = tmp_path / "draft.png"
        write_picture(draft, 50)
        draft.rename(path)
        assert shade((await rig.take(1))[0]) == 50
        await rig.status(lambda status: status.level == "ok")


async def test_device_that_is_not_there_is_reported_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(driver_opencv, "RETRY_S", 0.05)
    async with running(source="/dev/video99") as rig:
        status = await rig.status(lambda status: float(status.values["camera_failures"]) > 2)
    assert "/dev/video99 cannot be opened" in status.text
    assert status.level == "error"


async def test_stream_that_refuses_or_keeps_silent_is_reported_without_the_password(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_opencv, "NETWORK_TIMEOUT_S", 0.5)
    monkeypatch.setattr(driver_opencv, "RETRY_S", 0.05)
    secret = tmp_path / "credentials"
    secret.write_text("me:hunter2\n")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        source = f"rtsp://127.0.0.1:{silent.getsockname()[1]}/left"
        async with running(source=source, credentials_file=secret) as rig:
            status = await rig.status(lambda status: float(status.values["camera_failures"]) > 1)
            info = await rig.bus.call("@vertebra/services/camera/1/info", timeout_s=5)
    assert f"{source} cannot be opened" in status.text
    assert "hunter2" not in status.text
    assert b"hunter2" not in info.payload


async def test_credentials_must_be_readable(tmp_path: Path) -> None:
    source = "rtsp://127.0.0.1:1/"
    for content, reason in ((None, "cannot be read"), ("nocolon", "user:password")):
        path = tmp_path / "credentials"
        if content:
            path.write_text(content)
        async with running(source=source, credentials_file=path) as rig:
            with pytest.raises(ConfigError, match=reason):
                await rig.work


def of_format(pixel_format: PixelFormat, pixels: np.ndarray[Any, Any]) -> Image:
    return Image(pixels=Array.of(pixels.data), pixel_format=pixel_format, frame_id="eye")


async def test_relay_resizes_every_format_and_keeps_the_capture_time() -> None:
    async with running(source="key:vizzy/camera/left", width=16, height=8, max_rate_hz=1000) as rig:
        await rig.status(lambda status: status.level == "ok")
        publisher = MessagePublisher(rig.bus, CODECS, "vizzy/camera/left", origin="test")
        formats: list[Image] = [
            of_format("rgb8", np.full((48, 64, 3), (10, 20, 30), np.uint8)),
            of_format("mono16", np.full((48, 64), 50_000, "<u2")),
            of_format(
                "depth32f", np.repeat(np.array([[1.0], [3.0]], "<f4"), 24, axis=0).repeat(64, 1)
            ),
            of_format("rgba8", np.full((8, 16, 4), 7, np.uint8)),
        ]
        for index, image in enumerate(formats):
            await asyncio.sleep(0.002)  # at most 1000 in a second
            publisher.publish(image, captured_ns=1000 + index)
            (received,) = await rig.take(1)
            out = received.message
            assert (out.width, out.height, out.pixel_format) == (16, 8, image.pixel_format)
            assert out.frame_id == "eye"
            assert (received.header.captured_ns, received.header.hops) == (1000 + index, 1)
            values = np.unique(np.asarray(out.pixels))
            assert set(values) <= set(np.unique(np.asarray(image.pixels)))


async def test_relay_reports_what_it_cannot_resize_and_goes_on() -> None:
    async with running(source="key:vizzy/camera/left", width=16, max_rate_hz=1000) as rig:
        await rig.status(lambda status: status.level == "ok")
        publisher = MessagePublisher(rig.bus, CODECS, "vizzy/camera/left", origin="test")
        publisher.publish(of_format("bayer_rggb8", np.zeros((48, 64), np.uint8)))
        status = await rig.status(lambda status: status.level == "error")
        assert "leave width, height at 0" in status.text
        publisher.publish(of_format("mono8", np.zeros((48, 64), np.uint8)))
        assert (await rig.take(1))[0].message.width == 16
