"""What reading and writing have in common."""

from __future__ import annotations

from typing import Final, Self

HEADER: Final = b"\x00\x01\x00\x00"
"""XCDR1, little endian."""
HEADER_BYTES: Final = 4
PADDING_BYTES: Final = 3
"""DDS samples are whole multiples of 4 bytes."""
BASES: Final[dict[str, tuple[str, str]]] = {
    "bool": ("?", "|b1"), "byte": ("B", "|u1"), "int8": ("b", "|i1"), "uint8": ("B", "|u1"),
    "int16": ("h", "<i2"), "uint16": ("H", "<u2"), "int32": ("i", "<i4"), "uint32": ("I", "<u4"),
    "int64": ("q", "<i8"), "uint64": ("Q", "<u8"), "float32": ("f", "<f4"), "float64": ("d", "<f8"),
}  # fmt: skip
"""struct's letter and NumPy's type string of each primitive of fixed size."""


class Fault(Exception):  # noqa: N818  - becomes a DecodeError or an EncodeError
    """What is wrong, and in which field: the innermost first."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.path: list[str] = []

    def inside(self, name: str) -> Self:
        """Note what the fault is part of."""
        self.path.append(name)
        return self

    def told(self, type_name: str) -> str:
        """Return it in words."""
        path = "".join(part if part[0] == "[" else f".{part}" for part in reversed(self.path))
        return f"{type_name}{path}: {self}"
