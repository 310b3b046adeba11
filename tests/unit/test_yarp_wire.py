"""The bytes of a connection: greetings, messages, replies; whole, dribbled, damaged, oversized."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError, NameMappingError
from vertebra.yarp.naming.names import check_name
from vertebra.yarp.protocol.bottle import Value, Vocab, encode
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import STREAM_HEAD, part
from vertebra.yarp.protocol.receiver import CallReply, Event, Greeting, Message, Number, Receiver
from vertebra.yarp.protocol.wire import (
    ACK,
    FAST_TCP,
    MJPEG,
    NAME_SER,
    TCP,
    TEXT,
    TEXT_ACK,
    Carrier,
    PeerLimits,
    UnknownCarrierError,
    binary_message,
    choose_carrier,
    command,
    greeting,
    parse_carrier,
    parse_number,
    quit_message,
    text_message,
    welcome,
    yarp_number,
)

LIMITS = PeerLimits(max_message_bytes=300_000, max_text_bytes=1000)
HELLO = bytes.fromhex("5941e41e00005250 05000000 2f632f6100")


def feed(receiver: Receiver, raw: bytes, step: int = 1 << 20) -> list[Event]:
    """Return the events of `raw`, of which at most `step` bytes arrive at once."""
    found: list[Event] = []
    while raw:
        room = receiver.get_buffer()
        count = min(len(room), len(raw), step)
        room[:count] = raw[:count]
        receiver.buffer_updated(count)
        raw = raw[count:]
        while (event := receiver.next_event()) is not None:
            found.append(event)
    return found


def message(payload: bytes, envelope: str = "", letter: str = "D") -> bytes:
    return b"".join(binary_message(command(letter, envelope), (payload,)))


def plain(events: Iterable[Event]) -> list[tuple[object, ...]]:
    return [
        (event.command, event.payload if isinstance(event.payload, str) else bytes(event.payload))
        if isinstance(event, Message)
        else (event,)
        for event in events
    ]


# --- numbers and carriers ---


def test_yarp_numbers() -> None:
    assert yarp_number(10011) == bytes.fromhex("5941 1b270000 5250")
    assert parse_number(b"xx" + yarp_number(-7), 2) == -7
    assert parse_number(b"YA\0\0\0\0RQ") is None


@pytest.mark.parametrize(
    ("header", "carrier"),
    [
        ("5941e41e00005250", TCP),
        ("5941641e00005250", FAST_TCP),
        ("5941f41e00005250", TCP),  # other bits of the code are flags
        (b"CONNECT ".hex(), TEXT),
        (b"CONNACK ".hex(), TEXT_ACK),
        (b"NAME_SER".hex(), NAME_SER),
    ],
)
def test_the_first_eight_bytes_choose_the_carrier(header: str, carrier: Carrier) -> None:
    assert choose_carrier(bytes.fromhex(header)) is carrier


@pytest.mark.parametrize(
    ("header", "named"),
    [
        (bytes.fromhex("59416f1e00005250"), "shmem"),
        (b"GET /?ws", "websocket"),
        (b"UNIX_STR", "unix_stream"),
        (b"HELLO WO", "HELLO WO"),
        (bytes.fromhex("5941661e00005250"), "code 5"),
    ],
)
def test_other_carriers_are_refused_by_name(header: bytes, named: str) -> None:
    with pytest.raises(UnknownCarrierError, match=named):
        choose_carrier(header)


def test_carriers_with_modifiers() -> None:
    assert parse_carrier("tcp+foo.bar+x") == (TCP, ["foo.bar", "x"])
    for text in ("shmem", "nosuch", "", "tcp+recv.bayer", "tcp+log.in"):
        with pytest.raises(EncodeError):
            parse_carrier(text)


# --- greetings ---


@pytest.mark.parametrize("step", [1, 5, 1000])
@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (HELLO, Greeting(TCP, "/c/a", [])),
        (greeting(FAST_TCP, "anon_rpc"), Greeting(FAST_TCP, "anon_rpc", [])),
        (greeting(TCP, "/c/a", ["foo.bar", "x"]), Greeting(TCP, "/c/a", ["foo.bar", "x"])),
        (b"CONNECT /me/t\r\n", Greeting(TEXT, "/me/t", [])),
        (b"CONNACK <ping>\n", Greeting(TEXT_ACK, "<ping>", [])),
        (b"NAME_SER", Greeting(NAME_SER, "anon", [])),
    ],
)
def test_greetings_arrive_in_any_pieces(raw: bytes, expected: Greeting, step: int) -> None:
    assert feed(Receiver(LIMITS), raw, step) == [expected]


def test_greetings_as_yarp_sends_them() -> None:
    assert greeting(TCP, "/c/a") == HELLO
    assert greeting(TCP, "/c/a", ["foo.bar", "x"]).endswith(b"/c/a (foo bar) (x)\0")
    assert welcome(TCP, "/c/a", 10011) == yarp_number(10011)
    assert welcome(TEXT_ACK, "admin", 1) == b"Welcome admin\r\n"
    assert welcome(NAME_SER, "anon", 1) == b""


@pytest.mark.parametrize("name", ["", "x" * 1000, "two\nlines"])
def test_greetings_that_no_port_would_take(name: str) -> None:
    with pytest.raises(EncodeError):
        greeting(TCP, name)


@pytest.mark.parametrize(
    "raw",
    [
        TCP.header + struct.pack("<i", 0),
        TCP.header + struct.pack("<i", -1),
        TCP.header + struct.pack("<i", 1001),
        TCP.header + struct.pack("<i", 2**31 - 1),
        b"CONNECT " + b"x" * 1100,
        b"CONNECT " + b"x" * 1100 + b"\n",
    ],
)
def test_greetings_that_we_do_not_take(raw: bytes) -> None:
    with pytest.raises(DecodeError, match="name"):
        feed(Receiver(LIMITS), raw)


# --- binary messages ---


def test_a_message_as_yarp_writes_it() -> None:
    assert message(encode(["hello", "world"])) == bytes.fromhex(
        "5941 0a000000 5250"  # index
        "02 01 ffffffffffffffff"  # two blocks, one output length
        "08000000 1a000000 00000000"
        "00000000 7e 44 0001"  # D
        "04010000 02000000 05000000 68656c6c6f 05000000 776f726c64"
    )
    assert quit_message(TCP) == bytes.fromhex(
        "5941 0a000000 5250 01 01 ffffffffffffffff 0a000000 00000000 02000000 7e 00 0001 7100"
    )
    assert quit_message(TEXT) == b"q\r\n"
    assert command("d") == bytes.fromhex("00000000 7e 64 0001")
    assert command("D", "41 1234.5") == bytes.fromhex("0c000000 7e 00 0001") + b"D 41 1234.5\0"


@given(
    payloads=st.lists(st.integers(0, 100_000), max_size=6),
    envelope=st.text(st.characters(min_codepoint=32, exclude_categories=["Cs"]), max_size=40),
    step=st.sampled_from([1000, 3333, 65536, 1 << 20]),
)
def test_messages_of_all_sizes_arrive_in_any_pieces(
    payloads: list[int], envelope: str, step: int
) -> None:
    sent = [bytes([number % 251]) * size for number, size in enumerate(payloads)]
    raw = HELLO + b"".join(message(payload, envelope) for payload in sent)
    _, *got = plain(feed(Receiver(LIMITS), raw, step))
    assert got == [(f"D {envelope}" if envelope else "D", payload) for payload in sent]


@given(
    sizes=st.lists(st.integers(2, 290_000), min_size=1, max_size=3),
    step=st.sampled_from([3333, 65536, 1 << 20]),
)
def test_jpegs_of_all_sizes_arrive_in_any_pieces(sizes: list[int], step: int) -> None:
    sent = [b"\xff\xd8" + bytes([number]) * (size - 2) for number, size in enumerate(sizes)]
    raw = STREAM_HEAD + b"".join(b"".join(part(jpeg, "")) for jpeg in sent)
    _, *got = plain(feed(Receiver(LIMITS, MJPEG), raw, step))
    assert got == [("D", jpeg) for jpeg in sent]


def test_the_envelope_is_what_follows_the_letter() -> None:
    (event,) = feed(Receiver(LIMITS, TCP), message(b"x", "41 1234.5"))
    assert isinstance(event, Message)
    assert event.envelope == "41 1234.5"


def test_an_envelope_ends_at_its_nul_and_its_length_field_is_ignored() -> None:
    raw = b"".join(binary_message(command("D", "41 1234.5"), (b"x",)))
    length = struct.pack("<i", len(b"D 41 1234.5\0"))
    for claimed in (0, 3, 1_000_000):
        changed = raw.replace(length + b"~", struct.pack("<i", claimed) + b"~")
        assert plain(feed(Receiver(LIMITS, TCP), changed)) == [("D 41 1234.5", b"x")]


def test_a_large_payload_is_received_in_place() -> None:
    receiver = Receiver(LIMITS, TCP)
    raw = message(bytes(200_000))
    assert len(feed(receiver, raw)) == 1
    assert feed(receiver, raw[:100]) == []
    room = receiver.get_buffer()
    assert len(room) == len(raw) - 100  # the rest and nothing of the next message
    room[-1] = 7
    receiver.buffer_updated(len(room))
    assert receiver.full
    event = receiver.next_event()
    assert isinstance(event, Message)
    assert isinstance(event.payload, memoryview)
    assert event.payload.obj is room.obj
    assert event.payload.readonly
    assert (len(event.payload), event.payload[-1]) == (200_000, 7)


def test_memory_goes_to_peers_that_send_not_to_those_that_announce() -> None:
    limits = PeerLimits(max_message_bytes=2**31 - 1)
    payload = bytes(range(256)) * 8192
    raw = message(payload)
    receiver = Receiver(limits, TCP)
    assert feed(receiver, index(2**31 - 1)) == []
    assert len(receiver.get_buffer()) < 200_000
    for step in (len(raw), 50_000):
        assert plain(feed(Receiver(limits, TCP), raw, step)) == [("D", payload)]


@pytest.mark.parametrize(("blocks", "outputs"), [(1, 1), (1, 0), (24, 1), (255, 255)])
def test_the_split_into_blocks_is_irrelevant(blocks: int, outputs: int) -> None:
    body = command("D") + b"p" * blocks
    sizes = [len(body) - (blocks - 1), *[1] * (blocks - 1)]
    index = yarp_number(10) + bytes((blocks, outputs)) + b"\xff" * 8
    raw = index + struct.pack(f"<{blocks + outputs}i", *sizes, *[0] * outputs) + body
    assert plain(feed(Receiver(LIMITS, TCP), raw, 1)) == [("D", b"p" * blocks)]


def test_small_buffers_are_joined_and_large_ones_are_not_copied() -> None:
    pixels = bytes(100_000)
    head, large, tail = binary_message(command("D"), (b"header", pixels, b"a", b"b"))
    assert large is pixels
    assert bytes(head).endswith(b"header")
    assert bytes(tail) == b"ab"
    assert len(binary_message(command("D"), (b"header", b"more"))) == 1
    assert binary_message(command("D"), (pixels, pixels))[1:] == [pixels, pixels]


def test_an_envelope_that_yarp_would_cut_is_refused() -> None:
    with pytest.raises(EncodeError, match=r"\\n"):
        command("D", "two\nlines")


def index(*sizes: int) -> bytes:
    head = yarp_number(10) + bytes((len(sizes), 1)) + b"\xff" * 8
    return head + struct.pack(f"<{len(sizes) + 1}i", *sizes, 0)


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (index(2**31 - 1), "announces 2147483647 bytes; max_message_bytes is 300000"),
        (index(2**31 - 1, 2**31 - 1), "4294967294"),
        (index(-1), "block of -1 bytes"),
        (index(100, -50), "-50"),
        (index(7), "7 bytes has no room"),
        (index(), "0 bytes has no room"),
        (b"rubbish!", "rubbish!"),
        (yarp_number(10)[:7] + b"X", "YARP number"),
        (index(8) + bytes(8), "port command"),
        (index(12) + bytes.fromhex("04000000 7e 00 0001") + b"Dxxx", "does not end"),
        (message(bytes(20_000)).replace(b"\x7e", b"\x7f", 1), "port command"),
    ],
)
def test_what_breaks_a_stream_is_refused_before_anything_is_allocated(
    raw: bytes, reason: str
) -> None:
    with pytest.raises(DecodeError, match=reason):
        feed(Receiver(LIMITS, TCP), raw)


def test_acks_and_answers_between_messages() -> None:
    raw = yarp_number(10011) + ACK + message(b"x")
    assert plain(feed(Receiver(LIMITS, TCP), raw)) == [
        (Number(10011),), (Number(0),), ("D", b"x"),
    ]  # fmt: skip


@given(st.binary(max_size=300), st.sampled_from([None, TCP, TEXT, NAME_SER]))
def test_rubbish_never_does_more_than_break_its_stream(raw: bytes, dialled: Carrier | None) -> None:
    with suppress(DecodeError):
        feed(Receiver(LIMITS, dialled), raw, 7)


@given(st.integers(0, 60), st.integers(0, 255))
def test_a_flipped_byte_never_does_more_than_break_its_stream(position: int, byte: int) -> None:
    raw = bytearray(message(encode(["hello", "world"]), "41 1234.5"))
    raw[position] = byte
    try:
        events = feed(Receiver(LIMITS, TCP), bytes(raw))
    except DecodeError:
        return
    assert len(events) <= 2


# --- text messages ---


@pytest.mark.parametrize("step", [1, 1000])
def test_text_messages_arrive_in_any_pieces(step: int) -> None:
    raw = b'CONNECT /me\r\nD\r\nhello world\r\nd 41 1.5\n(1 2\n3) "a\r\nb"\n*\nq\r\n'
    greeted, *rest = feed(Receiver(LIMITS), raw, step)
    assert greeted == Greeting(TEXT, "/me", [])
    assert plain(rest) == [
        ("D", "hello world"),
        ("d 41 1.5", '(1 2\n3) "a\nb"'),
        ("*", ""),
        ("q", ""),
    ]


def test_text_messages_as_yarp_writes_them() -> None:
    assert text_message("D", "", "hello world") == b"D\r\nhello world\r\n"
    assert text_message("D", "41 1234.5", "x") == b"D 41 1234.5\r\nx\r\n"


def test_name_server_lines() -> None:
    raw = b"NAME_SERVER query /root\r\nNAME_SERVER list\n"
    _, *rest = feed(Receiver(LIMITS), raw, 3)
    assert plain(rest) == [("d", "query /root"), ("d", "list")]


@pytest.mark.parametrize(
    "raw",
    [
        b"D\n" + b"x" * 1001,
        b"x" * 2000 + b"\n",
        b"d\n" + b"(" * 900 + b"\n" + b"(" * 900 + b"\n",
        b"d\n(" + b"\n" * 200,
    ],
)
def test_text_that_never_ends_is_refused(raw: bytes) -> None:
    with pytest.raises(DecodeError, match=r"longer than|still open"):
        feed(Receiver(LIMITS, TEXT), raw)


# --- replies ---


def reply_receiver() -> Receiver:
    receiver = Receiver(LIMITS, TCP)
    receiver.expect_replies(Dialect.V3)
    return receiver


@pytest.mark.parametrize("step", [1, 7, 100_000])
@pytest.mark.parametrize(
    "values",
    [
        [Vocab("is"), "axes", 7],
        [],
        [ACK],  # the bytes of an ack inside a blob
        ["x" * 100_000],
    ],
)
def test_a_reply_has_no_index_and_no_length_and_ends_where_its_bottle_ends(
    values: list[Value], step: int
) -> None:
    raw = encode(values) + ACK
    assert feed(reply_receiver(), raw, step) == [CallReply(values)]


def test_an_ack_alone_is_a_call_without_reply() -> None:
    assert feed(reply_receiver(), ACK + encode([1]) + ACK, 8) == [CallReply(None), CallReply([1])]


@pytest.mark.parametrize(
    "raw",
    [
        b"registration name /root ip ...\r\n" + ACK,
        encode([1]) + b"more" + ACK,
        b"x" * 300_001,
    ],
)
def test_what_is_no_reply_is_refused(raw: bytes) -> None:
    with pytest.raises(DecodeError):
        feed(reply_receiver(), raw)


# --- names ---


@pytest.mark.parametrize("name", ["/root", "/icub/head/state:o", "/tmp/port/4=/suffix", "/a#b~%"])
def test_names_of_ports(name: str) -> None:
    assert check_name(name) == name


@pytest.mark.parametrize(
    ("name", "position"), [("x", 0), ("", 0), ("/a b", 2), ("/a\nb", 2), ('/"', 1), ("/(x)", 1)]
)
def test_names_that_cannot_be_those_of_ports(name: str, position: int) -> None:
    with pytest.raises(NameMappingError) as caught:
        check_name(name)
    assert caught.value.position == position
