"""`./vertebra doctor` on a machine where no fleet runs."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from vertebra.testing.ports import free_tcp_port


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    return {
        **{name: value for name, value in os.environ.items() if "VERTEBRA_" not in name},
        "VERTEBRA_STATE": str(tmp_path),
        "VERTEBRA_MODELS": str(tmp_path / "models"),
        "VERTEBRA_ROUTER": router,
        "VERTEBRA_ROUTER_LISTEN": f'["{router}"]',
        "VERTEBRA_YARP_NAME_SERVER_BIND": f"127.0.0.1:{free_tcp_port()}",
        "VERTEBRA_GATEWAY_TCP_PORT": str(free_tcp_port()),
    }


def doctor(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vertebra.cli", "doctor"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_machine_at_rest_is_well_and_warnings_have_remedies(environment: dict[str, str]) -> None:
    done = doctor(environment)
    assert done.returncode == 0, done.stdout + done.stderr
    levels = re.findall(r"^(\w+) +(.+?)  ", done.stdout, flags=re.MULTILINE)
    assert ("warning", "router") in levels
    assert ("warning", "face models") in levels
    assert not [name for level, name in levels if level == "wrong"]
    assert "-> start the fleet: ./vertebra up" in done.stdout
    assert "vertebra_face_tracking.models fetch --into" in done.stdout
    assert done.stdout.count("\n  -> ") == sum(level == "warning" for level, _ in levels)


def test_a_taken_tcp_port_is_wrong(environment: dict[str, str]) -> None:
    tcp_port = int(environment["VERTEBRA_GATEWAY_TCP_PORT"])
    with socket.create_server(("127.0.0.1", tcp_port)):
        done = doctor(environment)
    assert done.returncode == 1
    assert f"wrong    tcp_port {tcp_port} (gateway)" in done.stdout
    assert f"taken by process {os.getpid()} (" in done.stdout
    assert "-> stop it, or set VERTEBRA_GATEWAY_TCP_PORT" in done.stdout
