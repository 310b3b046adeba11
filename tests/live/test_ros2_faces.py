"""Faces of the fleet as a ROS4HRI node sees them."""

from __future__ import annotations

import asyncio
import functools
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vertebra.messages import (
    Array,
    Box,
    Expression,
    Expressions,
    Face,
    Faces,
    HeadPose,
    HeadPoses,
    Image,
    Message,
)
from vertebra.service import MessagePublisher
from vertebra_ros2 import humans

from .ros2_lab import Lab, Peer, lab_with, peer

pytestmark = pytest.mark.live

ROUTES = """
humans:
  - {key: cam/faces, image: cam, expressions: cam/expressions, head_poses: cam/poses,
     frame_id: cam_optical, field_of_view_deg: 60}
"""
GREEN = (0, 200, 0)


def face(track_id: int, x: float = 60.0) -> Face:
    return Face(
        track_id=track_id,
        box=Box(x=x, y=20.0, width=40.0, height=60.0),
        score=0.75,
        landmarks={"right_eye": (x + 10, 40.0), "left_eye": (x + 30, 40.0)},
    )


def faces(*track_ids: int) -> Faces:
    return Faces(faces=tuple(map(face, track_ids)), image_width=160, image_height=120)


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    async with lab_with(tmp_path, ROUTES) as lab:
        yield lab


class Camera:
    """What perception publishes of one camera, until the test ends."""

    def __init__(self, lab: Lab) -> None:
        self.track_ids: tuple[int, ...] = ()
        self.sent_ns: set[int] = set()
        self.wanted: dict[str, bool] = {}
        self._lab = lab
        self._demands = [
            lab.bus.follow_demand(key, functools.partial(self.wanted.__setitem__, key))
            for key in ("cam", "cam/faces", "cam/expressions", "cam/poses")
        ]
        self._work = asyncio.create_task(self._publish())

    async def _publish(self) -> None:
        keys = {"cam": Image, "cam/faces": Faces, "cam/expressions": Expressions,
                "cam/poses": HeadPoses}  # fmt: skip
        publishers: dict[str, MessagePublisher] = {key: self._lab.publisher(key) for key in keys}
        pixels = np.full((120, 160, 3), GREEN, np.uint8)
        while True:
            ids, now_ns = self.track_ids, time.time_ns()
            messages: dict[str, Message] = {
                "cam": Image(pixels=Array.of(pixels.data), pixel_format="rgb8"),
                "cam/faces": faces(*ids),
                "cam/expressions": Expressions(
                    expressions=tuple(
                        Expression(
                            track_id=one,
                            labels={"happiness": 0.75, "neutral": 0.25},
                            action_units={"AU12": 0.5},
                        )
                        for one in ids
                    )
                ),
                "cam/poses": HeadPoses(
                    head_poses=tuple(
                        HeadPose(track_id=one, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0)
                        for one in ids
                    )
                ),
            }
            self.sent_ns.add(now_ns)
            for key, message in messages.items():
                publishers[key].publish(message, captured_ns=now_ns)
                await asyncio.sleep(0.01)

    async def close(self) -> None:
        self._work.cancel()
        await asyncio.wait([self._work])
        for demand in self._demands:
            demand.close()


@pytest.fixture
async def camera(lab: Lab) -> AsyncIterator[Camera]:
    camera = Camera(lab)
    yield camera
    await camera.close()


async def tracked(node: Peer, *ids: str) -> list[Any]:
    """Return the first list of exactly these faces."""
    return await node.until("tracked", list(ids))


async def test_a_node_sees_faces_come_and_go(lab: Lab, camera: Camera) -> None:
    camera.track_ids = (1,)
    async with peer(lab, "know_humans", "roi", "landmarks") as node:
        _, _, stamp_ns, frame_id = await tracked(node, "f00001")
        assert frame_id == "cam_optical"
        assert stamp_ns in camera.sent_ns
        _, _, region = await node.until("roi", "f00001")
        box = [region[name] for name in ("xmin", "ymin", "xmax", "ymax", "c")]
        assert box == pytest.approx([60 / 160, 20 / 120, 100 / 160, 80 / 120, 0.75])
        _, _, found = await node.until("landmarks", "f00001")
        assert (found["width"], found["height"]) == (160, 120)
        known = {index: point for index, point in enumerate(found["landmarks"]) if point["c"]}
        assert known[68]["x"] == pytest.approx(70 / 160)
        assert known.keys() == {68, 69}
        camera.track_ids = (1, 7)
        await tracked(node, "f00001", "f00007")
        await node.until("roi", "f00007")
        camera.track_ids = ()
        await tracked(node)


