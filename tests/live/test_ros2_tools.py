"""`vertebra ros2` beside other participants on loopback."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from .ros2_lab import ON_LOOPBACK, PEER, ROOT

pytestmark = pytest.mark.live

Environment = dict[str, str]


@pytest.fixture
def environment() -> Environment:
    domain = str(random.randrange(90, 100))
    return {**os.environ, "ROS_DOMAIN_ID": domain, "CYCLONEDDS_URI": ON_LOOPBACK}


@contextmanager
def peer(environment: Environment, *role: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", PEER, *role], cwd=ROOT, env=environment, text=True,
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


def test_goal_is_followed_to_its_end(environment: Environment) -> None:
    with peer(environment, "count_up"):
        listed = tool(environment, "actions")
        done = tool(environment, "send_goal", "/fibonacci", '{"order": 4}')
        refused = tool(environment, "send_goal", "/fibonacci", '{"order": -4}')
    assert "/fibonacci  example_interfaces/action/Fibonacci\n" in listed.stdout
    assert done.returncode == 0, done.stderr
    parts = done.stdout.split("---\n")
    assert parts[0].startswith("accepted: ")
    assert parts[1] == "sequence: [0, 1, 1]\n"
    assert "status: succeeded\n" in parts[-1]
    assert "[0, 1, 1, 2, 3]" in parts[-1]
    assert refused.returncode == 1
    assert "the action server of /fibonacci refuses this goal" in refused.stderr


@pytest.mark.parametrize("words", [(), ("--timeout", "1")])
def test_goal_is_cancelled_with_the_program(
    environment: Environment, words: tuple[str, ...]
) -> None:
    with peer(environment, "count_up") as server:
        command = [sys.executable, "-m", "vertebra.cli", "ros2", "send_goal", "/fibonacci"]
        with subprocess.Popen(
            [*command, '{"order": 100000}', *words], env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        ) as sending:  # fmt: skip
            assert sending.stdout is not None
            goal_id = sending.stdout.readline().removeprefix("accepted: ").strip()
            if not words:
                sending.send_signal(signal.SIGINT)
            out, errors = sending.communicate(timeout=10)
        assert f"cancelled: {goal_id}\n" in out
        assert sending.returncode == (1 if words else 0), errors
        assert server.stdout is not None
        assert server.stdout.readline() == f'["cancelled", "{goal_id}"]\n'


def test_parameters_are_listed_read_and_set(environment: Environment) -> None:
    with peer(environment, "have_parameters"):
        listed = tool(environment, "param", "list")
        assert tool(environment, "param", "set", "/lab/camera", "rate", "5").returncode == 0
        read = tool(environment, "param", "get", "/lab/camera")
        refused = tool(environment, "param", "set", "/lab/camera", "rate", "500")
        unfit = tool(environment, "param", "set", "/lab/camera", "rate", "fast")
        unknown = tool(environment, "param", "get", "/lab/camera", "rat")
    rows = [line.split() for line in listed.stdout.splitlines()]
    assert ["/lab/camera", "many", "double", "array"] in rows
    assert ["/lab/camera", "rate", "double"] in rows
    assert read.stdout == "many: [1.5]\nrate: 5.0\n", read.stderr
    assert "/lab/camera does not set rate: rate is below 100" in refused.stderr
    assert "'fast' is string, the parameter is double" in unfit.stderr
    assert "/lab/camera has not all of the parameters rat" in unknown.stderr


def test_actions_of_nobody(environment: Environment) -> None:
    assert tool(environment, "actions", "--wait", "0.1").stdout == "ACTION  TYPE\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["call", "/nobody", "--wait", "0.1"], "nobody offers the ROS service /nobody"),
        (["pub", "/a", "std_msgs/msg/String", '{"dat": 1}'], "there is no field 'dat'"),
        (["pub", "/a", "lab/msg/No", "{}"], "the ROS type lab/msg/No is not known"),
        (
            ["send_goal", "/nobody", "--wait", "0.1"],
            "nobody offers the ROS service /nobody/_action",
        ),
        (["param", "get", "/nobody", "--wait", "0.1"], "nobody offers the ROS service /nobody/"),
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
