"""Every type of ROS 2 against the bytes and hashes that ROS itself made (golden_ros2.py)."""

from __future__ import annotations

import json
import tracemalloc
from typing import Any, Final

import pytest
from rosbags.typesys import Stores, get_typestore

from vertebra.errors import DecodeError
from vertebra.messages import Array
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types

from . import golden_ros2

TYPES: Final = Types.standard()
CDR: Final = Cdr(TYPES)
JAZZY: Final = get_typestore(Stores.ROS2_JAZZY)
HASHES: Final = json.loads((golden_ros2.FOLDER / "hashes.json").read_text())
_KNOWN: Final = json.loads((golden_ros2.FOLDER / "cdr.json").read_text())
GOLDEN: Final = {
    name: bytes.fromhex(digits) for known in _KNOWN.values() for name, digits in known.items()
}
every_type = pytest.mark.parametrize("name", sorted(GOLDEN))
MOST_BYTES: Final = 2 << 20


def plain(value: Any) -> Any:
    """Return a record with lists for arrays."""
    match value:
        case Array():
            return value.tolist()
        case dict():
            return {name: plain(item) for name, item in value.items()}
        case list():
            return [plain(item) for item in value]
    return value


def as_record(value: Any) -> Any:
    """Return what rosbags read, as a record."""
    if hasattr(value, "__msgtype__"):
        _, fields = JAZZY.fielddefs[value.__msgtype__]
        return {name: as_record(getattr(value, name)) for name, _ in fields}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [as_record(item) for item in value] if isinstance(value, list) else value


def test_every_type_has_its_bytes_and_most_are_of_ros() -> None:
    missing = sorted(set(filter(golden_ros2.is_made, TYPES)) - GOLDEN.keys())
    assert not missing, "run python tests/conformance/golden_ros2.py"
    assert len(_KNOWN["by_ros"]) >= 240


@every_type
def test_bytes_are_those_of_ros(name: str) -> None:
    record, golden = golden_ros2.record_of(TYPES, name), GOLDEN[name]
    assert plain(CDR.decode(golden, name)) == record
    big = golden_ros2.reference(TYPES, name, record, ">")
    assert plain(CDR.decode(big, name)) == record
    assert golden_ros2.reference(TYPES, name, record) == golden
    assert CDR.encode(record, name) == golden + bytes(-len(golden) % 4)


@pytest.mark.parametrize("name", sorted(GOLDEN.keys() & JAZZY.fielddefs.keys()))
def test_another_serialiser_reads_and_writes_the_same(name: str) -> None:
    theirs = JAZZY.deserialize_cdr(GOLDEN[name], name)
    assert as_record(theirs) == golden_ros2.record_of(TYPES, name)
    assert bytes(JAZZY.serialize_cdr(theirs, name)) == GOLDEN[name]


@pytest.mark.parametrize("name", sorted(HASHES))
def test_hash_is_that_of_rosidl(name: str) -> None:
    assert TYPES.hash_of(name) == f"RIHS01_{HASHES[name]}"


def is_refused(payload: bytes, name: str) -> bool:
    """Return whether a payload is damaged; any other error escapes."""
    try:
        record = CDR.decode(payload, name)
    except DecodeError:
        return True
    assert record.keys() == {field.name for field in TYPES.definition(name)}
    return False


@every_type
def test_every_cut_is_refused(name: str) -> None:
    golden = GOLDEN[name]
    assert all(is_refused(golden[:length], name) for length in range(len(golden)))
    assert not is_refused(golden + bytes(3), name)
    assert is_refused(golden + bytes(4), name)


@every_type
def test_damage_at_every_byte_is_refused_or_read(name: str) -> None:
    golden = GOLDEN[name]
    for position in range(len(golden)):
        for value in (0x00, 0xFF, golden[position] ^ 0x80):
            is_refused(golden[:position] + bytes([value]) + golden[position + 1 :], name)


@pytest.mark.parametrize("length", [0xFFFFFFFF, 0x00FFFFFF])
def test_no_length_takes_memory_that_its_bytes_do_not_fill(length: int) -> None:
    word = length.to_bytes(4, "little")
    for name, golden in GOLDEN.items():
        damaged = [
            golden[:place] + word + golden[place + 4 :] for place in range(4, len(golden) - 3, 4)
        ]
        tracemalloc.start()
        for payload in damaged:
            is_refused(payload, name)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < MOST_BYTES, name
