"""Captured bytes of the carriers udp, mcast and mjpeg, made and read by ours."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from vertebra.yarp.objects import Image
from vertebra.yarp.protocol.bottle import Value, Vocab, decode, encode
from vertebra.yarp.protocol.mjpeg import STREAM_HEAD, comment_of, part
from vertebra.yarp.protocol.packets import Reassembly, cut
from vertebra.yarp.protocol.receiver import Event, Greeting, Message, Receiver
from vertebra.yarp.protocol.wire import (
    DEFAULT_LIMITS,
    MCAST,
    MJPEG,
    TEXT,
    UDP,
    Carrier,
    binary_message,
    command,
    greeting,
    group_bytes,
    quit_message,
    text_line,
    welcome,
)
from vertebra_pillow.yarp import YarpJpeg

CAPTURED = json.loads((Path(__file__).parent / "yarp" / "carriers.json").read_text())
UDP_SESSION = CAPTURED["conn_udp"]
WRITTEN: list[list[Value]] = [
    ["hello", "world"],
    [1, 2.5, "a b", [1, 2, 3], Vocab("vo"), b"\1\2\xff"],
]


def events(raw: bytes, dialled: Carrier | None = None) -> Iterator[Event]:
    receiver = Receiver(DEFAULT_LIMITS, dialled)
    for byte in raw:  # as badly cut as can be
        receiver.get_buffer()[:1] = bytes([byte])
        receiver.buffer_updated(1)
        while (event := receiver.next_event()) is not None:
            yield event


def test_udp_begins_and_ends_as_captured() -> None:
    assert greeting(UDP, "/c/a").hex() == UDP_SESSION["greeting"]
    assert welcome(UDP, "/c/a", 45491).hex() == UDP_SESSION["answer"]
    leave = greeting(TEXT, "admin") + text_line("~/c/a") + quit_message(TEXT)
    assert leave.hex() == UDP_SESSION["leave"]
    (greeted,) = events(bytes.fromhex(UDP_SESSION["greeting"]))
    assert greeted == Greeting(UDP, "/c/a", [])


def test_captured_datagrams_are_those_that_we_send() -> None:
    for values, datagram in zip(WRITTEN, UDP_SESSION["datagrams"], strict=False):
        ours = cut(binary_message(command("D"), (encode(values),)))
        assert [raw.hex() for raw in ours] == [datagram]


def test_captured_datagrams_are_read_and_those_that_wake_are_ignored() -> None:
    read: list[list[Value]] = []
    lost: list[str] = []

    def on_message(message: Message) -> None:
        assert isinstance(message.payload, memoryview)
        read.append(decode(message.payload))

    reassembly = Reassembly(DEFAULT_LIMITS, on_message, lost.append)
    for datagram in UDP_SESSION["datagrams"]:
        reassembly.feed(bytes.fromhex(datagram))
    assert read == WRITTEN
    assert lost == []


def test_an_image_is_cut_as_the_real_one_is() -> None:
    # [cap cam_udp]: 320 x 240 rgb in its message with envelope
    image = Image.from_packed("rgb", 320, 240, bytes(230400))
    message = binary_message(command("D", "13 1795354748.6834"), image.encode_parts())
    assert [len(datagram) for datagram in cut(message)] == [
        65499,
        65499,
        65499,
        34058 - 4,
    ]  # one block less


def test_the_greeting_by_mcast_names_the_group() -> None:
    # refs 4.4: e0010103 2713 is 224.1.1.3:10003
    hello = greeting(MCAST, "/c/a") + group_bytes(("224.1.1.3", 10003))
    assert hello.hex() == "5941621e00005250" + "05000000" + "2f632f6100" + "e0010103" + "2713"
    (greeted,) = events(hello)
    assert greeted == Greeting(MCAST, "/c/a", [], ("224.1.1.3", 10003))


@pytest.mark.parametrize("case", ["cam_mjpeg", "cam_http_stream"])
def test_whoever_asks_for_a_stream_is_understood(case: str) -> None:
    """The request of YARP's own reader is no valid HTTP (refs 4.5)."""
    assert [*events(bytes.fromhex(CAPTURED[case]["request"]))] == [Greeting(MJPEG, "web", [])]


@pytest.mark.parametrize("case", ["cam_mjpeg", "cam_http_stream"])
def test_a_captured_stream_is_read_and_written_again(case: str) -> None:
    stream = bytes.fromhex(CAPTURED[case]["stream"])
    welcomed, image = events(stream, MJPEG)
    assert welcomed == Message("Welcome", "")
    assert isinstance(image, Message)
    assert isinstance(image.payload, memoryview)
    jpeg = bytes(image.payload)
    count, seconds = image.envelope.split()
    assert (int(count) > 0, float(seconds) > 1_795_354_700) == (True, True)
    assert comment_of(jpeg) == image.envelope
    shown = Image.decode(YarpJpeg().decode(jpeg))
    assert (shown.width, shown.height, shown.pixel_code) == (320, 240, "rgb")

    begin = jpeg.index(b"\xff\xfe")
    end = begin + 2 + int.from_bytes(jpeg[begin + 2 : begin + 4], "big")
    uncommented = jpeg[:begin] + jpeg[end:]
    assert STREAM_HEAD + b"".join(part(uncommented, image.envelope)) == stream
    assert comment_of(uncommented) == ""
