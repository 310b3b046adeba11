"""What yarp.conf, namespaces and environment variables make of names and addresses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from vertebra.errors import ConfigError
from vertebra.yarp.naming.addresses import advertised_host, is_loopback
from vertebra.yarp.naming.conf import (
    ServerAddress,
    config_path,
    configured_name_servers,
    default_tcp_port,
    opened_as,
)

THERE = ServerAddress("/root", "10.0.0.7", 10101)


@pytest.mark.parametrize(
    ("folder", "env"),
    [
        ("", {"YARP_CONFIG_HOME": "{home}"}),
        ("yarp", {"XDG_CONFIG_HOME": "{home}"}),
        (".config/yarp", {"HOME": "{home}"}),
    ],
)
def test_yarp_conf_is_where_yarp_looks_for_it(
    tmp_path: Path, folder: str, env: Mapping[str, str]
) -> None:
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    (tmp_path / folder / "yarp.conf").write_text("10.0.0.7 10101 yarp\n")
    env = {key: value.format(home=tmp_path) for key, value in env.items()}
    assert configured_name_servers(env) == [THERE]
    assert config_path(env) == tmp_path / folder / "yarp.conf"


@pytest.mark.parametrize(
    "text",
    [
        "10.0.0.7 10101",
        '"10.0.0.7"\n10101\nyarp\n',
        "[/root]\nhost = 10.0.0.7\nport = 10101\nmode = yarp\n",
    ],
)
def test_forms_of_yarp_conf(tmp_path: Path, text: str) -> None:
    (tmp_path / "yarp.conf").write_text(text)
    assert configured_name_servers({"YARP_CONFIG_HOME": str(tmp_path)}) == [THERE]


def test_a_namespace_has_a_file_of_its_own(tmp_path: Path) -> None:
    env = {"YARP_CONFIG_HOME": str(tmp_path)}
    (tmp_path / "yarp.conf").write_text("10.0.0.7 10101\n")
    (tmp_path / "_lab_two.conf").write_text("10.0.0.8 10102\n")
    two = ServerAddress("/lab/two", "10.0.0.8", 10102)
    assert configured_name_servers(env | {"YARP_NAMESPACE": "/lab/two /other"}) == [two]
    assert configured_name_servers(env | {"YARP_NAMESPACE": "/lab/two /root"}) == [two, THERE]
    (tmp_path / "yarp_namespace.conf").write_text("/lab/two\n")
    assert configured_name_servers(env) == [two]


def test_without_a_file_nothing_is_configured(tmp_path: Path) -> None:
    assert configured_name_servers({"YARP_CONFIG_HOME": str(tmp_path)}) == []


@pytest.mark.parametrize(
    "text",
    [
        "10.0.0.7",
        "10.0.0.7 many",
        "10.0.0.7 0",
        "h 70000",
        "h 11311 ros",
        "h 1 local",
        "[x]\nport=1\n",
        "[x\n",
    ],
)
def test_a_yarp_conf_that_cannot_work(tmp_path: Path, text: str) -> None:
    (tmp_path / "yarp.conf").write_text(text)
    with pytest.raises(ConfigError, match=r"yarp\.conf"):
        configured_name_servers({"YARP_CONFIG_HOME": str(tmp_path)})


def test_the_port_range_moves_the_name_server() -> None:
    assert default_tcp_port({}) == 10000
    assert default_tcp_port({"YARP_PORT_RANGE": "15000"}) == 15000
    with pytest.raises(ConfigError, match="YARP_PORT_RANGE is 'many'"):
        default_tcp_port({"YARP_PORT_RANGE": "many"})


def test_users_rename_and_move_the_ports_of_programs() -> None:
    env = {
        "YARP_RENAME_icub_cam_left_o": "/my/cam",
        "YARP_PORTNUMBER_icub_cam_left_o": "12345",
        "YARP_PORT_PREFIX": "/lab2",
    }
    assert opened_as("/icub/cam/left:o", env) == ("/lab2/my/cam", 12345)
    assert opened_as("/other", env) == ("/lab2/other", 0)
    assert opened_as("...", env) == ("...", 0)  # the name server makes this name
    assert opened_as("/other", {}) == ("/other", 0)


@pytest.mark.parametrize("number", ["many", "-1", "65536"])
def test_a_port_number_that_cannot_be(number: str) -> None:
    with pytest.raises(ConfigError, match="YARP_PORTNUMBER_a is"):
        opened_as("/a", {"YARP_PORTNUMBER_a": number})


@pytest.mark.parametrize(
    ("wanted", "bind_host", "yarp_ip", "expected"),
    [
        ("robot.lan", "0.0.0.0", "10.", "robot.lan"),
        (None, "127.0.0.1", "10.", "127.0.0.1"),
        (None, "0.0.0.0", "10.", "10.0.0.5"),
        (None, "0.0.0.0", "10.9.9.9", "10.9.9.9"),
        (None, "0.0.0.0", "", None),
    ],
)
def test_the_address_that_others_are_told(
    wanted: str | None, bind_host: str, yarp_ip: str, expected: str | None
) -> None:
    addresses = ["127.0.0.1", "192.168.1.5", "10.0.0.5"]
    assert advertised_host(wanted, bind_host, {"YARP_IP": yarp_ip}, addresses) == expected


def test_loopback_addresses_are_known() -> None:
    assert [*map(is_loopback, ("localhost", "127.0.0.1", "127.1.2.3", "::1"))] == [True] * 4
    assert [*map(is_loopback, ("10.0.0.1", "robot", ""))] == [False] * 3
