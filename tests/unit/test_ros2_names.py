"""Names of ROS 2: on DDS, on the backbone, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import NameMappingError
from vertebra.keys import check_key
from vertebra.ros2 import names

TOKENS = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,9}", fullmatch=True)
NAMES = st.lists(TOKENS, min_size=1, max_size=5).map(lambda tokens: "/" + "/".join(tokens))
ROLES = st.sampled_from(["topic", "request", "reply"])


@given(NAMES)
def test_name_comes_back_from_its_key(name: str) -> None:
    key = names.key_of(name)
    assert check_key(key) == f"ros2{name}"
    assert names.name_of(key) == name


@given(ROLES, NAMES)
def test_name_and_role_come_back_from_dds(role: names.Role, name: str) -> None:
    assert names.ros_name(names.dds_name(role, name)) == names.DdsName(role, name)


@given(st.tuples(ROLES, NAMES), st.tuples(ROLES, NAMES))
def test_no_two_share_a_dds_topic(
    one: tuple[names.Role, str], other: tuple[names.Role, str]
) -> None:
    assert (names.dds_name(*one) == names.dds_name(*other)) == (one == other)


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        ("rt/a/b", ("topic", "/a/b")),
        ("rq/add_two_intsRequest", ("request", "/add_two_ints")),
        ("rr/add_two_intsReply", ("reply", "/add_two_ints")),
        ("rt/fibonacci/_action/feedback", ("topic", "/fibonacci/_action/feedback")),
        ("ros_discovery_info", None),
        ("rq/add", None),
        ("rt/1st", None),
        ("rt/", None),
        ("robot/state", None),
    ],
)
def test_dds_topic(topic: str, expected: tuple[str, str] | None) -> None:
    assert names.ros_name(topic) == expected


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        (
            "example_interfaces/srv/AddTwoInts_Request",
            "example_interfaces::srv::dds_::AddTwoInts_Request_",
        ),
        (
            "example_interfaces/action/Fibonacci_SendGoal_Request",
            "example_interfaces::action::dds_::Fibonacci_SendGoal_Request_",
        ),
    ],
)
def test_dds_type(ros: str, dds: str) -> None:
    assert names.dds_type(ros) == dds
    assert names.ros_type(dds) == ros


def test_foreign_dds_type_is_none_of_ros() -> None:
    assert names.ros_type("HelloWorldData::Msg") is None


@pytest.mark.parametrize(
    ("name", "position"),
    [("chatter", 0), ("/a//b", 2), ("/a/1b", 2), ("/a-b", 2), ("/a/", 2), ("", 0), ("/a b", 2)],
)
def test_bad_name_is_pointed_at(name: str, position: int) -> None:
    with pytest.raises(NameMappingError) as caught:
        names.check_name(name)
    assert caught.value.position == position


def test_name_of_more_than_dds_can_hold_is_refused() -> None:
    names.check_name("/" + "a" * 246)
    with pytest.raises(NameMappingError, match="247"):
        names.check_name("/" + "a" * 247)


@pytest.mark.parametrize("key", ["yarp/a", "ros2/1a", "ros2/%.", "ros2", "ros2/a%2Fb"])
def test_key_that_no_name_has_is_refused(key: str) -> None:
    with pytest.raises(NameMappingError):
        names.name_of(key)


def test_bad_type_is_refused() -> None:
    with pytest.raises(NameMappingError, match="std_msgs/msg/String"):
        names.dds_type("std_msgs/String")
