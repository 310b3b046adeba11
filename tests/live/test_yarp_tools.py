"""`vertebra yarp ...` as people use it at a machine without YARP: as processes, by their words.

What real `yarp` printed in the same situations is in the captures that the comments name.
"""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import Incoming, NameClient, NameServer, Port, Reply, Vocab, encode
from vertebra.yarp.ports.connections import connections_of, survey

pytestmark = pytest.mark.live

TIMEOUT_S = 20.0


@dataclass
class Desk:
    """Somebody at a terminal, in a lab with a name server."""

    names: NameClient
    home: Path
    variables: dict[str, str]
    started: list[Process] = field(default_factory=list)

    async def start(self, *words: str, server: bool = True) -> Process:
        address = f"{self.names.host}:{self.names.tcp_port}"
        variables = {key: value for key, value in os.environ.items() if not key.startswith("YARP_")}
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "vertebra.cli", "yarp", *words),
            *(("--name-server", address) if server else ()),
            stdin=PIPE,
            stdout=PIPE,
            stderr=PIPE,
            env={**variables, **self.variables},
        )
        self.started.append(process)
        return process

    async def run(self, *words: str, typed: str = "") -> tuple[int | None, str, str]:
        return await finish(await self.start(*words), typed)


async def finish(process: Process, typed: str = "") -> tuple[int | None, str, str]:
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await process.communicate(typed.encode())
    return process.returncode, out.decode(), err.decode()


async def line_of(stream: asyncio.StreamReader | None) -> str:
    assert stream is not None
    async with asyncio.timeout(TIMEOUT_S):
        return (await stream.readline()).decode()


async def stop(process: Process) -> tuple[int | None, str, str]:
    process.send_signal(signal.SIGINT)
    return await finish(process)


@pytest.fixture
async def desk(tmp_path: Path) -> AsyncIterator[Desk]:
    async with await NameServer.start(tcp_port=0) as server:
        variables = {
            "YARP_CONFIG_HOME": str(tmp_path),
            "YARP_PORT_RANGE": str(free_tcp_port()),  # none of these is found by multicast
        }
        desk = Desk(server.client(), tmp_path, variables)
        yield desk
        for process in desk.started:  # those that a failed test has left
            with suppress(ProcessLookupError):
                process.kill()
            await process.communicate()


async def test_list_shows_registrations(desk: Desk) -> None:
    for name, tcp_port in (("/py/b", 17), ("/py/a", 18), ("/pyx", 19)):
        await desk.names.register(name, host="10.0.0.7", tcp_port=tcp_port)
    assert await desk.run("list", "/py") == (
        0,
        (
            "registration name /py/a ip 10.0.0.7 port 18 type tcp\n"
            "registration name /py/b ip 10.0.0.7 port 17 type tcp\n"
        ),
        "",
    )


async def test_read_prints_bottles_and_ctrl_c_unregisters(desk: Desk) -> None:
    async with await Port.open("/w", desk.names) as writer:
        reader = await desk.start("read", "/r", "/w")
        assert re.fullmatch(
            r"Port /r active at tcp://127.0.0.1:\d+/\n", await line_of(reader.stderr)
        )
        await eventually(lambda: len(writer.outputs) == 1, timeout_s=TIMEOUT_S)
        writer.write(encode(["hello", 1, 2.5, ["a b", Vocab("vo")]]))
        assert await line_of(reader.stdout) == 'hello 1 2.5 ("a b" [vo])\n'
        writer.write(encode([0, "as it was typed"]))
        assert await line_of(reader.stdout) == "as it was typed\n"
        assert await stop(reader) == (0, "", "")
        assert await desk.names.query("/r") is None


async def test_read_with_envelope_ends_after_one_message_when_asked(desk: Desk) -> None:
    # The form of the envelope is that of rob_state_o.
    async with await Port.open("/w", desk.names) as writer:
        reader = await desk.start("read", "...", "/w", "envelope", "once")
        await eventually(lambda: len(writer.outputs) == 1, timeout_s=TIMEOUT_S)
        writer.write(encode([5.5]), envelope="1587 1795354663.77049")
        status, out, _ = await finish(reader)
        assert (status, out) == (0, "1587 1795354663.7705     5.5\n")


