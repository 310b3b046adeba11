"""YARP ports against ports, tools and troublemakers, over real sockets and processes."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import struct
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from vertebra.errors import (
    BusyError,
    CommandRefusedError,
    DeadlineError,
    EncodeError,
    NotConnectedError,
)
from vertebra.testing.bus_suite import eventually
from vertebra.yarp import (
    Dialect,
    Incoming,
    NameClient,
    NameServer,
    PeerLimits,
    Port,
    PortNotFoundError,
    Reader,
    RpcClient,
    Value,
    Vocab,
    encode,
)
from vertebra.yarp.protocol.wire import (
    ACK,
    FAST_TCP,
    TCP,
    binary_message,
    command,
    greeting,
    reverse_message,
    yarp_number,
)

from .yarp_inbox import Inbox, echo

TIMEOUT_S = 5.0
PEER = Path(__file__).parent / "yarp_peer.py"
CARRIERS = ("tcp", "fast_tcp", "text", "text_ack")


class Raw:
    """A peer that sends what the test wants."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    async def expect(self, raw: bytes) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            assert await self.reader.readexactly(len(raw)) == raw

    async def say(self, raw: bytes, answer: bytes) -> None:
        self.writer.write(raw)
        await self.expect(answer)

    async def closed(self) -> bytes:
        """Wait until the other side closes; return what it sent before."""
        async with asyncio.timeout(TIMEOUT_S):
            try:
                return await self.reader.read()
            except ConnectionError:
                return b""


@asynccontextmanager
async def raw_peer(port: Port, hello: bytes = b"") -> AsyncIterator[Raw]:
    reader, writer = await asyncio.open_connection(port.contact.host, port.contact.tcp_port)
    peer = Raw(reader, writer)
    try:
        if hello:
            await peer.say(hello, yarp_number(port.contact.tcp_port))
        yield peer
    finally:
        writer.transport.abort()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def message(payload: bytes, letter: str = "D") -> bytes:
    return b"".join(binary_message(command(letter), (payload,)))


# --- life of a port ---


async def test_a_port_is_registered_while_it_is_open(names: NameClient) -> None:
    async with await Port.open("/a", names) as port:
        assert await names.query("/a") == port.contact
        assert await names.exists("/a")
    assert await names.query("/a") is None
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection(port.contact.host, port.contact.tcp_port)
    await port.close()


async def test_the_name_server_makes_up_a_name(names: NameClient) -> None:
    async with await Port.open("...", names) as port:
        assert port.name.startswith("/tmp/port/")
        assert await names.query(port.name) == port.contact


async def test_a_port_on_all_interfaces_registers_the_address_it_is_seen_from(
    names: NameClient,
) -> None:
    async with await Port.open("/a", names, bind_host="0.0.0.0") as port:
        assert port.contact.host == "127.0.0.1"
    async with await Port.open("/a", names, advertise_host="10.0.0.7") as port:
        assert port.contact.host == "10.0.0.7"


async def test_ports_listen_where_they_are_told_and_not_on_all_interfaces_as_in_yarp(
    names: NameClient,
) -> None:
    elsewhere = "127.0.0.2"  # also this machine
    async with await Port.open("/a", names) as port:
        for tcp_port in (port.contact.tcp_port, names.tcp_port):
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(elsewhere, tcp_port)
    async with await Port.open("/a", names, bind_host="0.0.0.0") as port:
        _, writer = await asyncio.open_connection(elsewhere, port.contact.tcp_port)
        writer.close()
        await writer.wait_closed()


async def test_an_open_that_fails_leaves_nothing_behind(names: NameClient) -> None:
    nobody = NameClient("127.0.0.1", 1)
    with pytest.raises(NotConnectedError, match=r"127\.0\.0\.1:1"):
        await Port.open("/a", nobody)


# --- data ---


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_data_passes_over_every_carrier(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        link = await writer.connect("/in", carrier)
        writer.write(encode([1, 2.5, "a b", [Vocab("vo"), b"\1\2"]]), envelope="41 1234.5")
        writer.write(encode([]))
        first, second = await inbox.wait(2)
        assert first.bottle() == [1, 2.5, "a b", [Vocab("vo"), b"\1\2"]]
        assert (first.envelope, first.sender, first.carrier) == ("41 1234.5", "/out", carrier)
        assert (first.sender_host, first.reply_wanted) == ("127.0.0.1", False)
        assert (second.bottle(), second.envelope) == ([], "")
        assert [(each.peer, each.carrier) for each in reader.inputs] == [("/out", carrier)]
        assert [(each.peer, each.carrier) for each in writer.outputs] == [("/in", carrier)]
        assert link.counters.messages == writer.sent.messages == reader.received.messages == 2
        assert writer.sent.bytes == reader.received.bytes
        assert await writer.disconnect("/in")
        assert not await writer.disconnect("/in")
        await eventually(lambda: not reader.inputs)
        assert reader.received.messages == 2


async def test_one_tcp_port_serves_all_carriers_and_the_first_eight_bytes_decide(
    names: NameClient,
) -> None:
    async with (
        await Port.open("/in", names, on_data=Inbox()) as port,
        raw_peer(port, greeting(TCP, "/a")),
        raw_peer(port, greeting(FAST_TCP, "/b")),
        raw_peer(port) as text,
        raw_peer(port) as page,
    ):
        await text.say(b"CONNECT /c\r\n", b"Welcome /c\r\n")
        page.writer.write(b"GET / HTTP/1.1\r\n\r\n")
        await page.expect(b"HTTP/")
        found = [(each.peer, each.carrier) for each in port.inputs]
        assert found[:3] == [("/a", "tcp"), ("/b", "fast_tcp"), ("/c", "text")]


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp"])
@pytest.mark.parametrize("size", [0, 1, 16_384, 65_536, 921_600, 20_000_000])
async def test_payloads_of_all_sizes_arrive_whole(
    names: NameClient, carrier: str, size: int
) -> None:
    inbox = Inbox()
    payload = bytes(range(256)) * (size // 256) + bytes(size % 256)
    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/out", names) as writer,
    ):
        await writer.connect("/in", carrier)
        writer.write(payload)
        (got,) = await inbox.wait(1)
        assert bytes(got.payload) == payload


async def test_arrays_are_sent_as_their_bytes(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/out", names) as writer,
    ):
        await writer.connect("/in")
        array: memoryview[Any] = memoryview(struct.pack("<3d", 1, 2, 3)).cast("d")
        writer.write(array)
        (got,) = await inbox.wait(1)
        assert struct.unpack("<3d", got.payload) == (1, 2, 3)


async def test_a_second_connection_replaces_the_first(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names) as writer,
    ):
        first = await writer.connect("/in", "tcp")
        await writer.connect("/in", "fast_tcp")
        await first.wait_closed()
        assert [each.carrier for each in writer.outputs] == ["fast_tcp"]
        await eventually(lambda: [each.carrier for each in reader.inputs] == ["fast_tcp"])
        writer.write(encode([1]))
        await inbox.wait(1)


