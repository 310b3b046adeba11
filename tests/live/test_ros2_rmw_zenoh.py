"""The ROS 2 adapter among nodes that imitate rmw_zenoh_cpp, by the fleet's own router."""

from __future__ import annotations

import asyncio
import itertools
import json
import random
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import Delivery, MemoryNetwork, Reply, Request, ZenohBus
from vertebra.bus.router import running_router
from vertebra.codec import CodecRegistry
from vertebra.errors import RemoteError
from vertebra.messages import Image, JointState, Native, Text
from vertebra.service import MessageReader, run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

from .ros2_lab import Lab, Peer, adapter, drain, first, running
from .test_ros2_actions import OFFERED as OFFERED_ACTION
from .test_ros2_actions import counter

pytestmark = pytest.mark.live

PROGRAM = "tests.live.rmw_zenoh_peer"
DOMAINS = itertools.cycle(random.sample(range(30, 40), 10))
STRING = (
    "std_msgs::msg::dds_::String_",
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
)
ADD = (
    "example_interfaces::srv::dds_::AddTwoInts_",
    "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
)
ROUTES = """
topics:
  - {ros: /joint_states, key: robot/joints, depth: 200}
  - {ros: /chatter, key: robot/said}
services:
  - {ros: /add_two_ints, key: robot/sum}
actions:
  - {ros: /fibonacci, key: robot/count}
"""
OUTBOUND = """
topics:
  - {ros: /chatter, key: robot/words, type: std_msgs/msg/String, direction: outbound,
     delivery: queue, depth: 64}
"""
OFFERED = """
services:
  - {ros: /fleet_sum, key: robot/sum, type: example_interfaces/srv/AddTwoInts,
     direction: outbound, timeout_s: 2}
"""


class Router:
    """The router of the fleet, which may go and come again at the same place."""

    def __init__(self) -> None:
        self.tcp_port = free_tcp_port()
        self.locator = f"tcp/127.0.0.1:{self.tcp_port}"
        self._running = ExitStack()

    def start(self) -> None:
        self._running.enter_context(running_router([self.locator]))

    def stop(self) -> None:
        self._running.close()


@dataclass
class Network:
    """One router, and a domain of its own there."""

    router: Router
    domain_id: int
    routes: Path

    def node(self, *role: str) -> AbstractAsyncContextManager[Peer]:
        """Run a node; it looks for its router where every rmw_zenoh node does: on localhost."""
        environment = {
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROUTER": f"tcp/localhost:{self.router.tcp_port}",
        }
        return running(PROGRAM, *role, environment=environment)

    @asynccontextmanager
    async def lab(self, routes: str = ROUTES, **settings: Any) -> AsyncIterator[Lab]:
        await asyncio.to_thread(self.routes.write_text, routes)
        chosen = {"driver": "rmw_zenoh", "zenoh_router": self.router.locator, **settings}
        async with adapter(MemoryNetwork(), self.domain_id, self.routes, **chosen) as lab:
            yield lab


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[Network]:
    router = Router()
    await asyncio.to_thread(router.start)
    yield Network(router, next(DOMAINS), tmp_path / "routes.yaml")
    await asyncio.to_thread(router.stop)


async def test_nodes_find_each_other_by_our_router(network: Network) -> None:
    async with network.node("peers") as one, network.node("listen") as other:
        await other.until("ready")
        await one.until("peers", 1)


@pytest.mark.parametrize("release", ["talk", "talk old", "talk_humble", "talk_best_effort"])
async def test_topic_arrives_with_its_origin(network: Network, release: str) -> None:
    async with network.lab() as lab, network.node(*release.split()):
        received = await first(lab.read("robot/said", Text))
        assert isinstance(received.message, Text)
        assert received.message.text.startswith("hello ")
        assert received.header.origin.endswith(":/chatter")
        assert abs(time.time_ns() - received.header.captured_ns) < 10e9


