"""The YARP adapter between real YARP ports on loopback and the backbone in memory."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork, Reply, Request
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError, RemoteError
from vertebra.messages import Array, Bottle, Image, Message, Tensor, Text
from vertebra.service import MessagePublisher, MessageReader, Received, run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import Incoming, NameClient, Port, Reader, RpcClient, Value, Vocab, objects
from vertebra_yarp.adapter import serve
from vertebra_yarp.driver import name_service
from vertebra_yarp.settings import YarpSettings

pytestmark = pytest.mark.live

ROUTES = """
streams:
  - {yarp: /cam, key: robot/camera, type: Image}
  - {yarp: /thin, key: robot/thin, max_rate_hz: 5}
  - {yarp: /fleet/words, key: robot/words, direction: outbound, delivery: queue, depth: 64}
calls:
  - {yarp: /calc, key: robot/calc}
  - {yarp: /fleet/greet, key: robot/greet, direction: outbound, timeout_s: 1}
control_boards:
  - {yarp: /head, key: robot/head}
"""


@dataclass
class Lab:
    """A running adapter, the backbone it is on and the name server it serves."""

    bus: MemoryBus
    codecs: CodecRegistry
    names: NameClient
    routes: Path
    service: asyncio.Task[None]

    def publisher(self, key: str) -> MessagePublisher:
        return MessagePublisher(self.bus, self.codecs, key)

    def read(self, key: str, wanted: type[Message] = Message) -> MessageReader[Message]:
        return MessageReader(self.bus.subscribe(key, Delivery.queue(500)), self.codecs, wanted)

    async def info(self) -> dict[str, str]:
        reply = await self.bus.call("@vertebra/services/yarp/1/info", timeout_s=5)
        return dict(json.loads(reply.payload)["routes"])


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[Lab]:
    routes = tmp_path / "routes.yaml"
    await asyncio.to_thread(routes.write_text, ROUTES)
    network = MemoryNetwork()
    bus = MemoryBus(network)
    tcp_port = free_tcp_port()
    settings = YarpSettings(name_server_bind=f"127.0.0.1:{tcp_port}", routes=routes)
    service = asyncio.create_task(run_service("yarp", settings, serve, bus=MemoryBus(network)))
    async with bus.presence("@vertebra/services/yarp/1/alive") as presence:
        await asyncio.wait_for(anext(presence), 5)
    names = NameClient("127.0.0.1", tcp_port)

    async def answering() -> None:
        while not service.done():
            try:
                await names.list_ports()
            except ConnectionError:
                await asyncio.sleep(0.02)
            else:
                return

    await asyncio.wait_for(answering(), 5)
    yield Lab(bus, CodecRegistry(), names, routes, service)
    service.cancel()
    await asyncio.wait([service], timeout=5)
    await bus.close()
    assert service.done()


async def first(reader: MessageReader[Message]) -> Received[Message]:
    async with asyncio.timeout(5):
        return await anext(aiter(reader))


async def test_image_crosses_with_its_stamp(lab: Lab) -> None:
    reader = lab.read("robot/camera", Image)
    pixels = bytes(range(256)) * 3
    stamped_ns = time.time_ns() // 1_000_000 * 1_000_000 - 2_000_000_000
    async with await Port.open("/cam", lab.names) as port:
        await eventually(lambda: bool(port.outputs))
        image = objects.Image.from_packed("rgb", 16, 16, pixels)
        port.write(image, envelope=objects.Stamp(1, stamped_ns / 1e9).to_envelope())
        received = await first(reader)
    assert isinstance(received.message, Image)
    assert received.message.pixels.shape == (16, 16, 3)
    assert bytes(received.message.pixels.data) == pixels
    assert received.header.captured_ns == stamped_ns
    assert received.header.origin == "yarp:/cam"
    assert received.header.hops == 1


async def test_robot_port_is_left_alone_until_someone_subscribes(lab: Lab) -> None:
    async with await Port.open("/cam", lab.names) as port:
        await asyncio.sleep(0.3)
        assert port.outputs == []
        reader = lab.read("robot/camera", Image)
        await eventually(lambda: len(port.outputs) == 1)
        reader.subscription.close()
        await eventually(lambda: port.outputs == [])


async def test_no_robot_waits_for_our_acks_streams_are_read_over_fast_tcp(lab: Lab) -> None:
    async with await Port.open("/cam", lab.names) as port:
        reader = lab.read("robot/camera", Image)
        await eventually(lambda: bool(port.outputs))
        assert [each.carrier for each in port.outputs] == ["fast_tcp"]
        reader.subscription.close()


async def test_wrong_type_is_refused_and_the_stream_lives(lab: Lab) -> None:
    reader = lab.read("robot/camera", Image)
    async with await Port.open("/cam", lab.names, delivery="queue") as port:
        await eventually(lambda: bool(port.outputs))
        port.write(objects.Vector.of([1.0]).encode())
        port.write(objects.Image.from_packed("mono", 8, 1, bytes(8)))
        received = await first(reader)
    assert isinstance(received.message, Image)
    assert received.message.pixel_format == "mono8"
    metrics = await lab.bus.call("@vertebra/services/yarp/1/metrics", timeout_s=5)
    assert b"vertebra_yarp_refused_total 1.0" in metrics.payload


async def test_restarted_robot_comes_back_by_itself(lab: Lab) -> None:
    reader = lab.read("robot/camera", Image)
    for _ in range(2):
        async with await Port.open("/cam", lab.names) as port:
            await eventually(lambda port=port: bool(port.outputs))  # type: ignore[misc]
            port.write(objects.Image.from_packed("mono", 8, 1, bytes(8)))
            await first(reader)


async def test_rate_limit_thins_out(lab: Lab) -> None:
    reader = lab.read("robot/thin")
    async with await Port.open("/thin", lab.names, delivery="queue", depth=200) as port:
        await eventually(lambda: bool(port.outputs))
        for number in range(100):
            port.write(objects.Vector.of([float(number)]).encode())
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.2)
    assert 4 <= reader.subscription.received <= 10


async def test_port_without_a_route_is_mirrored_and_typed_by_its_bytes(lab: Lab) -> None:
    async with await Port.open("/lab/@some:port", lab.names) as port:
        key = "yarp/lab/%40some:port"
        reader = lab.read(key)
        async with asyncio.timeout(5):
            while (await lab.info()).get("/lab/@some:port") != key:
                await asyncio.sleep(0.05)
        await eventually(lambda: bool(port.outputs))
        port.write(objects.Vector.of([1.0, 2.0]).encode())
        received = await first(reader)
    assert isinstance(received.message, Tensor)
    assert received.message.array.tolist() == [1.0, 2.0]
    async with asyncio.timeout(5):
        while "/lab/@some:port" in await lab.info():
            await asyncio.sleep(0.05)


async def test_key_is_written_to_a_port_of_ours(lab: Lab) -> None:
    await eventually_registered(lab, "/fleet/words")
    arrived: asyncio.Queue[Incoming] = asyncio.Queue()
    reader = await Reader.dial(
        "/fleet/words", lab.names, on_data=arrived.put_nowait, reader_name="/me"
    )
    publisher = lab.publisher("robot/words")
    await asyncio.sleep(0.05)
    publisher.publish(Text(text="hello"), captured_ns=1_795_000_000_250_000_000)
    publisher.publish(Tensor(array=Array(b"x", "|u1", (1,))))  # YARP has no object for it
    publisher.publish(Bottle(values=[1, {"vocab": "set"}]))
    hello = await asyncio.wait_for(arrived.get(), 5)
    assert hello.bottle() == ["hello"]
    assert objects.Stamp.from_envelope(hello.envelope).time_s == pytest.approx(1_795_000_000.25)
    assert (await asyncio.wait_for(arrived.get(), 5)).bottle() == [1, Vocab("set")]
    await reader.close()


async def test_what_came_from_yarp_does_not_go_back(lab: Lab) -> None:
    await eventually_registered(lab, "/fleet/words")
    arrived: asyncio.Queue[Incoming] = asyncio.Queue()
    reader = await Reader.dial(
        "/fleet/words", lab.names, on_data=arrived.put_nowait, reader_name="/me"
    )
    looped = MessagePublisher(lab.bus, lab.codecs, "robot/words", origin="yarp:/other")
    own = lab.publisher("robot/words")
    await asyncio.sleep(0.05)
    looped.publish(Text(text="echo"))
    own.publish(Text(text="news"))
    assert (await asyncio.wait_for(arrived.get(), 5)).bottle() == ["news"]
    await reader.close()


async def test_calls_reach_a_yarp_rpc_port_as_json_and_as_text(lab: Lab) -> None:
    async def add(incoming: Incoming) -> list[Value]:
        word, *numbers = incoming.bottle()
        return [word, sum(number for number in numbers if isinstance(number, int))]

    async with await Port.open("/calc", lab.names, on_call=add):
        as_json = await lab.bus.call(
            "robot/calc", b'[{"vocab": "add"}, 1, 2]', encoding="application/json", timeout_s=5
        )
        as_text = await lab.bus.call("robot/calc", b"[add] 3 4", encoding="text/plain", timeout_s=5)
        mirrored = await lab.bus.call("yarp/calc", b"sum 5", encoding="text/plain", timeout_s=5)
        with pytest.raises(RemoteError, match="text form") as caught:
            await lab.bus.call("robot/calc", b"{", encoding="application/json", timeout_s=5)
    assert json.loads(as_json.payload) == [{"vocab": "add"}, 3]
    assert as_text.payload == b"[add] 7"
    assert mirrored.payload == b"sum 5"
    assert caught.value.kind == "CommandRefusedError"


async def test_call_to_an_absent_port_says_so(lab: Lab) -> None:
    with pytest.raises(RemoteError, match="/calc"):
        await lab.bus.call("robot/calc", b"[1]", encoding="application/json", timeout_s=5)


async def test_yarp_calls_a_key(lab: Lab) -> None:
    async def greet(request: Request) -> Reply:
        (name,) = json.loads(request.payload)
        return Reply(payload=json.dumps([f"hello {name}", 1.5]).encode(), encoding="")

    await eventually_registered(lab, "/fleet/greet")
    async with await RpcClient.connect("/fleet/greet", lab.names) as client:
        fail = await client.call(["Ada"], timeout_s=5)
        assert fail[0] == Vocab("fail")
        assert "nobody serves 'robot/greet'" in str(fail[1])
        lab.bus.serve("robot/greet", greet)
        assert await client.call(["Ada"], timeout_s=5) == ["hello Ada", 1.5]


async def test_part_that_is_away_says_so(lab: Lab) -> None:
    with pytest.raises(RemoteError, match="/head") as caught:
        await lab.bus.call("robot/head/limits", timeout_s=5)
    assert caught.value.kind in {"NotConnectedError", "PortNotFoundError"}


async def test_routes_file_is_reloaded_and_a_fault_changes_nothing(lab: Lab) -> None:
    await asyncio.to_thread(lab.routes.write_text, "streams: nonsense\n")
    statuses = lab.read("@vertebra/services/yarp/1/status")
    async with asyncio.timeout(10):
        async for received in statuses:
            if "kept as they were" in received.message.text:  # type: ignore[attr-defined]
                break
    assert "/cam" in await lab.info()
    await asyncio.to_thread(lab.routes.write_text, "streams:\n  - {yarp: /new, key: robot/new}\n")
    async with asyncio.timeout(10):
        while "/new" not in (routes := await lab.info()):
            await asyncio.sleep(0.05)
    assert "/cam" not in routes


async def test_taken_name_server_port_stops_the_service_with_the_remedy(lab: Lab) -> None:
    tcp_port = lab.names.tcp_port
    settings = YarpSettings(name_server_bind=f"127.0.0.1:{tcp_port}", instance="2")
    with pytest.raises(ConfigError, match=str(tcp_port)):
        await asyncio.wait_for(
            run_service("yarp", settings, serve, bus=MemoryBus(lab.bus.network)), 5
        )


async def test_the_name_server_is_found_as_yarp_finds_it(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "yarp.conf").write_text(f"127.0.0.1 {lab.names.tcp_port} yarp\n")
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    async with name_service(name_server="auto", serve_names_on="", advertise_host="") as names:
        assert (names.host, names.tcp_port) == ("127.0.0.1", lab.names.tcp_port)


async def eventually_registered(lab: Lab, name: str) -> None:
    async with asyncio.timeout(5):
        while await lab.names.query(name) is None:
            await asyncio.sleep(0.02)
