"""Parts that many types are made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from vertebra.messages import Array, Quaternion, Vector3

Record = Mapping[str, Any]

CLOCKS_AGREE_WITHIN_NS: Final = 3600 * 10**9


def captured_ns(record: Record, received_ns: int) -> int:
    """Return when a record was true: its stamp, unless that is from another clock or not set.

    A stamp more than an hour away from our clock (simulated time, or none) says nothing here.
    """
    whole = record.get("header", record)
    stamp = whole.get("stamp") if isinstance(whole, Mapping) else None
    if not isinstance(stamp, Mapping) or stamp.keys() != {"sec", "nanosec"}:
        return received_ns
    stamped_ns: int = stamp["sec"] * 10**9 + stamp["nanosec"]
    return stamped_ns if abs(stamped_ns - received_ns) < CLOCKS_AGREE_WITHIN_NS else received_ns


def header(frame_id: str, stamp_ns: int) -> Record:
    """Return a `std_msgs/msg/Header`."""
    return {
        "stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9},
        "frame_id": frame_id,
    }


def frame_id(record: Record) -> str:
    """Return the coordinate frame in a record's header."""
    return str(record["header"]["frame_id"])


def vector(record: Record) -> Vector3:
    """Return a `Vector3` or `Point`."""
    return (record["x"], record["y"], record["z"])


def of_vector(values: Vector3) -> Record:
    """Return the record of a vector."""
    return dict(zip("xyz", values, strict=True))


def quaternion(record: Record) -> Quaternion:
    """Return a `Quaternion`."""
    return (record["x"], record["y"], record["z"], record["w"])


def of_quaternion(values: Quaternion) -> Record:
    """Return the record of a quaternion."""
    return dict(zip("xyzw", values, strict=True))


def covariance(values: Array, factor: float = 1.0) -> tuple[float, ...]:
    """Return a covariance; one of zeros is unknown to ROS, and empty here."""
    numbers = values.tolist()
    return tuple(number * factor for number in numbers) if any(numbers) else ()
