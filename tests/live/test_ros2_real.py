"""The adapter beside the real ROS 2: nodes of rclpy and the `ros2` tool, for both drivers of DDS.

They run on the middleware that `RMW_IMPLEMENTATION` names, or on ROS's default.
"""

from __future__ import annotations

import asyncio
import importlib
import itertools
import json
import os
import random
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import MemoryNetwork, Reply, Request
from vertebra.errors import CommandRefusedError, RemoteError
from vertebra.messages import JointState, Native, Text
from vertebra.testing.bus_suite import eventually

from .ros2_lab import ON_LOOPBACK, Lab, adapter, first

pytestmark = [pytest.mark.live, pytest.mark.installed_ros]

DOMAINS = itertools.cycle(random.sample(range(10, 20), 10))
PROGRAMS = {
    "talker": "demo_nodes_py",
    "listener": "demo_nodes_py",
    "add_two_ints_server": "demo_nodes_py",
    "add_two_ints_client": "demo_nodes_py",
    "server": "examples_rclpy_minimal_action_server",
    "client_cancel": "examples_rclpy_minimal_action_client",
}
MISSING = (
    "there is no ROS 2 with demo_nodes_py and examples_rclpy_minimal_action_*; install them and "
    "source its setup.bash"
)
ROUTES = """
topics:
  - {ros: /chatter, key: lab/said}
  - {ros: /joint_states, key: robot/joints, type: sensor_msgs/msg/JointState, direction: outbound}
  - {ros: /greeting, key: robot/says, type: std_msgs/msg/String, direction: outbound, retain: true}
services:
  - {ros: /add_two_ints, key: lab/sum}
  - {ros: /robot/add, key: robot/add, type: example_interfaces/srv/AddTwoInts, direction: outbound}
  - {ros: /robot/switch, key: robot/switch, type: std_srvs/srv/SetBool, direction: outbound}
actions:
  - {ros: /fibonacci, key: lab/count}
  - {ros: /robot/count, key: lab/count, type: example_interfaces/action/Fibonacci,
     direction: outbound}
"""
NOW = ("--no-daemon", "--spin-time", "2")
JOINTS_TYPE = "sensor_msgs/msg/JointState"
JOINTS = JointState(names=("neck",), positions_deg=(90.0,))


def program(name: str) -> Path:
    """Return the path of a program of ROS."""
    found = [
        Path(prefix, "lib", PROGRAMS[name], name)
        for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":")
        if prefix and Path(prefix, "lib", PROGRAMS[name], name).is_file()
    ]
    if not found or shutil.which("ros2") is None:
        pytest.skip(MISSING)
    return found[0]


@pytest.fixture(scope="module", autouse=True)
def sockets_for_ever() -> None:
    """Let Fast DDS open, before tests are watched, the sockets that it keeps."""
    try:
        rclpy = importlib.import_module("rclpy")
    except ImportError:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        rclpy.init(args=[], domain_id=next(DOMAINS))
        rclpy.create_node("first").destroy_node()
        rclpy.shutdown()


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> int:
    for name in PROGRAMS:
        program(name)
    domain_id = next(DOMAINS)
    monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    return domain_id


@pytest.fixture(params=["dds", "rclpy"])
async def lab(request: pytest.FixtureRequest, domain_id: int, tmp_path: Path) -> AsyncIterator[Lab]:
    middleware = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    if request.param == "dds" and middleware != "rmw_cyclonedds_cpp":
        pytest.skip(
            f"the driver dds does not reach services of {middleware}; set "
            "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"
        )
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    settings = {"driver": request.param, "interface": "auto"}
    async with adapter(MemoryNetwork(), domain_id, routes, **settings) as lab:
        yield lab


