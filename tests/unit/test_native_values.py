"""What `Native` carries comes back as what it was, or is refused."""

from __future__ import annotations

import dataclasses
import datetime as dt
import decimal
import enum
import uuid
from typing import Any

import pytest

from vertebra.codec import CodecRegistry
from vertebra.errors import EncodeError
from vertebra.messages import Header, Native

HEADER = Header(captured_ns=1)


class Colour(enum.Enum):
    RED = 1


@dataclasses.dataclass
class Point:
    x: int = 0


def sent(value: Any) -> Any:
    codecs = CodecRegistry.installed()
    payload, encoding = codecs.encode(Native(value=value), HEADER)
    message, _ = codecs.decode(bytes(payload), encoding)
    assert isinstance(message, Native)
    return message.value


@pytest.mark.parametrize(
    "value",
    [
        dt.datetime(2026, 1, 1, tzinfo=dt.UTC),
        dt.date(2026, 1, 1),
        dt.time(1),
        dt.timedelta(1),
        decimal.Decimal("1.5"),
        uuid.UUID(int=1),
        {1, 2},
        frozenset({1}),
        Colour.RED,
        Point(),
    ],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("place", ["alone", "in a list", "in a dict", "deep"])
def test_what_would_come_back_as_something_else_is_refused(value: Any, place: str) -> None:
    nested = {
        "alone": value,
        "in a list": [1, value],
        "in a dict": {"a": 1, "b": value},
        "deep": [{"a": (1, [value])}],
    }[place]
    with pytest.raises(EncodeError, match="would not come back as what it is"):
        sent(nested)


def test_a_key_is_looked_at_as_well() -> None:
    with pytest.raises(EncodeError, match="would not come back as what it is"):
        sent({dt.date(2026, 1, 1): 1})


def test_tuples_come_back_as_lists() -> None:
    assert sent({"size": (640, 480)}) == {"size": [640, 480]}


def test_a_list_that_holds_itself_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(EncodeError, match="recursion"):
        sent(endless)
