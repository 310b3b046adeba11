"""Several adapters: on one ROS domain, on two, and what becomes of their work when one is gone."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import Delivery, MemoryNetwork, Reply, Request, ZenohBus
from vertebra.bus.router import running_router
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError
from vertebra.messages import Message, Text
from vertebra.service import MessageReader
from vertebra.service.settings import load_settings
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra_ros2.settings import Ros2Settings

from .ros2_lab import DOMAINS, ON_LOOPBACK, PEER, ROOT, Lab, Peer, adapter, drain, first, peer

pytestmark = pytest.mark.live

BOTH_WAYS = """
topics:
  - {ros: /chatter, key: robot/said, depth: 200}
  - {ros: /chatter, key: robot/words, type: std_msgs/msg/String, direction: outbound,
     delivery: queue, depth: 64}
services:
  - {ros: /add_two_ints, key: robot/sum}
  - {ros: /fleet_sum, key: lab/sum, type: example_interfaces/srv/AddTwoInts, direction: outbound}
"""
TAKEN_OVER_WITHIN_S = 3.0


@pytest.fixture(autouse=True)
def shared_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two adapters in this process be in one domain, which DDS configures once."""
    monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
    monkeypatch.setenv("VERTEBRA_ROS2_INTERFACE", "auto")


@asynccontextmanager
async def two_adapters(folder: Path) -> AsyncIterator[tuple[Lab, Lab]]:
    """Run two adapters of one domain with the same routes on one backbone."""
    routes = folder / "routes.yaml"
    await asyncio.to_thread(routes.write_text, BOTH_WAYS)
    network, domain_id = MemoryNetwork(), next(DOMAINS)
    async with (
        adapter(network, domain_id, routes, node="one") as one,
        adapter(network, domain_id, routes, node="two", instance="2") as two,
    ):
        yield one, two


async def numbers(reader: MessageReader[Message], count: int) -> list[int]:
    """Return the numbers that the peer `talk` has put into what it said."""
    found: list[int] = []
    async with asyncio.timeout(20):
        async for received in reader:
            assert isinstance(received.message, Text)
            found.append(int(received.message.text.rpartition(" ")[2]))
            if len(found) == count:
                return found
    raise AssertionError


async def test_each_message_of_ros_is_once_on_the_backbone(tmp_path: Path) -> None:
    async with two_adapters(tmp_path) as (one, two), peer(one, "talk"):
        reader = one.read("robot/said")
        said = await numbers(reader, 100)
        assert said == list(range(said[0], said[0] + 100))
        assert await two.carried() == {}
        reader.subscription.close()


async def test_each_message_of_the_backbone_is_once_on_ros_and_does_not_come_back(
    tmp_path: Path,
) -> None:
    async with two_adapters(tmp_path) as (one, two), peer(one, "listen") as listener:
        await listener.until("ready")
        echo, mirrored = one.read("robot/said"), two.read("ros2/chatter")
        publisher = one.publisher("robot/words")
        publisher.publish(Text(text="first"))
        async with asyncio.timeout(10):
            while True:  # until the two have found each other
                publisher.publish(Text(text="hello"))
                if not listener.lines.empty():
                    break
                await asyncio.sleep(0.05)
        await asyncio.sleep(0.5)
        before = listener.lines.qsize()
        for number in range(50):
            publisher.publish(Text(text=str(number)))
            await asyncio.sleep(0.005)
        await asyncio.sleep(0.5)  # a loop would go on
        heard = [listener.lines.get_nowait() for _ in range(listener.lines.qsize())][before:]
        assert heard == [["heard", str(number)] for number in range(50)]
        assert echo.subscription.received == 0
        assert mirrored.subscription.received == 0
        echo.subscription.close()
        mirrored.subscription.close()


