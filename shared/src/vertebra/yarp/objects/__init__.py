"""The typed objects that YARP ports stream, and the bytes of each.

| family | objects | on the wire |
|---|---|---|
| vectors | Vector, VectorOf, Quaternion, Matrix | lists of numbers |
| images | Image | a header and padded rows |
| sounds | Sound | a header and int16, channel-wise |
| stamps | Stamp | an envelope, or a list of two |
| boards | Pair, JointData (JointValues, JointModes) | lists of vectors and flags |
| sensors | SensorData (Measurement), LaserScan2D, OdometryData | lists of vectors and times |
| clouds | PointCloud | a header and C++ structs |

All but the point cloud are bottles with a fixed shape. Each object has `encode(dialect)` and
`decode(payload, dialect)`; those that hold many numbers or pixels do it without going through a
list of Python values, and `kind_of` tells what a payload holds. Numbers are kept in `array.array`.
"""

from __future__ import annotations

from vertebra.yarp.objects.boards import JointData, JointModes, JointValues, Pair
from vertebra.yarp.objects.clouds import PointCloud
from vertebra.yarp.objects.images import DEFAULT_QUANTUM, PIXEL_BYTES, Image, row_bytes
from vertebra.yarp.objects.kinds import Kind, kind_of, read
from vertebra.yarp.objects.parts import YarpObject
from vertebra.yarp.objects.sensors import LaserScan2D, Measurement, OdometryData, SensorData
from vertebra.yarp.objects.sounds import Sound
from vertebra.yarp.objects.stamps import Stamp
from vertebra.yarp.objects.vectors import Matrix, Quaternion, Vector, VectorOf, is_vector

__all__ = [
    "DEFAULT_QUANTUM",
    "PIXEL_BYTES",
    "Image",
    "JointData",
    "JointModes",
    "JointValues",
    "Kind",
    "LaserScan2D",
    "Matrix",
    "Measurement",
    "OdometryData",
    "Pair",
    "PointCloud",
    "Quaternion",
    "SensorData",
    "Sound",
    "Stamp",
    "Vector",
    "VectorOf",
    "YarpObject",
    "is_vector",
    "kind_of",
    "read",
    "row_bytes",
]
