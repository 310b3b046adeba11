"""Every object that the real libraries (YARP 3.12.3 and 4.0.0) wrote, byte for byte.

`yarp/objects-*.json` was written by the C++ libraries themselves: `hex` is what an object sends on
a binary carrier, `text_mode` what it sends on a text carrier, `string` what it prints.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest

from vertebra.errors import DecodeError
from vertebra.yarp import objects
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.text import from_text, to_text

FILES = {Dialect.V3: "objects-3.12.json", Dialect.V4: "objects-4.0.json"}


@dataclass(frozen=True)
class Golden:
    dialect: Dialect
    kind: str
    name: str
    raw: bytes
    facts: dict[str, Any]

    @property
    def case(self) -> tuple[str, str]:
        return (self.kind, self.name)

    @property
    def text(self) -> str | None:
        if self.kind == "value":  # the library writes these in binary even on a text carrier
            return None
        if self.kind in ("bottle", "property", "bottle_parse"):
            text: str | None = self.facts.get("string")
        else:
            text = self.facts.get("text_mode")
        return None if text is None else text.rstrip("\r\n")


def _load() -> Iterator[Golden]:
    for dialect, file in FILES.items():
        path = Path(__file__).parent / "yarp" / file
        for facts in json.loads(path.read_text(encoding="utf-8"))["goldens"]:
            raw = bytes.fromhex(facts["hex"])
            yield Golden(dialect, facts["kind"], facts["name"], raw, facts)


GOLDENS = list(_load())

NOT_BOTTLES = {
    ("value", "list"): "a bare Value that holds a list repeats its header; YARP misreads it too",
    ("value", "null"): "the same",
    ("pointcloud", "XYZ 2x1"): "13 bytes of header come first",
    ("pointcloud", "XYZRGBA 1x1"): "the same",
}
NOT_CANONICAL = {
    ("value", "int32"): "a bare Value does not share the tag of its one element",
    ("value", "float64"): "the same",
    ("value", "vocab"): "the same",
    ("vector", "empty"): "an empty vector keeps its tag, an empty bottle has none",
    ("matrix", "0x0"): "the same",
    ("odometry", "OdometryData"): "a thrift struct does not share the tag of its nine float64",
}
OTHER_TEXT = {
    ("stamp", "max count, epoch time"): "a Stamp prints its time with 15 digits, a bottle with 21",
    ("pair", "Bottle [vmos] + Vector 1 2"): "a fault of the C++ writer: the text lacks the pair",
    ("pair", "Bottle [dpo] 3 + Vector 10.5"): "the same",
}
CHANGED_BY_TEXT = {
    "int8": "text has one kind of small integers",
    "int8 x2": "the same",
    "int64 small": "the same",
    "all types": "the same",
    "float32": "text has one kind of floats",
    "float32 x2": "the same",
    "vocab64 short": "up to four letters are a vocab32",
    "string true false null": "the word null is printed bare and reads as a vocab",
    "string and dict": "text has no dicts, only lists",
    "dict inside": "the same",
}


def goldens(*kinds: str, without: dict[tuple[str, str], str] | None = None) -> pytest.MarkDecorator:
    chosen = [
        golden
        for golden in GOLDENS
        if (not kinds or golden.kind in kinds) and golden.case not in (without or {})
    ]
    assert chosen
    ids = [f"{golden.dialect.name}-{golden.kind}-{golden.name}" for golden in chosen]
    return pytest.mark.parametrize("golden", chosen, ids=ids)


def exceptions(cases: dict[tuple[str, str], str]) -> pytest.MarkDecorator:
    chosen = [golden for golden in GOLDENS if golden.case in cases]
    assert {golden.case for golden in chosen} == cases.keys()
    ids = [f"{golden.dialect.name}-{golden.kind}-{golden.name}" for golden in chosen]
    return pytest.mark.parametrize("golden", chosen, ids=ids)


def test_all_goldens_are_here() -> None:
    assert [sum(golden.dialect is dialect for golden in GOLDENS) for dialect in FILES] == [129, 131]


@goldens(without=NOT_BOTTLES | NOT_CANONICAL)
def test_every_object_is_a_bottle_that_comes_back_byte_for_byte(golden: Golden) -> None:
    values = bottle.decode(golden.raw, golden.dialect)

    assert bottle.encode(values, golden.dialect) == golden.raw


@exceptions(NOT_CANONICAL)
def test_bottles_that_share_no_tag_are_read_and_come_back_as_the_same_values(
    golden: Golden,
) -> None:
    values = bottle.decode(golden.raw, golden.dialect)
    ours = bottle.encode(values, golden.dialect)

    assert ours != golden.raw
    assert bottle.decode(ours, golden.dialect) == values


@exceptions(NOT_BOTTLES)
def test_what_is_no_bottle_is_refused_as_one(golden: Golden) -> None:
    with pytest.raises(DecodeError):
        bottle.decode(golden.raw, golden.dialect)


NO_TEXT = {golden.case: "the library gave none" for golden in GOLDENS if golden.text is None}


@goldens(without=NOT_BOTTLES | OTHER_TEXT | NO_TEXT)
def test_text_carriers_carry_what_the_real_library_prints(golden: Golden) -> None:
    assert to_text(bottle.decode(golden.raw, golden.dialect), golden.dialect) == golden.text


@exceptions(OTHER_TEXT)
def test_texts_that_we_print_differently(golden: Golden) -> None:
    printed = to_text(bottle.decode(golden.raw, golden.dialect), golden.dialect)

    assert printed != golden.text


def test_strings_that_are_not_utf8_are_printed_as_they_are() -> None:
    for golden in GOLDENS:
        if golden.name == "string not utf8":
            printed = to_text(bottle.decode(golden.raw, golden.dialect), golden.dialect)
            assert printed.encode("utf-8", "surrogateescape").hex() == golden.facts["string_hex"]


@goldens("bottle_parse")
def test_text_is_read_as_the_real_library_reads_it(golden: Golden) -> None:
    values = from_text(golden.facts["input"], golden.dialect)

    assert len(values) == golden.facts["size"]
    assert bottle.encode(values, golden.dialect) == golden.raw


@goldens("bottle", "property")
def test_printed_bottles_read_back(golden: Golden) -> None:
    printed = to_text(bottle.decode(golden.raw, golden.dialect), golden.dialect)
    values = from_text(printed, golden.dialect)

    if golden.name in CHANGED_BY_TEXT:
        assert bottle.encode(values, golden.dialect) != golden.raw
    else:
        assert bottle.encode(values, golden.dialect) == golden.raw


# --- typed objects ---------------------------------------------------------------------------


class YarpObject(Protocol):
    def encode(self, dialect: Dialect) -> bytes: ...


DECODERS: dict[str, Callable[[Buffer, Dialect], YarpObject]] = {
    "vector": objects.Vector.decode,
    "matrix": objects.Matrix.decode,
    "quaternion": objects.Quaternion.decode,
    "image": objects.Image.decode,
    "sound": objects.Sound.decode,
    "stamp": objects.Stamp.decode,
    "pair": objects.Pair.decode,
    "jointData": objects.JointData.decode,
    "sensors": objects.SensorData.decode,
    "odometry": objects.OdometryData.decode,
    "vectorof_float": objects.VectorOf.decode,
    "vectorof_int": objects.VectorOf.decode,
    "laser": objects.LaserScan2D.decode,
    "pointcloud": objects.PointCloud.decode,
}
BOTTLES_ONLY = {"bottle", "bottle_parse", "property", "value"}


def test_every_kind_of_golden_has_a_type() -> None:
    assert {golden.kind for golden in GOLDENS} == DECODERS.keys() | BOTTLES_ONLY


@goldens(*DECODERS)
def test_objects_come_back_byte_for_byte(golden: Golden) -> None:
    encoded = DECODERS[golden.kind](golden.raw, golden.dialect).encode(golden.dialect)

    assert encoded == plain_quantum(golden)


def plain_quantum(golden: Golden) -> bytes:
    """Clear the one deliberate difference: YARP 3's flag in the word of an image's quantum.

    YARP 4 would take the flag for part of the number; YARP 3 does not miss it.
    """
    if golden.kind != "image":
        return golden.raw
    assert golden.raw[42:44] == (b"\1\0" if golden.dialect is Dialect.V3 else b"\0\0")
    return golden.raw[:42] + b"\0\0" + golden.raw[44:]


@goldens(*DECODERS)
def test_objects_cut_short_anywhere_are_refused(golden: Golden) -> None:
    for length in range(len(golden.raw)):
        with pytest.raises(DecodeError):
            DECODERS[golden.kind](golden.raw[:length], golden.dialect)


@goldens(*DECODERS)
def test_objects_with_any_byte_changed_are_refused_or_valid(golden: Golden) -> None:
    for position in range(len(golden.raw)):
        for mask in (0x01, 0x80, 0xFF):
            damaged = bytearray(golden.raw)
            damaged[position] ^= mask
            try:
                value = DECODERS[golden.kind](damaged, golden.dialect)
            except DecodeError:
                continue
            assert len(value.encode(golden.dialect)) == len(golden.raw)


@goldens(without=NOT_BOTTLES)
def test_bottles_with_any_byte_changed_are_refused_or_valid(golden: Golden) -> None:
    for position in range(len(golden.raw)):
        for mask in (0x01, 0x80, 0xFF):
            damaged = bytearray(golden.raw)
            damaged[position] ^= mask
            try:
                values = bottle.decode(damaged, golden.dialect)
            except DecodeError:
                continue
            bottle.encode(values, golden.dialect)


@goldens(without=NOT_BOTTLES)
def test_bottles_cut_short_anywhere_ask_for_no_more_than_is_missing(golden: Golden) -> None:
    for length in range(len(golden.raw)):
        with pytest.raises(bottle.Incomplete) as caught:
            bottle.decode_prefix(golden.raw[:length], 0, golden.dialect)
        assert 1 <= caught.value.missing_bytes <= len(golden.raw) - length


KINDS = {
    "bottle": "bottle",
    "property": "bottle",
    "image": "image",
    "jointData": "joint_data",
    "laser": "bottle",
    "matrix": "bottle",
    "odometry": "bottle",
    "pair": "bottle",
    "pointcloud": "point_cloud",
    "quaternion": "vector",
    "sensors": "sensor_data",
    "sound": "sound",
    "stamp": "bottle",
    "vector": "vector",
    "vectorof_float": "bottle",
    "vectorof_int": "bottle",
}


@goldens(*KINDS)
def test_a_stream_tells_what_it_carries(golden: Golden) -> None:
    expected = KINDS[golden.kind]
    if golden.kind == "bottle" and golden.name.startswith("float64"):
        expected = "vector"  # the same bytes

    assert objects.kind_of(golden.raw, golden.dialect) == expected


@goldens("image")
def test_images_have_the_sizes_of_the_real_library(golden: Golden) -> None:
    image = objects.Image.decode(golden.raw)
    facts = golden.facts

    assert image.width == facts.get("width", 0)
    assert image.height == facts.get("height", 0)
    assert image.quantum == facts.get("quantum", 0)
    if "row_size" in facts:
        assert image.pixel_code == facts["pixel_vocab"]
        assert image.row_bytes == facts["row_size"]
        assert len(image.pixels) == facts["raw_size"]
    if "pixels" in facts:  # k-th byte of the picture without its padding
        expected = bytes(k % 251 for k in range(1, len(image.packed_pixels()) + 1))
        assert bytes(image.packed_pixels()) == expected


# --- captured from running robots ------------------------------------------------------------

CAPTURED = json.loads(
    (Path(__file__).parent / "yarp" / "captured-3.12.json").read_text(encoding="utf-8")
)
ACKNOWLEDGEMENT = bytes.fromhex("5941000000005250")


@pytest.mark.parametrize("call", CAPTURED["calls"], ids=lambda call: call["command"])
def test_commands_that_people_typed_and_what_robots_replied(call: dict[str, str]) -> None:
    assert bottle.encode(from_text(call["command"])).hex() == call["request"]

    stream = bytes.fromhex(call["reply"])
    reply, end = bottle.decode_prefix(stream, 0)
    assert stream[end:] == ACKNOWLEDGEMENT
    assert bottle.encode(reply) == stream[:end]


@pytest.mark.parametrize("message", CAPTURED["streams"], ids=lambda message: message["case"])
def test_what_robots_streamed(message: dict[str, str]) -> None:
    payload = bytes.fromhex(message["payload"])

    assert DECODERS[message["type"]](payload, Dialect.V3).encode(Dialect.V3) == payload
    if message["envelope"]:
        stamp = objects.Stamp.from_envelope(message["envelope"])
        assert stamp.to_envelope() == message["envelope"]