async def test_adapter_without_routes_does_not_mirror_what_another_adapter_sends(
    tmp_path: Path,
) -> None:
    routes, nothing = tmp_path / "routes.yaml", tmp_path / "none.yaml"
    routes.write_text(BOTH_WAYS)
    nothing.write_text("")
    network, domain_id = MemoryNetwork(), next(DOMAINS)
    async with (
        adapter(network, domain_id, nothing, node="mirrors") as mirrors,
        adapter(network, domain_id, routes, node="sends", instance="2", automatic=False) as sends,
        peer(sends, "listen") as listener,
    ):
        await listener.until("ready")
        echo = mirrors.read("ros2/chatter")
        publisher = sends.publisher("robot/words")

        async def speak() -> None:
            while True:
                publisher.publish(Text(text="from the fleet"))
                await asyncio.sleep(0.02)

        speaking = asyncio.create_task(speak())
        await listener.until("heard")
        async with peer(sends, "talk"):  # the same topic, of a robot: that one is mirrored
            texts = set()
            for _ in range(20):
                received = await first(echo)
                assert isinstance(received.message, Text)
                texts.add(received.message.text.split()[0])
        speaking.cancel()
        assert texts == {"hello"}
        echo.subscription.close()


async def test_a_call_reaches_a_ros_service_once_and_a_key_once(tmp_path: Path) -> None:
    calls = 0

    async def add(request: Request) -> Reply:
        nonlocal calls
        calls += 1
        terms = json.loads(request.payload)
        total = json.dumps({"sum": terms["a"] + terms["b"]}).encode()
        return Reply(payload=total, encoding="application/json")

    async with two_adapters(tmp_path) as (one, _):
        one.bus.serve("lab/sum", add)
        async with peer(one, "serve_sum") as server:
            await server.until("ready")
            assert await one.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}
            assert await one.call("ros2/add_two_ints", {"a": 1}) == {"sum": 1}
            await asyncio.sleep(0.3)
            asked = [line for line in drained(server) if line[0] == "asked"]
            assert asked == [["asked", 40, 2], ["asked", 1, 0]]
        async with peer(one, "ask_sum", "3") as client:
            for number in (1, 2, 3):
                assert await client.until("sum") == ["sum", True, number, number + 2]
        assert calls == 3


def drained(peer: Peer) -> list[list[Any]]:
    lines = [*peer.kept]
    while not peer.lines.empty():
        lines.append(peer.lines.get_nowait())
    return lines


async def test_the_other_adapter_takes_over_when_one_is_gone(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, BOTH_WAYS)
    network, domain_id = MemoryNetwork(), next(DOMAINS)
    async with (
        adapter(network, domain_id, routes, node="two", instance="2") as two,
        adapter(network, domain_id, routes, node="three", instance="3") as three,
        peer(three, "talk"),
    ):
        assert (await two.carried())["/chatter"] == "robot/words"
        assert await three.carried() == {}
        reader = three.read("robot/said")
        await first(reader)
        two.service.cancel()
        await asyncio.wait([two.service])
        drain(reader)
        async with asyncio.timeout(TAKEN_OVER_WITHIN_S):
            await first(reader)
        async with adapter(network, domain_id, routes, node="two", instance="4") as back:
            assert await back.carried() == {}  # who comes back does not interrupt
            assert (await three.carried())["/chatter"] == "robot/words"
        reader.subscription.close()


async def test_the_other_adapter_takes_over_from_one_that_is_killed(tmp_path: Path) -> None:
    locator, domain_id = f"tcp/127.0.0.1:{free_tcp_port()}", str(next(DOMAINS))
    environment = {
        **os.environ,
        "VERTEBRA_ROUTER": locator,
        "VERTEBRA_HEARTBEAT_DIR": str(tmp_path),
        "VERTEBRA_ROS2_DOMAIN_ID": domain_id,
        "ROS_DOMAIN_ID": domain_id,
    }

    async with AsyncExitStack() as stack:

        async def start(*words: str, **variables: str) -> Process:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                *words,
                cwd=ROOT,
                env=environment | variables,
                stdin=PIPE,
                stdout=DEVNULL,
            )
            stack.push_async_callback(killed, process)
            return process

        stack.enter_context(running_router([locator]))
        bus = await ZenohBus.open(locator, timeout_s=10)
        stack.push_async_callback(bus.close)
        reader = MessageReader(
            bus.subscribe("ros2/chatter", Delivery.queue(5000)), CodecRegistry(), Message
        )
        async with bus.presence("@vertebra/ros2/turns/**") as claims, asyncio.timeout(20):
            first_one = await start("vertebra_ros2", VERTEBRA_INSTANCE="1")
            await anext(claims)
            await start("vertebra_ros2", VERTEBRA_INSTANCE="2", VERTEBRA_ROS2_NODE="two")
            await anext(claims)
        await start(PEER, "talk")
        said = await numbers(reader, 50)
        assert said == list(range(said[0], said[0] + 50))
        await killed(first_one)
        drain(reader)
        began_s = time.monotonic()
        said = await numbers(reader, 1)
        assert time.monotonic() - began_s < TAKEN_OVER_WITHIN_S
        said += await numbers(reader, 50)
        assert said == list(range(said[0], said[0] + 51))


