"""The dialect of a payload shows in its bytes: held against all objects of both real libraries."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.yarp import Dialect, encode
from vertebra.yarp.protocol.hints import dialect_of

FOLDER = Path(__file__).parent / "yarp"


def load(file: str) -> dict[tuple[str, str], bytes]:
    facts = json.loads((FOLDER / file).read_text(encoding="utf-8"))["goldens"]
    return {(one["kind"], one["name"]): bytes.fromhex(one["hex"]) for one in facts}


OBJECTS = {Dialect.V3: load("objects-3.12.json"), Dialect.V4: load("objects-4.0.json")}
BOTH = sorted(OBJECTS[Dialect.V3].keys() & OBJECTS[Dialect.V4].keys())
SAME_BYTES_OF_OTHER_TYPES = {
    ("value", "list"): "a bare Value that holds a list repeats its header; YARP misreads it too",
    ("vector", "empty"): "no item says how long an item is",
    ("matrix", "0x0"): "the same",
}


@pytest.mark.parametrize("case", BOTH, ids="-".join)
@pytest.mark.parametrize("dialect", Dialect)
def test_what_differs_is_told_apart(case: tuple[str, str], dialect: Dialect) -> None:
    raw = OBJECTS[dialect][case]
    differs = OBJECTS[Dialect.V3][case] != OBJECTS[Dialect.V4][case]
    differs &= case[0] != "image"  # the flag in its quantum harms no reader of ours

    if case in SAME_BYTES_OF_OTHER_TYPES:
        assert dialect_of(raw) in (dialect, None)
    else:
        assert dialect_of(raw) == (dialect if differs else None)


@given(st.binary(max_size=80))
def test_rubbish_is_of_no_dialect_or_of_one(raw: bytes) -> None:
    assert dialect_of(raw) in (None, *Dialect)


@pytest.mark.parametrize("dialect", Dialect)
def test_endless_counts_and_depths_end(dialect: Dialect) -> None:
    assert dialect_of(bytes.fromhex("00010000 ffffff7f 00010000 ffffff7f")) is None
    assert dialect_of(bytes.fromhex("0a010000 ffffff7f") + bytes(64)) is None
    assert dialect_of(bytes.fromhex("00010000 01000000") * 5000) is None
    assert dialect_of(encode([[[1.5]]], dialect)) is dialect