async def test_whom_a_port_cannot_write_to(names: NameClient) -> None:
    async with await Port.open("/out", names) as writer:
        with pytest.raises(PortNotFoundError, match="/nope is not registered"):
            await writer.connect("/nope")
        await names.register("/dead", host="127.0.0.1", tcp_port=1)
        with pytest.raises(NotConnectedError, match=r"/dead at 127.0.0.1:1"):
            await writer.connect("/dead")
        with pytest.raises(EncodeError, match="'shmem'"):
            await writer.connect("/dead", "shmem")
        assert writer.outputs == []


async def test_a_port_that_does_not_answer_a_greeting(names: NameClient) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        await names.register("/mute", host="127.0.0.1", tcp_port=silent.getsockname()[1])
        limits = PeerLimits(connect_timeout_s=0.1)
        async with await Port.open("/out", names, limits=limits) as writer:
            for carrier in ("tcp", "text"):
                with pytest.raises(DeadlineError, match=r"/mute at 127.0.0.1:\d+ within 0.1 s"):
                    await writer.connect("/mute", carrier)


@pytest.mark.parametrize("carrier", ["tcp", "text_ack"])
async def test_what_listens_there_is_no_yarp_port(names: NameClient, carrier: str) -> None:
    async def say_http(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(8)
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        await reader.read()
        writer.close()

    async with (
        await Port.open("/out", names) as writer,
        await asyncio.start_server(say_http, "127.0.0.1", 0) as web,
    ):
        await names.register("/web", host="127.0.0.1", tcp_port=web.sockets[0].getsockname()[1])
        with pytest.raises(NotConnectedError, match=f"does not take {carrier}: .*HTTP"):
            await writer.connect("/web", carrier)
        assert writer.outputs == []


async def test_connecting_is_given_up_when_its_caller_is_cancelled(names: NameClient) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.settimeout(TIMEOUT_S)
        await names.register("/mute", host="127.0.0.1", tcp_port=silent.getsockname()[1])
        async with await Port.open("/out", names, dialect=Dialect.V3) as writer:
            connecting = asyncio.create_task(writer.connect("/mute", "tcp"))
            peer, _ = await asyncio.to_thread(silent.accept)
            with peer:
                hello = greeting(TCP, "/out")
                assert await asyncio.to_thread(peer.recv, len(hello)) == hello
                connecting.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await connecting
                assert await asyncio.to_thread(peer.recv, 1) == b""
        assert writer.outputs == []


async def test_a_reader_that_fails_loses_the_message_and_not_the_stream(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    inbox = Inbox()

    def on_data(incoming: Incoming) -> None:
        (value,) = incoming.bottle()
        assert value != "poison"
        inbox(incoming)

    async with (
        await Port.open("/in", names, on_data=on_data) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        await writer.connect("/in", "tcp")
        writer.write(b"no bottle at all")
        writer.write(encode(["poison"]))
        writer.write(encode(["good"]))
        await inbox.wait(1)
        assert inbox.bottles == [["good"]]
        assert (reader.received.messages, reader.received.refused) == (1, 2)
    assert "no bottle begins" in caplog.text
    assert "AssertionError" in caplog.text


async def test_what_has_no_text_form_is_not_sent_as_text(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    inbox = Inbox()
    limits = PeerLimits(max_text_bytes=1000)
    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/out", names, limits=limits, delivery="queue") as writer,
    ):
        link = await writer.connect("/in", "text_ack")
        writer.write(b"no bottle")
        writer.write(encode(["x" * 2000]))
        writer.write(encode(["fine"]))
        await inbox.wait(1)
        assert inbox.bottles == [["fine"]]
        assert (link.counters.messages, link.counters.refused) == (1, 2)
    assert "max_text_bytes is 1000" in caplog.text


async def test_a_port_of_yarp_4_speaks_its_dialect(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox, dialect=Dialect.V4),
        await Port.open("/out", names, dialect=Dialect.V4) as writer,
    ):
        for carrier in ("fast_tcp", "text"):
            await writer.connect("/in", carrier)
            writer.write(encode([1.5, Vocab("abcdef")], Dialect.V4))
        await inbox.wait(2)
        assert inbox.bottles == [[1.5, "abcdef"]] * 2


# --- tools ---


async def test_the_yarp_tool_connects_and_disconnects_our_ports(names: NameClient) -> None:
    """The bytes are those of `yarp connect /out /in tcp` and `yarp disconnect /out /in`."""
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names) as writer,
    ):
        for request, answer in (
            (b'[list] [out] "/in"', b""),
            (b'[add] "tcp://in"', rb'0 "Added connection from /out to tcp://in\r\n"'),
            (b'[list] [out] "/in"', b'(from "/out") (to "/in") (carrier tcp)'),
        ):
            async with raw_peer(writer) as tool:
                await tool.say(b"CONNACK admin\r\n", b"Welcome admin\r\n")
                await tool.say(b"a\r\n" + request + b"\r\n", answer + b"\r\n<ACK>\r\n")
        writer.write(encode(["hello"]))
        await inbox.wait(1)
        async with raw_peer(reader) as ping:
            await ping.say(b"CONNACK <ping>\r\n", b"Welcome <ping>\r\n")
            tcp_port = reader.contact.tcp_port
            await ping.say(
                b"*\r\n",
                b"This is /in at tcp://127.0.0.1:%d/\r\n"
                b"There are no outgoing connections\r\n"
                b"There is an input connection from /out to /in using tcp\r\n"
                b"There is an input connection from <ping> to /in using text_ack\r\n"
                b"<ACK>\r\n" % tcp_port,
            )
        async with raw_peer(writer) as tool:
            await tool.say(b"CONNACK admin\r\n", b"Welcome admin\r\n")
            await tool.say(
                b'a\r\n[del] "/in"\r\n',
                b'0 "Removed connection from /out to /in\\r\\n"\r\n<ACK>\r\n',
            )
            await tool.say(b'a\r\n[list] [out] "/in"\r\n', b"\r\n<ACK>\r\n")
        await eventually(lambda: not reader.inputs)


