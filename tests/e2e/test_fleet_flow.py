"""What watchers get: faces where they are in the image, and the newest for those who are slow."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import statistics
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from vertebra.codec import CodecRegistry
from vertebra.messages import Box, Faces, Image
from vertebra_face_tracking.backend import DetectorOptions, open_detector

from .fleet import Fleet
from .watcher import CAMERA, FACES, FrugalReader, Sighting, dial, order, read_data, watching

FIRST_WITHIN_S: Final = 15.0
NEAR: Final = 0.15
"""How far from each other, in face widths, two detectors may see the middle of one face."""
SLOW_FOR_S: Final = 60.0
SLOW_PERIOD_S: Final = 1 / 3
"""A tenth of the camera's 30 images in a second."""
WEIGH_EVERY_S: Final = 5.0
GROWTH_BYTES: Final = 4 << 20
CODECS: Final = CodecRegistry.installed()


@pytest.fixture(autouse=True)
def all_well(fleet: Fleet) -> None:
    for service in fleet.services():
        fleet.wait_healthy(service)


# --- faces -------------------------------------------------------------------------------------


def shake_head(fleet: Fleet) -> None:
    """Turn the head from side to side, up and down."""
    with fleet.web() as web:
        for side in (1, -1, 1, -1):
            target_deg = {"neck_yaw": 15.0 * side, "neck_pitch": 8.0 * side}
            command = {"positions_deg": target_deg, "velocity_deg_s": 60.0}
            assert web.post("robots/vizzy/head/move", json=command).json()["reached"]


def middles_by_time(images: Iterable[Sighting]) -> dict[int, tuple[float, float]]:
    """Return where a detector of another kind sees the one face, where it sees one."""
    detector = open_detector(
        "haar", DetectorOptions(model="", models_directory=Path(), min_score=0)
    )
    middles = {}
    for sighting in images:
        assert isinstance(sighting.message, Image)
        found = detector.detect(np.asarray(sighting.message.pixels))
        if len(found) == 1:
            middles[sighting.header.captured_ns] = middle(found[0].box)
    return middles


def middle(box: Box) -> tuple[float, float]:
    return box.x + box.width / 2, box.y + box.height / 2


async def test_boxes_stay_on_the_face_while_the_head_moves(fleet: Fleet) -> None:
    async with watching(fleet) as watcher:
        await watcher.newer(FACES, time.time_ns(), timeout_s=FIRST_WITHIN_S)
        collecting = asyncio.create_task(watcher.collect(4.0))
        await asyncio.to_thread(shake_head, fleet)
        seen = await collecting

    elsewhere = middles_by_time(seen[CAMERA])
    boxes = {}
    for sighting in seen[FACES]:
        assert isinstance(sighting.message, Faces)
        if sighting.header.captured_ns in elsewhere and len(sighting.message.faces) == 1:
            boxes[sighting.header.captured_ns] = sighting.message.faces[0].box
    times = sorted(boxes)
    assert len(times) > 40, "most images have one face, found by both, and were joined by time"

    def error(box_ns: int, image_ns: int) -> float:
        distance = math.dist(middle(boxes[box_ns]), elsewhere[image_ns])
        return distance / boxes[box_ns].width

    errors = [error(each, each) for each in times]
    assert max(errors) < NEAR
    late = [error(box_ns, image_ns) for box_ns, image_ns in itertools.pairwise(times)]
    assert statistics.quantiles(late, n=10)[-1] > NEAR, "too slow to tell one image from the next"


# --- slow and fast watchers --------------------------------------------------------------------


@dataclass(slots=True)
class Experience:
    """What a watcher of the camera got."""

    captured_ns: list[int] = field(default_factory=list)
    arrived_ns: list[int] = field(default_factory=list)
    sequences: list[int] = field(default_factory=list)
    told: dict[str, Any] = field(default_factory=dict)
    dropped: int = 0

    def note(self, message: str | bytes) -> bool:
        """Take a message in; say whether it was an image."""
        if isinstance(message, str):
            control = json.loads(message)
            if control["op"] == "drops":
                self.told = control
            return False
        data = read_data(message)
        _, header = CODECS.decode(data.payload, data.encoding)
        self.captured_ns.append(header.captured_ns)
        self.arrived_ns.append(time.time_ns())
        self.sequences.append(header.sequence)
        self.dropped = data.dropped
        return True

    @property
    def passed_by(self) -> int:
        """Images that were sent since the first that came."""
        return self.sequences[-1] - self.sequences[0] + 1

    def check(self) -> None:
        """Hold what came against what was told about the rest."""
        uncounted = self.passed_by - len(self.sequences) - self.dropped
        assert 0 <= uncounted <= 0.02 * self.passed_by, "gone without a word"


async def look_like_page(fleet: Fleet, seen: Experience) -> None:
    """Take a third of a second for each image, in a library that reads ahead."""
    async with dial(fleet, ping_interval=None) as connection:
        await order(connection, "subscribe", id=1, key=CAMERA, window=1)
        async for message in connection:
            if seen.note(message):
                await asyncio.sleep(SLOW_PERIOD_S)
                await order(connection, "ack", id=1)


async def look_frugally(fleet: Fleet, seen: Experience, *, period_s: float) -> None:
    """Take some time for each image, and read nothing meanwhile."""
    async with FrugalReader(fleet) as connection:
        await connection.send(op="subscribe", id=1, key=CAMERA)
        while True:
            if seen.note(await connection.next()):
                await asyncio.sleep(period_s)


@pytest.mark.timeout(SLOW_FOR_S + 60, func_only=True)
async def test_slow_watchers_see_the_newest_and_disturb_nobody(fleet: Fleet) -> None:
    page, program, quick = Experience(), Experience(), Experience()
    sizes: list[int] = []

    async def weigh() -> None:
        while True:
            sizes.append(await asyncio.to_thread(fleet.resident_bytes, "gateway"))
            await asyncio.sleep(WEIGH_EVERY_S)

    async with asyncio.TaskGroup() as group:
        tasks = [
            group.create_task(look_like_page(fleet, page)),
            group.create_task(look_frugally(fleet, program, period_s=SLOW_PERIOD_S)),
            group.create_task(look_frugally(fleet, quick, period_s=0.0)),
            group.create_task(weigh()),
        ]
        await asyncio.sleep(SLOW_FOR_S)
        for task in tasks:
            task.cancel()

    for slow in (page, program):
        assert len(slow.sequences) > 0.8 * SLOW_FOR_S / SLOW_PERIOD_S
        assert all(
            captured_ns > last_but_one_ns
            for captured_ns, last_but_one_ns in zip(
                slow.captured_ns[2:], slow.arrived_ns, strict=False
            )
        ), "an image was older than two of the watcher's periods"
        assert slow.told["dropped"] > 0.8 * (slow.passed_by - len(slow.sequences))
        slow.check()
    quick.check()
    assert len(quick.sequences) > 0.85 * quick.passed_by
    assert quick.passed_by > 0.8 * 30 * SLOW_FOR_S
    assert max(sizes) - min(sizes[2:]) < GROWTH_BYTES, sizes
