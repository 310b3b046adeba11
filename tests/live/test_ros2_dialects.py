"""ROS nodes of another middleware, and of another release, than those whose services we speak."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import Reply, Request
from vertebra.errors import RemoteError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation
from vertebra.ros2.drivers import open_driver
from vertebra.ros2.qos import Qos
from vertebra.testing.bus_suite import eventually

from .ros2_lab import DOMAINS, Lab, lab_with, peer

pytestmark = pytest.mark.live

REMEDIES = ("RMW_IMPLEMENTATION=rmw_cyclonedds_cpp", "VERTEBRA_ROS2_DRIVER=rclpy")
OFFERED = """
services:
  - {ros: /fleet_sum, key: robot/sum, type: example_interfaces/srv/AddTwoInts, direction: outbound}
"""


async def assert_refused_at_once(lab: Lab, key: str) -> None:
    began_s = time.monotonic()
    with pytest.raises(RemoteError) as refused:
        await lab.call(key, {"a": 1})
    assert time.monotonic() - began_s < 1
    assert all(remedy in str(refused.value) for remedy in REMEDIES)


async def test_a_server_of_fast_dds_is_recognised_and_sent_nothing(tmp_path: Path) -> None:
    async with lab_with(tmp_path, "services: [{ros: /add_two_ints, key: robot/sum}]") as lab:
        async with peer(lab, "serve_sum_fast_dds") as other:
            await other.until("ready")
            text = await lab.told(lambda text: "ROS services: 1 cannot be called" in text)
            assert all(word in text for word in ("/add_two_ints", *REMEDIES))
            await assert_refused_at_once(lab, "robot/sum")
            await assert_refused_at_once(lab, "ros2/add_two_ints")
            async with peer(lab, "serve_sum") as server:  # a request would reach both of them
                await server.until("ready")
                await asyncio.sleep(0.5)
                await assert_refused_at_once(lab, "robot/sum")
            assert "asked" not in [line[0] for line in other.lines_so_far()]
        async with peer(lab, "serve_sum") as server:
            await server.until("ready")
            await lab.told(lambda text: "cannot be called" not in text)
            assert await lab.call("robot/sum", {"a": 40, "b": 2}) == {"sum": 42}


async def test_a_client_of_fast_dds_is_recognised_and_not_answered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    asked = []

    async def answer(request: Request) -> Reply:
        asked.append(request.payload)
        return Reply(payload=b'{"sum": 0}', encoding="application/json")

    async with lab_with(tmp_path, OFFERED) as lab:
        lab.bus.serve("robot/sum", answer)
        async with peer(lab, "ask_sum_fast_dds", "3") as client:
            await client.until("ready")
            text = await lab.told(lambda text: "a client cannot be answered" in text)
            assert all(word in text for word in ("/fleet_sum", *REMEDIES))
            await eventually(lambda: "/fleet_sum: a client is not answered" in caplog.text)
        assert asked == []
        async with peer(lab, "ask_sum", "1") as client:
            assert await client.until("sum") == ["sum", True, 1, 0]
        assert len(asked) == 1


async def test_a_node_of_humble_is_heard_and_known_by_its_name() -> None:
    types = Types.standard()
    part = Participation(domain_id=next(DOMAINS), node="watcher", interface="lo")
    heard: list[Any] = []
    async with open_driver("dds", part, types) as transport, peer(part, "talk_humble") as talker:
        await talker.until("ready")
        graph = transport.graph
        await eventually(lambda: graph.nodes() == ["/lab/talk_humble"])
        (writer,) = graph.writers("/chatter")
        assert (writer.type_hash, graph.node_of(writer)) == ("", "/lab/talk_humble")
        transport.reader("/chatter", writer.type, Qos(), lambda payload, _: heard.append(payload))
        await eventually(lambda: bool(heard))
        assert Cdr(types).decode(heard[0], writer.type)["data"].startswith("hello ")
