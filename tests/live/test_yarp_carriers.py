"""YARP ports against each other and against captured bytes over the carriers beside tcp."""

from __future__ import annotations

import asyncio
import json
import os
import socket

import pytest

from vertebra.errors import CommandRefusedError
from vertebra.testing.bus_suite import eventually
from vertebra.yarp import (
    Incoming,
    NameClient,
    PeerLimits,
    Port,
    Reader,
    RpcClient,
    Value,
    Vocab,
    encode,
)
from vertebra.yarp.objects import Image
from vertebra.yarp.ports.datagrams import DatagramWriter, GroupMember
from vertebra.yarp.protocol.mjpeg import STREAM_HEAD, comment_of
from vertebra.yarp.protocol.packets import cut
from vertebra.yarp.protocol.wire import (
    MCAST,
    UDP,
    binary_message,
    command,
    greeting,
    group_bytes,
    parse_number,
    reverse_message,
    yarp_number,
)
from vertebra_pillow.yarp import YarpJpeg

from .yarp_inbox import Inbox

TIMEOUT_S = 5.0
DATAGRAMS = ("udp", "mcast")


def message(payload: bytes, envelope: str = "") -> list[bytes]:
    return [*cut(binary_message(command("D", envelope), (payload,)))]


# --- datagrams ---


