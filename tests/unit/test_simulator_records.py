"""What the base tells and is told, as ROS records: they have the form of their types."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.names import check_name
from vertebra_simulator import records
from vertebra_simulator.base import Base, Pose, Velocity, turn_of
from vertebra_simulator.floorplan import BEAMS, ROOM
from vertebra_simulator.navigator import Outlook

CDR = Cdr(Types.standard())
NOW_NS = 1_700_000_000_250_000_000
POSES = st.builds(Pose, st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1))


def crossed(record: Mapping[str, Any], type_name: str) -> Any:
    """Return a record as it is on the other side of the wire."""
    return CDR.decode(CDR.encode(record, type_name), type_name)


@pytest.fixture
def base() -> Base:
    base = Base(ROOM)
    base.drive(Velocity(0.4, 0.5))
    base.advance_to(0.45)
    return base


@given(POSES)
def test_a_pose_comes_back(pose: Pose) -> None:
    read = records.read_pose(crossed(records.pose_of(pose), "geometry_msgs/msg/Pose"))
    assert read.place == pose.place
    assert turn_of(read.heading_rad - pose.heading_rad) == pytest.approx(0.0, abs=1e-12)


@given(POSES, st.floats(0.001, 1000))
def test_a_quaternion_need_not_have_the_length_1(pose: Pose, length: float) -> None:
    record = {**records.pose_of(pose)}
    turn = record["orientation"]
    record["orientation"] = {axis: length * value for axis, value in turn.items()}
    read = records.read_pose(crossed(record, "geometry_msgs/msg/Pose"))
    assert turn_of(read.heading_rad - pose.heading_rad) == pytest.approx(0.0, abs=1e-9)


def test_a_pose_without_orientation_looks_ahead() -> None:
    position = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"w": 0.0}}
    assert records.read_pose(crossed(position, "geometry_msgs/msg/Pose")) == Pose(1.0, 2.0, 0.0)


def test_odometry_says_where_and_how_fast(base: Base) -> None:
    told = crossed(records.odometry(base, NOW_NS), "nav_msgs/msg/Odometry")
    assert told["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert (told["header"]["frame_id"], told["child_frame_id"]) == ("odom", "base_link")
    assert records.read_pose(told["pose"]["pose"]).place == base.pose.place
    assert records.read_velocity(told["twist"]["twist"]) == base.velocity


def test_the_transform_says_the_same(base: Base) -> None:
    (told,) = crossed(records.transform(base, NOW_NS), "tf2_msgs/msg/TFMessage")["transforms"]
    assert (told["header"]["frame_id"], told["child_frame_id"]) == ("odom", "base_link")
    where = {
        "position": told["transform"]["translation"],
        "orientation": told["transform"]["rotation"],
    }
    assert records.read_pose(where).place == base.pose.place


def test_wheels_are_joints(base: Base) -> None:
    told = crossed(records.joints(base, NOW_NS), "sensor_msgs/msg/JointState")
    assert told["name"] == list(records.WHEELS)
    assert told["position"].tolist() == list(base.wheels_rad)
    assert told["velocity"].tolist() == list(base.wheel_speeds_rad_s)


def test_a_scan_names_its_angles(base: Base) -> None:
    told = crossed(records.scan(base, ROOM, 10.0, NOW_NS), "sensor_msgs/msg/LaserScan")
    assert len(told["ranges"].tolist()) == BEAMS
    last = told["angle_min"] + (BEAMS - 1) * told["angle_increment"]
    assert last == pytest.approx(told["angle_max"], abs=1e-4)
    assert told["angle_min"] == pytest.approx(-math.pi)
    assert told["scan_time"] == pytest.approx(0.1)


def test_feedback_says_how_far_it_is(base: Base) -> None:
    outlook = Outlook(distance_m=1.5, remaining_s=2.25)
    feedback = records.progress(base, outlook, 0.75, NOW_NS)
    told = crossed(feedback, "nav2_msgs/action/NavigateToPose_Feedback")
    assert told["distance_remaining"] == 1.5
    assert told["navigation_time"] == {"sec": 0, "nanosec": 750_000_000}
    assert told["estimated_time_remaining"] == {"sec": 2, "nanosec": 250_000_000}
    assert records.read_pose(told["current_pose"]["pose"]).place == base.pose.place


def test_diagnostics_warn_of_what_is_in_the_way(base: Base) -> None:
    def status() -> Any:
        record = records.diagnostics(base, "vizzy", "idle", NOW_NS)
        (one,) = crossed(record, "diagnostic_msgs/msg/DiagnosticArray")["status"]
        return one

    assert (status()["level"], status()["message"]) == (0, "works")
    base.stuck = "a wall"
    assert (status()["level"], status()["message"]) == (1, "a wall is in the way")
    assert {"key": "navigation", "value": "idle"} in status()["values"]


@pytest.mark.parametrize(
    ("robot", "token"), [("vizzy", "vizzy"), ("r1.lab-2", "r1_lab_2"), ("2nd", "_2nd")]
)
def test_every_robot_has_a_name_for_ros(robot: str, token: str) -> None:
    assert records.token_of(robot) == token
    assert check_name(f"/{token}_base")