async def test_topic_is_left_alone_until_someone_subscribes(network: Network) -> None:
    async with network.lab() as lab, network.node("talk"), network.node("watch") as watch:
        ours = ("MS", "%", "%", "vertebra", "%chatter")
        await watch.until("token", "MP", "%", "%lab", "talk", "%chatter")
        await asyncio.sleep(0.5)
        assert not [line for line in watch.lines_so_far() if line[1:6] == list(ours)]
        reader = lab.read("robot/said", Text)
        assert await watch.until("token", *ours) == ["token", *ours, *STRING, "::,64:,:,:,,"]
        await first(reader)
        reader.subscription.close()
        await watch.until("gone", *ours)


async def test_message_without_an_attachment_is_refused(network: Network) -> None:
    async with network.lab() as lab, network.node("talk", "none"):
        reader = lab.read("robot/said", Text)
        async with network.node("talk"):
            assert (await first(reader)).message != Text(text="")
        drain(reader)
        await asyncio.sleep(0.3)
        assert reader.subscription.take() is None


async def dropped(lab: Lab) -> float:
    """Return how many messages were lost, as the adapter counts them."""
    metrics = await lab.bus.call("@vertebra/services/ros2/1/metrics", timeout_s=5)
    lines = metrics.payload.decode().splitlines()
    (line,) = [line for line in lines if line.startswith("vertebra_ros2_dropped_total")]
    return float(line.split()[1])


async def test_what_is_lost_on_the_way_is_counted(network: Network) -> None:
    async with network.lab() as lab, network.node("talk", "gaps"):
        reader = lab.read("robot/said", Text)
        for _ in range(5):
            await first(reader)
        async with asyncio.timeout(10):
            while await dropped(lab) < 8:  # two between each and the next
                await asyncio.sleep(0.1)


async def test_latched_message_reaches_us_late(network: Network) -> None:
    async with network.lab() as lab, network.node("latch") as latch:
        await latch.until("ready")
        received = await first(lab.read("robot/said", Text))
    assert received.message == Text(text="from long ago")


async def test_latched_message_of_a_late_publisher_reaches_us(network: Network) -> None:
    async with network.lab() as lab:
        reader = lab.read("robot/said", Text)
        for _ in range(2):
            async with network.node("latch"):
                # Who is found early enough hears live also what is overwritten then.
                while (await first(reader)).message != Text(text="from long ago"):
                    pass


@pytest.mark.parametrize("release", ["listen", "listen_humble"])
async def test_key_reaches_a_ros_subscriber(network: Network, release: str) -> None:
    async with network.lab(OUTBOUND) as lab, network.node(release) as listener:
        await listener.until("ready")
        publisher = lab.publisher("robot/words")

        async def speak() -> None:
            for number in itertools.count():
                publisher.publish(Text(text=f"number {number}"))
                await asyncio.sleep(0.02)

        speaking = asyncio.create_task(speak())
        heard = [await listener.until("heard") for _ in range(10)]
        speaking.cancel()
    numbers = [int(text.split()[1]) for _, text, _, _ in heard]
    sequences = [sequence for _, _, sequence, _ in heard]
    assert numbers == list(range(numbers[0], numbers[0] + 10)), "each once, and in order"
    assert sequences == list(range(sequences[0], sequences[0] + 10))
    assert len({gid for *_, gid in heard}) == 1


async def test_latched_subscriber_gets_what_was_before_it(network: Network) -> None:
    routes = (
        "topics: [{ros: /chatter, key: robot/words, type: std_msgs/msg/String, "
        "direction: outbound, retain: true, depth: 1}]"
    )
    async with network.lab(routes) as lab:
        lab.publisher("robot/words").publish(Text(text="long ago"))
        lab.publisher("robot/words").publish(Text(text="before"))
        await asyncio.sleep(0.2)
        async with network.node("listen_latched") as listener:
            assert (await listener.until("heard"))[1] == "before"
        async with network.node("listen_latched_humble") as listener:
            assert (await listener.until("heard"))[1] == "before"


