"""The codec registry with faked installations, and the codecs that are built in."""

from __future__ import annotations

import math
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typing_extensions import Buffer

from vertebra.codec import ENCODING, CodecRegistry, encoding_of, to_json_value
from vertebra.codec.builtin import MAX_JSON_ITEMS
from vertebra.errors import CodecNotFoundError, ConfigError, DecodeError, EncodeError
from vertebra.messages import (
    Array,
    CompressedImage,
    Header,
    Image,
    Imu,
    JointState,
    Message,
    Native,
    Tensor,
    Text,
)

HEADER = Header(captured_ns=1_700_000_000_000_000_000, sequence=7, origin="test", hops=1)
JPEG = b"\xff\xd8\xff\xe0 not much of a picture \xff\xd9"


class ReverseCodec:
    """Text, backwards: what a plugin looks like."""

    encoding = "text/x-reverse"

    def encode(self, message: Message, header: Header) -> bytes:
        assert isinstance(message, Text)
        return message.text[::-1].encode()

    def decode(self, payload: Buffer) -> tuple[Message, Header]:
        return Text(text=bytes(payload).decode()[::-1]), Header()


class Celsius:
    def __init__(self, degrees: float) -> None:
        self.degrees = degrees


class CelsiusCodec:
    def pack(self, value: Celsius) -> Any:
        return value.degrees

    def unpack(self, plain: Any) -> Celsius:
        return Celsius(plain)


