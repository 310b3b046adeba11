"""Sessions of the real YARP programs, replayed against our ports without any socket.

Every captured connection has two ends. Where a port was the server, ours gets the client's bytes
and must answer with the server's. Where a port was the client (a writer that was told to connect),
ours gets the server's bytes and must send the client's.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from vertebra.yarp.naming.names import Contact
from vertebra.yarp.naming.nametable import NameTable, TableClient
from vertebra.yarp.ports.client import RpcClient
from vertebra.yarp.ports.incoming import Incoming, Reply
from vertebra.yarp.ports.link import Connection
from vertebra.yarp.ports.switchboard import Switchboard
from vertebra.yarp.protocol.bottle import Value, Vocab, decode, decode_prefix, encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.receiver import Event, Greeting, Message, Receiver
from vertebra.yarp.protocol.text import from_text
from vertebra.yarp.protocol.wire import (
    ACK,
    DEFAULT_LIMITS,
    OUTPUT_CARRIERS,
    TCP,
    TEXT,
    Carrier,
    UnknownCarrierError,
    greeting,
    quit_message,
    yarp_number,
)

SESSIONS = json.loads((Path(__file__).parent / "yarp" / "sessions.json").read_text())["cases"]
NAME_SERVER = 10000

LEFT_OUT = {
    "http_port_json": "YARP sends the same three lines for ever; ours ends with an empty list",
    "cam_mjpeg": "held to the bytes in test_yarp_carrier_bytes.py",
    "cam_http_stream": "held to the bytes in test_yarp_carrier_bytes.py",
    "conn_udp": "held to the bytes in test_yarp_carrier_bytes.py and test_yarp_carriers.py",
    "mcast_discovery": "held to the bytes in test_yarp_carrier_bytes.py and test_yarp_names.py",
    "conn_shmem": "carrier shmem needs the C++ library's shared memory",
    "conn_unix_stream": "carrier unix_stream is not spoken here; our refusal says so",
    "conn_tcp_log": "a log connection carries what a port reads; we refuse the modifier",
    "rob_state_o_text": "the C++ writer crashed",
    "mix_312_to_40_tcp": "the 4.0 reader choked on the dialect and never acknowledged",
}

EXCHANGES_LEFT_OUT = {
    "admin_rpc": {
        encode([Vocab("prop"), Vocab("get"), "/c/b"]): "tells about the process",
        encode([Vocab("prop"), Vocab("get"), "/c/a"]): "tells about a thread",
    },
}
"""Requests by a part of their bytes."""

NAMES = {
    10011: "/c/b",
    10018: "/icubSim/head/rpc:i",
    10019: "/icubSim/head/command:i",
    10020: "/icubSim/head/state:o",
}
"""Of ports that no reply of the name server mentions."""

ON_A_PAGE = r'<a href="http://([^:/]+):(\d+)">(\S+)</A> +\((\w+):/'
"""How pages show registered ports."""

LOOPING = ("http_port_admin",)
"""Here an earlier connection by http was still being told that its command is not understood."""

INPUT_PORTS = ("/c/b", "/cap/r")
"""Of `yarp read`, which refuses to be connected to a reader."""

JOINED_MIDWAY = {
    "admin_rpc": ("/c/a", "/c/b", "fast_tcp"),
    "admin_rpc_src": ("/c/a", "/c/b", "fast_tcp"),
    "close_by_reader": ("/c/a", "/c/b", "tcp"),
}
"""Connections that were there before the capture began."""

SPLITS_DIFFER = {"rob_state_o", "rob_state_o_tcp", "rob_stateExt_o", "cam_tcp", "reverse_fast_tcp",
                 "reverse_tcp"}  # fmt: skip
"""Cut into more blocks than our two; only what is in the blocks counts."""

THEIRS_ONLY = {("dup_name", 0): ACK}
"""YARP acknowledges once more when it closes a connection whose name is taken over."""

OURS_ONLY = {("port_raw_tcp", 0): ACK}
"""Stray bytes behind an object broke YARP's stream; ours goes by the announced length."""

DIALECTS = {
    ("mix_312_to_40_text", "/x/r"): Dialect.V4,
    ("mix_40_to_40_tcp", "/x/r"): Dialect.V4,
    ("mix_40_to_40_tcp", "/x/w"): Dialect.V4,
}

ENDS_LATE_S = {"127.0.0.1:42984": 0.2}
"""When the client closed, where that was not right after the last bytes (reverse_fast_tcp)."""

RPC_CASES = ("rpc_client", "rob_rpc_get", "cam_rpc", "py_rpc")
"""Here the client is not a port that writes."""


