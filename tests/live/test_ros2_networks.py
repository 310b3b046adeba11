"""ROS nodes on another machine: two network namespaces joined by a cable without multicast."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from .ros2_lab import PEER, ROOT

pytestmark = pytest.mark.live

ROBOT_ADDRESS: Final = "192.168.1.10"  # as in the README
LAB_ADDRESS: Final = "192.168.1.20"
DOMAIN: Final = "85"
WITHIN_S: Final = 20.0
BACK_WITHIN_S: Final = 5.0
"""So long a robot that was killed and started anew is away at most, from its start on."""
URI: Final = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="eth0"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='{peer}'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)
ROUTES: Final = """
topics:
  - {ros: /chatter, key: robot/said}
  - {ros: /words, key: lab/words, type: std_msgs/msg/String, direction: outbound}
  - {ros: /latched, key: lab/latched, type: std_msgs/msg/String, direction: outbound,
     retain: true, depth: 1}
services:
  - {ros: /add_two_ints, key: robot/sum}
"""


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@pytest.fixture
def namespaces() -> Iterator[tuple[str, str]]:
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip(
            "network namespaces need root and iproute2; run as root, apt-get install iproute2"
        )
    robot, lab = f"ros{os.getpid()}", f"vert{os.getpid()}"
    try:
        ip("netns", "add", robot)
    except subprocess.CalledProcessError as error:
        pytest.skip(
            f"network namespaces cannot be made here ({error.stderr.strip()}); run on a host"
        )
    try:
        ip("netns", "add", lab)
        ip("link", "add", "eth0", "netns", robot, "type", "veth", "peer", "eth0", "netns", lab)
        for namespace, address in ((robot, ROBOT_ADDRESS), (lab, LAB_ADDRESS)):
            ip("-n", namespace, "address", "add", f"{address}/24", "dev", "eth0")
            ip("-n", namespace, "link", "set", "eth0", "multicast", "off", "up")
            ip("-n", namespace, "link", "set", "lo", "up")
        yield robot, lab
    finally:
        ip("netns", "del", robot)
        with contextlib.suppress(subprocess.CalledProcessError):
            ip("netns", "del", lab)


class Cable:
    """Both ends of the cable, and how to run programs there."""

    def __init__(self, robot: str, lab: str, folder: Path) -> None:
        self._robot = robot
        self._lab = lab
        self._folder = folder
        self._running: list[Process] = []

    async def robot(self, *role: str) -> Process:
        """Run a ROS node on the robot."""
        return await self._run(
            self._robot, PEER, *role,
            ROS_DOMAIN_ID=DOMAIN, CYCLONEDDS_URI=URI.format(peer=LAB_ADDRESS),
        )  # fmt: skip

    async def lab(self, *arguments: str, **variables: str) -> Process:
        """Run a program of the fleet in the lab."""
        return await self._run(self._lab, *arguments, **variables)

    async def _run(self, namespace: str, *arguments: str, **variables: str) -> Process:
        environment = {
            **{name: value for name, value in os.environ.items() if "VERTEBRA" not in name},
            "VERTEBRA_HEARTBEAT_DIR": str(self._folder),
            **variables,
        }
        process = await asyncio.create_subprocess_exec(
            "ip", "netns", "exec", namespace, sys.executable, "-m", *arguments, cwd=ROOT,
            env=environment, stdin=PIPE, stdout=PIPE, stderr=DEVNULL,
        )  # fmt: skip
        self._running.append(process)
        return process

    async def stop(self) -> None:
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.communicate()


@pytest.fixture
async def cable(namespaces: tuple[str, str], tmp_path: Path) -> AsyncIterator[Cable]:
    """Run a fleet in the lab, whose adapter is told where the robot is."""
    cable = Cable(*namespaces, tmp_path)
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    await cable.lab("vertebra_router")
    await cable.lab(
        "vertebra_ros2",
        VERTEBRA_ROS2_DOMAIN_ID=DOMAIN,
        VERTEBRA_ROS2_INTERFACE="eth0",
        VERTEBRA_ROS2_PEERS=json.dumps([ROBOT_ADDRESS]),
        VERTEBRA_ROS2_ROUTES=str(routes),
    )
    yield cable
    await cable.stop()


async def line_with(process: Process, sign: str) -> str:
    assert process.stdout is not None
    async with asyncio.timeout(WITHIN_S):
        while line := (await process.stdout.readline()).decode():
            if sign in line:
                return line
    raise AssertionError(f"it ended before it said {sign!r}")


async def call(cable: Cable, key: str, document: dict[str, Any]) -> str:
    """Call a key until it is served, and return the answer."""
    async with asyncio.timeout(WITHIN_S):
        while True:
            asked = await cable.lab("vertebra.cli", "call", key, json.dumps(document))
            answer = (await asked.communicate())[0].decode()
            if asked.returncode == 0:
                return answer


async def test_both_ways_without_multicast(cable: Cable) -> None:
    await cable.robot("talk")
    await cable.robot("serve_sum")
    echo = await cable.lab("vertebra.cli", "echo", "--json", "robot/said")
    await line_with(echo, "hello")
    assert "42" in await call(cable, "robot/sum", {"a": 40, "b": 2})

    listener = await cable.robot("listen", "/words")
    await cable.lab(
        "vertebra.cli", "pub", "--rate", "20", "--type", "Text", "lab/words",
        '{"text": "hello robot"}',
    )  # fmt: skip
    assert "hello robot" in await line_with(listener, "heard")


async def test_killed_robot_is_back_at_once(cable: Cable) -> None:
    talk, server = await cable.robot("talk"), await cable.robot("serve_sum")
    echo = await cable.lab("vertebra.cli", "echo", "--json", "robot/said")
    await line_with(echo, "hello")
    assert "42" in await call(cable, "robot/sum", {"a": 40, "b": 2})
    for process in (talk, server):
        process.kill()
        await process.wait()

    began_s = time.monotonic()
    talk, server = await cable.robot("talk", "again"), await cable.robot("serve_sum")
    await line_with(talk, "ready")
    await line_with(server, "ready")
    await line_with(echo, "again")
    said_after_s = time.monotonic() - began_s
    assert "42" in await call(cable, "robot/sum", {"a": 40, "b": 2})
    answered_after_s = time.monotonic() - began_s
    assert said_after_s < BACK_WITHIN_S
    assert answered_after_s < BACK_WITHIN_S


async def test_late_joiners_get_what_was_latched_before_them(cable: Cable) -> None:
    latch = await cable.robot("latch")
    await line_with(latch, "ready")
    echo = await cable.lab("vertebra.cli", "echo", "--json", "robot/said")
    assert "from long ago" in await line_with(echo, "robot/said")

    publisher = await cable.lab(
        "vertebra.cli", "pub", "--rate", "5", "--type", "Text", "lab/latched",
        '{"text": "told once"}',
    )  # fmt: skip
    early = await cable.robot("listen_latched", "/latched")
    await line_with(early, "heard")
    publisher.kill()
    await publisher.wait()
    listener = await cable.robot("listen_latched", "/latched")
    assert "told once" in await line_with(listener, "heard")