async def test_write_sends_every_line(desk: Desk) -> None:
    arrived: list[str] = []
    lines = [f"line {number} (1.5 [ok])" for number in range(3000)]

    def take(incoming: Incoming) -> None:
        arrived.append(str(incoming.bottle()[1]))

    async with await Port.open("/r", desk.names, on_data=take):
        for carrier in ("", "fast_tcp:/"):
            arrived.clear()
            status, out, _ = await desk.run("write", "/w", f"{carrier}/r", typed="\n".join(lines))
            assert (status, out) == (0, "")
            assert arrived == [*map(str, range(3000))]
    assert await desk.names.query("/w") is None


async def test_a_name_in_use_is_left_alone(desk: Desk) -> None:
    async with await Port.open("/r", desk.names) as port:
        for tool in ("read", "write"):
            status, _, err = await desk.run(tool, "/r")
            assert status == 2
            assert "port /r already exists" in err
        assert await desk.names.query("/r") == port.contact


async def test_rpc_prints_responses(desk: Desk) -> None:
    # The words are those of rpc_client.
    async def answer(incoming: Incoming) -> Reply:
        request = incoming.bottle()
        if request == ["help"]:
            return [Vocab("many"), "do this", ["or", 1]]
        return [Vocab("is"), *request]

    async with await Port.open("/srv", desk.names, on_call=answer):
        assert await desk.run("rpc", "/srv", typed="get axes\n\nhelp\n[set] 1.5") == (
            0,
            "Response: [is] get axes\nResponses:\n  do this\n  or 1\nResponse: [is] [set] 1.5\n",
            "",
        )
        assert await desk.run("rpc", "/srv", "--admin", typed="[ver]\n") == (
            0, "Response: [ver] 1 2 3\n", "",
        )  # fmt: skip


async def test_rpc_finds_a_target_again_that_has_restarted(desk: Desk) -> None:
    async def answer(incoming: Incoming) -> Reply:
        return incoming.bottle()

    first = await Port.open("/srv", desk.names, on_call=answer)
    client = await desk.start("rpc", "/srv")
    assert client.stdin is not None
    client.stdin.write(b"one\n")
    assert await line_of(client.stdout) == "Response: one\n"
    await first.close()
    async with await Port.open("/srv", desk.names, on_call=answer):
        client.stdin.write(b"two\n")
        assert await line_of(client.stdout) == "Response: two\n"
        status, _, err = await stop(client)
    assert (status, err) == (0, "Target disappeared, reconnecting...\n")


async def test_connect_and_disconnect_say_what_they_did(desk: Desk) -> None:
    # The words are those of conn_tcp.
    async with await Port.open("/c/a", desk.names) as a, await Port.open("/c/b", desk.names):
        assert await desk.run("connect", "/c/a", "/c/b") == (
            0, "Success: Added connection from /c/a to tcp://c/b\n", "",
        )  # fmt: skip
        status, out, _ = await desk.run("connect", "/c/a", "/c/b", "fast_tcp")
        assert (status, out) == (0, "Success: Added connection from /c/a to fast_tcp://c/b\n")
        assert [link.carrier for link in a.outputs] == ["fast_tcp"]
        assert await desk.run("disconnect", "/c/a", "/c/b") == (
            0, "Success: Removed connection from /c/a to /c/b\n", "",
        )  # fmt: skip
        status, out, err = await desk.run("disconnect", "/c/a", "/c/b")
        assert (status, out) == (1, "")
        assert "/c/a is not connected to /c/b" in err


@pytest.mark.parametrize("ends", [("/nope1", "/nope2"), ("/root", "/nope2")])
async def test_connecting_what_is_not_there_fails(desk: Desk, ends: Sequence[str]) -> None:
    # As in conn_fail, and the remedy as well.
    status, out, err = await desk.run("connect", *ends)
    assert (status, out) == (1, "")
    assert re.search(r"vertebra: YARP port /nope\d is not registered.*start its program", err)


async def test_persistent_connections(desk: Desk) -> None:
    assert await desk.run("connect", "--persist") == (0, "No persistent connections.\n", "")
    assert await desk.run("connect", "--persist", "/c/a", "/c/b", "fast_tcp") == (0, "", "")
    assert await desk.run("connect", "--persist") == (
        0, "Persistent connection /c/a -> fast_tcp://c/b\n", "",
    )  # fmt: skip
    async with await Port.open("/c/b", desk.names), await Port.open("/c/a", desk.names) as a:
        await eventually(lambda: [each.carrier for each in a.outputs] == ["fast_tcp"])
    assert await desk.run("disconnect", "--persist", "/c/a", "/c/b") == (0, "", "")
    assert await desk.names.subscriptions() == []


