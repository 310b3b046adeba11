"""The name server and its clients over real sockets."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest

from vertebra.cli.checks import check_yarp_address
from vertebra.errors import ConfigError, DeadlineError, NameMappingError, NotConnectedError
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import (
    Contact,
    Incoming,
    NameClient,
    NameServer,
    Port,
    RpcClient,
    encode,
    find_name_server,
)
from vertebra.yarp.naming.addresses import is_loopback, own_addresses
from vertebra.yarp.naming.discovery import Responder, discover
from vertebra.yarp.naming.reachability import Reachability, check_reachability
from vertebra.yarp.protocol.wire import ACK, TCP, greeting, yarp_number

TIMEOUT_S = 5.0


async def exchange(server: NameServer, sent: bytes, expected: bytes) -> bytes:
    """Send, and return as many bytes as are expected."""
    reader, writer = await asyncio.open_connection(server.contact.host, server.contact.tcp_port)
    try:
        writer.write(sent)
        async with asyncio.timeout(TIMEOUT_S):
            return await reader.readexactly(len(expected))
    finally:
        writer.close()
        await writer.wait_closed()


@asynccontextmanager
async def listener(
    answer: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> AsyncIterator[NameClient]:
    """Stand in for a name server that is none."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await answer(reader, writer)
        writer.close()
        await writer.wait_closed()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as running:
        tcp_port = running.sockets[0].getsockname()[1]
        yield NameClient("127.0.0.1", tcp_port, timeout_s=0.2)


async def test_a_port_is_registered_found_and_forgotten(names: NameClient) -> None:
    granted = await names.register("/a", host="10.0.0.7", tcp_port=1234)
    assert granted == Contact("/a", "tcp", "10.0.0.7", 1234)
    assert await names.query("/a") == granted
    await names.announce("/a")
    await names.unregister("/a")
    assert await names.query("/a") is None
    await names.unregister("/a")


async def test_the_server_chooses_what_is_left_to_it(names: NameClient, server: NameServer) -> None:
    first = await names.register("...")
    second = await names.register("...", carrier="mcast")
    assert (first.name, first.host) == ("/tmp/port/1", "127.0.0.1")
    assert first.tcp_port in (server.contact.tcp_port + 2, 10002)
    assert (second.carrier, second.host) == ("mcast", "224.1.1.3")


async def test_a_name_is_taken_over_by_who_comes_later(names: NameClient) -> None:
    await names.register("/a", host="10.0.0.7", tcp_port=1)
    later = await names.register("/a", host="10.0.0.8", tcp_port=2)
    assert await names.query("/a") == later


async def test_ports_are_listed_by_prefix(names: NameClient, server: NameServer) -> None:
    for name in ("/py/b", "/py/a", "/pyx"):
        await names.register(name)
    assert [each.name for each in await names.list_ports("/py")] == ["/py/a", "/py/b"]
    assert [each.name for each in await names.list_ports()] == ["/py/a", "/py/b", "/pyx", "/root"]
    assert await names.query("/root") == server.contact


async def test_properties(names: NameClient) -> None:
    await names.register("/a")
    await names.set_property("/a", "accepts", "tcp", "fast_tcp", "two words")
    assert await names.get_property("/a", "accepts") == ["fast_tcp", "tcp", "two", "words"]
    assert await names.get_property("/a", "none") == []
    assert await names.get_property("/nope", "accepts") == []


@pytest.mark.parametrize("name", ["a", "/a b", "/a\r\nunregister /root"])
async def test_names_that_would_break_the_protocol(names: NameClient, name: str) -> None:
    with pytest.raises(NameMappingError):
        await names.register(name)
    assert await names.query(name) is None
    assert await names.query("/root") is not None


async def test_a_port_exists_when_it_answers(names: NameClient) -> None:
    assert not await names.exists("/a")
    async with await Port.open("/a", names):
        assert await names.exists("/a")
    dead = await names.register("/dead", host="127.0.0.1", tcp_port=1)
    assert dead.tcp_port == 1
    assert not await names.exists("/dead")


async def test_every_carrier_reaches_the_server(server: NameServer) -> None:
    line = (
        f"registration name /root ip 127.0.0.1 port {server.contact.tcp_port} type tcp\r\n"
        "*** end of message\r\n"
    ).encode()
    for sent, expected in (
        (b"NAME_SERVER query /root\n", line),
        (b"NAME_SERVER query /root\r\nNAME_SERVER query /root\r\n", line + line),
        (b"CONNECT foo\r\nd\nquery /root\n", b"Welcome foo\r\n" + line),
        (b"CONNACK foo\r\nd\nquery /root\n", b"Welcome foo\r\n" + line + b"<ACK>\r\n"),
        (
            greeting(TCP, "/me/x")
            + bytes.fromhex(
                "59410a00000052500201ffffffffffffffff080000001a00000000000000"
                "000000007e640001040100000200000005000000717565727905000000"
            )
            + b"/root",
            yarp_number(server.contact.tcp_port) + line + ACK,
        ),
    ):
        assert await exchange(server, sent, expected) == expected