@dataclass
class Captured:
    """One captured connection and what our two ends of it sent."""

    server: int
    chunks: list[tuple[float, str, bytes]]
    joined_midway: bool
    server_end: Ear | None = None
    client_end: Ear | None = None

    def bytes_of(self, direction: str) -> bytes:
        return b"".join(raw for _, way, raw in self.chunks if way == direction)


class Ear(asyncio.Transport):
    """A transport that keeps what is written to it."""

    def __init__(self, connection: Connection) -> None:
        ends = {"peername": ("127.0.0.1", 50000), "sockname": ("127.0.0.1", 50001)}
        super().__init__({**ends, "socket": FakeSocket()})
        self.connection = connection
        self.heard = bytearray()
        self._closing = False
        connection.connection_made(self)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.heard += data

    def is_closing(self) -> bool:
        return self._closing

    def close(self) -> None:
        if not self._closing:
            self._closing = True
            asyncio.get_running_loop().call_soon(self.connection.connection_lost, None)

    abort = close

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def feed(self, data: bytes) -> None:
        """Let the connection receive, as much at a time as it asks for."""
        while data and not self._closing:
            room = self.connection.get_buffer(-1)
            count = min(len(room), len(data))
            room[:count] = data[:count]
            self.connection.buffer_updated(count)
            data = data[count:]

    def end(self) -> None:
        """Let the other side close."""
        if not self._closing and not self.connection.eof_received():
            self.close()


class FakeSocket:
    def setsockopt(self, *_: int) -> None:
        pass


async def settle() -> None:
    """Let everything happen that follows; there is no I/O that could take longer."""
    for _ in range(30):
        await asyncio.sleep(0)


