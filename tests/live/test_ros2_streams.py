"""Images and joints at once through the ROS 2 adapter, at rates that a busy machine keeps up with.

The rates of a robot, and the time that each message takes, are measured in tests/bench.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from vertebra.bus import MemoryNetwork
from vertebra.messages import Array, Image, JointState, Message
from vertebra.service import MessageReader

from .ros2_lab import DOMAINS, adapter, peer

SECONDS: Final = 5
JOINTS_HZ: Final = 200
IMAGES_HZ: Final = 10
BEFORE: Final = 10**6
INBOUND: Final = """
topics:
  - {ros: /joint_states, key: robot/joints, depth: 200}
  - {ros: /image, key: robot/image}
"""
OUTBOUND: Final = """
topics:
  - {ros: /joints_in, key: robot/joints, type: sensor_msgs/msg/JointState, direction: outbound,
     delivery: queue, depth: 200}
  - {ros: /image_in, key: robot/image, type: sensor_msgs/msg/Image, direction: outbound,
     delivery: queue, depth: 10}
"""


async def sequences(reader: MessageReader[Message], count: int) -> list[int]:
    found: list[int] = []
    async with asyncio.timeout(6 * SECONDS):
        async for received in reader:
            found.append(received.header.sequence)
            if len(found) == count:
                break
    assert reader.subscription.dropped == 0
    return found


async def test_nothing_is_lost_on_the_way_from_ros(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    routes.write_text(INBOUND)
    async with adapter(MemoryNetwork(), next(DOMAINS), routes) as lab:
        joints, images = lab.read("robot/joints", JointState), lab.read("robot/image", Image)
        count, pictures = SECONDS * JOINTS_HZ, SECONDS * IMAGES_HZ
        async with (
            peer(lab, "joints", str(count), str(JOINTS_HZ)),
            peer(lab, "images", str(pictures), str(IMAGES_HZ)),
        ):
            found = await asyncio.gather(sequences(joints, count), sequences(images, pictures))
    assert tuple(found) == (list(range(count)), list(range(pictures)))


async def test_nothing_is_lost_on_the_way_to_ros(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    routes.write_text(OUTBOUND)
    async with (
        adapter(MemoryNetwork(), next(DOMAINS), routes) as lab,
        peer(lab, "hear_streams") as robot,
    ):
        await robot.until("ready")
        joints, images = lab.publisher("robot/joints"), lab.publisher("robot/image")
        pixels = bytearray(640 * 480 * 3)

        def say_joints(number: int) -> None:
            state = JointState(names=("neck",), positions_deg=(0.0,), efforts_nm=(float(number),))
            joints.publish(state)

        def show(number: int) -> None:
            pixels[:8] = number.to_bytes(8, "little")
            array = Array(bytes(pixels), "|u1", (480, 640, 3))
            images.publish(Image(pixels=array, pixel_format="rgb8"))

        for word, send in (("joints", say_joints), ("image", show)):
            while not [line for line in robot.lines_so_far() if line[0] == word]:
                send(BEFORE)  # until the two have found each other
                await asyncio.sleep(0.05)
        await asyncio.gather(paced(say_joints, JOINTS_HZ), paced(show, IMAGES_HZ))
        for word, count in (("joints", SECONDS * JOINTS_HZ), ("image", SECONDS * IMAGES_HZ)):
            heard: list[int] = []
            while len(heard) < count:
                number = (await robot.until(word))[1]
                heard += [number] if number != BEFORE else []
            assert heard == list(range(count))


async def paced(send: Callable[[int], None], rate_hz: int) -> None:
    began_s = time.monotonic()
    for number in range(SECONDS * rate_hz):
        send(number)
        await asyncio.sleep(began_s + (number + 1) / rate_hz - time.monotonic())
