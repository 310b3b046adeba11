"""The classes that ROS generated for our types, and its QoS, for the driver `rclpy`."""

from __future__ import annotations

from typing import Any, Final

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.type_support import check_for_type_support
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport
from rosidl_runtime_py.utilities import get_interface

from vertebra.errors import TransportError
from vertebra.ros2.names import check_type
from vertebra.ros2.qos import Qos

_ACTION_PARTS: Final = {
    "SendGoal": "SendGoalService",
    "GetResult": "GetResultService",
    "FeedbackMessage": "FeedbackMessage",
}


def class_of(type_name: str) -> Any:
    """Return the class of a message or service, or of such a part of an action.

    Raises:
        TransportError: This ROS does not have it.
    """
    package, kind, leaf = check_type(type_name).split("/")
    action, _, part = leaf.rpartition("_")
    try:
        if kind == "action" and part in _ACTION_PARTS:
            whole = get_interface(f"{package}/{kind}/{action}")
            found = getattr(whole.Impl, _ACTION_PARTS[part])
        else:
            found = get_interface(type_name)
        check_for_type_support(found)
    except (ImportError, AttributeError, UnsupportedTypeSupport) as error:
        raise TransportError(
            f"the ROS here does not have the type {type_name} ({error}); install its package "
            f"{package}, or source the workspace it is in, and restart this service"
        ) from error
    return found


def profile_of(qos: Qos) -> Any:
    """Return ROS's QoS profile."""
    reliable, latched = qos.reliability == "reliable", qos.durability == "transient_local"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def qos_of(profile: Any) -> Qos:
    """Return what an endpoint offers or requests; its depth is nobody else's matter."""
    best_effort = profile.reliability == ReliabilityPolicy.BEST_EFFORT
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        reliability="best_effort" if best_effort else "reliable",
        durability="transient_local" if latched else "volatile",
    )


def policy_of(event: Any) -> str:
    """Return the name of the policy that keeps two endpoints apart."""
    return str(qos_policy_name_from_kind(event.last_policy_kind)).lower()