async def test_commands_that_people_type(names: NameClient) -> None:
    async with (
        await Port.open("/in", names, on_data=Inbox()) as reader,
        await Port.open("/out", names) as writer,
        raw_peer(writer) as person,
        raw_peer(reader) as other,
    ):
        await person.say(b"CONNACK me\n", b"Welcome me\r\n")
        await person.say(b"/in\n", b"Added connection from /out to /in\r\n<ACK>\r\n")
        await other.say(b"CONNECT me\n", b"Welcome me\r\n")
        await other.say(b"~/out\n", b"Removing connection from /out to /in\r\n")
        await eventually(lambda: not writer.outputs)
        await person.say(b"/nope\n", b"Do not know how to connect to /nope\r\n<ACK>\r\n")
        await person.say(b"!/in\n", b"Could not find an outgoing connection to /in\r\n<ACK>\r\n")
        await person.say(b"q\n", b"<ACK>\r\n")
        assert await person.closed() == b""


async def test_requests_that_a_port_cannot_fulfil(names: NameClient) -> None:
    await names.register("/dead", host="127.0.0.1", tcp_port=1)
    async with (
        await Port.open("/a", names) as port,
        raw_peer(port) as tool,
        raw_peer(port, greeting(TCP, "admin")) as binary,
    ):
        await tool.say(b"CONNACK admin\r\n", b"Welcome admin\r\n")
        for request, answer in (
            (
                b'[add] "shmem://in"',
                b"-1 \"Cannot connect to shmem://in: cannot connect over carrier 'shmem'",
            ),
            (b'[add] "/dead"', b'-1 "Cannot connect to /dead: cannot reach YARP port /dead'),
            (b'[get] [in] "/nope"', b'-1 "Could not find an incoming connection from /nope'),
            (b'[set] [out] "/nope" (x 1)', b'-1 "Could not find an incoming connection to /nope'),
            (b"[prop] [get] none", b"\r\n<ACK>"),
            (b"[atch] [out] x", b'[fail] "portmonitor plug-ins are for the C++ library of YARP'),
            (b"[dtch] x", b'[fail] "detach command must be followed by [out] or [in]"'),
            (b"[get] x", b'[fail] "get command must be followed by [out] or [in]"'),
            (b"[get] [in]", b'-1 "target port is not specified.\\r\\n"'),
            (b"[prop] [get] /nope", b'[fail] "cannot find any connection to/from /nope"'),
            (b"[prop] [set] /nope (sched ((priority 30)))", b"[fail]"),
            (b"17", b'[fail] "send [help] for list of valid commands"'),
        ):
            await tool.say(b"a\r\n" + request + b"\r\n", answer)
            await tool.reader.readuntil(b"<ACK>\r\n" if not answer.endswith(b"<ACK>") else b"\r\n")
        await binary.say(message(b"no bottle at all", "a"), encode([Vocab("fail"), "x"])[:20])
        await binary.reader.readuntil(ACK)
        letter_z = message(b"").replace(b"~D", b"~z")
        await binary.say(letter_z, ACK)


async def test_what_a_port_tells_about_its_process(names: NameClient) -> None:
    async with (
        await Port.open("/a", names, on_call=echo) as port,
        raw_peer(port) as tool,
    ):
        await tool.say(b"CONNACK admin\r\n", b"Welcome admin\r\n")
        tool.writer.write(b'a\r\n[prop] [get] "/a"\r\n')
        answer = (await tool.reader.readuntil(b"<ACK>\r\n")).decode()
        assert f"(pid {os.getpid()})" in answer
        assert "(is_rpc 1)" in answer
        tool.writer.write(b"a\r\n[help]\r\n")
        assert b"[many]" in await tool.reader.readuntil(b"<ACK>\r\n")