async def test_ping_lets_a_port_describe_itself(desk: Desk) -> None:
    # The very form of conn_tcp, quotes included.
    async with await Port.open("/c/a", desk.names) as a, await Port.open("/c/b", desk.names) as b:
        await a.connect("/c/b", "tcp")
        await eventually(lambda: len(b.inputs) == 1)
        assert await desk.run("ping", "/c/b") == (
            0,
            (
                f'This is "/c/b" at "tcp://127.0.0.1:{b.contact.tcp_port}/"\n'
                "There are no outgoing connections\n"
                'There is an input connection from "/c/a" to "/c/b" using tcp\n'
                'There is an input connection from "<ping>" to "/c/b" using text_ack\n'
            ),
            "",
        )


async def test_ping_fails_where_nothing_answers(desk: Desk) -> None:
    status, out, err = await desk.run("ping", "/nope")
    assert (status, out) == (1, "")
    assert "could not find port /nope" in err
    await desk.names.register("/dead", host="127.0.0.1", tcp_port=1)
    status, out, err = await desk.run("ping", "/dead")
    assert (status, out) == (1, "")
    assert "port found, but cannot connect" in err


async def test_clean_removes_dead_names_and_no_live_one(desk: Desk) -> None:
    # The words are those of the capture clean.
    await desk.names.register("/c/dead", host="127.0.0.1", tcp_port=1)
    await desk.names.register("/c/silent", host="192.0.2.1", tcp_port=10)
    await desk.names.register("...", carrier="mcast")
    async with await Port.open("/c/live", desk.names) as live:
        where = live.contact.tcp_port
        assert await desk.run("clean", "--timeout", "0.5") == (
            0,
            (
                "Requesting list of ports from name server... \n"
                "Using a timeout of 0.5 seconds\n"
                "Testing /c/dead at tcp://127.0.0.1:1/\n"
                "* No response, removing port /c/dead\n"
                f"Testing /c/live at tcp://127.0.0.1:{where}/\n"
                "Testing /c/silent at tcp://192.0.2.1:10/\n"
                "* No response, removing port /c/silent\n"
                "Ignoring /root\n"
                "Skipping mcast port /tmp/port/1...\n"
                "Giving name server a chance to do garbage collection.\n"
                "Name server says: garbage collection done.\n"
            ),
            "",
        )
        left = [each.name for each in await desk.names.list_ports()]
        assert left == ["/c/live", "/root", "/tmp/port/1"]


async def test_a_server_of_ones_own(desk: Desk) -> None:
    tcp_port = free_tcp_port()
    words = ("server", "--socket", str(tcp_port), "--namespace", "/lab", "--write")
    server = await desk.start(*words, server=False)
    conf = desk.home / "_lab.conf"
    assert await line_of(server.stdout) == f"Wrote {conf}\n"
    assert await line_of(server.stdout) == f"Name server /lab at tcp://127.0.0.1:{tcp_port}/\n"
    assert await line_of(server.stdout) == "Ok. Ready!\n"
    assert conf.read_text() == f"127.0.0.1 {tcp_port} yarp\n"
    # Now tools find it without being told where it is.
    (desk.home / "yarp_namespace.conf").write_text("/lab\n")
    status, out, _ = await finish(await desk.start("list", "/lab", server=False))
    assert (status, out) == (0, f"registration name /lab ip 127.0.0.1 port {tcp_port} type tcp\n")
    names = NameClient("127.0.0.1", tcp_port)
    async with await Port.open("/a", names), await Port.open("/b", names):
        status, out, _ = await finish(await desk.start("connect", "/a", "/b", server=False))
        assert status == 0
        assert len(connections_of(await survey(names))) == 1
    assert (await stop(server))[:2] == (0, "")


async def test_without_a_name_server_the_remedy_is_named(desk: Desk) -> None:
    nobody = f"127.0.0.1:{free_tcp_port()}"
    status, out, err = await finish(await desk.start("list", "--name-server", nobody, server=False))
    assert (status, out) == (1, "")
    assert f"cannot reach the YARP name server at {nobody}" in err
    assert "start `yarpserver`" in err
    status, _, err = await finish(await desk.start("list", "--name-server", "lab", server=False))
    assert status == 2
    assert "'lab' is not of the form host:tcp_port" in err
