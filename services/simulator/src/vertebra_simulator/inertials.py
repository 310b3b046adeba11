"""What the multi-analog-sensors server of the head tells: one IMU, in the units of such servers."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Final

from vertebra.yarp import Value
from vertebra.yarp.objects import Measurement, SensorData

_NAME: Final = "head_imu"
_KINDS: Final = 12
_MEASURED: Final = 4  # gyroscope, accelerometer, magnetometer, orientation come first
METADATA: Final[list[Value]] = [
    [[_NAME, "head", ""]] if kind < _MEASURED else [] for kind in range(_KINDS)
]
"""The answer to `getMetadata`: name and frame of each sensor, by kind."""


def measurements(felt: Sequence[float], time_s: float) -> SensorData:
    """Return what streams on `measures:o` when an inertial port would stream `felt`."""

    def measured(values: Sequence[float]) -> tuple[Measurement]:
        return (Measurement(array("d", values), time_s),)

    return SensorData(
        orientations=measured(felt[:3]),
        linear_accelerometers=measured(felt[3:6]),
        gyroscopes=measured(felt[6:9]),
        magnetometers=measured([1e-6 * value for value in felt[9:]]),  # tesla
    )