@pytest.mark.parametrize("release", ["serve_sum", "serve_sum_humble"])
async def test_ros_service_is_called_by_its_key(network: Network, release: str) -> None:
    async with network.lab() as lab, network.node(release) as server:
        await server.until("ready")
        assert await lab.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}
        assert await lab.call("ros2/add_two_ints", {"a": 1}) == {"sum": 1}
        calls = (lab.call("robot/sum", {"a": number, "b": 1}) for number in range(50))
        assert await asyncio.gather(*calls) == [{"sum": number + 1} for number in range(50)]


async def test_call_without_an_answer_has_a_deadline(network: Network) -> None:
    async with network.lab() as lab, network.node("serve_sum") as server:
        await server.until("ready")
        with pytest.raises((RemoteError, TimeoutError)) as caught:
            await lab.call("robot/sum", {"a": -1}, timeout_s=0.5)
        assert "DeadlineError" in str(caught.value) or isinstance(caught.value, TimeoutError)
        assert await lab.call("robot/sum", {"a": 2}) == {"sum": 2}


async def test_server_that_dies_with_a_request_is_told_before_the_deadline(
    network: Network,
) -> None:
    async with network.lab() as lab, network.node("serve_sum") as server:
        await server.until("ready")
        began_s = time.monotonic()
        with pytest.raises(RemoteError, match="the client of /add_two_ints closes"):
            await lab.call("robot/sum", {"a": 666}, timeout_s=30)
        assert time.monotonic() - began_s < 10


async def test_call_of_nobody_says_so(network: Network) -> None:
    async with network.lab() as lab:
        with pytest.raises(RemoteError, match="nobody offers the ROS service /add_two_ints"):
            await lab.call("robot/sum", {"a": 1})


async def add(request: Request) -> Reply:
    terms = json.loads(request.payload)
    await asyncio.sleep(0.05)
    return Reply(
        payload=json.dumps({"sum": terms["a"] + terms["b"]}).encode(), encoding="application/json"
    )


@pytest.mark.parametrize("release", ["ask_sum", "ask_sum_humble"])
async def test_key_is_called_through_ros(network: Network, release: str) -> None:
    async with network.lab(OFFERED) as lab:
        lab.bus.serve("robot/sum", add)
        async with network.node(release, "3") as client:
            for number in (1, 2, 3):
                assert await client.until("sum") == ["sum", True, number, number + 2]


async def test_request_that_is_none_gets_no_answer_and_the_service_lives(network: Network) -> None:
    async with network.lab(OFFERED) as lab:
        lab.bus.serve("robot/sum", add)
        async with network.node("ask_badly") as client:
            await client.until("done")
            assert client.kept == [["replies", 0]] * 5
        async with network.node("ask_sum", "1") as client:
            assert await client.until("sum") == ["sum", True, 1, 3]


async def test_action_is_started_followed_and_cancelled(network: Network) -> None:
    async with network.lab() as lab, network.node("count_up") as server:
        feedback = lab.read("robot/count/feedback", Native)
        await server.until("ready")
        await lab.told(lambda text: "action /fibonacci" not in text)
        started = await lab.call("robot/count/goal", {"order": 6})
        told = (await first(feedback)).message
        ended = await lab.call("robot/count/result", started)
        assert isinstance(told, Native)
        assert told.value["goal_id"] == started["goal_id"]
        assert ended == {"status": "succeeded", "result": {"sequence": [0, 1, 1, 2, 3, 5, 8]}}
        with pytest.raises(RemoteError, match="refuses this goal"):
            await lab.call("robot/count/goal", {"order": -1})
        started = await lab.call("robot/count/goal", {"order": 1000})
        assert await lab.call("robot/count/cancel", started) == {"cancelling": [started["goal_id"]]}
        assert (await lab.call("robot/count/result", started))["status"] == "canceled"