async def killed(process: Process) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    await process.wait()


A_TO_B = "topics: [{ros: /chatter, key: robot/said}]"
B_FROM_A = (
    "topics: [{ros: /chatter, key: robot/said, type: std_msgs/msg/String, direction: outbound,"
    " delivery: queue, depth: 64}]"
)


async def test_message_of_a_domain_reaches_another_domain_once(tmp_path: Path) -> None:
    a_file, b_file = tmp_path / "a.yaml", tmp_path / "b.yaml"
    a_file.write_text(A_TO_B + "\n")
    b_file.write_text(B_FROM_A + "\n")
    network = MemoryNetwork()
    async with (
        adapter(network, next(DOMAINS), a_file, mirror="a") as a,
        adapter(network, next(DOMAINS), b_file, mirror="b", instance="2") as b,
        peer(b, "listen") as listener,
    ):
        await listener.until("ready")
        async with peer(a, "talk"):
            heard = [(await listener.until("heard"))[1] for _ in range(60)]
    numbers = [int(text.rpartition(" ")[2]) for text in heard]
    assert numbers == list(range(numbers[0], numbers[0] + 60))


async def test_mirrors_of_two_domains_are_apart(tmp_path: Path) -> None:
    nothing = tmp_path / "none.yaml"
    nothing.write_text("")
    network = MemoryNetwork()
    async with (
        adapter(network, next(DOMAINS), nothing, mirror="lab/a") as a,
        adapter(network, next(DOMAINS), nothing, mirror="lab/b", instance="2") as b,
        peer(a, "talk"),
        peer(b, "latch"),
        peer(b, "serve_sum"),
    ):
        of_a, of_b = a.read("lab/a/chatter"), b.read("lab/b/chatter")
        assert (await first(of_b)).message == Text(text="from long ago")
        assert (await first(of_a)).message != Text(text="from long ago")
        assert await b.call("lab/b/add_two_ints", {"a": 1}) == {"sum": 1}
        of_a.subscription.close()
        of_b.subscription.close()


async def test_mirror_of_another_domain_is_not_mixed_with_ours(tmp_path: Path) -> None:
    nothing = tmp_path / "none.yaml"
    nothing.write_text("")
    network = MemoryNetwork()
    async with (
        adapter(network, next(DOMAINS), nothing) as a,
        adapter(network, next(DOMAINS), nothing, instance="2") as b,
        peer(b, "talk"),
    ):
        mixed = a.read("ros2/chatter")
        text = await b.told(lambda text: "mirror:" in text)
        assert f"'ros2' is the mirror of domain {a.domain_id}" in text
        assert "VERTEBRA_ROS2_MIRROR" in text
        await asyncio.sleep(0.5)
        assert mixed.subscription.received == 0
        mixed.subscription.close()


@pytest.mark.parametrize("mirror", ["/ros2", "ros2/", "@ros2", "a b", "ros2/**"])
def test_mirror_that_is_no_key_does_not_start(monkeypatch: pytest.MonkeyPatch, mirror: str) -> None:
    monkeypatch.setenv("VERTEBRA_ROS2_MIRROR", mirror)
    with pytest.raises(ConfigError, match="VERTEBRA_ROS2_MIRROR"):
        load_settings(Ros2Settings)


async def test_adapter_of_another_network_with_our_domain_id_is_told(tmp_path: Path) -> None:
    nothing = tmp_path / "none.yaml"
    nothing.write_text("")
    network, domain_id = MemoryNetwork(), next(DOMAINS)
    async with adapter(network, domain_id, nothing) as lab:
        claim = f"@vertebra/ros2/turns/mirror%20at%20elsewhere/1/stranger/{domain_id}/{'ab' * 12}"
        stranger = lab.bus.declare_presence(claim)
        text = await lab.told(lambda text: "not in our ROS network" in text)
        assert f"another adapter is in domain {domain_id}" in text
        stranger.close()
        await lab.told(lambda text: "not in our ROS network" not in text)
        await eventually(lambda: not lab.service.done())
