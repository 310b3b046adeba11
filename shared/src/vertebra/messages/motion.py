"""Bodies and how they move."""

from __future__ import annotations

from typing import Literal

from msgspec import field

from vertebra.messages.array import Array
from vertebra.messages.message import Message

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""Order x, y, z, w."""
Covariance = tuple[float, ...]
"""A square matrix, row by row; empty when unknown."""


def _check_covariance(name: str, values: Covariance, axes: int) -> None:
    if len(values) not in (0, axes * axes):
        raise ValueError(
            f"{name} has {len(values)} values, not {axes * axes} ({axes} rows), or none if unknown"
        )


class Imu(Message, frozen=True, kw_only=True):
    """An inertial measurement; what the device does not measure is None.

    Covariances are of x, y and z, row by row, and empty when unknown.
    """

    orientation_xyzw: Quaternion | None = None
    angular_velocity_deg_s: Vector3 | None = None
    linear_acceleration_m_s2: Vector3 | None = None
    magnetic_field_ut: Vector3 | None = None
    frame_id: str = ""
    orientation_covariance_rad2: Covariance = ()
    angular_velocity_covariance_deg2_s2: Covariance = ()
    linear_acceleration_covariance_m2_s4: Covariance = ()

    def __post_init__(self) -> None:
        for name in (
            "orientation_covariance_rad2",
            "angular_velocity_covariance_deg2_s2",
            "linear_acceleration_covariance_m2_s4",
        ):
            _check_covariance(name, getattr(self, name), 3)


class JointState(Message, frozen=True, kw_only=True):
    """Joints of one robot part, in the order of `names`.

    Angles are in degrees, as on YARP robots; a prismatic joint (see `kinds`) gives metres, metres
    per second and newtons in the same places. `velocities_deg_s` and `efforts_nm` are empty when
    unknown, `kinds` is empty when all joints are revolute.
    """

    names: tuple[str, ...]
    positions_deg: tuple[float, ...]
    velocities_deg_s: tuple[float, ...] = ()
    efforts_nm: tuple[float, ...] = ()
    kinds: tuple[Literal["revolute", "prismatic"], ...] = ()
    frame_id: str = ""

    def __post_init__(self) -> None:
        count = len(self.names)
        for name in ("positions_deg", "velocities_deg_s", "efforts_nm", "kinds"):
            values = getattr(self, name)
            if len(values) != count and (values or name == "positions_deg"):
                raise ValueError(f"{name} has {len(values)} values for {count} joints")


class JointCommand(Message, frozen=True, kw_only=True):
    """Where joints shall go: exactly one of positions and velocities, in the order of `names`.

    Attributes:
        names: The joints that are meant; the others keep what they do.
        positions_deg: Targets (metres for prismatic joints).
        velocities_deg_s: Speeds to keep (metres per second for prismatic joints).
        mode: `trajectory` moves there with the robot's own speed profile, `direct` at once.
    """

    names: tuple[str, ...]
    positions_deg: tuple[float, ...] = ()
    velocities_deg_s: tuple[float, ...] = ()
    mode: Literal["trajectory", "direct"] = "trajectory"

    def __post_init__(self) -> None:
        given = self.positions_deg or self.velocities_deg_s
        if bool(self.positions_deg) == bool(self.velocities_deg_s):
            raise ValueError("give either positions_deg or velocities_deg_s")
        if len(given) != len(self.names):
            raise ValueError(f"{len(given)} values were given for {len(self.names)} joints")


class Pose(Message, frozen=True, kw_only=True):
    """A position and orientation in the coordinate frame `frame_id`.

    Attributes:
        position_m: Where it is.
        orientation_xyzw: How it is turned.
        frame_id: In which coordinate frame.
        covariance_m_rad: 6 x 6, of x, y, z (m) and the rotations about them (rad).
    """

    position_m: Vector3
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    frame_id: str = ""
    covariance_m_rad: Covariance = ()

    def __post_init__(self) -> None:
        _check_covariance("covariance_m_rad", self.covariance_m_rad, 6)


class Twist(Message, frozen=True, kw_only=True):
    """A velocity in the coordinate frame `frame_id`.

    Attributes:
        linear_m_s: Along x, y, z.
        angular_rad_s: About x, y, z.
        frame_id: In which coordinate frame.
        covariance_m_s_rad_s: 6 x 6, of the linear (m/s) and the angular velocities (rad/s).
    """

    linear_m_s: Vector3 = (0.0, 0.0, 0.0)
    angular_rad_s: Vector3 = (0.0, 0.0, 0.0)
    frame_id: str = ""
    covariance_m_s_rad_s: Covariance = ()

    def __post_init__(self) -> None:
        _check_covariance("covariance_m_s_rad_s", self.covariance_m_s_rad_s, 6)


class Odometry(Message, frozen=True, kw_only=True):
    """Pose of `child_frame_id` in `pose.frame_id` and its velocity in `child_frame_id`."""

    pose: Pose
    twist: Twist
    child_frame_id: str = ""


class LaserScan(Message, frozen=True, kw_only=True):
    """A planar scan.

    Attributes:
        ranges_m: Shape (beams,), type `<f4`; beam i looks at `angle_min_rad + i *
            angle_increment_rad`, positive is left.
        intensities: Like `ranges_m`, device units, or None.
        angle_max_rad: Of the last beam as the device says it; None if it does not.
        time_increment_s: From one beam to the next; 0 if all are of one moment.
        scan_time_s: From one scan to the next; 0 if unknown.
    """

    ranges_m: Array
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    intensities: Array | None = None
    frame_id: str = ""
    angle_max_rad: float | None = None
    time_increment_s: float = 0.0
    scan_time_s: float = 0.0


class PointCloud(Message, frozen=True, kw_only=True):
    """Points in the coordinate frame `frame_id`.

    Attributes:
        points_m: Shape (points, 3) or, for an organised cloud, (height, width, 3); type `<f4`.
        colors_rgb: Same leading shape, 3 items of type `|u1`, or None.
        channels: What else is known of each point, by name, such as `intensity`; same leading
            shape, more than one item per point makes another axis.
    """

    points_m: Array
    colors_rgb: Array | None = None
    frame_id: str = ""
    channels: dict[str, Array] = field(default_factory=dict)