class Scene:
    """The ports of one case, all ours, in the state in which the capture began."""

    def __init__(self, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.case = case
        left_out = EXCHANGES_LEFT_OUT.get(case, {})
        self.connections = [captured(raw, left_out) for raw in SESSIONS[case]["connections"]]
        self.table = NameTable()
        self.reply: list[Value] | None = None  # what the owner of an RPC port said
        self.boards = {
            tcp_port: self._board(Contact(name, "tcp", "127.0.0.1", tcp_port))
            for tcp_port, name in self._names().items()
        }
        self.boards[NAME_SERVER] = self._board(
            Contact("/root", "tcp", "127.0.0.1", NAME_SERVER), self._answer_names
        )
        self._seed_names()
        monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", self._dialled)

    def _names(self) -> dict[int, str]:
        servers = {each.server for each in self.connections} - {NAME_SERVER}
        spoken_to = {each.server for each in self.connections if each.bytes_of("c>s")}
        names = {tcp_port: NAMES[tcp_port] for tcp_port in servers & NAMES.keys()}
        return names | {
            tcp_port: name
            for name, _, tcp_port, _ in self._registrations()
            if tcp_port in servers & spoken_to
        }

    def _board(
        self, contact: Contact, on_call: Callable[[Incoming], Any] | None = None
    ) -> Switchboard:
        is_rpc = "rpc" in contact.name or contact.name == "/c/srv"
        return Switchboard(
            contact,
            TableClient(self.table, tcp_port=NAME_SERVER),
            on_data=lambda _: None,
            on_call=on_call or (self._answer_call if is_rpc else None),
            delivery="queue",
            depth=1000,
            dialect=DIALECTS.get((self.case, contact.name), Dialect.V3),
            limits=DEFAULT_LIMITS,
            sends=contact.name not in INPUT_PORTS,
        )

    async def _answer_names(self, incoming: Incoming) -> Reply:
        return self.table.answer(incoming.bottle(), incoming.sender_host)

    async def _answer_call(self, _: Incoming) -> Reply:
        return self.reply

    # --- the state before the capture ---

    def _registrations(self) -> Iterator[tuple[str, str, int, str]]:
        for each in self.connections:
            text = each.bytes_of("s>c").decode("latin-1")
            for form in (
                r"registration name (\S+) ip (\S+) port (\d+) type (\S+)",
                r'\(name "?([^")]+)"?\) \(ip "([^"]+)"\) \(port_number (\d+)\) \(carrier (\w+)\)',
                r'"name": "(\S+)", "ip": "(\S+)", "port_number": (\d+), "carrier": "(\w+)"',
            ):
                for name, host, tcp_port, carrier in re.findall(form, text):
                    yield name, host, int(tcp_port), carrier
            for host, tcp_port, name, carrier in re.findall(ON_A_PAGE, text):
                yield name, host, int(tcp_port), carrier

    def _seed_names(self) -> None:
        granted = set()
        for each in self.connections:
            if b" register " in each.bytes_of("c>s"):
                reply = each.bytes_of("s>c").decode().split()
                granted.add(reply[2])
                self.table._given.setdefault(int(reply[6]), reply[2])
        self.table.answer(["register", "/root", "tcp", "127.0.0.1", NAME_SERVER], "")
        for name, host, tcp_port, carrier in self._registrations():
            if name not in granted:
                self.table.answer(["register", name, carrier, host, tcp_port], "")

    async def _join_midway(self) -> None:
        if self.case not in JOINED_MIDWAY:
            return
        sender, dest, carrier = JOINED_MIDWAY[self.case]
        hello = greeting(OUTPUT_CARRIERS[carrier], sender)
        found = [each for each in self.connections if each.joined_midway]
        readers = [board for board in self.boards.values() if board.name == dest]
        writers = [board for board in self.boards.values() if board.name == sender]
        each = found[0] if found else Captured(0, [], joined_midway=True)
        for board in readers:
            each.server_end = Ear(board.accept())
            each.server_end.feed(hello)
            each.server_end.heard.clear()
        for board in writers:
            connecting = asyncio.create_task(board.connect(dest, carrier))
            await settle()
            assert each.client_end is not None
            assert each.client_end.heard == hello
            each.client_end.feed(yarp_number(0))
            await connecting
            each.client_end.heard.clear()

    async def _dialled(
        self, factory: Callable[[], Connection], _host: str, tcp_port: int
    ) -> tuple[asyncio.Transport, Connection]:
        """Stand in for loop.create_connection."""
        connection = factory()
        ear = Ear(connection)
        waiting = [
            each
            for each in self.connections
            if each.server == tcp_port and each.client_end is None and self.writer_of(each)
        ]
        waiting[0].client_end = ear
        return ear, connection

    # --- the capture ---

    def writer_of(self, each: Captured) -> Switchboard | None:
        """Return our port that opened this connection to write."""
        if each.joined_midway:
            sender = JOINED_MIDWAY[self.case][0]
        else:
            sender = sender_of(each.bytes_of("c>s"))
        for board in self.boards.values():
            if board.name == sender:
                return board
        return None

    async def replay(self) -> None:
        await self._join_midway()
        if self.case in LOOPING:
            (board,) = (board for board in self.boards.values() if board.name == "/c/b")
            Ear(board.accept()).feed(b"GET /?req=hello HTTP/1.0\r\n")
        steps = sorted(
            ((when, index, position)
             for index, each in enumerate(self.connections)
             for position, (when, _, _) in enumerate(each.chunks)),
        )  # fmt: skip
        for _, index, position in steps:
            each = self.connections[index]
            _, direction, raw = each.chunks[position]
            if direction == "c>s":
                await self._client_speaks(each, position, raw)
            elif direction == "s>c":
                await self._server_speaks(each, raw)
            else:
                self._server_end(each).end()
            await settle()

    def _server_end(self, each: Captured) -> Ear:
        if each.server_end is None:
            board = self.boards.get(each.server)
            each.server_end = Ear(board.accept() if board else Connection(
                Receiver(DEFAULT_LIMITS), lambda _: None, None))  # fmt: skip
        return each.server_end

    async def _client_speaks(self, each: Captured, position: int, raw: bytes) -> None:
        writer = self.writer_of(each)
        if writer is not None and each is self._first_of(writer):
            write_all(writer, raw, self._dialled_as(each) if position else None)
        following = [data for _, way, data in each.chunks[position + 1 :][:1] if way == "s>c"]
        self.reply = scripted(following[0]) if following else None
        if each.server in self.boards:
            self._server_end(each).feed(raw)

    async def _server_speaks(self, each: Captured, raw: bytes) -> None:
        asked_to_read = b"~r" in each.bytes_of("c>s")
        if asked_to_read:
            write_all(self.boards[each.server], raw, TCP)
        if each.client_end is not None:
            each.client_end.feed(raw)

    def _first_of(self, writer: Switchboard) -> Captured | None:
        """Return the connection that tells what was written; others carry the same."""
        return next(
            (each for each in self.connections
             if each.client_end is not None and self.writer_of(each) is writer
             and not each.client_end.is_closing()), None,
        )  # fmt: skip

    def _dialled_as(self, each: Captured) -> Carrier:
        return TCP if each.joined_midway or each.bytes_of("c>s")[:2] == b"YA" else TEXT

    async def close(self) -> None:
        for board in self.boards.values():
            await board.close()
        await settle()


def captured(raw: dict[str, Any], left_out: Collection[bytes]) -> Captured:
    chunks = []
    skipping = False
    for when, direction, data, *lengths in raw["data"]:
        chunk = bytes.fromhex(data).ljust(sum(lengths), b"\0")
        if direction == "c>s":
            skipping = any(part in chunk for part in left_out)
        if not skipping:
            chunks.append((when, direction, chunk))
    end_s = chunks[-1][0] if chunks else raw["t"]
    chunks.append((ENDS_LATE_S.get(raw["client"], end_s), "end", b""))
    server = int(raw["server"].rpartition(":")[2])
    return Captured(server, chunks, raw["joined_midway"])


def events(raw: bytes, dialled: Carrier | None) -> Iterator[Event]:
    """Yield what the bytes say, however they are cut into blocks."""
    receiver = Receiver(DEFAULT_LIMITS, dialled)
    while raw:
        room = receiver.get_buffer()
        count = min(len(room), len(raw))
        room[:count] = raw[:count]
        receiver.buffer_updated(count)
        raw = raw[count:]
        while (event := receiver.next_event()) is not None:
            yield event


def sender_of(raw: bytes) -> str:
    try:
        first = next(events(raw, None), None)
    except UnknownCarrierError:
        return ""
    return first.sender if isinstance(first, Greeting) else ""


def write_all(board: Switchboard, raw: bytes, dialled: Carrier | None) -> None:
    """Write what a captured writer wrote."""
    for event in events(raw, dialled):
        if isinstance(event, Message) and event.command[:1] == "D":
            payload = event.payload
            raw_payload = encode(from_text(payload)) if isinstance(payload, str) else payload
            board.write(raw_payload, event.envelope)


def scripted(raw: bytes) -> list[Value] | None:
    """Return the reply that a captured answer begins with, if any."""
    if raw[:2] not in (b"\x00\x01", b"\x01\x01", b"\x04\x01", b"\x09\x01", b"\x0a\x01"):
        return None
    return decode_prefix(raw, 0)[0]


def flat(event: Event) -> tuple[object, ...]:
    if isinstance(event, Message):
        return event.command, bytes(event.payload) if isinstance(event.payload, memoryview) else ""
    return (event,)


@pytest.mark.parametrize("case", sorted(SESSIONS.keys() - LEFT_OUT.keys()))
async def test_our_ports_take_the_place_of_the_real_ones_in(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(case, monkeypatch)
    await scene.replay()
    for index, each in enumerate(scene.connections):
        if each.server_end is not None:
            ours = bytes(each.server_end.heard).removesuffix(OURS_ONLY.get((case, index), b""))
            theirs = each.bytes_of("s>c").removesuffix(THEIRS_ONLY.get((case, index), b""))
            check(case, f"server of {index}", ours, theirs, TCP)
        if each.client_end is not None and case not in RPC_CASES:
            theirs = each.bytes_of("c>s")
            dialled = TCP if each.joined_midway else None
            check(case, f"client of {index}", bytes(each.client_end.heard), theirs, dialled)
    await scene.close()


def check(case: str, end: str, ours: bytes, theirs: bytes, dialled: Carrier | None) -> None:
    if case in SPLITS_DIFFER and ours != theirs:
        ours = ours.removesuffix(quit_message(TCP))  # these writers left without a word
        assert [*map(flat, events(ours, dialled))] == [*map(flat, events(theirs, dialled))], end
    else:
        assert (end, ours) == (end, theirs)


@pytest.mark.parametrize("case", RPC_CASES)
async def test_our_rpc_client_takes_the_place_of_the_real_one_in(case: str) -> None:
    each = next(
        connection
        for connection in (captured(raw, ()) for raw in SESSIONS[case]["connections"])
        if b"~d\0\1" in connection.bytes_of("c>s")
    )
    connection = Connection(Receiver(DEFAULT_LIMITS, TCP), lambda _: connection.hold(), None)
    ear = Ear(connection)
    hello, answer, *calls, leave, _ = [raw for _, _, raw in each.chunks[:-1]]
    connection.write(greeting(TCP, sender_of(hello)))
    ear.feed(answer)
    client = RpcClient(connection, "/peer", Dialect.V3, max_waiting_calls=1)
    connection.release()
    for request, reply in zip(calls[::2], calls[1::2], strict=True):
        message = next(events(request, TCP))
        assert isinstance(message, Message)
        assert isinstance(message.payload, memoryview)
        call = asyncio.create_task(client.call(decode(message.payload), timeout_s=1))
        await settle()
        for byte in reply:
            ear.feed(bytes([byte]))
        assert encode(await call) == reply.removesuffix(ACK)
    await client.close()
    assert leave == quit_message(TCP)
    assert bytes(ear.heard) == each.bytes_of("c>s")


def test_every_captured_case_is_replayed_or_left_out_for_a_reason() -> None:
    assert SESSIONS.keys() >= LEFT_OUT.keys()
    assert all(LEFT_OUT.values())
    replayed = SESSIONS.keys() - LEFT_OUT.keys()
    assert len(replayed) > 40
    assert all(SESSIONS[case]["connections"] for case in replayed)
