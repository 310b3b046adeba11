"""What every codec plugin has to do, as suites that its tests subclass.

Bytes that a release wrote are kept for ever in `<folder>/<release>/<case>.bin` and must be read by
all later ones. `VERTEBRA_WRITE_GOLDENS=1` makes the tests write those that are missing; they never
change one that exists.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar, Final

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vertebra.codec import Codec, CodecRegistry, FrameCodec, ValueCodec, ValueCodecs
from vertebra.errors import DecodeError, EncodeError
from vertebra.messages import Array, Foreign, Header, Message, Native

_WITHOUT_PLUGINS: Final = FrameCodec()
_HOSTILE: Final[Sequence[Any]] = [
    None, True, 1, 1.5, "", "x", b"", [], [1, [2]], {}, {"": None}, {1: 2},
    [Array(bytes(4), "<i4", (1,))], {"unknown": Array(bytes(4), "<i4", (1,))},
]  # fmt: skip


def goldens(folder: Path, release: str, cases: Mapping[str, Callable[[], bytes]]) -> Iterator[Path]:
    """Yield the golden files of all releases; write those of `release` that are missing.

    Args:
        folder: Where the releases lie.
        release: The release under test.
        cases: What it writes, by the name of the case.
    """
    for name, write in cases.items():
        path = folder / release / f"{name}.bin"
        if not path.exists():
            assert os.environ.get("VERTEBRA_WRITE_GOLDENS"), (
                f"{path} is missing; VERTEBRA_WRITE_GOLDENS=1 writes it"
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(write())
    yield from sorted(folder.glob("*/*.bin"))


class ValueCodecSuite(ABC):
    """What values of a library must survive: frames, other releases, damage, missing plugins.

    Attributes:
        tag: Name of the entry point under test.
        release: The release under test, for its golden frames.
        folder: Where the golden frames of all releases lie.
        values: What must come back the same, by the name of its case.
        refused: What has no form, and what the error says about it.
        hostile: Packed forms that nobody made, refused in addition to the usual ones.
    """

    tag: ClassVar[str]
    release: ClassVar[str]
    folder: ClassVar[Path]
    values: ClassVar[Mapping[str, Any]]
    refused: ClassVar[Sequence[tuple[Any, str]]]
    hostile: ClassVar[Sequence[Any]] = ()

    @abstractmethod
    def same(self, value: Any, other: Any) -> bool:
        """Say whether two values are the same in everything that the codec carries."""

    @abstractmethod
    def any_value(self) -> st.SearchStrategy[Any]:
        """Return a strategy for values that have a form."""

    def touch(self, value: Any) -> None:
        """Look at all of a value that was decoded: nothing may be wrong with it later."""
        repr(value)

    @pytest.fixture
    def frames(self) -> FrameCodec:
        return _installed()

    def test_plugin_is_found_by_its_entry_point(self) -> None:
        found = entry_points(group="vertebra.values")
        codec: ValueCodec = found[self.tag].load()()
        for value in self.values.values():
            assert self.same(codec.unpack(codec.pack(value)), value)

    def test_values_come_back_the_same_in_a_frame(self, frames: FrameCodec) -> None:
        nested = Native(value={"all": [*self.values.values()], "none": None})
        message, _ = frames.decode(bytes(frames.encode(nested, Header())))
        assert isinstance(message, Native)
        assert message.value["none"] is None
        for value, other in zip(self.values.values(), message.value["all"], strict=True):
            assert self.same(other, value), (other, value)

    @given(data=st.data())
    @settings(suppress_health_check=[HealthCheck.differing_executors], deadline=None)
    def test_any_value_comes_back_the_same(self, data: st.DataObject) -> None:
        frames = _installed()
        value = data.draw(self.any_value())
        frame = bytes(frames.encode(Native(value=value), Header()))
        assert self.same(_value(frames, frame), value)

    def test_frames_of_all_releases_are_read(self, frames: FrameCodec) -> None:
        seen = set()
        for path in self.goldens(frames):
            value = self.values.get(path.stem)
            assert value is not None, f"{path} is a case of the past: keep it in `values`"
            assert self.same(_value(frames, path.read_bytes()), value), path
            seen.add(path.stem)
        assert seen == set(self.values)

    def test_this_release_writes_its_frames_byte_for_byte(self, frames: FrameCodec) -> None:
        for path in self.goldens(frames):
            if path.parent.name == self.release:
                assert self.frame(frames, path.stem) == path.read_bytes(), path

    def goldens(self, frames: FrameCodec) -> Iterator[Path]:
        """Yield the golden frames of all releases."""
        cases = {name: lambda name=name: self.frame(frames, name) for name in self.values}
        return goldens(self.folder, self.release, cases)

    def frame(self, frames: FrameCodec, case: str) -> bytes:
        """Return the frame of one case."""
        return bytes(frames.encode(Native(value=self.values[case]), Header()))

    def test_frame_cut_anywhere_is_refused(self, frames: FrameCodec) -> None:
        for path in self.goldens(frames):
            frame = path.read_bytes()
            for length in range(len(frame)):
                with pytest.raises(DecodeError):
                    frames.decode(frame[:length])

    def test_damage_at_any_byte_is_an_error_or_another_value(self, frames: FrameCodec) -> None:
        for path in self.goldens(frames):
            for damaged in _damaged(path.read_bytes()):
                try:
                    value = _value(frames, damaged)
                except (DecodeError, LookupError):
                    continue
                if not isinstance(value, Foreign):
                    self.touch(value)

    def test_packed_forms_that_nobody_made_are_refused(self) -> None:
        codec: ValueCodec = entry_points(group="vertebra.values")[self.tag].load()()
        for plain in [*_HOSTILE, *self.hostile]:
            with pytest.raises(DecodeError):
                pytest.fail(f"{plain!r} became {codec.unpack(plain)!r}")

    def test_what_has_no_form_is_refused_with_a_remedy(self, frames: FrameCodec) -> None:
        for value, remedy in self.refused:
            with pytest.raises(EncodeError, match=remedy):
                frames.encode(Native(value=value), Header())

    def test_values_pass_unchanged_where_the_plugin_is_not_installed(
        self, frames: FrameCodec
    ) -> None:
        for path in self.goldens(frames):
            frame = path.read_bytes()
            value = _value(_WITHOUT_PLUGINS, frame)
            assert isinstance(value, Foreign)
            assert value.tag == self.tag
            assert bytes(_WITHOUT_PLUGINS.encode(Native(value=value), Header())) == frame


class CodecSuite(ABC):
    """What a codec for an encoding must do: messages, other releases, damage.

    Attributes:
        encoding: The media type; its entry point has dots for slashes.
        release: The release under test, for its golden payloads.
        folder: Where the golden payloads of all releases lie.
        messages: What must come back the same, by the name of its case.
        refused: What has no form, and what the error says about it.
        foreign: Payloads of others, and the message in each or, as a text, why it is refused.
    """

    encoding: ClassVar[str]
    release: ClassVar[str]
    folder: ClassVar[Path]
    messages: ClassVar[Mapping[str, Message]]
    refused: ClassVar[Sequence[tuple[Message, str]]]
    foreign: ClassVar[Sequence[tuple[bytes, Message | str]]]

    @abstractmethod
    def any_message(self) -> st.SearchStrategy[Message]:
        """Return a strategy for messages that have a form."""

    @pytest.fixture
    def codec(self) -> Codec:
        return self._load()

    def _load(self) -> Codec:
        loaded: Codec = entry_points(group="vertebra.codecs")[
            self.encoding.replace("/", ".")
        ].load()()
        return loaded

    def test_plugin_is_found_by_its_entry_point(self, codec: Codec) -> None:
        assert codec.encoding == self.encoding
        codecs = CodecRegistry.installed()
        for message in self.messages.values():
            payload, encoding = codecs.encode(message, Header(), self.encoding)
            assert encoding == self.encoding
            assert codecs.decode(bytes(payload), encoding) == (message, Header())

    @given(data=st.data())
    @settings(suppress_health_check=[HealthCheck.differing_executors], deadline=None)
    def test_any_message_comes_back_the_same(self, data: st.DataObject) -> None:
        codec = self._load()
        message = data.draw(self.any_message())
        payload = bytes(codec.encode(message, Header(captured_ns=1)))
        assert codec.decode(payload) == (message, Header())

    def test_payloads_of_all_releases_are_read(self, codec: Codec) -> None:
        seen = set()
        for path in self.goldens(codec):
            assert codec.decode(path.read_bytes()) == (self.messages[path.stem], Header()), path
            seen.add(path.stem)
        assert seen == set(self.messages)

    def goldens(self, codec: Codec) -> Iterator[Path]:
        """Yield the golden payloads of all releases."""
        cases = {
            name: lambda message=message: bytes(codec.encode(message, Header()))
            for name, message in self.messages.items()
        }
        return goldens(self.folder, self.release, cases)

    def test_payload_cut_or_extended_anywhere_is_refused(self, codec: Codec) -> None:
        for path in self.goldens(codec):
            payload = path.read_bytes()
            for length in range(len(payload)):
                with pytest.raises(DecodeError):
                    codec.decode(payload[:length])
            with pytest.raises(DecodeError):
                codec.decode(payload + b"\0")

    def test_damage_at_any_byte_is_an_error_or_another_message(self, codec: Codec) -> None:
        for path in self.goldens(codec):
            for damaged in _damaged(path.read_bytes()):
                try:
                    message, _ = codec.decode(damaged)
                except DecodeError:
                    continue
                assert isinstance(message, Message)

    def test_payloads_of_others_are_read_or_refused_with_the_reason(self, codec: Codec) -> None:
        for payload, expected in self.foreign:
            if isinstance(expected, str):
                with pytest.raises(DecodeError, match=expected):
                    pytest.fail(f"{payload!r:.100} became {codec.decode(payload)!r}")
            else:
                assert codec.decode(payload) == (expected, Header())

    def test_what_has_no_form_is_refused_with_a_remedy(self, codec: Codec) -> None:
        for message, remedy in self.refused:
            with pytest.raises(EncodeError, match=remedy):
                codec.encode(message, Header())

    def test_payload_may_be_any_buffer(self, codec: Codec) -> None:
        for message in self.messages.values():
            payload = bytearray(bytes(codec.encode(message, Header())))
            assert codec.decode(payload) == (message, Header())
            assert codec.decode(memoryview(payload)) == (message, Header())


def _installed() -> FrameCodec:
    return FrameCodec(values=ValueCodecs(entry_points(group="vertebra.values")))


def _value(frames: FrameCodec, frame: bytes) -> Any:
    message, _ = frames.decode(frame)
    assert isinstance(message, Native)
    return message.value


def _damaged(payload: bytes) -> Iterator[bytes]:
    """Yield the payload with each byte changed in three ways."""
    for offset, byte in enumerate(payload):
        for changed in {byte ^ 0x01, byte ^ 0x80, 0xFF - byte}:
            yield payload[:offset] + bytes([changed]) + payload[offset + 1 :]
