"""YARP ports, connections and routes, asked for on the backbone and by REST."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import httpx
import pytest

from vertebra.bus import MemoryBus
from vertebra.errors import RemoteError
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import NameClient, Port, objects
from vertebra_gateway.app import make_app
from vertebra_gateway.auth import Guard
from vertebra_gateway.fleet import Fleet as Services
from vertebra_gateway.resources import Robots
from vertebra_gateway.rest import Gateway
from vertebra_gateway.streams import Streams
from vertebra_gateway.ws import Clients

from .yarp_fleet import CODECS, Fleet, fleet

pytestmark = pytest.mark.live

TOKEN = "0123456789abcdef"
CONNECTIONS = "/api/yarp/connections"


@pytest.fixture
async def lab(names: NameClient) -> AsyncIterator[Fleet]:
    async with fleet(names) as started:
        yield started


@pytest.fixture
async def web(lab: Fleet) -> AsyncIterator[httpx.AsyncClient]:
    bus = MemoryBus(lab.network)
    async with asyncio.TaskGroup() as tasks:
        streams = Streams(bus, CODECS, tasks, jpeg_quality=80)
        robots = Robots(bus, CODECS, [])
        services = Services(bus, CODECS)
        gateway = Gateway(
            bus=bus,
            codecs=CODECS,
            robots=robots,
            streams=streams,
            fleet=services,
            clients=Clients(streams, robots),
        )
        following = tasks.create_task(services.follow())
        await eventually(lambda: services.instances("yarp") == ["1"])
        transport = httpx.ASGITransport(make_app(gateway, Guard(TOKEN)), raise_app_exceptions=False)
        async with httpx.AsyncClient(
            transport=transport,
            base_url="http://gateway",
            headers={"authorization": f"Bearer {TOKEN}"},
        ) as http:
            yield http
        streams.close()
        following.cancel()
    await bus.close()


async def test_yarp_connect_on_the_web(names: NameClient, web: httpx.AsyncClient) -> None:
    edge = {"from": "/a", "to": "/b", "carrier": "fast_tcp"}
    async with (
        await Port.open("/a", names) as a,
        await Port.open("/b", names, on_data=lambda _: None) as b,
    ):
        made = await web.post(CONNECTIONS, json=edge)
        assert (made.status_code, made.json()) == (200, edge)
        assert [link.peer for link in a.outputs] == ["/b"]
        assert (await web.get(CONNECTIONS)).json() == {"connections": [edge], "silent": []}
        ended = await web.delete(CONNECTIONS, params={"from": "/a", "to": "/b"})
        assert (ended.status_code, ended.json()) == (200, edge)
        await eventually(lambda: not a.outputs and not b.inputs)


async def test_ports_are_listed_with_carrier_address_and_life(
    names: NameClient, web: httpx.AsyncClient
) -> None:
    tcp_port = free_tcp_port()
    await names.register("/dead", host="127.0.0.1", tcp_port=tcp_port)
    async with await Port.open("/alive", names) as port:
        ports = {row["name"]: row for row in (await web.get("/api/yarp/ports")).json()["ports"]}
        silent = (await web.get(CONNECTIONS)).json()["silent"]
    assert ports["/alive"] == {
        "name": "/alive",
        "carrier": "tcp",
        "address": f"127.0.0.1:{port.contact.tcp_port}",
        "alive": True,
        "trouble": "",
    }
    assert ports["/dead"]["alive"] is False
    assert f"127.0.0.1:{tcp_port}" in ports["/dead"]["trouble"]
    assert silent == [ports["/dead"]]
    assert ports["/root"]["alive"] is True


@pytest.mark.parametrize(
    ("body", "status", "detail"),
    [
        ({"from": "/a", "to": "/nobody"}, 404, "/nobody is not registered"),
        ({"from": "/a", "to": "nobody"}, 422, "begins with a slash"),
        ({"from": "/a"}, 422, "missing required field `to`"),
        ({"from": "/a", "to": "/b", "by": "tcp"}, 422, "unknown field `by`"),
        ({"from": "/a", "to": "/b", "carrier": "text"}, 422, "crashes"),
        ({"from": "/a", "to": "/b", "carrier": "pigeon"}, 422, "Cannot connect to pigeon://b"),
        ({"from": "/dead", "to": "/b"}, 503, "cannot reach YARP port /dead"),
    ],
)
async def test_what_cannot_be_connected_is_refused_with_the_reason(
    names: NameClient, web: httpx.AsyncClient, body: dict[str, str], status: int, detail: str
) -> None:
    await names.register("/dead", host="127.0.0.1", tcp_port=free_tcp_port())
    async with await Port.open("/a", names), await Port.open("/b", names):
        answer = await web.post(CONNECTIONS, json=body)
    assert answer.status_code == status, answer.text
    assert detail in answer.json()["detail"]


async def test_what_is_not_connected_cannot_be_disconnected(
    names: NameClient, web: httpx.AsyncClient
) -> None:
    async with await Port.open("/a", names), await Port.open("/b", names):
        answer = await web.delete(CONNECTIONS, params={"from": "/a", "to": "/b"})
    assert answer.status_code == 404
    assert "/a is not connected to /b" in answer.json()["detail"]


async def test_the_token_is_asked_for(web: httpx.AsyncClient) -> None:
    for method in ("GET", "POST", "DELETE"):
        answer = await web.request(method, CONNECTIONS, headers={"authorization": ""})
        assert answer.status_code == 401


async def test_adapters_are_told_apart_by_their_instance(
    lab: Fleet, web: httpx.AsyncClient
) -> None:
    assert (await web.get("/api/yarp/routes?instance=1")).status_code == 200
    unknown = await web.get("/api/yarp/routes?instance=7")
    assert (unknown.status_code, unknown.json()["known"]) == (404, ["1"])
    second = lab.bus.declare_presence("@vertebra/services/yarp/2/alive")
    async with asyncio.timeout(5):
        while (answer := await web.get("/api/yarp/routes")).status_code != 422:
            await asyncio.sleep(0.02)
    assert answer.json()["known"] == ["1", "2"]
    second.close()


async def test_openapi_tells_of_it(web: httpx.AsyncClient) -> None:
    document = (await web.get("/openapi.json")).json()
    assert list(document["paths"][CONNECTIONS]) == ["get", "post", "delete"]
    assert CONNECTIONS in (await web.get("/docs")).text


async def test_a_bad_call_on_the_backbone_says_what_a_good_one_is(lab: Fleet) -> None:
    with pytest.raises(RemoteError, match='"from": "/a"'):
        await lab.ask("connect", source="/a")


async def test_the_table_counts_what_each_route_carries(
    names: NameClient, lab: Fleet, web: httpx.AsyncClient
) -> None:
    async with await Port.open("/lab/cam", names, delivery="queue") as port:
        async with asyncio.timeout(5):
            while not await lab.route("/lab/cam"):
                await asyncio.sleep(0.05)
        assert (await lab.route("/lab/cam"))["connected"] is False
        reader = lab.read("yarp/lab/cam")
        await eventually(lambda: bool(port.outputs))
        payload = objects.Vector.of([1.0, 2.0]).encode()
        for _ in range(3):
            port.write(payload)
        await eventually(lambda: reader.subscription.received == 3)
        assert await lab.route("/lab/cam") == {
            "yarp": "/lab/cam",
            "key": "yarp/lab/cam",
            "kind": "inbound stream",
            "mirrored": True,
            "messages": 3,
            "bytes": 3 * len(payload),
            "dropped": 0,
            "refused": 0,
            "connected": True,
            "last_error": "",
        }
        labels = '{key="yarp/lab/cam",kind="inbound stream",yarp="/lab/cam"}'
        metrics = await lab.metrics()
        assert f"vertebra_yarp_route_messages_total{labels} 3.0" in metrics
        assert f"vertebra_yarp_route_connected{labels} 1.0" in metrics
        row = await lab.route("/lab/cam")
        assert row in (await web.get("/api/yarp/routes")).json()["routes"]
        reader.subscription.close()
