"""`./vertebra up` runs the whole fleet as processes, and leaves none behind."""

from __future__ import annotations

import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import httpx
import pytest

from vertebra.testing.ports import free_tcp_port

ROOT: Final = Path(__file__).parents[2]
READY_WITHIN_S: Final = 10.0
STOPPED_WITHIN_S: Final = 10.0
SERVICES: Final = {"router", "yarp", "ros2", "simulator", "face_tracking", "gateway"}


class Up:
    """An `up` with a state folder and TCP ports of its own, so that it disturbs no other."""

    def __init__(self, folder: Path) -> None:
        router, name_server, self.gateway = free_tcp_port(), free_tcp_port(), free_tcp_port()
        self.folder = folder
        self.environment = {
            **{name: value for name, value in os.environ.items() if "VERTEBRA_" not in name},
            "VERTEBRA_STATE": str(folder),
            "VERTEBRA_MODELS": str(ROOT / ".vertebra/models"),
            "VERTEBRA_SECRETS": str(folder / "secrets"),
            "VERTEBRA_ROUTER": f"tcp/127.0.0.1:{router}",
            "VERTEBRA_ROUTER_LISTEN": f'["tcp/127.0.0.1:{router}"]',
            "VERTEBRA_YARP_NAME_SERVER_BIND": f"127.0.0.1:{name_server}",
            "VERTEBRA_SIMULATOR_NAME_SERVER": f"127.0.0.1:{name_server}",
            "VERTEBRA_ROS2_DOMAIN_ID": str(random.randrange(100, 230)),
            "VERTEBRA_GATEWAY_TCP_PORT": str(self.gateway),
            "VERTEBRA_GATEWAY_TOKEN_FILE": str(folder / "secrets/gateway_token"),
        }
        self.output = folder / "output.txt"

    def start(self) -> subprocess.Popen[bytes]:
        self.output.touch()
        with self.output.open("wb") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "vertebra.cli", "up"],
                env=self.environment,
                cwd=self.folder,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def command(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "vertebra.cli", *arguments],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )

    def text(self) -> str:
        return self.output.read_text(encoding="utf-8")

    def processes(self) -> dict[int, str]:
        """Return what runs for this fleet, wherever it hangs in the tree of processes."""
        mark = f"VERTEBRA_HEARTBEAT_DIR={self.folder}/".encode()
        found = {}
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if mark in (process / "environ").read_bytes():
                    words = (process / "cmdline").read_bytes().split(b"\0")
                    found[int(process.name)] = b" ".join(words).decode()
            except OSError:
                continue
        return found

    def pid_of(self, service: str) -> int:
        (pid,) = [
            pid for pid, command in self.processes().items() if command.endswith(f"_{service} ")
        ]
        return pid


def until(condition: Callable[[], bool], within_s: float, complaint: Callable[[], str]) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, complaint()
        time.sleep(0.05)


def find(pattern: str, text: str) -> re.Match[str] | None:
    return re.search(pattern, text, re.MULTILINE)


@contextmanager
def running(folder: Path) -> Iterator[tuple[Up, subprocess.Popen[bytes]]]:
    up = Up(folder)
    process = up.start()
    try:
        until(lambda: "vertebra: ready after" in up.text(), 40, up.text)
        yield up, process
    finally:
        if process.poll() is None:
            process.terminate()
        process.wait(30)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with running(tmp_path_factory.mktemp("fleet")) as (up, process):
        yield up
        check_stop(up, process, signal.SIGTERM)


