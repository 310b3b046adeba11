"""The checks of `doctor`: right findings, and a remedy for every bad one."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from vertebra import heartbeat
from vertebra.cli import checks
from vertebra.cli.up import Address, check_addresses
from vertebra.errors import ConfigError
from vertebra.testing.ports import free_tcp_port


@pytest.fixture
def listener() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_python_is_new_enough() -> None:
    assert checks.check_python().level == "ok"
    old = checks.check_python((3, 10, 12))
    assert (old.level, old.text, old.remedy) == (
        "wrong",
        "3.10.12",
        "install Python 3.11 or newer",
    )


def test_a_free_tcp_port_is_well() -> None:
    tcp_port = free_tcp_port()
    assert checks.check_tcp_port("router", "VARIABLE", "127.0.0.1", tcp_port).text == "free"


def test_a_taken_tcp_port_names_the_process_and_the_variable(listener: int) -> None:
    finding = checks.check_tcp_port("router", "VERTEBRA_ROUTER_LISTEN", "127.0.0.1", listener)
    assert finding.level == "wrong"
    assert f"process {os.getpid()} (" in finding.text
    assert "VERTEBRA_ROUTER_LISTEN" in finding.remedy


def test_all_taken_addresses_are_told_before_the_start(listener: int) -> None:
    free = Address("gateway", "VERTEBRA_GATEWAY_TCP_PORT", "127.0.0.1", free_tcp_port())
    taken = Address("router", "VERTEBRA_ROUTER_LISTEN", "127.0.0.1", listener)
    check_addresses([free])
    with pytest.raises(ConfigError) as caught:
        check_addresses([taken, free, taken])
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert lines[0].startswith(
        f"router cannot listen on 127.0.0.1:{listener}, which process {os.getpid()} ("
    )
    assert lines[0].endswith("stop that one, or set VERTEBRA_ROUTER_LISTEN to another address")


def test_a_server_answers_or_not(listener: int) -> None:
    assert checks.check_tcp_server("x", "127.0.0.1", listener, remedy="r").level == "ok"
    finding = checks.check_tcp_server("x", "127.0.0.1", free_tcp_port(), remedy="start it")
    assert (finding.level, finding.remedy) == ("warning", "start it")
    assert "refused" in finding.text


def test_multicast_is_tried() -> None:
    assert checks.check_multicast().level == "ok"
    assert checks.check_multicast("203.0.113.1").level == "warning"  # no interface of ours


def test_shared_memory_is_judged_by_its_description() -> None:
    assert checks.check_shared_memory("on: 32 MiB").level == "ok"
    assert checks.check_shared_memory("off: the limit is low").level == "warning"


@pytest.mark.parametrize(
    ("code", "level", "text"),
    [
        ("print('noise'); print('1.2.3')", "ok", "1.2.3"),
        ("import sys; sys.exit('no engine')", "warning", "no engine"),
        ("raise SystemExit(3)", "warning", "exit status 3"),
    ],
)
def test_a_command_tells_by_its_status_and_last_line(code: str, level: str, text: str) -> None:
    finding = checks.check_command("x", [sys.executable, "-c", code], remedy="r")
    assert (finding.level, finding.text) == (level, text)


def test_a_command_that_is_missing_or_hangs_is_a_warning() -> None:
    missing = checks.check_command("x", ["no-such-command"], remedy="install it")
    assert (missing.text, missing.remedy) == ("there is no no-such-command here", "install it")
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    assert "hangs" in checks.check_command("x", sleep, remedy="r", timeout_s=0.2).text


def test_cameras_are_listed(tmp_path: Path) -> None:
    assert checks.check_cameras(tmp_path).level == "ok"
    (tmp_path / "video0").touch()
    assert checks.check_cameras(tmp_path).text == str(tmp_path / "video0")


def test_a_camera_that_may_not_be_opened_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "video0").touch()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may open every file
    finding = checks.check_cameras(tmp_path)
    assert (finding.level, "group video" in finding.remedy) == ("warning", True)


def test_services_of_one_name_do_not_take_each_others_heartbeat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    with ThreadPoolExecutor(8) as services:
        list(services.map(heartbeat.beat, ["ros2"] * 500))
    assert [file.name for file in tmp_path.iterdir()] == ["vertebra-ros2.heartbeat"]


def test_heartbeats_of_running_services(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    heartbeat.beat("camera")
    heartbeat.beat("yarp", "no name server")
    heartbeat.beat("gateway")
    past_s = time.time() - 60
    os.utime(heartbeat.heartbeat_path("gateway"), (past_s, past_s))
    found = {each.name: each for each in checks.check_heartbeats(tmp_path)}
    assert found["service camera"].level == "ok"
    assert (found["service yarp"].level, found["service yarp"].text) == ("wrong", "no name server")
    assert "60 s old" in found["service gateway"].text


def test_versions_are_compared() -> None:
    assert checks.check_version("yarp", "0.1.0", "0.1.0").level == "ok"
    assert checks.check_version("yarp", "0.0.9", "0.1.0").level == "wrong"


def test_every_bad_finding_has_a_remedy(listener: int) -> None:
    bad = [
        checks.check_python((2, 7, 18)),
        checks.check_tcp_port("x", "X", "127.0.0.1", listener),
        checks.check_multicast("203.0.113.1"),
        checks.check_shared_memory("off"),
        checks.check_version("x", "1", "2"),
    ]
    assert all(each.level != "ok" and each.remedy for each in bad)
