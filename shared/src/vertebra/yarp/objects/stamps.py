"""Stamps: when a message was true, and its number."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final, Self

from vertebra.yarp.objects.parts import YarpObject, damage
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import Dialect

_ENVELOPE: Final = re.compile(
    r"\s*([+-]?[0-9]{1,10})\s+([+-]?[0-9.]{1,40}(?:[eE][+-]?[0-9]{1,4})?)\s*"
)


@dataclass(frozen=True, slots=True)
class Stamp(YarpObject):
    """The count and the time of a message: usually its envelope, sometimes an object itself.

    Attributes:
        count: Number of the message at its sender.
        time_s: Seconds by the sender's clock, often since 1970.
    """

    count: int
    time_s: float

    def to_envelope(self) -> str:
        """Return the text beside a message; it resolves 10 us in times since 1970."""
        return f"{self.count:d} {self.time_s:.15g}"

    @classmethod
    def from_envelope(cls, text: str) -> Self:
        """Return the stamp that the text beside a message holds.

        Raises:
            DecodeError: It holds something else.
        """
        match = _ENVELOPE.fullmatch(text)
        try:
            if match is not None:
                return cls(int(match[1]), float(match[2]))
        except ValueError:  # such as 1.2.3
            pass
        raise damage("stamp", f"the envelope {text[:80]!r} is not a count and a time in seconds")

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the stamp as an object.

        Raises:
            EncodeError: The count is no int32.
        """
        return bottle.encode([self.count, float(self.time_s)], dialect)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the stamp in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        match bottle.decode(payload, dialect):
            case [int() as count, float() as time_s] if math.isfinite(time_s):
                return cls(count, time_s)
            case other:
                raise damage("stamp", f"{len(other)} values are not a count and a time in seconds")
