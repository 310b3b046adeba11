"""Routes of the ROS 2 adapter: what a file says, and which line is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.errors import ConfigError
from vertebra.ros2.mapping import Sound
from vertebra.service.routes import parse_routes, read_routes
from vertebra_ros2.routes import KINDS, Action, Base, Parameters, Service, Topic

SHIPPED = Path(__file__).parents[2] / "deploy/ros2/routes.yaml"


def test_every_field() -> None:
    text = """
topics:
  - {ros: /scan, key: base/scan, depth: 5, max_rate_hz: 10}
  - {ros: /words, key: words, type: std_msgs/msg/String, direction: outbound, retain: true}
  - {ros: /audio, key: ear, sound: {rate_hz: 48000, channels: 2, format: F32LE}}
services:
  - {ros: /reset, key: base/reset, type: std_srvs/srv/Trigger}
actions:
  - {ros: /navigate, key: base/navigate}
  - {ros: /greet, key: greet, type: lab_msgs/action/Greet, direction: outbound, timeout_s: 1}
parameters:
  - {ros: /planner, key: base/planner}
bases:
  - {ros: /cmd_vel, key: base, max_linear_m_s: 0.5, max_angular_deg_s: 60, actions: [/navigate]}
"""
    assert parse_routes(text, "routes.yaml", KINDS) == (
        Topic(ros="/scan", key="base/scan", depth=5, max_rate_hz=10),
        Topic(
            ros="/words",
            key="words",
            type="std_msgs/msg/String",
            direction="outbound",
            retain=True,
        ),
        Topic(ros="/audio", key="ear", sound=Sound(rate_hz=48000, channels=2, format="F32LE")),
        Service(ros="/reset", key="base/reset", type="std_srvs/srv/Trigger"),
        Action(ros="/navigate", key="base/navigate"),
        Action(
            ros="/greet",
            key="greet",
            type="lab_msgs/action/Greet",
            direction="outbound",
            timeout_s=1,
        ),
        Parameters(ros="/planner", key="base/planner"),
        Base(
            ros="/cmd_vel",
            key="base",
            max_linear_m_s=0.5,
            max_angular_deg_s=60,
            actions=("/navigate",),
        ),
    )


@pytest.mark.parametrize("text", ["", "# nothing", "topics:\nservices: []", "topics: []"])
def test_nothing_is_no_route(text: str) -> None:
    assert parse_routes(text, "routes.yaml", KINDS) == ()


def test_shipped_file_is_right() -> None:
    keys = {route.key for route in read_routes(SHIPPED, KINDS)}
    assert {"vizzy/base", "vizzy/base/odometry", "vizzy/camera/left/faces"} <= keys


def test_no_file_is_no_route() -> None:
    assert read_routes(None, KINDS) == ()


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        read_routes(tmp_path / "nowhere.yaml", KINDS)


def test_key_may_go_out_to_several_topics() -> None:
    text = """
topics:
  - {ros: /audio, key: ear, type: audio_common_msgs/msg/AudioData, direction: outbound}
  - {ros: /audio_info, key: ear, type: audio_common_msgs/msg/AudioInfo, direction: outbound}
"""
    assert len(parse_routes(text, "routes.yaml", KINDS)) == 2


def test_topic_may_go_both_ways() -> None:
    text = """
topics:
  - {ros: /a, key: in}
  - {ros: /a, key: out, type: std_msgs/msg/String, direction: outbound}
services:
  - {ros: /a, key: a}
"""
    assert len(parse_routes(text, "routes.yaml", KINDS)) == 3


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("{ros: a, key: a}", "a ROS name is '/' and tokens"),
        ("{ros: /a, key: /a}", "a key has no empty chunk"),
        ("{ros: /a, key: a, typ: x}", "unknown field `typ`"),
        ("{ros: /a}", "missing required field `key`"),
        ("{ros: /a, key: a, direction: out}", "Invalid enum value 'out'"),
        ("{ros: /a, key: a, direction: outbound}", "an outbound route says the ROS type of /a"),
        ("{ros: /a, key: a, type: String}", "a ROS type is called as in"),
        ("{ros: /a, key: a, depth: 0}", "a depth is at least 1, not 0"),
        ("{ros: /b, key: a}", r"the ROS topic /b \(inbound\) has a route in line 2 already"),
        ("{ros: /a, key: b}", r"the key b \(inbound\) has a route in line 2 already"),
    ],
)
def test_bad_line_is_named(line: str, told: str) -> None:
    text = f"topics:\n  - {{ros: /b, key: b}}\n  - {line}"
    with pytest.raises(ConfigError, match=f"routes.yaml:3: .*{told}"):
        parse_routes(text, "routes.yaml", KINDS)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("topics: {ros: /a}", "routes.yaml:1: topics is a list of routes"),
        (
            "streams: []",
            "expected a map with the keys topics, services, actions, parameters, bases",
        ),
        ("- a", "expected a map"),
        ("topics: [", "routes.yaml is no YAML"),
        (
            "services: [{ros: /a, key: a, type: std_msgs/msg/String}]",
            "std_msgs/msg/String is a message",
        ),
        (
            "actions: [{ros: /a, key: a, type: std_srvs/srv/Trigger}]",
            "std_srvs/srv/Trigger is no action",
        ),
        (
            "actions: [{ros: /a, key: a, direction: outbound}]",
            "an outbound route says the ROS type of /a",
        ),
        (
            "bases: [{ros: /a, key: a, max_linear_m_s: 0, max_angular_deg_s: 90}]",
            "max_linear_m_s is above 0, not 0",
        ),
        (
            "bases: [{ros: /a, key: a, max_linear_m_s: 1, max_angular_deg_s: .inf}]",
            "max_angular_deg_s is above 0, not inf",
        ),
        (
            "bases: [{ros: /a, key: a, max_linear_m_s: 1, max_angular_deg_s: 9, actions: [go]}]",
            "a ROS name is",
        ),
        (
            """bases: [{ros: /a, key: a, max_linear_m_s: 1, max_angular_deg_s: 9}]
topics: [{ros: /a, key: b, type: a/msg/B, direction: outbound}]""",
            r"the ROS topic /a \(outbound\) has a route in line 1 already",
        ),
    ],
)
def test_file_of_another_form_is_refused(text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        parse_routes(text, "routes.yaml", KINDS)
