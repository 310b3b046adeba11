"""`vertebra ros2` beside other participants on loopback."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.live

PEER = Path(__file__).with_name("ros2_peer.py")
ON_LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)
Environment = dict[str, str]


@pytest.fixture
def environment() -> Environment:
    domain = str(random.randrange(90, 100))
    return {**os.environ, "ROS_DOMAIN_ID": domain, "CYCLONEDDS_URI": ON_LOOPBACK}


@contextmanager
def peer(environment: Environment, *role: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, str(PEER), *role], env=environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    with process:
        assert process.stdout.readline().startswith('["ready"')
        yield process
        assert process.stdin is not None
        process.stdin.close()
        process.wait(10)


def tool(environment: Environment, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vertebra.cli", "ros2", *words],
        env=environment, text=True, capture_output=True, timeout=30, check=False,
    )  # fmt: skip


def test_topics_are_listed_with_their_nodes(environment: Environment) -> None:
    with peer(environment, "talk"):
        done = tool(environment, "topics")
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    assert ["/chatter", "std_msgs/msg/String", "/lab/talk", "-"] in rows


def test_service_is_listed_and_called(environment: Environment) -> None:
    with peer(environment, "serve_sum"):
        listed = tool(environment, "services")
        called = tool(environment, "call", "/add_two_ints", '{"a": 40, "b": 2}')
    assert "/add_two_ints  example_interfaces/srv/AddTwoInts\n" in listed.stdout
    assert called.stdout == "sum: 42\n", called.stderr


def test_service_of_fast_dds_says_what_to_do(environment: Environment) -> None:
    with peer(environment, "serve_sum_fast_dds"):
        called = tool(environment, "call", "/add_two_ints")
    assert called.returncode == 1
    assert "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in called.stderr


def test_echo_prints_messages(environment: Environment) -> None:
    with peer(environment, "talk"):
        done = tool(environment, "echo", "/chatter", "-n", "2")
    assert done.stdout.count("---\ndata: hello ") == 2, done.stderr


def test_pub_reaches_a_subscriber(environment: Environment) -> None:
    with peer(environment, "listen") as listener:
        done = tool(environment, "pub", "/chatter", "std_msgs/msg/String", '{"data": "hi"}')
        assert done.returncode == 0, done.stderr
        assert listener.stdout is not None
        assert listener.stdout.readline() == '["heard", "hi"]\n'


def test_actions_of_nobody(environment: Environment) -> None:
    assert tool(environment, "actions", "--wait", "0.1").stdout == "ACTION  TYPE\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["call", "/nobody", "--wait", "0.1"], "nobody offers the ROS service /nobody"),
        (["pub", "/a", "std_msgs/msg/String", '{"dat": 1}'], "there is no field 'dat'"),
        (["pub", "/a", "lab/msg/No", "{}"], "the ROS type lab/msg/No is not known"),
        (["echo", "a-b"], "a ROS name is '/' and tokens"),
        (["pub", "/a", "std_msgs/msg/String", "data"], "'data' is not JSON"),
        (["topics", "--interface", "nowhere0"], "DDS does not start in domain"),
    ],
)
def test_mistake_is_told(environment: Environment, words: list[str], told: str) -> None:
    done = tool(environment, *words)
    assert done.returncode in (1, 2)
    assert told in done.stderr
    assert "Traceback" not in done.stderr
