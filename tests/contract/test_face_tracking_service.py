"""The face tracking service on a bus in memory, from images to faces."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork, Sample, Subscription
from vertebra.codec import ENCODING, CodecRegistry
from vertebra.errors import ConfigError
from vertebra.messages import Array, Box, Faces, Header, Image, Message, Status, Text
from vertebra.service import MessagePublisher, MessageReader, Received, run_service, service_key
from vertebra_face_tracking import adapter
from vertebra_face_tracking.adapter import serve
from vertebra_face_tracking.backend import Detection, Detector, DetectorOptions, RgbImage
from vertebra_face_tracking.models import ModelMissingError
from vertebra_face_tracking.settings import FaceTrackingSettings

LEFT, RIGHT = "vizzy/camera/left", "vizzy/camera/right"
NAME = "face_tracking"
PORTRAIT = Path(__file__).parents[1] / "data" / "astronaut.jpg"
START_NS = 1_700_000_000_000_000_000
WITHIN_S = 10.0
GREY = Image(pixels=Array(bytes(48 * 64), "|u1", (48, 64)), pixel_format="mono8")


class Stub:
    """A detector that sees one face everywhere, and can be held up or broken."""

    name = "stub"
    version = "1"

    def __init__(self) -> None:
        self.called = threading.Semaphore(0)
        self.go_on = threading.Event()
        self.go_on.set()
        self.error: Exception | None = None

    def detect(self, image: RgbImage) -> list[Detection]:
        self.called.release()
        if not self.go_on.wait(WITHIN_S):
            raise TimeoutError("the test forgot this detector")
        if self.error is not None:
            raise self.error
        return [Detection(box=Box(x=10, y=10, width=20, height=20), score=0.9)]

    async def wait_until_called(self) -> None:
        assert await asyncio.to_thread(self.called.acquire, timeout=WITHIN_S)


@dataclass
class Rig:
    """A running service, and a bus to talk to it."""

    bus: MemoryBus
    work: asyncio.Task[None]
    watching: asyncio.Event
    viewer: Subscription[Sample]
    codecs: CodecRegistry = field(default_factory=CodecRegistry)

    def read(self, key: str, wanted: type[Message]) -> AsyncIterator[Received[Any]]:
        subscription = self.bus.subscribe(key, Delivery.queue(1000))
        return aiter(MessageReader(subscription, self.codecs, wanted))

    def camera(self, key: str) -> MessagePublisher:
        return MessagePublisher(self.bus, self.codecs, key, origin="test")

    async def next(self, messages: AsyncIterator[Received[Any]]) -> Received[Any]:
        async with asyncio.timeout(WITHIN_S):
            return await anext(messages)

    async def status(self, fits: Callable[[Status], bool]) -> Status:
        """Wait for a status that fits; the service tells it all the time."""
        async with self.bus.subscribe(
            service_key(NAME, "1", "status"), Delivery.latest()
        ) as subscription:
            messages = aiter(MessageReader(subscription, self.codecs, Status))
            while True:
                status: Status = (await self.next(messages)).message
                if fits(status):
                    return status

    async def ready(self) -> None:
        await self.status(lambda status: status.level == "ok")
        await asyncio.wait_for(self.watching.wait(), WITHIN_S)

    async def metrics(self) -> dict[str, float]:
        reply = await self.bus.call(service_key(NAME, "1", "metrics"), timeout_s=WITHIN_S)
        return {
            sample.name: sample.value
            for family in text_string_to_metric_families(reply.payload.decode())
            for sample in family.samples
        }


async def film(camera: MessagePublisher) -> None:
    """Publish 200 images per second."""
    while True:
        camera.publish(GREY)
        await asyncio.sleep(0.005)


@asynccontextmanager
async def running(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **settings: Any
) -> AsyncIterator[Rig]:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    monkeypatch.setattr("vertebra.service.run._BEAT_EVERY_S", 0.05)
    network = MemoryNetwork()
    bus = MemoryBus(network)
    in_force = FaceTrackingSettings(**settings)
    viewer = bus.subscribe(f"{in_force.input}/faces", Delivery.latest())
    watching = asyncio.Event()
    bus.follow_demand(in_force.input, lambda wanted: watching.set() if wanted else watching.clear())
    work = asyncio.create_task(run_service(NAME, in_force, serve, bus=MemoryBus(network)))
    try:
        yield Rig(bus, work, watching, viewer)
    finally:
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)
        await bus.close()


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch) -> Stub:
    made = Stub()

    def open_stub(name: str, options: DetectorOptions) -> Detector:
        return made

    monkeypatch.setattr(adapter, "open_detector", open_stub)
    return made


@pytest.fixture
async def rig(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stub: Stub) -> AsyncIterator[Rig]:
    async with running(monkeypatch, tmp_path, max_rate_hz=1000) as rig:
        await rig.ready()
        yield rig


async def test_an_image_becomes_faces_of_the_same_instant(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    read = cv2.imread(str(PORTRAIT))
    assert read is not None
    image = Image(pixels=Array(read.tobytes(), "|u1", read.shape), pixel_format="bgr8")
    async with running(monkeypatch, tmp_path, backend="haar") as rig:
        await rig.ready()
        results = rig.read(f"{LEFT}/faces", Faces)
        camera = rig.camera(LEFT)

        for number in range(2):
            camera.publish(image, captured_ns=START_NS + number * 50_000_000)
            received = await rig.next(results)

            faces: Faces = received.message
            assert received.header.captured_ns == START_NS + number * 50_000_000
            assert received.header.origin == NAME
            assert (faces.image_width, faces.image_height) == (512, 512)
            assert faces.backend.startswith("haar-frontalface (opencv-4.")
            (face,) = faces.faces
            assert face.track_id == 1
            centre = face.box.x + face.box.width / 2, face.box.y + face.box.height / 2
            assert np.hypot(centre[0] - 222, centre[1] - 118) < 20

        measured = await rig.metrics()
        assert measured["vertebra_face_tracking_images_total"] == 2
        assert measured["vertebra_face_tracking_inference_s"] > 0
        assert measured["vertebra_face_tracking_age_s"] > 1e6  # the images say they are of 2023


async def test_an_image_without_faces_is_an_empty_result(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async with running(monkeypatch, tmp_path, backend="haar") as rig:
        await rig.ready()
        results = rig.read(f"{LEFT}/faces", Faces)
        rig.camera(LEFT).publish(GREY, captured_ns=START_NS)

        assert (await rig.next(results)).message.faces == ()


BAD_PAYLOADS = {
    "rubbish": b"rubbish",
    "cut": bytes(CodecRegistry().encode(GREY, Header(captured_ns=1))[0])[:-1],
    "another message": bytes(CodecRegistry().encode(Text(text="hello"), Header())[0]),
    "no pixels": bytes(
        CodecRegistry().encode(
            Image(pixels=Array(b"", "|u1", (0, 9)), pixel_format="mono8"), Header()
        )[0]
    ),
}


@pytest.mark.parametrize("payload", BAD_PAYLOADS.values(), ids=BAD_PAYLOADS.keys())
async def test_a_bad_image_is_reported_and_the_next_one_is_looked_at(
    rig: Rig, payload: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(adapter, "REPORT_EVERY_S", 0.2)
    results = rig.read(f"{LEFT}/faces", Faces)
    rig.bus.publisher(LEFT, encoding=ENCODING).put(payload)

    status = await rig.status(lambda status: status.level == "warning")
    assert f"images: {LEFT}: " in status.text
    assert status.values["face_tracking_failed_images"] == 1

    rig.camera(LEFT).publish(GREY, captured_ns=START_NS)
    received = await rig.next(results)
    assert received.header.captured_ns == START_NS  # the bad image gave no result at all
    assert len(received.message.faces) == 1

    filming = asyncio.create_task(film(rig.camera(LEFT)))
    await rig.ready()  # good images go on, so the report is taken back
    filming.cancel()


async def test_a_detector_that_fails_gives_a_report_and_no_result(rig: Rig, stub: Stub) -> None:
    results = rig.read(f"{LEFT}/faces", Faces)
    camera = rig.camera(LEFT)
    stub.error = RuntimeError("out of memory")
    camera.publish(GREY, captured_ns=START_NS)

    status = await rig.status(lambda status: status.level == "warning")
    assert "stub failed: RuntimeError('out of memory')" in status.text

    stub.error = None
    camera.publish(GREY, captured_ns=START_NS + 1)
    assert (await rig.next(results)).header.captured_ns == START_NS + 1


async def test_many_failures_are_counted_and_told_once(
    rig: Rig, stub: Stub, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(20):
        stub.error = RuntimeError(f"failure {number}")
        rig.camera(LEFT).publish(GREY)
        await stub.wait_until_called()

    await rig.status(lambda status: status.values["face_tracking_failed_images"] == 20)
    assert sum("RuntimeError" in record.message for record in caplog.records) == 1


async def test_a_slow_detector_sees_the_newest_image_and_counts_the_others(
    rig: Rig, stub: Stub
) -> None:
    results = rig.read(f"{LEFT}/faces", Faces)
    camera = rig.camera(LEFT)
    stub.go_on.clear()
    camera.publish(GREY, captured_ns=START_NS)
    await stub.wait_until_called()

    for number in range(1, 11):
        camera.publish(GREY, captured_ns=START_NS + number)
    stub.go_on.set()

    seen = [(await rig.next(results)).header.captured_ns - START_NS for _ in range(2)]
    assert seen == [0, 10]
    assert (await rig.metrics())["vertebra_face_tracking_dropped_images"] == 9


async def test_the_event_loop_is_free_while_the_detector_works(rig: Rig, stub: Stub) -> None:
    stub.go_on.clear()
    rig.camera(LEFT).publish(GREY)
    await stub.wait_until_called()

    assert await rig.metrics()  # the service still answers
    stub.go_on.set()


async def test_a_fast_camera_does_not_starve_a_slow_one(rig: Rig, stub: Stub) -> None:
    results = rig.read(f"{RIGHT}/faces", Faces)
    stub.go_on.clear()
    rig.camera(LEFT).publish(GREY)
    await stub.wait_until_called()
    for _ in range(50):
        rig.camera(LEFT).publish(GREY)
    rig.camera(RIGHT).publish(GREY, captured_ns=START_NS)
    for _ in range(50):
        rig.camera(LEFT).publish(GREY)
    stub.go_on.set()

    assert (await rig.next(results)).header.captured_ns == START_NS
    await rig.status(lambda status: status.values["face_tracking_images"] == 3)


async def test_cameras_are_followed_apart_and_share_no_ids(rig: Rig) -> None:
    seen: dict[str, list[int]] = {}
    for key in (LEFT, RIGHT, LEFT, RIGHT):
        results = rig.read(f"{key}/faces", Faces)
        rig.camera(key).publish(GREY, captured_ns=START_NS + len(seen))
        faces = (await rig.next(results)).message.faces
        seen.setdefault(key, []).append(faces[0].track_id)

    assert seen == {LEFT: [1, 1], RIGHT: [2, 2]}


async def test_cameras_that_come_and_go_do_not_pile_up(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(adapter, "MAX_CAMERAS", 3)
    before = len(rig.bus.network.subscriptions)
    for number in range(10):
        key = f"vizzy/camera/{number}"
        results = rig.read(f"{key}/faces", Faces)
        rig.camera(key).publish(GREY, captured_ns=START_NS)
        assert (await rig.next(results)).message.faces[0].track_id == number + 1

    # The first camera was forgotten: its face is a new one, under an id that nobody had.
    results = rig.read("vizzy/camera/0/faces", Faces)
    rig.camera("vizzy/camera/0").publish(GREY, captured_ns=START_NS + 1)
    assert (await rig.next(results)).message.faces[0].track_id == 11
    assert len(rig.bus.network.subscriptions) == before + 11  # all of them ours


async def test_the_rate_is_limited(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stub: Stub
) -> None:
    async with running(monkeypatch, tmp_path, max_rate_hz=20) as rig:
        await rig.ready()
        results = rig.read(f"{LEFT}/faces", Faces)
        loop = asyncio.get_running_loop()

        filming = asyncio.create_task(film(rig.camera(LEFT)))
        await rig.next(results)
        started_s = loop.time()
        for _ in range(10):
            await rig.next(results)
        elapsed_s = loop.time() - started_s
        filming.cancel()

        assert elapsed_s >= 0.44  # one image may be early


async def test_a_service_without_its_model_is_up_and_says_what_mends_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    models = tmp_path / "models"
    async with running(monkeypatch, tmp_path, VERTEBRA_MODELS=models) as rig:
        results = rig.bus.subscribe(f"{LEFT}/faces", Delivery.latest())
        rig.camera(LEFT).publish(GREY)

        status = await rig.status(lambda status: "model missing" in status.text)

        assert status.level == "error"
        assert f"vertebra_face_tracking.models fetch blazeface-full-range --into {models}" in (
            status.text
        )
        assert results.take() is None
        assert not rig.work.done()


async def test_a_model_that_arrives_later_is_taken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    answers: list[Stub | ModelMissingError] = [ModelMissingError("model missing")] * 2
    answers.append(Stub())

    def open_later(name: str, options: DetectorOptions) -> Detector:
        answer = answers.pop(0)
        if isinstance(answer, ModelMissingError):
            raise answer
        return answer

    monkeypatch.setattr(adapter, "open_detector", open_later)
    monkeypatch.setattr(adapter, "RETRY_S", 0.05)
    async with running(monkeypatch, tmp_path) as rig:
        await rig.ready()
        results = rig.read(f"{LEFT}/faces", Faces)
        rig.camera(LEFT).publish(GREY)

        assert (await rig.next(results)).message.faces


async def test_an_unknown_backend_stops_the_service(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async with running(monkeypatch, tmp_path, backend="yolo") as rig:
        with pytest.raises(ConfigError, match="no face detector 'yolo'; installed are"):
            async with asyncio.timeout(WITHIN_S):
                await rig.work


async def test_it_stops_at_once_even_while_the_detector_works(rig: Rig, stub: Stub) -> None:
    stub.go_on.clear()
    rig.camera(LEFT).publish(GREY)
    await stub.wait_until_called()

    rig.work.cancel()
    done, _ = await asyncio.wait([rig.work], timeout=2)
    stub.go_on.set()

    assert done


async def test_nobody_looks_at_images_that_nobody_asks_about(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stub: Stub
) -> None:
    async with running(monkeypatch, tmp_path) as rig:
        await rig.ready()
        rig.viewer.close()
        async with asyncio.timeout(WITHIN_S):
            while rig.watching.is_set():
                await asyncio.sleep(0.01)
        rig.camera("vizzy/camera/left").publish(GREY)
        faces = rig.read("vizzy/camera/left/faces", Faces)
        await asyncio.wait_for(rig.watching.wait(), WITHIN_S)
        rig.camera("vizzy/camera/left").publish(GREY, captured_ns=7)
        received = await rig.next(faces)
    assert received.header.captured_ns == 7
    assert stub.called.acquire(blocking=False)
    assert not stub.called.acquire(blocking=False)