async def test_bot_replies_are_bottles(names: NameClient, server: NameServer) -> None:
    async with await RpcClient.connect("/root", names) as client:
        reply = await client.call(["bot", "query", "/root"], timeout_s=TIMEOUT_S)
    assert reply == [
        "port",
        ["name", "/root"],
        ["ip", "127.0.0.1"],
        ["port_number", server.contact.tcp_port],
        ["carrier", "tcp"],
    ]


async def test_many_clients_at_once(names: NameClient) -> None:
    granted = await asyncio.gather(*(names.register(f"/p/{n}") for n in range(150)))
    assert len({each.tcp_port for each in granted}) == 150
    assert len(await names.list_ports("/p")) == 150


async def test_rubbish_leaves_the_server_alone(names: NameClient, server: NameServer) -> None:
    assert (await exchange(server, b"HELLO WORLD\n", b"* Error.")) == b"* Error."
    assert (await exchange(server, b"NAME_SERVER \xff\xfe((((\n", b"")) == b""
    assert (await exchange(server, b"NAME_SERVER frobnicate\n", b"***")) == b"***"
    assert await names.query("/root") == server.contact


# --- when there is no name server ---


async def test_nobody_listens(server: NameServer) -> None:
    names = server.client()
    await server.close()
    address = f"{names.host}:{names.tcp_port}"
    with pytest.raises(NotConnectedError, match=rf"{address}.*start `yarpserver`"):
        await names.query("/a")
    with pytest.raises(NotConnectedError, match=address):
        await Port.open("/a", names)


async def test_a_silent_server() -> None:
    over = asyncio.Event()

    async def keep_silent(_: asyncio.StreamReader, __: asyncio.StreamWriter) -> None:
        await over.wait()

    async with listener(keep_silent) as names:
        with pytest.raises(DeadlineError, match=f"{names.host}:{names.tcp_port} within 0.2 s"):
            await names.query("/a")
        over.set()


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "no YARP port"),
        (b"Welcome admin\r\nregistration ", "before its answer was complete"),
        (b"Welcome admin\r\nregistration of what?\r\n<ACK>\r\n", "instead of a registration"),
        (b"Welcome admin\r\n" + b"x" * 70_000, "line without end"),
        (b"", "before its answer was complete"),
    ],
)
async def test_a_server_that_is_none(answer: bytes, complaint: str) -> None:
    async def say(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)

    async with listener(say) as names:
        with pytest.raises(NotConnectedError, match=complaint):
            await names.query("/a")


async def test_an_address_in_use(server: NameServer) -> None:
    with pytest.raises(ConfigError, match=f"{server.contact.tcp_port}.*choose another"):
        await NameServer.start(tcp_port=server.contact.tcp_port)


# --- persistent connections ---


async def test_the_server_connects_ports_whenever_both_are_there(names: NameClient) -> None:
    arrived: asyncio.Queue[Incoming] = asyncio.Queue()

    async def open_reader() -> Port:
        return await Port.open("/b", names, on_data=arrived.put_nowait)

    async with (
        await RpcClient.connect("/root", names) as server,
        await Port.open("/a", names) as writer,
    ):
        await server.call(["subscribe", "/a", "fast_tcp://b"], timeout_s=TIMEOUT_S)
        assert writer.outputs == []
        reader = await open_reader()
        await eventually(lambda: [link.carrier for link in writer.outputs] == ["fast_tcp"])
        # As after a power cut: no farewell, and no word to the name server.
        reader._board.names = NameClient("127.0.0.1", 1)
        await reader.close()
        reader = await open_reader()
        await eventually(lambda: len(writer.outputs) == 1)
        writer.write(encode(["again"]))
        assert (await asyncio.wait_for(arrived.get(), TIMEOUT_S)).bottle() == ["again"]
        await reader.close()


async def test_a_connection_to_a_port_that_died_unnoticed_is_replaced(names: NameClient) -> None:
    async with (
        await RpcClient.connect("/root", names) as server,
        await Port.open("/a", names) as writer,
        await Port.open("/b", names),
    ):
        await server.call(["subscribe", "/a", "/b"], timeout_s=TIMEOUT_S)
        await eventually(lambda: len(writer.outputs) == 1)
        stale = writer.outputs[0]
        await names.announce("/b")
        await eventually(lambda: stale.closed and len(writer.outputs) == 1)