async def test_topics_of_a_face_are_there_as_long_as_the_face(lab: Lab, camera: Camera) -> None:
    camera.track_ids = (3,)
    names = {f"rt/humans/faces/f00003/{part}" for part in ("roi", "landmarks", "cropped")}
    async with peer(lab, "know_humans") as node, peer(lab, "watch") as watch:
        await tracked(node, "f00003")
        types = {
            line[2]: line[3] for line in [await watch.until("endpoint", "writer", n) for n in names]
        }
        assert types["rt/humans/faces/f00003/roi"] == (
            "hri_msgs::msg::dds_::NormalizedRegionOfInterest2D_"
        )
        camera.track_ids = ()
        await tracked(node)
    async with peer(lab, "know_humans") as node, peer(lab, "watch") as watch:
        await tracked(node)
        await asyncio.sleep(0.5)
        seen = []
        while not watch.lines.empty():
            seen.append(watch.lines.get_nowait())
        written = {line[2] for line in seen if line[:2] == ["endpoint", "writer"]}
        assert "rt/humans/faces/tracked" in written
        assert not names & written


async def test_expressions_and_head_poses_belong_to_their_faces(lab: Lab, camera: Camera) -> None:
    camera.track_ids = (2,)
    async with peer(lab, "know_humans", "expression", "facs") as node:
        _, _, shown = await node.until("expression", "f00002")
        assert (shown["expression"], shown["confidence"]) == ("happy", 0.75)
        _, _, units = await node.until("facs", "f00002")
        assert (units["intensity"][12], units["confidence"][12]) == (0.5, 1.0)
        assert sum(units["confidence"]) == 1.0
        _, (head, gaze) = await node.until("tf")
        assert (head["header"]["frame_id"], head["child_frame_id"]) == (
            "cam_optical",
            "face_f00002",
        )
        assert (gaze["header"]["frame_id"], gaze["child_frame_id"]) == (
            "face_f00002",
            "gaze_f00002",
        )
        assert head["transform"]["translation"]["z"] == pytest.approx(0.554, abs=0.01)


async def test_a_face_is_cropped_out_of_its_own_image(lab: Lab, camera: Camera) -> None:
    camera.track_ids = (4,)
    async with peer(lab, "know_humans", "cropped") as node:
        _, _, image = await node.until("cropped", "f00004")
        assert (image["encoding"], image["width"], image["height"]) == ("bgr8", 128, 128)
        middle = np.array(image["data"], np.uint8).reshape(128, 3)
        assert middle[64].tolist() == [0, 200, 0]
        assert middle[2].tolist() == [0, 0, 0]  # the face is higher than wide
        stamp = image["header"]["stamp"]
        assert stamp["sec"] * 10**9 + stamp["nanosec"] in camera.sent_ns


async def test_perception_runs_only_while_a_node_looks(lab: Lab, camera: Camera) -> None:
    camera.track_ids = (5,)
    await asyncio.sleep(0.3)
    assert not any(camera.wanted.values())
    async with peer(lab, "know_humans", "roi") as node:
        await tracked(node, "f00005")
        assert camera.wanted["cam/faces"]
        assert not camera.wanted.get("cam")  # nobody reads cropped faces
    async with asyncio.timeout(15):
        while camera.wanted["cam/faces"]:
            await asyncio.sleep(0.05)


async def test_faces_of_which_nothing_comes_are_gone(
    lab: Lab, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(humans, "SILENT_AFTER_S", 0.5)
    camera.track_ids = (6,)
    async with peer(lab, "know_humans", "roi") as node:
        await tracked(node, "f00006")
        await camera.close()
        await tracked(node)


async def test_faces_that_have_no_names_are_refused_and_the_others_live(lab: Lab) -> None:
    publisher = lab.publisher("cam/faces")
    async with peer(lab, "know_humans", "roi") as node:

        async def publish() -> None:
            while True:
                publisher.publish(faces(-1), captured_ns=time.time_ns())
                publisher.publish(faces(8), captured_ns=time.time_ns())
                await asyncio.sleep(0.02)

        work = asyncio.create_task(publish())
        await tracked(node, "f00008")
        work.cancel()
        await asyncio.wait([work])