async def test_what_tools_may_set_is_bounded(names: NameClient) -> None:
    async with (
        await Port.open("/a", names) as port,
        raw_peer(port) as tool,
    ):
        await tool.say(b"CONNACK admin\r\n", b"Welcome admin\r\n")
        for number in range(100):
            await tool.say(b"a\n[prop] [set] k%d (1 2)\n" % number, b"[ok]\r\n<ACK>\r\n")
        await tool.say(b"a\n[prop] [set] k7 8\n", b"[ok]\r\n<ACK>\r\n")
        await tool.say(b"a\n[prop] [get] k7\n", b"8\r\n<ACK>\r\n")
        await tool.say(b"a\n[prop] [set] more 1\n", b'[fail] "a port keeps at most 100')


# --- reading by reverse connection ---


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp"])
async def test_reading_without_a_port_of_our_own(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    async with await Port.open("/out", names, delivery="queue") as source:
        reader = await Reader.dial("/out", names, on_data=inbox, reader_name="/me", carrier=carrier)
        await eventually(lambda: bool(source.outputs))
        assert [(each.peer, each.carrier) for each in source.outputs] == [("/me", carrier)]
        for number in range(10):
            source.write([number, bytes(number * 10_000)], envelope=f"{number} 0.5")
        got = await inbox.wait(10)
        assert [len(each.payload) for each in got] == [24 + n * 10_000 for n in range(10)]
        assert got[3].envelope == "3 0.5"
        assert got[3].sender == "/out"
        assert reader.counters.messages == 10
        assert [each.name for each in await names.list_ports()] == ["/out", "/root"]
        await reader.close()
        await eventually(lambda: not source.outputs)
        assert source.sent.messages == 10


async def test_a_reader_is_told_when_its_source_closes(names: NameClient) -> None:
    async with await Port.open("/out", names):
        reader = await Reader.dial("/out", names, on_data=Inbox(), reader_name="/me")
    assert await asyncio.wait_for(reader.wait_closed(), TIMEOUT_S) == "closed by the peer"
    assert reader.closed
    with pytest.raises(PortNotFoundError):
        await Reader.dial("/out", names, on_data=Inbox(), reader_name="/me")


async def test_a_reader_of_the_same_name_takes_over(names: NameClient) -> None:
    async with await Port.open("/out", names) as source:
        first = await Reader.dial("/out", names, on_data=Inbox(), reader_name="/me")
        await eventually(lambda: len(source.outputs) == 1)
        second = await Reader.dial("/out", names, on_data=Inbox(), reader_name="/me")
        await asyncio.wait_for(first.wait_closed(), TIMEOUT_S)
        assert not second.closed
        await eventually(lambda: len(source.outputs) == 1)
        await second.close()


async def test_only_what_yarp_can_reverse_is_asked_for(names: NameClient) -> None:
    with pytest.raises(EncodeError, match="text_ack"):
        await Reader.dial("/o", names, on_data=Inbox(), reader_name="/me", carrier="text_ack")


# --- calls ---


async def test_calls_are_answered(names: NameClient) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo) as port,
        await RpcClient.connect("/rpc", names) as client,
    ):
        request: list[Value] = [Vocab("get"), "axes", 1, 2.5, [], [1, [2.5, "x"]]]
        assert await client.call(request, timeout_s=TIMEOUT_S) == request
        big = ["x" * 3_000_000]
        assert await client.call(big, timeout_s=TIMEOUT_S) == big
        replies = await asyncio.gather(
            *(client.call([number], timeout_s=TIMEOUT_S) for number in range(50))
        )
        assert replies == [[number] for number in range(50)]
        assert port.received.messages == client.counters.messages == 52


async def test_a_call_to_a_port_that_does_not_reply(names: NameClient) -> None:
    inbox = Inbox()

    async def keep_quiet(_: Incoming) -> None:
        return None

    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/rpc", names, on_call=keep_quiet),
    ):
        for name in ("/in", "/rpc"):
            async with await RpcClient.connect(name, names) as client:
                assert await client.call(["hello"], timeout_s=TIMEOUT_S) == []
    assert inbox.got[0].reply_wanted


async def test_messages_without_reply_reach_a_port_that_answers_calls(names: NameClient) -> None:
    got = []

    async def on_call(incoming: Incoming) -> list[Value]:
        got.append(incoming.bottle())
        return ["nobody waits for this"]

    async with (
        await Port.open("/rpc", names, on_call=on_call) as port,
        raw_peer(port, greeting(TCP, "anon")) as peer,
    ):
        await peer.say(message(encode([1])), ACK)
        await peer.say(message(encode([2]), "d"), encode(["nobody waits for this"]) + ACK)
    assert got == [[1], [2]]


async def test_a_port_with_both_callbacks_tells_data_from_calls(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/both", names, on_data=inbox, on_call=echo) as port,
        raw_peer(port, greeting(TCP, "anon")) as peer,
    ):
        await peer.say(message(encode([1])), ACK)
        await peer.say(message(encode([2]), "d"), encode([2]) + ACK)
    assert inbox.bottles == [[1]]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (CommandRefusedError("joint 9: there are 6"), "joint 9: there are 6"),
        (ZeroDivisionError("a fault"), "/rpc failed; its log says why"),
        (DeadlineError("the motor", 3), "no answer from the motor within 3 s"),
    ],
)
async def test_a_call_that_fails_says_so(
    names: NameClient, caplog: pytest.LogCaptureFixture, error: Exception, reason: str
) -> None:
    async def on_call(_: Incoming) -> None:
        raise error

    async with (
        await Port.open("/rpc", names, on_call=on_call) as port,
        await RpcClient.connect("/rpc", names) as client,
    ):
        for _ in range(2):
            reply = await client.call(["x"], timeout_s=TIMEOUT_S)
            assert reply == [Vocab("fail"), reason]
        assert port.received.refused == 2
    assert str(error) in caplog.text


