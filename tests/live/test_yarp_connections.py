"""Connections between YARP ports, listed, made and removed by a third party."""

from __future__ import annotations

import asyncio
import socket
import time

import pytest

from vertebra.errors import CommandRefusedError, NameMappingError, NotConnectedError
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import (
    Incoming,
    NameClient,
    Port,
    PortNotFoundError,
    RpcClient,
    Vocab,
    encode,
)
from vertebra.yarp.ports.connections import (
    NoSuchConnectionError,
    PortConnection,
    PortState,
    connect,
    connections_of,
    disconnect,
    survey,
)

pytestmark = pytest.mark.live


async def connections(names: NameClient) -> list[PortConnection]:
    return connections_of(await survey(names))


async def test_two_ports_of_others_are_connected_listed_and_disconnected(
    names: NameClient,
) -> None:
    arrived: asyncio.Queue[Incoming] = asyncio.Queue()
    async with (
        await Port.open("/a", names) as a,
        await Port.open("/b", names, on_data=arrived.put_nowait),
    ):
        assert await connections(names) == []
        made = await connect(names, "/a", "/b", "fast_tcp")
        assert made == PortConnection("/a", "/b", "fast_tcp")
        assert await connections(names) == [made]
        a.write(encode(["hello"]))
        assert (await asyncio.wait_for(arrived.get(), 5)).bottle() == ["hello"]
        assert await disconnect(names, "/a", "/b") == made
        assert await connections(names) == []


async def test_connecting_again_keeps_the_connection_or_changes_its_carrier(
    names: NameClient,
) -> None:
    async with (
        await Port.open("/a", names) as a,
        await Port.open("/b", names, on_data=lambda _: None),
    ):
        await connect(names, "/a", "/b")
        (first,) = a.outputs
        assert (await connect(names, "/a", "/b")).carrier == "tcp"
        assert a.outputs == [first]
        assert (await connect(names, "/a", "/b", "fast_tcp")).carrier == "fast_tcp"
        await eventually(lambda: [link.carrier for link in a.outputs] == ["fast_tcp"])


async def test_disconnecting_one_way_leaves_the_other_way_alone(names: NameClient) -> None:
    async with (
        await Port.open("/a", names, on_data=lambda _: None),
        await Port.open("/b", names, on_data=lambda _: None),
    ):
        back = await connect(names, "/b", "/a")
        with pytest.raises(NoSuchConnectionError, match="/a is not connected to /b"):
            await disconnect(names, "/a", "/b")
        assert await connections(names) == [back]


async def test_names_that_are_not_registered_are_told(names: NameClient) -> None:
    async with await Port.open("/a", names):
        with pytest.raises(PortNotFoundError, match="/nobody"):
            await connect(names, "/a", "/nobody")
        with pytest.raises(PortNotFoundError, match="/nobody"):
            await disconnect(names, "/nobody", "/a")
        with pytest.raises(NameMappingError, match="slash"):
            await connect(names, "/a", "b")


async def test_a_carrier_that_the_port_does_not_speak_is_refused_in_its_words(
    names: NameClient,
) -> None:
    async with await Port.open("/a", names), await Port.open("/b", names):
        with pytest.raises(CommandRefusedError, match="Cannot connect to pigeon://b"):
            await connect(names, "/a", "/b", "pigeon")
        with pytest.raises(CommandRefusedError, match="no carrier"):
            await connect(names, "/a", "/b", 'tcp" "x')


async def test_the_slash_of_the_name_is_merged_where_a_carrier_comes_before_it(
    names: NameClient,
) -> None:
    async with await Port.open("/a", names) as a, await Port.open("/b", names):
        async with await RpcClient.connect("/a", names) as tool:
            unmerged = await tool.administer([Vocab("add"), "tcp:///b"], timeout_s=5)
        assert unmerged[0] != 0
        assert a.outputs == []
        await connect(names, "/a", "/b", "fast_tcp")
        assert [(each.peer, each.carrier) for each in a.outputs] == [("/b", "fast_tcp")]


@pytest.mark.parametrize("carrier", ["text", "text_ack", "text+log.in"])
async def test_text_from_a_streaming_port_crashes_it_and_is_never_asked_for(
    names: NameClient, carrier: str
) -> None:
    async with await Port.open("/a", names) as a, await Port.open("/b", names):
        with pytest.raises(CommandRefusedError, match="crashes"):
            await connect(names, "/a", "/b", carrier)
        assert a.outputs == []


async def test_dead_and_hanging_ports_are_named_and_not_waited_for(names: NameClient) -> None:
    await names.register("/dead", host="127.0.0.1", tcp_port=free_tcp_port())
    await names.register("...", carrier="mcast")
    with socket.create_server(("127.0.0.1", 0), backlog=100) as hanging:  # nobody accepts
        tcp_port = hanging.getsockname()[1]
        for number in range(30):
            await names.register(f"/hangs/{number:02}", host="127.0.0.1", tcp_port=tcp_port)
        states, made = await survey_beside_a_connection(names)
    assert connections_of(states) == [made]
    trouble = {state.contact.name: state.trouble for state in states}
    assert trouble["/hangs/07"] == "no answer within 0.2 s"
    assert "cannot reach" in trouble["/dead"]
    assert trouble["/a"] == ""
    assert not any(name.startswith("/tmp") for name in trouble)  # the multicast group


async def survey_beside_a_connection(
    names: NameClient,
) -> tuple[list[PortState], PortConnection]:
    async with (
        await Port.open("/a", names),
        await Port.open("/b", names, on_data=lambda _: None),
    ):
        made = await connect(names, "/a", "/b")
        began_s = time.monotonic()
        states = await survey(names, timeout_s=0.2)
        assert time.monotonic() - began_s < 2
        with pytest.raises(NotConnectedError, match="cannot reach YARP port /dead"):
            await connect(names, "/dead", "/b")
    return states, made


async def test_a_reader_is_asked_when_its_writer_does_not_answer(names: NameClient) -> None:
    async with (
        await Port.open("/a", names, check_registration_s=60) as a,
        await Port.open("/b", names, on_data=lambda _: None) as b,
    ):
        await connect(names, "/a", "/b")
        await names.register("/a", host="127.0.0.1", tcp_port=free_tcp_port())
        assert (await disconnect(names, "/a", "/b")).carrier == "tcp"
        await eventually(lambda: not a.outputs and not b.inputs)
