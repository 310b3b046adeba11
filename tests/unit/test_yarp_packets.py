"""Messages as datagrams: whatever is lost, doubled, turned or damaged, never a part of one."""

from __future__ import annotations

import random
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.yarp.protocol.packets import MAX_DATAGRAM_BYTES, Reassembly, cut
from vertebra.yarp.protocol.receiver import Message
from vertebra.yarp.protocol.wire import DEFAULT_LIMITS, PeerLimits, binary_message, command


class Taken:
    """What a reassembly has given."""

    def __init__(self, limits: PeerLimits = DEFAULT_LIMITS) -> None:
        self.payloads: list[bytes] = []
        self.lost: list[str] = []
        self.reassembly = Reassembly(limits, self._take, self.lost.append)

    def _take(self, message: Message) -> None:
        assert not isinstance(message.payload, str)
        self.payloads.append(bytes(message.payload))

    def feed(self, *datagrams: bytes) -> Taken:
        for datagram in datagrams:
            self.reassembly.feed(datagram)
        return self


def datagrams_of(payload: bytes, envelope: str = "") -> list[bytes]:
    return [*cut(binary_message(command("D", envelope), (payload,)))]


def datagram(sequence: int, body: bytes) -> bytes:
    return struct.pack("<Ii", zlib.crc32(body), sequence) + body


@given(st.integers(0, 3 * MAX_DATAGRAM_BYTES), st.sampled_from(["", "41 1234.5"]))
def test_messages_of_every_size_come_back(size: int, envelope: str) -> None:
    payload = random.Random(size).randbytes(size)
    datagrams = datagrams_of(payload, envelope)
    assert all(len(each) == MAX_DATAGRAM_BYTES for each in datagrams[:-1])
    taken = Taken().feed(*datagrams)
    assert (taken.payloads, taken.lost) == ([payload], [])


@given(st.data())
def test_of_a_message_that_lost_a_datagram_nothing_is_delivered(data: st.DataObject) -> None:
    payload, after = bytes(4 * MAX_DATAGRAM_BYTES), b"after"
    datagrams = datagrams_of(payload)
    gone = data.draw(st.integers(0, len(datagrams) - 1))
    rest = datagrams[:gone] + datagrams[gone + 1 :]
    taken = Taken().feed(*rest, *datagrams_of(after))
    assert (taken.payloads, len(taken.lost)) == ([after], 1)


@given(st.permutations(range(4)))
def test_out_of_order_is_lost(order: list[int]) -> None:
    payload = bytes(3 * MAX_DATAGRAM_BYTES)
    datagrams = datagrams_of(payload)
    taken = Taken().feed(*(datagrams[index] for index in order))
    whole = order == [0, 1, 2, 3]
    assert taken.payloads == ([payload] if whole else [])
    assert bool(taken.lost) != whole


@given(st.data())
def test_flipped_and_cut_datagrams_cost_their_message_alone(data: st.DataObject) -> None:
    good, damaged = b"good", datagrams_of(b"x" * 100)[0]
    position = data.draw(st.integers(0, len(damaged) - 1))
    flipped = bytearray(damaged)
    flipped[position] ^= data.draw(st.integers(1, 255))
    taken = Taken().feed(bytes(flipped), damaged[:position], *datagrams_of(good))
    assert taken.payloads == [good]
    assert 1 <= len(taken.lost) <= 2  # a wrong sequence number may be taken for one that wakes


@given(st.lists(st.binary(max_size=64), max_size=20))
def test_rubbish_is_counted_and_holds_no_memory(rubbish: list[bytes]) -> None:
    taken = Taken().feed(*rubbish, *datagrams_of(b"good"))
    assert taken.payloads == [b"good"]
    assert bool(taken.lost) == bool(rubbish)


def test_small_datagrams_of_others_are_put_together() -> None:
    raw = b"".join(binary_message(command("D"), (b"payload",)))
    pieces = [datagram(number, raw[number : number + 1]) for number in range(len(raw))]
    assert Taken().feed(*pieces).payloads == [b"payload"]


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"no index, but long enough", "must begin with an index"),
        (b"".join(binary_message(command("D"), (b"x",))) + b"!", "bytes came where"),
        (b"".join(binary_message(command("D"), (bytes(2000),)))[:100], "max_message_bytes is 1000"),
        (b"".join(binary_message(command("D"), ()))[:-8] + bytes(8), "begin with a port command"),
    ],
)
def test_what_cannot_be_a_message_is_given_up_at_once(body: bytes, reason: str) -> None:
    taken = Taken(PeerLimits(max_message_bytes=1000)).feed(datagram(0, body), datagram(1, b"more"))
    assert taken.payloads == []
    (lost,) = taken.lost
    assert reason in lost


def test_many_losses_in_a_row_are_all_counted() -> None:
    first, *_ = datagrams_of(bytes(2 * MAX_DATAGRAM_BYTES))
    _, second, third = datagrams_of(bytes(2 * MAX_DATAGRAM_BYTES))
    taken = Taken().feed(first, first, first, second, second, third)
    # Two were cut short by the next; the third got a datagram twice.
    assert (taken.payloads, len(taken.lost)) == ([], 3)
