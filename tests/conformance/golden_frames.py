"""The golden frames: cases that people write as JSON, and the bytes that they stand for.

    frames/<case>.json          a message and its header: every writer makes <case>.bin from it,
                                every reader reads it back from there
    frames/foreign/<case>.json  what other, past or future writers may write: read only; a case
                                whose message got new fields goes there as `<case>-first`
    frames/damaged/<case>.json  refused, with `error` and with `reason` in its text; those with
                                `"needs": "schemas"` only by readers that know the message types

Numbers are strings, so that no JSON parser rounds them. In values `{"$int": "5"}`,
`{"$float": "0.5"}`, `{"$bytes": "00 ff"}` and `{"$map": [[key, value], ...]}` say their types;
`{"$array": {...}}` and `{"$foreign": {...}}` are the extension types of FRAME.md. Arrays have
`items` in C order, or `bytes` where their type has no numbers. Where a writer of ours would not
write it, `written` is the header as it stands (`$msgpack`: verbatim), `of` names another case,
and `changes` are made to the bytes of either.

The writer in this file is slow, obvious, and shares no code with the one under test. Run it by
hand after writing a case; a frame that exists is rewritten only with `--update`, because frames of
past releases never change:

    python tests/conformance/golden_frames.py [--update]
"""

from __future__ import annotations

import json
import math
import struct
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).parent / "frames"
LETTERS: Final = {
    "b1": "?", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I",
    "u8": "Q", "f4": "f", "f8": "d",
}  # fmt: skip
"""Letters of `struct` for the item types that have `items`."""


@dataclass(frozen=True, slots=True)
class Case:
    """One golden frame."""

    path: Path
    document: dict[str, Any]

    @property
    def name(self) -> str:
        """The folder below frames/, if any, and the file's stem."""
        return self.path.relative_to(FOLDER).with_suffix("").as_posix()

    @property
    def frame(self) -> bytes:
        """The committed bytes."""
        return self.path.with_suffix(".bin").read_bytes()


def cases(folder: str = ".") -> list[Case]:
    """Return the cases in one folder, sorted by name."""
    paths = sorted((FOLDER / folder).glob("*.json"))
    return [Case(path, json.loads(path.read_text(encoding="utf-8"))) for path in paths]


def frame_of(document: dict[str, Any]) -> bytes:
    """Return the frame that a case describes, by FRAME.md alone."""
    if "of" in document:
        frame = (FOLDER / document["of"]).with_suffix(".bin").read_bytes()
    else:
        frame = _written(document)
    return _changed(frame, document.get("changes", ()))


def _written(document: dict[str, Any]) -> bytes:
    buffers: list[bytes] = []
    if "written" in document:
        header = dict(document["written"])
    else:
        given = document["header"]
        header = {"schema": document["schema"]}
        for key in ("captured_ns", "sequence"):
            if given[key] != "0":
                header[key] = {"$int": given[key]}
        if given["origin"]:
            header["origin"] = given["origin"]
        if given["hops"] != "0":
            header["hops"] = {"$int": given["hops"]}
        header["fields"] = document["message"]
    # Buffers are numbered while the header is packed, so their table comes last.
    packed = {key: _pack(value, buffers) for key, value in header.items()}
    if buffers and "buffers" not in packed:
        packed["buffers"] = _pack([{"$int": str(len(buffer))} for buffer in buffers], [])
    body = _head(len(packed), 0x80, 16, (None, 0xDE, 0xDF))
    for key, value in packed.items():
        body += _pack(key, []) + value
    frame = b"VTB\x01" + struct.pack("<I", len(body)) + body
    for buffer in buffers:
        frame += bytes(-len(frame) % 64) + buffer
    return frame


def _changed(original: bytes, changes: Iterable[dict[str, str]]) -> bytes:
    frame = bytearray(original)
    for change in changes:
        if "cut_to" in change:
            del frame[int(change["cut_to"]) :]
        elif "append" in change:
            frame += bytes.fromhex(change["append"])
        else:
            new = bytes.fromhex(change["bytes"])
            offset = int(change["offset"])
            frame[offset : offset + len(new)] = new
    return bytes(frame)