def check_stop(up: Up, process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    process.send_signal(number)
    assert process.wait(STOPPED_WITHIN_S) == 0, up.text()
    assert up.processes() == {}
    assert "Traceback" not in up.text()


def test_it_is_ready_soon_and_says_where(fleet: Up) -> None:
    text = fleet.text()
    ready = re.search(r"vertebra: ready after ([\d.]+) s", text)
    assert ready is not None
    assert float(ready[1]) < READY_WITHIN_S
    assert "Traceback" not in text
    dashboard = re.search(r"dashboard +(http://127\.0\.0\.1:\d+/\?token=\S+)", text)
    assert dashboard is not None
    with httpx.Client(follow_redirects=True) as client:
        answer = client.get(dashboard[1])
        assert (answer.status_code, "text/html" in answer.headers["content-type"]) == (200, True)
    assert httpx.get(f"http://127.0.0.1:{fleet.gateway}/robots").status_code == 401


def test_every_service_runs_under_the_supervisor_and_writes_its_log(fleet: Up) -> None:
    commands = " ".join(fleet.processes().values())
    for service in SERVICES:
        assert f"-m vertebra_{service} " in commands
        assert (fleet.folder / "log" / f"{service}.log").stat().st_size
        assert f"{service:13} | " in fleet.text()


def test_a_service_that_is_killed_comes_back(fleet: Up) -> None:
    before = fleet.pid_of("simulator")
    os.kill(before, signal.SIGKILL)
    until(
        lambda: any(
            pid != before and command.endswith("_simulator ")
            for pid, command in fleet.processes().items()
        ),
        10,
        fleet.text,
    )
    answer = ""

    def answers() -> bool:
        nonlocal answer
        done = fleet.command("call", "vizzy/head/limits", "--timeout", "2")
        answer = done.stdout + done.stderr
        return "neck_yaw" in done.stdout

    until(answers, 20, lambda: f"{answer}\n{fleet.text()}")
    assert "exited: simulator (terminated by SIGKILL" in fleet.text()


def test_doctor_finds_the_fleet_well(fleet: Up) -> None:
    done = fleet.command("doctor")
    assert done.returncode == 0, done.stdout
    for service in SERVICES:
        assert find(rf"^ok +{service} on the backbone +present, version", done.stdout)
        assert find(rf"^ok +service {service} +works", done.stdout)
    assert find(r"^ok +tcp_port \d+ \(gateway\) +in use by the fleet", done.stdout)
    assert find(r"^ok +YARP name server +answers at", done.stdout)


def test_keys_show_the_robot_and_who_is_there(fleet: Up) -> None:
    done = fleet.command("keys", "vizzy/**")
    assert done.returncode == 0
    state = find(r"^vizzy/head/state +\S+JointState/1 +([\d.]+) Hz", done.stdout)
    assert state is not None, done.stdout
    assert float(state[1]) > 10
    for service in SERVICES:
        assert find(rf"^{service} +1 +\d+\.\d+\.\d+ +(ok|warning)", done.stdout)


def test_the_base_is_driven_and_tells_where_it_is(fleet: Up) -> None:
    domain = fleet.environment["VERTEBRA_ROS2_DOMAIN_ID"]
    topics = fleet.command("ros2", "topics", "--domain", domain)
    assert find(r"^/cmd_vel +geometry_msgs/msg/Twist", topics.stdout), topics.stdout + topics.stderr
    assert find(r"^/odom +nav_msgs/msg/Odometry", topics.stdout), topics.stdout
    done = fleet.command("call", "vizzy/base/drive", '{"linear_m_s": 0.4, "for_s": 2}')
    assert '"stops_in_s": 2.0' in done.stdout, done.stdout + done.stderr
    told = fleet.command("echo", "vizzy/base/odometry", "-n", "1")
    assert "base_link" in told.stdout, told.stdout + told.stderr


def test_a_second_one_is_refused(fleet: Up) -> None:
    done = fleet.command("up")
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(
        r"vertebra: the fleet of this checkout runs already \(process \d+\); .*\n", done.stderr
    )


def test_ctrl_c_stops_everything(tmp_path: Path) -> None:
    with running(tmp_path) as (up, process):
        check_stop(up, process, signal.SIGINT)


def test_nothing_outlives_it_even_if_it_is_killed(tmp_path: Path) -> None:
    with running(tmp_path) as (up, process):
        assert len(up.processes()) == len(SERVICES) + 1
        process.kill()
        until(lambda: not up.processes(), STOPPED_WITHIN_S, lambda: str(up.processes()))


def test_the_services_do_not_outlive_the_supervisor(tmp_path: Path) -> None:
    with running(tmp_path) as (up, process):
        (supervisor,) = [pid for pid, command in up.processes().items() if "supervisord" in command]
        os.kill(supervisor, signal.SIGKILL)
        assert process.wait(STOPPED_WITHIN_S) == 1
        until(lambda: not up.processes(), STOPPED_WITHIN_S, lambda: str(up.processes()))
    assert "supervisor ended by itself with status -9" in up.text()


def test_a_taken_tcp_port_is_found_before_anything_starts(tmp_path: Path) -> None:
    up = Up(tmp_path)
    with socket.create_server(("127.0.0.1", up.gateway)):
        done = up.command("up")
    assert done.returncode == 2
    assert done.stderr.startswith(
        f"vertebra: gateway cannot listen on 127.0.0.1:{up.gateway}, which process {os.getpid()} ("
    )
    assert "set VERTEBRA_GATEWAY_TCP_PORT to another address" in done.stderr
    assert up.processes() == {}


def test_a_service_with_a_bad_setting_is_named_and_the_others_run(tmp_path: Path) -> None:
    up = Up(tmp_path)
    up.environment |= {"VERTEBRA_YARP_NAME_SERVER_BIND": "nonsense", "VERTEBRA_TYPO": "1"}
    process = up.start()
    try:
        until(lambda: "vertebra: waiting for yarp: " in up.text(), 30, up.text)
        until(lambda: "exited: yarp (exit status 2" in up.text(), 30, up.text)
        assert "VERTEBRA_TYPO is set, but compose.yaml hands it to no service" in up.text()
        assert up.pid_of("gateway")
    finally:
        process.terminate()
        process.wait(30)