async def test_a_port_that_cannot_be_reached_keeps_nobody_waiting(
    names: NameClient, server: NameServer
) -> None:
    for name in ("/a", "/b"):
        await names.register(name, host="127.0.0.1", tcp_port=1)
        await names.announce(name)
    async with await RpcClient.connect("/root", names) as client:
        await client.call(["subscribe", "/a", "/b"], timeout_s=TIMEOUT_S)
        assert await client.call(["bot", "query", "/a"], timeout_s=TIMEOUT_S)
    assert [*server._matchmaker._tasks] == [("/a", "/b")]  # and closing the server ends it


# --- its page ---

LINK = '<a href="http://127.0.0.1:10002">/py/a</A>                          (tcp://py/a)'  # 3.12.3


async def browse(server: NameServer, target: str) -> str:
    place = server.contact.host, server.contact.tcp_port
    reader, writer = await asyncio.open_connection(*place)
    try:
        writer.write(f"GET {target} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        async with asyncio.timeout(TIMEOUT_S):
            return (await reader.read()).decode()
    finally:
        writer.close()
        await writer.wait_closed()


async def test_the_page_of_a_name_server_shows_the_ports_escaped(
    server: NameServer, names: NameClient
) -> None:
    await names.register("/py/a", host="127.0.0.1", tcp_port=10002)
    await names.register("/<b>", host="127.0.0.1", tcp_port=10003)
    to_ports = f'<a href="http://127.0.0.1:{server.contact.tcp_port}/data=list">All ports'
    assert to_ports in await browse(server, "/")
    page = await browse(server, "/data=list")
    assert LINK in page.splitlines()
    assert "/&lt;b&gt;</A>" in page
    assert "<b>" not in page


@pytest.mark.parametrize("change", ["register+/evil", "unregister+/py/a", "bot+set+/py/a+k+1"])
async def test_over_http_a_name_server_changes_nothing(
    server: NameServer, names: NameClient, change: str
) -> None:
    await names.register("/py/a", host="127.0.0.1", tcp_port=10002)
    for target in (f"/?req={change}", f"/data={change}"):
        assert "changes nothing" in await browse(server, target)
    assert {contact.name for contact in await names.list_ports()} == {"/root", "/py/a"}
    async with await RpcClient.connect("/root", names) as client:
        assert await client.call(["bot", "get", "/py/a", "k"], timeout_s=TIMEOUT_S) == []


# --- discovery ---

LOOPBACK = ["127.0.0.1"]


@pytest.fixture
def udp_port() -> int:
    return free_tcp_port()  # the same range; another program there would not disturb


async def test_a_name_server_is_found_by_multicast(udp_port: int) -> None:
    async with await NameServer.start(tcp_port=0, discovery_udp_port=udp_port) as server:
        found = await discover("/root", udp_port, interfaces=LOOPBACK, timeout_s=TIMEOUT_S)
        assert found == server.contact
        fallback = await server.client().query("fallback")
        assert fallback == Contact("fallback", "mcast", "224.2.1.1", udp_port)
        assert await discover("/other", udp_port, interfaces=LOOPBACK, timeout_s=0.1) is None


async def test_discovery_speaks_as_yarp_does(udp_port: int) -> None:
    # The datagrams of the capture mcast_discovery.
    question = bytes.fromhex("2d7c9fe0000000004e414d455f534552564552207175657279202f726f6f740a")
    answer = bytes.fromhex(
        "5e8ebb3100000000726567697374726174696f6e206e616d65202f726f6f74206970203132372e302e302e31"
        "20706f72742031303030302074797065207463700a"
    )
    heard: asyncio.Queue[bytes] = asyncio.Queue()

    class Ear(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: object) -> None:
            heard.put_nowait(data)

    with multicast_socket(udp_port) as sock:
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Ear, sock=sock)
        line = "registration name /root ip 127.0.0.1 port 10000 type tcp"
        responder = Responder("/root", line, LOOPBACK)
        assert await responder.start(udp_port)
        for rubbish in (b"", b"12345678", question[:-1], b"\0" + question[1:], b"x" * 9000):
            transport.sendto(rubbish, ("224.2.1.1", udp_port))
        transport.sendto(question, ("224.2.1.1", udp_port))
        received = []
        async with asyncio.timeout(TIMEOUT_S):
            while answer not in received:
                received.append(await heard.get())
        assert received.count(answer) == 1
        task = asyncio.create_task(
            discover("/root", udp_port, interfaces=LOOPBACK, timeout_s=TIMEOUT_S)
        )
        async with asyncio.timeout(TIMEOUT_S):
            while await heard.get() != question:
                pass
        assert await task == Contact("/root", "tcp", "127.0.0.1", 10000)
        responder.close()
        transport.close()


