"""One function for each direction of each type, made of those of its fields."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from typing_extensions import Buffer

from vertebra.errors import DecodeError, EncodeError
from vertebra.ros2.cdr.parts import BASES, HEADER_BYTES, Fault
from vertebra.ros2.cdr.reading import (
    Read,
    Source,
    array_reader,
    count_of,
    read_whole,
    record_reader,
    scalar_reader,
    source_of,
    text_reader,
    wide_text_reader,
)
from vertebra.ros2.cdr.writing import (
    Sink,
    Write,
    array_writer,
    check_bound,
    default_of,
    record_writer,
    scalar_writer,
    text_writer,
)
from vertebra.ros2.definitions import Types
from vertebra.ros2.interface_files import Field


class Cdr:
    """Reads and writes the messages of some types."""

    def __init__(self, types: Types) -> None:
        self._types = types
        self._readers: dict[str, Read] = {}
        self._writers: dict[str, Write] = {}
        self._least: dict[str, int] = {}

    def decode(self, payload: Buffer, type_name: str) -> dict[str, Any]:
        """Return the record in a payload; its arrays look at the payload.

        Raises:
            DecodeError: The payload is damaged, or of another type.
            CodecNotFoundError: The type is not known.
        """
        read = self._reader(type_name)
        view = _checked(payload, type_name)
        try:
            return read_whole(read, view)
        except Fault as fault:
            raise DecodeError(fault.told(type_name)) from None

    def size(self, payload: Buffer, type_name: str) -> int:
        """Return how many bytes of a payload are the message, whatever follows it.

        Raises:
            DecodeError: The payload is damaged, or of another type.
            CodecNotFoundError: The type is not known.
        """
        read = self._reader(type_name)
        view = _checked(payload, type_name)
        source = source_of(view)
        try:
            read(source)
        except Fault as fault:
            raise DecodeError(fault.told(type_name)) from None
        return HEADER_BYTES + source.position

    def encode(self, record: Mapping[str, Any], type_name: str) -> bytes:
        """Return the payload of a record; fields that it does not have are zero or empty.

        Raises:
            EncodeError: A field is unknown, or its value does not fit.
            CodecNotFoundError: The type is not known.
        """
        write = self._writer(type_name)
        sink = Sink()
        try:
            write(sink, record)
        except Fault as fault:
            raise EncodeError(fault.told(type_name)) from None
        return sink.whole()

    def _reader(self, type_name: str) -> Read:
        read = self._readers.get(type_name)
        if read is None:
            fields = tuple(
                (field.name, self._read_field(field)) for field in self._types.definition(type_name)
            )
            read = self._readers[type_name] = record_reader(fields)
        return read

    def _writer(self, type_name: str) -> Write:
        write = self._writers.get(type_name)
        if write is None:
            fields = {
                field.name: (self._write_field(field), default_of(field))
                for field in self._types.definition(type_name)
            }
            write = self._writers[type_name] = record_writer(fields)
        return write

    def _least_bytes(self, type_name: str) -> int:
        """Return how many bytes a value of a type has at least, padding aside."""
        if type_name in BASES:
            return struct.calcsize(BASES[type_name][0])
        if type_name in ("string", "wstring"):
            return 4
        if type_name not in self._least:
            self._least[type_name] = sum(
                4 if field.plural in ("sequence", "bounded")
                else max(field.count, field.plural == "one") * self._least_bytes(field.type)
                for field in self._types.definition(type_name)
            )  # fmt: skip
        return self._least[type_name]

    def _read_field(self, field: Field) -> Read:
        if field.plural == "one":
            return self._read_one(field)
        fixed = field.count if field.plural == "array" else None
        most = field.count if field.plural == "bounded" else None
        least_bytes = self._least_bytes(field.type)
        if field.type in BASES:
            return array_reader(field.type, fixed, most)
        read = self._read_one(field)

        def read_list(source: Source) -> list[Any]:
            count = count_of(source, fixed, most, least_bytes)
            items = []
            for index in range(count):
                try:
                    items.append(read(source))
                except Fault as fault:
                    raise fault.inside(f"[{index}]") from None
            return items

        return read_list

    def _read_one(self, field: Field) -> Read:
        if field.type in BASES:
            return scalar_reader(field.type)
        if field.type == "string":
            return text_reader(field.max_text)
        if field.type == "wstring":
            return wide_text_reader(field.max_text)
        return self._reader(field.type)

    def _write_field(self, field: Field) -> Write:
        if field.plural == "one":
            return self._write_one(field)
        fixed = field.count if field.plural == "array" else None
        most = field.count if field.plural == "bounded" else None
        if field.type in BASES:
            return array_writer(field.type, fixed, most)
        write = self._write_one(field)

        def write_list(sink: Sink, items: Sequence[Any]) -> None:
            if not isinstance(items, list | tuple):
                raise Fault(f"is a list, not {type(items).__name__}")
            if fixed is None:
                check_bound(len(items), most)
                sink.align(4)
                sink.put(len(items).to_bytes(4, "little"), 4)
            elif not items:
                items = [default_of(Field("", field.type))] * fixed
            elif len(items) != fixed:
                raise Fault(f"has {fixed} items, not {len(items)}")
            for index, item in enumerate(items):
                try:
                    write(sink, item)
                except Fault as fault:
                    raise fault.inside(f"[{index}]") from None

        return write_list

    def _write_one(self, field: Field) -> Write:
        if field.type in BASES:
            return scalar_writer(field.type)
        if field.type in ("string", "wstring"):
            return text_writer(field.max_text, wide=field.type == "wstring")
        return self._writer(field.type)


def _checked(payload: Buffer, type_name: str) -> memoryview:
    view = memoryview(payload).cast("B").toreadonly()
    if len(view) < HEADER_BYTES or view[0] or view[1] > 1:
        raise DecodeError(
            f"{type_name}: {bytes(view[:4]).hex(' ') or 'nothing'} is no header of XCDR1"
        )
    return view