async def test_a_reply_that_is_no_bottle_fails(names: NameClient) -> None:
    async def on_call(_: Incoming) -> list[Any]:
        return [object()]

    async with (
        await Port.open("/rpc", names, on_call=on_call),
        await RpcClient.connect("/rpc", names) as client,
    ):
        reply = await client.call(["x"], timeout_s=TIMEOUT_S)
        assert reply[0] == "fail"
        assert "cannot hold a object" in str(reply[1])


async def test_a_slow_call_is_given_up_by_the_port(names: NameClient) -> None:
    cancelled = asyncio.Event()

    async def on_call(_: Incoming) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.set()

    limits = PeerLimits(reply_timeout_s=0.05)
    async with (
        await Port.open("/rpc", names, on_call=on_call, limits=limits),
        await RpcClient.connect("/rpc", names) as client,
    ):
        reply = await client.call(["x"], timeout_s=TIMEOUT_S)
        assert reply == [Vocab("fail"), "no reply within 0.05 s"]
        assert cancelled.is_set()


async def test_a_slow_call_is_given_up_by_the_client(names: NameClient) -> None:
    release = asyncio.Event()

    async def on_call(_: Incoming) -> list[Value]:
        await release.wait()
        return ["late"]

    async with await Port.open("/rpc", names, on_call=on_call):
        client = await RpcClient.connect("/rpc", names)
        waiting = asyncio.create_task(client.call(["next"], timeout_s=TIMEOUT_S))
        with pytest.raises(DeadlineError, match=r"/rpc within 0.05 s"):
            await client.call(["x"], timeout_s=0.05)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert client.closed
        with pytest.raises(NotConnectedError, match="connect a new client"):
            await client.call(["x"], timeout_s=1)
        release.set()
        async with await RpcClient.connect("/rpc", names) as fresh:
            assert await fresh.call(["x"], timeout_s=TIMEOUT_S) == ["late"]


async def test_more_calls_than_may_wait_are_refused(names: NameClient) -> None:
    release = asyncio.Event()

    async def on_call(_: Incoming) -> list[Value]:
        await release.wait()
        return ["done"]

    async with (
        await Port.open("/rpc", names, on_call=on_call),
        await RpcClient.connect("/rpc", names, max_waiting_calls=2) as client,
    ):
        calls = [asyncio.create_task(client.call([n], timeout_s=TIMEOUT_S)) for n in range(3)]
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match="/rpc is busy: 2 requests"):
            await client.call([3], timeout_s=TIMEOUT_S)
        release.set()
        assert await asyncio.gather(*calls) == [["done"]] * 3


async def test_a_slow_call_holds_up_its_own_connection_only(names: NameClient) -> None:
    release = asyncio.Event()

    async def on_call(incoming: Incoming) -> list[Value]:
        if incoming.bottle() == ["wait"]:
            await release.wait()
        return incoming.bottle()

    async with (
        await Port.open("/rpc", names, on_call=on_call) as port,
        await RpcClient.connect("/rpc", names) as client,
        raw_peer(port, greeting(TCP, "anon")) as peer,
    ):
        # More than fits into the receive buffer, which stops being read in the meantime.
        later = [encode([n, "x" * 200]) for n in range(2000)]
        peer.writer.write(message(encode(["wait"]), "d"))
        peer.writer.write(b"".join(message(each, "d") for each in later))
        assert await client.call(["quick"], timeout_s=TIMEOUT_S) == ["quick"]
        release.set()
        await peer.expect(encode(["wait"]) + ACK + b"".join(each + ACK for each in later))


async def test_a_client_that_does_not_take_its_replies_is_not_served_further(
    names: NameClient,
) -> None:
    calls = 0
    reply: list[Value] = ["x" * 1_000_000]

    async def on_call(_: Incoming) -> list[Value]:
        nonlocal calls
        calls += 1
        return reply

    async with (
        await Port.open("/rpc", names, on_call=on_call) as port,
        await RpcClient.connect("/rpc", names) as other,
        raw_peer(port, greeting(TCP, "anon")) as greedy,
    ):
        greedy.writer.write(message(encode([1]), "d") * 100)
        connection = [*port._board._inputs][1].tcp
        await eventually(lambda: not connection.writable)
        assert await other.call([2], timeout_s=TIMEOUT_S) == reply
        assert calls < 50  # what the kernel took, and one reply
        await greedy.expect((encode(reply) + ACK) * 100)
        assert calls == 101


async def test_a_client_that_does_not_take_its_acks_is_not_read_further(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as port,
        raw_peer(port, greeting(TCP, "anon")) as careless,
    ):
        connection = next(iter(port._board._inputs)).tcp
        assert connection._transport is not None
        sock = connection._transport.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        careless.writer.write(message(encode([1])) * 100_000)
        await eventually(lambda: not connection.writable)
        assert len(inbox.got) < 100_000
        await careless.expect(ACK * 100_000)
        assert len(inbox.got) == 100_000