@contextmanager
def multicast_socket(udp_port: int) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(("224.2.1.1", udp_port))
        here = socket.inet_aton("127.0.0.1")
        member = socket.inet_aton("224.2.1.1") + here
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, here)
        yield sock


async def test_a_machine_without_multicast_is_told_once(
    udp_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    responder = Responder("/root", "", ["192.0.2.1"])
    assert not await responder.start(udp_port)
    responder.close()
    assert caplog.text.count("nobody finds this name server by multicast") == 1
    assert await discover("/root", udp_port, interfaces=["192.0.2.1"]) is None


async def test_the_name_server_is_found_as_yarp_finds_it(tmp_path: Path) -> None:
    env = {"YARP_CONFIG_HOME": str(tmp_path)}
    async with (
        await NameServer.start(tcp_port=0) as first,
        await NameServer.start(tcp_port=0, namespace="/lab") as second,
    ):
        here = {**env, "YARP_PORT_RANGE": str(first.contact.tcp_port)}
        found = await find_name_server(here)
        assert found.tcp_port == first.contact.tcp_port
        (tmp_path / "yarp.conf").write_text(f"127.0.0.1 {first.contact.tcp_port} yarp\n")
        (tmp_path / "_lab.conf").write_text(f"127.0.0.1 {second.contact.tcp_port} yarp\n")
        both = await find_name_server({**env, "YARP_NAMESPACE": "/root /lab"})
        await second.client().register("/only/there")
        assert await both.query("/only/there") is not None
        await both.register("/new")
        assert await first.client().query("/new") is not None
        assert await second.client().query("/new") is None
        assert await second.client().query("/lab") == second.contact


async def test_without_any_name_server_it_is_the_usual_place(tmp_path: Path, udp_port: int) -> None:
    env = {"YARP_CONFIG_HOME": str(tmp_path), "YARP_PORT_RANGE": str(udp_port)}
    found = await find_name_server(env, timeout_s=0.1)
    assert (found.host, found.tcp_port) == ("127.0.0.1", udp_port)


# --- opening a port ---


async def test_a_port_tells_the_server_what_yarps_own_library_tells(names: NameClient) -> None:
    async with await Port.open("/a", names):
        offers = await names.get_property("/a", "offers")
        assert {"tcp", "fast_tcp", "text_ack"} <= {*offers}
        assert await names.get_property("/a", "accepts") == offers
        assert "127.0.0.1" in await names.get_property("/a", "ips")
        assert await names.get_property("/a", "process") == [str(os.getpid())]


async def test_users_rename_and_move_ports_by_the_environment(names: NameClient) -> None:
    tcp_port = free_tcp_port()
    env = {
        "YARP_RENAME_a": "/b",
        "YARP_PORTNUMBER_a": str(tcp_port),
        "YARP_PORT_PREFIX": "/lab",
        "YARP_IP": "127.",
    }
    async with await Port.open("/a", names, bind_host="0.0.0.0", env=env) as port:
        assert port.contact == Contact("/lab/b", "tcp", "127.0.0.1", tcp_port)
        assert await names.query("/lab/b") == port.contact


# --- where others reach us ---


async def test_the_name_server_reaches_us_where_it_tells_others(names: NameClient) -> None:
    found = await check_reachability(names, bind_host="0.0.0.0", advertise_host=None)
    assert found == Reachability("127.0.0.1", "127.0.0.1", reached=True)
    assert await names.subscriptions() == []
    assert [each.name for each in await names.list_ports()] == ["/root"]


async def test_an_address_where_nobody_reaches_us_is_noticed(names: NameClient) -> None:
    finding = await check_yarp_address(
        names, bind_host="127.0.0.1", advertise_host="192.0.2.1", timeout_s=0.3
    )
    assert finding.level == "wrong"
    assert "others are told 192.0.2.1, where the name server cannot reach us" in finding.text
    assert "it sees us at 127.0.0.1" in finding.text
    assert "VERTEBRA_YARP_ADVERTISE_HOST" in finding.remedy
    assert [each.name for each in await names.list_ports()] == ["/root"]


async def test_telling_other_machines_our_loopback_is_noticed() -> None:
    own = next((each for each in own_addresses() if not is_loopback(each)), None)
    if own is None:
        pytest.skip("this machine has loopback only; connect it to a network")
    async with await NameServer.start(tcp_port=0, bind_host=own) as server:
        names = server.client()
        finding = await check_yarp_address(names, bind_host="127.0.0.1", advertise_host="")
        assert (finding.level, "which is themselves" in finding.text) == ("wrong", True)
        finding = await check_yarp_address(names, bind_host="0.0.0.0", advertise_host="")
        assert finding.text == f"others are told {own}; the name server reaches us"
