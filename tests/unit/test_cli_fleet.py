"""The fleet as compose.yaml describes it, and where it listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.cli.fleet import (
    Program,
    active_variables,
    interpolate,
    mentioned_variables,
    read_fleet,
    read_variables,
)
from vertebra.cli.up import Address, listening_addresses
from vertebra.errors import ConfigError

COMPOSE = """
x-environment: &environment
  VERTEBRA_ROUTER: ${VERTEBRA_ROUTER:-tcp/router:7447}
services:
  router:
    command: ["python", "-m", "vertebra_router"]
    environment:
      <<: *environment
      VERTEBRA_ROUTER_LISTEN: '${VERTEBRA_ROUTER_LISTEN:-["tcp/0.0.0.0:7447"]}'
  camera:
    profiles: [camera, all]
    command: ["python", "-m", "vertebra_camera", "${SOURCE:-}"]
    environment: {HTTP_PROXY: , VERTEBRA_CAMERA_RATE: 5}
"""


def test_programs_have_their_command_and_resolved_environment() -> None:
    programs = read_fleet(COMPOSE, {"VERTEBRA_ROUTER": "tcp/127.0.0.1:7447"})
    assert programs == [
        Program(
            "router",
            ("python", "-m", "vertebra_router"),
            {
                "VERTEBRA_ROUTER": "tcp/127.0.0.1:7447",
                "VERTEBRA_ROUTER_LISTEN": '["tcp/0.0.0.0:7447"]',
            },
        )
    ]


@pytest.mark.parametrize("profile", ["camera", "all"])
def test_profiles_switch_services_on(profile: str) -> None:
    variables = {"HTTP_PROXY": "http://proxy", "SOURCE": "0"}
    _, camera = read_fleet(COMPOSE, variables, profiles=[profile])
    assert camera.command == ("python", "-m", "vertebra_camera", "0")
    assert camera.environment == {"HTTP_PROXY": "http://proxy", "VERTEBRA_CAMERA_RATE": "5"}


def test_a_named_service_needs_no_profile() -> None:
    (camera,) = read_fleet(COMPOSE, {}, services=["camera"])
    assert (camera.name, camera.environment) == ("camera", {"VERTEBRA_CAMERA_RATE": "5"})


def test_unknown_names_are_refused_with_a_suggestion() -> None:
    with pytest.raises(ConfigError, match="no service 'ruoter'; did you mean router"):
        read_fleet(COMPOSE, {}, services=["ruoter"])
    with pytest.raises(ConfigError, match="no profile 'x'; known: all, camera"):
        read_fleet(COMPOSE, {}, profiles=["x"])


@pytest.mark.parametrize(
    ("entry", "match"),
    [
        ("{command: python -m x}", "command of x is a list of words"),
        ("{}", "command of x is a list of words, not None"),
        ("{command: [x], environment: [A=1]}", "environment of x is a map"),
    ],
)
def test_what_a_process_cannot_have_is_refused(entry: str, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        read_fleet(f"services: {{x: {entry}}}", {})


@pytest.mark.parametrize(
    ("text", "resolved"),
    [
        ("plain", "plain"), ("${A}", "1"), ("${A:-x}", "1"), ("${B:-x}", "x"), ("${B}", ""),
        ("${EMPTY:-x}", "x"), ("${A:?message}", "1"), ("a${A}b${B:-c}", "a1bc"), ("$$A", "$A"),
        ('${B:-["a", "b"]}', '["a", "b"]'), ("${B:-}", ""),
    ],
)  # fmt: skip
def test_variables_are_resolved_as_compose_does(text: str, resolved: str) -> None:
    assert interpolate(text, {"A": "1", "EMPTY": ""}) == resolved


def test_a_variable_that_must_be_set_is_named() -> None:
    with pytest.raises(ConfigError, match="TOKEN is not set: make one"):
        interpolate("${TOKEN:?make one}", {"TOKEN": ""})


@pytest.mark.parametrize("text", ["$A", "${A-x}", "${A:+x}", "${A", "$"])
def test_other_forms_are_refused_and_not_misread(text: str) -> None:
    with pytest.raises(ConfigError, match="understood here"):
        interpolate(text, {"A": "1"})


def test_mentioned_variables_are_found() -> None:
    assert mentioned_variables(COMPOSE) == {"VERTEBRA_ROUTER", "VERTEBRA_ROUTER_LISTEN", "SOURCE"}


def test_variables_of_a_file() -> None:
    text = '# comment\n\nA=1\nB=["x=y"]\nC=\n'
    assert read_variables(text) == {"A": "1", "B": '["x=y"]', "C": ""}


@pytest.mark.parametrize("text", ["A", "A\n", "a b=1", "export A=1"])
def test_a_line_that_is_no_variable_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"line 1, .* is not NAME=value"):
        read_variables(text)


def test_the_environment_wins_over_the_file_unless_empty(tmp_path: Path) -> None:
    (tmp_path / "deploy").mkdir()
    (tmp_path / "deploy" / "local.env").write_text("A=file\nB=file\nC=file\n")
    variables = active_variables(tmp_path, {"A": "shell", "B": ""})
    assert variables == {"A": "shell", "B": "file", "C": "file"}


def program(name: str, **environment: str) -> Program:
    return Program(name, ("python",), environment)


def test_addresses_follow_the_environment_of_the_programs() -> None:
    found = listening_addresses(
        [
            program("router", VERTEBRA_ROUTER_LISTEN='["tcp/127.0.0.1:1", "tcp/10.0.0.1:2"]'),
            program("yarp", VERTEBRA_YARP_NAME_SERVER=""),
            program("gateway", VERTEBRA_GATEWAY_TCP_PORT="8081"),
            program("simulator"),
        ]
    )
    assert [(each.service, str(each)) for each in found] == [
        ("router", "127.0.0.1:1"),
        ("router", "10.0.0.1:2"),
        ("yarp", "127.0.0.1:10000"),
        ("gateway", "127.0.0.1:8081"),
    ]
    assert found[-1] == Address("gateway", "VERTEBRA_GATEWAY_TCP_PORT", "127.0.0.1", 8081)


def test_a_foreign_name_server_is_not_listened_on() -> None:
    assert listening_addresses([program("yarp", VERTEBRA_YARP_NAME_SERVER="lab:10000")]) == []
