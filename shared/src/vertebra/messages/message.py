"""What every message is, and the header that travels with it."""

from __future__ import annotations

from typing import ClassVar

from msgspec import Struct


class Message(Struct, frozen=True, kw_only=True):
    """Base of all message types.

    Evolution: a new field needs a default; readers ignore fields they do not know; anything else
    is a new major `VERSION`, and a reader refuses a major it does not know.
    """

    VERSION: ClassVar[int] = 1

    @classmethod
    def schema(cls) -> str:
        """Return the name of this schema, `vertebra/<Type>/<major>`."""
        return f"vertebra/{cls.__name__}/{cls.VERSION}"


class Header(Struct, frozen=True, kw_only=True):
    """Where and when a message came to be.

    Attributes:
        captured_ns: When the content was true (UTC, nanoseconds since 1970), not when it was sent.
        sequence: Counts the messages of one publisher from 0.
        origin: Who made it, for example `yarp:/vizzy/head/state:o`; bridges keep it.
        hops: How many bridges it has crossed.
    """

    captured_ns: int = 0
    sequence: int = 0
    origin: str = ""
    hops: int = 0