async def test_ros_client_has_its_goal_reached_by_the_fleet(network: Network) -> None:
    async with (
        network.lab(OFFERED_ACTION) as lab,
        counter(lab),
        network.node("act", "fleet_count", "5") as client,
    ):
        assert await client.until("accepted") == ["accepted", True, 1]
        assert (await client.until("feedback"))[:5] == ["feedback", True, 0, 1, 1]
        assert await client.until("result") == ["result", True, 4, 0, 1, 1, 2, 3, 5]
        await client.until("state", 2)
        await client.until("state", 4)


async def test_two_adapters_carry_each_message_once(network: Network) -> None:
    both_ways = OUTBOUND + "  - {ros: /chatter, key: robot/said, depth: 200}\n"
    await asyncio.to_thread(network.routes.write_text, both_ways)
    backbone = MemoryNetwork()
    chosen = {"driver": "rmw_zenoh", "zenoh_router": network.router.locator}
    async with (
        adapter(backbone, network.domain_id, network.routes, **chosen, node="one") as one,
        adapter(
            backbone, network.domain_id, network.routes, **chosen, node="two", instance="2"
        ) as two,
    ):
        said, mirrored = one.read("robot/said", Text), two.read("ros2/chatter", Text)
        publisher = one.publisher("robot/words")
        async with network.node("listen") as listener:
            await listener.until("ready")
            while not listener.lines_so_far():
                publisher.publish(Text(text="hello"))
                await asyncio.sleep(0.05)
            await asyncio.sleep(0.5)
            listener.lines_so_far().clear()
            for number in range(50):
                publisher.publish(Text(text=str(number)))
                await asyncio.sleep(0.005)
            await asyncio.sleep(0.5)  # a loop would go on
            assert [line[1] for line in listener.lines_so_far()] == list(map(str, range(50)))
        assert (said.subscription.received, mirrored.subscription.received) == (0, 0)
        async with network.node("talk"):
            texts = [(await first(said)).message for _ in range(20)]
        numbers = [int(one.text.split()[1]) for one in texts if isinstance(one, Text)]
        assert numbers == list(range(numbers[0], numbers[0] + 20))


async def test_our_node_is_in_the_graph(network: Network) -> None:
    async with (
        network.lab(OFFERED, node="fleet", namespace="/our") as _,
        network.node("watch") as watch,
    ):
        ours = ("%", "%our", "fleet")
        assert await watch.until("token", "NN", *ours) == ["token", "NN", *ours]
        server = ["token", "SS", *ours, "%fleet_sum", *ADD, "::,10:,:,:,,"]
        assert await watch.until(*server) == server


async def test_killed_node_vanishes_and_a_new_one_is_heard(network: Network) -> None:
    async with network.lab() as lab:
        reader = lab.read("robot/said", Text)
        for _ in range(2):
            async with network.node("talk") as killed:
                await first(reader)
                assert "/image" not in await lab.carried()
                killed.process.kill()
                await killed.process.wait()
            drain(reader)
        async with network.node("images", "100000", "30") as killed:
            await first(lab.read("ros2/image", Image))
            assert (await lab.carried())["/image"] == "ros2/image"
            killed.process.kill()
            await killed.process.wait()
        async with asyncio.timeout(5):
            while "/image" in await lab.carried():
                await asyncio.sleep(0.05)


async def test_everything_comes_back_with_the_router(network: Network) -> None:
    async with (
        network.lab(ROUTES + "  - {ros: /unused, key: unused}\n") as lab,
        network.node("talk"),
        network.node("serve_sum") as server,
    ):
        await server.until("ready")
        reader = lab.read("robot/said", Text)
        await first(reader)
        await asyncio.to_thread(network.router.stop)
        await asyncio.sleep(0.5)
        drain(reader)
        await asyncio.to_thread(network.router.start)
        async with asyncio.timeout(20):
            while (received := reader.subscription.take()) is None:
                await asyncio.sleep(0.05)
        assert received is not None
        assert await lab.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}


async def test_two_domains_on_one_router(network: Network) -> None:
    other = Network(network.router, network.domain_id + 10, network.routes.with_name("other.yaml"))
    async with network.lab() as lab, other.lab() as other_lab, other.node("talk"):
        here, there = lab.read("robot/said", Text), other_lab.read("robot/said", Text)
        await first(there)
        assert here.subscription.take() is None