def codec(name: str, value: str) -> EntryPoint:
    return EntryPoint(name, value, "vertebra.codecs")


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the path that holds a distribution with entry points, and nothing else."""
    installed = tmp_path / "reverse-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: reverse\nVersion: 0.1\n")
    (installed / "entry_points.txt").write_text(
        "[vertebra.codecs]\ntext.x-reverse = reverse_plugin:ReverseCodec\n"
        "[vertebra.values]\nthermo.Celsius = reverse_plugin:CelsiusCodec\n"
    )
    (tmp_path / "reverse_plugin.py").write_text(
        "raise AssertionError('imported before it was needed')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_plugins_of_installed_distributions_are_found_and_not_yet_imported(plugins: Path) -> None:
    registry = CodecRegistry.installed()
    assert "text/x-reverse" in registry.encodings
    with pytest.raises(AssertionError, match="before it was needed"):
        registry.decode(b"", "text/x-reverse")


def test_a_plugin_reads_and_writes_its_encoding() -> None:
    registry = CodecRegistry([codec("text.x-reverse", f"{__name__}:ReverseCodec")])
    assert registry.encode(Text(text="abc"), HEADER, "text/x-reverse") == (b"cba", "text/x-reverse")
    assert registry.decode(b"cba", "text/x-reverse; charset=utf-8")[0] == Text(text="abc")


def test_rivals_are_refused_and_named() -> None:
    with pytest.raises(ConfigError, match=r"'a:A' and 'b:B' both claim 'image\.png'") as caught:
        CodecRegistry([codec("image.png", "a:A"), codec("image.png", "b:B")])
    assert "uninstall one" in str(caught.value)


def test_the_same_distribution_seen_twice_is_no_rival() -> None:
    registry = CodecRegistry([codec("image.png", "a:A"), codec("image.png", "a:A")])
    assert "image/png" in registry.encodings


def test_a_plugin_does_not_replace_what_is_built_in() -> None:
    with pytest.raises(ConfigError, match="built-in encoding 'image/jpeg'"):
        CodecRegistry([codec("image.jpeg", "a:A")])


def test_an_import_error_of_a_plugin_is_not_hidden() -> None:
    registry = CodecRegistry([codec("image.png", "no_such_package:Codec")])
    with pytest.raises(ModuleNotFoundError, match="no_such_package"):
        registry.decode(b"", "image/png")


@pytest.mark.parametrize("encoding", ["", "image/webp", "text", "application/json5"])
def test_an_unknown_encoding_is_refused_with_what_is_known(encoding: str) -> None:
    registry = CodecRegistry()
    with pytest.raises(CodecNotFoundError, match="installed: application/json") as caught:
        registry.decode(b"", encoding)
    assert repr(encoding) in str(caught.value)
    with pytest.raises(CodecNotFoundError):
        registry.encode(Text(text=""), HEADER, encoding)


def test_the_encoding_of_a_frame_names_its_schema() -> None:
    payload, encoding = CodecRegistry().encode(Text(text="hello"), HEADER)
    assert encoding == encoding_of(Text) == f"{ENCODING};Text/1"
    assert CodecRegistry().decode(bytes(payload), encoding) == (Text(text="hello"), HEADER)


class TestJson:
    def encode(self, message: Message) -> bytes:
        payload, encoding = CodecRegistry().encode(message, HEADER, "application/json")
        assert encoding == "application/json"
        return bytes(payload)

    def decode(self, payload: bytes) -> tuple[Message, Header]:
        return CodecRegistry().decode(payload, "application/json")

    @pytest.mark.parametrize(
        "message",
        [
            Text(text="grüezi", language="de-CH"),
            Imu(orientation_xyzw=(0.0, 0.0, 0.0, 1.0), frame_id="imu"),
            JointState(names=("a", "b"), positions_deg=(1.5, -2.0)),
            Tensor(array=Array(bytes(range(12)), "<u2", (2, 3))),
            Tensor(array=Array(b"", "<f8", (0, 3))),
            Image(pixels=Array(bytes(18), "|u1", (2, 3, 3)), pixel_format="rgb8"),
            Native(value={"a": [1, 2.5, None, True, "x"], "b": {}}),
        ],
        ids=lambda message: type(message).__name__,
    )
    def test_a_message_comes_back_with_its_header(self, message: Message) -> None:
        assert self.decode(self.encode(message)) == (message, HEADER)

    json_values = st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**53), 2**53)
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )

    @given(json_values)
    def test_any_document_without_schema_is_a_native(self, value: Any) -> None:
        if isinstance(value, dict):
            value.pop("schema", None)
        message, header = self.decode(msgspec.json.encode(value))
        assert isinstance(message, Native)
        assert header == Header()
        assert msgspec.json.encode(message.value) == msgspec.json.encode(value)

    def test_bytes_are_lists_of_numbers_not_base64(self) -> None:
        assert to_json_value(Native(value=b"\0\xff")) == {"value": {"bytes": [0, 255]}}

    def test_a_large_array_is_refused(self) -> None:
        size = MAX_JSON_ITEMS + 1
        with pytest.raises(EncodeError, match="ask for the frame encoding"):
            self.encode(Tensor(array=Array(bytes(size), "|u1", (size,))))
        with pytest.raises(EncodeError, match="ask for the frame encoding"):
            self.encode(Native(value=bytes(size)))

    def test_a_value_without_a_form_is_refused(self) -> None:
        with pytest.raises(EncodeError, match="has no JSON"):
            self.encode(Native(value=object()))
        loop: list[Any] = []
        loop.append(loop)
        with pytest.raises(EncodeError):
            self.encode(Native(value=loop))

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "{",
            "nul",
            "[1,]",
            '{"schema": 7}',
            '{"schema": {"a": 1}}',
            '{"schema": "x/Y/1"}',
            '{"schema": "vertebra/Text/1"}',
            '{"schema": "vertebra/Text/1", "message": {"text": 7}}',
            '{"schema": "vertebra/Text/2", "message": {"text": ""}}',
            '{"schema": "vertebra/Text/1", "message": {"text": ""}, "sequence": "x"}',
            '{"schema": "vertebra/JointState/1", "message": {"names": ["a"], "positions_deg": []}}',
        ],
    )
    def test_damage_is_refused(self, text: str) -> None:
        with pytest.raises(DecodeError):
            self.decode(text.encode())

    @pytest.mark.parametrize(
        "array",
        [
            "[1, 2]",
            '{"dtype": "|u1", "shape": [2], "items": [1, 300]}',
            '{"dtype": "|u1", "shape": [3], "items": [1, 2]}',
            '{"dtype": "|u1", "shape": ["a"], "items": [1]}',
            '{"dtype": "|u1", "shape": 1, "items": [1]}',
            '{"dtype": "<M8[s]", "shape": [1], "items": [1]}',
            '{"dtype": ["|u1"], "shape": [1], "items": [1]}',
            '{"dtype": "<f8", "shape": [1], "items": [{"a": 1}]}',
        ],
    )
    def test_a_damaged_array_is_refused(self, array: str) -> None:
        text = f'{{"schema": "vertebra/Tensor/1", "message": {{"array": {array}}}}}'
        with pytest.raises(DecodeError):
            self.decode(text.encode())

    def test_a_nesting_bomb_is_a_decode_error(self) -> None:
        with pytest.raises(DecodeError):
            self.decode(b"[" * 100_000)


class TestText:
    @given(st.text())
    def test_text_comes_back(self, text: str) -> None:
        registry = CodecRegistry()
        payload, encoding = registry.encode(Text(text=text), HEADER, "text/plain")
        assert registry.decode(bytes(payload), encoding) == (Text(text=text), Header())

    def test_what_is_not_utf8_is_refused(self) -> None:
        with pytest.raises(DecodeError, match="not UTF-8"):
            CodecRegistry().decode(b"\xff", "text/plain")

    def test_it_carries_nothing_but_text(self) -> None:
        with pytest.raises(EncodeError, match="carries Text, not Imu; use a frame"):
            CodecRegistry().encode(Imu(), HEADER, "text/plain")


class TestRaw:
    def test_bytes_are_seen_in_place(self) -> None:
        payload = bytearray(b"abc")
        message, _ = CodecRegistry().decode(payload, "application/octet-stream")
        assert isinstance(message, Tensor)
        payload[0] = ord("x")
        assert bytes(message.array.data) == b"xbc"

    def test_bytes_come_back(self) -> None:
        tensor = Tensor(array=Array(b"abcd", "<u2", (2,)))
        payload, encoding = CodecRegistry().encode(tensor, HEADER, "application/octet-stream")
        assert (payload, encoding) == (b"abcd", "application/octet-stream")


class TestJpeg:
    def test_the_file_comes_back_as_it_is(self) -> None:
        registry = CodecRegistry()
        message, _ = registry.decode(JPEG, "image/jpeg")
        assert isinstance(message, CompressedImage)
        assert message.media_type == "image/jpeg"
        assert registry.encode(message, HEADER, "image/jpeg") == (JPEG, "image/jpeg")

    @pytest.mark.parametrize("payload", [b"", JPEG[:-2], JPEG[2:], b"\x89PNG\r\n\x1a\n"])
    def test_a_cut_or_foreign_file_is_refused(self, payload: bytes) -> None:
        with pytest.raises(DecodeError, match="no whole JPEG"):
            CodecRegistry().decode(payload, "image/jpeg")

    def test_another_picture_format_is_no_jpeg(self) -> None:
        png = CompressedImage(data=Array(b"ab", "|u1", (2,)), media_type="image/png")
        with pytest.raises(EncodeError, match="is 'image/png', not a JPEG"):
            CodecRegistry().encode(png, HEADER, "image/jpeg")


def test_numbers_that_json_lacks_become_null() -> None:
    text = msgspec.json.encode(to_json_value(Native(value=[math.nan, math.inf])))
    assert text == b'{"value":[null,null]}'
