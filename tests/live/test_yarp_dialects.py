"""One fleet of YARP 3 and YARP 4: each connection speaks the dialect of its peer."""

from __future__ import annotations

import asyncio
import json
import logging
from array import array
from pathlib import Path

import pytest

from vertebra.errors import EncodeError
from vertebra.testing.bus_suite import eventually
from vertebra.yarp import (
    Contact,
    Dialect,
    Float32,
    Incoming,
    NameClient,
    NameServer,
    Port,
    Reader,
    RpcClient,
    Sender,
    Value,
    Vocab,
    encode,
    objects,
)
from vertebra.yarp.naming.exchange import ask

from .yarp_inbox import echo

SESSIONS = Path(__file__).parents[1] / "conformance" / "yarp" / "sessions.json"
PARTED: list[Value] = [1.5, Float32(0.5), [2.5, "x"]]
"""Differs in each tag between the dialects."""

every_dialect = pytest.mark.parametrize("dialect", Dialect, ids=str)


# --- asking a port ---


@every_dialect
async def test_a_port_tells_its_dialect_and_keeps_its_connections(
    names: NameClient, dialect: Dialect
) -> None:
    got: list[Incoming] = []
    async with (
        await Port.open("/in", names, on_data=got.append, dialect=dialect) as port,
        await Port.open("/out", names, dialect=dialect) as writer,
    ):
        await writer.connect("/in", "tcp")
        assert await names.dialects.of(port.contact) is dialect
        assert await names.dialects.of(writer.contact) is dialect
        writer.write([1.5])
        await eventually(lambda: len(got) == 1)
        assert [link.peer for link in port.inputs] == ["/out"]
        assert [link.peer for link in writer.outputs] == ["/in"]


async def test_a_port_is_not_asked_again_at_once(names: NameClient) -> None:
    asked = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        asked.append((await reader.readline(), await reader.readline(), await reader.readline()))
        writer.write(b'Welcome admin\r\n-1 "no connection to abcdef"\r\n<ACK>\r\n')
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with server:
        contact = await names.register("/four", tcp_port=server.sockets[0].getsockname()[1])
        assert await names.dialects.of(contact) is Dialect.V4
        assert await names.dialects.of(contact) is Dialect.V4
    assert asked == [(b"CONNACK admin\r\n", b"a\r\n", b"[del] [abcdef]\r\n")]


REFUSALS = [
    (case, Dialect.V4 if b"abcdef" in raw else Dialect.V3, raw)
    for case, facts in json.loads(SESSIONS.read_text(encoding="utf-8"))["cases"].items()
    for connection in facts["connections"]
    for _, direction, piece, *_ in connection["data"]
    for raw in [bytes.fromhex(piece)]
    if direction == "s>c" and b"connection to abcd" in raw
]