@pytest.mark.parametrize("carrier", DATAGRAMS)
async def test_messages_pass_as_datagrams(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        link = await writer.connect("/in", carrier)
        await eventually(lambda: bool(reader.inputs))
        writer.write(encode([1, "a b"]), envelope="41 1234.5")
        writer.write(encode([]))
        first, second = await inbox.wait(2)
        assert (first.bottle(), first.envelope) == ([1, "a b"], "41 1234.5")
        assert (first.sender, first.carrier, second.bottle()) == ("/out", carrier, [])
        assert link.counters.messages == writer.sent.messages == reader.received.messages == 2
        assert await writer.disconnect("/in")
        await eventually(lambda: not reader.inputs)


@pytest.mark.parametrize("carrier", DATAGRAMS)
async def test_an_image_passes_whole_as_fifteen_datagrams(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    pixels = bytes(range(256)) * 3600
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        await writer.connect("/in", carrier)
        await eventually(lambda: bool(reader.inputs))
        for _ in range(5):
            writer.write(pixels)
        got = await inbox.wait(5)
        assert all(bytes(incoming.payload) == pixels for incoming in got)
        assert reader.received.lost == 0


# --- losses, and who is gone ---


async def udp_writer(port: Port, name: str = "/robot") -> tuple[socket.socket, tuple[str, int]]:
    """Greet as a real writer does; return its socket and where it has to send to."""
    reader, writer = await asyncio.open_connection(port.contact.host, port.contact.tcp_port)
    writer.write(greeting(UDP, name))
    async with asyncio.timeout(TIMEOUT_S):
        answer = await reader.readexactly(8)
        assert await reader.read() == b""  # the port has closed the TCP connection
    host, tcp_port = writer.get_extra_info("sockname")
    writer.close()
    await writer.wait_closed()
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind((host, tcp_port))
    return sock, (port.contact.host, parse_number(answer) or 0)


async def test_the_udp_port_of_a_writer_is_its_former_tcp_port(names: NameClient) -> None:
    heard: asyncio.Queue[tuple[str, int]] = asyncio.Queue()

    class Ear(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
            heard.put_nowait(addr)

    loop = asyncio.get_running_loop()
    ear, _ = await loop.create_datagram_endpoint(Ear, ("127.0.0.1", 0))
    greeted: asyncio.Queue[tuple[str, int]] = asyncio.Queue()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if await reader.readexactly(8) == UDP.header:
            greeted.put_nowait(writer.get_extra_info("peername"))
            writer.write(yarp_number(ear.get_extra_info("sockname")[1]))
        writer.close()

    robot = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        await names.register("/robot", host="127.0.0.1", tcp_port=robot.sockets[0].getsockname()[1])
        async with await Port.open("/out", names) as writer:
            await writer.connect("/robot", "udp")
            writer.write(encode([1]))
            async with asyncio.timeout(TIMEOUT_S):
                assert await heard.get() == await greeted.get()
    finally:
        ear.close()
        robot.close()
        await robot.wait_closed()


async def test_lost_datagrams_are_counted_and_no_part_is_delivered(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    inbox = Inbox()
    async with await Port.open("/in", names, on_data=inbox) as port:
        sock, place = await udp_writer(port)
        with sock:
            large, small = message(bytes(100_000)), message(encode([1]))
            wrong = bytes([large[0][0] ^ 1]) + large[0][1:]
            for datagram in (large[0], *small, large[1], wrong, large[1], b"abc", *small):
                sock.sendto(datagram, place)
            got = await inbox.wait(2)
        assert [incoming.bottle() for incoming in got] == [[1], [1]]
        # The first was cut short by the next and went on after it; the third was damaged.
        assert port.received.lost == 4
        assert "it ended after 1 datagrams" in caplog.text


async def test_a_datagram_announcing_too_much_costs_nothing(names: NameClient) -> None:
    inbox = Inbox()
    limits = PeerLimits(max_message_bytes=1000)
    async with await Port.open("/in", names, on_data=inbox, limits=limits) as port:
        sock, place = await udp_writer(port)
        with sock:
            for datagram in (*message(bytes(100_000)), *message(encode([1]))):
                sock.sendto(datagram, place)
            (incoming,) = await inbox.wait(1)
        assert incoming.bottle() == [1]
        assert port.received.lost == 1


async def test_what_wants_an_answer_is_refused_over_udp(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as port,
        await Port.open("/other", names),
    ):
        sock, place = await udp_writer(port)
        with sock:
            add = encode([Vocab("add"), "/other"])
            sock.sendto(next(cut(binary_message(command("a"), (add,)))), place)
            sock.sendto(next(cut([reverse_message()])), place)
            sock.sendto(next(cut(binary_message(command("d"), (encode([2]),)))), place)
            (incoming,) = await inbox.wait(1)
        assert (incoming.bottle(), incoming.reply_wanted) == ([2], False)
        assert port.received.refused == 2
        assert port.outputs == []


@pytest.mark.parametrize("carrier", DATAGRAMS)
async def test_a_dead_writer_by_datagrams_is_found_out(names: NameClient, carrier: str) -> None:
    limits = PeerLimits(datagram_silence_s=0.1)
    async with await Port.open("/in", names, on_data=Inbox(), limits=limits) as reader:
        writer = await Port.open("/out", names)
        await writer.connect("/in", carrier)
        link = await reader.wait_input("/out")
        await asyncio.sleep(0.3)
        assert not link.closed  # it was asked, and writes to us still
        channel = writer._board._outputs[0]._connection
        assert isinstance(channel, DatagramWriter | GroupMember)
        channel._farewell = _nothing  # as if killed
        await writer.close()
        async with asyncio.timeout(TIMEOUT_S):
            assert "/out" in await link.wait_closed()


async def _nothing() -> None:
    """Say nothing to the reader."""


async def test_a_dead_reader_by_udp_is_found_out(names: NameClient) -> None:
    async with await Port.open("/out", names) as writer:
        reader = await Port.open("/in", names, on_data=Inbox())
        link = await writer.connect("/in", "udp")
        reader._board._inputs.copy().popitem()[0]._connection.close("as if killed")
        await reader.close()
        async with asyncio.timeout(TIMEOUT_S):
            while not link.closed:
                writer.write(encode([1]))
                await asyncio.sleep(0.01)


async def test_one_transmission_serves_all_readers_by_mcast(names: NameClient) -> None:
    inboxes = [Inbox(), Inbox()]
    async with (
        await Port.open("/in/0", names, on_data=inboxes[0]) as first,
        await Port.open("/in/1", names, on_data=inboxes[1]) as second,
        await Port.open("/out", names, delivery="queue") as writer,
    ):
        for reader in (first, second):
            await writer.connect(reader.name, "mcast")
            await reader.wait_input("/out")
        group = next(each for each in await names.list_ports() if each.carrier == "mcast")
        assert await names.get_property("/out", "owns") == [group.name]
        writer.write(encode([1]))
        for inbox in inboxes:
            await inbox.wait(1)
        await writer.disconnect("/in/0")  # the one that was elected
        writer.write(encode([2]))
        await inboxes[1].wait(2)
        assert [incoming.bottle() for incoming in inboxes[1].got] == [[1], [2]]
        assert len(inboxes[0].got) == 1
        await writer.disconnect("/in/1")
        await eventually(lambda: not second.inputs)
    assert [each.name for each in await names.list_ports() if each.carrier == "mcast"] == []


async def test_nobody_makes_us_join_what_is_no_group(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    async with await Port.open("/in", names, on_data=Inbox()) as port:
        reader, writer = await asyncio.open_connection(port.contact.host, port.contact.tcp_port)
        writer.write(greeting(MCAST, "/robot") + group_bytes(("10.0.0.1", 10003)))
        assert await reader.read() == b""
        writer.close()
        await eventually(lambda: "10.0.0.1:10003 is no multicast group" in caplog.text)


async def test_a_connection_by_udp_is_replaced_without_losing_the_new_one(
    names: NameClient,
) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/in", names, on_data=inbox) as reader,
        await Port.open("/out", names) as writer,
    ):
        for carrier in ("udp", "udp", "tcp", "udp"):
            await writer.connect("/in", carrier)
        assert [link.carrier for link in reader.inputs] == ["udp"]
        writer.write(encode([1]))
        await inbox.wait(1)


# --- images as JPEGs ---


def picture(width: int = 6, height: int = 4) -> Image:
    return Image.from_packed("rgb", width, height, bytes([200, 10, 10]) * (width * height))


async def test_a_browser_watches_an_image_port(names: NameClient) -> None:
    async with await Port.open("/cam", names, jpeg=YarpJpeg()) as camera:
        reader, writer = await asyncio.open_connection(*place_of(camera))
        writer.write(b"GET /?action=stream HTTP/1.1\r\nHost: x\r\n\r\n")
        head = await reader.readuntil(b"--boundarydonotcross\r\n")
        assert head == STREAM_HEAD
        camera.write(picture(), envelope="41 1234.5")
        part = (await reader.readuntil(b"\r\n\r\n")).decode()
        assert part.startswith("Content-Type: image/jpeg\r\nContent-Length: ")
        jpeg = await reader.readexactly(int(part.split()[-1]))
        assert comment_of(jpeg) == "41 1234.5"
        assert Image.decode(YarpJpeg().decode(jpeg)).width == 6
        assert [link.carrier for link in camera.outputs] == ["mjpeg"]
        camera.write(encode(["no image"]))
        await eventually(lambda: camera.sent.refused == 1)
        writer.close()
        await eventually(lambda: not camera.outputs)


async def test_a_port_without_a_codec_says_so(
    names: NameClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vertebra.yarp.ports.switchboard.installed_jpeg", lambda: None)
    async with await Port.open("/cam", names) as camera:
        reader, writer = await asyncio.open_connection(*place_of(camera))
        writer.write(b"GET /?action=stream HTTP/1.1\r\nHost: x\r\n\r\n")
        assert b"503" in await reader.read()
        writer.close()


async def test_a_port_pulls_images_when_it_is_told_to_add_mjpeg(names: NameClient) -> None:
    inbox = Inbox()
    async with (
        await Port.open("/cam", names, jpeg=YarpJpeg()) as camera,
        await Port.open("/view", names, on_data=inbox, jpeg=YarpJpeg(), sends=False) as viewer,
        await RpcClient.connect("/view", names) as tool,
    ):
        reply = await tool.administer([Vocab("add"), "mjpeg://cam"], timeout_s=TIMEOUT_S)
        assert reply == [0, "Added connection from /view to mjpeg://cam\r\n"]
        reply = await tool.administer([Vocab("list"), Vocab("in"), "/cam"], timeout_s=TIMEOUT_S)
        assert reply == [["from", "/cam"], ["to", "/view"], ["carrier", "mjpeg"], ["push", 0]]
        await eventually(lambda: bool(camera.outputs))
        camera.write(picture(), envelope="41 1234.5")
        (incoming,) = await inbox.wait(1)
        image = Image.decode(incoming.payload)
        assert (image.width, image.height, image.pixel_code) == (6, 4, "rgb")
        assert (incoming.envelope, incoming.carrier, incoming.sender) == (
            "41 1234.5", "mjpeg", "/cam",
        )  # fmt: skip
        reply = await tool.administer([Vocab("del"), "/cam"], timeout_s=TIMEOUT_S)
        assert reply == [0, "Removing connection from /cam to /view\r\n"]
        await eventually(lambda: not camera.outputs)
        assert viewer.received.messages == 1


# --- readers ---


@pytest.mark.parametrize("carrier", ["fast_tcp", "tcp", "udp", "mcast"])
async def test_a_reader_subscribes_over_every_carrier(names: NameClient, carrier: str) -> None:
    inbox = Inbox()
    async with await Port.open("/out", names) as source:
        reader = await Reader.dial("/out", names, on_data=inbox, reader_name="/me", carrier=carrier)
        await eventually(lambda: bool(source.outputs))
        source.write(encode([1]), envelope="1 2.5")
        (incoming,) = await inbox.wait(1)
        assert (incoming.bottle(), incoming.envelope, incoming.sender) == ([1], "1 2.5", "/out")
        assert (reader.peer, reader.carrier, reader.counters.messages) == ("/out", carrier, 1)
        await reader.close()
        await eventually(lambda: not source.outputs)
        assert await names.query("/me") is None
        again = await Reader.dial("/out", names, on_data=inbox, reader_name="/me", carrier=carrier)
    assert "by the peer" in await again.wait_closed() or carrier in DATAGRAMS


async def test_a_reader_by_mjpeg_gets_the_jpegs_themselves(names: NameClient) -> None:
    inbox = Inbox()
    async with await Port.open("/cam", names, jpeg=YarpJpeg()) as camera:
        reader = await Reader.dial("/cam", names, on_data=inbox, reader_name="/me", carrier="mjpeg")
        await eventually(lambda: bool(camera.outputs))
        camera.write(picture(640, 480), envelope="7 8.5")
        (incoming,) = await inbox.wait(1)
        assert bytes(incoming.payload[:2]) == b"\xff\xd8"
        assert incoming.envelope == "7 8.5"
        await reader.close()


async def test_a_reader_takes_over_from_one_that_was_killed(names: NameClient) -> None:
    inbox = Inbox()
    async with await Port.open("/out", names) as source:
        first = await Port.open("/me", names, on_data=inbox)
        await source.connect("/me", "udp")
        await names.unregister("/me")  # as if killed: nobody has told the source
        reader = await Reader.dial("/out", names, on_data=inbox, reader_name="/me", carrier="udp")
        source.write(encode([1]))
        await inbox.wait(1)
        assert reader.counters.messages == 1
        await reader.close()
        await first.close()


# --- http ---


def place_of(port: Port) -> tuple[str, int]:
    return port.contact.host, port.contact.tcp_port


async def ask(port: Port, request: bytes) -> bytes:
    reader, writer = await asyncio.open_connection(*place_of(port))
    try:
        writer.write(request)
        async with asyncio.timeout(TIMEOUT_S):
            return await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()


async def echo(incoming: Incoming) -> list[Value]:
    return ["echo", *incoming.bottle()]


async def test_scripts_call_the_owner_over_http(names: NameClient) -> None:
    async with await Port.open("/srv", names, on_call=echo) as port:
        reply = await ask(port, b"GET /?req=get%20axes+(a%201)%20[v] HTTP/1.0\r\n\r\n")
        head, _, body = reply.partition(b"\n\n")
        assert b"application/json" in head
        assert json.loads(body) == ["echo", "get", "axes", ["a", 1], "v"]
        form = b"POST /form HTTP/1.0\r\nContent-Length: 12\r\n\r\ndata=%3Cb%3E"
        assert b"&lt;b&gt;" in await ask(port, form)


async def test_a_port_whose_owner_does_not_reply_ends_the_response(names: NameClient) -> None:
    """The real one sends the same three lines until the client goes (refs 4.2)."""
    inbox = Inbox()
    async with await Port.open("/in", names, on_data=inbox) as port:
        reply = await ask(port, b"GET /?req=hello%20there HTTP/1.0\r\n\r\n")
        assert reply.endswith(b"\n\n[]\n\n")
        assert inbox.got[0].bottle() == ["hello", "there"]


@pytest.mark.parametrize(
    ("request_line", "headers", "status"),
    [
        ("GET /?req=stop", "Host: x\r\nOrigin: http://evil.example", b"403"),
        ("GET /?req=stop", "Sec-Fetch-Site: cross-site", b"403"),
        ("GET /nowhere", "Host: x", b"404"),
    ],
)
async def test_requests_of_other_sites_reach_no_owner(
    names: NameClient, request_line: str, headers: str, status: bytes
) -> None:
    inbox = Inbox()
    async with await Port.open("/in", names, on_data=inbox) as port:
        request = f"{request_line} HTTP/1.1\r\n{headers}\r\n\r\n".encode()
        assert status in (await ask(port, request)).splitlines()[0]
        assert inbox.got == []


async def test_over_http_a_port_tells_but_changes_nothing(names: NameClient) -> None:
    async with await Port.open("/a", names) as port, await Port.open("/b", names):
        reply = await ask(port, b"GET /?admin=1&req=%5Blist%5D%20%5Bin%5D HTTP/1.0\r\n\r\n")
        assert reply.endswith(b'\n\n["web"]\n\n')
        reply = await ask(port, b"GET /?admin=1&req=%5Badd%5D%20/b HTTP/1.0\r\n\r\n")
        assert b"changes nothing" in reply
        reply = await ask(
            port, b"GET /?admin=1&req=%5Bprop%5D%20%5Bset%5D%20x%201 HTTP/1.0\r\n\r\n"
        )
        assert b"changes nothing" in reply
        assert port.outputs == []


async def test_an_endless_http_head_is_refused(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    async with await Port.open("/a", names) as port:
        assert await ask(port, b"GET / HTTP/1.0\r\n" + b"a: b\r\n" * 200) == b""
        assert "an HTTP head has" in caplog.text


# --- behaviour ---


async def test_an_input_port_allows_no_outputs(names: NameClient) -> None:
    async with (
        await Port.open("/in", names, on_data=Inbox(), sends=False) as port,
        await Port.open("/other", names),
        await RpcClient.connect("/in", names) as tool,
    ):
        reply = await tool.administer([Vocab("add"), "/other"], timeout_s=TIMEOUT_S)
        assert reply == [-1, "Outputs not allowed\r\n"]
        with pytest.raises(CommandRefusedError, match="Outputs not allowed"):
            await port.connect("/other")


async def test_a_port_tells_the_name_server_what_it_speaks(names: NameClient) -> None:
    async with await Port.open("/a", names):
        offers = await names.get_property("/a", "offers")
        assert {"tcp", "fast_tcp", "udp", "mcast", "text", "text_ack", "http", "mjpeg"} <= {*offers}
        assert await names.get_property("/a", "accepts") == offers
        assert await names.get_property("/a", "process") == [str(os.getpid())]
        assert "127.0.0.1" in await names.get_property("/a", "ips")


async def test_a_reader_that_closes_asks_its_writers_to_stop(
    names: NameClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    async with await Port.open("/out", names) as writer:
        reader = await Port.open("/in", names, on_data=Inbox())
        await writer.connect("/in", "tcp")
        await eventually(lambda: bool(reader.inputs))
        await reader.close()
        await eventually(lambda: not writer.outputs)
        assert "/out no longer writes to /in: closed by us" in caplog.text
