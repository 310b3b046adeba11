"""What the command line makes of what the user typed, and how it shows messages."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest
import yaml

from vertebra.bus import Reply, Sample
from vertebra.cli import call, echo
from vertebra.cli.backbone import as_yaml, readable, table
from vertebra.cli.pub import encode_payload
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError
from vertebra.messages import (
    Array,
    Box,
    Face,
    Faces,
    Header,
    Image,
    JointState,
    Message,
    Native,
    Tensor,
    Text,
)

CODECS = CodecRegistry()
IMAGE = Image(pixels=Array(bytes(240 * 320 * 3), "|u1", (240, 320, 3)), pixel_format="rgb8")


def cli(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vertebra.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("text", "type_name", "encoding", "message"),
    [
        ("hello", None, "text/plain", Text(text="hello")),
        ('{"a": [1]}', None, "application/json", Native(value={"a": [1]})),
        ("hello", "Text", "application/vnd.vertebra.frame;Text/1", Text(text="hello")),
        ('{"text": "a"}', "Text", "application/vnd.vertebra.frame;Text/1", Text(text="a")),
        (
            '{"names": ["a"], "positions_deg": [1.5]}',
            "JointState",
            "application/vnd.vertebra.frame;JointState/1",
            JointState(names=("a",), positions_deg=(1.5,)),
        ),
        (
            '{"array": {"dtype": "|u1", "shape": [2], "items": [1, 2]}}',
            "Tensor",
            "application/vnd.vertebra.frame;Tensor/1",
            Tensor(array=Array(b"\1\2", "|u1", (2,))),
        ),
    ],
)
def test_what_was_typed_becomes_a_payload(
    text: str, type_name: str | None, encoding: str, message: Message
) -> None:
    payload, used = encode_payload(CODECS, text, type_name)
    assert used == encoding
    assert isinstance(payload, bytes) or payload.nbytes
    joined = payload if isinstance(payload, bytes) else b"".join(payload.parts())
    assert CODECS.decode(joined, used)[0] == message


@pytest.mark.parametrize(
    ("text", "type_name", "match"),
    [
        ("{", "Imu", "is not JSON"),
        ("{}", "Pose", "position_m, orientation_xyzw, frame_id"),
        ("7", "Text", "is no Text"),
        ('{"names": ["a"], "positions_deg": []}', "JointState", "0 values for 1 joints"),
    ],
)
def test_what_does_not_fit_is_refused(text: str, type_name: str, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        encode_payload(CODECS, text, type_name)


def test_an_image_is_shown_as_a_summary() -> None:
    assert as_yaml(readable(IMAGE)) == (
        "pixels: 240 x 320 x 3 of |u1, 230400 bytes\npixel_format: rgb8\nframe_id: ''"
    )


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (Array(b"\1\2", "|u1", (2,)), [1, 2]),
        (Array(bytes(8), "<M8[ns]", (1,)), "1 of <M8[ns]"),
        (b"abc", "3 bytes: 61 62 63"),
        ({1: (2.5, None)}, {"1": [2.5, None]}),
        (object(), "a object"),
    ],
)
def test_values_are_shown_plainly(value: Any, shown: Any) -> None:
    text = as_yaml(readable(Native(value=value)))
    assert yaml.safe_load(text) == {"value": shown}


def test_yaml_for_people_is_still_yaml() -> None:
    faces = Faces(
        faces=(Face(track_id=1, box=Box(x=1, y=2, width=3, height=4), score=0.5),),
        image_width=320,
        image_height=240,
    )
    loaded = yaml.safe_load(as_yaml(readable(faces)))
    assert loaded["faces"][0]["box"] == {"x": 1, "y": 2, "width": 3, "height": 4}


def sample(text: str, encoding: str = "text/plain") -> Sample:
    return Sample(key="a/b", payload=text.encode(), encoding=encoding, sent_ns=1)


def test_echo_shows_key_type_and_fields() -> None:
    shown = echo._as_text(sample("hi"), Text(text="hi"), Header(), encoding=True)
    head, *fields = shown.splitlines()
    assert head.startswith("--- a/b, Text, ")
    assert head.endswith(" ms ago, text/plain")
    assert fields == ["text: hi", "language: ''"]


def test_echo_as_json_is_one_line_per_message() -> None:
    shown = echo._as_json(sample("hi"), Text(text="hi"), Header(captured_ns=5))
    assert json.loads(shown) == {
        "key": "a/b",
        "encoding": "text/plain",
        "captured_ns": 5,
        "schema": "vertebra/Text/1",
        "message": {"text": "hi", "language": ""},
    }
    assert "\n" not in shown


@pytest.mark.parametrize(
    ("reply", "shown"),
    [
        (Reply(payload=b'{"a":1}', encoding="application/json"), '{\n  "a": 1\n}'),
        (Reply(payload=b"hi", encoding="text/plain"), "text: hi\nlanguage: ''"),
        (Reply(payload=b"", encoding=""), "(an empty answer)"),
    ],
)
def test_answers_are_shown_by_their_encoding(reply: Reply, shown: str) -> None:
    assert call._show(reply) == shown


def test_columns_are_aligned() -> None:
    assert table([("a", "bb", "c"), ("aaa", "b", "")]) == "a    bb  c\naaa  b"


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("pub", "a//b", "x"), 2, "a key has no empty chunk"),
        (("pub", "a", "{", "--type", "Imu"), 2, "vertebra: '{' is not JSON"),
        (("pub", "a", "x", "--rate", "0"), 2, "a rate is more than 0 Hz"),
        (("call", "a", "{"), 2, "is not JSON"),
        (("echo", "a b"), 2, "not allowed in a key expression"),
        (("keys", "--router", "nonsense"), 2, "is no Zenoh locator"),
        (("up", "nonsense"), 2, "compose.yaml has no service 'nonsense'"),
        (("nonsense",), 2, "invalid choice"),
        ((), 2, "required: COMMAND"),
    ],
)
def test_misuse_is_told_without_a_traceback(
    arguments: tuple[str, ...], status: int, text: str
) -> None:
    done = cli(*arguments)
    assert text in done.stderr
    assert "Traceback" not in done.stderr
    assert (done.returncode, done.stdout) == (status, "")