async def test_a_client_that_has_stopped_sending_gets_its_reply(names: NameClient) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo) as port,
        raw_peer(port) as pipe,  # printf ... | nc host port
    ):
        pipe.writer.write(b"CONNECT me\nd\nhello world\n")
        pipe.writer.write_eof()
        assert await pipe.closed() == b"Welcome me\r\nhello world\r\n"


async def test_calls_over_text(names: NameClient) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo) as port,
        raw_peer(port) as peer,
        raw_peer(port) as named,
    ):
        await peer.say(b"CONNACK me\n", b"Welcome me\r\n")
        await peer.say(b"d\n1 2.5 (a b)\n", b"1 2.5 (a b)\r\n<ACK>\r\n")
        await peer.say(b"d\n\n", b"\r\n<ACK>\r\n")
        await peer.say(b"d\n" + b"(" * 100 + b")" * 100 + b"\n", b"<ACK>\r\n")  # too deep
        await named.say(b"NAME_SERVER hello\n", b"hello\r\n")
        assert port.received.refused == 1


async def test_a_lost_connection_fails_the_call_at_once(names: NameClient) -> None:
    called = asyncio.Event()

    async def on_call(_: Incoming) -> None:
        called.set()
        await asyncio.Event().wait()

    port = await Port.open("/rpc", names, on_call=on_call)
    async with await RpcClient.connect("/rpc", names) as client:
        call = asyncio.create_task(client.call(["x"], timeout_s=60))
        await called.wait()
        await port.close()
        with pytest.raises(NotConnectedError, match="/rpc has ended"):
            await asyncio.wait_for(call, TIMEOUT_S)


async def test_a_port_that_talks_out_of_turn_is_left(names: NameClient) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo) as port,
        await RpcClient.connect("/rpc", names) as client,
    ):
        (link,) = port.inputs
        link._connection.write(encode(["surprise"]) + ACK)
        assert "without being asked" in await asyncio.wait_for(client.wait_closed(), TIMEOUT_S)


# --- slow and dead peers ---


@pytest.mark.parametrize("hello", [greeting(FAST_TCP, "/slow"), greeting(TCP, "/slow")])
async def test_a_reader_that_does_not_read_slows_nobody(names: NameClient, hello: bytes) -> None:
    inbox = Inbox()
    image = bytes(1_000_000)
    async with (
        await Port.open("/out", names) as source,
        raw_peer(source, hello) as slow,  # its stream reads 128 kB and no more
    ):
        slow.writer.write(reverse_message())
        reader = await Reader.dial("/out", names, on_data=inbox, reader_name="/me", carrier="tcp")
        await eventually(lambda: len(source.outputs) == 2)
        for number in range(100):
            source.write([number, image])
            await inbox.wait(number + 1)
        stuck, healthy = source.outputs
        assert (stuck.peer, healthy.peer) == ("/slow", "/me")
        assert (healthy.counters.messages, healthy.counters.dropped) == (100, 0)
        assert stuck.counters.messages < 20  # what the kernel took, or one without ack
        assert stuck.counters.dropped == 99 - stuck.counters.messages  # the newest one waits
        await reader.close()


async def test_a_queue_refuses_when_it_is_full(names: NameClient) -> None:
    async with (
        await Port.open("/out", names, delivery="queue", depth=3, dialect=Dialect.V3) as source,
        raw_peer(source, greeting(TCP, "/slow")) as slow,
    ):
        await slow.say(reverse_message(), ACK)
        for number in range(4):
            source.write(encode([number]))
        with pytest.raises(BusyError, match="/slow is busy: 3 requests"):
            source.write(encode([4]))
        assert source.sent.refused == 1
        for number in range(4):
            await slow.expect(message(encode([number])))
            slow.writer.write(ACK)
        await eventually(lambda: source.sent.messages == 4)


async def test_a_queue_sends_some_messages_ahead_of_their_acks(names: NameClient) -> None:
    async with (
        await Port.open("/out", names, delivery="queue", depth=30) as source,
        raw_peer(source, greeting(TCP, "/slow")) as slow,
    ):
        await slow.say(reverse_message(), ACK)
        for number in range(20):
            source.write(encode([number]))
        ahead = b"".join(message(encode([number])) for number in range(8))
        await slow.expect(ahead)
        assert source.sent.messages == 8
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await slow.reader.read(1)
        slow.writer.write(ACK * 8)
        await slow.expect(b"".join(message(encode([number])) for number in range(8, 16)))


