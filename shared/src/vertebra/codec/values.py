"""Values of libraries inside messages: what a codec plugin for a library offers."""

from __future__ import annotations

import dataclasses
import datetime as dt
import decimal
import enum
import uuid
from collections.abc import Collection, Iterable
from importlib.metadata import EntryPoint
from typing import Any, Final, Protocol

import msgspec

from vertebra.errors import CodecNotFoundError, ConfigError, EncodeError
from vertebra.messages import Foreign

GROUP: Final = "vertebra.values"
_LEAVES: Final = frozenset({type(None), bool, int, float, str, bytes, bytearray, memoryview})
_ALTERED: Final = (
    dt.date,
    dt.time,
    dt.timedelta,
    decimal.Decimal,
    enum.Enum,
    msgspec.Struct,
    set,
    frozenset,
    uuid.UUID,
)


class ValueCodec(Protocol):
    """Packs values of one type of a library into plain values and back.

    It is listed as an entry point of the group `vertebra.values` whose name is the qualified name
    of that type (`numpy.ndarray`), which is also its tag on the wire. Subclasses are found by their
    bases. Nothing is imported before the first value of that type is seen.
    """

    def pack(self, value: Any) -> Any:
        """Return `value` as a nesting of plain values and `Array`; raise `EncodeError`."""
        ...

    def unpack(self, plain: Any) -> Any:
        """Return the value that `pack` was given; raise `DecodeError`. `plain` is untrusted."""
        ...


class ValueCodecs:
    """Value codecs by the qualified name of their type."""

    def __init__(self, found: Iterable[EntryPoint]) -> None:
        self._listed = list_entry_points(found)
        self._loaded: dict[str, ValueCodec] = {}

    def pack(self, value: Any) -> Foreign:
        """Return `value` in its packed form; raise `CodecNotFoundError` if no plugin knows it."""
        for base in type(value).__mro__:
            tag = f"{base.__module__}.{base.__qualname__}"
            if tag in self._listed:
                return Foreign(tag=tag, plain=self._load(tag).pack(value))
        raise CodecNotFoundError(
            f"no codec plugin for values of type {_name(type(value))}; "
            f"installed: {', '.join(sorted(self._listed)) or 'none'}"
        )

    def unpack(self, foreign: Foreign) -> Any:
        """Return the library's value, or `foreign` itself where no plugin knows its tag."""
        if foreign.tag not in self._listed:
            return foreign
        return self._load(foreign.tag).unpack(foreign.plain)

    def _load(self, tag: str) -> ValueCodec:
        if tag not in self._loaded:
            self._loaded[tag] = self._listed[tag].load()()
        return self._loaded[tag]


def list_entry_points(found: Iterable[EntryPoint]) -> dict[str, EntryPoint]:
    """Return entry points by name; raise `ConfigError` when two distributions claim one name."""
    listed: dict[str, EntryPoint] = {}
    for entry_point in found:
        rival = listed.setdefault(entry_point.name, entry_point)
        if rival.value != entry_point.value:
            raise ConfigError(
                f"{rival.value!r} and {entry_point.value!r} both claim {entry_point.name!r} "
                f"in {entry_point.group}; uninstall one of them"
            )
    return listed


def check_plain(value: Any) -> None:
    """Refuse what msgspec would turn into something else without a word, at any depth of `value`.

    Dates would come back as text, sets as lists, enumerations and data classes as what they hold.
    Tuples do come back as lists, as in JSON: they are how Python people write short lists.

    Raises:
        EncodeError: There is such a value.
        RecursionError: It is nested too deeply, or holds itself.
    """
    if isinstance(value, dict):
        _check_each(value)
        _check_each(value.values())
    elif isinstance(value, list | tuple):
        _check_each(value)
    else:
        _refuse_altered(value)


def _check_each(values: Collection[Any]) -> None:
    # Long lists of numbers are the common case, and so are looked through by C.
    if not _LEAVES.issuperset(map(type, values)):
        for value in values:
            if type(value) not in _LEAVES:
                check_plain(value)


def _refuse_altered(value: Any) -> None:
    if isinstance(value, _ALTERED) or dataclasses.is_dataclass(value):
        raise EncodeError(
            f"{value!r:.80} of type {_name(type(value))} would not come back as what it is; "
            "convert it to text, numbers, lists and dicts, or write a codec plugin for it"
        )


def _name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"
