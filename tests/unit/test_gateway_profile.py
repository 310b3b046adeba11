"""Robot profiles: what is read, and how errors point at the line."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.errors import ConfigError
from vertebra_gateway.profile import load_profiles, parse_profile

SHIPPED = Path(__file__).parents[2] / "deploy" / "robots"
GOOD = """\
robot: r2
presence: "@vertebra/parts/r2/*"
resources:
  - path: arm/limits
    kind: call
    method: GET
    key: r2/arm/limits
  - path: arm/move
    kind: call
    key: r2/arm/move
    timeout_s: 3
    input: {type: object, required: [to]}
    limits:
      from: arm/limits
      fields:
        to: {min: low, max: high, unit: deg}
  - path: eye
    kind: stream
    key: r2/eye
    content_type: image/jpeg
"""


def test_a_profile_is_read() -> None:
    profile = parse_profile(GOOD, "r2.yaml")
    assert profile.robot == "r2"
    assert [(found.path, found.kind, found.http_method) for found in profile.resources] == [
        ("arm/limits", "call", "GET"),
        ("arm/move", "call", "POST"),
        ("eye", "stream", "GET"),
    ]
    move = profile.resource("arm/move")
    assert move is not None
    assert move.limits is not None
    assert (move.timeout_s, move.limits.source) == (3.0, "arm/limits")
    assert move.limits.fields["to"].unit == "deg"
    assert profile.resource("arm") is None


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("robot: r2", "robot: R 2", 1, "'R 2' is no robot name"),
        ("robot: r2", "robot: [r2]", 1, "Expected `str`, got `array`"),
        ("robot: r2", "robots: r2", 1, "unknown field `robots`"),
        ("presence:", "presence", 3, "this is no YAML"),
        ("/r2/*", "/r2//*", 2, "has no empty chunk"),
        ("path: arm/limits", "path: /arm/limits", 4, "'/arm/limits' is no path"),
        ("path: eye", "path: eye/stream", 17, "the last of which is not 'stream'"),
        ("path: eye", "path: arm/move", 17, "resource 'arm/move' exists already"),
        ("kind: stream", "kind: river", 18, "Invalid enum value 'river'"),
        ("kind: stream", "kind: stream\n    kind: read", 19, "'kind' is given twice"),
        ("kind: stream", "kind: stream\n    1: read", 19, "1 is no text"),
        ("kind: stream", "kind: stream\n    method: POST", 19, "method belongs to a resource"),
        ("key: r2/eye", "key: r2/*", 19, "'*' is not allowed in a key"),
        ("key: r2/eye", "keys: r2/eye", 17, "unknown field `keys`"),
        ("timeout_s: 3", "timeout_s: -1", 11, "above 0 and at most 600"),
        ("timeout_s: 3", "timeout_s: .nan", 11, "above 0 and at most 600"),
        ("timeout_s: 3", "method: GET", 12, "a call by GET takes no input"),
        ("{type: object, required: [to]}", "{type: objekt}", 12, "this is no JSON Schema"),
        ("from: arm/limits", "from: eye", 14, "'eye' is no resource of kind call"),
        ("from: arm/limits", "from: leg/limits", 14, "'leg/limits' is no resource"),
        ("unit: deg", "units: deg", 16, "unknown field `units`"),
    ],
)
def test_errors_point_at_file_and_line(old: str, new: str, line: int, says: str) -> None:
    assert old in GOOD
    with pytest.raises(ConfigError) as caught:
        parse_profile(GOOD.replace(old, new, 1), "r2.yaml")
    assert str(caught.value).startswith(f"r2.yaml, line {line}: ")
    assert says in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "7", "&a [*a]", "robot: r2", "\x00", "a: b\n--- \nc"])
def test_anything_else_is_an_error_too(text: str) -> None:
    with pytest.raises(ConfigError, match=r"r2\.yaml"):
        parse_profile(text, "r2.yaml")


def test_two_files_for_one_robot_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(GOOD, encoding="utf-8")
    (tmp_path / "b.yaml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"b\.yaml: robot 'r2' is described in .*a\.yaml already"):
        load_profiles(tmp_path)


def test_missing_folder_and_unreadable_file_name_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="set VERTEBRA_GATEWAY_ROBOTS"):
        load_profiles(tmp_path / "nowhere")
    (tmp_path / "a.yaml").write_bytes(b"robot: \xff")
    with pytest.raises(ConfigError, match=r"a\.yaml cannot be read"):
        load_profiles(tmp_path)


def test_the_shipped_profiles_are_good() -> None:
    profiles = {profile.robot: profile for profile in load_profiles(SHIPPED)}
    assert {resource.path for resource in profiles["vizzy"].resources} >= {
        "head/joints",
        "head/limits",
        "head/move",
        "head/stop",
        "camera/left",
        "camera/left/faces",
        "imu",
    }


PARTS = """
robot: r2
parts:
  - {kind: control_board, path: head, key: r2/head}
  - {kind: speaker, path: mouth, key: r2/mouth}
