"""A robot on another machine: two network namespaces, joined by a cable, data both ways.

The machine of the lab has two networks, as one with Docker has; only one of them is the robot's.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import re
import shutil
import subprocess
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Final

import pytest

pytestmark = pytest.mark.live

ROOT: Final = Path(__file__).parents[2]
ROBOT_ADDRESS: Final = "192.168.1.10"  # as in the READMEs
LAB_ADDRESS: Final = "192.168.1.20"
README: Final = (ROOT / "services/yarp/README.md").read_text("utf-8")
WITHIN_S: Final = 20.0

ROBOT: Final = """
import asyncio
from vertebra.yarp import NameServer, Port, PortNotFoundError, Reader, encode

async def main():
    server = await NameServer.start(bind_host="0.0.0.0", advertise_host="HOST")
    names = server.client()
    numbers = await Port.open("/robot/out", names, bind_host="0.0.0.0", advertise_host="HOST")
    heard = await Port.open(
        "/robot/in", names, bind_host="0.0.0.0", advertise_host="HOST",
        on_data=lambda it: print("in", it.bottle(), flush=True),
    )
    asyncio.create_task(ask(names))
    for number in range(10**9):
        numbers.write(encode([number]))
        await asyncio.sleep(0.02)

async def ask(names):
    while True:
        try:
            reader = await Reader.dial(
                "/lab/words", names, reader_name="/robot/ear",
                on_data=lambda it: print("ear", it.bottle(), flush=True),
            )
        except PortNotFoundError:
            await asyncio.sleep(0.1)
        else:
            where = await names.query("/lab/words")
            print("dialled", where.host, flush=True)
            return

asyncio.run(main())
""".replace("HOST", ROBOT_ADDRESS)


class Cable:
    """Two network namespaces and how to run programs in them."""

    def __init__(self, robot: str, lab: str, folder: Path) -> None:
        self.robot = robot
        self.lab = lab
        self._folder = folder
        self._running: list[Process] = []

    async def run(self, namespace: str, *arguments: str, **variables: str) -> Process:
        environment = {
            **{name: value for name, value in os.environ.items() if "VERTEBRA" not in name},
            "VERTEBRA_HEARTBEAT_DIR": str(self._folder),
            **variables,
        }
        process = await asyncio.create_subprocess_exec(
            "ip", "netns", "exec", namespace, sys.executable, *arguments,
            env=environment, stdout=PIPE, stderr=DEVNULL,
        )  # fmt: skip
        self._running.append(process)
        return process

    async def stop(self) -> None:
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.communicate()


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@pytest.fixture
def namespaces() -> Iterator[tuple[str, str]]:
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip(
            "network namespaces need root and iproute2; run as root, apt-get install iproute2"
        )
    robot, lab = f"robot{os.getpid()}", f"lab{os.getpid()}"
    try:
        ip("netns", "add", robot)
    except subprocess.CalledProcessError as error:
        pytest.skip(
            f"network namespaces cannot be made here ({error.stderr.strip()}); run on a host"
        )
    try:
        ip("netns", "add", lab)
        ip("link", "add", "eth0", "netns", robot, "type", "veth", "peer", "eth0", "netns", lab)
        ip("-n", lab, "link", "add", "docker0", "type", "veth", "peer", "docker1")
        for namespace, interface, address in (
            (lab, "docker0", "172.17.0.1/16"),
            (robot, "eth0", f"{ROBOT_ADDRESS}/24"),
            (lab, "eth0", f"{LAB_ADDRESS}/24"),
        ):
            ip("-n", namespace, "address", "add", address, "dev", interface)
            ip("-n", namespace, "link", "set", interface, "up")
            ip("-n", namespace, "link", "set", "lo", "up")
        yield robot, lab
    finally:
        ip("netns", "del", robot)
        with contextlib.suppress(subprocess.CalledProcessError):
            ip("netns", "del", lab)


@pytest.fixture
async def cable(namespaces: tuple[str, str], tmp_path: Path) -> AsyncIterator[Cable]:
    cable = Cable(*namespaces, tmp_path)
    yield cable
    await cable.stop()


def three_lines() -> dict[str, str]:
    """Return the configuration of the README that joins a lab's name server."""
    (block,) = re.findall(r"^```ini\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
    lines = dict(line.split("=", 1) for line in block.splitlines())
    assert len(lines) == 3
    return lines


async def line_with(process: Process, sign: str) -> str:
    assert process.stdout is not None
    async with asyncio.timeout(WITHIN_S):
        while line := (await process.stdout.readline()).decode():
            if sign in line:
                return line
    raise AssertionError(f"it ended before it said {sign!r}")


@pytest.mark.parametrize("advertised", ["as the README says", "found"])
async def test_a_lab_with_a_yarpserver_joins_in_three_lines(
    cable: Cable, tmp_path: Path, advertised: str
) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(
        routes.write_text,
        "streams: [{yarp: /lab/words, key: lab/words, direction: outbound}]\n",
    )
    lines = three_lines()
    if advertised == "found":
        del lines["VERTEBRA_YARP_ADVERTISE_HOST"]
    robot = await cable.run(cable.robot, "-c", ROBOT)
    await cable.run(cable.lab, "-m", "vertebra_router")
    await cable.run(cable.lab, "-m", "vertebra_yarp", VERTEBRA_YARP_ROUTES=str(routes), **lines)

    # From the robot to the backbone.
    echo = await cable.run(cable.lab, "-m", "vertebra.cli", "echo", "--json", "yarp/robot/out")
    numbers = [
        int(re.findall(r'"values": ?\[(\d+)\]', await line_with(echo, "yarp/robot/out"))[0])
        for _ in range(20)
    ]
    assert all(later > earlier for earlier, later in itertools.pairwise(numbers))

    # From the backbone to the robot, which dials the address that our port is registered with.
    assert LAB_ADDRESS in await line_with(robot, "dialled")
    await cable.run(
        cable.lab, "-m", "vertebra.cli", "pub", "--rate", "20", "--type", "Text",
        "lab/words", '{"text": "hello robot"}',
    )  # fmt: skip
    assert "hello robot" in await line_with(robot, "ear")

    # The same over a connection that our port makes, because somebody asked the adapter to.
    call = await cable.run(
        cable.lab, "-m", "vertebra.cli", "call", "@vertebra/services/yarp/1/connect",
        '{"from": "/lab/words", "to": "/robot/in"}',
    )  # fmt: skip
    assert '"to"' in await line_with(call, "/robot/in")
    assert "hello robot" in await line_with(robot, "in [")
