"""The gateway as it is started: its own process, a real router, a robot behind it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest

from vertebra.bus import ZenohBus
from vertebra.bus.router import running_router
from vertebra.codec import CodecRegistry
from vertebra.testing.ports import free_tcp_port
from vertebra_gateway.testing import FakeRobot

pytestmark = [pytest.mark.live]

TOKEN = "0123456789abcdef"
ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
WITHIN_S = 20.0


@asynccontextmanager
async def gateway(folder: Path, router: str, tcp_port: int, **extra: str) -> AsyncIterator[Process]:
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("VERTEBRA")},
        "VERTEBRA_ROUTER": router,
        "VERTEBRA_HEARTBEAT_DIR": str(folder),
        "VERTEBRA_GATEWAY_TCP_PORT": str(tcp_port),
        "VERTEBRA_GATEWAY_ROBOTS": str(ROBOTS),
        **extra,
    }
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "vertebra_gateway", env=environment, stderr=PIPE
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def stderr_of(process: Process) -> str:
    async with asyncio.timeout(WITHIN_S):
        _, errors = await process.communicate()
    return errors.decode()


async def test_it_runs_serves_refuses_a_second_one_and_stops(tmp_path: Path) -> None:
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    tcp_port = free_tcp_port()
    token_file = tmp_path / "token"
    token_file.write_text(f"{TOKEN}\n", encoding="utf-8")
    secret = {"VERTEBRA_GATEWAY_TOKEN_FILE": str(token_file)}
    with running_router([router]):
        bus = await ZenohBus.open(router)
        FakeRobot(bus, CodecRegistry.installed())
        async with (
            gateway(tmp_path, router, tcp_port, **secret) as process,
            httpx.AsyncClient(
                base_url=f"http://127.0.0.1:{tcp_port}",
                headers={"authorization": f"Bearer {TOKEN}"},
            ) as http,
        ):
            async with asyncio.timeout(WITHIN_S):
                while True:
                    with contextlib.suppress(httpx.ConnectError):
                        if (await http.get("/api/robots/vizzy")).json()["online"]:
                            break
                    assert process.returncode is None, await stderr_of(process)
                    await asyncio.sleep(0.05)
            move = "/api/robots/vizzy/head/move"
            answer = await http.post(move, json={"positions_deg": {"neck_yaw": 20}})
            assert answer.json()["positions_deg"]["neck_yaw"] == 20
            refused = await http.post(move, json={"positions_deg": {"neck_yaw": 31}})
            assert (refused.status_code, refused.json()["limit"]["max"]) == (422, 30.0)
            metrics = (await http.get("/metrics")).text
            assert 'vertebra_gateway_clients{instance="1",service="gateway"} 0.0' in metrics

            other = tmp_path / "other"
            other.mkdir()
            async with gateway(other, router, tcp_port, **secret) as second:
                errors = await stderr_of(second)
            assert second.returncode == 2
            assert f"127.0.0.1:{tcp_port}" in errors
            assert "set VERTEBRA_GATEWAY_TCP_PORT" in errors

            started_s = time.monotonic()
            process.send_signal(signal.SIGTERM)
            errors = await stderr_of(process)
            assert time.monotonic() - started_s < 5.0
            assert process.returncode == 0
            assert "Traceback" not in errors, errors
            assert "destroyed" not in errors, errors
            assert TOKEN not in errors
        await bus.close()


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({}, "the gateway needs a token: set VERTEBRA_GATEWAY_TOKEN_FILE"),
        ({"VERTEBRA_GATEWAY_TOKEN": "short"}, "has 5 characters; it needs at least 16"),
        ({"VERTEBRA_GATEWAY_TOKEN_FILE": "/nowhere/token"}, "the token cannot be read"),
        (
            {"VERTEBRA_GATEWAY_TOKEN": TOKEN, "VERTEBRA_GATEWAY_TOKEN_FILE": "/nowhere/token"},
            "not both",
        ),
        (
            {"VERTEBRA_GATEWAY_TOKEN": TOKEN, "VERTEBRA_GATEWAY_ROBOTS": "/nowhere"},
            "set VERTEBRA_GATEWAY_ROBOTS",
        ),
        ({"VERTEBRA_GATEWAY_PORT": "80"}, "did you mean VERTEBRA_GATEWAY_TCP_PORT?"),
    ],
)
async def test_settings_that_cannot_work_end_it_before_any_router_is_there(
    tmp_path: Path, settings: dict[str, str], says: str
) -> None:
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    async with gateway(tmp_path, router, free_tcp_port(), **settings) as process:
        errors = await stderr_of(process)
    assert process.returncode == 2
    assert says in errors


async def test_an_address_of_another_machine_ends_it_with_status_2(tmp_path: Path) -> None:
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    settings = {"VERTEBRA_GATEWAY_TOKEN": TOKEN, "VERTEBRA_GATEWAY_HOST": "192.0.2.1"}
    with running_router([router]):
        async with gateway(tmp_path, router, free_tcp_port(), **settings) as process:
            errors = await stderr_of(process)
    assert process.returncode == 2
    assert "192.0.2.1:" in errors