async def test_joint_stream_of_1_khz_loses_nothing(network: Network) -> None:
    async with network.lab() as lab:
        reader = lab.read("robot/joints", JointState)
        async with network.node("joints", "2000", "1000") as robot:
            received = []
            async with asyncio.timeout(30):
                async for one in reader:
                    received.append(one)
                    if len(received) == 2000:
                        break
            await robot.until("sent")
    assert [one.header.sequence for one in received] == list(range(2000))
    message = received[0].message
    assert isinstance(message, JointState)
    assert list(message.names) == ["pan", "yaw"]


async def test_vga_images_arrive_at_30_hz(network: Network) -> None:
    """A publisher of rmw_zenoh drops what a busy machine does not let through: that is counted."""
    async with network.lab() as lab, network.node("images", "100000", "30"):
        reader = lab.read("ros2/image", Image)
        received = [await first(reader) for _ in range(60)]
        assert await dropped(lab) < 60
    message = received[0].message
    assert isinstance(message, Image)
    assert message.pixels.shape == (480, 640, 3)
    sequences = [one.header.sequence for one in received]
    assert sequences == list(range(sequences[0], sequences[0] + 60))


async def test_fleet_and_ros_nodes_share_one_router(network: Network) -> None:
    """The backbone is on the router that ROS nodes use; without a setting that is where we look."""
    settings = Ros2Settings(
        driver="rmw_zenoh", domain_id=network.domain_id, router=network.router.locator
    )
    bus = await ZenohBus.open(network.router.locator, shared_memory=False)
    own = await ZenohBus.open(network.router.locator, shared_memory=False)
    service = asyncio.create_task(run_service("ros2", settings, serve, bus=own))
    try:
        reader = MessageReader(
            bus.subscribe("ros2/chatter", Delivery.queue(100)), CodecRegistry(), Text
        )
        async with network.node("talk"), asyncio.timeout(10):
            received = await anext(aiter(reader))
        assert received.message.text.startswith("hello ")
    finally:
        service.cancel()
        await asyncio.wait([service], timeout=5)
        await bus.close()
        await own.close()
    await eventually(service.done)


async def tool(network: Network, *words: str) -> tuple[int | None, str, str]:
    """Run a part of `vertebra ros2`; return its status, output and errors."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "vertebra.cli", "ros2", words[0], "--driver", "rmw_zenoh",
        "--router", network.router.locator, "--domain", str(network.domain_id), *words[1:],
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    output, errors = await asyncio.wait_for(process.communicate(), 30)
    return process.returncode, output.decode(), errors.decode()


async def test_tools_list_echo_call_and_publish(network: Network) -> None:
    async with network.node("talk") as talker, network.node("serve_sum") as server:
        await talker.until("ready")
        await server.until("ready")
        _, topics, _ = await tool(network, "topics")
        _, echoed, _ = await tool(network, "echo", "/chatter", "-n", "2")
        _, called, _ = await tool(network, "call", "/add_two_ints", '{"a": 40, "b": 2}')
    assert ["/chatter", "std_msgs/msg/String", "/lab/talk", "-"] in [
        line.split() for line in topics.splitlines()
    ]
    assert echoed.count("---\ndata: hello ") == 2
    assert called == "sum: 42\n"
    async with network.node("listen") as listener:
        await listener.until("ready")
        status, *_ = await tool(network, "pub", "/chatter", "std_msgs/msg/String", '{"data": "hi"}')
        assert status == 0
        assert (await listener.until("heard"))[1:3] == ["hi", 1]


async def test_tool_without_a_router_says_so(network: Network) -> None:
    nowhere = Router()
    status, _, errors = await tool(Network(nowhere, 0, network.routes), "topics")
    assert status == 1
    assert f"no Zenoh router answers at {nowhere.locator}" in errors
    status, _, errors = await tool(network, "topics", "--driver", "rmw")
    assert status == 2
    assert "'rmw' is no driver" in errors
