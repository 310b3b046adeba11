"""The service's work: newest images in, faces out, one detector in one thread."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Final

import cv2

from vertebra.bus import Delivery, Sample, Subscription
from vertebra.errors import CodecError
from vertebra.messages import Faces, Image
from vertebra.service import Context, MessagePublisher, MessageReader
from vertebra_face_tracking.backend import Detector, DetectorError, DetectorOptions, open_detector
from vertebra_face_tracking.models import ModelMissingError
from vertebra_face_tracking.pipeline import find_faces
from vertebra_face_tracking.settings import RESULT, FaceTrackingSettings
from vertebra_face_tracking.tracker import Tracker

MAX_CAMERAS: Final = 64
"""The camera that was silent longest is forgotten when there are more."""
RETRY_S: Final = 5.0
REPORT_EVERY_S: Final = 5.0


async def serve(context: Context[FaceTrackingSettings]) -> None:
    """Look at images until cancelled; as long as the model is missing, say so and wait for it."""
    cv2.setNumThreads(1)  # the cores are shared with the other services
    worker = ThreadPoolExecutor(1, thread_name_prefix="face-detector")
    try:
        detector = await _open(context, worker)
        await _FaceTracking(context, detector, worker).run()
    finally:
        worker.shutdown(wait=False)


async def _open(context: Context[FaceTrackingSettings], worker: Executor) -> Detector:
    settings = context.settings
    options = DetectorOptions(settings.model, settings.models_directory, settings.min_score)
    loop = asyncio.get_running_loop()
    while True:
        try:
            detector = await loop.run_in_executor(worker, open_detector, settings.backend, options)
        except ModelMissingError as error:
            context.report("detector", "error", str(error))
            await asyncio.sleep(RETRY_S)
        else:
            context.report("detector", "ok")
            return detector


@dataclass(frozen=True, slots=True)
class _Camera:
    tracker: Tracker
    publisher: MessagePublisher


class _FaceTracking:
    """The running service: its cameras and its measurements."""

    def __init__(
        self, context: Context[FaceTrackingSettings], detector: Detector, worker: Executor
    ) -> None:
        self._context = context
        self._detector = detector
        self._worker = worker
        self._ids = count(1)
        self._cameras: OrderedDict[str, _Camera] = OrderedDict()
        self._quiet_until_s = 0.0
        settings = context.settings
        self._wanted = asyncio.Event()
        self._images: Subscription[Sample] | None = None
        self._dropped = 0
        self._lost = 0
        context.routes[settings.input] = f"{settings.input}/{RESULT}"
        self._analysed = context.counter(
            "face_tracking_images", "Images whose faces were published"
        )
        self._failed = context.counter(
            "face_tracking_failed_images", "Images that could not be analysed"
        )
        self._inference_s = context.gauge("face_tracking_inference_s", "Time the last image took")
        self._age_s = context.gauge("face_tracking_age_s", "Time from the last image to its result")
        context.gauge(
            "face_tracking_dropped_images",
            "Images let go because newer ones came first",
            lambda: self._dropped + (self._images.dropped if self._images else 0),
        )
        context.gauge(
            "face_tracking_lost_images",
            "Images lost on the way to here",
            lambda: self._lost + (self._images.lost if self._images else 0),
        )

    async def run(self) -> None:
        """Look at the newest image of each camera in turn, while anybody wants to know."""
        settings = self._context.settings
        self._context.bus.follow_demand(f"{settings.input}/{RESULT}", self._on_wanted)
        self._context.ready()
        while True:
            await self._wanted.wait()
            async with self._context.bus.subscribe(settings.input, Delivery.latest()) as images:
                self._images = images
                await self._follow(images)
            self._dropped += images.dropped
            self._lost += images.lost
            self._images = None

    def _on_wanted(self, wanted: bool) -> None:  # noqa: FBT001  - called back
        if wanted:
            self._wanted.set()
        else:
            self._wanted.clear()
            if self._images is not None:
                self._images.close()

    async def _follow(self, images: Subscription[Sample]) -> None:
        reader = MessageReader(images, self._context.codecs, Image)
        interval_s = 1 / self._context.settings.max_rate_hz
        due_s = 0.0
        async for sample in images:
            # Counted from when this one was due: an image that came late delays no other.
            due_s = max(due_s + interval_s, time.monotonic())
            await self._look(sample, reader)
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))

    async def _look(self, sample: Sample, reader: MessageReader[Image]) -> None:
        camera = self._camera(sample.key)
        try:
            received = reader.read(sample)
            captured_ns = received.header.captured_ns
            work = partial(self._analyse, received.message, captured_ns, camera.tracker)
            faces = await asyncio.get_running_loop().run_in_executor(self._worker, work)
        except (CodecError, DetectorError) as error:
            self._report_failure(f"{sample.key}: {error}")
            return
        camera.publisher.publish(faces, captured_ns=captured_ns)
        self._analysed.inc()
        self._age_s.set((time.time_ns() - captured_ns) / 1e9)
        if time.monotonic() >= self._quiet_until_s:
            self._context.report("images", "ok")

    def _analyse(self, image: Image, captured_ns: int, tracker: Tracker) -> Faces:
        """Run in the worker's thread."""
        started_s = time.perf_counter()
        faces = find_faces(image, captured_ns, self._detector, tracker)
        self._inference_s.set(time.perf_counter() - started_s)
        return faces

    def _camera(self, key: str) -> _Camera:
        camera = self._cameras.get(key)
        if camera is None:
            camera = _Camera(
                Tracker(self._ids, keep_s=self._context.settings.keep_s),
                self._context.publisher(f"{key}/{RESULT}"),
            )
            self._cameras[key] = camera
        self._cameras.move_to_end(key)
        if len(self._cameras) > MAX_CAMERAS:
            _, oldest = self._cameras.popitem(last=False)
            oldest.publisher.close()
        return camera

    def _report_failure(self, text: str) -> None:
        """Count a failure and show it, at most one in `REPORT_EVERY_S`."""
        self._failed.inc()
        now_s = time.monotonic()
        if now_s >= self._quiet_until_s:
            self._context.report("images", "warning", text)
            self._quiet_until_s = now_s + REPORT_EVERY_S
