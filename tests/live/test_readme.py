"""Every command in README.md runs, and does what README says."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import pytest

from .test_up import ROOT, Up, running, until

pytestmark = pytest.mark.live

README: Final = (ROOT / "README.md").read_text(encoding="utf-8")
README_OF_YARP: Final = (ROOT / "services/yarp/README.md").read_text(encoding="utf-8")
ELSEWHERE: Final = {
    "up": ("tests/live/test_up.py", '"up"'),
    "containers": ("tests/e2e/conftest.py", "DockerCompose"),
    "test": (".ci/run", "./vertebra test"),
}
"""Blocks that a test of their own runs, and what shows that it does."""


class Block(NamedTuple):
    where: str
    language: str
    text: str


def blocks_of(text: str) -> list[Block]:
    found = re.finditer(r"<!-- run: (\w+) -->\n```(\w+)\n(.*?)```", text, re.DOTALL)
    return [Block(*match.groups()) for match in found]


BLOCKS: Final = blocks_of(README)


def in_fleet(number: int) -> Block:
    return [block for block in BLOCKS if block.where == "fleet"][number]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Up, Path]]:
    """A running fleet, and a folder that looks like its checkout."""
    with running(tmp_path_factory.mktemp("readme")) as (up, _):
        folder = tmp_path_factory.mktemp("desk")
        (folder / "vertebra").symlink_to(ROOT / "vertebra")
        (folder / ".venv").symlink_to(Path(sys.executable).parents[1])
        (folder / "deploy").mkdir()
        (folder / "deploy" / "secrets").symlink_to(up.folder / "secrets")
        yield up, folder


def run(block: Block, up: Up, folder: Path) -> subprocess.CompletedProcess[str]:
    if "curl " in block.text and shutil.which("curl") is None:
        pytest.skip("there is no curl; apt-get install curl")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        env=up.environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=50,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def test_every_command_is_run_by_some_test() -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    in_fleets = [block for block in BLOCKS if block.where == "fleet"]
    assert {f"in_fleet({number})" in source for number in range(len(in_fleets))} == {True}
    fences = re.findall(r"^```(?:sh|python)$", README, re.MULTILINE)
    assert len(fences) == len(BLOCKS)
    for block in BLOCKS:
        if block.where not in {"fleet", "python", "check"}:
            place, sign = ELSEWHERE[block.where]
            assert sign in (ROOT / place).read_text(encoding="utf-8")


def test_curl_drives_and_watches_the_robot(desk: tuple[Up, Path]) -> None:
    said = run(in_fleet(0), *desk).stdout
    assert '"online":true' in said
    assert '"min_deg"' in said
    assert '"reached":true' in said
    assert '"neck_yaw":20.0' in said
    assert '"schema":"vertebra/Faces/1"' in said
    # In a single image nobody may be found: the face moves, and what is doubtful is not shown.
    setup, _, commands = in_fleet(0).text.partition("\n\n")
    (line,) = (line for line in commands.splitlines() if "camera/left/faces" in line)
    look = in_fleet(0)._replace(text=f"{setup}\n{line}")
    until(lambda: '"track_id"' in run(look, *desk).stdout, 10, lambda: "no face is found")
    folder = desk[1]
    assert (folder / "snapshot.jpg").read_bytes()[:2] == b"\xff\xd8"
    assert (folder / "stream.mjpeg").read_bytes().count(b"image/jpeg") > 10


def test_a_position_outside_the_limits_is_refused_with_the_limit(desk: tuple[Up, Path]) -> None:
    said = run(in_fleet(1), *desk).stdout
    assert '"status":422' in said
    assert '"limit":{"min":-' in said


def test_curl_drives_the_base_and_watches_it(desk: tuple[Up, Path]) -> None:
    said = run(in_fleet(2), *desk).stdout
    assert '"stops_in_s":1.0' in said
    events = re.findall(r"^data: .*\"position_m\":\[(-?[\d.e-]+),", said, re.MULTILINE)
    assert len(events) > 5
    assert float(events[-1]) < float(events[0])
    left_m = re.findall(r'"distance_remaining":([\d.]+)', said)
    assert float(left_m[-1]) < float(left_m[0])
    assert '"cancelling":["' in said
    assert '"status":"canceled"' in said


def test_shell_commands_show_and_move(desk: tuple[Up, Path]) -> None:
    said = run(
        in_fleet(3)._replace(text=in_fleet(3).text.replace("doctor", "doctor || true")), *desk
    )
    assert "vizzy/head/state" in said.stdout
    assert '"reached"' in said.stdout


def run_yarp(block: Block, up: Up, folder: Path) -> str:
    """Run YARP's tools, which find the fleet's name server as YARP finds it."""
    host, _, tcp_port = up.environment["VERTEBRA_YARP_NAME_SERVER_BIND"].rpartition(":")
    (folder / "yarp.conf").write_text(f"{host} {tcp_port} yarp\n", encoding="utf-8")
    setting = f"export YARP_CONFIG_HOME={folder}\n"
    return run(block._replace(text=setting + block.text), up, folder).stdout


def test_tools_of_yarp(desk: tuple[Up, Path]) -> None:
    said = run_yarp(in_fleet(4), *desk)
    assert "registration name /vizzy/imu ip 127.0.0.1 port " in said
    assert re.search(r"^\d+ \d+\.\d{4}     -?\d.* -?\d", said, re.MULTILINE)
    assert "Response: [is] [axes] 6 " in said
    assert 'This is "/vizzy/camera/left" at "tcp://127.0.0.1:' in said


def test_tools_in_the_readme_of_the_yarp_service(desk: tuple[Up, Path]) -> None:
    (block,) = (block for block in blocks_of(README_OF_YARP) if block.where == "tools")
    said = run_yarp(block, *desk)
    assert "registration name /vizzy/head/rpc:i ip" in said
    assert re.search(r"Response: \[is\] \[encs\] \(", said)
    assert "Testing /vizzy/imu at tcp://127.0.0.1:" in said
    assert "removing" not in said


def test_tools_of_ros2(desk: tuple[Up, Path]) -> None:
    up, folder = desk
    setting = f"export ROS_DOMAIN_ID={up.environment['VERTEBRA_ROS2_DOMAIN_ID']}\n"
    block = in_fleet(5)
    said = run(block._replace(text=setting + block.text), up, folder).stdout
    assert re.search(r"^/odom +nav_msgs/msg/Odometry +/vizzy_base ", said, re.MULTILINE)
    assert "child_frame_id: base_link" in said
    assert "distance_remaining: " in said
    assert "status: succeeded" in said


def test_python_example_sees_the_camera(desk: tuple[Up, Path]) -> None:
    up, folder = desk
    (block,) = (block for block in BLOCKS if block.where == "python")
    program = block.text.replace("tcp/127.0.0.1:7447", up.environment["VERTEBRA_ROUTER"])
    assert program != block.text
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert done.returncode == 0, done.stderr
    assert "(240, 320, 3)" in done.stdout


def test_settings_of_a_lab_are_checked(desk: tuple[Up, Path]) -> None:
    (block,) = (block for block in BLOCKS if block.where == "check")
    assert "name_server: 192.168.1.10:10000" in run(block, *desk).stdout