def _pack(value: Any, buffers: list[bytes]) -> bytes:
    match value:
        case None:
            return b"\xc0"
        case bool():
            return b"\xc3" if value else b"\xc2"
        case str():
            text = value.encode()
            return _head(len(text), 0xA0, 32, (0xD9, 0xDA, 0xDB)) + text
        case list():
            head = _head(len(value), 0x90, 16, (None, 0xDC, 0xDD))
            return head + b"".join(_pack(item, buffers) for item in value)
        case {"$int": digits}:
            return _pack_int(int(digits))
        case {"$float": number}:
            return b"\xcb" + struct.pack(">d", float(number))
        case {"$bytes": digits}:
            data = bytes.fromhex(digits)
            return _head(len(data), 0, 0, (0xC4, 0xC5, 0xC6)) + data
        case {"$msgpack": digits}:  # whatever a foreign writer may write
            return bytes.fromhex(digits)
        case {"$map": pairs}:
            head = _head(len(pairs), 0x80, 16, (None, 0xDE, 0xDF))
            return head + b"".join(_pack(item, buffers) for pair in pairs for item in pair)
        case {"$array": array}:
            buffers.append(bytes_of(array))
            shape = [{"$int": length} for length in array["shape"]]
            reference = [{"$int": str(len(buffers) - 1)}, array["dtype"], shape]
            return _pack_extension(1, _pack(reference, buffers))
        case {"$foreign": foreign}:
            return _pack_extension(2, _pack([foreign["tag"], foreign["plain"]], buffers))
        case dict():
            return _pack({"$map": [[key, item] for key, item in value.items()]}, buffers)
    raise TypeError(f"{value!r} is no value of a golden frame")


def _pack_int(value: int) -> bytes:
    if -32 <= value <= 127:
        return struct.pack("b", value)
    unsigned = ((0xCC, ">B"), (0xCD, ">H"), (0xCE, ">I"), (0xCF, ">Q"))
    signed = ((0xD0, ">b"), (0xD1, ">h"), (0xD2, ">i"), (0xD3, ">q"))
    for code, form in unsigned if value >= 0 else signed:
        try:
            return bytes([code]) + struct.pack(form, value)
        except struct.error:
            continue
    raise OverflowError(f"{value} does not fit into 64 bits")


def _pack_extension(code: int, body: bytes) -> bytes:
    fixed = {1: 0xD4, 2: 0xD5, 4: 0xD6, 8: 0xD7, 16: 0xD8}
    if len(body) in fixed:
        head = bytes([fixed[len(body)]])
    else:
        head = _head(len(body), 0, 0, (0xC7, 0xC8, 0xC9))
    return head + bytes([code]) + body


def _head(
    length: int, small: int, small_below: int, codes: tuple[int | None, int | None, int | None]
) -> bytes:
    """Return the head of a string, list, map or extension in its shortest form."""
    if length < small_below:
        return bytes([small | length])
    for code, form, end in zip(codes, (">B", ">H", ">I"), (1 << 8, 1 << 16, 1 << 32), strict=True):
        if code is not None and length < end:
            return bytes([code]) + struct.pack(form, length)
    raise OverflowError(f"MessagePack counts to 2^32, not to {length}")


def bytes_of(array: dict[str, Any]) -> bytes:
    """Return the buffer of a `$array`."""
    if "bytes" in array:
        return bytes.fromhex(array["bytes"])
    order = array["dtype"][0].replace("|", "<")
    convert = float if array["dtype"][1] == "f" else int
    return b"".join(
        struct.pack(order + LETTERS[array["dtype"][1:]], convert(item)) for item in array["items"]
    )


def items_of(data: bytes, dtype: str) -> list[str]:
    """Return the numbers in a buffer as `items` has them."""
    form = dtype[0].replace("|", "<") + LETTERS[dtype[1:]]
    items = [item for (item,) in struct.iter_unpack(form, data)]
    return [number(item) if isinstance(item, float) else str(int(item)) for item in items]


def number(value: float) -> str:
    """Return a float as Python and JavaScript both read it."""
    return "NaN" if math.isnan(value) else repr(value).replace("inf", "Infinity")


def main() -> None:
    """Write the frames of all cases."""
    update = sys.argv[1:] == ["--update"]
    for case in cases() + cases("foreign") + cases("damaged"):
        path = case.path.with_suffix(".bin")
        frame = frame_of(case.document)
        if path.exists() and path.read_bytes() != frame and not update:
            sys.exit(f"{path} would change; a released frame never does. Force it with --update")
        path.write_bytes(frame)


if __name__ == "__main__":
    main()
