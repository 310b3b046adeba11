"""What a user does with the fleet: requests to the gateway, and a program on the backbone."""

from __future__ import annotations

import asyncio
import io
import json
import math
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any, Final

import httpx
import numpy as np
import pytest
from PIL import Image as Picture

from vertebra.bus import Delivery, ZenohBus
from vertebra.codec import CodecRegistry
from vertebra.messages import Faces, Image
from vertebra.service import MessageReader

from .fleet import Fleet
from .watcher import CAMERA, watching

SIZE: Final = (320, 240)
JOINTS: Final = [
    "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence",
]  # fmt: skip
MEASURED_S: Final = 3.0


@pytest.fixture
def web(fleet: Fleet) -> Iterator[httpx.Client]:
    for service in fleet.services():
        fleet.wait_healthy(service)
    with fleet.web() as client:
        yield client


@pytest.fixture
async def bus(fleet: Fleet) -> AsyncIterator[ZenohBus]:
    """Membership of a program on this machine in the backbone of the containers."""
    bus = await ZenohBus.open(fleet.router, timeout_s=10.0)
    yield bus
    await bus.close()


def picture_in(payload: bytes) -> Picture.Image:
    picture = Picture.open(io.BytesIO(payload), formats=["JPEG"])
    picture.load()
    return picture


def test_the_robots_are_listed_with_what_they_offer(web: httpx.Client) -> None:
    (robot,) = web.get("robots").raise_for_status().json()

    assert (robot["name"], robot["online"], robot["reason"]) == ("vizzy", True, "")
    paths = {resource["path"]: resource["kind"] for resource in robot["resources"]}
    assert paths["head/joints"] == "read"
    assert paths["head/move"] == "call"
    assert paths["camera/left"] == "stream"


def test_joints_move_to_where_they_are_told_to(web: httpx.Client) -> None:
    """The command and the joints travel over the YARP wire, twice."""
    for target_deg in (15.0, -10.0):
        answer = web.post(
            "robots/vizzy/head/move", json={"positions_deg": {"neck_yaw": target_deg}}
        )

        reply = answer.raise_for_status().json()
        assert reply["reached"] is True
        assert reply["positions_deg"]["neck_yaw"] == pytest.approx(target_deg, abs=0.5)
        joints = web.get("robots/vizzy/head/joints").raise_for_status().json()
        assert joints["message"]["names"] == JOINTS
        assert joints["message"]["positions_deg"][2] == pytest.approx(target_deg, abs=0.5)
        assert joints["age_s"] < 1.0


def test_the_base_drives_and_navigates(web: httpx.Client) -> None:
    """The command and the odometry travel over DDS, from container to container."""

    def place() -> tuple[float, float]:
        told = web.get("robots/vizzy/base/odometry").raise_for_status().json()
        assert told["age_s"] < 1.0
        x_m, y_m, _ = told["message"]["pose"]["position_m"]
        return x_m, y_m

    began = place()
    for _ in range(4):
        answer = web.post("robots/vizzy/base/drive", json={"linear_m_s": 0.3, "for_s": 0.5})
        assert answer.raise_for_status().json()["stops_in_s"] == 0.5
        time.sleep(0.25)
    assert math.dist(began, place()) > 0.1
    pose = {"position": {"x": -1.0, "y": -1.0}}
    goal = web.post("robots/vizzy/base/navigate/goal", json={"pose": {"pose": pose}})
    named = goal.raise_for_status().json()
    ended = web.post("robots/vizzy/base/navigate/result", json=named, timeout=60)
    assert ended.raise_for_status().json()["status"] == "succeeded"
    assert math.dist(place(), (-1.0, -1.0)) < 0.1
    stopped = web.post("robots/vizzy/base/stop").raise_for_status().json()
    assert stopped == {"cancelling": []}


def test_a_position_outside_the_limits_is_refused_with_the_limit(web: httpx.Client) -> None:
    limits = web.get("robots/vizzy/head/limits").raise_for_status().json()["joints"]
    yaw = next(joint for joint in limits if joint["name"] == "neck_yaw")
    before = web.get("robots/vizzy/head/joints").raise_for_status().json()["message"]

    answer = web.post("robots/vizzy/head/move", json={"positions_deg": {"neck_yaw": 200}})

    assert answer.status_code == httpx.codes.UNPROCESSABLE_ENTITY
    problem = answer.json()
    assert (problem["joint"], problem["value"]) == ("neck_yaw", 200)
    assert problem["limit"] == {"min": yaw["min_deg"], "max": yaw["max_deg"], "unit": "deg"}
    after = web.get("robots/vizzy/head/joints").raise_for_status().json()["message"]
    assert after["positions_deg"] == pytest.approx(before["positions_deg"], abs=0.5)


