"""What sensors measured: multi-analog sensors, laser scanners, wheels."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from typing import Final, Self

from vertebra.yarp.objects.parts import TWO_I32, YarpObject, damage, floats, number_list, pack
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Buffer, Value
from vertebra.yarp.protocol.dialect import INT32, LIST, Dialect


@dataclass(frozen=True, slots=True)
class Measurement:
    """What one sensor measured.

    Attributes:
        values: In the units of its kind.
        time_s: Seconds by the robot's clock.
    """

    values: array[float]
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorData(YarpObject):
    """What a multi-analog-sensors server streams; the fields are in the order of the wire."""

    gyroscopes: tuple[Measurement, ...] = ()
    linear_accelerometers: tuple[Measurement, ...] = ()
    magnetometers: tuple[Measurement, ...] = ()
    orientations: tuple[Measurement, ...] = ()
    temperatures: tuple[Measurement, ...] = ()
    force_torques: tuple[Measurement, ...] = ()
    contact_load_cells: tuple[Measurement, ...] = ()
    encoder_arrays: tuple[Measurement, ...] = ()
    skin_patches: tuple[Measurement, ...] = ()
    positions: tuple[Measurement, ...] = ()
    linear_velocities: tuple[Measurement, ...] = ()
    angular_accelerometers: tuple[Measurement, ...] = ()

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the measurements in binary."""
        parts = [TWO_I32.pack(LIST, len(_SENSOR_FIELDS))]
        for name in _SENSOR_FIELDS:
            measurements: tuple[Measurement, ...] = getattr(self, name)
            parts.append(TWO_I32.pack(LIST, len(measurements)))
            for measurement in measurements:
                parts.append(TWO_I32.pack(LIST, 2))
                parts.append(floats(measurement.values, dialect))
                parts.append(struct.pack("<id", dialect.float64, measurement.time_s))
        return b"".join(parts)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the measurements in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        values = bottle.decode(payload, dialect)
        if len(values) != len(_SENSOR_FIELDS):
            raise damage("SensorStreamingData", f"{len(values)} lists, not {len(_SENSOR_FIELDS)}")
        return cls(**dict(map(_measurements, _SENSOR_FIELDS, values)))


_SENSOR_FIELDS: Final = tuple(SensorData.__dataclass_fields__)


def _measurements(name: str, sensors: Value) -> tuple[str, tuple[Measurement, ...]]:
    if not isinstance(sensors, list):
        raise damage("SensorStreamingData", f"{name} is no list")
    return name, tuple(_measurement(name, sensor) for sensor in sensors)


def _measurement(name: str, sensor: Value) -> Measurement:
    match sensor:
        case [list() as values, float() as time_s]:
            return Measurement(number_list("SensorStreamingData", name, values), time_s)
        case _:
            raise damage("SensorStreamingData", f"a sensor of {name} is not (values) and a time")


@dataclass(frozen=True, slots=True)
class LaserScan2D(YarpObject):
    """One sweep of a laser scanner.

    Attributes:
        angle_min_deg: Angle of the first range.
        angle_max_deg: Angle after the last range.
        range_min_m: Nearest distance that the scanner sees.
        range_max_m: Farthest distance that the scanner sees.
        ranges_m: Distances by rising angle.
        status: Of the device, in YARP's own numbers.
    """

    angle_min_deg: float
    angle_max_deg: float
    range_min_m: float
    range_max_m: float
    ranges_m: array[float]
    status: int

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the scan in binary."""
        limits = (self.angle_min_deg, self.angle_max_deg, self.range_min_m, self.range_max_m)
        head = b"".join([struct.pack("<id", dialect.float64, limit) for limit in limits])
        ranges = floats(self.ranges_m, dialect)
        return TWO_I32.pack(LIST, 6) + head + ranges + pack("scan", TWO_I32, INT32, self.status)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the scan in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        match bottle.decode(payload, dialect):
            case [
                float() as angle_min, float() as angle_max,
                float() as range_min, float() as range_max,
                list() as ranges, int() as status,
            ]:  # fmt: skip
                numbers = number_list("LaserScan2D", "ranges", ranges)
                return cls(angle_min, angle_max, range_min, range_max, numbers, status)
            case other:
                raise damage("LaserScan2D", f"these {len(other)} values are no scan")


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryData(YarpObject):
    """Where a mobile base is on the floor, and how it moves.

    `base_vel` is in its own frame, `odom_vel` in that of its start. Metres and degrees; the fields
    are in the order of the wire.
    """

    odom_x: float
    odom_y: float
    odom_theta: float
    base_vel_x: float
    base_vel_y: float
    base_vel_theta: float
    odom_vel_x: float
    odom_vel_y: float
    odom_vel_theta: float

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the odometry in binary."""
        values = [getattr(self, name) for name in _ODOMETRY_FIELDS]
        tagged = [struct.pack("<id", dialect.float64, value) for value in values]
        return TWO_I32.pack(LIST, len(values)) + b"".join(tagged)

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the odometry in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        values = bottle.decode(payload, dialect)
        if len(values) != len(_ODOMETRY_FIELDS):
            raise damage("OdometryData", f"{len(values)} values, not {len(_ODOMETRY_FIELDS)}")
        numbers = number_list("OdometryData", "it", values)
        return cls(**dict(zip(_ODOMETRY_FIELDS, numbers, strict=True)))


_ODOMETRY_FIELDS: Final = tuple(OdometryData.__dataclass_fields__)
