"""Wiring: pictures of one source become images on one key."""

from __future__ import annotations

import asyncio
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from vertebra.bus import Delivery, Subscription
from vertebra.errors import ConfigError, EncodeError
from vertebra.messages import Image
from vertebra.service import Context, MessageReader
from vertebra_camera.driver_opencv import (
    Captured,
    CaptureError,
    CaptureThread,
    Ended,
    Event,
    Trouble,
    resize_message,
    to_message,
)
from vertebra_camera.pipeline import Device, Files, Pace, Relay, Stream, parse_source
from vertebra_camera.settings import CameraSettings

log = logging.getLogger(__name__)

FILES_DEPTH: Final = 8
"""Of files nothing should be missed; of cameras only the newest image counts."""


async def serve(context: Context[CameraSettings]) -> None:
    """Publish images until cancelled."""
    settings = context.settings
    context.routes[settings.source] = settings.key
    source = parse_source(settings.source)
    if isinstance(source, Relay):
        await _relay(context, source.key)
    else:
        await _capture(context, source)


async def _capture(context: Context[CameraSettings], source: Device | Stream | Files) -> None:
    settings = context.settings
    publisher = context.publisher(settings.key, origin=f"camera:{settings.source}")
    published = context.counter("camera_images", "Images that were published")
    failed = context.counter("camera_failures", "Times that the source gave no image")
    depth = FILES_DEPTH if isinstance(source, Files) else 1
    # A failure and a picture wait side by side: neither hides the other.
    events = Subscription[Event](
        settings.source, Delivery.latest(depth), key_of=lambda event: type(event).__name__
    )
    context.gauge(
        "camera_dropped",
        "Images let go because newer ones came first",
        lambda: events.dropped,
    )
    thread = CaptureThread(
        source,
        events.offer,
        size=(settings.width, settings.height),
        rate_hz=settings.max_rate_hz,
        loop=settings.loop,
        credentials=await asyncio.to_thread(_read_credentials, settings.credentials_file),
    )
    thread.start()
    context.ready()
    try:
        async for event in events:
            match event:
                case Captured(pixels, captured_ns, part):
                    context.report("source", "ok")
                    context.report(part, "ok")
                    image = to_message(pixels, settings.frame_id)
                    publisher.publish(image, captured_ns=captured_ns)
                    published.inc()
                case Trouble(CaptureError() as error, part):
                    failed.inc()
                    context.report(part, "error" if part == "source" else "warning", str(error))
                case Trouble(error):
                    raise error
                case Ended():
                    log.info("%s has ended", settings.source)
    finally:
        thread.stop()
        events.close()


async def _relay(context: Context[CameraSettings], key: str) -> None:
    settings = context.settings
    wanted = (settings.width, settings.height)
    publisher = context.publisher(settings.key, origin=f"camera:{settings.source}")
    published = context.counter("camera_images", "Images that were published")
    pace = Pace(settings.max_rate_hz)
    loop = asyncio.get_running_loop()
    with ThreadPoolExecutor(1, thread_name_prefix="resize") as worker:
        async with context.bus.subscribe(key, Delivery.latest()) as images:
            reader = MessageReader(images, context.codecs, Image)
            context.gauge("camera_dropped", "Images let go", lambda: images.dropped)
            context.gauge("camera_lost", "Images lost on the way to here", lambda: images.lost)
            context.gauge("camera_failures", "Images that were unreadable", lambda: reader.refused)
            context.ready()
            async for received in reader:
                header = received.header
                if not pace.allows(time.monotonic()):
                    continue
                try:
                    image = await loop.run_in_executor(
                        worker, resize_message, received.message, wanted
                    )
                except EncodeError as error:
                    context.report("source", "error", str(error))
                    continue
                context.report("source", "ok")
                publisher.publish(image, captured_ns=header.captured_ns, hops=header.hops + 1)
                published.inc()


def _read_credentials(path: Path | None) -> str:
    if path is None:
        return ""
    try:
        credentials = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the credentials file {path} cannot be read: {error}") from error
    if ":" not in credentials:
        raise ConfigError(f"the credentials file {path} does not hold `user:password`")
    return credentials