def test_a_snapshot_is_a_jpeg_of_now(web: httpx.Client) -> None:
    answer = web.get("robots/vizzy/camera/left").raise_for_status()

    assert answer.headers["content-type"] == "image/jpeg"
    assert abs(time.time() - int(answer.headers["x-captured-ns"]) / 1e9) < 2.0
    picture = picture_in(answer.content)
    assert picture.size == SIZE
    assert np.asarray(picture).std() > 10, "it shows something"


def test_a_stream_is_many_jpegs_of_different_times(web: httpx.Client) -> None:
    wanted = 20
    times: list[int] = []
    with web.stream("GET", "robots/vizzy/camera/left/stream") as answer:
        boundary = answer.headers["content-type"].partition("boundary=")[2].encode()
        buffer = b""
        for piece in answer.iter_bytes():
            *parts, buffer = (buffer + piece).split(b"--" + boundary + b"\r\n")
            for part in filter(None, parts):
                head, _, body = part.partition(b"\r\n\r\n")
                fields = dict(line.split(b": ") for line in head.lower().split(b"\r\n"))
                times.append(int(fields[b"x-captured-ns"]))
                assert picture_in(body[: int(fields[b"content-length"])]).size == SIZE
            if len(times) >= wanted:
                break

    assert times == sorted(set(times))


def test_faces_are_found(web: httpx.Client) -> None:
    web.post("robots/vizzy/head/move", json={"positions_deg": dict.fromkeys(JOINTS[:3], 0.0)})

    answer = web.get("robots/vizzy/camera/left/faces").raise_for_status().json()

    assert answer["schema"] == "vertebra/Faces/1"
    (face,) = answer["message"]["faces"]
    assert face["score"] > 0.5
    assert face["box"]["width"] > 20


def test_nobody_comes_in_without_the_token(fleet: Fleet) -> None:
    answer = httpx.get(f"{fleet.url}/api/robots", trust_env=False)

    assert answer.status_code == httpx.codes.UNAUTHORIZED


async def test_a_program_on_this_machine_sees_the_camera(bus: ZenohBus) -> None:
    """As in README, through the router's published tcp_port, without shared memory."""
    reader = MessageReader(
        bus.subscribe(CAMERA, Delivery.latest()), CodecRegistry.installed(), Image
    )
    async with asyncio.timeout(10.0):
        received = await anext(aiter(reader))

    assert np.asarray(received.message.pixels).shape == (*reversed(SIZE), 3)


async def test_a_camera_is_added_by_its_profile(fleet: Fleet) -> None:
    with fleet.with_profile("camera"):
        async with watching(fleet, "lab/camera/front", "lab/camera/front/faces") as watcher:
            image = await watcher.newer("lab/camera/front", time.time_ns(), timeout_s=15.0)
            faces = await watcher.newer("lab/camera/front/faces", 0, timeout_s=15.0)

    assert isinstance(image.message, Image)
    assert (image.message.width, image.message.height) == SIZE
    assert isinstance(faces.message, Faces)


async def services_info(bus: ZenohBus) -> dict[str, Any]:
    query = bus.query("@vertebra/services/*/*/info", timeout_s=2.0)
    documents = [json.loads(bytes(reply.payload)) async for reply in query]
    return {document["service"]: document for document in documents}


async def test_images_travel_by_shared_memory_if_and_only_if_it_is_on(
    fleet: Fleet, bus: ZenohBus
) -> None:
    # Receivers keep what they locked of every publisher that ever was (Zenoh issue 2787), and
    # other tests here kill publishers.
    await asyncio.to_thread(fleet.stop_all)
    await asyncio.to_thread(fleet.start_all)
    async with watching(fleet) as watcher:
        await watcher.newer(CAMERA, time.time_ns(), timeout_s=15.0)
        is_on = (await services_info(bus))["yarp"]["shared_memory"].startswith("on")
        await watcher.collect(2.0)  # a publisher claims its pool first

        before, began_s = fleet.network_bytes("yarp")[1], time.monotonic()
        seen = await watcher.collect(MEASURED_S)
        sent, duration_s = fleet.network_bytes("yarp")[1] - before, time.monotonic() - began_s

    images = len(seen[CAMERA])
    assert images > 10 * MEASURED_S
    nbytes = SIZE[0] * SIZE[1] * 3 * images / MEASURED_S * duration_s
    assert (sent < nbytes / 5) == is_on, f"{sent} bytes sent for {nbytes:.0f} bytes of images"
