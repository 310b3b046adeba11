"""Fleets that share a YARP name server and a robot, and robots' ports that are left in peace."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.messages import Array, JointState, Tensor, Text
from vertebra.service import run_service
from vertebra.testing.bus_suite import eventually
from vertebra.yarp import NameClient, Port, encode
from vertebra.yarp.ports.connections import connections_of, survey
from vertebra_simulator.adapter import serve as serve_simulator
from vertebra_simulator.settings import SimulatorSettings

from .yarp_fleet import Fleet, fleet

pytestmark = pytest.mark.live

ROUTES = """
control_boards:
  - {yarp: /vizzy/head, key: vizzy/head}
streams:
  - {yarp: /words, key: lab/words, direction: outbound, delivery: queue, depth: 64}
"""


@contextlib.asynccontextmanager
async def robot(names: NameClient) -> AsyncIterator[None]:
    settings = SimulatorSettings(name_server=f"{names.host}:{names.tcp_port}")
    bus = MemoryBus(MemoryNetwork())
    service = asyncio.create_task(run_service("simulator", settings, serve_simulator, bus=bus))
    try:
        async with asyncio.timeout(5):
            while await names.query("/vizzy/imu") is None:  # it comes after the head
                await asyncio.sleep(0.02)
        yield
    finally:
        service.cancel()
        await asyncio.wait([service], timeout=5)


async def mirrored(fleet: Fleet, name: str) -> None:
    async with asyncio.timeout(5):
        while not await fleet.route(name):
            await asyncio.sleep(0.02)


async def test_two_fleets_read_one_robot_and_each_gets_every_message_once(
    names: NameClient, tmp_path: Path
) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    async with (
        robot(names),
        fleet(names, routes) as one,
        fleet(names, routes) as two,
    ):
        stamps: dict[str, list[int]] = {"one": [], "two": []}

        async def follow(name: str, reading: Fleet) -> None:
            async for received in reading.read("vizzy/head/state", JointState):
                stamps[name].append(received.header.captured_ns)

        async with asyncio.TaskGroup() as tasks:
            reading = [
                tasks.create_task(follow("one", one)),
                tasks.create_task(follow("two", two)),
            ]
            await eventually(lambda: min(map(len, stamps.values())) > 5)
            begin = max(taken[0] for taken in stamps.values())
            count = min(map(len, stamps.values()))
            await eventually(lambda: min(map(len, stamps.values())) > count + 50)
            end = min(taken[-1] for taken in stamps.values())
            same = [[at for at in taken if begin <= at <= end] for taken in stamps.values()]
            assert same[0] == same[1]
            assert len(set(same[0])) == len(same[0])
            found = connections_of(await survey(names))
            readers = {it.dest for it in found if it.source == "/vizzy/head/stateExt:o"}
            assert len(readers) == 2
            assert all(reader.startswith("/vertebra/") for reader in readers)
            for task in reading:
                task.cancel()


async def test_a_port_of_one_fleet_is_mirrored_by_the_other_once_and_never_by_itself(
    names: NameClient, tmp_path: Path
) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    async with fleet(names, routes) as one, fleet(names) as two:
        await mirrored(two, "/words")
        heard, echoed = two.read("yarp/words"), one.read("yarp/words")
        async with asyncio.timeout(5):
            while not (await two.route("/words"))["connected"]:
                await asyncio.sleep(0.02)
        publisher = one.publisher("lab/words")
        for number in range(19):
            publisher.publish(Text(text=str(number)))
        publisher.publish(Tensor(array=Array(bytes(16), "<f8", (2,))))
        await eventually(lambda: heard.subscription.received >= 20)
        await asyncio.sleep(0.3)  # a loop would go on
        assert heard.subscription.received == 20
        assert echoed.subscription.received == 0
        (row,) = [row for row in (await one.ask("routes"))["routes"] if row["yarp"] == "/words"]
        assert (row["kind"], row["messages"]) == ("outbound stream", 20)
        assert row["bytes"] == 19 * 12 + 28 + 24
        heard.subscription.close()
        echoed.subscription.close()


async def test_a_fleet_does_not_take_the_name_of_a_living_port(
    names: NameClient, tmp_path: Path
) -> None:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    async with await Port.open("/words", names) as port, fleet(names, routes) as late:
        async with asyncio.timeout(5):
            while "another program's" not in (await late.route("/words"))["last_error"]:
                await asyncio.sleep(0.02)
        assert await names.query("/words") == port.contact
        await port.close()
        async with asyncio.timeout(5):
            while not (await late.route("/words"))["connected"]:
                await asyncio.sleep(0.05)


async def test_what_adapters_call_their_own_is_not_mirrored(names: NameClient) -> None:
    async with (
        fleet(names, prefix="/ours/deep") as one,
        await Port.open("/vertebra/other-fleet/reader/cam", names),
        await Port.open("/ours/deep/reader/cam", names),
        await Port.open("/ours/deeper", names),
    ):
        await mirrored(one, "/ours/deeper")
        shown = {row["yarp"] for row in (await one.ask("routes"))["routes"]}
        assert shown == {"/ours/deeper"}


async def test_a_mirrored_port_is_not_touched_before_someone_subscribes_nor_after(
    names: NameClient,
) -> None:
    connections = 0

    def count(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        connections += 1
        writer.close()

    listener = await asyncio.start_server(count, "127.0.0.1", 0)
    tcp_port = listener.sockets[0].getsockname()[1]
    await names.register("/robot/cam", host="127.0.0.1", tcp_port=tcp_port)
    async with fleet(names) as lab:
        await mirrored(lab, "/robot/cam")
        await asyncio.sleep(2.5)  # two looks at the name server later
        assert connections == 0
        reader = lab.read("yarp/robot/cam")
        await eventually(lambda: connections > 0)
        reader.subscription.close()
        await asyncio.sleep(0.1)
        count_then = connections
        await asyncio.sleep(1.5)  # longer than any pause between two attempts
        assert connections == count_then
    listener.close()
    await listener.wait_closed()


async def test_subscribers_share_one_connection_that_ends_with_the_last(
    names: NameClient,
) -> None:
    async with await Port.open("/robot/cam", names) as port, fleet(names) as lab:
        await mirrored(lab, "/robot/cam")
        first, second = lab.read("yarp/robot/cam"), lab.read("yarp/robot/*")
        await eventually(lambda: len(port.outputs) == 1)
        port.write(encode(["both"]))
        await eventually(lambda: first.subscription.received == second.subscription.received == 1)
        assert len(port.outputs) == 1
        assert port.inputs == []
        first.subscription.close()
        port.write(encode(["one"]))
        await eventually(lambda: second.subscription.received == 2)
        second.subscription.close()
        await eventually(lambda: port.outputs == [])
