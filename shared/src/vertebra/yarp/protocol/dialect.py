"""Type tags of a Bottle on the wire, in the two dialects of YARP (`BottleImpl`, `Storable`).

YARP 4 renumbered the floats: its float32 wears the tag that was float64 in YARP 3. A connection
speaks one dialect from beginning to end and nothing in the handshake tells which.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

INT32: Final = 1
STRING: Final = 4
VOCAB32: Final = 9
BLOB: Final = 12
INT16: Final = 64
INT64: Final = 17
INT8: Final = 32
LIST: Final = 256
DICT: Final = 512  # a bit: the tag of a dict is LIST | DICT


class Dialect(Enum):
    """The YARP generation that a peer speaks; its value is (float32, float64, vocab64)."""

    V3 = (128, 10, None)
    V4 = (10, 20, 18)

    def __init__(self, float32: int, float64: int, vocab64: int | None) -> None:
        self.float32 = float32
        self.float64 = float64
        self.vocab64 = vocab64

    def __str__(self) -> str:
        return f"YARP {self.name[1:]}"
