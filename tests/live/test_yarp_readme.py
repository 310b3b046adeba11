"""The commands in the README of the YARP service run, and do what it says."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from vertebra.testing.bus_suite import eventually
from vertebra.yarp import NameClient, Port

from .test_up import ROOT, Up, running

pytestmark = pytest.mark.live

README: Final = (ROOT / "services/yarp/README.md").read_text(encoding="utf-8")
SHELL: Final = re.findall(r"^```sh\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


@pytest.fixture
async def up(tmp_path: Path) -> AsyncIterator[Up]:
    context = running(tmp_path)
    started, _ = await asyncio.to_thread(context.__enter__)
    yield started
    await asyncio.to_thread(context.__exit__, None, None, None)


async def test_curl_connects_a_camera_to_a_port_of_somebody_else(up: Up) -> None:
    if shutil.which("curl") is None:
        pytest.skip("there is no curl; apt-get install curl")
    (block,) = (block for block in SHELL if "curl" in block)
    variables, commands = block.split("\n\n", maxsplit=1)
    making, removing = commands.split('curl -fsS -H "$AUTH" -X DELETE')
    host, _, tcp_port = up.environment["VERTEBRA_YARP_NAME_SERVER_BIND"].rpartition(":")
    names = NameClient(host, int(tcp_port))
    seen: list[int] = []
    async with await Port.open("/view", names, on_data=lambda it: seen.append(len(it.payload))):
        said = await bash(up, f"{variables}\n{making}")
        await eventually(lambda: len(seen) > 3)
        said += await bash(up, f'{variables}\ncurl -fsS -H "$AUTH" -X DELETE{removing}')
    edge = '{"from":"/vizzy/camera/left","to":"/view","carrier":"fast_tcp"}'
    assert said.count(edge) == 3  # made, listed, removed
    assert '"silent":[]' in said
    assert '"key":"vizzy/camera/left","kind":"inbound stream"' in said
    assert min(seen) > 320 * 240 * 3


async def bash(up: Up, script: str) -> str:
    script = script.replace("deploy/secrets", up.environment["VERTEBRA_SECRETS"])
    script = script.replace("127.0.0.1:8080", f"127.0.0.1:{up.gateway}")
    process = await asyncio.create_subprocess_exec(
        "bash", "-euo", "pipefail", "-c", script, stdout=asyncio.subprocess.PIPE
    )
    said = (await process.communicate())[0].decode()
    assert process.returncode == 0, said
    return said