async def test_an_ack_too_many_is_no_fault(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    """YARP 3.12.3 acks once more where a newer connection from us has replaced the old one."""
    async with (
        await Port.open("/out", names) as source,
        raw_peer(source, greeting(TCP, "/reader")) as peer,
    ):
        await peer.say(reverse_message(), ACK)
        peer.writer.write(ACK * 2)
        source.write(encode([1]))
        await peer.expect(message(encode([1])))
        peer.writer.write(ACK)
        await source.wait_for_room()
        assert [output.peer for output in source.outputs] == ["/reader"]
    assert caplog.messages == []


async def test_who_waits_for_room_loses_nothing(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/out", names, delivery="queue", depth=3) as source,
    ):
        await source.wait_for_room()  # nobody reads, nobody is waited for
        await source.connect("/in", "tcp")
        for number in range(100):
            await source.wait_for_room()
            source.write(encode([number]))
        await inbox.wait(100)
        assert inbox.bottles == [[number] for number in range(100)]


async def test_a_property_does_not_fill_the_memory(names: NameClient) -> None:
    async with (
        await Port.open("/a", names) as port,
        raw_peer(port, greeting(TCP, "admin")) as tool,
    ):
        request = encode([Vocab("prop"), Vocab("set"), "x", bytes(300_000)])
        tool.writer.write(message(request, "a"))
        refusal = f"an administrative message of {len(request)} bytes; max_text_bytes is 262144"
        await tool.expect(encode([Vocab("fail"), refusal]) + ACK)
        tool.writer.write(message(encode([Vocab("prop"), Vocab("get")]), "a"))
        await tool.expect(encode([]) + ACK)


async def test_a_reader_that_goes_is_not_waited_for(names: NameClient) -> None:
    async with await Port.open("/out", names, delivery="queue", depth=1) as source:
        async with raw_peer(source, greeting(TCP, "/slow")) as slow:
            await slow.say(reverse_message(), ACK)
            source.write(encode([0]))
            await slow.expect(message(encode([0])))
            source.write(encode([1]))
            waiting = asyncio.create_task(source.wait_for_room())
            await asyncio.sleep(0)
            assert not waiting.done()
        async with asyncio.timeout(TIMEOUT_S):
            await waiting


async def test_the_newest_message_waits_for_a_busy_reader(names: NameClient) -> None:
    """What a busy connection cannot take is counted; YARP's `write(false)` drops it in silence."""
    async with (
        await Port.open("/out", names, dialect=Dialect.V3) as source,
        raw_peer(source, greeting(TCP, "/slow")) as slow,
    ):
        await slow.say(reverse_message(), ACK)
        for number in range(10):
            source.write(encode([number]))
        await slow.expect(message(encode([0])))
        await slow.say(ACK, message(encode([9])))
        assert source.sent.dropped == 8


@asynccontextmanager
async def peer_process(
    role: str, name: str, names: NameClient
) -> AsyncIterator[asyncio.subprocess.Process]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, PEER, role, name, str(names.tcp_port), stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(TIMEOUT_S):
            assert await process.stdout.readline() == b"ready\n"
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def test_a_writer_that_is_killed_is_gone_and_may_come_back(names: NameClient) -> None:
    inbox = Inbox()
    async with await Port.open("/in", names, on_data=inbox) as reader:
        async with peer_process("write", "/w", names) as process:
            other = await Reader.dial("/w", names, on_data=Inbox(), reader_name="/other")
            await ask(names, "/w", '[add] "fast_tcp://in"')
            await inbox.wait(10)
            process.send_signal(signal.SIGKILL)
            await asyncio.wait_for(other.wait_closed(), TIMEOUT_S)
            await eventually(lambda: not reader.inputs)
        assert await names.query("/w") is not None  # nobody could unregister it
        with pytest.raises(NotConnectedError, match="yarp clean"):
            await Reader.dial("/w", names, on_data=Inbox(), reader_name="/other")
        before = len(inbox.got)
        async with peer_process("write", "/w", names):
            await ask(names, "/w", '[add] "tcp://in"')
            await inbox.wait(before + 10)


async def test_a_reader_that_is_killed_is_forgotten(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox),
        await Port.open("/out", names, delivery="queue", depth=1000) as writer,
        peer_process("read", "/r", names) as process,
    ):
        await writer.connect("/in", "tcp")
        link = await writer.connect("/r", "tcp")
        process.send_signal(signal.SIGKILL)
        await asyncio.wait_for(link.wait_closed(), TIMEOUT_S)
        for number in range(100):
            writer.write(encode([number]))
        await inbox.wait(100)
        assert [each.peer for each in writer.outputs] == ["/in"]


async def ask(names: NameClient, port_name: str, request: str) -> None:
    contact = await names.query(port_name)
    assert contact is not None
    reader, writer = await asyncio.open_connection(contact.host, contact.tcp_port)
    writer.write(f"CONNACK admin\r\na\r\n{request}\r\n".encode())
    async with asyncio.timeout(TIMEOUT_S):
        await reader.readline()
        assert (await reader.readline()).startswith(b"0 ")
    writer.close()
    await writer.wait_closed()


# --- the name server restarts ---