class Program:
    """A program of ROS that runs, and what it has printed."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.printed = ""

    async def read(self) -> None:
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            self.printed += line.decode()

    async def until(self, text: str) -> None:
        """Wait until it has printed a text."""
        try:
            await eventually(lambda: text in self.printed, timeout_s=20)
        except TimeoutError:
            pytest.fail(f"{text!r} is not in what was printed: {self.printed}")


@asynccontextmanager
async def running(*command: str | Path) -> AsyncIterator[Program]:
    """Run a program of ROS, ended by SIGTERM."""
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    running = Program(process)
    reading = asyncio.create_task(running.read())
    try:
        yield running
    finally:
        if process.returncode is None:
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), 10)
        except TimeoutError:
            process.kill()
            await process.wait()
        await reading


async def tool(*words: str) -> str:
    """Return what the `ros2` tool prints."""
    async with running("ros2", *words) as ros2:
        await asyncio.wait_for(ros2.process.wait(), 30)
    return ros2.printed


async def until_told(text: str, *words: str) -> None:
    """Ask the `ros2` tool until it tells so: the names of nodes and actions come when they like."""
    async with asyncio.timeout(40):
        while text not in await tool(*words):
            continue


async def until_offered(lab: Lab, ros: str) -> None:
    """Wait until the adapter knows a topic of a node."""
    async with asyncio.timeout(20):
        while ros not in await lab.carried():
            await asyncio.sleep(0.05)


async def until_served(lab: Lab, ros: str) -> None:
    """Wait until the adapter no longer tells that nobody offers a service or an action."""
    await lab.told(lambda text: f"{ros}: nobody offers it" not in text)


@asynccontextmanager
async def publishing(lab: Lab, message: Any, key: str) -> AsyncIterator[None]:
    """Publish on the backbone at 50 Hz."""

    async def publish() -> None:
        publisher = lab.publisher(key)
        while True:
            publisher.publish(message)
            await asyncio.sleep(0.02)

    task = asyncio.create_task(publish())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


async def add(request: Request) -> Reply:
    asked = json.loads(request.payload)
    return Reply(
        payload=json.dumps({"sum": asked["a"] + asked["b"]}).encode(), encoding="application/json"
    )


async def refuse(_: Request) -> Reply:
    raise CommandRefusedError("the motors are hot")


# What ROS nodes have, on the backbone


async def test_a_talker_is_heard_by_its_route(lab: Lab) -> None:
    async with running(program("talker")):
        received = await asyncio.wait_for(first(lab.read("lab/said", Text)), 20)
    assert isinstance(received.message, Text)
    assert received.message.text.startswith("Hello World: ")


async def test_what_has_no_route_is_in_the_mirror(lab: Lab) -> None:
    async with running(program("talker")):
        await until_offered(lab, "/rosout")
        received = await asyncio.wait_for(first(lab.read("ros2/rosout", Native)), 20)
    assert isinstance(received.message, Native)
    assert received.message.value["name"] == "talker"


async def test_a_service_is_called(lab: Lab) -> None:
    async with running(program("add_two_ints_server")):
        await until_served(lab, "/add_two_ints")
        for a in range(3):
            assert await lab.call("lab/sum", {"a": a, "b": 40}, 20) == {"sum": a + 40}


async def test_parameters_are_read_and_set(lab: Lab) -> None:
    async with running(program("talker")) as talker:
        await talker.until("Hello World")
        await until_offered(lab, "/chatter")
        node = "ros2/talker/parameters"
        assert (await lab.call(f"{node}/get", {}, 10))["use_sim_time"] is False
        await lab.call(f"{node}/set", {"use_sim_time": True}, 10)
        assert await lab.call(f"{node}/get", {"names": ["use_sim_time"]}, 10) == {
            "use_sim_time": True
        }
        told = await lab.call(f"{node}/describe", {"names": ["use_sim_time"]}, 10)
        assert told["use_sim_time"]["type"] == "boolean"
        with pytest.raises(RemoteError, match="is string, the parameter is boolean"):
            await lab.call(f"{node}/set", {"use_sim_time": "no bool"}, 10)


async def test_a_goal_is_followed_to_its_result(lab: Lab) -> None:
    async with running(program("server")):
        await until_served(lab, "/fibonacci")
        feedback = lab.read("lab/count/feedback", Native)
        sent = await lab.call("lab/count/goal", {"order": 3}, 20)
        told = await asyncio.wait_for(first(feedback), 20)
        done = await lab.call("lab/count/result", sent, 20)
    assert isinstance(told.message, Native)
    assert told.message.value["goal_id"] == sent["goal_id"]
    assert done["status"] == "succeeded"
    assert done["result"] == {"sequence": [0, 1, 1, 2]}


async def test_a_goal_is_cancelled(lab: Lab) -> None:
    async with running(program("server")) as server:
        await until_served(lab, "/fibonacci")
        sent = await lab.call("lab/count/goal", {"order": 40}, 20)
        await lab.call("lab/count/cancel", sent, 10)
        done = await lab.call("lab/count/result", sent, 20)
        await server.until("Goal canceled")
    assert done["status"] == "canceled"


# What the backbone has, for ROS nodes


async def test_a_listener_hears_the_backbone(lab: Lab) -> None:
    said = publishing(lab, Text(text="from the backbone"), "robot/says")
    renamed = ("--ros-args", "-r", "chatter:=/greeting")
    async with said, running(program("listener"), *renamed) as listener:
        await listener.until("I heard: [from the backbone]")


async def test_a_client_is_answered(lab: Lab) -> None:
    lab.bus.serve("robot/add", add)
    renamed = ("--ros-args", "-r", "add_two_ints:=/robot/add")
    async with running(program("add_two_ints_client"), *renamed) as client:
        await client.until("Result of add_two_ints: 5")


async def test_an_action_client_follows_a_goal_and_cancels_it(lab: Lab) -> None:
    renamed = ("--ros-args", "-r", "fibonacci:=/robot/count")
    async with running(program("server")), running(program("client_cancel"), *renamed) as client:
        await client.until("Goal accepted")
        await client.until("Received feedback")
        await client.until("Goal successfully canceled")


# The `ros2` tool


async def test_topics_are_listed_and_described(lab: Lab) -> None:
    await until_told(f"/joint_states [{JOINTS_TYPE}]", "topic", "list", "-t", *NOW)
    listed = await tool("topic", "list", "-t", *NOW)
    assert "/greeting [std_msgs/msg/String]" in listed
    told = await tool("topic", "info", "-v", "/greeting", *NOW)
    assert "Publisher count: 1" in told
    assert "Node name: vertebra" in told
    assert "Durability: TRANSIENT_LOCAL" in told
    assert "Topic type hash: RIHS01_" in told
    assert "Failed to parse" not in listed + told


async def test_messages_are_echoed_and_counted(lab: Lab) -> None:
    async with publishing(lab, JOINTS, "robot/joints"):
        echoed = await tool("topic", "echo", "/joint_states", JOINTS_TYPE, "--once", "--no-daemon")
        assert "- neck" in echoed
        assert "1.5707963267948966" in echoed
        async with running("ros2", "topic", "hz", "/joint_states", "--window", "50") as hz:
            await hz.until("average rate")
    rate_hz = float(re.findall(r"average rate: ([\d.]+)", hz.printed)[0])
    assert 20 < rate_hz < 60


async def test_what_is_retained_reaches_who_comes_late(lab: Lab) -> None:
    lab.publisher("robot/says").publish(Text(text="kept"))
    late = ("--qos-durability", "transient_local", "--qos-reliability", "reliable", "--no-daemon")
    words = ("topic", "echo", "/greeting", "std_msgs/msg/String", "--once")
    assert "data: kept" in await tool(*words, *late)


async def test_messages_are_published(lab: Lab) -> None:
    reader = lab.read("lab/said", Text)
    words = ("topic", "pub", "--times", "3", "--rate", "5", "-w", "1", "/chatter")
    async with running("ros2", *words, "std_msgs/msg/String", "{data: by hand}"):
        received = await asyncio.wait_for(first(reader), 20)
    assert isinstance(received.message, Text)
    assert received.message.text == "by hand"


async def test_services_are_listed_and_called(lab: Lab) -> None:
    lab.bus.serve("robot/add", add)
    lab.bus.serve("robot/switch", refuse)
    kind = "example_interfaces/srv/AddTwoInts"
    await until_told(f"/robot/add [{kind}]", "service", "list", "-t", *NOW)
    assert "sum=42" in await tool("service", "call", "/robot/add", kind, "{a: 40, b: 2}")
    refused = await tool("service", "call", "/robot/switch", "std_srvs/srv/SetBool", "{data: true}")
    assert "success=False" in refused
    assert "the motors are hot" in refused


async def test_a_goal_is_sent_with_feedback(lab: Lab) -> None:
    kind = "example_interfaces/action/Fibonacci"
    async with running(program("server")):
        await until_offered(lab, "/rosout")
        try:
            await until_told(f"/robot/count [{kind}]", "action", "list", "-t")
        finally:
            await tool("daemon", "stop")  # alone this one cannot do without
        done = await tool("action", "send_goal", "/robot/count", kind, "{order: 3}", "--feedback")
    assert "Goal accepted with ID" in done
    assert "Feedback:" in done
    assert "Goal finished with status: SUCCEEDED" in done
    assert done.count("- 2") >= 1


async def test_our_node_is_listed_and_described(lab: Lab) -> None:
    await until_told("/vertebra\n", "node", "list", *NOW)
    told = await tool("node", "info", "/vertebra", *NOW)
    assert "/joint_states: sensor_msgs/msg/JointState" in told
    assert "/robot/add: example_interfaces/srv/AddTwoInts" in told
    assert "/robot/count: example_interfaces/action/Fibonacci" in told


async def test_settings_of_our_node_are_parameters(lab: Lab) -> None:
    await until_told("  domain_id\n", "param", "list", "/vertebra", *NOW)
    got = await tool("param", "get", "/vertebra", "domain_id", *NOW)
    assert f"Integer value is: {lab.domain_id}" in got
    refused = await tool("param", "set", "/vertebra", "domain_id", "5", *NOW)
    assert "set VERTEBRA_ROS2_DOMAIN_ID and restart the service" in refused
    told = await tool("param", "describe", "/vertebra", "automatic", *NOW)
    assert "Type: boolean" in told
    assert "Read only: true" in told


# Nodes on another middleware than the driver's


async def test_fast_dds_is_heard_and_its_services_are_recognised(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefixes = os.environ["AMENT_PREFIX_PATH"].split(":")
    index = "share/ament_index/resource_index/rmw_typesupport/rmw_fastrtps_cpp"
    if not any(Path(prefix, index).is_file() for prefix in prefixes):
        pytest.skip("this ROS has no rmw_fastrtps_cpp; install it")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    async with (
        adapter(MemoryNetwork(), domain_id, routes, driver="dds", interface="auto") as lab,
        running(program("talker")),
        running(program("add_two_ints_server")),
    ):
        received = await asyncio.wait_for(first(lab.read("lab/said", Text)), 20)
        assert isinstance(received.message, Text)
        told = await lab.told(lambda text: "service /add_two_ints: its node runs another" in text)
        assert "VERTEBRA_ROS2_DRIVER=rclpy" in told
        with pytest.raises(RemoteError, match="RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"):
            await lab.call("lab/sum", {"a": 1, "b": 2}, 20)


async def test_a_type_that_ros_does_not_have_stops_only_its_route(
    domain_id: int, tmp_path: Path
) -> None:
    types, routes = tmp_path / "lab_msgs/msg", tmp_path / "routes.yaml"
    types.mkdir(parents=True)
    (types / "Strange.msg").write_text("int32 x\n")
    routes.write_text(
        "topics:\n  - {ros: /chatter, key: lab/said}\n"
        "  - {ros: /odd, key: lab/odd, type: lab_msgs/msg/Strange, direction: outbound}\n"
    )
    settings = {"driver": "rclpy", "interface": "auto", "types": (tmp_path / "lab_msgs",)}
    async with (
        adapter(MemoryNetwork(), domain_id, routes, **settings) as lab,
        running(program("talker")),
    ):
        told = await lab.told(lambda text: "lab_msgs/msg/Strange" in text)
        assert "route /odd: the ROS here does not have the type" in told
        received = await asyncio.wait_for(first(lab.read("lab/said", Text)), 20)
        assert isinstance(received.message, Text)