resources:
  - {path: eye, kind: stream, key: r2/eye}
"""


def test_parts_offer_what_their_kind_offers() -> None:
    profile = parse_profile(PARTS, "r2.yaml")
    move = profile.resource("head/move")
    assert move is not None
    assert move.key == "r2/head/move"
    assert move.limits is not None
    assert move.limits.source == "head/limits"
    play = profile.resource("mouth/play")
    assert play is not None
    assert play.takes == "audio/wav"
    assert profile.resource("eye") is not None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("speaker", "trumpet", r"line 5: .*trumpet"),
        ("path: mouth", "path: head", None),
        ("key: r2/mouth", "key: /r2", r"line 5: .*no empty chunk"),
        ("path: eye", "path: head/move", r"line 7: .*exists already"),
        ("key: r2/eye", "key: r2/eye, takes: audio/wav", r"line 7: .*taken by a call"),
        ("key: r2/eye", "key: r2/eye, control: form", r"line 7: .*kind call"),
    ],
)
def test_faults_in_parts_are_named_with_their_line(old: str, new: str, words: str | None) -> None:
    text = PARTS.replace(old, new)
    if words is None:
        assert parse_profile(text, "r2.yaml").resource("head/play") is not None
        return
    with pytest.raises(ConfigError, match=words):
        parse_profile(text, "r2.yaml")


def test_a_profile_may_be_one_file(tmp_path: Path) -> None:
    (tmp_path / "r2.yaml").write_text(PARTS)
    (tmp_path / "r3.yaml").write_text(PARTS.replace("r2", "r3"))
    assert [profile.robot for profile in load_profiles(tmp_path / "r3.yaml")] == ["r3"]
    assert [profile.robot for profile in load_profiles(tmp_path)] == ["r2", "r3"]


BASE = """
robot: r2
presence: "@vertebra/parts/r2/**"
parts:
  - {kind: control_board, path: head, key: r2/head}
  - {kind: speaker, path: mouth, key: r2/mouth}
  - {kind: base, path: wheels, key: r2/base}
  - kind: action
    path: wheels/dock
    key: r2/base/dock
    goal: {type: object, required: [dock], properties: {dock: {type: string}}}
"""


def test_an_action_takes_the_goals_that_the_profile_describes() -> None:
    profile = parse_profile(BASE, "r2.yaml")
    goal = profile.resource("wheels/dock/goal")
    assert goal is not None
    assert (goal.key, goal.http_method) == ("r2/base/dock/goal", "POST")
    assert goal.input is not None
    assert goal.input["required"] == ["dock"]
    result = profile.resource("wheels/dock/result")
    assert result is not None
    assert result.timeout_s == 600
    without = parse_profile(BASE[: BASE.index("    goal:")], "r2.yaml").resource("wheels/dock/goal")
    assert without is not None
    assert without.input == {"type": "object"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("kind: action", "kind: base", r"line 11: goal belongs to a part of kind action"),
        ("{type: string}", "{type: text}", r"line 11: this is no JSON Schema"),
    ],
)
def test_faults_in_goals_are_named_with_their_line(old: str, new: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_profile(BASE.replace(old, new), "r2.yaml")


def test_presence_tells_of_the_parts_that_it_matches_and_that_are_announced() -> None:
    def watched(text: str) -> list[str]:
        return [part.path for part in parse_profile(text, "r2.yaml").watched_parts()]

    assert watched(BASE) == ["head", "wheels"]
    assert watched(BASE.replace("r2/**", "r2/head")) == ["head"]
    assert watched(BASE.replace('"@vertebra/parts/r2/**"', '""')) == []