@pytest.mark.parametrize(("case", "dialect", "raw"), REFUSALS)
async def test_what_real_ports_of_3_12_and_4_0_answered(
    names: NameClient, case: str, dialect: Dialect, raw: bytes
) -> None:
    """Captured from both, see `mix_*` in the sessions."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        assert await reader.readline() == b"CONNACK admin\r\n"
        writer.write(b"Welcome admin\r\n" + raw.removeprefix(b"Welcome probe\r\n"))
        await reader.read()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        contact = await names.register(f"/{case}", tcp_port=server.sockets[0].getsockname()[1])
        assert await names.dialects.of(contact) is dialect


def test_both_generations_were_captured() -> None:
    assert {dialect for _, dialect, _ in REFUSALS} == {*Dialect}


@pytest.mark.parametrize(
    "answer", [b"", b"Welcome admin\r\n<ACK>\r\n", b"Welcome admin\r\nwhat\r\n<ACK>\r\n"]
)
async def test_who_does_not_tell_is_taken_for_yarp_3_with_one_line_in_the_log(
    names: NameClient, answer: bytes, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("vertebra.yarp.naming.probe.PROBE_TIMEOUT_S", 0.2)
    gone = asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(answer)
        await reader.read()  # until we leave
        writer.close()
        gone.set()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        contact = await names.register("/mute", tcp_port=server.sockets[0].getsockname()[1])
        async with asyncio.timeout(2):
            assert await names.dialects.of(contact) is Dialect.V3
            await gone.wait()
    (line,) = [record.message for record in caplog.records if "/mute" in record.message]
    assert "does not tell its dialect" in line
    assert "YARP 3 is assumed" in line


async def test_nobody_there_is_left_to_whoever_dials(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    contact = await names.register("/dead", tcp_port=1)
    assert await names.dialects.of(contact) is Dialect.V3
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


async def test_a_name_server_tells_its_dialect_by_an_echo(
    server: NameServer, names: NameClient
) -> None:
    assert await names.dialects.of(server.contact) is Dialect.V3
    lines = await ask(names.host, names.tcp_port, "d", "check /root x [abcdef]", 1.0)
    assert "value abcd " in lines[0]


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ({}, None),
        ({"/": Dialect.V4}, Dialect.V4),
        ({"/icub/head": Dialect.V4}, Dialect.V4),
        ({"/icub/head/rpc:i": Dialect.V4, "/icub": Dialect.V3, "/": Dialect.V3}, Dialect.V4),
        ({"/icub/he": Dialect.V4}, None),
    ],
)
async def test_what_a_route_says_is_not_asked(
    names: NameClient, told: dict[str, Dialect], expected: Dialect | None
) -> None:
    names.dialects.told = told
    assert names.dialects.told_of("/icub/head/rpc:i") is expected
    if expected is not None:
        contact = Contact("/icub/head/rpc:i", "tcp", "127.0.0.1", 1)  # nobody is there
        assert await names.dialects.of(contact) is expected
        assert await names.dialects.of_sender(contact.name) is expected


# --- each connection in its own dialect ---


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp", "text", "text_ack"])
async def test_one_writer_serves_readers_of_both_dialects(names: NameClient, carrier: str) -> None:
    got: dict[Dialect, list[Incoming]] = {dialect: [] for dialect in Dialect}
    async with (
        await Port.open("/three", names, on_data=got[Dialect.V3].append, dialect=Dialect.V3),
        await Port.open("/four", names, on_data=got[Dialect.V4].append, dialect=Dialect.V4),
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        await writer.connect("/three", carrier)
        await writer.connect("/four", carrier)
        vector = objects.Vector.of([1.5, 2.5])
        writer.write(vector)
        writer.write(PARTED)
        writer.write(vector.encode(Dialect.V4))  # bytes find their way, too
        writer.write(vector.encode(Dialect.V3))
        for dialect in Dialect:
            await eventually(lambda dialect=dialect: len(got[dialect]) == 4)  # type: ignore[misc]
            payloads = [bytes(incoming.payload) for incoming in got[dialect]]
            assert payloads[0] == vector.encode(dialect)
            assert payloads[2:] == [payloads[0]] * 2
            if not carrier.startswith("text"):  # text has one kind of floats
                assert payloads[1] == encode(PARTED, dialect)


@every_dialect
async def test_who_reads_us_in_reverse_is_asked_by_name(
    names: NameClient, dialect: Dialect
) -> None:
    got: list[Incoming] = []
    async with (
        await Port.open("/reader", names, on_data=got.append, dialect=dialect),
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        await Reader.dial("/out", names, on_data=got.append, reader_name="/reader")
        await eventually(lambda: bool(writer.outputs))
        for _ in range(3):
            writer.write(PARTED)  # kept until the answer is there
        await eventually(lambda: len(got) == 3)
        assert {bytes(incoming.payload) for incoming in got} == {encode(PARTED, dialect)}


async def test_a_reader_that_cannot_be_asked_gets_yarp_3(names: NameClient) -> None:
    got: list[Incoming] = []
    async with await Port.open("/out", names, delivery="queue") as writer:
        await Reader.dial("/out", names, on_data=got.append, reader_name="/nowhere")
        await eventually(lambda: bool(writer.outputs))
        writer.write(PARTED)
        await eventually(lambda: len(got) == 1)
        assert bytes(got[0].payload) == encode(PARTED, Dialect.V3)


@every_dialect
async def test_messages_show_the_dialect_of_who_sends_them(
    names: NameClient, dialect: Dialect
) -> None:
    got: list[Incoming] = []
    async with (
        await Port.open("/in", names, on_data=got.append),
        await Port.open("/out", names, dialect=dialect) as writer,
    ):
        await Reader.dial("/out", names, on_data=got.append, reader_name="/me")
        await eventually(lambda: bool(writer.outputs))
        await writer.connect("/in")
        writer.write(PARTED)
        await eventually(lambda: len(got) == 2)
        assert [incoming.bottle() for incoming in got] == [PARTED] * 2
        assert {incoming.dialect for incoming in got} == {dialect}


@every_dialect
async def test_calls_and_replies_are_in_the_dialect_of_the_server(
    names: NameClient, dialect: Dialect
) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo, dialect=dialect),
        await RpcClient.connect("/rpc", names) as client,
    ):
        assert client.dialect is dialect
        assert await client.call(PARTED, timeout_s=5) == PARTED


@every_dialect
async def test_replies_are_in_the_dialect_of_the_caller(
    names: NameClient, dialect: Dialect
) -> None:
    async def answer(_: Incoming) -> list[Value]:
        return [1.5, "ok"]

    async with (
        await Port.open("/rpc", names, on_call=answer),
        await Port.open("/caller", names, dialect=dialect),
        await RpcClient.connect("/rpc", names, sender="/caller", dialect=dialect) as known,
        await RpcClient.connect("/rpc", names, dialect=dialect) as nameless,
    ):
        assert await known.call(["anything"], timeout_s=5) == [1.5, "ok"]
        assert await nameless.call([0.5], timeout_s=5) == [1.5, "ok"]  # shown by the request


async def test_a_caller_of_unknown_dialect_waits_only_for_replies_that_differ(
    names: NameClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A C++ caller may be unable to answer the question while it waits for its reply."""
    monkeypatch.setattr("vertebra.yarp.naming.probe.PROBE_TIMEOUT_S", 0.3)

    async def hang(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()

    busy = await asyncio.start_server(hang, "127.0.0.1", 0)
    async with busy, await Port.open("/rpc", names, on_call=echo_or_float):
        await names.register("/busy", tcp_port=busy.sockets[0].getsockname()[1])
        async with await RpcClient.connect(
            "/rpc", names, sender="/busy", dialect=Dialect.V3
        ) as caller:
            began_s = asyncio.get_running_loop().time()
            assert await caller.call(["x", 1], timeout_s=5) == ["x", 1]
            assert asyncio.get_running_loop().time() - began_s < 0.25
            assert await caller.call(["float"], timeout_s=5) == [1.5]


async def echo_or_float(incoming: Incoming) -> list[Value]:
    values = incoming.bottle()
    return [1.5] if values == ["float"] else values


@every_dialect
async def test_a_sender_speaks_the_dialect_of_its_port(names: NameClient, dialect: Dialect) -> None:
    got: list[Incoming] = []
    command = objects.Pair([Vocab("dpo"), 3], objects.Vector.of([10.5]))
    async with await Port.open("/in", names, on_data=got.append, dialect=dialect):
        sender = await Sender.dial("/in", names, sender_name="/me")
        sender.write(command)
        await eventually(lambda: len(got) == 1)
        assert bytes(got[0].payload) == command.encode(dialect)
        await sender.close()


async def test_what_one_dialect_cannot_say_reaches_the_others(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    got: dict[Dialect, list[Incoming]] = {dialect: [] for dialect in Dialect}
    async with (
        await Port.open("/three", names, on_data=got[Dialect.V3].append, dialect=Dialect.V3),
        await Port.open("/four", names, on_data=got[Dialect.V4].append, dialect=Dialect.V4),
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        three = await writer.connect("/three")
        await writer.connect("/four")
        writer.write([Vocab("abcdef")])
        writer.write([1.5])
        await eventually(lambda: len(got[Dialect.V4]) == 2)
        await eventually(lambda: len(got[Dialect.V3]) == 1)
        assert three.counters.refused == 1
        assert "YARP 3 has only 4" in caplog.text
        with pytest.raises(EncodeError, match="cannot hold a object"):
            writer.write([object()])  # type: ignore[list-item]


async def test_pixels_are_shared_by_all_readers(names: NameClient) -> None:
    image = objects.Image("mono", 8, 1, array("B", bytes(8)))  # type: ignore[arg-type]
    parts = [image.encode_parts(dialect)[1] for dialect in Dialect]
    assert all(part is image.pixels for part in parts)