async def test_ports_register_again_when_the_name_server_has_forgotten_them(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    inbox = Inbox()
    first = await NameServer.start(tcp_port=0)
    names = first.client()
    async with (
        await Port.open("/in", names, on_data=inbox, check_registration_s=0.02),
        await Port.open("/out", names, check_registration_s=0.02) as writer,
    ):
        await writer.connect("/in")
        await first.close()
        await eventually(lambda: "cannot reach the YARP name server" in caplog.text)
        writer.write(encode([1]))  # who is connected does not need it
        await inbox.wait(1)
        async with await NameServer.start(tcp_port=first.contact.tcp_port):
            await eventually(lambda: caplog.text.count("is registered again") == 2)
            assert await names.exists("/in")
            assert await names.exists("/out")
            assert caplog.text.count("cannot reach the YARP name server") == 2  # each once
            await writer.close()


async def test_a_port_closes_although_the_name_server_hangs(
    caplog: pytest.LogCaptureFixture,
) -> None:
    server = await NameServer.start(tcp_port=0)
    port = await Port.open("/a", server.client())
    await server.close()
    with socket.create_server(("127.0.0.1", server.contact.tcp_port)):
        async with asyncio.timeout(2):
            await port.close()
    assert "/a stays registered: no answer in time" in caplog.text


async def test_a_name_taken_over_by_another_port_is_not_fought_for(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    async with await Port.open("/a", names, check_registration_s=0.02):
        taken = await names.register("/a", host="10.0.0.7", tcp_port=1)
        await eventually(lambda: "another port has taken its name" in caplog.text)
        assert await names.query("/a") == taken


# --- troublemakers ---


@pytest.mark.parametrize(
    ("hello", "rubbish", "complaint"),
    [
        (b"", b"HELLO WORLD", "choose no YARP carrier"),
        (b"", b"GET /?ws HTTP/1.1\r\n\r\n", "carrier websocket is not spoken here"),
        (b"", FAST_TCP.header + struct.pack("<i", 2**31 - 1), "announces a name of 2147483647"),
        (b"", greeting(TCP, "/x", ["recv.bayer"]), "needs the plug-in 'recv.bayer'"),
        (greeting(TCP, "/x"), b"rubbish rubbish", "must begin with a YARP number"),
        (greeting(TCP, "/x"), ACK, "where a message should be"),
        (
            greeting(TCP, "/x"),
            yarp_number(10) + b"\1\1" + b"\xff" * 8 + struct.pack("<ii", 2**31 - 1, 0),
            "announces 2147483647 bytes; max_message_bytes is",
        ),
    ],
)
async def test_a_troublemaker_is_closed_with_the_reason_and_all_others_live_on(
    names: NameClient,
    caplog: pytest.LogCaptureFixture,
    hello: bytes,
    rubbish: bytes,
    complaint: str,
) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as port,
        await Port.open("/out", names) as writer,
    ):
        await writer.connect("/in", "tcp")
        async with raw_peer(port, hello) as trouble:
            host, tcp_port = trouble.writer.get_extra_info("sockname")
            trouble.writer.write(rubbish)
            await trouble.closed()
            assert f"from {host}:{tcp_port}" in caplog.text
            assert complaint in caplog.text
        writer.write(encode(["still here"]))
        await inbox.wait(1)
        assert [each.peer for each in port.inputs] == ["/out"]


async def test_a_peer_that_connects_and_says_nothing_is_tolerated_for_a_while(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    limits = PeerLimits(greeting_timeout_s=0.1)
    async with await Port.open("/in", names, limits=limits, on_call=echo) as port:
        async with raw_peer(port):
            pass  # `yarp exists`
        async with raw_peer(port) as silent, raw_peer(port) as half:
            half.writer.write(b"CONN")
            assert port.inputs == []
            assert await names.exists("/in")
            assert await silent.closed() == b""
            assert await half.closed() == b""
        async with raw_peer(port, greeting(TCP, "quiet")) as quiet:
            await asyncio.sleep(0.3)  # who has greeted may be silent for as long as it likes
            await quiet.say(message(encode([1]), "d"), encode([1]) + ACK)
    assert caplog.text.count("no greeting within 0.1 s") == 2


async def test_when_a_port_is_full_the_longest_silent_peer_makes_room(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    limits = PeerLimits(max_connections=2)
    async with (
        await Port.open("/in", names, limits=limits) as port,
        raw_peer(port) as silent,
        raw_peer(port, greeting(TCP, "a")) as first,
        raw_peer(port, greeting(TCP, "b")) as second,
    ):
        assert await silent.closed() == b""
        async with raw_peer(port) as late:
            assert await late.closed() == b""
        assert [each.peer for each in port.inputs] == ["a", "b"]
        for peer in (first, second):
            await peer.say(message(encode([1])), ACK)
    assert "turned away 1 connections so far: max_connections is 2" in caplog.text


async def test_a_peer_that_dies_in_the_middle_of_a_message(names: NameClient) -> None:
    inbox = Inbox()
    async with await Port.open("/in", names, on_data=inbox) as port:
        whole = message(bytes(500_000))
        for length in (5, 30, 60_000, len(whole) - 1):
            async with raw_peer(port, greeting(TCP, "anon")) as dying:
                dying.writer.write(whole[:length])
                await eventually(lambda: dying.writer.transport.get_write_buffer_size() == 0)
        async with raw_peer(port, greeting(TCP, "anon")) as healthy:
            await healthy.say(whole, ACK)
        assert [len(each.payload) for each in inbox.got] == [500_000]


async def test_a_second_connection_under_a_rooted_name_closes_the_first(names: NameClient) -> None:
    async with (
        await Port.open("/rpc", names, on_call=echo) as port,
        raw_peer(port, greeting(TCP, "/same")) as first,
        raw_peer(port, greeting(TCP, "/same")) as second,
        raw_peer(port, greeting(TCP, "anon")),
        raw_peer(port, greeting(TCP, "anon")),
    ):
        assert await first.closed() == b""
        await second.say(message(encode([1]), "d"), encode([1]) + ACK)
        assert [each.peer for each in port.inputs] == ["/same", "anon", "anon"]


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_a_reader_that_talks_out_of_turn_is_dropped(
    names: NameClient, caplog: pytest.LogCaptureFixture, carrier: str
) -> None:
    async def babble(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        is_text = (await reader.readexactly(8)).startswith(b"CONN")
        writer.write(b"Welcome /out\r\nbla bla\r\n" if is_text else yarp_number(1) + b"bla bla!")
        await reader.read()
        writer.close()

    async with await Port.open("/out", names) as writer:
        async with await asyncio.start_server(babble, "127.0.0.1", 0) as fake:
            tcp_port = fake.sockets[0].getsockname()[1]
            await names.register("/fake", host="127.0.0.1", tcp_port=tcp_port)
            link = await writer.connect("/fake", carrier)
            await asyncio.wait_for(link.wait_closed(), TIMEOUT_S)
        assert writer.outputs == []
    assert "closed the YARP connection from 127.0.0.1" in caplog.text
