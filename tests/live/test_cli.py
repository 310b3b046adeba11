"""The commands that talk to a fleet, as a user runs them, against a real router."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest

from vertebra.bus import Delivery, Reply, Request, ZenohBus
from vertebra.bus.router import running_router
from vertebra.codec import CodecRegistry
from vertebra.errors import CommandRefusedError
from vertebra.messages import Array, Image, Text
from vertebra.service import MessagePublisher
from vertebra.testing.ports import free_tcp_port

TIMEOUT_S = 20.0


@dataclass
class Backbone:
    """A router, a member of its network, and the command line beside it."""

    router: str
    bus: ZenohBus

    async def start(self, *arguments: str) -> Process:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "vertebra.cli", *arguments, "--router", self.router),
            stdout=PIPE,
            stderr=PIPE,
        )

    async def run(self, *arguments: str) -> tuple[int | None, str, str]:
        process = await self.start(*arguments)
        async with asyncio.timeout(TIMEOUT_S):
            out, err = await process.communicate()
        return process.returncode, out.decode(), err.decode()


@pytest.fixture
async def backbone() -> AsyncIterator[Backbone]:
    router = f"tcp/127.0.0.1:{free_tcp_port()}"
    with running_router([router]):
        bus = await ZenohBus.open(router, timeout_s=5)
        yield Backbone(router, bus)
        await bus.close()


@pytest.fixture
async def talking(backbone: Backbone) -> AsyncIterator[Backbone]:
    """The backbone with words and pictures on it, 50 a second."""

    async def talk() -> None:
        words = MessagePublisher(backbone.bus, CodecRegistry(), "robot/words")
        images = MessagePublisher(backbone.bus, CodecRegistry(), "robot/images")
        raw = backbone.bus.publisher("robot/raw", encoding="application/x-unknown")
        pixels = Array(bytes(48 * 64 * 3), "|u1", (48, 64, 3))
        while True:
            words.publish(Text(text="grüezi"))
            images.publish(Image(pixels=pixels, pixel_format="rgb8"))
            raw.put(b"\0\1\2")
            await asyncio.sleep(0.02)

    task = asyncio.create_task(talk())
    yield backbone
    task.cancel()


async def test_echo_prints_a_number_of_messages(talking: Backbone) -> None:
    status, out, err = await talking.run("echo", "robot/words", "-n", "2", "--encoding")
    assert (status, err) == (0, "")
    assert out.count("--- robot/words, Text, ") == 2
    assert out.count("text: grüezi\n") == 2
    assert "application/vnd.vertebra.frame;Text/1" in out


async def test_echo_prints_json_and_images_in_words(talking: Backbone) -> None:
    status, out, _ = await talking.run("echo", "robot/images", "-n", "1", "--json")
    document = json.loads(out)
    assert status == 0
    assert (document["key"], document["schema"]) == ("robot/images", "vertebra/Image/1")
    assert document["message"]["pixels"] == "48 x 64 x 3 of |u1, 9216 bytes"


async def test_echo_writes_payloads_as_they_are(talking: Backbone) -> None:
    assert await talking.run("echo", "robot/raw", "-n", "2", "--raw") == (0, "\0\1\2\0\1\2", "")


async def test_echo_says_what_it_cannot_read(talking: Backbone) -> None:
    status, out, err = await talking.run("echo", "robot/raw", "-n", "1")
    assert (status, out) == (0, "")
    assert "robot/raw: nothing here reads 'application/x-unknown'" in err


async def test_keys_lists_what_is_seen(talking: Backbone) -> None:
    status, out, _ = await talking.run("keys", "--seconds", "1")
    assert status == 0
    rows = {line.split()[0]: line.split() for line in out.splitlines() if line}
    assert rows["robot/words"][1] == "application/vnd.vertebra.frame;Text/1"
    assert rows["robot/raw"][1] == "application/x-unknown"
    assert 10 < float(rows["robot/words"][2]) < 60
    assert out.endswith("no service is present\n")


async def test_keys_of_a_silent_network(backbone: Backbone) -> None:
    _, out, _ = await backbone.run("keys", "robot/**", "--seconds", "0.2")
    assert out.startswith("no sample on robot/** within 0.2 s\n")


@pytest.mark.parametrize(
    ("arguments", "payload", "encoding"),
    [
        (["hello"], b"hello", "text/plain"),
        (['{"a": 1}'], b'{"a": 1}', "application/json"),
    ],
)
async def test_pub_reaches_who_listens(
    backbone: Backbone, arguments: list[str], payload: bytes, encoding: str
) -> None:
    async with backbone.bus.subscribe("robot/words", Delivery.queue(4)) as samples:
        assert await backbone.run("pub", "robot/words", *arguments) == (0, "", "")
        sample = await asyncio.wait_for(anext(samples), TIMEOUT_S)
    assert (sample.payload, sample.encoding) == (payload, encoding)


async def test_pub_repeats_until_ctrl_c_and_then_is_quiet(backbone: Backbone) -> None:
    async with backbone.bus.subscribe("robot/words", Delivery.queue(100)) as samples:
        process = await backbone.start("pub", "robot/words", "hi", "--type", "Text", "--rate", "50")
        async with asyncio.timeout(TIMEOUT_S):
            seen = [await anext(samples) for _ in range(5)]
            process.send_signal(signal.SIGINT)
            out, err = await process.communicate()
    assert (process.returncode, out, err) == (130, b"", b"")
    message, header = CodecRegistry().decode(seen[0].payload, seen[0].encoding)
    assert (message, header.origin) == (Text(text="hi"), "cli")


async def test_a_closed_pipe_is_quiet(talking: Backbone) -> None:
    process = await talking.start("echo", "robot/words")
    assert process.stdout is not None
    assert process.stderr is not None
    async with asyncio.timeout(TIMEOUT_S):
        await process.stdout.readline()
        process._transport.get_pipe_transport(1).close()  # type: ignore[attr-defined]
        assert await process.stderr.read() == b""
        assert await process.wait() == 0


async def test_call_prints_the_answer_or_the_error(backbone: Backbone) -> None:
    async def handler(request: Request) -> Reply:
        if not request.payload:
            raise CommandRefusedError("neck_yaw goes to 30 deg, not to 99")
        return Reply(payload=request.payload, encoding=request.encoding)

    with_answer = backbone.bus.serve("robot/move", handler)
    status, out, err = await backbone.run("call", "robot/move", '{"neck_yaw": 20}')
    assert (status, json.loads(out), err) == (0, {"neck_yaw": 20}, "")
    assert await backbone.run("call", "robot/move") == (
        1,
        "",
        "vertebra: CommandRefusedError: neck_yaw goes to 30 deg, not to 99\n",
    )
    with_answer.close()


async def test_call_to_nobody_and_too_late(backbone: Backbone) -> None:
    async def handler(_: Request) -> Reply:
        await asyncio.sleep(60)
        raise AssertionError

    served = backbone.bus.serve("robot/slow", handler)
    status, _, err = await backbone.run("call", "robot/nobody")
    assert (status, err) == (1, "vertebra: nobody serves 'robot/nobody'\n")
    status, _, err = await backbone.run("call", "robot/slow", "--timeout", "0.3")
    assert status == 1
    assert "within 0.3 s" in err
    served.close()


async def test_a_router_that_is_not_there_is_told_with_the_remedy() -> None:
    gone = Backbone(f"tcp/127.0.0.1:{free_tcp_port()}", None)  # type: ignore[arg-type]
    status, out, err = await gone.run("keys")
    assert (status, out) == (1, "")
    assert "start the fleet with ./vertebra up, or name its router with --router" in err
    assert "Traceback" not in err
