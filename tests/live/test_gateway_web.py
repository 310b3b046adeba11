"""The gateway on a real socket: WebSocket and MJPEG clients that read, read slowly or not at all.

`VERTEBRA_SLOW_CLIENT_S=60` runs the slow clients as long as the issue asks for.
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import os
import random
import resource
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
import pytest
from pydantic import SecretStr
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin, Subprotocol

from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError
from vertebra.messages import Array, Image
from vertebra.service import MessagePublisher, run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra_gateway.adapter import serve
from vertebra_gateway.settings import GatewaySettings
from vertebra_gateway.testing import FakeRobot

pytestmark = [pytest.mark.live]

TOKEN = "0123456789abcdef"
BEARER = {"authorization": f"Bearer {TOKEN}"}
SUBPROTOCOLS = [Subprotocol("vertebra.v1"), Subprotocol(f"token.{TOKEN}")]
ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
STREAM = "/api/robots/vizzy/camera/left/stream"
CODECS = CodecRegistry.installed()
SLOW_CLIENT_S = float(os.environ.get("VERTEBRA_SLOW_CLIENT_S", "4"))
RATE_HZ = 30.0
SLOW_PERIOD_S = 10 / RATE_HZ
WITHIN_S = 5.0


@dataclass
class Data:
    """A data message."""

    subscription: int
    head: dict[str, Any]
    payload: bytes

    @property
    def age_s(self) -> float:
        return (time.time_ns() - int(self.head["sent_ns"])) / 1e9


def read_data(message: bytes) -> Data:
    length = int.from_bytes(message[4:8], "little")
    start = (8 + length + 63) // 64 * 64
    head = json.loads(message[8 : 8 + length])
    return Data(int.from_bytes(message[:4], "little"), head, message[start:])


@dataclass
class Client:
    """A WebSocket client that keeps control messages and data apart."""

    socket: ClientConnection
    control: list[dict[str, Any]] = field(default_factory=list)
    data: list[Data] = field(default_factory=list)

    async def send(self, op: str, **members: Any) -> None:
        await self.socket.send(json.dumps({"op": op, **members}))

    async def read(self) -> None:
        message = await self.socket.recv()
        if isinstance(message, str):
            self.control.append(json.loads(message))
        else:
            self.data.append(read_data(message))

    async def read_until(self, condition: Callable[[], Any]) -> None:
        async with asyncio.timeout(WITHIN_S):
            while not condition():
                await self.read()

    def has_more_than(self, count: int) -> bool:
        return len(self.data) > count

    async def answer(self, op: str, **members: Any) -> dict[str, Any]:
        await self.read_until(lambda: self.find(op, **members))
        return self.find(op, **members)[-1]

    def find(self, op: str, **members: Any) -> list[dict[str, Any]]:
        wanted = {"op": op, **members}.items()
        return [message for message in self.control if message.items() >= wanted]


@dataclass
class Rig:
    """A running gateway and the robot behind it."""

    tcp_port: int
    bus: MemoryBus
    robot: FakeRobot
    work: asyncio.Task[None]
    settings: GatewaySettings

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.tcp_port}"

    @asynccontextmanager
    async def client(self, **options: Any) -> AsyncIterator[Client]:
        options = {"subprotocols": SUBPROTOCOLS, "compression": None, "max_size": None} | options
        async with connect(f"ws://127.0.0.1:{self.tcp_port}/ws", **options) as websocket:
            yield Client(websocket)

    @asynccontextmanager
    async def streaming(self, work: Callable[[], Awaitable[None]]) -> AsyncIterator[None]:
        task = asyncio.ensure_future(work())
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    async def get(self, path: str) -> Any:
        async with httpx.AsyncClient(base_url=self.url, headers=BEARER) as http:
            response = await http.get(path)
        return response.json()

    async def stop(self) -> float:
        started_s = time.monotonic()
        self.work.cancel()
        with suppress(asyncio.CancelledError):
            await self.work
        return time.monotonic() - started_s


@asynccontextmanager
async def running() -> AsyncIterator[Rig]:
    network = MemoryNetwork()
    outside = MemoryBus(network)
    robot = FakeRobot(outside, CODECS)
    tcp_port = free_tcp_port()
    settings = GatewaySettings(token=SecretStr(TOKEN), tcp_port=tcp_port, robots=ROBOTS)
    work = asyncio.create_task(run_service("gateway", settings, serve, bus=MemoryBus(network)))
    rig = Rig(tcp_port, outside, robot, work, settings)
    async with httpx.AsyncClient(base_url=rig.url, headers=BEARER) as http, asyncio.timeout(10):
        while True:
            with suppress(httpx.ConnectError):
                if (await http.get("/api/robots/vizzy")).json()["online"]:
                    break
            if work.done():
                work.result()
            await asyncio.sleep(0.02)
    try:
        yield rig
    finally:
        await rig.stop()
        await outside.close()


@pytest.fixture
async def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Rig]:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    async with running() as started:
        yield started


async def test_robots_are_told_at_once_and_when_one_goes_and_comes(rig: Rig) -> None:
    async with rig.client() as client:
        assert client.socket.subprotocol == "vertebra.v1"
        told = await client.answer("robots")
        assert [(robot["name"], robot["online"]) for robot in told["robots"]] == [("vizzy", True)]
        rig.robot.close()
        await client.read_until(lambda: not client.control[-1]["robots"][0]["online"])
        assert "nobody is present" in client.control[-1]["robots"][0]["reason"]
        FakeRobot(rig.bus, CODECS)
        await client.read_until(lambda: client.control[-1]["robots"][0]["online"])


async def test_ping_measures_the_clock(rig: Rig) -> None:
    async with rig.client() as client:
        before_ns = time.time_ns()
        await client.send("ping", id=1, client_ns=str(before_ns))
        pong = await client.answer("pong", id=1)
        assert pong["client_ns"] == str(before_ns)
        assert before_ns <= int(pong["server_ns"]) <= time.time_ns()


async def test_each_form_of_data(rig: Rig) -> None:
    async with rig.client() as client, rig.streaming(lambda: rig.robot.stream(RATE_HZ)):
        await client.send("subscribe", id=1, key="vizzy/head/state")
        await client.send("subscribe", id=2, key="vizzy/head/*", form="json")
        await client.send("subscribe", id=3, key="vizzy/camera/left", form="jpeg")
        await client.send("subscribe", id=4, key="vizzy/camera/left")
        await client.read_until(
            lambda: {found.subscription for found in client.data} == {1, 2, 3, 4}
        )
        first = {found.subscription: found for found in reversed(client.data)}
        assert first[1].head["encoding"] == "application/vnd.vertebra.frame;JointState/1"
        assert first[1].payload.startswith(b"VTB\x01")
        assert first[2].head["encoding"] == "application/json"
        assert json.loads(first[2].payload)["message"]["names"][0] == "neck_pitch"
        assert first[3].head["encoding"] == "image/jpeg"
        assert first[3].payload.startswith(b"\xff\xd8")
        assert 0 < int(first[3].head["captured_ns"]) <= int(first[3].head["sent_ns"])
        assert len(first[4].payload) > 320 * 240 * 3
        assert first[4].head["key"] == "vizzy/camera/left"
        await client.send("unsubscribe", id=4)
        await client.answer("unsubscribed", id=4)
        client.data.clear()
        await client.read_until(lambda: len(client.data) > 10)
        assert 4 not in {found.subscription for found in client.data}


async def test_a_new_subscription_gets_what_is_known_after_its_answer(rig: Rig) -> None:
    async with rig.client() as first, rig.client() as client:
        await first.send("subscribe", id=1, key="vizzy/head/state")
        await first.answer("subscribed", id=1)
        rig.robot.publish_state()  # never again
        await first.read_until(lambda: first.has_more_than(0))
        for number, form in enumerate(("frame", "json"), start=1):
            await client.send("subscribe", id=number, key="vizzy/head/state", form=form)
            order: list[str] = []
            async with asyncio.timeout(WITHIN_S):
                while "data" not in order:
                    message = await client.socket.recv()
                    order.append(json.loads(message)["op"] if isinstance(message, str) else "data")
            assert order[-2:] == ["subscribed", "data"]


async def test_calls_are_answered_and_refused_as_in_rest(rig: Rig) -> None:
    async with rig.client() as client:
        move: dict[str, Any] = {"robot": "vizzy", "path": "head/move"}
        await client.send("call", id=1, body={"positions_deg": {"neck_yaw": 12}}, **move)
        assert (await client.answer("reply", id=1))["body"]["positions_deg"]["neck_yaw"] == 12
        await client.send("call", id=2, body={"positions_deg": {"neck_yaw": 99}}, **move)
        refused = await client.answer("error", id=2)
        assert (refused["status"], refused["joint"], refused["limit"]["max"]) == (
            422,
            "neck_yaw",
            30.0,
        )
        await client.send("call", id=3, robot="nobody", path="head/move")
        assert (await client.answer("error", id=3))["status"] == 404
        rig.robot.delay_s = 5.0
        await client.send("call", id=4, body={"positions_deg": {}}, timeout_s=0.1, **move)
        assert (await client.answer("error", id=4))["status"] == 422  # nothing to move
        await client.send(
            "call", id=5, body={"positions_deg": {"neck_yaw": 1}}, timeout_s=0.1, **move
        )
        assert (await client.answer("error", id=5))["status"] == 504
        await client.send("call", id=6, body={"positions_deg": {"neck_yaw": 1}}, **move)
        await client.send("ping", id=7, client_ns="1")
        await client.answer("pong", id=7)  # a call that lasts holds up nothing
        assert not client.find("reply", id=6)


async def test_a_form_that_does_not_fit_is_told_once_and_the_rest_lives(rig: Rig) -> None:
    async with rig.client() as client, rig.streaming(lambda: rig.robot.stream(RATE_HZ)):
        await client.send("subscribe", id=1, key="vizzy/head/state", form="jpeg")
        await client.send("subscribe", id=2, key="vizzy/camera/left", form="json")
        await client.send("subscribe", id=3, key="vizzy/head/state")
        assert "JointState is no image" in (await client.answer("error", id=1))["detail"]
        assert "more than 65536 items" in (await client.answer("error", id=2))["detail"]
        await client.read_until(lambda: len(client.data) > 10)
        assert len(client.find("error")) == 2


async def test_rubbish_is_answered_and_harms_nothing(rig: Rig) -> None:
    dice = random.Random(0)
    async with rig.client() as client:
        for _ in range(300):
            text = "".join(dice.choices('{}[]":,0123456789opidsubscribe \x00ü', k=40))
            await client.socket.send(text if dice.random() < 0.9 else text.encode())
        await client.send("ping", id=1, client_ns="1")
        await client.answer("pong", id=1)
        assert len(client.find("error", id=None, status=422)) == 300


@pytest.mark.parametrize(
    ("subprotocols", "headers", "origin", "status"),
    [
        (["vertebra.v1"], {}, None, 401),
        (["vertebra.v1", "token.wrong"], {}, None, 401),
        (["vertebra.v1", f"token.{TOKEN}"], {}, "http://evil.org", 403),
        (["vertebra.v1"], BEARER, None, 101),
        (["vertebra.v1"], {"cookie": f"vertebra_token={TOKEN}"}, "self", 101),
    ],
)
async def test_who_may_connect(
    rig: Rig,
    subprotocols: list[str],
    headers: dict[str, str],
    origin: str | None,
    status: int,
) -> None:
    options = {
        "subprotocols": [Subprotocol(name) for name in subprotocols],
        "additional_headers": headers,
        "origin": Origin(rig.url if origin == "self" else origin) if origin else None,
    }
    if status == 101:
        async with rig.client(**options) as client:
            await client.answer("robots")
        return
    with pytest.raises(InvalidStatus) as caught:
        async with rig.client(**options):
            pass
    response = caught.value.response
    assert response.status_code == status
    assert json.loads(response.body or b"")["status"] == status


async def closed_with(client: Client) -> ConnectionClosed:
    try:
        await client.read_until(lambda: False)
    except ConnectionClosed as closed:
        return closed
    raise AssertionError


async def test_a_bad_subprotocol_ends_the_connection(rig: Rig) -> None:
    async with rig.client(subprotocols=None, additional_headers=BEARER) as client:
        closed = await closed_with(client)
    assert closed.rcvd is not None
    assert (closed.rcvd.code, "vertebra.v1" in closed.rcvd.reason) == (1008, True)


async def test_a_long_text_ends_the_connection(rig: Rig) -> None:
    async with rig.client() as client:
        await client.socket.send(" " * ((256 << 10) + 1))
        closed = await closed_with(client)
    assert closed.rcvd is not None
    assert (closed.rcvd.code, "262144" in closed.rcvd.reason) == (1009, True)


async def test_too_many_subscriptions_end_the_connection_and_leave_nothing(rig: Rig) -> None:
    before = len(rig.bus.network.subscriptions)
    async with rig.client() as client:
        for number in range(1, 258):
            await client.send("subscribe", id=number, key=f"a/{number}")
        closed = await closed_with(client)
    assert closed.rcvd is not None
    assert (closed.rcvd.code, "256" in closed.rcvd.reason) == (1008, True)
    await eventually(lambda: len(rig.bus.network.subscriptions) == before)


async def test_queue_keeps_every_message_in_order(rig: Rig) -> None:
    async with rig.client() as client:
        await client.send("subscribe", id=1, key="count", delivery="queue", depth=1000)
        await client.answer("subscribed", id=1)
        publisher = rig.bus.publisher("count", encoding="text/plain")
        for number in range(500):
            publisher.put(b"%d" % number)
            if not number % 20:
                await asyncio.sleep(0)
        await client.read_until(lambda: len(client.data) == 500)
    assert [int(found.payload) for found in client.data] == list(range(500))
    assert client.data[-1].head["dropped"] == 0


async def test_max_rate_is_kept(rig: Rig) -> None:
    async with rig.client() as client, rig.streaming(lambda: rig.robot.stream(100)):
        await client.send("subscribe", id=1, key="vizzy/head/state", max_rate_hz=10)
        await client.read_until(lambda: client.data)
        started_s = time.monotonic()
        await client.read_until(lambda: len(client.data) == 11)
        took_s = time.monotonic() - started_s
    assert 0.9 <= took_s <= 2.0
    assert client.data[-1].head["dropped"] == 0


class RawReader:
    """A client without any buffer of its own: it reads what it is told to, when it is told to."""

    def __init__(self, connection: socket.socket) -> None:
        self._loop = asyncio.get_running_loop()
        self._connection = connection

    @classmethod
    @asynccontextmanager
    async def open(cls, tcp_port: int, request: str) -> AsyncIterator[RawReader]:
        with socket.socket() as connection:
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 32 << 10)
            reader = cls(connection)
            await reader._loop.sock_connect(connection, ("127.0.0.1", tcp_port))
            await reader._loop.sock_sendall(connection, request.encode())
            yield reader

    @classmethod
    @asynccontextmanager
    async def subscribed(cls, tcp_port: int, **subscription: Any) -> AsyncIterator[RawReader]:
        """Open a WebSocket with one subscription."""
        key = base64.b64encode(b"0123456789abcdef").decode()
        request = (
            "GET /ws HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: vertebra.v1, token.{TOKEN}\r\n\r\n"
        )
        async with cls.open(tcp_port, request) as reader:
            assert " 101 " in await reader.head()
            await reader.send(1, json.dumps({"op": "subscribe", "id": 1, **subscription}).encode())
            yield reader

    @classmethod
    @asynccontextmanager
    async def watching(cls, tcp_port: int) -> AsyncIterator[RawReader]:
        """Open an MJPEG stream; HTTP/1.0 has no chunks."""
        request = f"GET {STREAM} HTTP/1.0\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n\r\n"
        async with cls.open(tcp_port, request) as reader:
            head = await reader.head()
            assert " 200 " in head
            assert "multipart/x-mixed-replace; boundary=" in head
            yield reader

    async def head(self) -> str:
        """Read up to an empty line."""
        found = b""
        while not found.endswith(b"\r\n\r\n"):
            found += await self._exactly(1)
        return found.decode()

    async def part(self) -> tuple[dict[str, str], bytes]:
        """Read one MJPEG part."""
        lines = [line.partition(": ") for line in (await self.head()).splitlines() if ": " in line]
        headers = {name.lower(): value for name, _, value in lines}
        return headers, await self._exactly(int(headers["content-length"]))

    async def read(self) -> bytes | dict[str, Any]:
        """Return the next WebSocket message; answer the pings before it."""
        while True:
            opcode, length = await self._exactly(2)
            if length >= 126:
                length = int.from_bytes(await self._exactly(2 if length == 126 else 8), "big")
            payload = await self._exactly(length)
            if opcode & 0xF == 9:
                await self.send(10, payload)
            elif opcode & 0xF == 1:
                message: dict[str, Any] = json.loads(payload)
                return message
            else:
                assert opcode & 0xF == 2
                return payload

    async def read_data(self, drops: list[dict[str, Any]]) -> Data:
        while isinstance(message := await self.read(), dict):
            if message["op"] == "drops":
                drops.append(message)
        return read_data(message)

    async def send(self, opcode: int, payload: bytes) -> None:
        """Send a WebSocket frame, masked with zeros."""
        length = len(payload)
        size = bytes((0x80 | length,)) if length < 126 else b"\xfe" + length.to_bytes(2, "big")
        frame = bytes((0x80 | opcode,)) + size + bytes(4) + payload
        await self._loop.sock_sendall(self._connection, frame)

    async def _exactly(self, length: int) -> bytes:
        parts = []
        while length:
            part = await self._loop.sock_recv(self._connection, length)
            if not part:
                raise ConnectionResetError("the gateway closed the connection")
            parts.append(part)
            length -= len(part)
        return b"".join(parts)


async def count_all(client: Client) -> None:
    while True:
        await client.read()


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


@pytest.mark.timeout(60 + 2 * SLOW_CLIENT_S)
@pytest.mark.parametrize(
    ("key", "form"),
    [("vizzy/head/state", "json"), ("vizzy/camera/left", "frame"), ("vizzy/**", "frame")],
)
async def test_a_client_that_reads_slowly_sees_new_data_and_harms_nobody(
    rig: Rig, key: str, form: str
) -> None:
    drops: list[dict[str, Any]] = []
    ages_s: list[float] = []
    async with (
        rig.streaming(lambda: rig.robot.stream(RATE_HZ)),
        rig.client() as other,
        RawReader.subscribed(rig.tcp_port, key=key, form=form) as slow,
    ):
        await other.send("subscribe", id=1, key="vizzy/head/state")
        await other.read_until(lambda: other.data)
        async with rig.streaming(lambda: count_all(other)):
            keys = {(await slow.read_data(drops)).head["key"] for _ in range(4)}
            resident = resident_bytes()
            started_s = time.monotonic()
            others_before = len(other.data)
            pause_s = SLOW_PERIOD_S / len(keys)  # the period of each of its keys is ten of theirs
            last: Data | None = None
            while time.monotonic() - started_s < SLOW_CLIENT_S:
                await asyncio.sleep(pause_s)
                last = await slow.read_data(drops)
                ages_s.append(last.age_s)
            took_s = time.monotonic() - started_s
            others = len(other.data) - others_before
            growth = resident_bytes() - resident
    assert last is not None
    assert max(ages_s) < 2 * SLOW_PERIOD_S, ages_s
    assert drops, "the slow client was never told what it missed"
    assert 0 < drops[-1]["dropped"] <= last.head["dropped"] + RATE_HZ * 2
    assert last.head["dropped"] > 0.5 * took_s * RATE_HZ
    assert others > 0.8 * took_s * RATE_HZ
    assert sorted(found.age_s for found in other.data)  # they were all read
    assert growth < 30 << 20, f"memory grew by {growth >> 20} MiB"


@pytest.mark.timeout(60 + 2 * SLOW_CLIENT_S)
@pytest.mark.parametrize(
    ("key", "form"), [("vizzy/head/state", "json"), ("vizzy/camera/left", "frame")]
)
async def test_with_a_window_a_library_that_reads_ahead_hides_nothing(
    rig: Rig, key: str, form: str
) -> None:
    ages_s: list[float] = []
    async with rig.client() as client, rig.streaming(lambda: rig.robot.stream(RATE_HZ)):
        await client.send("subscribe", id=1, key=key, form=form, window=1)
        started_s = time.monotonic()
        while time.monotonic() - started_s < SLOW_CLIENT_S:
            count = len(ages_s)
            await client.read_until(partial(client.has_more_than, count))
            ages_s.append(client.data[-1].age_s)
            await asyncio.sleep(SLOW_PERIOD_S)
            await client.send("ack", id=1)
    assert max(ages_s[2:]) < 0.5 * SLOW_PERIOD_S, ages_s
    assert client.data[-1].head["dropped"] > 0.5 * SLOW_CLIENT_S * RATE_HZ


async def test_control_overtakes_data(rig: Rig) -> None:
    async with (
        rig.streaming(lambda: rig.robot.stream(RATE_HZ)),
        RawReader.subscribed(rig.tcp_port, key="vizzy/camera/left") as slow,
    ):
        await slow.read_data([])
        await asyncio.sleep(0.5)  # a sender without lanes has fifteen images in its queue by now
        ping = json.dumps({"op": "ping", "id": 7, "client_ns": "1"}).encode()
        await slow.send(1, ping)
        before = 0
        while not (isinstance(message := await slow.read(), dict) and message["op"] == "pong"):
            before += isinstance(message, bytes)
        assert before <= 2


async def test_a_client_that_asks_and_never_reads_is_not_listened_to_for_ever(rig: Rig) -> None:
    ping = json.dumps({"op": "ping", "id": 7, "client_ns": "1"}).ljust(1000).encode()
    sent = 0
    async with RawReader.subscribed(rig.tcp_port, key="vizzy/head/state") as silent:
        with suppress(TimeoutError):
            async with asyncio.timeout(3):
                while sent < 64 << 20:
                    await silent.send(1, ping)
                    sent += len(ping)
        assert sent < 64 << 20, "the gateway takes in requests without end"
        async with rig.client() as other:
            await other.answer("robots")


async def test_the_fleet_and_the_metrics_show_a_slow_client(rig: Rig) -> None:
    async with rig.client() as client, rig.streaming(lambda: rig.robot.stream(100)):
        await client.send("subscribe", id=1, key="vizzy/head/state", window=1)
        told = await client.answer("drops", id=1)
        (row,) = (await rig.get("/api/fleet"))["clients"]
        assert row["dropped"] >= told["dropped"] > 0
        assert (row["subscriptions"], row["sent"], row["lost"]) == (1, 1, 0)
    async with httpx.AsyncClient(base_url=rig.url, headers=BEARER) as http:
        text = (await http.get("/metrics")).text
    values = dict(line.rsplit(" ", 1) for line in text.splitlines() if line[0] != "#")
    assert float(values['vertebra_gateway_sent{instance="1",service="gateway"}']) >= 1
    assert float(values['vertebra_gateway_dropped{instance="1",service="gateway"}']) > 0


async def test_connections_leave_nothing_behind(rig: Rig) -> None:
    before = len(rig.bus.network.subscriptions)
    tasks = len(asyncio.all_tasks())
    async with rig.streaming(lambda: rig.robot.stream(100)):
        for _ in range(30):
            async with rig.client() as client:
                await client.send("subscribe", id=1, key="vizzy/camera/left", form="jpeg")
                await client.send("subscribe", id=2, key="vizzy/**")
                await client.answer("subscribed", id=2)
    await eventually(lambda: len(rig.bus.network.subscriptions) == before)
    await eventually(lambda: len(asyncio.all_tasks()) <= tasks + 1)


def noise() -> Image:
    pixels = random.Random(0).randbytes(320 * 240 * 3)
    return Image(pixels=Array(pixels, "|u1", (240, 320, 3)), pixel_format="rgb8")


async def stream_noise(rig: Rig) -> None:
    """Publish images that do not get much smaller as JPEGs."""
    publisher = MessagePublisher(rig.bus, CODECS, "vizzy/camera/left")
    image = noise()
    while True:
        publisher.publish(image)
        await asyncio.sleep(1 / RATE_HZ)


async def test_mjpeg_shows_every_image_to_a_reader_that_keeps_up(rig: Rig) -> None:
    async with (
        rig.streaming(lambda: rig.robot.stream(RATE_HZ)),
        RawReader.watching(rig.tcp_port) as reader,
    ):
        captured = []
        async with asyncio.timeout(WITHIN_S):
            for _ in range(15):
                headers, body = await reader.part()
                assert headers["content-type"] == "image/jpeg"
                assert body.startswith(b"\xff\xd8")
                assert body.endswith(b"\xff\xd9")
                assert float(headers["x-age-s"]) < 1
                captured.append(int(headers["x-captured-ns"]))
        gaps = [later - earlier for earlier, later in pairwise(captured)]
        assert all(gap > 0 for gap in gaps)
        assert sorted(gaps)[len(gaps) // 2] < 2e9 / RATE_HZ


async def test_mjpeg_gives_a_slow_reader_new_images(rig: Rig) -> None:
    ages_s = []
    async with rig.streaming(lambda: stream_noise(rig)), RawReader.watching(rig.tcp_port) as reader:
        started_s = time.monotonic()
        while time.monotonic() - started_s < SLOW_CLIENT_S:
            headers, _ = await reader.part()
            ages_s.append((time.time_ns() - int(headers["x-captured-ns"])) / 1e9)
            await asyncio.sleep(SLOW_PERIOD_S)
    assert max(ages_s) < 4 * SLOW_PERIOD_S, ages_s


async def test_mjpeg_that_nobody_reads_any_more_ends(rig: Rig) -> None:
    before = len(rig.bus.network.subscriptions)
    async with rig.streaming(lambda: stream_noise(rig)):
        async with RawReader.watching(rig.tcp_port) as reader:
            await reader.part()
            assert len(rig.bus.network.subscriptions) == before + 1
        await eventually(lambda: len(rig.bus.network.subscriptions) == before)


async def test_events_bring_each_value_while_somebody_reads_them(rig: Rig) -> None:
    before = len(rig.bus.network.subscriptions)
    captured: list[int] = []
    async with (
        rig.streaming(lambda: rig.robot.stream(RATE_HZ)),
        httpx.AsyncClient(base_url=rig.url, headers=BEARER) as http,
    ):
        async with (
            asyncio.timeout(WITHIN_S),
            http.stream("GET", "/api/robots/vizzy/head/joints/stream") as response,
        ):
            assert response.headers["content-type"].startswith("text/event-stream")
            async for line in response.aiter_lines():
                if line:
                    captured.append(int(json.loads(line.removeprefix("data: "))["captured_ns"]))
                if len(captured) == 15:
                    break
            assert len(rig.bus.network.subscriptions) == before + 1
        await eventually(lambda: len(rig.bus.network.subscriptions) == before)
    gaps = [later - earlier for earlier, later in pairwise(captured)]
    assert all(gap > 0 for gap in gaps)
    assert sorted(gaps)[len(gaps) // 2] < 2e9 / RATE_HZ


async def test_it_stops_within_5_s_with_clients_of_every_kind(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    move: dict[str, Any] = {"robot": "vizzy", "path": "head/move"}
    rig.robot.delay_s = 60.0
    async with (
        rig.streaming(lambda: stream_noise(rig)),
        rig.client() as client,
        RawReader.subscribed(rig.tcp_port, key="vizzy/camera/left", delivery="queue"),
        RawReader.watching(rig.tcp_port) as reader,
        RawReader.watching(rig.tcp_port) as stuck,
    ):
        await client.send("subscribe", id=1, key="vizzy/camera/left")
        await client.read_until(lambda: client.data)
        await reader.part()
        await stuck.part()
        await client.send("call", id=2, body={"positions_deg": {"neck_yaw": 1}}, **move)
        await eventually(lambda: bool(rig.robot.moves))
        caplog.clear()
        took_s = await rig.stop()
        closed = await closed_with(client)
    assert took_s < 5.0
    assert closed.rcvd is not None
    assert closed.rcvd.code == 1012
    bad = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert not bad, [record.getMessage() for record in bad]


async def test_a_second_gateway_on_the_same_port_says_what_to_do(rig: Rig) -> None:
    with pytest.raises(ConfigError) as caught:
        await run_service("gateway", rig.settings, serve, bus=MemoryBus())
    text = str(caught.value)
    assert f"127.0.0.1:{rig.tcp_port}" in text
    assert "another gateway" in text
    assert "VERTEBRA_GATEWAY_TCP_PORT" in text
